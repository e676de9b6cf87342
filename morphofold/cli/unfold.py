"""``morphofold unfold``: smooth surfaces of one or both hemispheres, with a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from morphofold.cli.inputs import writable_name
from morphofold.cli.options import Answer, Unfold, sides
from morphofold.cli.printing import progress
from morphofold.io import refuse_foreign
from morphofold.io.cortices import hemispheres, read_folded
from morphofold.io.files import side_named
from morphofold.mesh_quality.repair import unfoldable
from morphofold.progress import part_of
from morphofold.report.pages.study_pages import unfold_report
from morphofold.results.unfolding import UnfoldedSide, write_unfolding
from morphofold.unfolding.spheres import sphere_of
from morphofold.unfolding.unfold import check_options, unfold


def run(args: Unfold) -> Answer:
    check_options(args.level, args.radius)
    source = args.input
    present = hemispheres(source) if source.is_dir() else (side_named(source.name) or "lh",)
    hemis = sides(args.hemi) or present
    with progress("unfold", args.quiet) as show:
        show(0.0, "reading")
        bodies = [unfoldable(read_folded(source, hemi, surface=args.surface, sphere=args.sphere)) for hemi in hemis]
        out = args.out or Path(f"{writable_name(bodies[0].cortex.name)}-unfolded")
        refuse_foreign(out, [source])
        unfolded = []
        for k, body in enumerate(bodies):
            white, sphere = body.cortex.white, body.cortex.sphere
            part = part_of(show, 0.1 + 0.5 * k / len(bodies), 0.5 / len(bodies), f"{body.cortex.hemi}: ")
            part(0.0, "heat flow")
            smooth = unfold(white, sphere or sphere_of(white, part), args.level, radius=args.radius)
            unfolded.append(UnfoldedSide(body, smooth))
        show(0.6, "writing")
        summary = write_unfolding(unfolded, out, unfold_report)
        show(1.0, "done")
    return Answer(out / "summary.json", _lines(summary, out))


def _lines(summary: Mapping[str, Any], out: Path) -> Iterator[str]:
    for row in summary["hemispheres"]:
        yield (
            f"{summary['name']} {row['hemi']}: {row['folded_area_mm2']:,.0f} mm2 folded, {row['area_mm2']:,.0f} mm2 "
            f"smooth; a cortex of up to {row['thickest_cortex_mm']:.2g} mm fits"
        )
        yield from (f"warning: {note} [{key}]" for key, note in summary["notes"][row["hemi"]].items())
    yield f"-> {out / 'report.html'}"
