"""CAT12: the surfaces of all subjects of a study lie in one folder surf/, or in those of a BIDS dataset."""

from morphofold.io.layouts import Layout

LAYOUTS = (
    Layout(
        "CAT12",
        folders=("", "sub-{x}/ses-{y}", "sub-{x}"),
        surfaces=("surf/{side}.{kind}.{subject}.gii",),
        maps=("surf/{side}.{kind}.{subject}",),
        others={"registered": ("surf/{side}.sphere.reg.{subject}.gii",)},
        needs=("surf/lh.central.{subject}.gii",),  # which lh.white.surf.gii of others lacks
    ),
)
