"""Surfaces and maps packed for the page: back within their step, and thinned without a change of shape."""

import base64
import zlib

import numpy as np
import pytest
from made_measures import made_cortex, made_measures
from made_surfaces import area

from morphofold.report.pages import viewer_data
from morphofold.report.pages.page_entries import Entry
from morphofold.surface import Surface


def decode(data, n, itemsize, stride=1):
    """Inverse of ``viewer.encode``, as in the viewer."""
    dtype = np.dtype(f"<u{itemsize}")
    planes = np.frombuffer(data, dtype=np.uint8).reshape(itemsize, n)
    zigzag = np.ascontiguousarray(planes.T).view(dtype).ravel()
    step = (zigzag >> 1) ^ (np.zeros_like(zigzag) - (zigzag & 1))
    whole = np.zeros(-(-n // stride) * stride, dtype=dtype)
    whole[:n] = step
    return np.cumsum(whole.reshape(-1, stride), axis=0, dtype=dtype).ravel()[:n]


@pytest.mark.parametrize("dtype", [np.uint16, np.uint32])
@pytest.mark.parametrize("stride", [1, 3])
def test_encoding_is_undone_by_decoding_for_any_numbers(rng, dtype, stride):
    a = rng.integers(0, np.iinfo(dtype).max, 1000, dtype=dtype, endpoint=True)
    data = viewer_data.encode(a, stride)
    np.testing.assert_array_equal(decode(data, a.size, a.itemsize, stride), a)
    assert len(data) == a.nbytes


def unpack(packed):
    raw = zlib.decompress(base64.b64decode(packed.data))
    arrays = packed.meta["arrays"]
    return {
        name: decode(raw[a["at"] : a["at"] + a["n"] * a["bytes"]], a["n"], a["bytes"], a["stride"])
        for name, a in arrays.items()
    }


def packed_with(m, steps):
    return viewer_data.pack(viewer_data.thinned(Entry("a", "", "", "", m)), steps)


def test_a_packed_surface_and_its_maps_come_back_within_their_step():
    m = made_measures()
    packed = packed_with(m, {"H": 0.0, "sulcal_depth": 0.01})
    arrays, ids = unpack(packed), unpack(packed)["ids"].astype(int)
    box = packed.meta["surfaces"]["white"]
    verts = np.array(box["low"]) + arrays["white"].reshape(-1, 3) * box["edge"] / 65535
    assert np.abs(verts - m.cortex.white.verts[ids]).max() < box["edge"] / 65535
    for key, step in (("H", 0.4 / 65534), ("sulcal_depth", 0.01)):
        span = packed.meta["maps"][key]
        codes = arrays[f"map:{key}"]
        values = np.where(
            codes == viewer_data.NAN_CODE_16_BIT, np.nan, span["low"] + codes / 65534 * (span["high"] - span["low"])
        )
        np.testing.assert_allclose(values, m.maps[key][ids], atol=0.51 * step)
    np.testing.assert_array_equal(arrays["regions"] - 1.0, m.cortex.regions.labels[ids])
    assert packed.meta["regions"] == ["no region", "front", "middle", "back"]


def test_packing_keeps_every_triangle_and_its_sense():
    m = made_measures()
    packed = packed_with(m, {})
    arrays = unpack(packed)
    faces = arrays["ids"][arrays["faces"].reshape(-1, 3)].astype(int)
    rotated = lambda f: sorted(tuple(np.roll(row, -row.argmin())) for row in f)
    assert rotated(faces) == rotated(m.cortex.faces)


def test_a_large_surface_is_thinned_to_a_closed_one_of_the_same_area():
    cortex = made_cortex(level=5)
    display = viewer_data.thin(cortex, 2500)
    assert display.thinned
    assert 2300 < len(display.ids) < 2600
    assert len(np.unique(display.ids)) == len(display.ids)
    for surface in (cortex.pial, cortex.white):
        thinned = Surface(surface.verts[display.ids], display.faces)
        assert area(thinned) == pytest.approx(area(surface), rel=0.01)
    edges = np.sort(
        np.concatenate([display.faces[:, [0, 1]], display.faces[:, [1, 2]], display.faces[:, [2, 0]]]), axis=1
    )
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert not viewer_data.thin(cortex, 10_242).thinned


def test_no_vertex_is_chosen_twice_while_another_is_free():
    near = np.array([[0, 1, 2], [0, 2, 1], [0, 1, 3]])
    np.testing.assert_array_equal(viewer_data.distinct(near), [0, 2, 1])
    np.testing.assert_array_equal(viewer_data.distinct(np.array([[5], [5]])), [5, 5])
