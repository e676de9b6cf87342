"""sMRIPrep, fMRIPrep and NiBabies, and what ``morphofold analyze --layout bids`` writes."""

from dataclasses import replace

from morphofold.io.layouts import Layout

SIDES = {"lh": "L", "rh": "R"}
FOLDERS = ("sub-{x}/ses-{y}", "sub-{x}")
_OTHERS = {
    "regions": (
        "anat/{entities}_hemi-{side}_seg-{annotation}_dseg.label.gii",
        "../sourcedata/freesurfer/{entities}/label/{hemi}.{annotation}.annot",
        "../../sourcedata/freesurfer/{entities}/label/{hemi}.{annotation}.annot",  # from a session
        "../../sourcedata/freesurfer/{person}/label/{hemi}.{annotation}.annot",
    ),
    "cortex": ("anat/{entities}_hemi-{side}_desc-cortex_mask.label.gii",),
    "registered": ("anat/{entities}_hemi-{side}_desc-reg_sphere.surf.gii",),
    "registered fsLR": (
        "anat/{entities}_hemi-{side}_space-fsLR_desc-msmsulc_sphere.surf.gii",
        "anat/{entities}_hemi-{side}_space-fsLR_desc-reg_sphere.surf.gii",
    ),
}
_SUMMARY = "anat/{entities}_desc-morphofold_provenance.json"
_FMRIPREP = Layout(
    "fMRIPrep",
    FOLDERS,
    surfaces=("anat/{entities}_hemi-{side}_{kind}.surf.gii",),
    maps=("anat/{entities}_hemi-{side}_{kind}.shape.gii",),
    others=_OTHERS,
    sides=SIDES,
)
_OURS = replace(
    _FMRIPREP,
    program="morphofold",
    maps=("anat/{entities}_hemi-{side}_desc-input_{kind}.shape.gii",),  # without desc-input they are its own measures
    others={**_OTHERS, "summary": (_SUMMARY,)},
    needs=(_SUMMARY,),
)
LAYOUTS = (_OURS, _FMRIPREP)
