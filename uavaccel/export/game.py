"""What a log of one game says, whichever suite flew it: poses, commands, pictures, events, collision."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from uavaccel.commands.paths import velocities
from uavaccel.commands.slices import samples_due
from uavaccel.config import validate
from uavaccel.envs.camera_client import FlightSample
from uavaccel.envs.observer import Game, Observer
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import EXACT
from uavaccel.errors import UserError
from uavaccel.forms import MEND
from uavaccel.records import RunDirectory
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.profile import PROFILES
from uavaccel.suites.dp1 import Dp1, Dp1Config
from uavaccel.suites.dp2 import Dp2Config
from uavaccel.suites.evaluation.again import evaluation_of, fly_again
from uavaccel.suites.evaluation.film import SamplesSeen, SecondEventCamera, Seen
from uavaccel.suites.evaluation.flights import EvaluateRow
from uavaccel.suites.old_report import Arrays
from uavaccel.suites.rows import Row
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs import PRESETS, make_sensor
from uavaccel.vision.event_counter import EventCounter

Times = NDArray[np.int64]
FRAME_NS, WINDOW_NS = 10_000_000, 50_000_000  # of the event camera beside the agent's own


class Window(NamedTuple):
    """Events up to `time_ns`, since the window before: rows (n, 4), t in s, x, y, p = 1 or -1.

    `counts`, ON and OFF per pixel, stands in where a run kept counts alone.
    """

    time_ns: int
    rows: NDArray[np.floating] | None
    counts: tuple[NDArray[np.integer], NDArray[np.integer]] | None = None

    def per_pixel(self) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        """ON and OFF events of each pixel."""
        if self.counts is not None:
            return self.counts
        on, off = np.zeros((2, HEIGHT, WIDTH), np.int32)
        if self.rows is not None:
            x, y = self.rows[:, 1].astype(int), self.rows[:, 2].astype(int)
            positive = self.rows[:, 3] > 0
            np.add.at(on, (y[positive], x[positive]), 1)
            np.add.at(off, (y[~positive], x[~positive]), 1)
        return on, off


@dataclass(frozen=True)
class GameLog:
    """One game; times in integer ns of simulated time since its start, NED metres, orientations body FRD to NED."""

    time_ns: Times
    position_m: NDArray[np.float64]
    orientation_wxyz: NDArray[np.float64]
    command_ns: Times
    """When each command began; of DP2 and evaluations: the sample that it followed."""
    command_m_s: NDArray[np.float64]
    """(c, 3) NED."""
    velocity_m_s: NDArray[np.float64] | None = None
    image_ns: Times = field(default_factory=lambda: np.zeros(0, np.int64))
    images: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 0), np.uint8))
    """(n, H, W) gray, or (n, H, W, 3) RGB."""
    windows: tuple[Window, ...] = ()
    collision: tuple[int, str] | None = None


def read_game(run: RunDirectory, row: Row) -> GameLog:
    """Return the game of that row: from its arrays, or, an evaluation's, flown again.

    Raises UserError for a run that keeps no flights, and where a game cannot be flown again.
    """
    suite = run.config().get("suite")
    if suite == "dp1":
        return _of_dp1(run, row)
    if suite == "dp2":
        return _of_dp2(run, row)
    if suite == "evaluate":
        return _of_evaluation(run, row)
    raise UserError(f"{run.path}: a run of {suite} keeps no flights to log; dp1, dp2 and evaluate do")


def _ns(seconds: NDArray[np.float64]) -> Times:
    return np.rint(seconds * NS_PER_S).astype(np.int64)


def _of_dp1(run: RunDirectory, row: Row) -> GameLog:
    config = validate(Dp1Config, run.config(), str(run.path / "config.yaml"))
    case = next((each for each in Dp1().cases(config) if each.id == row["case"]), None)
    if case is None:
        raise UserError(f"{run.path / 'rows.jsonl'}: {row['case']}: is no game of config.yaml; {MEND}")
    arrays = run.load_arrays(row)
    began = _ns(arrays["command_start_s"])
    asked = np.array(velocities(case.path, case.rounds, config.speed_m_s), np.float64)
    return GameLog(
        _ns(arrays["time_s"]),
        arrays["position_m"],
        arrays["orientation_wxyz"],
        began,
        asked[: len(began)],
        arrays["linear_velocity_m_s"],
    )


def _of_dp2(run: RunDirectory, row: Row) -> GameLog:
    config = validate(Dp2Config, run.config(), str(run.path / "config.yaml"))
    arrays = run.load_arrays(row)
    time_ns, flat = _ns(arrays["time_s"]), arrays["command_velocity_m_s"]
    slots = len(samples_due(config.t_move_s, config.t_sample_s))
    began = np.searchsorted(arrays["sample_index"], np.arange(len(flat)) * slots)
    collision = row["collision"]
    return GameLog(
        time_ns,
        arrays["position_m"],
        arrays["orientation_wxyz"],
        time_ns[began],
        np.column_stack([flat, np.zeros(len(flat))]),
        image_ns=time_ns,
        images=arrays.get("colour", arrays["image"]),
        windows=tuple(_dp2_windows(config, arrays, time_ns)),
        collision=collision and (round(collision["time_s"] * NS_PER_S), collision["object"]),
    )


def _dp2_windows(config: Dp2Config, arrays: Arrays, time_ns: Times) -> Iterator[Window]:
    """Yield those between one picture and the next; as counts where the camera counted at a rate of its own."""
    if "dvs_on" in arrays:
        for at, on, off in zip(time_ns.tolist(), arrays["dvs_on"], arrays["dvs_off"], strict=True):
            yield Window(at, None, (on, off))
        return
    images = arrays["image"]
    sensor = make_sensor(PRESETS[config.dvs_preset], images.shape[1:], config.sensor_seed)
    counter = EventCounter(sensor, listed=True)
    counter.start(images[0], int(time_ns[0]), config.sensor_seed)
    for image, at in zip(images[1:], time_ns[1:].tolist(), strict=True):
        counter.look(image, at)
        yield Window(at, counter.take_events())


class _Onlooker(SamplesSeen):
    """The samples of a game, the start among them, and what ended it."""

    hit: tuple[int, str] | None = None

    def game_begun(self, game: Game) -> None:
        super().game_begun(game)
        start = game.start
        self.hit = None
        picture = game.picture(start.time_ns)
        self.samples.append(Seen(start.time_ns, picture, start.position_m, start.orientation_wxyz, 0))

    def sample_taken(self, sample: FlightSample, command: int) -> None:
        super().sample_taken(sample, command)
        if sample.collision:
            self.hit = (sample.collision["time_ns"], sample.collision["object"])


def _of_evaluation(run: RunDirectory, row: Row) -> GameLog:
    config = evaluation_of(run, "--mcap")
    if config.simulator != EXACT:
        raise UserError(
            f"{run.path}: simulator = {config.simulator!r} keeps no poses to log; evaluate with simulator mujoco"
        )
    task, onlooker = config.task, _Onlooker()
    camera = SecondEventCamera(task, max(1, FRAME_NS // PROFILES[task.profile].tick_ns))
    environment = ObstacleLane(**task.model_dump(mode="json"))
    observers: tuple[Observer, ...] = (onlooker, camera)
    for observer in observers:
        environment.add_observer(observer)
    asked = []
    try:
        # A command is stamped with the sample that it was decided on.
        for step in fly_again(run, config, environment, cast(EvaluateRow, row)):
            asked.append(environment.episode_task.velocity_goal(step.action).velocity_m_s)
        events, seen, hit = camera.events.take_events(), onlooker.samples, onlooker.hit
    finally:
        environment.close()
    start_ns = seen[0].time_ns
    time_ns = np.array([each.time_ns - start_ns for each in seen], np.int64)
    of_command = np.array([each.command for each in seen[1:]])
    began = [int(time_ns[np.searchsorted(of_command, command)]) for command in range(len(asked))]
    return GameLog(
        time_ns,
        np.array([each.position_m for each in seen], np.float64),
        np.array([each.orientation_wxyz for each in seen], np.float64),
        np.array(began, np.int64),
        np.array(asked, np.float64),
        image_ns=time_ns,
        images=np.stack([each.image for each in seen]),
        windows=tuple(_windows(events, int(time_ns[-1]))),
        collision=hit and (hit[0] - start_ns, hit[1]),
    )


def _windows(events: NDArray[np.floating], last_ns: int) -> Iterator[Window]:
    """Events sorted by their frame, by windows of WINDOW_NS; the last one ends with the game."""
    ends = [*range(WINDOW_NS, last_ns, WINDOW_NS), last_ns]
    time_ns = _ns(events[:, 0].astype(np.float64))
    cuts = np.searchsorted(time_ns, np.array(ends), side="right")
    for end, first, last in zip(ends, [0, *cuts[:-1]], cuts, strict=True):
        yield Window(end, events[first:last])
