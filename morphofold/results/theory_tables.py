"""Tables of the theory, one row per point: ``morphofold theory`` prints them and the figures of the studies draw them.

Lengths are in mm; only their ratios matter (the paper's 50 and 2 have no unit). Growth stretches are ratios of lengths.
Stresses are over a shear modulus, which the column names give.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from morphofold.errors import ImpossibleBody, OutOfRange
from morphofold.sim import theory
from morphofold.sim.scene.geometries import Sphere

if TYPE_CHECKING:
    from morphofold.sim.equilibrium.statics import Look
    from morphofold.sim.scene import Scene

Row = dict[str, Any]

#: growth up to which wrinkles and creases are searched
G_MAX = 10.0
_SEARCH_LIMIT_TEXT = f"found up to g = {G_MAX:g}, or as far as the smooth state could be followed"


@dataclass(frozen=True)
class Case:
    """First wrinkles and first creases of one sphere.

    Attributes
    ----------
    thickness, radius : float
        Thickness of the cortex, and radius of the outer surface [mm].
    mu_ratio : float
        Shear modulus of the cortex over the core's.
    law : {"isotropic", "tangential"}
    kappa_ratio, A_over_C : float
        Bulk over shear modulus (inf is incompressible); radius of the fixed hole over the outer one.
    bifurcation : Bifurcation
        Result of :func:`morphofold.sim.theory.bifurcation`, with creases at the same kappa_ratio.
    """

    thickness: float
    radius: float
    mu_ratio: float
    law: str
    kappa_ratio: float
    A_over_C: float
    bifurcation: theory.Bifurcation

    def row(self) -> Row:
        """Critical growth, mode and wavelength; ``reason`` explains values that are NaN or infinite."""
        bifurcation, T_over_C = self.bifurcation, self.thickness / self.radius
        reasons = [bifurcation.reason] if bifurcation.reason else []
        if np.isinf(bifurcation.mode):
            reasons.append("the shortest waves come first: their degree has no bound")
        if np.isnan(bifurcation.creasing_amplitude) and not np.isnan(bifurcation.g_crit):
            reasons.append("these wrinkles live on the interface: no creasing amplitude")
        if np.isnan(bifurcation.g_crease):
            reasons.append(f"no crease {_SEARCH_LIMIT_TEXT}")
        return {
            **self._sphere_columns(),
            "g_crit": bifurcation.g_crit,
            "degree": _whole_degree(bifurcation.mode),
            "wavelength_mm": bifurcation.wavelength * self.radius,
            "wavelength_over_T": bifurcation.wavelength / T_over_C,
            "wavelength_deformed_mm": bifurcation.wavelength_deformed * self.radius,
            "wavelength_deformed_over_T": bifurcation.wavelength_deformed / T_over_C,
            "creasing_amplitude_over_T": bifurcation.creasing_amplitude / T_over_C,
            "g_crease": bifurcation.g_crease,
            "first": bifurcation.first or None,
            "reason": "; ".join(reasons) or None,
        }

    def curve_rows(self) -> list[Row]:
        """Critical growth of each degree that was computed; NaN, with the reason, where none was first."""
        none_text = f"none {_SEARCH_LIMIT_TEXT}"
        return [
            {**self._sphere_columns(), "degree": int(degree), "g_crit": g, "reason": none_text if np.isnan(g) else None}
            for degree, g in zip(*self.bifurcation.curve)
        ]

    def _sphere_columns(self) -> Row:
        return {
            "law": self.law,
            "thickness_mm": self.thickness,
            "outer_radius_mm": self.radius,
            "T_over_C": self.thickness / self.radius,
            "hole_ratio": self.A_over_C,
            "mu_ratio": self.mu_ratio,
            "kappa_ratio": "inf" if np.isinf(self.kappa_ratio) else self.kappa_ratio,
        }


def _whole_degree(mode: float) -> int | str | None:
    """The degree as a whole number; "inf" if it is infinite, since JSON has no such number; None without a mode."""
    return None if np.isnan(mode) else "inf" if np.isinf(mode) else int(mode)


def radius_rows(
    growth: Iterable[float],
    thickness: float = 2.0,
    radius: float = 50.0,
    laws: Sequence[str] = ("isotropic",),
    *,
    g_core: float = 1.0,
    A_over_C: float = 0.5,
) -> list[Row]:
    """Outer radius c of the smooth grown sphere over B and over C, Eqs. (9) to (11); one row per law and growth."""
    growth = np.asarray(list(growth), dtype=np.float64)
    C_bar = outer_ratio(thickness, radius, A_over_C)
    rows: list[Row] = []
    for law in laws:
        c_bar = theory.deformed_radius(growth, C_bar, law, g_core=g_core, A_bar=A_over_C * C_bar)
        rows += _rows_of_columns(
            law=law,
            thickness_mm=thickness,
            outer_radius_mm=radius,
            growth=growth,
            c_over_B=c_bar,
            c_over_C=c_bar / C_bar,
        )
    return rows


def stress_rows(
    growth: float = 2.0,
    thicknesses: Iterable[float] = (1.0, 2.0, 3.0),
    radius: float = 50.0,
    laws: Sequence[str] = ("isotropic",),
    *,
    mu_ratio: float = 1.0,
    points: int = 11,
    g_core: float = 1.0,
    A_over_C: float = 0.5,
    layers: Sequence[str] = ("core", "cortex"),
) -> list[Row]:
    """Cauchy stress along a radius, tension positive; ``points`` rows per law, thickness and layer.

    ``position`` goes from 0 at the inner to 1 at the outer side of the grown layer: (r - b)/(c - b) in the cortex.
    """
    rows: list[Row] = []
    for law, thickness, layer in product(laws, thicknesses, layers):
        A, B = A_over_C * radius, radius / outer_ratio(thickness, radius, A_over_C)
        stress = theory.stresses(growth, B, radius, law, mu_cortex=mu_ratio, n=points, part=layer, A=A, g_core=g_core)
        rows += _rows_of_columns(
            law=law,
            thickness_mm=thickness,
            outer_radius_mm=radius,
            growth=growth,
            mu_ratio=mu_ratio,
            layer=layer,
            R_mm=np.linspace(*((B, radius) if layer == "cortex" else (A, B)), points),
            r_mm=stress.r,
            position=(stress.r - stress.r[0]) / (stress.r[-1] - stress.r[0]),
            sigma_r_over_mu_core=stress.sigma_r,
            sigma_theta_over_mu_core=stress.sigma_theta,
            sigma_theta_over_mu_cortex=stress.sigma_theta / mu_ratio,
        )
    return rows


def critical_rows(
    C_bar: Iterable[float],
    laws: Sequence[str] = ("isotropic", "tangential"),
    *,
    g_core: float = 1.0,
    A_over_C: float = 0.5,
) -> list[Row]:
    """Growth at which the outer surface can crease, Eqs. (12) and (13), and at which it is unstable after Biot."""
    C_bar = np.asarray(list(C_bar), dtype=np.float64)
    if g_core != 1 and not 0 <= A_over_C * C_bar.max() <= 1:
        raise ImpossibleBody(
            f"the fixed hole, A/C = {A_over_C:g}, must lie inside the interface: C/B = {C_bar.max():g}."
        )
    hole_over_B = A_over_C * C_bar if g_core != 1 else None  # it matters only if the core grows
    rows: list[Row] = []
    for law in laws:
        g_crease = theory.critical_growth(C_bar, law, g_core=g_core, A_bar=hole_over_B)
        g_biot = theory.critical_growth(C_bar, law, ratio=theory.BIOT, g_core=g_core, A_bar=hole_over_B)
        reasons = [_reason_out_of_reach(law, *growths) for growths in zip(g_crease, g_biot)]
        rows += _rows_of_columns(
            law=law, C_over_B=C_bar, T_over_C=1 - 1 / C_bar, g_crease=g_crease, g_biot=g_biot, reason=reasons
        )
    return rows


def _rows_of_columns(**columns: Any) -> list[Row]:
    """One row per entry of the columns; a single value is repeated in every row."""
    column_values = np.broadcast_arrays(*(np.asarray(column, dtype=object) for column in columns.values()))
    return [dict(zip(columns, row)) for row in zip(*column_values)]


def bifurcation_cases(
    thicknesses: Iterable[float] = (1.0, 2.0, 3.0),
    radius: float = 50.0,
    mu_ratios: Iterable[float] = (1.0, 2.0, 4.0),
    laws: Sequence[str] = ("isotropic", "tangential"),
    *,
    kappa_ratio: float = np.inf,
    A_over_C: float = 0.5,
    progress: Any = None,
) -> list[Case]:
    """Wrinkles and creases by law, shear modulus ratio and thickness; calls ``progress(share, text)`` after each."""
    case_keys = list(product(laws, mu_ratios, thicknesses))
    for _, _, thickness in case_keys:
        outer_ratio(thickness, radius, A_over_C)  # refuses wrong values before the first long computation
    cases = []
    for law, mu_ratio, thickness in case_keys:
        bifurcation = theory.bifurcation(thickness / radius, mu_ratio, law, kappa_ratio, A_over_C=A_over_C, g_max=G_MAX)
        cases.append(Case(thickness, radius, mu_ratio, law, kappa_ratio, A_over_C, bifurcation))
        if progress is not None:
            progress(len(cases) / len(case_keys), f"{law}, mu ratio {mu_ratio:g}, T = {thickness:g} mm")
    return cases


def body_row(scene: Scene, look: Look = lambda g, eigenvalue: None) -> Row:
    """Critical growth of a scene's meshed body, and that of the theory if the body is a sphere or a part of one.

    The scene's effects are left out of both. ``seconds`` is the time for the body alone; ``look`` is called with growth
    and lowest eigenvalue of each state on the path, see :func:`morphofold.sim.equilibrium.statics.bifurcation_of_body`.
    """
    from morphofold.sim.build import build_bilayer
    from morphofold.sim.equilibrium.statics import bifurcation_of_scene

    bilayer, thickness, material = build_bilayer(scene), scene.geometry.cortex_thickness, scene.material
    g_theory, degree, reason = _theory_of_scene(scene)
    start_time = time.perf_counter()
    body_bifurcation = bifurcation_of_scene(scene, look=look)
    reasons = [reason] if reason else []
    if np.isnan(body_bifurcation.g_crit):
        reasons.append(f"this body is stable up to g = {body_bifurcation.history[:, 0].max():g}")
    if body_bifurcation.rounded:
        reasons.append("this uneven body bends into folds without a bifurcation: g_crit is approximate")
    return {
        "scene": scene.name,
        "shape": scene.geometry.shape,
        "portion": getattr(scene.geometry, "portion", None),
        "law": scene.growth.law,
        "thickness_mm": thickness,
        "mu_ratio": material.mu_ratio,
        "kappa_ratio": material.kappa_ratio,
        "left_out": tuple(scene.effects),
        "elements": bilayer.mesh.nelements,
        "edge_over_T": bilayer.edge / thickness,
        "g_crit": body_bifurcation.g_crit,
        "rounded": body_bifurcation.rounded,
        "degree": body_bifurcation.degree,
        "wavelength_mm": body_bifurcation.wavelength,
        "wavelength_over_T": body_bifurcation.wavelength / thickness,
        "g_theory": g_theory,
        "degree_theory": _whole_degree(degree),
        "difference_percent": 100 * (body_bifurcation.g_crit / g_theory - 1),
        "seconds": time.perf_counter() - start_time,
        "reason": "; ".join(reasons) or None,
    }


def _theory_of_scene(scene: Scene) -> tuple[float, float, str]:
    """g_crit and degree of a scene's sphere, or NaN and the reason; an octant has only harmonics of even degree."""
    geometry, material = scene.geometry, scene.material
    if reason := scene.without(*scene.effects).beyond_theory:
        return np.nan, np.nan, reason
    assert isinstance(geometry, Sphere)  # a radial scene has no body
    arguments = (geometry.cortex_thickness / geometry.radius, material.mu_ratio, scene.growth.law, material.kappa_ratio)
    try:
        onset = theory.bifurcation(*arguments, A_over_C=geometry.hole_radius / geometry.radius, g_max=G_MAX)
    except ValueError as error:
        return np.nan, np.nan, f"no theory: {error}"
    if geometry.portion != "octant" or not np.isfinite(onset.mode):
        return onset.g_crit, onset.mode, onset.reason and f"in theory {onset.reason}"
    degrees, growths = (curve_values[onset.curve.degree % 2 == 0] for curve_values in onset.curve)
    lowest_index = int(np.nanargmin(growths))
    return float(growths[lowest_index]), float(degrees[lowest_index]), ""


def outer_ratio(thickness: float, radius: float, A_over_C: float = 0.0) -> float:
    """C/B for cortical thickness T = C - B; ``ValueError`` unless 0 < T < C and the hole is inside the interface."""
    if not (np.isfinite(radius) and 0 < thickness < radius):
        raise OutOfRange(f"thickness must lie between 0 and the outer radius {radius:g} mm, got {thickness:g} mm.")
    if not 0 <= A_over_C < 1 - thickness / radius:
        raise ImpossibleBody(
            f"the fixed hole must lie inside the interface B = {radius - thickness:g} mm: its radius is {A_over_C:g} C "
            f"= {A_over_C * radius:g} mm. Give a thinner cortex or a smaller hole."
        )
    return radius / (radius - thickness)


def _reason_out_of_reach(law: str, crease_growth: float, biot_growth: float) -> str | None:
    reasons = []
    if np.isnan(crease_growth):
        reasons.append(f"no crease for {law} growth from C/B = {theory.thickest_creasing(law):.3f}")
    if np.isnan(biot_growth):
        reasons.append(f"Biot's stretch is not reached from C/B = {theory.thickest_creasing(law, theory.BIOT):.3f}")
    return "; ".join(reasons) or None
