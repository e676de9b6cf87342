"""A scene in one dimension: radial equilibria by finite elements, written as a simulation folder like any other.

The body stays a sphere, whether it is stable or not. Nothing of the solver in three dimensions is imported. A stage
takes some hundredths of a second, its measures take longer.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np

from morphofold.progress import Progress
from morphofold.shapes import icosphere
from morphofold.sim.effects import build_effects
from morphofold.sim.growth import volume as det_G
from morphofold.sim.output.folder import FolderWriter
from morphofold.sim.scene import Radial, Scene
from morphofold.sim.sphere_theory.finite_elements import LAYERS, RadialState, radial_equilibrium
from morphofold.surface import Surface

ICOSPHERE_LEVEL = 4  # level of the written icosphere: 2,562 vertices
PROFILE_POINTS = 41  # points of the written profile in each layer
ENERGY_GAUSS_POINTS = 64  # Gauss points in each layer for the energy


class RadialRun:
    """One run of a scene whose shape is radial."""

    def __init__(self, scene: Scene, writer: FolderWriter, progress: Progress, interrupted: Callable[[], bool]):
        self._scene, self._writer, self._progress, self._interrupted = scene, writer, progress, interrupted
        self._geometry = geometry = cast(Radial, scene.geometry)
        self._A = geometry.hole_radius / geometry.radius  # radii over the outer radius, as in the paper
        self._B = 1 - geometry.cortex_thickness / geometry.radius
        self._effects = build_effects(scene)
        self._share = sum(getattr(effect, "share", 0.0) for effect in self._effects)  # of core growth, if any

    def go(self) -> None:
        started, growth = time.perf_counter(), 1.0
        self._writer.begin()
        stages: list[dict[str, Any]] = []
        log: list[dict[str, Any]] = []
        solving = 0.0
        with self._writer.telling_a_full_disk(lambda: growth):
            for growth in self._scene.stages:
                before = time.perf_counter()
                state = self.equilibrium(growth)
                numbers = {"growth": growth, "step": 0, **self.numbers(state, growth)}
                solving += time.perf_counter() - before
                kept = self._writer.health_of(growth)  # of a stage written before a stop
                if kept is None:
                    self._write_stage(growth, state, numbers)
                else:
                    numbers = kept
                stages.append(numbers)
                log.append(
                    {
                        **numbers,
                        "elapsed": round(time.perf_counter() - started, 3),
                        "effects": {effect.name: {} for effect in self._effects},
                    }
                )
                self._writer.log(log)
                self._progress(
                    0.99 * len(stages) / len(self._scene.stages), f"g {growth:.3f}, min J {numbers['min_J']:.2f}"
                )
                if self._interrupted():
                    raise KeyboardInterrupt
            self._writer.health(
                stages,
                [],
                quadrature_points=len(state.R),
                steps=0,
                seconds=round(time.perf_counter() - started, 2),
                seconds_by_phase={"radial": round(solving, 3)},
            )
        self._progress(1.0, "done")

    def equilibrium(self, g: float) -> RadialState:
        """Equilibrium of the sphere at growth ``g`` of its cortex, lengths in units of its outer radius."""
        geometry, material = self._geometry, self._scene.material
        return radial_equilibrium(
            g,
            geometry.cortex_thickness / geometry.radius,
            material.mu_ratio,
            self._scene.growth.law,
            material.kappa_ratio,
            A_over_C=self._A,
            g_core=self._core(g),
        )

    def _core(self, g: float) -> float:
        return 1 + (g - 1) * self._share

    def numbers(self, state: RadialState, g: float) -> dict[str, Any]:
        """Health numbers of a stage, for a sphere: in mm and in units of the core's shear modulus."""
        radius = self._geometry.radius
        white, pial = self._radii(state)
        grown = 1 - self._B**3
        grown *= det_G(g, self._scene.growth.law) * radius**3
        return {
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
        white, pial = self._geometry.radius * state.at([self._B, 1.0], "cortex").r
        return float(white), float(pial)

    def _energy(self, state: RadialState, g: float) -> float:
        """Elastic energy [mu of the core mm^3]: the integral of det G W of ``material.energy`` over the layers."""
        nodes, weights = np.polynomial.legendre.leggauss(ENERGY_GAUSS_POINTS)
        material, isotropic, total = self._scene.material, self._scene.growth.law == "isotropic", 0.0
        for layer, mu in zip(LAYERS, (1.0, material.mu_ratio)):
            low, high = self._ends(layer)
            at = state.at(low + (high - low) * (nodes + 1) / 2, layer)
            tangential = g if layer == "cortex" else self._core(g)
            grown = tangential**3 if isotropic or layer == "core" else tangential**2
            beta = at.r / (at.R * tangential)
            invariant = at.J ** (-2 / 3) * ((at.J / beta**2) ** 2 + 2 * beta**2)
            W = 0.5 * mu * (invariant - 3) + 0.5 * material.kappa_ratio * mu * (at.J - 1) ** 2
            total += 0.5 * (high - low) * float(np.sum(weights * grown * W * 4 * np.pi * at.R**2))
        return total * self._geometry.radius**3

    def _ends(self, layer: str) -> tuple[float, float]:
        """Inner and outer radius of a layer over that of the sphere."""
        return (self._A, self._B) if layer == "core" else (self._B, 1.0)

    def _write_stage(self, g: float, state: RadialState, numbers: dict[str, Any]) -> None:
        verts, faces = icosphere(ICOSPHERE_LEVEL)
        white, pial = (
            Surface(r * verts, faces, name=f"lh.{name}") for r, name in zip(self._radii(state), ("white", "pial"))
        )
        self._writer.stage(
            g,
            white,
            pial,
            portion=1.0,
            reference_radius=self._geometry.radius,
            numbers=numbers,
            warnings=[],
            beside=lambda folder: self._write_profile(folder / "profile.tsv", state),
        )

    def _write_profile(self, path: Path, state: RadialState) -> None:
        """Radii [mm], Cauchy stresses [shear modulus of the core, tension positive] and J along the radius."""
        C = self._geometry.radius
        lines = ["layer\tR_mm\tr_mm\tsigma_r\tsigma_theta\tJ"]
        for layer in LAYERS:
            at = state.at(np.linspace(*self._ends(layer), PROFILE_POINTS), layer)
            lines += [
                f"{layer}\t{C * R:.9g}\t{C * r:.9g}\t{s:.9g}\t{t:.9g}\t{J:.9g}"
                for R, r, s, t, J in zip(at.R, at.r, at.sigma_r, at.sigma_theta, at.J)
            ]
        path.write_text("\n".join(lines) + "\n")
