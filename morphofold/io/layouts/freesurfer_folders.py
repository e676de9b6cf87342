"""FreeSurfer 5 to 8, FastSurfer, simulations and analyses of morphofold, and folders with ``lh.white`` alone."""

from morphofold.io.layouts import FREESURFER, Layout

SURFACE_ENDINGS = ("", ".surf.gii", ".gii", ".surf.gii.gz", ".asc")
_MAP_ENDINGS = ("", ".shape.gii", ".gii", ".mgh", ".mgz")


def _paths(folder: str, stem: str, endings: tuple[str, ...]) -> tuple[str, ...]:
    """Patterns of a file in its folder, in surf/ or in the subject's folder itself."""
    return tuple(f"{parent}{stem}{end}" for parent in dict.fromkeys((folder, "surf/", "")) for end in endings)


LAYOUTS = (
    Layout(
        FREESURFER,
        folders=("sub-{x}/ses-{y}", "{x}"),
        surfaces=_paths("surf/", "{side}.{kind}", SURFACE_ENDINGS),
        maps=_paths("surf/", "{side}.{kind}", _MAP_ENDINGS),
        others={
            "regions": _paths("label/", "{side}.{annotation}", (".annot", ".label.gii")),
            "cortex": (
                *_paths("label/", "{side}.cortex.label", ("",)),
                *_paths("label/", "{side}.atlasroi.shape.gii", ("",)),  # of HCP
            ),
            "registered": _paths("surf/", "{side}.sphere.reg", SURFACE_ENDINGS),
            "stats": ("stats/aseg.stats",),
            "summary": ("summary.json",),
        },
        annotations=("aparc", "aparc.DKTatlas.mapped"),  # the second of FastSurfer
        marks=("surf", "mri", "scripts", "stats", "label"),
    ),
)
