"""Projection of a lane's boxes, cylinders and planes into the camera's image, as faces: textured and lit.

A ray is d(column, row) = forward + right * x + up * y, of unit depth. It meets the plane N . (P - eye) = h, with N
pointing outwards and h < 0, at depth 1/w with w = N . d / h; along a tangent T of the plane, T . (P - eye) = T . d / w.
Therefore w, and the distance from each edge times w, are dot products of d with constant vectors.

Computed in float64, stored as float32. Scalar functions, as in `kernels.rays`. `project` processes a whole scene; on a
GPU one thread per solid calls `project_solid`, each with rows of its own.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from uavaccel.kernels import fields as at
from uavaccel.kernels.fields import Appearance, Scenes, Vector
from uavaccel.kernels.rays import Faces, dot, plus, touches
from uavaccel.sim.parts import part

Floats = NDArray[np.floating]
View = tuple[Vector, Vector, Vector, Vector]  # eye; the ray: per column, per row, of pixel (0, 0)
Span = tuple[float, float]
Look = tuple[Appearance, Scenes, int, int]  # with the lane and the material
Block = tuple[Vector, Vector]  # a solid's middle from the eye, and its half size

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
APOTHEM, HALF_SIDE = math.cos(math.pi / at.SLICES), math.sin(math.pi / at.SLICES)  # of a prism of radius 1
SKY_SHARE = 0.70  # distance of the sky in MuJoCo's renderer, as a share of the far plane's
NONE = (0.0, 0.0, 0.0)


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
    per_column, per_row = plus(NONE, right, 2.0 * wide / at.COLUMNS), plus(NONE, up, -2.0 * high / at.ROWS)
    corner = plus(plus(NONE, back, -1.0), right, wide / at.COLUMNS - wide)
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
    per_w = plus(NONE, normal, 1.0 / h)
    put(faces, row, at.W, view, per_w)
    put(faces, row, at.EDGES, view, plus(t, per_w, -ts[0]))
    put(faces, row, at.EDGES + 3, view, plus(plus(NONE, per_w, ts[1]), t, -1.0))
    put(faces, row, at.EDGES + 6, view, plus(s, per_w, -ss[0]))
    put(faces, row, at.EDGES + 9, view, plus(plus(NONE, per_w, ss[1]), s, -1.0))
    faces[row, at.EXTRA] = np.float32(0.0)
    middle = plus(plus(plus(NONE, normal, h), t, 0.5 * (ts[0] + ts[1])), s, 0.5 * (ss[0] + ss[1]))
    t_half, s_half = plus(NONE, t, 0.5 * (ts[1] - ts[0])), plus(NONE, s, 0.5 * (ss[1] - ss[0]))
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
        put(faces, row, 3 * side, view, plus(plus(NONE, per_w, reach), out, -1.0))
    faces[row, at.NEAREST_W] = np.float32(0.0)


@part(error_model="numpy", inline=False)
def put_light(faces: Faces, row: int, look: Look, low: Vector, high: Vector, width: float) -> None:
    """Write a face's shading, from the vertex normals at its low and high end, which are `width` metres apart."""
    appearance, scenes, lane, material = look
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
def put_texture(faces: Faces, row: int, look: Look, half: Vector, across: Span, down: Span) -> None:
    """Write a face's texture mapping; `across` and `down` are texture coordinates at its edge and per metre.

    A uniform texture repeats with the `half` sizes of the solid.
    """
    appearance, _, _, material = look
    texture = int(appearance.materials[material, at.TEXTURE_ID])
    faces[row, at.TEXTURE] = np.float32(texture)
    for place in range(2):
        repeat = float(appearance.materials[material, at.REPEAT + place])
        repeat = repeat if repeat > 0.0 else 1.0
        if appearance.materials[material, at.UNIFORM] > 0.0 and half[place] > 0.0:
            repeat *= half[place]
        texels = repeat * (1 << appearance.textures[texture, at.LOG2_SIZE])
        edge, per_metre = across if place == 0 else down
        field = at.TU if place == 0 else at.TV
        faces[row, field] = np.float32(texels * per_metre)
        faces[row, field + 1] = np.float32(texels * edge)


@part(error_model="numpy", inline=False)
def put_side(faces: Faces, row: int, view: View, axis: int, towards: float, h: float, block: Block, look: Look) -> int:
    """Write a box's side perpendicular to an axis, or a plane, and return the rows written: 0 if it is invisible."""
    middle, half = block
    normal = (towards if axis == 0 else 0.0, towards if axis == 1 else 0.0, towards if axis == 2 else 0.0)
    t, s = (Y if axis == 0 else X), (Y if axis == 2 else Z)
    t_middle, t_half = dot(t, middle), dot(t, half)
    s_middle, s_half = dot(s, middle), dot(s, half)
    ts, ss = (t_middle - t_half, t_middle + t_half), (s_middle - s_half, s_middle + s_half)
    if not put_face(faces, row, view, normal, h, t, ts, s, ss):
        return 0
    put_light(faces, row, look, normal, normal, 1.0)
    put_texture(faces, row, look, half, (0.0, 0.5 / t_half), (0.0, 0.5 / s_half))
    return 1


@part(error_model="numpy")
def corner_of(side: int) -> Vector:
    """Return the vertex normal at a corner of a cylinder's prism."""
    angle = side * 2.0 * math.pi / at.SLICES
    return math.cos(angle), math.sin(angle), 0.0


@part(error_model="numpy", inline=False)
def put_cylinder(faces: Faces, row: int, view: View, block: Block, look: Look) -> int:
    """Write the prism that OpenGL draws for an upright cylinder, and return the rows written: a cap takes two."""
    written, (middle, half) = 0, block
    radius, tall = half[0], half[2]
    ss = (middle[2] - tall, middle[2] + tall)
    for side in range(at.SLICES):
        low, high = corner_of(side), corner_of(side + 1)
        angle = (side + 0.5) * 2.0 * math.pi / at.SLICES
        normal = (math.cos(angle), math.sin(angle), 0.0)
        t = (-normal[1], normal[0], 0.0)
        h, t_middle = radius * APOTHEM + dot(normal, middle), dot(t, middle)
        ts = (t_middle - radius * HALF_SIDE, t_middle + radius * HALF_SIDE)
        if h < 0.0 and put_face(faces, row + written, view, normal, h, t, ts, Z, ss):
            width = 2.0 * radius * HALF_SIDE
            put_light(faces, row + written, look, low, high, width)
            across = (side / at.SLICES, 1.0 / (at.SLICES * width))
            put_texture(faces, row + written, look, half, across, (0.0, 0.5 / tall))
            written += 1
    towards, row = (1.0 if middle[2] < 0.0 else -1.0), row + written
    h, normal = towards * middle[2] + tall, (0.0, 0.0, towards)
    ts, ss = (middle[0] - radius, middle[0] + radius), (middle[1] - radius, middle[1] + radius)
    if h >= 0.0 or not put_face(faces, row, view, normal, h, X, ts, Y, ss):
        return written
    faces[row, at.EXTRA] = np.float32(row + 1)
    put_prism(faces, row + 1, view, plus(NONE, normal, 1.0 / h), middle, radius)
    put_light(faces, row, look, normal, normal, 1.0)
    put_texture(faces, row, look, half, (0.0, 0.5 / radius), (1.0, -0.5 / radius))  # it runs upwards
    return written + 2


@part(error_model="numpy", inline=False)
def project_solid(
    appearance: Appearance, scenes: Scenes, lane: int, solid: int, view: View, sky: bool, faces: Faces, row: int
) -> int:
    """Write a solid's faces from `row` on, and return the rows written: at most 3 for a box, 6 for a cylinder."""
    eye, own = view[0], scenes.solids[lane, solid]
    middle = own[0] - eye[0], own[1] - eye[1], own[2] - eye[2]
    half = float(own[at.HALF_SIZE]), float(own[at.HALF_SIZE + 1]), float(own[at.HALF_SIZE + 2])
    kind, block, look = int(own[at.KIND]), (middle, half), (appearance, scenes, lane, int(own[at.MATERIAL]))
    if kind == at.CYLINDER:
        return put_cylinder(faces, row, view, block, look)
    written = 0
    for axis in range(2 if kind == at.PLANE else 0, 3):
        towards = 1.0 if middle[axis] < 0.0 else -1.0  # the side that faces the eye
        height = half[axis] if kind != at.PLANE else 0.0
        h = towards * middle[axis] + height
        if h < 0.0 and (kind != at.PLANE or towards > 0.0):
            written += put_side(faces, row + written, view, axis, towards, h, block, look)
            if kind == at.PLANE and sky and written > 0:
                faces[row, at.EXTRA] = np.float32(row + written)
                sky_m = SKY_SHARE * appearance.camera[at.FAR_M]
                put_prism(faces, row + written, view, (0.0, 0.0, 1.0 / h), NONE, sky_m)
                written += 1
    return written


@part(error_model="numpy", inline=False)
def project(
    appearance: Appearance, scenes: Scenes, lane: int, position: Floats, quaternion: Floats, sky: bool, faces: Faces
) -> int:
    """Project a scene for a pose, NED in metres and wxyz, to `faces` (FACES, FIELDS), and return the rows in use.

    With `sky` the ground ends at the sky, as in OpenGL's colour images; depth images have none.
    """
    view = view_of(appearance.camera, position, quaternion)
    row = begin(appearance.camera, view, faces)
    for solid in range(scenes.counts[lane]):
        row += project_solid(appearance, scenes, lane, solid, view, sky, faces, row)
    faces[0, at.COUNT] = np.float32(row)
    return row
