"""CIFTI-2: maps and regions of both hemispheres in one file, as Connectome Workbench has them, through nibabel."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphofold.errors import WrongFile
from morphofold.frozen_arrays import Array, Bools
from morphofold.io.files import atomic_file, name_in_file
from morphofold.io.gifti import regions_of_keys
from morphofold.surface import PerVertex, Regions

_STRUCTURES = {"lh": "CIFTI_STRUCTURE_CORTEX_LEFT", "rh": "CIFTI_STRUCTURE_CORTEX_RIGHT"}
_SIDES = {"lh": "L", "rh": "R"}
_INTENTS = {"dscalar": (3006, "ConnDenseScalar"), "pscalar": (3008, "ConnParcelScalr")}


def read_map(raw: bytes, path: Path, hemi: str = "lh") -> PerVertex:
    """Values (N,) of a hemisphere in a dense file with a single map (``.dscalar.nii``), NaN where it has none."""
    return _values_and_labels(raw, hemi)[0]


def read_regions(raw: bytes, path: Path, hemi: str = "lh") -> Regions:
    """The regions of a hemisphere in a file of labels (``.dlabel.nii``); key 0 means no region."""
    values, labels = _values_and_labels(raw, hemi)
    return regions_of_keys(np.nan_to_num(values).astype(np.int64), labels, name_in_file(path))


def read_mask(raw: bytes, path: Path, hemi: str = "lh") -> Bools:
    """Mask (N,): where the map of a hemisphere is positive."""
    return np.nan_to_num(_values_and_labels(raw, hemi)[0]) > 0


def _values_and_labels(raw: bytes, hemi: str) -> tuple[PerVertex, dict[int, tuple[str, Sequence[float]]]]:
    from nibabel.cifti2 import BrainModelAxis, Cifti2Image

    image = Cifti2Image.from_bytes(raw)
    rows, columns = (image.header.get_axis(k) for k in (0, 1))
    if not isinstance(columns, BrainModelAxis) or len(rows) != 1:
        raise WrongFile("it is not one map of gray matter; pass a .dscalar.nii or .dlabel.nii with a single map")
    for structure, part, model in columns.iter_structures():
        if structure == _STRUCTURES[hemi]:
            values = np.full(model.nvertices[structure], np.nan)
            values[model.vertex] = np.asarray(image.get_fdata())[0, part]
            return values, dict(getattr(rows, "label", [{}])[0])
    raise WrongFile(f"it has no {_STRUCTURES[hemi]}; pass a file of this hemisphere")


def write_dscalar(path: Path, maps: Mapping[str, Mapping[str, Array]], is_cortex: Mapping[str, Bools]) -> None:
    """Write maps, by name and hemisphere (N,), at the vertices of the cortex of each hemisphere (N,) bool.

    A hemisphere that a map lacks is NaN there. Written completely or not at all, in float32.
    """
    from nibabel import cifti2

    hemis = [hemi for hemi in _STRUCTURES if hemi in is_cortex]
    models = [cifti2.BrainModelAxis.from_mask(is_cortex[hemi], _STRUCTURES[hemi]) for hemi in hemis]
    missing = {hemi: np.full(len(is_cortex[hemi]), np.nan) for hemi in hemis}
    rows = [
        np.concatenate([np.asarray(values.get(hemi, missing[hemi]))[is_cortex[hemi]] for hemi in hemis])
        for values in maps.values()
    ]
    _write(path, "dscalar", rows, (cifti2.ScalarAxis(list(maps)), sum(models[1:], start=models[0])))


def write_pscalar(
    path: Path, regions: Mapping[str, Regions], columns: Sequence[str], rows: Sequence[Mapping[str, Any]]
) -> None:
    """Write columns of a table of regions, whose rows name hemisphere and region; None becomes NaN."""
    from nibabel import cifti2

    models = []
    for row in rows:
        hemi, of_hemi = row["hemi"], regions[row["hemi"]]
        vertices = np.flatnonzero(of_hemi.labels == of_hemi.names.index(row["region"]))
        model = cifti2.BrainModelAxis.from_surface(vertices, len(of_hemi.labels), _STRUCTURES[hemi])
        models.append((f"{_SIDES[hemi]}_{row['region']}", model))
    values = [[np.nan if row[column] is None else row[column] for row in rows] for column in columns]
    _write(path, "pscalar", values, (cifti2.ScalarAxis(list(columns)), cifti2.ParcelsAxis.from_brain_models(models)))


def _write(path: Path, kind: str, rows: Sequence[Any], axes: tuple[Any, Any]) -> None:
    from nibabel.cifti2 import Cifti2Image

    image = Cifti2Image(np.array(rows, dtype=np.float32), header=axes)
    image.nifti_header.set_intent(_INTENTS[kind][0], name=_INTENTS[kind][1])
    with atomic_file(path) as temporary:
        temporary.write_bytes(image.to_bytes())
