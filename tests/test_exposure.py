"""Modelled auto-exposure: how far it goes in a time, where it ends, and that a pause holds it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uavaccel.envs.camera_client import CameraClient
from uavaccel.envs.task import AT_REST
from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.perturb import AutoExposure

S = 1_000_000_000


def grey(level: int) -> np.ndarray:
    return np.full((4, 6), level, np.uint8)


def test_the_first_image_is_taken_as_it_is_and_sets_the_aim() -> None:
    exposure = AutoExposure()
    assert (exposure.expose(grey(80), 5 * S) == 80).all()
    assert (exposure.expose(grey(80), 9 * S) == 80).all()


def test_an_image_counts_from_the_one_before_it() -> None:
    """Ten a second: each goes 0.3 of a stop further."""
    exposure = AutoExposure()
    exposure.expose(grey(200), 0)
    reached = []
    for tenth in range(1, 4):
        exposure.expose(grey(20), tenth * S // 10)
        reached.append(exposure.stops)
    assert reached == pytest.approx([0.3, 0.6, 0.9])


@pytest.mark.parametrize(
    ("level", "ran_s", "stops"),
    [
        (40, 0.1, 0.3),  # half as bright: one stop up at 3 stops per second
        (40, 1.0, 1.0),  # and no further than that
        (160, 0.1, -0.1),  # down at 1 stop per second
        (160, 0.0, 0.0),  # a pause holds it
        (5, 60.0, 2.0),  # 4 stops are more than there are
        (0, 0.1, 0.3),  # night too
    ],
)
def test_it_follows_by_so_many_stops_per_second(level: int, ran_s: float, stops: float) -> None:
    exposure = AutoExposure()
    exposure.expose(grey(80), 2 * S)
    image = exposure.expose(grey(level), round((2 + ran_s) * S))
    assert exposure.stops == pytest.approx(stops)
    assert (image == round(level * 2**stops)).all()


def test_a_faster_clock_leaves_it_less_time() -> None:
    """The same simulated second, at 1x and at 100x."""
    slow, fast = AutoExposure(), AutoExposure()
    for exposure, clock_speed in ((slow, 1), (fast, 100)):
        exposure.expose(grey(80), 0)
        exposure.expose(grey(40), S // clock_speed)
    assert (slow.stops, fast.stops) == pytest.approx((1.0, 0.03))


def test_bright_pixels_saturate_and_colours_keep_their_order() -> None:
    exposure = AutoExposure()
    exposure.expose(np.full((2, 2, 3), 100, np.uint8), 0)
    image = exposure.expose(np.array([[[20, 40, 60], [20, 40, 200]]], np.uint8), 10 * S)
    assert image[0, 1, 2] == 255
    assert image[0, 0, 0] < image[0, 0, 1] < image[0, 0, 2]


def test_a_camera_is_exposed_for_the_time_that_it_ran() -> None:
    """At 10x a simulated second is a tenth of one: three tenths of a stop up, as the picture is half as bright."""
    images = iter((grey(80), grey(40)))
    client: Any = SimpleNamespace(clock_speed=10.0, image=lambda kind, size: next(images))
    exposure = AutoExposure()
    camera = CameraClient(client, guard=GuardSettings(max_retries=0), exposure=exposure)
    for time_ns in (0, S):
        sample = camera.take(replace(AT_REST, time_ns=time_ns))
    assert exposure.stops == pytest.approx(0.3)
    assert (sample.image == round(40 * 2**0.3)).all()
