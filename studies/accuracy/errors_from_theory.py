"""Error against time of the solver for the smooth body and for the onset of folding: compared with theory."""

from functools import cache, partial

import numpy as np

from morphofold.frozen_arrays import Array
from morphofold.sim import theory
from morphofold.sim.body import Body
from morphofold.sim.equilibrium.tangent import cauchy_stress, points
from morphofold.sim.sphere_theory import smooth_sphere as smooth
from morphofold.studies.accuracy.error_points import Point, Timing, timed
from morphofold.studies.accuracy.radial_finite_elements import RadialState, radial_equilibrium
from morphofold.studies.accuracy.radial_modes import critical_growth_of_degree
from morphofold.studies.accuracy.solver_settings import STUDY_BODY, Setting
from morphofold.studies.folds.fold_measures import sphere
from morphofold.studies.onset import onset
from morphofold.timing import working_seconds

SMOOTH_GROWTH = 1.15  # growth at which the smooth body is compared with theory: it wrinkles from 1.24 on
START_GROWTH = 1.1  # growth at which the search for the onset starts
MOST_REPEATS, LONG_ENOUGH = 3, 10.0  # the smooth body is grown at most so often; not again after so many seconds
THEORY, INCOMPRESSIBLE = "theory", "incompressible theory"


def smooth_points(setting: Setting) -> list[Point]:
    """Radius and hoop stress of the smooth body at g = 1.15, grown by the dynamics, against theory.

    The body comes to rest at the end, as at a stage of a scene. Theory is the radial equilibrium of the same
    kappa/mu; the radius is also compared with the incompressible one (Razavi et al. 2015, Eq. 11).
    """
    run_seconds: list[float] = []
    while len(run_seconds) < MOST_REPEATS and sum(run_seconds) < LONG_ENOUGH:
        dynamics = setting.dynamics(with_folds=False)
        began_at = working_seconds()
        dynamics.grow_to(SMOOTH_GROWTH)
        dynamics.settle()
        run_seconds.append(working_seconds() - began_at)
    body, x, n_elements = dynamics.body, dynamics.state.x, dynamics.body.elements.n
    theory_state = theory_of(setting.kappa_ratio)
    errors = [
        ("radius", radius_error(body, x, theory_state), THEORY),
        ("hoop stress", stress_error(body, x, theory_state), THEORY),
        ("radius", radius_error(body, x, theory_of(np.inf)), INCOMPRESSIBLE),
    ]
    return [setting.point(name, error, against, n_elements, Timing.of(run_seconds)) for name, error, against in errors]


@cache
def theory_of(kappa_ratio: float) -> RadialState:
    """The smooth body at g = 1.15 by theory, lengths over C; for ``inf`` the radius is that of Eq. (11)."""
    T_over_C, mu_ratio, law, A_over_C = _sphere()
    return radial_equilibrium(SMOOTH_GROWTH, T_over_C, mu_ratio, law, kappa_ratio, A_over_C=A_over_C)


def _sphere() -> tuple[float, float, str, float]:
    """T/C, ratio of moduli, growth law and A/C of the body of the study."""
    scene = Setting("", "", 0.0).scene()
    geometry = sphere(scene)
    T_over_C, A_over_C = geometry.cortex_thickness / geometry.radius, geometry.hole_radius / geometry.radius
    return T_over_C, scene.material.mu_ratio, scene.growth.law, A_over_C


def radius_error(body: Body, x: Array, exact_state: RadialState) -> float:
    """Rms over the pial nodes of the error of their radius, over their displacement by theory."""
    C = float(np.linalg.norm(body.X[: body.n_surface], axis=1).max())
    r = C * float(exact_state.at(1.0, "cortex").r[0])
    return float(np.sqrt(np.mean((np.linalg.norm(x[: body.n_surface], axis=1) - r) ** 2))) / (r - C)


def stress_error(body: Body, x: Array, exact_state: RadialState) -> float:
    """Rms error of the hoop stress of the elements of the cortex, over the rms of the exact one.

    The hoop stress is the mean of the two tangential Cauchy stresses, averaged over an element (for tetrahedra: over
    a patch of six), and compared with theory at the mean of its nodes.
    """
    nodes = np.concatenate([node_group.nodes for node_group in points(body)])
    is_cortex = body.bilayer.share[nodes].mean(axis=1) > 0  # nodes of the core have no share of the cortex
    centres, stress = body.X[nodes[is_cortex]].mean(axis=1), cauchy_stress(body, x)[is_cortex]
    R = np.linalg.norm(centres, axis=1)
    normal = centres / R[:, None]
    hoop_stress = 0.5 * (np.trace(stress, axis1=1, axis2=2) - np.einsum("ei,eij,ej->e", normal, stress, normal))
    C = np.linalg.norm(body.X[: body.n_surface], axis=1).max()
    exact_hoop = exact_state.at(R / C, "cortex").sigma_theta
    return float(np.sqrt(np.sum((hoop_stress - exact_hoop) ** 2) / np.sum(exact_hoop**2)))


def onset_points(setting: Setting) -> list[Point]:
    """Growth at which folding starts in the dynamics (:func:`~morphofold.studies.onset.onset`), against theory."""
    scene, bilayer = setting.scene(), setting.bilayer()
    T_over_C, mu_ratio, law, A_over_C = _sphere()
    began_at = working_seconds()
    onset_g = onset(scene, start=START_GROWTH, bilayer=bilayer).g
    timing, n_elements = Timing.of([working_seconds() - began_at]), bilayer.mesh.nelements
    kappa_by_name = {THEORY: setting.kappa_ratio, INCOMPRESSIBLE: np.inf}
    onsets = {
        against: theory.bifurcation(T_over_C, mu_ratio, law, kappa_ratio, A_over_C=A_over_C).g_crit
        for against, kappa_ratio in kappa_by_name.items()
    }
    return [
        setting.point("onset", abs(onset_g - g) / (g - 1), against, n_elements, timing) for against, g in onsets.items()
    ]


def theory_points() -> list[Point]:
    """The time that theory takes for the same two numbers, and the difference between its two methods."""
    T_over_C, mu_ratio, law, A_over_C = _sphere()
    kappa = Setting("", "", 0.0).kappa_ratio
    exact_body = smooth.SmoothSphere(T_over_C, mu_ratio, law, kappa, A_over_C)

    def radius() -> float:
        smooth.smooth_state.cache_clear()
        return float(smooth.smooth_state(exact_body, SMOOTH_GROWTH).fields[1, smooth.RADIUS].max())

    def begins() -> theory.Bifurcation:
        smooth.smooth_state.cache_clear()
        return theory.bifurcation(T_over_C, mu_ratio, law, kappa, A_over_C=A_over_C)

    element_r = float(theory_of(kappa).at(1.0, "cortex").r[0])
    wrinkling = begins()
    element_g = critical_growth_of_degree(int(wrinkling.mode), T_over_C, mu_ratio, law, kappa, A_over_C=A_over_C)
    errors = {"radius": abs(radius() / element_r - 1), "onset": abs(wrinkling.g_crit - element_g) / (element_g - 1)}
    make_point = partial(
        Point, "solver", STUDY_BODY, against=THEORY, axis="mesh", setting="the exact body", value=0.0, size=0
    )
    return [
        make_point(quantity=quantity, error=errors[quantity], **timed(compute)[1]._asdict(), method="the theory")
        for quantity, compute in (("radius", radius), ("onset", begins))
    ]
