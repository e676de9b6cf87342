"""Maps of a cortex that follow from its surfaces alone, a file each: ``measure`` makes every one that lies here.

``NAME.py`` has a function ``values(cortex)`` that gives one number per vertex, (N,), NaN where there is none. Its
label, unit and colours are a line of ``morphofold.quantities``.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from importlib import import_module

from morphofold.surface import Cortex, PerVertex


def each_map() -> dict[str, Callable[[Cortex], PerVertex]]:
    """The function of every map here, by its name."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return {name: import_module(f"{__name__}.{name}").values for name in names}
