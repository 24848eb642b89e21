"""Projection of a lane's surfaces into the camera's image, as faces: functions that are linear in column and row.

A ray is d(column, row) = forward + right * x + up * y, of unit depth. It meets the plane N . (P - eye) = h, with N
pointing outwards and h < 0, at depth 1/w with w = N . d / h; along a tangent T of the plane, T . (P - eye) = T . d / w.
Therefore w, and the distance from each edge times w, are dot products of d with constant vectors.

Computed in float64, stored as float32. Scalar functions, as in `kernels.rays`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from uavaccel.kernels import fields as at
from uavaccel.kernels.fields import Appearance, Scenes
from uavaccel.kernels.operands import Vector, dot, plus
from uavaccel.kernels.rays import Faces, touches
from uavaccel.sim.parts import part

Floats = NDArray[np.floating]
View = tuple[Vector, Vector, Vector, Vector]  # eye; the ray: per column, per row, of pixel (0, 0)
Span = tuple[float, float]

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
APOTHEM, HALF_SIDE = math.cos(math.pi / at.SLICES), math.sin(math.pi / at.SLICES)  # of a prism of radius 1
SKY_SHARE = 0.70  # distance of the sky in MuJoCo's renderer, as a share of the far plane's


@part(error_model="numpy")
def turned(quaternion: tuple[float, float, float, float], v: Vector) -> Vector:
    """Rotate a vector by a unit quaternion wxyz."""
    w, x, y, z = quaternion
    across = (2.0 * (y * v[2] - z * v[1]), 2.0 * (z * v[0] - x * v[2]), 2.0 * (x * v[1] - y * v[0]))
    return (
        v[0] + w * across[0] + y * across[2] - z * across[1],
        v[1] + w * across[1] + z * across[0] - x * across[2],
        v[2] + w * across[2] + x * across[1] - y * across[0],
    )


@part(error_model="numpy")
def axes_of(camera: Floats, position: Floats, quaternion: Floats) -> tuple[Vector, Vector, Vector, Vector]:
    """Return eye and axes right, up, back in MuJoCo's axes for a drone's pose: NED in metres, and wxyz, FRD to NED."""
    w, x, y, z = quaternion[0], quaternion[1], -quaternion[2], -quaternion[3]
    length = math.sqrt(w * w + x * x + y * y + z * z)
    q = (w / length, x / length, y / length, z / length)
    c, a = at.PLACE, at.AXES
    place = turned(q, (camera[c], camera[c + 1], camera[c + 2]))
    eye = (position[0] + place[0], place[1] - position[1], place[2] - position[2])
    right = turned(q, (camera[a], camera[a + 3], camera[a + 6]))
    up = turned(q, (camera[a + 1], camera[a + 4], camera[a + 7]))
    return eye, right, up, turned(q, (camera[a + 2], camera[a + 5], camera[a + 8]))


@part(error_model="numpy")
def view_of(camera: Floats, position: Floats, quaternion: Floats) -> View:
    """Return eye and rays in MuJoCo's axes for a drone's pose, as `axes_of` takes it."""
    eye, right, up, back = axes_of(camera, position, quaternion)
    wide, high = camera[at.HALF_WIDTH], camera[at.HALF_HEIGHT]
    none = (0.0, 0.0, 0.0)
    per_column, per_row = plus(none, right, 2.0 * wide / at.COLUMNS), plus(none, up, -2.0 * high / at.ROWS)
    corner = plus(plus(none, back, -1.0), right, wide / at.COLUMNS - wide)
    return eye, per_column, per_row, plus(corner, up, high - high / at.ROWS)


@part(error_model="numpy")
def put(faces: Faces, row: int, field: int, view: View, vector: Vector) -> None:
    """Write the dot product of the ray with a constant vector, as a linear function of column and row."""
    for place in range(3):
        faces[row, field + place] = np.float32(dot(view[place + 1], vector))


@part(error_model="numpy")
def begin(camera: Floats, view: View, faces: Faces) -> int:
    """Write row 0, the image's rays, and return the number of rows in use."""
    for place, axis in enumerate((X, Y, Z)):
        put(faces, 0, at.RAYS + 3 * place, view, axis)
    faces[0, at.FAR_W] = np.float32(1.0 / camera[at.FAR_M])
    faces[0, at.NEAR_W] = np.float32(1.0 / camera[at.NEAR_M])
    faces[0, at.COUNT] = np.float32(1.0)
    return 1


@part(error_model="numpy")
def bound(faces: Faces, row: int, view: View, middle: Vector, t: Vector, s: Vector) -> None:
    """Write the columns that a rectangle may cover, and its largest w; t and s lead from its centre to its edges."""
    per_column, per_row, corner = view[1], view[2], view[3]
    middle_column = 0.5 * (at.COLUMNS - 1)
    forward = plus(plus(corner, per_column, middle_column), per_row, 0.5 * (at.ROWS - 1))
    left, right, nearest = 1e9, -1e9, 1e9
    for one in (-1.0, 1.0):
        for other in (-1.0, 1.0):
            corner_of_it = plus(plus(middle, t, one), s, other)
            depth = dot(corner_of_it, forward)
            nearest = min(nearest, depth)
            if depth > 0.0:
                column = dot(corner_of_it, per_column) / (dot(per_column, per_column) * depth)
                left, right = min(left, column), max(right, column)
    whole = nearest < 0.01  # part of it is beside or behind the eye
    first, last = math.floor(left + middle_column - 0.01), math.ceil(right + middle_column + 0.01)
    faces[row, at.FIRST_COLUMN] = np.float32(0.0 if whole else max(first, 0.0))
    faces[row, at.LAST_COLUMN] = np.float32(at.COLUMNS - 1.0 if whole else min(last, at.COLUMNS - 1.0))
    faces[row, at.NEAREST_W] = faces[0, at.NEAR_W] if whole else np.float32(1.0001 / nearest)


@part(error_model="numpy", inline=False)
def put_face(
    faces: Faces, row: int, view: View, normal: Vector, h: float, t: Vector, ts: Span, s: Vector, ss: Span
) -> bool:
    """Write a rectangle's plane and edges, and return whether it may be visible.

    `ts` and `ss` are its extents along the tangents t and s, relative to the eye, metres.
    """
    per_w = plus((0.0, 0.0, 0.0), normal, 1.0 / h)
    none = (0.0, 0.0, 0.0)
    put(faces, row, at.W, view, per_w)
    put(faces, row, at.EDGES, view, plus(t, per_w, -ts[0]))
    put(faces, row, at.EDGES + 3, view, plus(plus(none, per_w, ts[1]), t, -1.0))
    put(faces, row, at.EDGES + 6, view, plus(s, per_w, -ss[0]))
    put(faces, row, at.EDGES + 9, view, plus(plus(none, per_w, ss[1]), s, -1.0))
    faces[row, at.EXTRA] = np.float32(0.0)
    middle = plus(plus(plus(none, normal, h), t, 0.5 * (ts[0] + ts[1])), s, 0.5 * (ss[0] + ss[1]))
    t_half, s_half = plus(none, t, 0.5 * (ts[1] - ts[0])), plus(none, s, 0.5 * (ss[1] - ss[0]))
    bound(faces, row, view, middle, t_half, s_half)
    if faces[row, at.FIRST_COLUMN] > faces[row, at.LAST_COLUMN]:
        return False
    end_row, end_column = np.float32(at.ROWS - 1), np.float32(at.COLUMNS - 1)
    return touches(faces, row, np.float32(0.0), end_row, np.float32(0.0), end_column)


@part(error_model="numpy", inline=False)
def put_prism(faces: Faces, row: int, view: View, per_w: Vector, centre: Vector, radius: float) -> None:
    """Write eight more edges, an upright prism's, in a row of their own, on a face whose w is d . per_w."""
    for side in range(at.SLICES):
        angle = (side + 0.5) * 2.0 * math.pi / at.SLICES
        out = (math.cos(angle), math.sin(angle), 0.0)
        reach = radius * APOTHEM + dot(out, centre)
        put(faces, row, 3 * side, view, plus(plus((0.0, 0.0, 0.0), per_w, reach), out, -1.0))
    faces[row, at.NEAREST_W] = np.float32(0.0)


@part(error_model="numpy", inline=False)
def put_light(
    faces: Faces,
    row: int,
    appearance: Appearance,
    scenes: Scenes,
    lane: int,
    material: int,
    low: Vector,
    high: Vector,
    width: float,
) -> None:
    """Write a face's shading, from the vertex normals at its low and high end, which are `width` metres apart."""
    sun = (scenes.lights[lane, at.TOWARDS], scenes.lights[lane, at.TOWARDS + 1], scenes.lights[lane, at.TOWARDS + 2])
    for channel in range(3):
        colour = appearance.materials[material, at.RGB + channel]
        ambient, diffuse = (scenes.lights[lane, at.AMBIENT + channel], scenes.lights[lane, at.DIFFUSE + channel])
        ambient += appearance.materials[material, at.EMISSION]
        first = min(max(colour * (ambient + diffuse * max(dot(low, sun), 0.0)), 0.0), 1.0)
        last = min(max(colour * (ambient + diffuse * max(dot(high, sun), 0.0)), 0.0), 1.0)
        faces[row, at.COLOUR + channel] = np.float32(first)
        faces[row, at.SLOPE + channel] = np.float32((last - first) / width)


@part(error_model="numpy", inline=False)
def put_texture(
    faces: Faces, row: int, appearance: Appearance, material: int, sizes: Span, across: Span, down: Span
) -> None:
    """Write a face's texture mapping; `across` and `down` are texture coordinates at its edge and per metre.

    `sizes` are the half sizes of the solid, with which a uniform texture repeats.
    """
    texture = int(appearance.materials[material, at.TEXTURE_ID])
    faces[row, at.TEXTURE] = np.float32(texture)
    for place in range(2):
        repeat = float(appearance.materials[material, at.REPEAT + place])
        repeat = repeat if repeat > 0.0 else 1.0
        if appearance.materials[material, at.UNIFORM] > 0.0 and sizes[place] > 0.0:
            repeat *= sizes[place]
        texels = repeat * (1 << appearance.textures[texture, at.LOG2_SIZE])
        edge, per_metre = across if place == 0 else down
        field = at.TU if place == 0 else at.TV
        faces[row, field] = np.float32(texels * per_metre)
        faces[row, field + 1] = np.float32(texels * edge)
