"""The Human Connectome Project's pipelines: the subject's own mesh, or 32,000 vertices of fs_LR.

Surfaces are those of T1w/, in the person's own millimetres; those of MNINonLinear/ are warped to a template. Name
``T1w/fsaverage_LR32k`` for the mesh of fs_LR where both are.
"""

from morphofold.io.layouts import Layout


def _layout(surfaces: str, maps: str, mesh: str, spheres: dict[str, tuple[str, ...]]) -> Layout:
    start = f"{maps}/{{subject}}.{{side}}"
    return Layout(
        "HCP",
        folders=("{subject}",),
        surfaces=(f"{surfaces}/{{subject}}.{{side}}.{{kind}}.{mesh}.surf.gii",),
        maps=(f"{start}.{{kind}}.{mesh}.shape.gii",),
        others={
            "regions": (
                f"{start}.{{annotation}}.{mesh}.label.gii",
                f"{maps}/{{subject}}.{{annotation}}.{mesh}.dlabel.nii",
            ),
            "cortex": (f"{start}.roi.{mesh}.shape.gii", f"{start}.atlasroi.{mesh}.shape.gii"),
            **{
                content: tuple(f"{start}.{name}.{mesh}.surf.gii" for name in names)
                for content, names in spheres.items()
            },
        },
        sides={"lh": "L", "rh": "R"},
    )


LAYOUTS = (
    _layout(
        "T1w/Native",
        "MNINonLinear/Native",
        "native",
        {"registered": ("sphere.reg",), "registered fsLR": ("sphere.MSMAll", "sphere.MSMSulc", "sphere.reg.reg_LR")},
    ),
    _layout("T1w/fsaverage_LR32k", "MNINonLinear/fsaverage_LR32k", "32k_fs_LR", {"registered fsLR": ("sphere",)}),
)
