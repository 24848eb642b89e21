"""Noise beside v2e's presets: as much as it says, another in each game, the same in the same game, none when off."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.vision import noise as numbers
from uavaccel.vision.dvs import PRESETS, DvsParameters, init_state, make_sensor, step
from uavaccel.vision.noise import ImageNoise, noise_seed

SHAPE = (144, 256)


def events_per_s(grey: int, frames_per_s: int, duration_s: float = 1.0, **keys: Any) -> NDArray[np.float64]:
    """ON and OFF events (2, H, W) per second of a sensor of a task that looks at an even grey."""
    parameters, frame = LaneTask(**keys).dvs_parameters, np.full(SHAPE, grey, np.uint8)
    sensor = make_sensor(parameters, SHAPE, 0)
    state, total = init_state(sensor, frame, noise_seed=3), np.zeros((2, *SHAPE))
    for index in range(1, round(duration_s * frames_per_s) + 1):
        state, on, off = step(sensor, state, frame, index / frames_per_s)
        total += on, off
    return total / duration_s


# --- from which numbers -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("counter", "key", "expected"), [
    ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
])  # fmt: skip
def test_random_numbers_are_those_of_philox(counter: str, key: str, expected: str) -> None:
    """Known answers of Random123 (kat_vectors, philox4x32 of 10 rounds); a frame and a seed have two words each."""
    block, low, high, stream = (int(word, 16) for word in counter.split())
    seed, seed_high = (int(word, 16) for word in key.split())
    drawn = numbers.words.py_func(np.uint64(seed_high << 32 | seed), np.uint64(high << 32 | low), stream, block)
    assert [f"{int(word):08x}" for word in drawn] == expected.split()


def test_each_use_has_a_stream_of_its_own() -> None:
    streams = (numbers.LEAK_JITTER, numbers.SHOT_NOISE, numbers.READ_NOISE, numbers.LATENCY)
    drawn = {numbers.uniform((5,), 1, 2, stream).tobytes() for stream in streams}
    assert len(drawn) == len(streams)


def test_a_row_of_noise_begins_as_a_longer_one_does() -> None:
    """By fours of one block, of which the last may be used in part."""
    for draw in (numbers.uniform, numbers.normal):
        long = draw((11,), 1, 2, 3)
        assert len({*long.tolist()}) == 11
        for length in range(1, 11):
            np.testing.assert_array_equal(draw((length,), 1, 2, 3), long[:length])


# --- how much -----------------------------------------------------------------------------------------------------


def test_hot_pixels_fire_whatever_they_see_and_others_do_not() -> None:
    for grey in (0, 200):
        on, off = events_per_s(grey, 3, 4.0, dvs_hot_pixels=0.03)
        assert not off.any()
        assert (on > 0).mean() == pytest.approx(0.03, abs=0.003)
        assert on[on > 0].mean() == pytest.approx(10.0, abs=0.15)
    assert not events_per_s(0, 3).any()


@pytest.mark.parametrize(("preset", "expected"), [
    ("clean", DvsParameters(0.4, 0.4, 0.06, 0.0, 0.5, 0.0, 0.0, 1.5, 0.0, 0.01)),
    ("constructor", DvsParameters(0.4, 0.4, 0.09, 0.0, 0.6, 0.1, 0.1, 1.5, 0.0, 0.01)),
    ("command_line", DvsParameters(0.4, 0.4, 0.09, 300.0, 0.51, 0.1, 0.1, 1.501, 0.0005, 0.01)),
    ("noisy", DvsParameters(0.4, 0.4, 0.15, 30.0, 0.6, 0.1, 0.1, 6.5, 0.0, 0.01)),
])  # fmt: skip
def test_noise_is_added_to_the_presets_own(preset: Any, expected: DvsParameters) -> None:
    """Rates are added to the preset's, thresholds and their spread multiplied; the rest stays the preset's."""
    task = LaneTask(
        dvs_preset=preset, dvs_threshold_ratio=2.0, dvs_spread_ratio=3.0, dvs_shot_noise_hz=1.5,
        dvs_leak_hz=0.5, dvs_hot_pixels=0.01,
    )  # fmt: skip
    assert astuple(task.dvs_parameters) == pytest.approx(astuple(expected))
    assert LaneTask(dvs_preset=preset).dvs_parameters == PRESETS[preset]


@pytest.mark.parametrize("shape", [SHAPE, (*SHAPE, 3)])
def test_image_noise_has_its_deviation_and_no_mean(shape: tuple[int, ...]) -> None:
    grey = np.full(shape, 120, np.uint8)
    noisy = ImageNoise(6.0, 1).add(grey, 330).astype(float) - 120
    assert noisy.mean() == pytest.approx(0.0, abs=0.1)
    assert noisy.std() == pytest.approx(np.hypot(6.0, np.sqrt(1 / 12)), rel=0.02)
    assert abs(np.corrcoef(noisy.ravel()[1:], noisy.ravel()[:-1])[0, 1]) < 0.02
    white = ImageNoise(6.0, 1).add(np.full(shape, 255, np.uint8), 0)
    assert white.dtype == np.uint8
    assert white.min() > 200


def test_image_noise_is_of_its_seed_and_moment() -> None:
    grey, game = np.full(SHAPE, 50, np.uint8), np.random.SeedSequence(5)
    noise = ImageNoise(3.0, noise_seed(game))
    np.testing.assert_array_equal(noise.add(grey, 7), ImageNoise(3.0, noise_seed(game)).add(grey, 7))
    assert (noise.add(grey, 8) != noise.add(grey, 7)).mean() > 0.5
    child, sister = np.random.SeedSequence(5).spawn(2)  # as the games of a suite are
    for another in (np.random.SeedSequence(6), child, sister, *child.spawn(1)):
        other = ImageNoise(3.0, noise_seed(another))
        assert (other.add(grey, 7) != noise.add(grey, 7)).mean() > 0.5
    assert len({noise_seed(each) for each in (game, child, sister)}) == 3
    late = ImageNoise(3.0, noise_seed(game), start_ns=1_000)  # which is the same game, begun later
    np.testing.assert_array_equal(late.add(grey, 1_007), noise.add(grey, 7))
    assert ImageNoise(0.0, 1).add(grey, 7) is grey


# --- in games -----------------------------------------------------------------------------------------------------


def flown(environment: ObstacleLane, commands: int, **reset: Any) -> list[bytes]:
    first = environment.reset(**reset)[0]
    return [first.tobytes(), *(environment.step(2)[0].tobytes() for _ in range(commands))]


@pytest.mark.opengl
@pytest.mark.parametrize(
    "noise", [{"dvs_shot_noise_hz": 1.0}, {"image_noise": 4.0}], ids=lambda noise: next(iter(noise))
)
def test_a_game_has_its_own_noise_and_always_the_same(noise: dict[str, Any]) -> None:
    """But for what a preset makes, which is that of all games."""
    with closing(ObstacleLane(**noise)) as noisy, closing(ObstacleLane(dvs_preset="noisy")) as usual:
        lane = {"lane": 3}
        first = flown(noisy, 1, seed=1, options=lane)
        assert flown(noisy, 1, options=lane)[1] != first[1]  # the same lane in the next game
        assert flown(noisy, 1, seed=1, options=lane) == first
        assert flown(usual, 1, seed=1, options=lane)[1] != first[1]
        assert flown(usual, 1, options=lane) == flown(usual, 1, seed=7, options=lane)


def test_event_noise_is_of_the_game_where_there_is_any() -> None:
    for keys in ({"dvs_shot_noise_hz": 1.0}, {"dvs_leak_hz": 0.5}):
        assert [LaneTask(**keys).events_seed(seed) for seed in (3, 4)] == [3, 4]
    assert LaneTask(dvs_hot_pixels=0.1, image_noise=3.0).events_seed(3) == 0


@pytest.mark.opengl
def test_noise_is_drawn_for_each_game_and_seen() -> None:
    ranges = {"image_noise": [2, 20], "dvs_hot_pixels": [0.01, 0.3], "dvs_shot_noise_hz": [1, 2]}
    with closing(ObstacleLane(randomise=ranges)) as environment:
        _, info = environment.reset(seed=0)
        drawn, seen = info["conditions"], environment.step(2)[0]
        assert set(drawn) == set(ranges)
        assert environment.episode_task.dvs_parameters.hot_share == drawn["dvs_hot_pixels"]
        assert environment.episode_task.dvs_parameters.shot_noise_rate_hz == drawn["dvs_shot_noise_hz"]
        lane = json.loads(json.dumps(info["lane"]))
    with closing(ObstacleLane(**drawn)) as environment:
        environment.reset(seed=0, options={"lane": lane})
        np.testing.assert_array_equal(environment.step(2)[0], seen)
