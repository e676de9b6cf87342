"""CAT12: the surfaces of all subjects of a study lie in one folder surf/, or in those of a BIDS dataset.

It writes white and pial only if asked to (``output.surf_measures``, or ``cat.extopts.expertgui``): the central surface
alone has no thickness of gyri.
"""

from morphofold.io.layouts import Layout

LAYOUTS = (
    Layout(
        "CAT12",
        folders=("", "sub-{x}/ses-{y}", "sub-{x}"),
        surfaces=("surf/{side}.{kind}.{subject}.gii",),
        maps=("surf/{side}.{kind}.{subject}",),
        others={
            "regions": ("label/{side}.{annotation}.{subject}.annot",),
            "registered": ("surf/{side}.sphere.reg.{subject}.gii",),
        },
        annotations=("aparc_DK40",),
        needs=("surf/lh.central.{subject}.gii",),  # which lh.white.surf.gii of others lacks
    ),
)
