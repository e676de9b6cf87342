"""Permutations on the workers of a fleet."""

import numpy as np
import pytest
from made_cohort import HereFleet

from morphofold.cohort.fleet import Lost, open_fleet
from morphofold.cohort.permuting import on_workers
from morphofold.geometry import vertex_areas
from morphofold.inference.clusters import Mesh
from morphofold.inference.permutations import infer
from morphofold.shapes import icosphere

VERTS, FACES = icosphere(2, radius=50.0)
MESH = Mesh(FACES, vertex_areas(VERTS, FACES))
SUBJECTS = 12


def inferred(**options):
    random = np.random.default_rng(0)
    maps = random.standard_normal((SUBJECTS, len(VERTS)))
    maps[0, :5] = np.nan
    design = np.column_stack([np.ones(SUBJECTS), random.standard_normal(SUBJECTS)])
    return infer(maps, design, np.array([0.0, 1.0]), MESH, permutations=150, seed=2, **options)


@pytest.mark.parametrize("workers", [0, 2])
def test_the_bytes_are_those_of_one_machine(tmp_path, workers):
    if workers:
        with open_fleet(workers=workers) as fleet:
            found = inferred(largest=on_workers(fleet, tmp_path))
    else:
        found = inferred(largest=on_workers(HereFleet(), tmp_path))
    own = inferred()
    for name in ("null_height", "null_area", "null_tfce", "p_tfce", "p_height"):
        np.testing.assert_array_equal(getattr(found, name), getattr(own, name))
    assert not any(tmp_path.iterdir())  # the data are removed


def test_lost_workers_end_the_work(tmp_path):
    class Dying(HereFleet):
        def run(self, work, jobs):
            for job in jobs:
                yield job, Lost("its workers died")

    with pytest.raises(RuntimeError):
        inferred(largest=on_workers(Dying(), tmp_path))
    assert not any(tmp_path.iterdir())
