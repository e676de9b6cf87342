"""``morphofold unfold``: unfold a cortex, and write the result and a page."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from morphofold.cli.analyze import writable_name
from morphofold.cli.command_options import Answer, Unfold, sides
from morphofold.cli.terminal_output import progress
from morphofold.io import refuse_foreign
from morphofold.io.cortices import hemispheres, read_folded
from morphofold.io.files import side_named
from morphofold.mesh_quality.repair import unfoldable
from morphofold.progress_callbacks import part_of
from morphofold.report.pages.unfold_page import unfold_report
from morphofold.results.unfolding import UnfoldedSide, write_unfolding
from morphofold.unfolding.spheres import sphere_of
from morphofold.unfolding.unfold import check_options, unfold


def run(args: Unfold) -> Answer:
    check_options(args.level, args.radius)
    source = args.input
    hemis = sides(args.hemi) or ([side_named(source.name) or "lh"] if source.is_file() else hemispheres(source))
    with progress("unfold", args.quiet) as on_progress:
        on_progress(0.0, "reading")
        meshes = [unfoldable(read_folded(source, hemi, surface=args.surface, sphere=args.sphere)) for hemi in hemis]
        out = args.out or Path(f"{writable_name(meshes[0].cortex.name)}-unfolded")
        refuse_foreign(out, [source])
        unfolded_sides = []
        for k, mesh in enumerate(meshes):
            white, sphere = mesh.cortex.white, mesh.cortex.sphere
            update = part_of(on_progress, 0.1 + 0.5 * k / len(meshes), 0.5 / len(meshes), f"{mesh.cortex.hemi}: ")
            update(0.0, "heat flow")
            unfolding = unfold(white, sphere or sphere_of(white, update), args.level, radius=args.radius)
            unfolded_sides.append(UnfoldedSide(mesh, unfolding))
        on_progress(0.6, "writing")
        summary = write_unfolding(unfolded_sides, out, unfold_report)
        on_progress(1.0, "done")
    return Answer(out / "summary.json", _unfolded_lines(summary, out))


def _unfolded_lines(summary: Mapping[str, Any], out: Path) -> Iterator[str]:
    for row in summary["hemispheres"]:
        yield (
            f"{summary['name']} {row['hemi']}: {row['folded_area_mm2']:,.0f} mm2 folded, {row['area_mm2']:,.0f} mm2 "
            f"smooth; a cortex of up to {row['thickest_cortex_mm']:.2g} mm fits"
        )
        yield from (f"warning: {note} [{key}]" for key, note in summary["notes"][row["hemi"]].items())
    yield f"-> {out / 'report.html'}"
