"""The figures of Razavi et al. (2015), drawn anew, each with the table of its points.

Only theory is drawn as yet, and labels say so, for finite-element points to join. The text of the paper doesn't state
the limits of its axes: those here are ours and follow the ranges that the text names.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.report.line_plots import legend_below, new_figure, save, set_limits
from morphofold.report.theory_plots import LAWS, draw_critical, draw_radius, draw_stress
from morphofold.report.theory_tables import Row, critical_rows, radius_rows, stress_rows
from morphofold.results import write_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def fig3() -> Figure:
    """Fig. 3: (a) outer radius against isotropic growth, (b) tangential stress through the cortex at g = 2.

    C = 50 mm; T = 2 mm in (a), 1, 2 and 3 mm in (b). Limits: g from 1 to 2, as in the text, and c/B from 1 to 1.3;
    position from the interface (0) to the outer surface (1), stress over the cortex's own modulus from -14 to 0.
    """
    radius, stress = fig3_rows()
    with new_figure(9.2, 4.4, 1, 2) as (figure, ((left, right),)):
        draw_radius(left, radius)
        set_limits(left, (1, 2), (1, 1.3), "(a)  $T$ = 2 mm, $C$ = 50 mm, isotropic growth")
        draw_stress(right, stress)
        set_limits(right, (0, 1), (-14, 0), "(b)  $g$ = 2, $C$ = 50 mm, isotropic growth")
        legend_below(left)
        legend_below(right)
    return figure


def fig3_rows() -> tuple[list[Row], list[Row]]:
    """The points of :func:`fig3`, panels (a) and (b)."""
    radius, stress = radius_rows(np.linspace(1, 2, 101)), stress_rows(points=101, layers=("cortex",))
    return [{"source": "theory", **row} for row in radius], [{"source": "theory", **row} for row in stress]


def fig4() -> Figure:
    """Fig. 4: growth at which creases can form against C/B, Eqs. (12) and (13), with the limits that the text names.

    Limits: C/B from 1 to 1.3, beyond the 1.2 from which isotropic growth brings no crease; g from 1 to 3.
    """
    with new_figure(7.6, 4.6, 1, 1) as (figure, ((ax,),)):
        draw_critical(ax, fig4_rows(), LAWS)
        set_limits(ax, (1, 1.3), (1, 3), "")
        legend_below(ax)
    return figure


def fig4_rows() -> list[Row]:
    """The points of :func:`fig4`."""
    rows = critical_rows(np.linspace(1, 1.3, 601)[1:])
    return [{"source": "theory", **row} for row in rows]


def reproduce_fig3(folder: Path) -> dict[str, Any]:
    """Write fig3.png, fig3a.tsv and fig3b.tsv into ``folder``; what an index should say of them."""
    save(fig3(), folder / "fig3.png")
    for panel, rows in zip("ab", fig3_rows()):
        write_table(folder / f"fig3{panel}.tsv", list(rows[0]), rows)
    return {
        "files": ["fig3.png", "fig3a.tsv", "fig3b.tsv"],
        "shows": "(a) outer radius against growth, (b) tangential stress through the cortex",
        "equations": "(a) Eq. (11); (b) Eqs. (4) to (6) integrated in closed form, zero radial stress outside",
        "parameters": {
            "law": "isotropic", "outer_radius_mm": 50,
            "a": {"thickness_mm": 2, "growth": [1, 2]},
            "b": {"thickness_mm": [1, 2, 3], "growth": 2, "mu_ratio": 1},
        },
        "limits": "ours, after the ranges in the text: g 1 to 2, c/B 1 to 1.3; position 0 to 1, stress/mu -14 to 0",
    }  # fmt: skip


def reproduce_fig4(folder: Path) -> dict[str, Any]:
    """Write fig4.png and fig4.tsv into ``folder``; what an index should say of them."""
    save(fig4(), folder / "fig4.png")
    write_table(folder / "fig4.tsv", ("source", "law", "C_over_B", "T_over_C", "g_crease"), fig4_rows())
    return {
        "files": ["fig4.png", "fig4.tsv"],
        "shows": "growth at which creases can form, against the outer radius",
        "equations": "Eq. (12), isotropic; Eq. (13), tangential; criterion lambda_r/lambda_theta = 2.4, Eq. (7)",
        "parameters": {"law": list(LAWS), "C_over_B": [1, 1.3], "g_core": 1},
        "limits": "ours, after the ranges in the text: C/B 1 to 1.3, g 1 to 3",
    }


#: figure of the paper -> function that writes its files into a folder
REPRODUCTIONS: dict[str, Callable[[Path], dict[str, Any]]] = {"fig3": reproduce_fig3, "fig4": reproduce_fig4}
