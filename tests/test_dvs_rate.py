"""An event camera faster than the samples, beside the pixel model written down once more; and files of its events."""

from __future__ import annotations

from contextlib import closing
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
from uavaccel.sim.lane.layout import lane_seed, sample_layout
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.vehicle.goal import of_velocity
from uavaccel.sim.world import World
from uavaccel.suites.dp2 import Dp2
from uavaccel.suites.evaluate import EvaluateConfig, Evaluation
from uavaccel.units import to_ns
from uavaccel.vision.dvs import PRESETS, EventCounter, count_events, make_sensor, sensor_from_maps

LANE, TICK_S, SAMPLES = 3, 0.002, (165, 330, 500)  # ticks of a command's samples
AHEAD = 2


def frames_of(commands: int, every: int) -> dict[int, NDArray[np.uint8]]:
    """The gray pictures of every so many ticks of a flight straight ahead, taken without the environment."""
    world = World("lane", NATIVE)
    world.set_lane(sample_layout(lane_seed("training", LANE)))
    world.reset((0.0, 0.0, -2.0))
    camera = world.camera(256, 144)
    frames = {0: camera.gray(world.data)}
    for command in range(commands):
        world.lead.set_goal(of_velocity(VelocityGoal((1.0, 0.0, 0.0), -2.0)))
        world.lead.hold_from(None)
        for tick in range(every, SAMPLES[-1] + 1, every):
            world.advance(every)
            frames[command * SAMPLES[-1] + tick] = camera.gray(world.data)
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
@pytest.mark.parametrize(("rate_hz", "commands"), [(500.0, 1), (100.0, 2)])
def test_every_frame_between_two_samples_counts(rate_hz: float, commands: int) -> None:
    every = round(1 / (rate_hz * TICK_S))
    frames = frames_of(commands, every)
    pixels, images = Pixels(frames[0]), []
    events_on = events_off = 0
    for first in range(0, commands * SAMPLES[-1], SAMPLES[-1]):
        start = first
        for end in (first + sample for sample in SAMPLES):
            counts = [pixels.count(frames[tick]) for tick in range(start + every, end + 1, every)]
            on, off = (np.sum(each, axis=0) for each in zip(*counts, strict=True))
            events_on, events_off = events_on + on.sum(), events_off + off.sum()
            blocks = (on - off).reshape(36, 4, 64, 4).sum(axis=(1, 3))
            images.append(np.clip(128 + blocks, 0, 255))
            start = end
    with closing(ObstacleLane(dvs_rate_hz=rate_hz, list_events=True)) as environment:
        environment.reset(seed=0, options={"lane": LANE})
        seen = np.concatenate([environment.step(AHEAD)[0] for _ in range(commands)])
        events = environment.pop_events()
        assert not len(environment.pop_events())
    np.testing.assert_array_equal(seen, images)
    assert ((events[:, 3] > 0).sum(), (events[:, 3] < 0).sum()) == (events_on, events_off)
    assert (np.diff(events[:, 0]) >= 0).all()
    assert len(np.unique(events[:, 0])) > 100 * commands  # stamps of their own, not those of the samples
    assert 0.0 < events[0, 0] <= events[-1, 0] <= commands


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
def test_dp2_counts_between_its_samples_and_flies_as_ever() -> None:
    """An ADSC game, whose samples come late: after a frame of the grid, and in between."""
    row, arrays = dp2_game()
    watched_row, watched = dp2_game("dvs_rate_hz=50")
    assert watched_row == row
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
