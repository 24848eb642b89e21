"""Pictures as a GPU's threads draw them, column by column and quad by quad, against those of the CPU's loops."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from tests.test_kernel_looks import drawn_views, laid_out
from uavaccel.kernels import events
from uavaccel.kernels import fields as at
from uavaccel.kernels.appearance import read_appearance
from uavaccel.kernels.faces import project
from uavaccel.kernels.fields import Appearance
from uavaccel.kernels.pictures import render_gray
from uavaccel.kernels.quads import (
    MOST_INTERVALS,
    MOST_PIECES,
    Column,
    add_interval,
    fill_column,
    quad_lumas,
    quick_count,
    settle,
    update_quad,
)
from uavaccel.resources import asset
from uavaccel.vision.dvs import PRESETS, DvsParameters
from uavaccel.vision.dvs_kernels import count_single_pixel
from uavaccel.vision.dvs_sensor import sample_pixels


@pytest.fixture(scope="module")
def appearance() -> Appearance:
    return read_appearance(mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml"))))


def room() -> Column:
    intervals, pieces = (MOST_INTERVALS, at.COLUMNS), (MOST_PIECES, at.COLUMNS)
    rows, w = np.zeros(intervals, np.int32), np.zeros((2, *intervals), np.float32)
    return Column(rows, w[0], w[1], np.zeros(pieces, np.int32))


@njit
def draw(appearance: Any, faces: Any, room: Column, shown: Any, picture: Any) -> None:
    """What each pixel shows (ROWS, COLUMNS), and its luma."""
    for column in range(at.COLUMNS):
        place, count = np.uintp(column), np.int32(0)
        for face in range(1, int(faces[0, at.COUNT])):
            if faces[face, at.NEAREST_W] > 0:
                count = add_interval(faces, np.int32(face), np.int32(column), room, place, count)
        settle(faces[0, at.FAR_W], room, place, count)
        fill_column(room, place, shown, place)
    for row in range(0, at.ROWS, 2):
        for column in range(0, at.COLUMNS, 2):
            a, b = np.int32(shown[row, column]), np.int32(shown[row, column + 1])
            c, d = np.int32(shown[row + 1, column]), np.int32(shown[row + 1, column + 1])
            quad = quad_lumas(
                faces, (a, b, c, d), appearance.texels, appearance.textures, np.int32(row), np.int32(column)
            )
            picture[row, column], picture[row, column + 1] = quad[0], quad[1]
            picture[row + 1, column], picture[row + 1, column + 1] = quad[2], quad[3]


def test_columns_and_quads_are_the_picture(appearance: Appearance) -> None:
    arguments = laid_out(appearance, drawn_views(48, seed=1))
    faces = np.zeros((at.FACES, at.FIELDS), np.float32)
    shown = np.zeros((at.ROWS, at.COLUMNS), np.int16)
    drawn = np.zeros((48, at.ROWS, at.COLUMNS), np.uint8)
    for number, picture in enumerate(drawn):
        project(appearance, arguments[1], number, arguments[3][number], arguments[4][number], True, faces)
        draw(appearance, faces, room(), shown, picture)
    apart = np.abs(drawn.astype(int) - render_gray(*arguments))
    assert np.mean(apart > 0) <= 5e-5


def test_counts_without_a_double_division_are_v2es() -> None:
    rng = np.random.default_rng(0)
    base = rng.uniform(0, 5.5, 200_000).astype(np.float32)
    up, down = (np.abs(rng.normal(0.2, 0.05, (2, len(base)))) + 0.01).astype(np.float32)
    whole = rng.integers(-9, 10, len(base)).astype(np.float32)
    for log in (rng.uniform(0, 5.5, len(base)).astype(np.float32), base + whole * np.where(whole > 0, up, down)):
        exact = [count_single_pixel(*each) for each in zip(log, base, up, down, strict=True)]
        quick: NDArray[Any] = np.array([quick_count(*each) for each in zip(log, base, up, down, strict=True)])
        np.testing.assert_array_equal(quick, exact)
        assert np.abs(quick).max() > 5


@njit
def see_both(levels: Any, camera: Any, sensor: Any, plain: Any, full: Any) -> tuple[int, int]:
    """A picture as quads without noise see it, and as `events.update_pixel` does: ON minus OFF events."""
    quick = slow = 0
    none, zero = full[0:0], (np.float32(0.0), np.float32(0.0))
    for row in range(0, at.ROWS, 2):
        for column in range(0, at.COLUMNS, 2):
            place = np.uintp(row * at.COLUMNS + column)
            shown, before = (levels[row : row + 2, column : column + 2], plain[0, row : row + 2, column : column + 2])
            lumas = (shown[0, 0], shown[0, 1], shown[1, 0], shown[1, 1])
            known = (before[0, 0], before[0, 1], before[1, 0], before[1, 1])
            quick += update_quad(lumas, known, camera, sensor, plain, place, place)
            for part in range(4):
                y, x = row + part // 2, column + part % 2
                slow += events.update_pixel(levels[y, x], camera, sensor, full, none, zero, y, x, 0.1)
    return quick, slow


def test_a_lanes_camera_has_each_parameter_under_its_name() -> None:
    parameters = DvsParameters(0.1, 0.3, 0.02, 50.0, 0.4, 0.05, 0.9, 6.0, 0.007, 0.08)
    camera = events.camera_row(parameters, 2.5)
    expected = {
        events.POSITIVE: 0.1, events.NEGATIVE: 0.3, events.SIGMA: 0.02, events.TAU: 1 / (100 * np.pi),
        events.LEAK: 0.4, events.JITTER: 0.05, events.SHOT: 6.0, events.REFRACTORY: 0.007, events.HOT: 0.08,
        events.READ: 2.5,
    }  # fmt: skip
    assert dict(enumerate(camera.tolist())) == pytest.approx(expected)


def test_a_pixel_rises_by_one_threshold_and_falls_by_the_other() -> None:
    """Of 0.25 and 0.5 without a spread, from 50 to 100, by 0.693, and back: two whole steps up, one down."""
    parameters, shape = DvsParameters(0.25, 0.5, threshold_sigma=0.0), (at.ROWS, at.COLUMNS)
    sensor, row = events.sensor_of(sample_pixels(parameters, shape, 3)), events.camera_row(parameters, 0.0)
    full = np.full(shape, np.log(50), np.float32)
    plain = full[None].copy()
    for level, events_each, after in ((100, 2, 0.5), (50, -1, 0.0), (50, 0, 0.0)):
        both = see_both(np.full(shape, level), tuple(row), sensor, plain, full)
        assert both == (events_each * full.size, events_each * full.size)
        np.testing.assert_allclose(full, np.log(50) + after, atol=1e-6)
        np.testing.assert_array_equal(plain[0], full)


@pytest.mark.parametrize(("sigma", "negative"), [(0.0, 0.2), (0.05, 0.2), (0.05, 0.3)])
def test_quads_without_noise_see_what_pixels_see(sigma: float, negative: float) -> None:
    rng, shape = np.random.default_rng(0), (at.ROWS, at.COLUMNS)
    parameters = replace(PRESETS["clean"], threshold_sigma=sigma, negative_threshold=negative)
    sensor, row = events.sensor_of(sample_pixels(parameters, shape, 3)), events.camera_row(parameters, 0.0)
    full = sensor.logs[rng.integers(0, 256, shape)]
    plain = full[None].copy()
    for _ in range(3):
        quick, slow = see_both(rng.integers(0, 256, shape), tuple(row), sensor, plain, full)
        assert quick == slow != 0
        np.testing.assert_array_equal(plain[0], full)
