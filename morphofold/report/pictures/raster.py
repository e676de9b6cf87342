"""A small software renderer: triangles go in, the face that each pixel sees comes out, and its shaded colour; for the
pictures of ``surfaces``. No graphics library is needed.

It is slower than a graphics card. Each picture has one thread and one order of triangles, so every run gives the same
picture, bit for bit.
"""

import math

import numpy as np

from morphofold.frozen_arrays import Array, Ints
from morphofold.geometry import corners, dot, is_closed, position
from morphofold.kernels import kernel, reading
from morphofold.report.colours import RGB, in_bytes

#: the face at each pixel and the weights of its first two corners, as ``rasterise`` returns them
Seen = tuple[np.ndarray, np.ndarray, np.ndarray]
OVERSAMPLE = 2  # times a picture is drawn larger in each direction


@kernel
def rasterise(xyz, faces, width, height, closed):
    """The nearest triangle at each pixel.

    Parameters
    ----------
    xyz : (N, 3) float64
        Pixel column, pixel row (0 at the top) and height towards the viewer of each vertex.
    faces : (M, 3) int64
    width, height : int
    closed : bool
        Whether the surface is closed and its faces are counter-clockwise seen from outside.

    Returns
    -------
    face : (height, width) int32
        Index of the visible face, -1 where there is none.
    b0, b1 : (height, width) float32
        Barycentric weights of the first two corners of the face.
    """
    depth = np.full((height, width), -np.inf)
    face = np.full(depth.shape, -1, np.int32)
    b0, b1 = np.zeros(depth.shape, np.float32), np.zeros(depth.shape, np.float32)
    for f in range(len(faces)):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners(xyz, faces, f)
        twice = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if twice == 0.0 or (closed and twice > 0.0):  # on a closed surface, those turned away lie behind others
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


#: unit vectors towards the key light, and halfway from it to the viewer
KEY_LIGHT, HIGHLIGHT = (tuple(np.divide(v, np.linalg.norm(v))) for v in ((-0.35, 0.55, 0.75), (-0.18, 0.28, 0.94)))


@kernel
def paint(face, b0, b1, faces, normals, colours, oversample):
    """Brightness (height, width, 3) of the result of ``rasterise``, lit as in the viewer; white where there is no face.

    There is a key light from the upper left, a fill light from the viewer and a small specular term. Open surfaces show
    their inside. The picture is ``oversample`` times smaller in each direction than ``face``; each pixel is a sum.
    """
    height, width = face.shape[0] // oversample, face.shape[1] // oversample
    image, normal = np.zeros((height, width, 3)), np.empty(3)
    for y in range(face.shape[0]):
        for x in range(face.shape[1]):
            f, u, v, pixel = face[y, x], b0[y, x], b1[y, x], image[y // oversample, x // oversample]
            if f < 0:
                pixel += 1.0
                continue
            w, (i, j, k) = 1.0 - u - v, position(faces, f)
            for c in range(3):
                normal[c] = u * normals[i, c] + v * normals[j, c] + w * normals[k, c]
            normal *= math.copysign(1.0 / max(math.sqrt(dot(normal, normal)), 1e-12), normal[2])
            specular = max(dot(normal, HIGHLIGHT), 0.0) ** 24
            light = 0.26 + 0.44 * max(dot(normal, KEY_LIGHT), 0.0) + 0.36 * normal[2]
            for c in range(3):
                colour = u * colours[i, c] + v * colours[j, c] + w * colours[k, c]
                pixel[c] += min(colour / 255.0 * light + 0.06 * specular, 1.0)
    return image


def visible(points: Array, faces: Ints, size: tuple[int, int], px_per_mm: float, oversample: int = OVERSAMPLE) -> Seen:
    """The visible faces of a surface from +z, x to the right, y up, without perspective.

    Parameters
    ----------
    points : (N, 3)
        In the camera's axes and centred [mm].
    faces : (M, 3)
    size : (width, height) in pixels
    px_per_mm : float
    oversample : int
        The picture is drawn this many times larger in each direction; :func:`coloured` averages it down.
    """
    width, height = (n * oversample for n in size)
    oversampled_px = px_per_mm * oversample
    xyz = [width / 2, height / 2, 0] + points * [oversampled_px, -oversampled_px, 1]
    face, b0, b1 = rasterise(*reading(xyz, faces), width, height, is_closed(faces))
    return face, b0, b1


def coloured(seen: Seen, faces: Ints, normals: Array, colours: RGB, oversample: int = OVERSAMPLE) -> RGB:
    """Picture (height, width, 3) on white, from unit normals (N, 3) in the camera's axes and colours (N, 3)."""
    image = paint(*reading(*seen, faces, normals, colours), oversample)
    return in_bytes(image * (255.0 / oversample**2))
