"""A scene in one dimension: radial equilibria by finite elements, written as a simulation folder like any other.

The body stays a sphere, whether it is stable or not. Nothing of the solver in three dimensions is imported. A stage
takes some hundredths of a second, its measures take longer.
"""

from pathlib import Path
from typing import cast

import numpy as np

from morphofold.provenance import Row
from morphofold.shapes import icosphere
from morphofold.sim.growth import volume as det_G
from morphofold.sim.output.folder import Run
from morphofold.sim.scene import Radial
from morphofold.sim.sphere_theory.finite_elements import LAYERS, RadialState, radial_equilibrium
from morphofold.surface import Surface
from morphofold.timing import working_seconds

ICOSPHERE_LEVEL = 4  # level of the written icosphere: 2,562 vertices
PROFILE_POINTS = 41  # points of the written profile in each layer
ENERGY_GAUSS_POINTS = 64  # Gauss points in each layer for the energy


class RadialRun(Run):
    """One run of a scene whose shape is radial."""

    state: RadialState

    def build(self) -> None:
        geometry = cast(Radial, self.scene.geometry)
        self._radius, self._T_over_C = geometry.radius, geometry.cortex_thickness / geometry.radius
        A, B = geometry.hole_radius / geometry.radius, 1 - self._T_over_C
        self._ends = dict(zip(LAYERS, ((A, B), (B, 1.0))))  # radii of the layers over the outer radius, as in the paper
        self._core_share = sum(getattr(effect, "share", 0.0) for effect in self.effects)  # of the growth, if any
        self._solving = 0.0

    def grow_to(self, g: float) -> None:
        before = working_seconds()
        self.growth, self.state = g, self.equilibrium(g)
        self._numbers = self.numbers(self.state, g)
        self._solving += working_seconds() - before

    def after_stage(self, numbers: Row) -> None:
        effects: Row = {effect.name: {} for effect in self.effects}
        self.log.append({**numbers, "elapsed": round(self.elapsed, 3), "effects": effects})
        self.writer.log(self.log)
        share = len(self.log) / len(self.scene.stages)
        self.progress(0.99 * share, f"g {self.growth:.3f}, min J {numbers['min_J']:.2f}")
        if self.interrupted():
            raise KeyboardInterrupt

    def cost(self) -> Row:
        return {
            "quadrature_points": len(self.state.R),
            "steps": 0,
            "seconds": round(self.elapsed, 2),
            "seconds_by_phase": {"radial": round(self._solving, 3)},
        }

    def equilibrium(self, g: float) -> RadialState:
        """Equilibrium of the sphere at growth ``g`` of its cortex, lengths in units of its outer radius."""
        material = self.scene.material
        return radial_equilibrium(
            g,
            self._T_over_C,
            material.mu_ratio,
            self.scene.growth.law,
            material.kappa_ratio,
            A_over_C=self._ends["core"][0],
            g_core=self._core(g),
        )

    def _core(self, g: float) -> float:
        return 1 + (g - 1) * self._core_share

    def numbers(self, state: RadialState, g: float) -> Row:
        """Health numbers of a stage, for a sphere: in mm and in units of the core's shear modulus."""
        white, pial = self._radii(state)
        grown = 1 - self._ends["cortex"][0] ** 3
        grown *= det_G(g, self.scene.growth.law) * self._radius**3
        return {
            "growth": g,
            "step": 0,
            "strain_energy": self._energy(state, g),
            "kinetic_energy": 0.0,
            "kinetic_over_strain": 0.0,
            "min_J": float(state.J.min()),
            "lowest_J": float(state.J.min()),
            "overlap": 0.0,
            "winding_max": 1,
            "crossings": 0,
            "deepest_crossing": 0.0,
            "volume_drift": abs((pial**3 - white**3) / grown - 1),
            "mean_radius_mm": pial,
        }

    def _radii(self, state: RadialState) -> tuple[float, float]:
        """Deformed radii of the white and the pial surface [mm]."""
        white, pial = self._radius * state.at(self._ends["cortex"], "cortex").r
        return float(white), float(pial)

    def _energy(self, state: RadialState, g: float) -> float:
        """Elastic energy [mu of the core mm^3]: the integral of det G W of ``material.energy`` over the layers."""
        nodes, weights = np.polynomial.legendre.leggauss(ENERGY_GAUSS_POINTS)
        material, law, total = self.scene.material, self.scene.growth.law, 0.0
        for (layer, (low, high)), mu in zip(self._ends.items(), (1.0, material.mu_ratio)):
            points = state.at(low + (high - low) * (nodes + 1) / 2, layer)
            tangential, law_of_layer = (g, law) if layer == "cortex" else (self._core(g), "isotropic")
            beta = points.r / (points.R * tangential)
            invariant = points.J ** (-2 / 3) * ((points.J / beta**2) ** 2 + 2 * beta**2)
            W = 0.5 * mu * (invariant - 3) + 0.5 * material.kappa_ratio * mu * (points.J - 1) ** 2
            energy = weights * det_G(tangential, law_of_layer) * W * 4 * np.pi * points.R**2
            total += 0.5 * (high - low) * float(np.sum(energy))
        return total * self._radius**3

    def write_stage(self, g: float) -> Row:
        """Write the surfaces and the profile of the present state; returns its numbers for health.json."""
        verts, faces = icosphere(ICOSPHERE_LEVEL)
        white, pial = (
            Surface(r * verts, faces, name=f"lh.{name}") for r, name in zip(self._radii(self.state), ("white", "pial"))
        )
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
        C = self._radius
        lines = ["layer\tR_mm\tr_mm\tsigma_r\tsigma_theta\tJ"]
        for layer, ends in self._ends.items():
            points = self.state.at(np.linspace(*ends, PROFILE_POINTS), layer)
            lines += [
                f"{layer}\t{C * R:.9g}\t{C * r:.9g}\t{s:.9g}\t{t:.9g}\t{J:.9g}"
                for R, r, s, t, J in zip(points.R, points.r, points.sigma_r, points.sigma_theta, points.J)
            ]
        path.write_text("\n".join(lines) + "\n")
