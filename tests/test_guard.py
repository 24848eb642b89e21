"""What becomes of images: modelled perturbations, the guard that notices them, and auto-exposure."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import permutations
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from uavaccel.envs.camera_client import CameraClient
from uavaccel.envs.values import AT_REST
from uavaccel.vision.guard import GuardSettings, GuardState, Verdict, acquire, judge, mean_brightness
from uavaccel.vision.perturb import (
    AutoExposure,
    PerturbationKind,
    PerturbationSettings,
    perturb,
    perturb_share,
    share_at,
)

NATIVE, AIRSIM = GuardSettings(), GuardSettings(accept_identical=False)


def grey(level: float) -> NDArray[np.uint8]:
    return np.full((6, 8, 3), level, np.uint8)


def camera(images: Iterable[NDArray]) -> Callable[[], NDArray]:
    return iter(images).__next__


@pytest.mark.parametrize(
    ("reference", "levels", "settings", "taken"),
    [
        (None, [10], NATIVE, (10, 0, Verdict.STEADY)),  # the first one needs only to be bright enough
        (None, [9, 200], NATIVE, (200, 1, Verdict.STEADY)),
        (100.0, [0, 160, 101], NATIVE, (101, 2, Verdict.STEADY)),
        (100.0, [200, 201, 202, 203], AIRSIM, (203, 3, Verdict.EXHAUSTED)),
        (203.0, [205], AIRSIM, (205, 0, Verdict.STEADY)),  # the fallback has become the reference
        (100.0, [200, 200], NATIVE, (200, 1, Verdict.IDENTICAL)),
        (100.0, [200] * 4, AIRSIM, (200, 3, Verdict.EXHAUSTED)),
        (100.0, [200, 201, 200, 200], NATIVE, (200, 3, Verdict.IDENTICAL)),  # to the one just before alone
        (100.0, [0], GuardSettings(max_retries=0), (0, 0, Verdict.EXHAUSTED)),
    ],
)
def test_images_are_requested_until_one_is_accepted(
    reference: float | None, levels: list[int], settings: GuardSettings, taken: tuple[int, int, Verdict]
) -> None:
    found = acquire(GuardState(reference), camera(map(grey, levels)), settings)
    assert (found.image[0, 0, 0], found.retries, found.reason) == taken
    assert found.state.reference_brightness == pytest.approx(taken[0])
    assert (found.state.suspect, found.state.retries) == (None, 0)


def test_a_reused_buffer_is_not_taken_for_an_identical_image() -> None:
    buffer, levels = grey(0), iter([200, 50, 100])

    def request() -> NDArray:
        buffer[:] = next(levels)
        return buffer

    assert acquire(GuardState(100.0), request).reason is Verdict.STEADY


def test_an_image_of_the_same_brightness_is_not_identical() -> None:
    other = grey(200)
    other[0, 0, 0] += 1
    taken = acquire(GuardState(100.0), camera([grey(200), other, grey(100)]))
    assert (taken.retries, taken.reason) == (2, Verdict.STEADY)


@pytest.mark.parametrize(
    ("settings", "level", "verdict"),
    [
        *((NATIVE, level, "steady" if level in (90, 110) else "retry") for level in (89, 90, 110, 111)),
        (GuardSettings(max_change=0.5), 149, "steady"),
        (GuardSettings(max_change=0.5), 151, "retry"),
        (GuardSettings(max_change=0.5, min_brightness=60), 59, "retry"),
        (GuardSettings(max_change=0.5, min_brightness=60), 60, "steady"),
        (GuardSettings(max_change=0.0), 100, "steady"),
    ],
)
def test_limits_are_relative_and_the_floor_is_absolute(settings: GuardSettings, level: int, verdict: str) -> None:
    reference = mean_brightness(grey(100))
    assert judge(GuardState(reference), grey(level), settings)[1] == verdict


@given(st.lists(st.integers(0, 255), min_size=1, max_size=40), st.integers(0, 4), st.booleans())
def test_it_never_locks_and_never_asks_more_than_allowed(levels: list[int], retries: int, same: bool) -> None:
    settings, state = GuardSettings(max_retries=retries, accept_identical=same), GuardState()
    for level in levels:
        taken = acquire(state, itertools.repeat(grey(level)).__next__, settings)
        state = taken.state
        assert taken.retries <= min(retries, 1 if same else retries)
        assert state.reference_brightness == pytest.approx(level)


def test_brightness_is_the_mean_luma_of_grey_and_colour() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (9, 7, 3), np.uint8)
    assert mean_brightness(rgb) == pytest.approx(float((rgb @ np.array([0.299, 0.587, 0.114])).mean()))
    assert mean_brightness(rgb[:, :, 0]) == pytest.approx(float(rgb[:, :, 0].mean()))


# --- perturbations ----------------------------------------------------------------------------------------------------


def flight(images: int, seed: int = 0) -> list[NDArray[np.uint8]]:
    """Views of a coloured texture sliding by."""
    texture = np.random.default_rng(seed).integers(0, 256, (72, 128 + 2 * images, 3), np.uint8)
    texture = cv2.GaussianBlur(texture, (0, 0), 3) * np.array([1.0, 0.8, 0.5])
    return [texture[:, 2 * i : 2 * i + 128].astype(np.uint8) for i in range(images)]


def test_off_by_default() -> None:
    image = flight(1)[0]
    same, kind = perturb_share(image, PerturbationSettings(), 0)
    assert same is image
    assert kind is None


def test_the_share_grows_with_clock_speed_from_none_to_all_of_it() -> None:
    shares = [share_at(clock_speed, 0.08, 25.0) for clock_speed in (0.5, 1.0, 6.0, 26.0, 76.0, 1e9)]
    assert shares == pytest.approx([0.0, 0.0, 0.08 / 6, 0.04, 0.06, 0.08])
    assert share_at(1.0, 0.08, None) == share_at(100.0, 0.08, None) == 0.08


def test_share_and_kinds_are_met_and_follow_the_seed() -> None:
    image, settings = flight(1)[0], PerturbationSettings(share=0.2, seed=3)
    kinds = [perturb_share(image, settings, i)[1] for i in range(2000)]
    assert kinds == [perturb_share(image, settings, i)[1] for i in range(2000)]
    assert 2000 - kinds.count(None) == pytest.approx(400, abs=4 * 320**0.5)
    for kind in PerturbationKind:
        assert kinds.count(kind) == pytest.approx(100, abs=40)


@pytest.mark.parametrize("kind", PerturbationKind)
def test_a_perturbed_image_is_a_changed_copy(kind: PerturbationKind) -> None:
    image = flight(1)[0]
    before = image.copy()
    changed = perturb(image, kind, np.random.default_rng(1))
    np.testing.assert_array_equal(image, before)
    assert (changed.shape, changed.dtype) == (image.shape, image.dtype)
    assert (changed != image).any()


def test_a_changed_image_follows_its_index_and_its_seed() -> None:
    image, salt = flight(1)[0], (PerturbationKind.SALT_AND_PEPPER,)
    settings = PerturbationSettings(share=1.0, kinds=salt, seed=3)
    [once, again, next_, other] = [
        perturb_share(image, changed, index)
        for changed, index in (
            (settings, 0), (settings, 0), (settings, 1), (PerturbationSettings(1.0, salt, seed=4), 0),
        )
    ]  # fmt: skip
    assert {kind for _, kind in (once, again, next_, other)} == set(salt)
    np.testing.assert_array_equal(once[0], again[0])
    assert (once[0] != next_[0]).any()
    assert (once[0] != other[0]).any()


def test_brightness_is_a_gain_that_darkens_as_often_as_it_brightens() -> None:
    """0.4 to 0.8 or 1.25 to 2, evenly, and clipped."""
    rng, image = np.random.default_rng(2), np.zeros((2, 2, 3), np.uint8)
    image[0, 0], image[1, 1] = 100, 250
    changed = np.array([perturb(image, PerturbationKind.BRIGHTNESS, rng) for _ in range(4000)], float)
    gains = changed[:, 0, 0, 0] / 100
    assert not changed[:, 0, 1].any()
    np.testing.assert_allclose(changed[:, 1, 1, 1], np.minimum(250 * gains, 255), atol=2.0)
    darker, brighter = gains[gains < 1], gains[gains > 1]
    assert len(darker) == pytest.approx(2000, abs=130)
    for group, low, high in ((darker, 0.4, 0.8), (brighter, 1.25, 2.0)):
        assert (group.min(), group.max()) == pytest.approx((low, high), abs=0.006)
        assert group.mean() == pytest.approx((low + high) / 2, abs=4 * (high - low) / 12**0.5 / 2000**0.5)


def test_colours_are_every_wrong_order_of_the_channels_equally_often() -> None:
    rng = np.random.default_rng(2)
    image = np.array([[[10, 20, 30]]], np.uint8)
    orders = Counter(tuple(perturb(image, PerturbationKind.COLOURS, rng)[0, 0].tolist()) for _ in range(2000))
    assert set(orders) == set(permutations((10, 20, 30))) - {(10, 20, 30)}
    assert min(orders.values()) > 400 - 4 * 320**0.5


def test_an_empty_image_is_black() -> None:
    assert not perturb(flight(1)[0], PerturbationKind.EMPTY, np.random.default_rng(0)).any()


def test_salt_and_pepper_hit_their_share_of_the_pixels() -> None:
    grey = np.full((400, 400, 3), 90, np.uint8)
    noisy = perturb(grey, PerturbationKind.SALT_AND_PEPPER, np.random.default_rng(1))
    for level in (0, 255):  # all three channels of a pixel, black as often as white
        assert (noisy == level).all(axis=2).mean() == pytest.approx(0.05 / 2, rel=0.1)
    assert (noisy == 90).all(axis=2).mean() == pytest.approx(0.95, rel=0.01)


# --- auto-exposure ----------------------------------------------------------------------------------------------------


S = 1_000_000_000


def level_image(level: int) -> np.ndarray:
    return np.full((4, 6), level, np.uint8)


@pytest.mark.parametrize(
    ("seen", "stops"),  # levels and the seconds that ran before each
    [
        ([(80, 5), (80, 9)], 0.0),
        ([(200, 0), (20, 0.1), (20, 0.2), (20, 0.3)], 0.9),  # each counts from the one before it
        ([(80, 2), (40, 2.1)], 0.3),  # half as bright: one stop up at 3 stops per second
        ([(80, 2), (40, 3)], 1.0),  # and no further than that
        ([(80, 0), (40, 0.01)], 0.03),  # a second at 100x
        ([(80, 2), (160, 2.1)], -0.1),  # down at 1 stop per second
        ([(80, 2), (160, 2)], 0.0),  # a pause holds it
        ([(80, 2), (5, 62)], 2.0),  # 4 stops are more than there are
        ([(80, 2), (0, 2.1)], 0.3),  # night too
    ],
)
def test_it_follows_by_so_many_stops_per_second(seen: list[tuple[int, float]], stops: float) -> None:
    exposure = AutoExposure()
    images = [exposure.expose(level_image(level), round(ran_s * S)) for level, ran_s in seen]
    assert exposure.stops == pytest.approx(stops)
    assert (images[0] == seen[0][0]).all()
    assert (images[-1] == round(seen[-1][0] * 2**stops)).all()


def test_bright_pixels_saturate_and_colours_keep_their_order() -> None:
    exposure = AutoExposure()
    exposure.expose(np.full((2, 2, 3), 100, np.uint8), 0)
    image = exposure.expose(np.array([[[20, 40, 60], [20, 40, 200]]], np.uint8), 10 * S)
    assert image[0, 1, 2] == 255
    assert image[0, 0, 0] < image[0, 0, 1] < image[0, 0, 2]


def camera_of(*levels: int, **settings: Any) -> CameraClient:
    """A camera at 10x that is given pictures of these levels, one after the other."""
    images = map(level_image, levels)
    return CameraClient(Mock(clock_speed=10.0, image=lambda kind, size: next(images)), **settings)


def test_a_camera_is_exposed_for_the_time_that_it_ran() -> None:
    """At 10x a simulated second is a tenth of one: three tenths of a stop up, as the picture is half as bright."""
    exposure = AutoExposure()
    camera = camera_of(80, 40, guard=GuardSettings(max_retries=0), exposure=exposure)
    for time_ns in (0, S):
        sample = camera.read_sample(replace(AT_REST, time_ns=time_ns))
    assert exposure.stops == pytest.approx(0.3)
    assert (sample.image == round(40 * 2**0.3)).all()


def test_a_cameras_picture_is_compared_with_that_of_the_sample_before() -> None:
    camera = camera_of(80, 120, 82, 120, 121)
    samples = [camera.read_sample(AT_REST) for _ in range(2)]
    assert [(int(sample.image[0, 0]), sample.retries) for sample in samples] == [(80, 0), (82, 1)]
    depth = camera_of(80, 120, kind="depth")
    assert [depth.read_sample(AT_REST).retries for _ in range(2)] == [0, 0]
