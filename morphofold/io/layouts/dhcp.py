"""The developing Human Connectome Project: newborns and fetuses. Its white surface is called wm or white."""

from morphofold.io.layouts import Layout

LAYOUTS = tuple(
    Layout(
        "dHCP",
        folders=("sub-{x}/ses-{y}",),
        surfaces=(f"anat/{{entities}}_hemi-{{side}}_{space}{{kind}}.surf.gii",),
        maps=(f"anat/{{entities}}_hemi-{{side}}_{space}{{kind}}.shape.gii",),
        others={
            "regions": (f"anat/{{entities}}_hemi-{{side}}_{space}{{annotation}}.label.gii",),
            "cortex": (f"anat/{{entities}}_hemi-{{side}}_{space}desc-medialwall_mask.shape.gii",),
        },
        sides={"lh": "left", "rh": "right"},
        kinds={"white": white},
        annotations=("desc-drawem_dseg",),
    )
    for white in ("wm", "white")
    for space in ("", "space-T2w_")
)
