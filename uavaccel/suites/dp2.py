"""DP2: what the drone sees on its way through the lane, compared with real time (paper, sections III-C2b and IV-C)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Sized
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from typing_extensions import TypedDict

from uavaccel import limits
from uavaccel.commands import COMMANDS
from uavaccel.commands.slices import check_times, samples_due
from uavaccel.config import Config
from uavaccel.draw import style
from uavaccel.draw.labels import clock_label, command_at_clock
from uavaccel.draw.page import Block, Column, Heading, Picture, Table, listed, unknown
from uavaccel.envs.camera_client import CameraClient, Sample
from uavaccel.envs.task import rate_ticks
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.forms import ArrayForm, Count, Number, Positive
from uavaccel.forms import NotNegative as NonNegative
from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.limits import Seconds, Seed
from uavaccel.metrics.dvs_ed import dvs_ed_percent
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.lane.file import LaneFile, parse_lane
from uavaccel.sim.lane.layout import Difficulty, LaneLayout, Share
from uavaccel.sim.lane.path import plan_path
from uavaccel.sim.profile import PROFILES
from uavaccel.suites import plots
from uavaccel.suites.experiment import FlightExperiment, Timing, t_th_ns
from uavaccel.suites.flight import Commands, Flight, Window, windows_of
from uavaccel.suites.report import Report, Summary, finished, source_line, warnings
from uavaccel.suites.rows import FlightCase, FlightRow, Role, flight_row, named_seed, subset
from uavaccel.suites.suite import GameResult, Suite
from uavaccel.units import NS_PER_S, attitude_difference_rad, to_ns
from uavaccel.vision.dvs import PRESETS, init_state, luma, make_sensor, step
from uavaccel.vision.event_counter import EventCounter
from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.guard_study import guard_study
from uavaccel.vision.perturb import AutoExposure, PerturbationKind, PerturbationSettings, share_at
from uavaccel.wire.image_api import lane_layout

if TYPE_CHECKING:
    from uavaccel.wire.session import Session

ERRORS = ("position_error_m", "attitude_error_deg", "dvs_ed_percent")
"""Of each image against the one at the same place in the path of the same command's run at 1x."""
GUARD_SHARE, GUARD_STREAMS = 0.05, 20  # of the perturbed images; of the guard study
LEAST_PERCENT, LEAST_M = 0.1, 0.001  # below, Figure 7's axes are linear

NotNegative = Annotated[float, Field(ge=0.0)]
Velocity = tuple[limits.Velocity, limits.Velocity]
Arrays = dict[str, NDArray[Any]]


class DrawnLane(Config):
    """A lane sampled from a seed."""

    seed: Seed
    """The lane's: the same seed and difficulty make the same lane."""
    difficulty: Difficulty = Difficulty()
    """How hard the lane is, and what the weather and the vehicle are like."""


class GuardConfig(Config):
    """Limits of the image guard (uavaccel.vision.guard); `max_retries: 0` switches it off."""

    max_change: NotNegative = 0.10
    """Accepted change of mean brightness, as a share of the last image's."""
    min_brightness: NotNegative = 10.0
    """Mean brightness, from 0 to 255, below which an image is too dark."""
    max_retries: Annotated[int, Field(ge=0, le=1000)] = 3
    """How often a rejected image is asked for again."""
    accept_identical: bool = True
    """Whether an image that comes out identical when it is requested again is accepted."""

    def settings(self) -> GuardSettings:
        return GuardSettings(**self.model_dump())


class PerturbationConfig(Config):
    """A MODEL of images that are corrupted on their way (uavaccel.vision.perturb); share 0 switches it off."""

    share: Share = 0.0
    """Share of the received images that are perturbed, those requested again included."""
    half_excess: Annotated[float, Field(gt=0.0)] | None = None
    """ClockSpeed above 1 at which half of the share is reached, as a renderer has less time; without it all have it."""
    kinds: Annotated[tuple[PerturbationKind, ...], Field(min_length=1)] = tuple(PerturbationKind)
    """How images go wrong; each perturbed image draws one of them."""


class Dp2Config(FlightExperiment):
    """`suite: dp2`."""

    suite: Literal["dp2"]
    lane: Seed | DrawnLane | LaneFile = 3
    """A seed, a seed with a difficulty, or a custom lane, written out or as the name of its YAML file."""
    path: Literal["planned"] | tuple[Velocity, ...] = "planned"
    """planned: a collision-free path to the lane's end; or a list of velocities north and east, in m/s."""
    height_m: Annotated[float, Field(lt=0.0, ge=-limits.MOST_HEIGHT_M)] = -10.0
    """NED z at which the path starts, and which is held: -10 is 10 m up."""
    t_move_s: Seconds = 1.0
    """Simulated seconds of a command."""
    t_sample_s: Seconds = 0.33
    """Simulated seconds between two samples during a command."""
    reference_timing: Timing = "virtual"
    """Timing of the game at 1x that each command is compared with, unless the run flies that one anyway."""
    guard: GuardConfig = GuardConfig()
    """The check of an image's mean brightness, and what follows a rejection."""
    perturbation: PerturbationConfig = PerturbationConfig()
    """Perturbation of the games' images; those that they are compared with stay clean."""
    auto_exposure: bool = False
    """A MODEL of a game engine's auto-exposure (uavaccel.vision.exposure), in every game; the paper switched it off."""
    dvs_preset: Literal["clean", "constructor", "command_line", "noisy"] = "clean"
    """v2e's parameters of the DVS that the report applies to the images."""
    dvs_rate_hz: Annotated[float, Field(gt=0.0)] | None = None
    """Frames per simulated second that the DVS receives in flight; without it the stored images are its frames."""
    sensor_seed: Seed = 0
    """Seed of the DVS's thresholds: one sensor for all ClockSpeeds."""

    @field_validator("lane", mode="before", json_schema_input_type=int | DrawnLane | LaneFile | str)
    @classmethod
    def _written_out(cls, lane: object) -> object:
        return parse_lane(lane)

    @field_validator("path")
    @classmethod
    def _not_empty(cls, path: Sized) -> Sized:
        if not path:
            raise ValueError("needs at least one velocity, or: planned")
        return path

    @model_validator(mode="after")
    def _times_fit(self) -> Dp2Config:
        check_times(self.t_move_s, self.t_sample_s, PROFILES[self.profile].check_duration)
        if self.dvs_rate_hz is not None:
            rate_ticks(self.dvs_rate_hz, self.profile)
            if "wall" in (self.timing, self.reference_timing):
                raise ValueError("dvs_rate_hz needs timing and reference_timing virtual or lockstep")
        return self

    def wire_lane(self) -> object:
        """Return the lane as Client.set_lane takes it."""
        return self.lane if isinstance(self.lane, int) else self.lane.model_dump(mode="json")

    def layout(self) -> LaneLayout:
        """Return the places of the obstacles. Raises UserError where one stands at the start."""
        return lane_layout(self.wire_lane())

    def velocities(self) -> tuple[Velocity, ...]:
        """Return the velocity of each command, north and east in m/s. Raises UserError where no path is free."""
        return _planned(self.model_dump_json()) if self.path == "planned" else self.path

    @property
    def slots(self) -> int:
        """The samples of a command."""
        return len(samples_due(self.t_move_s, self.t_sample_s))


@lru_cache(maxsize=8)
def _planned(config: str) -> tuple[Velocity, ...]:
    """Return the planned path of a configuration in JSON, by which it is remembered."""
    planned = Dp2Config.model_validate_json(config)
    return tuple(plan_path(planned.layout(), -planned.height_m, command_s=planned.t_move_s))


class Collision(TypedDict):
    """What a flight collided with: the object, simulated seconds since the start, and the place in NED metres."""

    object: str
    time_s: NonNegative
    position_m: Annotated[list[Number], Field(min_length=3, max_length=3)]


class Dp2Row(FlightRow):
    """The row of a game of DP2."""

    t_move_s: Positive
    t_sample_s: Positive
    commands: Count
    planned_commands: Count
    samples: Count
    distance_m: Number
    collision: Collision | None
    guard_retries: Count


PICTURES = ("samples", HEIGHT, WIDTH)
ARRAYS = {
    "sample_index": ArrayForm("iu", ("samples",), ascends=True),
    "time_s": ArrayForm("f8", ("samples",), ascends=True),
    "position_m": ArrayForm("f8", ("samples", 3)),
    "orientation_wxyz": ArrayForm("f8", ("samples", 4)),
    "image": ArrayForm("u1", PICTURES),
    "colour": ArrayForm("u1", (*PICTURES, 3), optional=True),
    "retries": ArrayForm("iu", ("samples",)),
    "command_velocity_m_s": ArrayForm("f8", ("commands", 2)),
    "dvs_on": ArrayForm("u", PICTURES, optional=True),
    "dvs_off": ArrayForm("u", PICTURES, optional=True),
}
"""What a game keeps, as `arrays_of` makes it."""


@dataclass(frozen=True)
class Game(FlightCase):
    """One game: a reference flies at 1x with clean images; the one in lockstep flies TCSC without latency."""

    planned_s: float

    def simulated_s(self) -> float:
        """Return the simulated time of the commands, without gaps between them."""
        return self.planned_s

    def seed(self, run_seed: int) -> np.random.SeedSequence:
        """Return the game's own seed."""
        return named_seed(run_seed, self.id)


class Dp2(Suite[Dp2Config, Game]):
    """`uavaccel run dp2`. Beside the summary it writes scores.json, the errors of each image."""

    name = "dp2"
    config = Dp2Config
    row = Dp2Row
    arrays = ARRAYS
    quick: ClassVar[Mapping[str, object]] = {}

    def cases(self, config: Dp2Config) -> Iterator[Game]:
        """Yield references, the flight without latency, and the grid."""
        planned_s = len(config.velocities()) * config.t_move_s
        grid = [(command, clock_speed) for command in config.command for clock_speed in config.clock_speed]
        clean = config.perturbation.share == 0 and config.timing == config.reference_timing
        flown_anyway = {command for command, clock_speed in grid if clock_speed == 1.0} if clean else set()
        for command in config.command:
            if command not in flown_anyway:
                yield Game("reference", command, 1.0, config.reference_timing, planned_s)
        yield Game("lockstep", "tcsc", 1.0, "lockstep", planned_s)
        for command, clock_speed in grid:
            role: Role = "reference" if clock_speed == 1.0 and command in flown_anyway else "game"
            yield Game(role, command, clock_speed, config.timing, planned_s)

    def case_of(self, row: Plain) -> str:
        return Game(row["role"], row["command"], row["clock_speed"], row["timing"], 0.0).id

    def renders(self, config: Dp2Config) -> bool:
        return True

    def open(self, config: Dp2Config, timing: str, run: RunDirectory) -> AbstractContextManager[Session]:
        from uavaccel.wire.session import open_session

        return open_session(timing, config.profile, "lane", config.latency)

    def fly(self, config: Dp2Config, case: Game, opened: Session) -> GameResult:
        client = opened.start_game(case.clock_speed, case.seed(config.seed), config.wire_lane(), config.height_m)
        perturbation, exposure = perturbation_of(config, case), AutoExposure() if config.auto_exposure else None
        # in colour where colours may be perturbed, and once per run for the guard study
        kind = "colour" if case.role == "lockstep" or perturbation else "gray"
        settings = client, kind, config.guard.settings(), perturbation, exposure
        if config.dvs_rate_hz is None:
            flown, counts = fly_path(config, case, CameraClient(*settings)), {}
        else:
            with closing(EventClient(config, opened, *settings)) as camera:
                flown = fly_path(config, case, camera)
                counts = camera.arrays(len(flown.samples))
        row, _ = flight_row(case, config, client, flown.wall_s)
        start, hit = flown.samples[0].state, flown.collision
        end_m = hit["position_m"] if hit else flown.samples[-1].state.position_m
        row |= {
            "t_move_s": config.t_move_s,
            "t_sample_s": config.t_sample_s,
            "commands": flown.commands,
            "planned_commands": len(config.velocities()),
            "samples": len(flown.samples),
            "distance_m": float(end_m[0]) - start.position_m[0],
            "collision": hit
            and {
                "object": hit["object"],
                "time_s": (hit["time_ns"] - start.time_ns) / NS_PER_S,
                "position_m": list(hit["position_m"]),
            },
            "guard_retries": sum(sample.retries for sample in flown.samples),
        }
        return GameResult(row, arrays_of(flown, config.velocities()) | counts)

    def flight(
        self, report: Report, game: Mapping[str, Any], pictures: bool = True, event_rate_hz: float | None = None
    ) -> Flight:
        config, arrays = report.config, report.arrays(game)
        if "image" not in arrays:
            raise UserError(f"{report.run.path / game['arrays']}: holds no images")
        time_ns, flat = to_ns(arrays["time_s"]), arrays["command_velocity_m_s"]
        starts = time_ns[np.searchsorted(arrays["sample_index"], np.arange(len(flat)) * config.slots)]
        ends = np.minimum(starts + to_ns(config.t_move_s), [*starts[1:], time_ns[-1]])
        hit = game["collision"]
        achieved = f"achieved {game['real_time_factor']:.1f}x, {timing_provenance(game['timing'])}"
        clock = (
            f"at ClockSpeed {clock_label(game['clock_speed'])} ({achieved}{', hit ' + hit['object'] if hit else ''})"
        )
        return Flight(
            f"{game['command'].upper()} {'in lockstep, without latency' if game['timing'] == 'lockstep' else clock}",
            game["clock_speed"],
            time_ns,
            arrays["position_m"],
            arrays["orientation_wxyz"],
            Commands(starts, ends, np.column_stack([flat, np.zeros(len(flat))])),
            scene="lane",
            lane=config.layout(),
            image_ns=time_ns,
            images=arrays.get("colour", arrays["image"]),
            windows=list(_windows(config, arrays, time_ns)) if pictures else (),
            collision=hit and (round(hit["time_s"] * NS_PER_S), hit["object"]),
        )

    def score(self, report: Report) -> pd.DataFrame:
        """Return the finished games by command and ClockSpeed, with the ERRORS of their images as lists.

        `reference` is the place of the run at 1x in the table, `equal_poses` and `equal_counts` say whether poses and
        DVS counts are those of the game without latency to the last bit; they are None where the run has no such game.
        Only two games beside the present one are held in memory at a time.
        """
        games = finished(report.games)
        lockstep = _observed(report, games[games.role == "lockstep"])
        flown = games[games.role != "lockstep"].assign(later=games.role != "reference")
        flown = flown.sort_values(["command", "clock_speed", "later"], kind="stable").drop(columns="later")
        scored = []
        for _, own in flown.groupby("command"):
            real = _observed(report, own[own.role == "reference"])
            for at in own.index:
                seen = real if real is not None and at == real.at else _observed(report, own.loc[[at]])
                scored.append(_scored(seen, real, lockstep))
        return flown.join(pd.DataFrame(scored, flown.index, columns=SCORES, dtype=object))

    def summary(self, report: Report) -> Summary:
        """Return an entry for each command and ClockSpeed, and the guard study on the images that are in colour.

        Errors are those of the images that a game shares with the same command's run at 1x: the images of a game that
        collides end at its collision. Numbers that cannot be known are None.
        """
        config, scores = report.config, report.scores
        compared = scores[scores.reference.notna()]
        by_image = compared[["command", "clock_speed", "role", *ERRORS]].to_dict("records")
        report.run.write_json("scores.json", by_image)
        in_colour = finished(report.games[report.games.role == "lockstep"]).head(1)
        colour = [report.arrays(game)["colour"] for _, game in in_colour.iterrows()]
        return {
            "suite": "dp2",
            **subset(config.model_dump(), "profile", "seed", "dvs_preset", "sensor_seed"),
            "perturbed_share": config.perturbation.share,
            "cells": [summary_of_game(game, report.games) for _, game in scores.iterrows()],
            "guard_study": study_guard(colour[0], config.guard.settings(), config.seed) if colour else None,
        }

    def title(self, report: Report) -> str:
        return f"DP2, {report.config.profile} profile, seed {report.config.seed}"

    def headline(self, report: Report) -> str:
        cells = [cell for cell in report.summary["cells"] if cell["position_error_m_max"] is not None]
        flown = [cell for cell in cells if cell["clock_speed"] > 1 and cell["timing"] != "lockstep"]
        fastest = {cell["command"]: cell for cell in sorted(flown, key=lambda cell: cell["clock_speed"])}
        said = [_likeness(cell) for _, cell in sorted(fastest.items())]
        return "; ".join(said) or f"{len(report.games)} games, none of them accelerated and comparable with 1x"

    def overview(self, report: Report) -> Table:
        return Table.of(report.summary["cells"], TABLE)

    def page(self, report: Report) -> Iterator[Block | str]:
        games, config, guard = report.games, report.config, report.summary["guard_study"]
        yield f"Games: {source_line(games)}."
        for _, game in games[games.collision.notna()].iterrows():
            yield (
                f"{game.case} hit {game.collision['object']} after {game.distance_m:.1f} m and stood still from there: "
                "its images count up to that moment."
            )
        yield from warnings(games)
        if config.perturbation.share:
            fewer = ", fewer where the ClockSpeed is low" if config.perturbation.half_excess else ""
            yield (
                f"Modelled: {config.perturbation.share:.1%} of the images of the games were perturbed on their way"
                f"{fewer}; those of the runs at 1x that they are compared with were not."
            )
        if config.latency.reply_us.get("image") is None and (games.timing == "virtual").any():
            yield "The modelled wall times leave out drawing the images: the latency model has no channel for them."
        yield Heading("Each ClockSpeed against the run at 1x")
        yield self.overview(report)
        yield READING
        yield images_figure(report)
        if guard is not None:
            yield Heading("Image guard (modelled)")
            yield guard_table(guard)
            yield GUARD.format_map(guard)


class Flown(NamedTuple):
    """A flight's samples with their indices: 0 at the start, then the place in the path, the same in every game."""

    samples: list[Sample]
    indices: list[int]
    commands: int
    wall_s: float
    collision: Mapping[str, Any] | None


def fly_path(config: Dp2Config, case: Game, camera: CameraClient) -> Flown:
    """Fly the path to its end or to a collision, and return the samples up to there."""
    command, slots = COMMANDS[case.command], config.slots
    t_th = t_th_ns(config, case.clock_speed, config.t_sample_s)
    samples, indices, commands = [camera.gather(camera.kinematics())], [0], 0
    command.begin(camera)
    start_ns = camera.now_ns()
    for velocity in config.velocities():
        goal = VelocityGoal((*velocity, 0.0), config.height_m)
        flown = list(command.fly(camera, goal, config.t_move_s, config.t_sample_s, t_th))
        first, commands = 1 + commands * slots, commands + 1
        # The last sample is always that of the command's end; ADSC may come too late for one before it.
        indices += [*range(first, first + len(flown) - 1), first + slots - 1]
        samples += flown
        stands_still = samples[-1].state.position_m == samples[-2].state.position_m  # a collision freezes it
        if stands_still and camera.client.collision():
            break
    wall_s = (camera.now_ns() - start_ns) / NS_PER_S
    collision = camera.client.collision()
    kept = sum(not collision or sample.state.time_ns <= collision["time_ns"] for sample in samples)
    return Flown(samples[:kept], indices[:kept], commands, wall_s, collision)


def perturbation_of(config: Dp2Config, case: Game) -> PerturbationSettings | None:
    """Return how the images of a game are perturbed; None for those that it is compared with."""
    if case.role != "game" or config.perturbation.share == 0:
        return None
    seed, model = int(case.seed(config.seed).generate_state(1)[0]), config.perturbation
    return PerturbationSettings(share_at(case.clock_speed, model.share, model.half_excess), model.kinds, seed)


def arrays_of(flown: Flown, velocities: Sequence[Velocity]) -> Arrays:
    """Return the arrays of a game with n samples: `sample_index`, `time_s` since the start, `position_m` (n, 3) NED,
    `orientation_wxyz` (n, 4), `image` (n, 144, 256) gray, `retries`, `command_velocity_m_s` (commands, 2) and, where
    the images are in colour, `colour` (n, 144, 256, 3).
    """
    states = [sample.state for sample in flown.samples]
    images = np.stack([sample.image for sample in flown.samples])
    gray = images if images.ndim == 3 else np.stack([luma(image) for image in images])
    return {
        "sample_index": np.array(flown.indices, np.int32),
        "time_s": np.array([(state.time_ns - states[0].time_ns) / NS_PER_S for state in states]),
        "position_m": np.array([state.position_m for state in states]),
        "orientation_wxyz": np.array([state.orientation_wxyz for state in states]),
        "retries": np.array([sample.retries for sample in flown.samples], np.int32),
        "command_velocity_m_s": np.array(velocities[: flown.commands]),
        "image": gray,
        **({} if images.ndim == 3 else {"colour": images}),
    }


class EventClient(CameraClient):
    """A camera client that counts events between samples, inside the simulation, without messages or wall time."""

    def __init__(self, config: Dp2Config, session: Session, *settings: Any) -> None:
        """`settings` are the arguments of CameraClient."""
        super().__init__(*settings)
        assert config.dvs_rate_hz is not None
        sensor = make_sensor(PRESETS[config.dvs_preset], (HEIGHT, WIDTH), config.sensor_seed)
        self._session, self._noise_seed = session, config.sensor_seed
        self._counter = EventCounter(sensor)
        self._counts: list[tuple[NDArray[np.int32], NDArray[np.int32]]] = []
        self.close = session.watch(rate_ticks(config.dvs_rate_hz, config.profile), self._see)

    def _see(self, time_ns: int) -> None:
        self._counter.look(self._session.picture(), time_ns)

    def gather(self, state: Kinematics) -> Sample:
        """Return the sample, and count the events since the last one; the first sample begins the game."""
        if not self._counts:
            self._counter.start(self._session.picture(), state.time_ns, self._noise_seed)
        elif not self._counter.has_seen(state.time_ns):
            self._see(state.time_ns)
        self._counts.append(self._counter.take())
        return super().gather(state)

    def arrays(self, samples: int) -> Arrays:
        """Return `dvs_on` and `dvs_off` (n, 144, 256) of the first n samples: uint8, or uint16 beyond 255 events."""
        both = np.array(self._counts[:samples])
        both = both.astype(np.uint8 if both.max() < 256 else np.uint16)
        return {"dvs_on": both[:, 0], "dvs_off": both[:, 1]}


def _windows(config: Dp2Config, arrays: Arrays, time_ns: NDArray[np.int64]) -> Iterator[Window]:
    """Yield those between one picture and the next; as counts where the camera counted at a rate of its own."""
    if "dvs_on" in arrays:
        for at, on, off in zip(time_ns.tolist(), arrays["dvs_on"], arrays["dvs_off"], strict=True):
            yield Window(at, None, (on, off))
        return
    yield from windows_of(arrays["image"], time_ns, PRESETS[config.dvs_preset], config.sensor_seed)


def count_events(
    images: NDArray[np.uint8], time_s: NDArray[np.float64], preset: str, sensor_seed: int
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Return ON and OFF counts (n, H, W) of gray images (n, H, W) taken at `time_s`; the first causes no events."""
    sensor = make_sensor(PRESETS[preset], images.shape[1:], sensor_seed)
    state = init_state(sensor, images[0], float(time_s[0]), noise_seed=sensor_seed)
    on, off = np.zeros(images.shape, np.uint16), np.zeros(images.shape, np.uint16)
    for i in range(1, len(images)):
        state, on[i], off[i] = step(sensor, state, images[i], float(time_s[i]))
    return on, off


class Observed(NamedTuple):
    """The samples of the game at `at` in the table, with the DVS's event counts (n, H, W), 0 for the first."""

    at: int
    places: NDArray[np.int32]
    poses: tuple[NDArray[np.float64], NDArray[np.float64]]
    counts: tuple[NDArray[Any], NDArray[Any]]


def _observed(report: Report, games: pd.DataFrame) -> Observed | None:
    """Return the first of these games as it was observed, by the DVS in flight or else by the one of the report."""
    for at, game in games.head(1).iterrows():
        arrays, config = report.arrays(game), report.config
        counts = (
            (arrays["dvs_on"], arrays["dvs_off"])
            if "dvs_on" in arrays
            else count_events(arrays["image"], arrays["time_s"], config.dvs_preset, config.sensor_seed)
        )
        return Observed(at, arrays["sample_index"], (arrays["position_m"], arrays["orientation_wxyz"]), counts)
    return None


SCORES = ["reference", *ERRORS, "equal_poses", "equal_counts"]


def _scored(seen: Observed | None, real: Observed | None, lockstep: Observed | None) -> list[Any]:
    """Return the SCORES of a game; without a run at 1x its errors are empty."""
    assert seen is not None

    def equal(ours: Sequence[Any], theirs: Sequence[Any]) -> bool:
        return all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))

    same = [equal(seen.poses, lockstep.poses), equal(seen.counts, lockstep.counts)] if lockstep else [None, None]
    if real is None:
        return [None, [], [], [], *same]
    _, own, other = np.intersect1d(seen.places, real.places, return_indices=True)
    own, other = own[1:], other[1:]  # the start has made no events yet
    offset_m = seen.poses[0][own] - real.poses[0][other]
    turn_rad = attitude_difference_rad(seen.poses[1][own], real.poses[1][other])
    events = dvs_ed_percent(*(each[own] for each in seen.counts), *(each[other] for each in real.counts))
    errors = np.linalg.norm(offset_m, axis=1), np.degrees(turn_rad), events
    return [real.at, *(each.tolist() for each in errors), *same]


def summary_of_game(game: pd.Series, games: pd.DataFrame) -> dict[str, Any]:
    """Return the entry of a scored game."""
    kept = ["command", "clock_speed", "t_move_s", "timing", "guard_retries", "collision", "distance_m"]
    kept += ["wall_s", "real_time_factor", "lost_wall_s"]
    marks = [key for key in ("disturbed", "stalled_wall_s", "restarts") if not unknown(game.get(key))]
    spread = {f"{name}_{of}": float(take(game[name])) if game[name] else None for name in ERRORS for of, take in SPREAD}
    real = None if unknown(game.reference) else games.loc[game.reference]
    return {
        **subset(game, *kept, *marks),
        **spread,
        "provenance": timing_provenance(game.timing),
        "reference": None
        if real is None
        else {
            **subset(real, "case", "clock_speed", "timing"),
            "provenance": timing_provenance(real.timing),
            "is_this_cell": real.case == game.case,
        },
        "images": game.samples,
        "paired_images": len(game.position_error_m),
        "poses_equal_lockstep": game.equal_poses,
        "dvs_counts_equal_lockstep": game.equal_counts,
        "simulated_s_per_wall_s": game.duration_s / game.wall_s if game.wall_s > 0 else None,
    }


SPREAD: tuple[tuple[str, Callable[[Any], Any]], ...] = (("median", np.median), ("max", np.max))


def study_guard(images: NDArray[np.uint8], settings: GuardSettings, seed: int) -> dict[str, Any]:
    """Count what the guard accepts (MODELLED) where a share of the run's own images (n, H, W, 3) is perturbed, by kind.

    The images are sent GUARD_STREAMS times, perturbed with another seed each time, as one stream has too few of each
    kind. An image that the guard requests again may be perturbed again, so with the guard more are sent.
    """
    streams = [guard_study(list(images), GUARD_SHARE, seed + n, settings) for n in range(GUARD_STREAMS)]
    by_kind: dict[str, Any] = {}
    for kind, guard in ((str(kind), guard) for kind in PerturbationKind for guard in ("off", "on")):
        counts = pd.DataFrame([stream[guard]["by_kind"][kind] for stream in streams])
        sent, passed = int(counts.sent.sum()), int(counts.passed.sum())
        shares = {"sent": sent, "passed": passed, "share_passed": passed / sent if sent else None}
        by_kind.setdefault(kind, {})[guard] = shares
    handed_on = {guard: [stream[guard]["perturbed_share_handed_on"] for stream in streams] for guard in ("off", "on")}
    return {
        "modelled": True,
        "images": len(images),
        "share": GUARD_SHARE,
        "streams": GUARD_STREAMS,
        "by_kind": by_kind,
        "perturbed_share_handed_on": {guard: float(np.mean(shares)) for guard, shares in handed_on.items()},
        "clean_false_alarms": streams[0]["clean"]["false_alarms"],
        "clean_retries": streams[0]["clean"]["retries"],
    }


def guard_table(guard: Summary) -> Table:
    """Return a table with a row for each kind of perturbation, and one for all."""
    passed = {name: pd.DataFrame({kind: of[name] for kind, of in guard["by_kind"].items()}).T for name in ("off", "on")}
    both = pd.concat({name: counts[["sent", "passed"]] for name, counts in passed.items()}, axis=1)
    both.loc["all"] = both.sum()
    share = {name: (both[name].passed / both[name].sent).astype(float) for name in ("off", "on")}
    lines = pd.DataFrame({"kind": both.index.str.replace("_", " "), "sent": both["on"].sent.to_numpy()})
    return Table.of(
        lines.assign(off=share["off"].to_numpy(), on=share["on"].to_numpy()),
        {
            "kind of perturbation": "{kind}",
            "perturbed images sent": "{sent:g}",
            "pass without guard": "{off:.1%}",
            "pass the guard": "{on:.1%}",
        },
    )


def exact_number(value: float | None, digits: int) -> str:
    """Format a number so that only an exact 0 is "0", and one too small for the digits is written with an exponent."""
    if not value:
        return "-" if value is None else "0"
    return f"{value:.{digits}f}" if value >= 10.0**-digits else f"{value:.0e}"


def _pair(name: str, digits: int) -> Callable[[Mapping[str, Any]], str]:
    return lambda cell: ", ".join(exact_number(cell[f"{name}_{of}"], digits) for of, _ in SPREAD)


def _clock(cell: Mapping[str, Any]) -> str:
    reference = " (reference)" if cell["reference"] and cell["reference"]["is_this_cell"] else ""
    return f"{cell['clock_speed']:g}x{reference}{' (disturbed)' if cell.get('disturbed') else ''}"


def _against_lockstep(cell: Mapping[str, Any]) -> str:
    words = {True: "equal", False: "differ", None: "-"}
    return f"{words[cell['poses_equal_lockstep']]}, {words[cell['dvs_counts_equal_lockstep']]}"


TABLE: Mapping[str, Column] = {
    "command": "{command!u}",
    "ClockSpeed": _clock,
    "images": "{paired_images}",
    "position error, m: median, max": _pair("position_error_m", 3),
    "attitude error, deg: max": lambda cell: exact_number(cell["attitude_error_deg_max"], 2),
    "DVS-ED, %: median, max": _pair("dvs_ed_percent", 2),
    "guard retries": "{guard_retries}",
    "poses, counts v. lockstep": _against_lockstep,
    "distance, m": lambda cell: (
        f"{cell['distance_m']:.1f}" + (f" (hit {cell['collision']['object']})" if cell["collision"] else "")
    ),
    "simulated s a wall s": lambda cell: exact_number(cell["simulated_s_per_wall_s"], 2),
    "source": "{provenance}",
}


def _likeness(cell: Mapping[str, Any]) -> str:
    error_m, events = cell["position_error_m_max"], cell["dvs_ed_percent_max"]
    if not error_m and not events:
        return f"{command_at_clock(cell)} takes the images of 1x, each at the same place with as many events"
    return (
        f"{command_at_clock(cell)} takes its images up to {exact_number(error_m, 3)} m from those of 1x, with a DVS-ED "
        f"of up to {exact_number(events, 2)} %"
    )


def images_figure(report: Report) -> Picture:
    """Draw Figure 7, position error over DVS-ED: a point an image, a panel a command.

    A command whose images all have no error gets a line below the panels in place of an empty panel.
    """
    scores = report.scores
    images = scores[scores.reference.notna() & (scores.reference != scores.index)].sort_values("clock_speed")
    exact = images[
        [not any(e) and not any(p) for e, p in zip(images.dvs_ed_percent, images.position_error_m, strict=True)]
    ]
    commands = sorted(set(images.command[~images.index.isin(exact.index)]), reverse=True)
    clocks = sorted(set(images.clock_speed))
    source = source_line(scores)
    below = [
        f"{command.upper()} at {listed(map(clock_label, own.clock_speed))}: all {own.position_error_m.map(len).sum()} "
        "images at 0, 0"
        for command, own in sorted(exact[~exact.command.isin(commands)].groupby("command"), reverse=True)
    ]
    title = "Position error and DVS-ED of each image against the run at 1x"
    options = {"sharex": True, "sharey": True}
    figure, grid = plots.panels(1, len(commands), title, "\n".join([*below, source]), (3.6, 3.2), **options)
    for axes, command in zip(grid[0], commands, strict=False):
        for _, game in images[images.command == command][::-1].iterrows():  # few and near points lie on top
            _scatter(axes, game, clocks)
        axes.set_xlabel("DVS-ED, % of the pixels")
        handles, labels = axes.get_legend_handles_labels()
        above = {"loc": "lower left", "bbox_to_anchor": (-0.02, 1.0), "alignment": "left", "title_fontsize": 10}
        axes.legend(handles[::-1], labels[::-1], title=command.upper(), ncols=2, **above)
    if commands:
        grid[0, 0].set_ylabel("position error, m")
        # logarithmic, as the clouds lie decades apart, but linear around 0, so that 0 has its place
        grid[0, 0].set_xscale("symlog", linthresh=LEAST_PERCENT, linscale=0.6)
        grid[0, 0].set_yscale("symlog", linthresh=LEAST_M, linscale=0.6)
        for axis in (grid[0, 0].xaxis, grid[0, 0].yaxis):
            axis.set_major_formatter("{x:g}")
        grid[0, 0].set(xlim=(-0.4 * LEAST_PERCENT, 100), ylim=(-0.4 * LEAST_M, 10))
    else:
        some = "every image has no error at all" if below else "no accelerated game to compare with a run at 1x"
        style.note(grid[0, 0], some)
    return report.figure("figure7_images", figure, FIGURE7, source)


def _scatter(axes: Any, game: pd.Series, clocks: Sequence[float]) -> None:
    """Draw a game's images, those without error as one ring."""
    place = clocks.index(game.clock_speed)
    colour, marker = style.series(place).values()
    x, y = np.array(game.dvs_ed_percent), np.array(game.position_error_m)
    away = (x != 0) | (y != 0)
    axes.scatter(x[away], y[away], s=13, c=colour, marker=marker, linewidths=0, alpha=0.7, clip_on=False)
    exact, count = np.count_nonzero(~away), f"{len(x)} image{'s' if len(x) > 1 else ''}"
    if exact:
        size = (5.0 + 4.5 * place) ** 2
        axes.scatter(0, 0, s=size, facecolors="none", edgecolors=colour, linewidths=1.6, clip_on=False)
        count = f"all {len(x)} at 0, 0" if exact == len(x) else f"{exact} of {len(x)} at 0, 0"
    axes.scatter([], [], s=22, c=colour, marker=marker, label=f"{clock_label(game.clock_speed)}: {count}")


FIGURE7 = (
    "Figure 7. Position error over DVS-ED, a point an image, against the image of the same place in the path of the "
    "same command's run at 1x. Rings: images at the same place with as many DVS pixels as at 1x. Both axes are "
    f"logarithmic, but linear up to {LEAST_PERCENT:g} % and {LEAST_M * 1e3:g} mm."
)
READING = (
    "Images are paired by their place in the path: the same sample of the same command. DVS-ED is the difference in "
    "the number of pixels with ON events plus that with OFF events, over all pixels; it cannot see events that moved "
    "elsewhere. One DVS, with one map of thresholds, is applied to all games' images. An error of 0 is exactly 0. "
    "Equal to lockstep means that every pose, or every pixel's event count, has the same bits as in the game flown "
    "without latency. Measured: the machine's clock. Modelled: a simulated clock."
)
GUARD = (
    "False alarms: {clean_false_alarms} of {images} clean images. With {share:.0%} of the images perturbed, "
    "{perturbed_share_handed_on[off]:.1%} of those handed on are perturbed without the guard and "
    "{perturbed_share_handed_on[on]:.1%} with it. The images are those of the game without latency, sent {streams} "
    "times with another seed. MuJoCo renders every image correctly: the perturbations are a model of a renderer short "
    "of time, whose sizes are this project's own choice. The guard checks mean brightness alone and cannot detect what "
    "leaves that as it is."
)
