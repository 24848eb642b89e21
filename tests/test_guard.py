"""The image guard: what it accepts, refuses, and falls back on."""

import itertools
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from uavaccel.vision.guard import GuardSettings, GuardState, Verdict, acquire, judge, mean_brightness

AIRSIM = GuardSettings(accept_identical=False)


def grey(level: float) -> NDArray[np.uint8]:
    return np.full((6, 8, 3), level, np.uint8)


def camera(images: Iterable[NDArray]) -> Callable[[], NDArray]:
    return iter(images).__next__


def test_first_image_needs_only_to_be_bright_enough() -> None:
    assert acquire(GuardState(), camera([grey(10)])).reason is Verdict.STEADY
    taken = acquire(GuardState(), camera([grey(9), grey(200)]))
    assert (taken.image[0, 0, 0], taken.retries) == (200, 1)


@pytest.mark.parametrize(("level", "verdict"), [(110, "steady"), (90, "steady"), (111, "retry"), (89, "retry")])
def test_ten_percent_either_way_are_accepted(level: int, verdict: str) -> None:
    assert judge(GuardState(100.0), grey(level), GuardSettings())[1] == verdict


def test_a_perturbed_image_is_requested_again_and_the_next_accepted() -> None:
    taken = acquire(GuardState(100.0), camera([grey(0), grey(160), grey(101)]))
    assert (taken.image[0, 0, 0], taken.retries, taken.reason) == (101, 2, Verdict.STEADY)
    assert taken.state.reference_brightness == pytest.approx(101.0)
    assert taken.state.suspect is None


def test_fallback_is_the_last_received_image_and_becomes_the_reference() -> None:
    taken = acquire(GuardState(100.0), camera([grey(200), grey(201), grey(202), grey(203)]), AIRSIM)
    assert (taken.image[0, 0, 0], taken.retries, taken.reason) == (203, 3, Verdict.EXHAUSTED)
    assert acquire(taken.state, camera([grey(205)]), AIRSIM).retries == 0


def test_identical_re_render_is_accepted_at_once_in_native_alone() -> None:
    bright = [grey(200) for _ in range(4)]
    native = acquire(GuardState(100.0), camera(bright))
    assert (native.retries, native.reason) == (1, Verdict.IDENTICAL)
    assert acquire(GuardState(100.0), camera(bright), AIRSIM).reason is Verdict.EXHAUSTED


def test_a_camera_that_reuses_its_buffer_is_not_taken_for_an_identical_image() -> None:
    buffer, levels = grey(0), iter([200, 100])

    def request() -> NDArray:
        buffer[:] = next(levels)
        return buffer

    assert acquire(GuardState(100.0), request).reason is Verdict.STEADY


def test_an_image_is_identical_to_the_one_just_before_alone() -> None:
    taken = acquire(GuardState(100.0), camera([grey(200), grey(201), grey(200), grey(200)]))
    assert (taken.retries, taken.reason) == (3, Verdict.IDENTICAL)
    other = grey(200)
    other[0, 0, 0] += 1  # of almost the same brightness
    taken = acquire(GuardState(100.0), camera([grey(200), other, grey(100)]))
    assert (taken.retries, taken.reason) == (2, Verdict.STEADY)


def test_suspects_leave_the_reference_as_it_is_and_the_accepted_one_becomes_it() -> None:
    state, verdict = judge(GuardState(100.0), grey(200), GuardSettings())
    assert (verdict, state.reference_brightness, state.retries) == (Verdict.RETRY, 100.0, 1)
    state, verdict = judge(state, grey(200), GuardSettings())
    assert (verdict, state.retries, state.suspect) == (Verdict.IDENTICAL, 0, None)
    assert state.reference_brightness == pytest.approx(200.0)


@pytest.mark.parametrize(
    ("settings", "level", "verdict"),
    [
        (GuardSettings(max_change=0.5), 149, "steady"),
        (GuardSettings(max_change=0.5), 151, "retry"),
        (GuardSettings(max_change=0.5, min_brightness=60), 59, "retry"),
        (GuardSettings(max_change=0.5, min_brightness=60), 60, "steady"),
        (GuardSettings(max_change=0.0), 100, "steady"),
    ],
)
def test_limits_are_relative_to_the_reference_and_the_floor_is_absolute(
    settings: GuardSettings, level: int, verdict: str
) -> None:
    reference = mean_brightness(grey(100))
    assert judge(GuardState(reference), grey(level), settings)[1] == verdict


def test_without_retries_every_image_is_taken() -> None:
    off = GuardSettings(max_retries=0)
    assert acquire(GuardState(100.0), camera([grey(0)]), off).retries == 0


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
