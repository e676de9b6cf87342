"""The Human Connectome Project's pipelines: the subject's own mesh, or 32,000 vertices of fs_LR.

Surfaces are those of T1w/, in the person's own millimetres; those of MNINonLinear/ are warped to a template. Name
``T1w/fsaverage_LR32k`` for the mesh of fs_LR where both are.
"""

from morphofold.io.layouts import Layout


def _layout(surfaces: str, maps: str, mesh: str, registered: tuple[str, ...] = ()) -> Layout:
    start = f"{maps}/{{subject}}.{{side}}"
    return Layout(
        "HCP",
        folders=("{subject}",),
        surfaces=(f"{surfaces}/{{subject}}.{{side}}.{{kind}}.{mesh}.surf.gii",),
        maps=(f"{start}.{{kind}}.{mesh}.shape.gii",),
        others={
            "regions": (f"{start}.{{annotation}}.{mesh}.label.gii",),
            "cortex": (f"{start}.roi.{mesh}.shape.gii", f"{start}.atlasroi.{mesh}.shape.gii"),
            "registered": registered,
        },
        sides={"lh": "L", "rh": "R"},
    )


LAYOUTS = (
    _layout(
        "T1w/Native",
        "MNINonLinear/Native",
        "native",
        ("MNINonLinear/Native/{subject}.{side}.sphere.reg.native.surf.gii",),
    ),
    _layout("T1w/fsaverage_LR32k", "MNINonLinear/fsaverage_LR32k", "32k_fs_LR"),
)
