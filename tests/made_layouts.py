"""A cortex written as the programs write it whose layouts morphofold reads."""

import numpy as np

from morphofold.io import write_annotation, write_gifti_map, write_label, write_morph, write_surface

LR, LEFT_RIGHT = {"lh": "L", "rh": "R"}, {"lh": "left", "rh": "right"}
SURFACES, MAPS = ("white", "pial"), ("thickness", "sulc", "curv")


def _put(root, path):
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    return root / path


def _write_gifti(root, cortex, surface, values, regions="", mask="", kinds=None):
    """Surfaces, maps, regions and mask by patterns of their paths, in GIFTI."""
    names = {name: name for name in (*SURFACES, *MAPS)} | (kinds or {})
    for kind in SURFACES:
        write_surface(_put(root, surface.format(names[kind])), getattr(cortex, kind))
    for kind in MAPS:
        write_gifti_map(_put(root, values.format(names[kind])), cortex.maps[kind])
    if regions:
        write_annotation(_put(root, regions), cortex.regions)
    if mask:
        write_gifti_map(_put(root, mask), cortex.cortex.astype(float))


def write_freesurfer(root, name, cortex):
    for kind in SURFACES:
        write_surface(_put(root, f"{name}/surf/{cortex.hemi}.{kind}"), getattr(cortex, kind))
    for kind in MAPS:
        write_morph(root / f"{name}/surf/{cortex.hemi}.{kind}", cortex.maps[kind])
    write_annotation(_put(root, f"{name}/label/{cortex.hemi}.aparc.annot"), cortex.regions)
    write_label(root / f"{name}/label/{cortex.hemi}.cortex.label", cortex.cortex, cortex.white.verts)


def write_text_surfaces(root, name, cortex):
    """As FreeSurfer, with surfaces in the text of mris_convert and SUMA."""
    write_freesurfer(root, name, cortex)
    for kind in SURFACES:
        verts, faces = getattr(cortex, kind).verts, cortex.faces
        rows = [f"{len(verts)} {len(faces)}", *("{:.17g} {:.17g} {:.17g} 0".format(*tuple(row)) for row in verts)]
        rows += [f"{a} {b} {c} 0" for a, b, c in faces.tolist()]
        (root / f"{name}/surf/{cortex.hemi}.{kind}").unlink()
        text = "\n".join(["#!ascii version of a surface", *rows, ""])
        (root / f"{name}/surf/{cortex.hemi}.{kind}.asc").write_text(text)


def write_fmriprep(root, name, cortex):
    start = f"{name.replace('_ses-', '/ses-')}/anat/{name}_hemi-{LR[cortex.hemi]}"
    mask = f"{start}_desc-cortex_mask.label.gii"
    _write_gifti(root, cortex, f"{start}_{{}}.surf.gii", f"{start}_{{}}.shape.gii")
    write_label(root / mask, cortex.cortex, cortex.white.verts)
    write_surface(root / f"{start}_space-fsLR_den-32k_white.surf.gii", cortex.white)  # is not the subject's own mesh
    annotation = f"sourcedata/freesurfer/{name}/label/{cortex.hemi}.aparc.annot"
    write_annotation(_put(root, annotation), cortex.regions)


def write_hcp(root, name, cortex, folders=("T1w/Native", "MNINonLinear/Native"), mesh="native", roi="roi"):
    surfaces, maps = (f"{name}/{folder}/{name}.{LR[cortex.hemi]}" for folder in folders)
    _write_gifti(
        root,
        cortex,
        f"{surfaces}.{{}}.{mesh}.surf.gii",
        f"{maps}.{{}}.{mesh}.shape.gii",
        f"{maps}.aparc.{mesh}.label.gii",
        f"{maps}.{roi}.{mesh}.shape.gii",
    )


def write_hcp_32k(root, name, cortex):
    write_hcp(root, name, cortex, ("T1w/fsaverage_LR32k", "MNINonLinear/fsaverage_LR32k"), "32k_fs_LR", "atlasroi")


def write_dhcp(root, name, cortex):
    start = f"{name.replace('_ses-', '/ses-')}/anat/{name}_hemi-{LEFT_RIGHT[cortex.hemi]}"
    _write_gifti(
        root,
        cortex,
        f"{start}_{{}}.surf.gii",
        f"{start}_{{}}.shape.gii",
        f"{start}_desc-drawem_dseg.label.gii",
        f"{start}_desc-medialwall_mask.shape.gii",
        {"white": "wm"},
    )


def write_cat12(root, name, cortex):
    for kind in SURFACES:
        write_surface(_put(root, f"surf/{cortex.hemi}.{kind}.{name}.gii"), getattr(cortex, kind))
    write_surface(root / f"surf/{cortex.hemi}.central.{name}.gii", cortex.white)
    for kind in MAPS:
        write_morph(root / f"surf/{cortex.hemi}.{kind}.{name}", cortex.maps[kind])


def write_civet(root, name, cortex):
    side = LEFT_RIGHT[cortex.hemi]
    for kind, called in (("white", "white"), ("pial", "gray")):
        verts, faces = getattr(cortex, kind).verts, cortex.faces
        lines = [f"P 0.3 0.3 0.4 10 1 {len(verts)}", *(" ".join(map(str, row.tolist())) for row in [*verts, *verts])]
        lines += [f"{len(faces)}", "0 1 1 1 1", " ".join(map(str, 3 * np.arange(1, len(faces) + 1)))]
        lines += [" ".join(map(str, faces.ravel())), ""]
        _put(root, f"{name}/surfaces/study_{name}_{called}_surface_{side}_81920.obj").write_text("\n".join(lines))
    thickness = _put(root, f"{name}/thickness/study_{name}_native_rms_tlaplace_30mm_{side}.txt")
    np.savetxt(thickness, cortex.maps["thickness"], "%.17g")


def write_templateflow(home, name, cortex, density="32k", spheres=None):
    """A template of templateflow on the mesh of a cortex, without white; ``spheres`` by the end of their names."""
    start = f"tpl-{name}/tpl-{name}{{}}_hemi-{LR[cortex.hemi]}_den-{density}_"
    write_surface(_put(home, start.format("") + "midthickness.surf.gii"), cortex.white)
    write_label(home / (start.format("") + "desc-nomedialwall_dparc.label.gii"), cortex.cortex, cortex.white.verts)
    write_annotation(home / (start.format("") + "atlas-Test_dseg.label.gii"), cortex.regions)
    for space, sphere in (spheres or {"": cortex.sphere}).items():
        write_surface(home / (start.format(space) + "sphere.surf.gii"), sphere)


def write_standard_mesh_atlases(root, cortex, density="32k", spheres=None):
    """The folder of templates of HCP's pipelines, with a midthickness."""
    side, mesh = LR[cortex.hemi], f"{density}_fs_LR"
    write_surface(_put(root, f"Conte69.{side}.midthickness.{mesh}.surf.gii"), cortex.white)
    write_gifti_map(root / f"{side}.atlasroi.{mesh}.shape.gii", cortex.cortex.astype(float))
    write_annotation(root / f"Conte69.{side}.Test.{mesh}.label.gii", cortex.regions)
    names = {"": f"{side}.sphere", "_space-fsaverage": f"resample_fsaverage/fs_LR-deformed_to-fsaverage.{side}.sphere"}
    for space, sphere in spheres.items():
        write_surface(_put(root, f"{names[space]}.{mesh}.surf.gii"), sphere)
