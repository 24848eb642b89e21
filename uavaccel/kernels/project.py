"""Projection of a lane's boxes, cylinders and planes: the faces turned towards the camera, textured and lit.

`project` processes a whole scene; on a GPU one thread per solid calls `project_solid`, each with rows of its own.
"""

from __future__ import annotations

import math

import numpy as np

from uavaccel.kernels import fields as at
from uavaccel.kernels.faces import (
    APOTHEM,
    HALF_SIDE,
    SKY_SHARE,
    Floats,
    View,
    X,
    Y,
    Z,
    begin,
    put_face,
    put_light,
    put_prism,
    put_texture,
    view_of,
)
from uavaccel.kernels.fields import Appearance, Scenes
from uavaccel.kernels.operands import Vector, dot, plus
from uavaccel.kernels.rays import Faces
from uavaccel.sim.parts import part


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


@part(error_model="numpy", inline=False)
def project_solid(
    appearance: Appearance, scenes: Scenes, lane: int, solid: int, view: View, sky: bool, faces: Faces, row: int
) -> int:
    """Write a solid's faces from `row` on, and return the rows written: at most 3 for a box, 6 for a cylinder."""
    eye = view[0]
    middle = (
        scenes.solids[lane, solid, 0] - eye[0],
        scenes.solids[lane, solid, 1] - eye[1],
        scenes.solids[lane, solid, 2] - eye[2],
    )
    half = (
        float(scenes.solids[lane, solid, at.HALF_SIZE]),
        float(scenes.solids[lane, solid, at.HALF_SIZE + 1]),
        float(scenes.solids[lane, solid, at.HALF_SIZE + 2]),
    )
    kind, material = int(scenes.solids[lane, solid, at.KIND]), int(scenes.solids[lane, solid, at.MATERIAL])
    if kind == at.CYLINDER:
        return put_cylinder(faces, row, view, middle, half, appearance, scenes, lane, material)
    written = 0
    for axis in range(2 if kind == at.PLANE else 0, 3):
        towards = 1.0 if middle[axis] < 0.0 else -1.0  # the side that faces the eye
        height = half[axis] if kind != at.PLANE else 0.0
        h = towards * middle[axis] + height
        if h < 0.0 and (kind != at.PLANE or towards > 0.0):
            written += put_side(
                faces, row + written, view, axis, towards, h, middle, half, appearance, scenes, lane, material
            )  # fmt: skip
            if kind == at.PLANE and sky and written > 0:
                faces[row, at.EXTRA] = np.float32(row + written)
                put_prism(
                    faces,
                    row + written,
                    view,
                    (0.0, 0.0, 1.0 / h),
                    (0.0, 0.0, 0.0),
                    SKY_SHARE * appearance.camera[at.FAR_M],
                )
                written += 1
    return written


@part(error_model="numpy", inline=False)
def put_side(
    faces: Faces,
    row: int,
    view: View,
    axis: int,
    towards: float,
    h: float,
    middle: Vector,
    half: Vector,
    appearance: Appearance,
    scenes: Scenes,
    lane: int,
    material: int,
) -> int:
    """Write a box's side perpendicular to an axis, or a plane, and return the rows written: 0 if it is invisible."""
    normal = (towards if axis == 0 else 0.0, towards if axis == 1 else 0.0, towards if axis == 2 else 0.0)
    t, s = (Y if axis == 0 else X), (Y if axis == 2 else Z)
    t_middle, t_half = dot(t, middle), dot(t, half)
    s_middle, s_half = dot(s, middle), dot(s, half)
    ts, ss = (t_middle - t_half, t_middle + t_half), (s_middle - s_half, s_middle + s_half)
    if not put_face(faces, row, view, normal, h, t, ts, s, ss):
        return 0
    put_light(faces, row, appearance, scenes, lane, material, normal, normal, 1.0)
    across, down = (0.0, 0.5 / t_half), (0.0, 0.5 / s_half)
    put_texture(faces, row, appearance, material, (half[0], half[1]), across, down)
    return 1


@part(error_model="numpy", inline=False)
def put_cylinder(
    faces: Faces,
    row: int,
    view: View,
    middle: Vector,
    half: Vector,
    appearance: Appearance,
    scenes: Scenes,
    lane: int,
    material: int,
) -> int:
    """Write the prism that OpenGL draws for an upright cylinder, and return the rows written."""
    written, radius, tall = 0, half[0], half[2]
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
            put_light(faces, row + written, appearance, scenes, lane, material, low, high, width)
            across = (side / at.SLICES, 1.0 / (at.SLICES * width))
            down = (0.0, 0.5 / tall)
            put_texture(faces, row + written, appearance, material, (half[0], half[1]), across, down)
            written += 1
    return written + put_cap(faces, row + written, view, middle, half, appearance, scenes, lane, material)


@part(error_model="numpy")
def corner_of(side: int) -> Vector:
    """Return the vertex normal at a corner of a cylinder's prism."""
    angle = side * 2.0 * math.pi / at.SLICES
    return math.cos(angle), math.sin(angle), 0.0


@part(error_model="numpy")
def put_cap(
    faces: Faces,
    row: int,
    view: View,
    middle: Vector,
    half: Vector,
    appearance: Appearance,
    scenes: Scenes,
    lane: int,
    material: int,
) -> int:
    """Write a cylinder's visible cap: a face, and a row with its eight edges. Return the rows written, 2 or 0."""
    radius, tall = half[0], half[2]
    towards = 1.0 if middle[2] < 0.0 else -1.0
    h = towards * middle[2] + tall
    normal = (0.0, 0.0, towards)
    ts, ss = (middle[0] - radius, middle[0] + radius), (middle[1] - radius, middle[1] + radius)
    if h >= 0.0 or not put_face(faces, row, view, normal, h, X, ts, Y, ss):
        return 0
    faces[row, at.EXTRA] = np.float32(row + 1)
    put_prism(faces, row + 1, view, plus((0.0, 0.0, 0.0), normal, 1.0 / h), middle, radius)
    put_light(faces, row, appearance, scenes, lane, material, normal, normal, 1.0)
    half_turn = (1.0, -0.5 / radius)  # a cap's texture runs upwards
    put_texture(faces, row, appearance, material, (half[0], half[1]), (0.0, 0.5 / radius), half_turn)
    return 2
