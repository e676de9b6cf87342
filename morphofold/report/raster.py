"""A small software renderer: smooth-shaded triangles through a z-buffer, no graphics library needed.

Slower than a graphics card and good enough. One thread and one order of triangles, so the same picture, bit
for bit, on every run.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def rasterise(xyz, faces, width, height):
    """The nearest triangle behind each pixel.

    Parameters
    ----------
    xyz : (N, 3) float64
        Pixel column, pixel row (0 at the top) and height towards the viewer of each vertex.
    faces : (M, 3) int64
    width, height : int

    Returns
    -------
    face : (height, width) int64
        Index of the face seen, -1 where there is none.
    b0, b1 : (height, width) float64
        Barycentric weights of the face's first two corners there.
    """
    face = np.full((height, width), -1, dtype=np.int64)
    depth = np.full((height, width), -np.inf)
    b0, b1 = np.zeros((height, width)), np.zeros((height, width))
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        bx, by, bz = xyz[j, 0], xyz[j, 1], xyz[j, 2]
        cx, cy, cz = xyz[k, 0], xyz[k, 1], xyz[k, 2]
        twice = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if twice == 0.0:
            continue
        first_x = max(math.ceil(min(ax, bx, cx) - 0.5), 0)
        last_x = min(math.floor(max(ax, bx, cx) - 0.5), width - 1)
        first_y = max(math.ceil(min(ay, by, cy) - 0.5), 0)
        last_y = min(math.floor(max(ay, by, cy) - 0.5), height - 1)
        for y in range(first_y, last_y + 1):
            for x in range(first_x, last_x + 1):
                px, py = x + 0.5, y + 0.5
                u = ((bx - px) * (cy - py) - (by - py) * (cx - px)) / twice
                v = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) / twice
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < -1e-12:
                    continue
                z = u * az + v * bz + w * cz
                if z > depth[y, x]:
                    depth[y, x] = z
                    face[y, x] = f
                    b0[y, x] = u
                    b1[y, x] = v
    return face, b0, b1


def render(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    faces: NDArray[np.int64],
    colours: NDArray[np.uint8],
    size: tuple[int, int],
    half_height: float,
    oversample: int = 2,
) -> NDArray[np.uint8]:
    """Picture (height, width, 3) of a surface seen from +z, x to the right, y up, no perspective, on white.

    Parameters
    ----------
    points, normals : (N, 3)
        Already turned into the camera's axes and centred [mm]; unit normals.
    faces : (M, 3)
    colours : (N, 3) uint8
    size : (width, height) in pixels
    half_height : float
        Half the height of the picture [mm].
    oversample : int
        The picture is drawn this many times larger each way and averaged down.
    """
    width, height = size[0] * oversample, size[1] * oversample
    per_mm = height / (2 * half_height)
    xyz = np.stack([width / 2 + per_mm * points[:, 0], height / 2 - per_mm * points[:, 1], points[:, 2]], axis=1)
    face, b0, b1 = rasterise(xyz, np.ascontiguousarray(faces), width, height)
    image = np.ones((height, width, 3))
    seen = face >= 0
    corners = faces[face[seen]]
    weight = np.stack([b0[seen], b1[seen], 1 - b0[seen] - b1[seen]], axis=1)[:, :, None]
    normal = (normals[corners] * weight).sum(axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    normal *= np.where(normal[:, 2:] < 0, -1.0, 1.0)  # open surfaces show their inside
    image[seen] = shade((colours[corners] / 255.0 * weight).sum(axis=1), normal)
    image = image.reshape(size[1], oversample, size[0], oversample, 3).mean(axis=(1, 3))
    return np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)


def shade(base: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The light of every picture and of the viewer: a key from the upper left, a fill from the viewer."""
    key = np.clip(normal @ _unit(-0.35, 0.55, 0.75), 0, None)[:, None]
    head = np.clip(normal[:, 2:], 0, None)
    shine = np.clip(normal @ _unit(-0.18, 0.28, 0.94), 0, None)[:, None] ** 24
    return base * (0.26 + 0.44 * key + 0.36 * head) + 0.06 * shine


def _unit(*v: float) -> np.ndarray:
    return np.array(v) / np.linalg.norm(v)
