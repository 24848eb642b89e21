"""Draws pictures of many lanes on the CPU, row by row."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uavaccel.kernels import fields as at
from uavaccel.kernels.fields import Looks, Scenes
from uavaccel.kernels.project import project
from uavaccel.kernels.rays import depth_at, luma_at
from uavaccel.kernels.spans import gray_picture, make_desk


@njit(cache=True, nogil=True, error_model="numpy")
def _slow_gray(looks: Any, scenes: Any, lanes: Any, positions: Any, quaternions: Any, out: Any) -> None:
    faces = np.zeros((at.FACES, at.FIELDS), np.float32)
    for drone in range(len(lanes)):
        project(looks, scenes, lanes[drone], positions[drone], quaternions[drone], True, faces)
        for row in range(at.ROWS):
            for column in range(at.COLUMNS):
                out[drone, row, column] = luma_at(faces, looks.texels, looks.textures, row, column)


@njit(cache=True, nogil=True, error_model="numpy")
def _slow_depth(looks: Any, scenes: Any, lanes: Any, positions: Any, quaternions: Any, out: Any) -> None:
    faces = np.zeros((at.FACES, at.FIELDS), np.float32)
    for drone in range(len(lanes)):
        project(looks, scenes, lanes[drone], positions[drone], quaternions[drone], False, faces)
        for row in range(at.ROWS):
            for column in range(at.COLUMNS):
                out[drone, row, column] = depth_at(faces, row, column)


def draw_gray(looks: Looks, scenes: Scenes, lanes: NDArray[np.int32], positions: Any, quaternions: Any, out: Any = None) -> NDArray[np.uint8]:
    if out is None:
        out = np.empty((len(lanes), at.ROWS, at.COLUMNS), np.uint8)
    _slow_gray(looks, scenes, lanes, positions, quaternions, out)
    return out


def draw_depth(looks: Looks, scenes: Scenes, lanes: NDArray[np.int32], positions: Any, quaternions: Any, out: Any = None) -> NDArray[np.uint8]:
    if out is None:
        out = np.empty((len(lanes), at.ROWS, at.COLUMNS), np.float32)
    _slow_depth(looks, scenes, lanes, positions, quaternions, out)
    return out


@njit(cache=False, nogil=True, error_model="numpy")
def _fast_gray(looks: Any, scenes: Any, lanes: Any, positions: Any, quaternions: Any, stage: int, out: Any) -> None:
    desk = make_desk()
    for drone in range(len(lanes)):
        project(looks, scenes, lanes[drone], positions[drone], quaternions[drone], True, desk.faces)
        if stage:
            gray_picture(looks, desk, out[drone], stage)
