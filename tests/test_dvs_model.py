"""Every parameter of the event camera, against a pixel written out here, against statistics, and between samples."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.opengl import needs_opengl
from tests.running import configured, fly_into
from uavaccel.config import validate
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.flight import of_velocity
from uavaccel.sim.lane import lane_seed, sample_layout
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
from uavaccel.suites.dp2 import Dp2
from uavaccel.suites.evaluate import EvaluateConfig, Evaluation
from uavaccel.units import to_ns
from uavaccel.vision import dvs, noise
from uavaccel.vision.dvs import PRESETS, EventCounter, count_events, make_sensor, sensor_from_maps

SHAPE = (144, 256)
PIXELS = SHAPE[0] * SHAPE[1]
EXACT = replace(dvs.PRESETS["clean"], threshold_sigma=0.0)
TIMES_S = np.array([0.0, 0.05, 0.4, 0.401, 1.0, 1.02])  # uneven


def grey(level: int) -> NDArray[np.uint8]:
    return np.full(SHAPE, level, np.uint8)


def lin_log(intensity: int) -> float:
    return intensity * math.log(20) / 20 if intensity <= 20 else math.log(intensity)


Event = tuple[float, int]


class Pixel:
    """v2e's pixel: a log intensity remembered, and an event for each threshold passed; its random numbers are given."""

    def __init__(self, parameters: dvs.DvsParameters, maps: NDArray[np.float64], is_hot: bool, first: int) -> None:
        self.parameters, self.is_hot = parameters, is_hot
        self.up, self.down, self.leak = maps.tolist()
        self.base = self.filtered = lin_log(first)
        self.last_s = -math.inf

    def change(self, intensity: int, dt_s: float, normal: float) -> int:
        """Whole thresholds between what is seen and what is remembered; the last frame was `dt_s` ago."""
        p, weight = self.parameters, 1.0
        if p.cutoff_hz > 0:
            weight = min(1.0, (intensity + 20) / 275 * dt_s * 2 * math.pi * p.cutoff_hz)
        self.filtered += weight * (lin_log(intensity) - self.filtered)
        leak_hz = p.leak_rate_hz * self.leak * (1 - p.leak_jitter_fraction * normal)
        self.base -= dt_s * (leak_hz + 10.0 * self.is_hot) * self.up
        difference = self.filtered - self.base
        return math.floor(difference / self.up) if difference > 0 else -math.floor(-difference / self.down)

    def emit(self, count: int, stamps_s: NDArray[np.float64], refractory_s: float) -> list[Event]:
        sign, events = (1 if count > 0 else -1), []
        for stamp_s in stamps_s[: abs(count)]:
            if refractory_s and stamp_s - self.last_s <= refractory_s:
                continue
            if refractory_s:
                self.last_s = stamp_s
            self.base += self.up if sign > 0 else -self.down
            events.append((float(stamp_s), sign))
        return events

    def shot(self, intensity: int, dt_s: float, draw: float) -> list[int]:
        """The signs of a frame's noise, after which what is seen is remembered."""
        p = self.parameters
        chance = p.shot_noise_rate_hz / 2 * dt_s * (1 - 0.75 * (intensity + 20) / 275)
        on = draw > 1 - chance * p.positive_threshold / self.up
        signs = [1] * on + [-1] * (draw < chance * p.negative_threshold / self.down)
        self.base = self.filtered if signs else self.base
        return signs


NOISE = {
    "cutoff_hz": 6.0, "leak_rate_hz": 1.5, "leak_jitter_fraction": 0.5, "refractory_s": 0.0613,
    "shot_noise_rate_hz": 6.0, "hot_share": 0.3, "positive_threshold": 0.3,
}  # fmt: skip


@pytest.mark.parametrize("seed", range(10))
def test_every_event_of_a_pixel(seed: int) -> None:
    """With some of what a sensor may have; no event comes before the first frame: none is too early after one."""
    rng = np.random.default_rng(seed)
    parameters = replace(EXACT, **{key: most for key, most in NOISE.items() if rng.random() < 0.6})
    times_s = 2.0 * (seed % 2) + TIMES_S
    frames = rng.integers(0, 256, (len(times_s), 5, 6), np.uint8)
    maps = rng.uniform((0.1, 0.3, 0.5), (0.2, 0.5, 2.0), (5, 6, 3))
    hot = rng.random((5, 6)) < parameters.hot_share
    sensor = dvs.sensor_from_maps(parameters, *maps.transpose(2, 0, 1))._replace(hot=hot if hot.any() else None)
    state = dvs.init_state(sensor, frames[0], times_s[0], seed)
    pixels = {
        place: Pixel(parameters, maps[place], bool(hot[place]), int(frames[0][place])) for place in np.ndindex(5, 6)
    }
    for number, (before_s, now_s) in enumerate(pairwise(times_s.tolist()), 1):
        frame, dt_s = frames[number], now_s - before_s
        normals = noise.normal((5, 6), seed, number, noise.LEAK_JITTER)
        draws = noise.uniform((5, 6), seed, number, noise.SHOT_NOISE)
        state, on, off, events = dvs.step_with_events(sensor, state, frame, now_s)
        counts = {place: each.change(int(frame[place]), dt_s, float(normals[place])) for place, each in pixels.items()}
        most = max(1, *(abs(count) for count in counts.values()))
        stamps_s = before_s + dt_s * np.arange(1, most + 1) / most
        refractory_s = parameters.refractory_s if parameters.refractory_s > dt_s / most else 0.0
        for place, pixel in pixels.items():
            expected = pixel.emit(counts[place], stamps_s, refractory_s)
            expected += [(now_s, sign) for sign in pixel.shot(int(frame[place]), dt_s, float(draws[place]))]
            here = events[(events[:, 2] == place[0]) & (events[:, 1] == place[1])]
            np.testing.assert_allclose(here[:, [0, 3]], np.array(expected).reshape(-1, 2), rtol=1e-6)
            assert [on[place], off[place]] == [sum(each == sign for _, each in expected) for sign in (1, -1)]
        assert state.time_s == now_s


def test_thresholds_spread_by_sigma_around_their_own_nominal_values() -> None:
    """They belong to the seed, and are at least a hundredth."""
    parameters = replace(EXACT, positive_threshold=0.3, negative_threshold=0.5, threshold_sigma=0.04)
    sensor = dvs.make_sensor(parameters, SHAPE, seed=4)
    for map_, nominal in ((sensor.positive_threshold, 0.3), (sensor.negative_threshold, 0.5)):
        assert map_.mean() == pytest.approx(nominal, abs=4 * 0.04 / PIXELS**0.5)
        assert map_.std() == pytest.approx(0.04, rel=0.03)
    assert abs(np.corrcoef(sensor.positive_threshold.ravel(), sensor.negative_threshold.ravel())[0, 1]) < 0.03
    same, other = (dvs.make_sensor(parameters, SHAPE, seed).positive_threshold for seed in (4, 5))
    np.testing.assert_array_equal(sensor.positive_threshold, same)
    assert (sensor.positive_threshold != other).any()
    wide = dvs.make_sensor(replace(parameters, threshold_sigma=0.2), SHAPE, seed=4)
    assert wide.positive_threshold.min() == np.float32(0.01)
    flat = dvs.make_sensor(replace(parameters, threshold_sigma=0.0), SHAPE, seed=4)
    assert (flat.positive_threshold == np.float32(0.3)).all()
    assert (flat.negative_threshold == np.float32(0.5)).all()


def test_leak_rates_spread_by_decades_around_one() -> None:
    sensor = dvs.make_sensor(replace(EXACT, leak_rate_hz=0.1, leak_rate_spread_decades=0.25), SHAPE, seed=4)
    decades = np.log10(sensor.leak_rate_factor)
    assert decades.std() == pytest.approx(0.25, rel=0.03)
    assert decades.mean() == pytest.approx(0.0, abs=4 * 0.25 / PIXELS**0.5)


def test_shot_noise_is_listed_at_the_last_stamp_where_it_hit() -> None:
    sensor = dvs.make_sensor(replace(EXACT, shot_noise_rate_hz=3.0), SHAPE, seed=0)
    _, on, off, events = dvs.step_with_events(sensor, dvs.init_state(sensor, grey(60)), grey(60), 0.1)
    assert (events[:, 0] == np.float32(0.1)).all()
    for counts, polarity in ((on, 1), (off, -1)):
        rows, columns = np.nonzero(counts)
        np.testing.assert_array_equal(events[events[:, 3] == polarity][:, 1:3], np.stack([columns, rows], axis=1))


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_depends_on_the_seed_and_not_on_the_sensors(seed: int) -> None:
    parameters = replace(EXACT, shot_noise_rate_hz=2.0)

    def step(sensor_seed: int, noise_seed: int) -> NDArray:
        sensor = dvs.make_sensor(parameters, SHAPE, sensor_seed)
        state, _, _ = dvs.step(sensor, dvs.init_state(sensor, grey(9), noise_seed=noise_seed), grey(9), 0.3)
        return dvs.step(sensor, state, grey(9), 0.6)[1]  # of a later frame: the seed is carried on

    np.testing.assert_array_equal(step(seed, 5), step(seed + 1, 5))
    assert (step(seed, 5) != step(seed, 6)).any()
    images, times_ns = np.stack([grey(9)] * 3), np.array([0, 300_000_000, 600_000_000])
    on, _ = count_events(images, times_ns, parameters, seed)  # whose noise is of the sensor's seed
    np.testing.assert_array_equal(on[2], step(seed + 1, seed))


# --- faster than the samples ------------------------------------------------------------------------------------------


LANE, TICK_S = 3, 0.002
AHEAD = 2


def frames_of(commands: int, ticks: int, every: int) -> dict[int, NDArray[np.uint8]]:
    """The gray pictures of every so many ticks of a flight straight ahead, taken without the environment."""
    world = World("lane", NATIVE)
    world.set_lane(sample_layout(lane_seed("training", LANE)))
    world.reset((0.0, 0.0, -2.0))
    camera = world.camera(256, 144)
    frames = {0: camera.gray(world.data)}
    for command in range(commands):
        world.lead.set_goal(of_velocity(VelocityGoal((1.0, 0.0, 0.0), -2.0)))
        world.lead.hold_from(None)
        for tick in range(every, ticks + 1, every):
            world.advance(every)
            frames[command * ticks + tick] = camera.gray(world.data)
    world.close()
    return frames


class Pixels:
    """v2e's clean pixel in plain numpy: lin-log intensity, whole thresholds of change, the remainder kept."""

    def __init__(self, first: NDArray[np.uint8]) -> None:
        sensor = make_sensor(PRESETS["clean"], first.shape, 0)
        self.positive, self.negative = sensor.positive_threshold, sensor.negative_threshold
        self.base = self.log(first)

    @staticmethod
    def log(frame: NDArray[np.uint8]) -> NDArray[np.float32]:
        x = frame.astype(np.float64)
        return np.round(np.where(x <= 20, x * np.log(20) / 20, np.log(np.maximum(x, 1))), 8).astype(np.float32)

    def count(self, frame: NDArray[np.uint8]) -> tuple[NDArray[Any], NDArray[Any]]:
        change = self.log(frame) - self.base
        on = np.floor_divide(np.maximum(change, 0), self.positive).astype(np.int32)
        off = np.floor_divide(np.maximum(-change, 0), self.negative).astype(np.int32)
        self.base = self.base + on.astype(np.float32) * self.positive - off.astype(np.float32) * self.negative
        return on, off


@needs_opengl
@pytest.mark.slow
@pytest.mark.parametrize(("rate_hz", "commands", "samples"), [(500.0, 1, (50, 100, 150)), (100.0, 2, (165, 330, 500))])
def test_every_frame_between_two_samples_counts(rate_hz: float, commands: int, samples: tuple[int, ...]) -> None:
    """With a command's samples in ticks."""
    every, ticks = round(1 / (rate_hz * TICK_S)), samples[-1]
    frames = frames_of(commands, ticks, every)
    pixels, images = Pixels(frames[0]), []
    events_on = events_off = 0
    for first in range(0, commands * ticks, ticks):
        start = first
        for end in (first + sample for sample in samples):
            counts = [pixels.count(frames[tick]) for tick in range(start + every, end + 1, every)]
            on, off = (np.sum(each, axis=0) for each in zip(*counts, strict=True))
            events_on, events_off = events_on + on.sum(), events_off + off.sum()
            blocks = (on - off).reshape(36, 4, 64, 4).sum(axis=(1, 3))
            images.append(np.clip(128 + blocks, 0, 255))
            start = end
    times: dict[str, Any] = {"t_move_s": ticks * TICK_S, "t_sample_s": samples[0] * TICK_S}
    with closing(ObstacleLane(dvs_rate_hz=rate_hz, list_events=True, **times)) as environment:
        environment.reset(seed=0, options={"lane": LANE})
        seen = np.concatenate([environment.step(AHEAD)[0] for _ in range(commands)])
        events = environment.pop_events()
        assert not len(environment.pop_events())
    np.testing.assert_array_equal(seen, images)
    assert ((events[:, 3] > 0).sum(), (events[:, 3] < 0).sum()) == (events_on, events_off)
    assert (np.diff(events[:, 0]) >= 0).all()
    assert len(np.unique(events[:, 0])) > 100 * commands  # stamps of their own, not those of the samples
    assert 0.0 < events[0, 0] <= events[-1, 0] <= commands * ticks * TICK_S


@needs_opengl
def test_a_faster_camera_does_not_change_the_flight() -> None:
    with closing(ObstacleLane()) as slow, closing(ObstacleLane(dvs_rate_hz=50.0)) as fast:
        infos = []
        for environment in (slow, fast):
            environment.reset(seed=1)
            infos.append([environment.step(action)[4] for action in (2, 0, 4)])
        assert infos[0] == infos[1]


LEVELS = (100, 170, 110, 170)  # of which a threshold of 0.2 makes 2 ON, 1 OFF and 1 ON


def even(level: int) -> NDArray[np.uint8]:
    return np.full((2, 3), level, np.uint8)


def counter_after(looks: int, listed: bool = True) -> EventCounter:
    """A counter that began 5 s into a flight, and looked every 0.1 s."""
    thresholds = np.full((2, 3), 0.2)
    counter = EventCounter(sensor_from_maps(PRESETS["clean"], thresholds, thresholds), listed)
    counter.start(even(LEVELS[0]), 5_000_000_000)
    for number in range(1, looks + 1):
        counter.process_frame(even(LEVELS[number]), 5_000_000_000 + number * 100_000_000)
    return counter


def counted(counter: EventCounter) -> tuple[list[int], ...]:
    """The ON and the OFF counts, each of all pixels."""
    return tuple(np.unique(counts).tolist() for counts in counter.take())


@pytest.mark.parametrize(("looks", "expected"), [(0, ([0], [0])), (1, ([2], [0])), (2, ([2], [1])), (3, ([3], [1]))])
def test_a_counter_adds_up_what_it_has_seen_since_it_was_asked(looks: int, expected: tuple[list[int], ...]) -> None:
    counter = counter_after(looks)
    seen_ns = 5_000_000_000 + looks * 100_000_000
    assert (counter.frames, counter.has_frame_of(seen_ns)) == (looks, looks > 0)
    assert not counter.has_frame_of(seen_ns - 100_000_000)
    assert counted(counter) == expected
    assert not counter.has_frame_of(seen_ns), "not since it was asked"
    assert counted(counter) == ([0], [0])
    events = counter.pop_events()
    stamps_s = [0.05, 0.1, 0.2, 0.3]  # from its beginning; of the two ON events one is halfway
    assert np.unique(events[:, 0]) == pytest.approx(stamps_s[: looks + 1 if looks else 0])
    assert events[:, 3].sum() == 6 * (expected[0][0] - expected[1][0])
    assert len(counter.pop_events()) == 0


def test_a_counter_begins_anew_with_nothing_seen() -> None:
    counter = counter_after(2)
    counter.start(even(170), 7_000_000_000)
    assert not counter.has_frame_of(5_200_000_000)
    assert (counted(counter), len(counter.pop_events())) == (([0], [0]), 0)
    counter.process_frame(even(170), 7_100_000_000)
    assert (counted(counter), counter.frames) == (([0], [0]), 3)


def dp2_game(*overrides: str) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Row and arrays of a short path's game."""
    config = configured("dp2", "path=[[1, 0], [0.5, 0.8]]", *overrides, clock_speed=[5.0], timing="virtual")
    (case,) = (case for case in Dp2().cases(config) if (case.role, case.command) == ("game", "adsc"))
    with Dp2().open(config, "virtual", cast(Any, None)) as session:
        flown = Dp2().fly(config, case, session)
    return flown.row, dict(flown.arrays)


@needs_opengl
def test_dp2_counts_between_its_samples_and_flies_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """An ADSC game, whose samples come late: at a frame of the grid, which is seen once, and in between."""
    row, arrays = dp2_game()
    process, seen_ns = EventCounter.process_frame, list[int]()

    def process_frame(counter: EventCounter, frame: NDArray[np.uint8], time_ns: int) -> None:
        seen_ns.append(time_ns)
        process(counter, frame, time_ns)

    monkeypatch.setattr(EventCounter, "process_frame", process_frame)
    watched_row, watched = dp2_game("dvs_rate_hz=50")
    assert watched_row == row
    assert seen_ns == sorted({*seen_ns})
    on, off = watched.pop("dvs_on"), watched.pop("dvs_off")
    assert {name: each.tobytes() for name, each in watched.items()} == {
        name: array.tobytes() for name, array in arrays.items()
    }
    assert on.shape == off.shape == arrays["image"].shape
    assert not on[0].any()
    at_samples = count_events(arrays["image"], to_ns(arrays["time_s"]), PRESETS["clean"], 0)
    for fast, slow in zip((on, off), at_samples, strict=True):
        assert fast.sum() > slow.sum()  # what comes and goes between two samples is seen too
    # Whatever was seen between, events add up to each sample's change of log intensity, but for less than one more.
    pixels = Pixels(arrays["image"][0])
    for counts in ((on, off), at_samples):
        risen, fallen = (np.cumsum(count, axis=0, dtype=np.float32) for count in counts)
        for image, up, down in zip(arrays["image"], risen, fallen, strict=True):
            rest = Pixels.log(image) - pixels.base - up * pixels.positive + down * pixels.negative
            assert (rest < pixels.positive + 1e-4).all()
            assert (-rest < pixels.negative + 1e-4).all()


@needs_opengl
def test_the_events_of_a_game_of_an_agent_that_sees_none(tmp_path: Path) -> None:
    """At the samples' own rate they are those that an agent with a DVS would have seen, summed over each frame."""
    task: dict[str, Any] = {"timing": "lockstep", "split": "evaluation", "max_commands": 2, "t_sample_s": 0.5}
    flown = {"agent": "straight", "games": 1, "task": {**task, "observation": "state"}}
    run = fly_into(tmp_path / "run", Evaluation(), validate(EvaluateConfig, flown, "test"))
    flight = Evaluation().flight(Evaluation().report(run), run.rows()[0], event_rate_hz=2.0)
    events = np.concatenate([window.rows for window in flight.windows if window.rows is not None])
    with closing(ObstacleLane(**task)) as seeing:
        seeing.reset(seed=0, options={"lane": 0})
        frames = np.concatenate([seeing.step(AHEAD)[0] for _ in range(2)]).astype(int) - 128
    counted = np.zeros((4, 36, 64), int)
    sample = np.minimum(events[:, 0] // 0.5000001, 3).astype(int)
    np.add.at(counted, (sample, events[:, 2].astype(int) // 4, events[:, 1].astype(int) // 4), events[:, 3].astype(int))
    np.testing.assert_array_equal(np.clip(counted, -128, 127), frames)
