"""CIVET 1 and 2: white and gray surfaces of 40,962 vertices, resampled to its template where that was done."""

from morphofold.io.layouts import Layout

LAYOUTS = tuple(
    Layout(
        "CIVET",
        folders=("{x}",),
        surfaces=(
            f"surfaces/{{entities}}_{{kind}}_surface{rsl}_{{side}}_81920.obj",
            f"surfaces/{{entities}}_{{kind}}_surface{rsl}_{{side}}_calibrated_81920.obj",  # white of CIVET 1
        ),
        maps=(f"thickness/{{entities}}_native_rms{rsl}_{{kind}}_{{side}}.txt",),
        sides={"lh": "left", "rh": "right"},
        kinds={"pial": "gray", "thickness": "tlaplace_30mm"},
    )
    for rsl in ("_rsl", "")
)
