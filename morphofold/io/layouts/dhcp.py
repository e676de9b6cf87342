"""The developing Human Connectome Project: newborns and fetuses, by releases 2 and 3."""

from morphofold.io.layouts import Layout

LAYOUTS = tuple(
    Layout(
        "dHCP",
        folders=("sub-{x}/ses-{y}",),
        surfaces=(f"anat/{{entities}}_{side_key}{{side}}_{space}{{kind}}.surf.gii",),
        maps=(f"anat/{{entities}}_{side_key}{{side}}_{space}{{kind}}.shape.gii",),
        others={
            "regions": tuple(
                f"anat/{{entities}}_{side_key}{{side}}_{space}{name}.label.gii" for name in ("{annotation}", "drawem")
            ),
            "cortex": tuple(
                f"anat/{{entities}}_{side_key}{{side}}_{space}{name}.shape.gii"
                for name in ("desc-medialwall_mask", "roi")
            ),
        },
        sides=sides,
        kinds={"white": white},
        annotations=("desc-drawem_dseg",),
    )
    for side_key, sides, white in (
        ("hemi-", {"lh": "left", "rh": "right"}, "wm"),
        ("hemi-", {"lh": "left", "rh": "right"}, "white"),
        ("", {"lh": "left", "rh": "right"}, "white"),
    )
    for space in ("", "space-T2w_")
)
