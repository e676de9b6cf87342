"""The options of ``morphofold theory``: a class for each question, see :mod:`morphofold.cli.options`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter, Token

from morphofold.cli.options import RUNNING, Printing, Switch, Texts, Whole, within
from morphofold.errors import NotReadable

MOST_RANGE_VALUES = 10_000  # in one FROM:TO:COUNT


def range_values(words: Sequence[str], option: str = "") -> list[float]:
    """Numbers and ranges FROM:TO:COUNT in the order given, each once."""
    numbers: list[float] = []
    for word in words:
        first, *rest = word.split(":")
        try:
            low = float(first)
            high, count = (float(rest[0]), int(rest[1])) if rest else (low, 2)
            if len(rest) > 2 or not 2 <= count <= MOST_RANGE_VALUES:
                raise NotReadable
        except (ValueError, IndexError):
            raise NotReadable(
                f"{option}: {word!r} is neither a number nor FROM:TO:COUNT with a COUNT from 2 to "
                f"{MOST_RANGE_VALUES:,}, such as 1:2:11."
            ) from None
        step = (high - low) / (count - 1)  # 1.2, not 1.2000000000000002
        numbers += [float(f"{low + i * step:.12g}") for i in range(count)] if rest else [low]
    return list(dict.fromkeys(numbers))


def _converted(_: Any, tokens: Sequence[Token]) -> list[float]:
    return range_values([token.value for token in tokens], tokens[0].keyword or "")


SEVERAL = Parameter(consume_multiple=(1, None), converter=_converted, json_list=False)
# lengths beyond these limits overflow, or results lose their digits
LENGTH, GROWTH, RATIO = within(1e-6, 1e6), within(1e-3, 1e3), within(1e-4, 1e4)
Length = Annotated[float, LENGTH]
Lengths = Annotated[list[float], SEVERAL, LENGTH]
Growth = Annotated[float, GROWTH]
Growths = Annotated[list[float], SEVERAL, GROWTH, Parameter(show_default="1:2:11")]
RadiusRatios = Annotated[list[float], SEVERAL, within(1 + 1e-6, 1e3)]
GrowthLaw = Literal["isotropic", "tangential", "both"]


@dataclass
class Theory(Printing):
    """Radius, stress, creases and wrinkles of the growing sphere, without a simulation.

    Without options each prints what the paper draws (Razavi et al. 2015, Figs. 3 and 4). bifurcation prints what the
    paper leaves out: the growth at which the smooth sphere first wrinkles. The help names the options that take ranges.
    Lengths are in mm, but only their ratios matter.

    For example:

    - `morphofold theory radius`
    - `morphofold theory stress --plot stress.png`
    - `morphofold theory critical`
    - `morphofold theory bifurcation --thickness 1:3:5 --mu-ratio 1 2 4 --law isotropic`
    """

    _: KW_ONLY
    hole_ratio: Annotated[float, within(0.0, 1 - 1e-6)] = 0.5
    """A/C: radius of the fixed hole over C."""
    law: GrowthLaw = "isotropic"
    """Growth of the cortex."""
    plot: Annotated[Path | None, Parameter(group=RUNNING)] = None
    """Also draw it: .png, .svg or .pdf."""

    @property
    def laws(self) -> tuple[str, ...]:
        return ("isotropic", "tangential") if self.law == "both" else (self.law,)


@dataclass
class Radius(Theory):
    """Outer radius of the smooth grown sphere, Eqs. (9) to (11); Fig. 3(a).

    For example:

    - `morphofold theory radius`
    """

    _: KW_ONLY
    thickness: Length = 2.0
    """Thickness of the cortex, T = C - B [mm]."""
    radius: Length = 50.0
    """Outer radius C [mm]."""
    growth: Growths = field(default_factory=lambda: range_values(["1:2:11"]))
    """Growth of the cortex; numbers or FROM:TO:COUNT."""
    core_growth: Growth = 1.0
    """Growth of the core; 1 is none."""

    @property
    def interface_radius(self) -> float:
        return self.radius - self.thickness


@dataclass
class Stress(Theory):
    """Radial and tangential stress through core and cortex; Fig. 3(b).

    For example:

    - `morphofold theory stress --plot stress.png`
    """

    _: KW_ONLY
    thickness: Lengths = field(default_factory=lambda: [1.0, 2.0, 3.0])
    """Thickness of the cortex, T = C - B [mm]; numbers or FROM:TO:COUNT."""
    radius: Length = 50.0
    """Outer radius C [mm]."""
    growth: Growth = 2.0
    """Growth of the cortex."""
    mu_ratio: Annotated[float, RATIO] = 1.0
    """Shear modulus, cortex over core."""
    points: Annotated[Whole, within(2, 10_000)] = 11
    """Points per layer."""
    core_growth: Growth = 1.0
    """Growth of the core; 1 is none."""


@dataclass
class Critical(Theory):
    """Growth at which creases can form, Eqs. (12) and (13), and Biot's limit; Fig. 4.

    For example:

    - `morphofold theory critical`
    """

    rules = ("--ratio excludes --thickness", "--radius needs --thickness")
    _: KW_ONLY
    law: GrowthLaw = "both"
    """Growth of the cortex."""
    ratio: Annotated[RadiusRatios, Parameter(show_default=False)] = field(default_factory=list)
    """C/B: outer radius / interface radius; numbers or FROM:TO:COUNT (default: 1.02:1.3:15)."""
    thickness: Annotated[Lengths, Parameter(show_default=False)] = field(default_factory=list)
    """Of the cortex [mm], instead of --ratio; numbers or FROM:TO:COUNT."""
    radius: Annotated[float | None, LENGTH] = None
    """Outer radius C [mm], with --thickness (default: 50)."""
    core_growth: Growth = 1.0
    """Growth of the core; 1 is none."""


@dataclass
class Bifurcation(Theory):
    """Growth at which the smooth sphere first wrinkles, and its wrinkles; with the crease criterion.

    The cortex grows by the stretch g (a ratio of lengths, 1 is none): in all directions if isotropic, along the surface
    alone if tangential. Wrinkles are waves all over the sphere, spherical harmonics of degree l: about l around it,
    each 2 pi C / sqrt(l (l + 1)) long. A crease is a sharp fold of the surface alone; it can form once
    lambda_r/lambda_theta of the smooth surface is 2.4, the paper's criterion. The mu ratio is the cortex's shear
    modulus over the core's. The defaults are the paper's sphere: C = 50, A/C = 0.5, T = 1, 2 and 3, incompressible.
    With --body it prints the growth at which the meshed body of a scene loses its stability, from the exact stiffness
    of that mesh. If the scene is a sphere or a part of one, theory is printed too. The effects of the scene are left
    out.

    For example:

    - `morphofold theory bifurcation --thickness 1:3:5 --mu-ratio 1 2 4 --law isotropic`
    """

    rules = (
        "--set needs --body",
        "--body excludes --thickness --radius --hole-ratio --mu-ratio --kappa-ratio --law --curve --plot",
    )
    _: KW_ONLY
    law: GrowthLaw = "both"
    """Growth of the cortex."""
    thickness: Lengths = field(default_factory=lambda: [1.0, 2.0, 3.0])
    """Thickness of the cortex, T = C - B [mm]; numbers or FROM:TO:COUNT."""
    radius: Length = 50.0
    """Outer radius C [mm]."""
    mu_ratio: Annotated[list[float], SEVERAL, RATIO] = field(default_factory=lambda: [1.0, 2.0, 4.0])
    """Shear modulus, cortex over core; numbers or FROM:TO:COUNT."""
    kappa_ratio: Annotated[float, within(1.0, math.inf)] = math.inf
    """Bulk over shear modulus; inf is incompressible."""
    curve: Switch = False
    """Critical growth of each degree, not only the least."""
    body: str | None = None
    """A built-in scene or a TOML file, instead of the options above."""
    set: Texts = field(default_factory=list)
    """With --body: change one value of the scene, TABLE.KEY=VALUE; may be repeated."""
