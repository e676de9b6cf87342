"""Maps of a cortex that follow from its surfaces alone. Each has a file here, and ``measure`` computes them all.

``NAME.py`` has a function ``values(cortex)`` that gives one number per vertex, (N,), NaN where there is none. A line of
``morphofold.quantities`` gives its label, unit and colours.
"""

import pkgutil
from collections.abc import Callable
from importlib import import_module

from morphofold.surface import Cortex, PerVertex


def each_map() -> dict[str, Callable[[Cortex], PerVertex]]:
    """The function of every map here, by the name of the map."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return {name: import_module(f"{__name__}.{name}").values for name in names}
