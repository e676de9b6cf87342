"""CIVET: white and gray surfaces of 40,962 vertices, in the space of its template."""

from morphofold.io.layouts import Layout

LAYOUTS = (
    Layout(
        "CIVET",
        folders=("{x}",),
        surfaces=("surfaces/{entities}_{kind}_surface_{side}_81920.obj",),
        maps=("thickness/{entities}_native_rms_{kind}_{side}.txt",),
        sides={"lh": "left", "rh": "right"},
        kinds={"pial": "gray", "thickness": "tlaplace_30mm"},
        in_template_space=True,
    ),
)
