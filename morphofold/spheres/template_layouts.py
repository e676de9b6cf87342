"""How templateflow and the Human Connectome Project name the files of templates: fs_LR and fsaverage at any density.

They are not shipped: those of fs_LR come under the terms of the Human Connectome Project. What is registered to
fs_LR comes over by spheres in the space ``fsLR``, all else by those in the space of fsaverage.
"""

from morphofold.io.layouts import Layout

SIDES = {"lh": "L", "rh": "R"}


def _names(ending: str, template: str, space: str = "") -> tuple[str, ...]:
    """A name of templateflow, in today's and in the earlier order of its parts."""
    start = f"tpl-{template}{space}"
    return f"{start}_hemi-{{side}}_den-{{density}}_{ending}", f"{start}_den-{{density}}_hemi-{{side}}_{ending}"


def _templateflow(template: str, spheres: dict[str, tuple[str, ...]], white: str) -> Layout:
    regions = ("{annotation}_dseg.label.gii", "atlas-{annotation}_dseg.label.gii")
    return Layout(
        template,
        folders=(f"tpl-{template}",),
        surfaces=_names("{kind}.surf.gii", template),
        others={
            **spheres,
            "regions": tuple(name for ending in regions for name in _names(ending, template)),
            "cortex": _names("desc-nomedialwall_dparc.label.gii", template),
        },
        sides=SIDES,
        kinds={"white": white},
        annotations=("atlas-Desikan2006_seg-aparc_desc-curated", "seg-aparc"),
    )


TEMPLATE_LAYOUTS = (
    _templateflow(
        "fsLR",
        {
            "registered fsLR": _names("sphere.surf.gii", "fsLR"),
            "registered": _names("sphere.surf.gii", "fsLR", "_space-fsaverage"),
        },
        "midthickness",
    ),
    _templateflow(
        "fsaverage",
        {"registered": _names("desc-std_sphere.surf.gii", "fsaverage") + _names("sphere.surf.gii", "fsaverage")},
        "white",
    ),
    Layout(  # the folder standard_mesh_atlases of HCP's pipelines, with a midthickness such as Conte69's in it
        "fsLR",
        folders=("standard_mesh_atlases",),
        surfaces=("{average}.{side}.{kind}.{density}_fs_LR.surf.gii",),
        others={
            "registered fsLR": ("{side}.sphere.{density}_fs_LR.surf.gii",),
            "registered": ("resample_fsaverage/fs_LR-deformed_to-fsaverage.{side}.sphere.{density}_fs_LR.surf.gii",),
            "regions": ("{average}.{side}.{annotation}.{density}_fs_LR.label.gii",),
            "cortex": ("{side}.atlasroi.{density}_fs_LR.shape.gii",),
        },
        sides=SIDES,
        kinds={"white": "midthickness"},
    ),
)
