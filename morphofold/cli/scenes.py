"""``morphofold scenes``: a table of the built-in scenes, or one of them with all its values."""

from collections.abc import Iterator, Sequence

from morphofold.cli.command_options import Answer, Scenes
from morphofold.cli.terminal_output import aligned
from morphofold.sim.scene import Scene
from morphofold.sim.scene.scene_files import load_scene, scene_names, to_toml

SCENE_KINDS = ("Figures of the paper", "The same, growing along the surface only", "Spheres", "Other bodies")
TABLE_HEADINGS = ("name", "shape", "cortex", "mu ratio", "growth", "to", "effects")


def run(args: Scenes) -> Answer:
    if args.scene is not None:
        scene = load_scene(args.scene)
        return Answer(scene.model_dump(exclude_none=True), to_toml(scene).splitlines())
    scenes = [load_scene(name) for name in scene_names()]
    summary = [{"name": scene.name, "title": scene.title, "effects": tuple(scene.effects)} for scene in scenes]
    return Answer(summary, _table_lines(scenes))


def _kind_of_scene(scene: Scene) -> str:
    if scene.name.startswith("fig"):
        return SCENE_KINDS[1] if scene.growth.law == "tangential" else SCENE_KINDS[0]
    return SCENE_KINDS[2] if scene.geometry.shape == "sphere" else SCENE_KINDS[3]


def _row(scene: Scene) -> tuple[str, ...]:
    geometry = scene.geometry
    shape = " ".join(filter(None, (getattr(geometry, "portion", "").replace("full", ""), geometry.shape)))
    thickness, mu_ratio, final_growth = geometry.cortex_thickness, scene.material.mu_ratio, scene.growth.final
    effects = ", ".join(scene.effects) or "-"
    return scene.name, shape, f"{thickness:g} mm", f"{mu_ratio:g}", scene.growth.law, f"{final_growth:.2f}", effects


def _table_lines(scenes: Sequence[Scene]) -> Iterator[str]:
    """Table of the scenes by kind, in columns."""
    heading, *scene_lines = aligned([*zip(TABLE_HEADINGS, *map(_row, scenes))], "<" * len(TABLE_HEADINGS))
    yield heading
    for kind in SCENE_KINDS:
        yield from ("", kind, *(line for scene, line in zip(scenes, scene_lines) if _kind_of_scene(scene) == kind))
