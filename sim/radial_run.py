"""A scene in one dimension: smooth states of the growing sphere, written as a simulation folder like any other.

The body stays a sphere, whether it is stable or not. Nothing of the solver in three dimensions is imported. A stage
takes some hundredths of a second, its measures take longer.
"""

from pathlib import Path
from typing import cast

import numpy as np
from numpy.polynomial import Chebyshev

from morphofold.digests_and_json import Row
from morphofold.frozen_arrays import Array
from morphofold.shapes import icosphere
from morphofold.sim.growth_laws import volume as det_G
from morphofold.sim.output.simulation_folder import Run
from morphofold.sim.scene import Radial
from morphofold.sim.sphere_theory.smooth_sphere import SmoothSphere, smooth_state
from morphofold.surface import Surface
from morphofold.timing import working_seconds

ICOSPHERE_LEVEL = 4  # level of the written icosphere: 2,562 vertices
PROFILE_POINTS = 41  # points of the written profile in each layer
CHEBYSHEV_POINTS = 64  # of a state in each layer: they resolve a hole of 1 mm, and growth by 4


class RadialRun(Run):
    """One run of a scene whose shape is radial.

    Attributes
    ----------
    y : (2, CHEBYSHEV_POINTS) float64
        Coordinate of the points of core and cortex, as of ``smooth_sphere.State``.
    profile : dict of str to (2, CHEBYSHEV_POINTS) float64
        Columns of the profile there: deformed radii [mm], Cauchy stresses [shear modulus of the core], J.
    """

    y: Array
    profile: dict[str, Array]

    def build(self) -> None:
        geometry, material = cast(Radial, self.scene.geometry), self.scene.material
        T_over_C, A_over_C = geometry.cortex_thickness / geometry.radius, geometry.hole_radius / geometry.radius
        law = self.scene.growth.law
        self._sphere = SmoothSphere(T_over_C, material.mu_ratio, law, material.kappa_ratio, A_over_C)
        self._radius, self._seconds = geometry.radius, 0.0
        self._core_share = sum(getattr(effect, "share", 0.0) for effect in self.effects)  # of the growth, if any

    def grow_to(self, g: float) -> None:
        start_time, self.growth = working_seconds(), g
        sphere, g_core = self._sphere, 1 + (g - 1) * self._core_share
        self.y, state_fields = smooth_state(sphere, g, g_core, CHEBYSHEV_POINTS)
        self._det_G = det_G(g_core, "isotropic"), det_G(g, sphere.law)
        lambda_r, lambda_theta, pressure, _, r, _ = state_fields.swapaxes(0, 1)
        mu, J, I1 = sphere.mu[:, None], lambda_r * lambda_theta**2, lambda_r**2 + 2 * lambda_theta**2
        sigma_r, sigma_theta = (mu * J ** (-5 / 3) * (lam**2 - I1 / 3) + pressure for lam in (lambda_r, lambda_theta))
        self.profile = {"r_mm": self._radius * r, "sigma_r": sigma_r, "sigma_theta": sigma_theta, "J": J}
        energy = 0.5 * mu * (J ** (-2 / 3) * I1 - 3 + sphere.kappa_ratio * (J - 1) ** 2)  # per grown volume
        self._numbers = self._stage_numbers(4 * np.pi * self._radius**3 * energy * np.exp(3 * self.y))
        self._seconds += working_seconds() - start_time

    def after_stage(self, numbers: Row) -> None:
        effects: Row = {effect.name: {} for effect in self.effects}
        self.log.append({**numbers, "elapsed": round(self.elapsed, 3), "effects": effects})
        self.writer.log(self.log)
        done_share = len(self.log) / len(self.scene.stages)
        self.progress(0.99 * done_share, f"g {self.growth:.3f}, min J {numbers['min_J']:.2f}")
        if self.interrupted():
            raise KeyboardInterrupt

    def cost(self) -> Row:
        return {
            "quadrature_points": self.y.size,
            "steps": 0,
            "seconds": round(self.elapsed, 2),
            "seconds_by_phase": {"radial": round(self._seconds, 3)},
        }

    def _stage_numbers(self, energy_by_y: Array) -> Row:
        """Health numbers of a stage, for a sphere: in mm and in units of the core's shear modulus."""
        energies = (self._along(layer, energy_by_y).integ(lbnd=self.y[layer, 0])(self.y[layer, -1]) for layer in (0, 1))
        white_radius, pial_radius = self.profile["r_mm"][1, [0, -1]].tolist()
        least_J = float(self.profile["J"].min())
        free_volume = (1 - self._sphere.B**3) * self._det_G[1] * self._radius**3
        return {
            "growth": self.growth,
            "step": 0,
            "strain_energy": float(sum(energies)),
            "kinetic_energy": 0.0,
            "kinetic_over_strain": 0.0,
            "min_J": least_J,
            "lowest_J": least_J,
            "overlap": 0.0,
            "winding_max": 1,
            "crossings": 0,
            "deepest_crossing": 0.0,
            "volume_drift": abs((pial_radius**3 - white_radius**3) / free_volume - 1),
            "mean_radius_mm": pial_radius,
        }

    def _along(self, layer: int, values: Array) -> Chebyshev:
        """Values (2, CHEBYSHEV_POINTS) as a function of y in core (0) or cortex (1)."""
        return Chebyshev.fit(self.y[layer], values[layer], CHEBYSHEV_POINTS - 1)

    def write_stage(self, g: float) -> Row:
        """Write the surfaces and the profile of the present state; returns its numbers for health.json."""
        verts, faces = icosphere(ICOSPHERE_LEVEL)
        radii = self.profile["r_mm"][1, [0, -1]]
        white, pial = (Surface(r * verts, faces, name=f"lh.{name}") for r, name in zip(radii, ("white", "pial")))
        self.writer.stage(
            g,
            white,
            pial,
            portion=1.0,
            reference_radius=self._radius,
            numbers=self._numbers,
            warnings=[],
            add_files=lambda folder: self._write_profile(folder / "profile.tsv"),
        )
        return self._numbers

    def _write_profile(self, path: Path) -> None:
        """Radii [mm], Cauchy stresses [shear modulus of the core, tension positive] and J along the radius."""
        lines = ["\t".join(["layer", "R_mm", *self.profile])]
        A, B = self._sphere.A_over_C, self._sphere.B
        for layer, (layer_name, end_radii) in enumerate({"core": (A, B), "cortex": (B, 1.0)}.items()):
            R = np.linspace(*end_radii, PROFILE_POINTS)
            y = np.log(np.exp(3 * self.y[1, 0]) + self._det_G[layer] * (R**3 - B**3)) / 3
            columns = [self._radius * R, *(self._along(layer, column)(y) for column in self.profile.values())]
            lines += ["\t".join([layer_name, *(f"{value:.9g}" for value in row)]) for row in zip(*columns)]
        path.write_text("\n".join(lines) + "\n")
