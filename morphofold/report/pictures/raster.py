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
    visible_face : (height, width) int32
        Its index, -1 where there is none.
    b0, b1 : (height, width) float32
        Barycentric weights of the first two corners of the face.
    """
    depth = np.full((height, width), -np.inf)
    visible_face = np.full(depth.shape, -1, np.int32)
    b0, b1 = np.zeros(depth.shape, np.float32), np.zeros(depth.shape, np.float32)
    for face_index in range(len(faces)):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners(xyz, faces, face_index)
        area2 = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area2 == 0.0 or (closed and area2 > 0.0):  # on a closed surface, those turned away lie behind others
            continue
        first_x = max(math.ceil(min(ax, bx, cx) - 0.5), 0)
        last_x = min(math.floor(max(ax, bx, cx) - 0.5), width - 1)
        first_y = max(math.ceil(min(ay, by, cy) - 0.5), 0)
        last_y = min(math.floor(max(ay, by, cy) - 0.5), height - 1)
        for y in range(first_y, last_y + 1):
            for x in range(first_x, last_x + 1):
                pixel_x, pixel_y = x + 0.5, y + 0.5
                u = ((bx - pixel_x) * (cy - pixel_y) - (by - pixel_y) * (cx - pixel_x)) / area2
                v = ((cx - pixel_x) * (ay - pixel_y) - (cy - pixel_y) * (ax - pixel_x)) / area2
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < -1e-12:
                    continue
                z = u * az + v * bz + w * cz
                if z > depth[y, x]:
                    depth[y, x] = z
                    visible_face[y, x] = face_index
                    b0[y, x] = u
                    b1[y, x] = v
    return visible_face, b0, b1


#: unit vectors towards the key light, and halfway from it to the viewer
KEY_LIGHT, HIGHLIGHT = (tuple(np.divide(v, np.linalg.norm(v))) for v in ((-0.35, 0.55, 0.75), (-0.18, 0.28, 0.94)))


@kernel
def paint(visible_face, b0, b1, faces, normals, colours, oversample):
    """Brightness (height, width, 3) of the result of ``rasterise``, lit as in the viewer; white where there is no face.

    There is a key light from the upper left, a fill light from the viewer and a small specular term. Open surfaces show
    their inside. The picture is ``oversample`` times smaller each way than ``visible_face``; each pixel is a sum.
    """
    height, width = visible_face.shape[0] // oversample, visible_face.shape[1] // oversample
    image, normal = np.zeros((height, width, 3)), np.empty(3)
    for y in range(visible_face.shape[0]):
        for x in range(visible_face.shape[1]):
            face_index, u, v, pixel = visible_face[y, x], b0[y, x], b1[y, x], image[y // oversample, x // oversample]
            if face_index < 0:
                pixel += 1.0
                continue
            w, (i, j, k) = 1.0 - u - v, position(faces, face_index)
            for axis in range(3):
                normal[axis] = u * normals[i, axis] + v * normals[j, axis] + w * normals[k, axis]
            normal *= math.copysign(1.0 / max(math.sqrt(dot(normal, normal)), 1e-12), normal[2])
            specular = max(dot(normal, HIGHLIGHT), 0.0) ** 24
            light = 0.26 + 0.44 * max(dot(normal, KEY_LIGHT), 0.0) + 0.36 * normal[2]
            for channel in range(3):
                colour = u * colours[i, channel] + v * colours[j, channel] + w * colours[k, channel]
                pixel[channel] += min(colour / 255.0 * light + 0.06 * specular, 1.0)
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
    width, height = (side_px * oversample for side_px in size)
    fine_px_per_mm = px_per_mm * oversample
    xyz = [width / 2, height / 2, 0] + points * [fine_px_per_mm, -fine_px_per_mm, 1]
    visible_face, b0, b1 = rasterise(*reading(xyz, faces), width, height, is_closed(faces))
    return visible_face, b0, b1


def coloured(seen: Seen, faces: Ints, normals: Array, colours: RGB, oversample: int = OVERSAMPLE) -> RGB:
    """Picture (height, width, 3) on white, from unit normals (N, 3) in the camera's axes and colours (N, 3)."""
    brightness = paint(*reading(*seen, faces, normals, colours), oversample)
    return in_bytes(brightness * (255.0 / oversample**2))
