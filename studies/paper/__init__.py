"""The figures of Razavi et al. (2015) that can be reproduced, each with the table of its points."""

from collections.abc import Callable
from typing import Any

from morphofold.studies.paper.figures_8_and_9 import reproduce_fig8, reproduce_fig9
from morphofold.studies.paper.paper_folds import reproduce_fig5, reproduce_fig6, reproduce_fig7
from morphofold.studies.paper.paper_theory import reproduce_fig3, reproduce_fig4
from morphofold.studies.person.thickness_pair_figure import reproduce_pairs

#: figure of the paper -> function that writes its files into a folder and returns their entry for an index; it
#: requests the simulations that it needs
REPRODUCTIONS: dict[str, Callable[..., dict[str, Any]]] = {
    "fig3": reproduce_fig3,
    "fig4": reproduce_fig4,
    "fig5": reproduce_fig5,
    "fig6": reproduce_fig6,
    "fig7": reproduce_fig7,
    "fig8": reproduce_fig8,
    "fig9": reproduce_fig9,
    "fig8-grown": reproduce_pairs,
}
