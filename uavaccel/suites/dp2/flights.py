"""DP2: what the drone sees on a collision-free path to the lane's end (paper, sections III-C2b and IV-C)."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, field_validator, model_validator

from uavaccel.commands import COMMANDS
from uavaccel.commands.slices import samples_due
from uavaccel.config import Config
from uavaccel.envs.camera_client import CameraClient, Sample
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.lane.file import LaneFile, lane_written_out
from uavaccel.sim.lane.layout import Difficulty, LaneLayout, Share
from uavaccel.sim.lane.path import plan_path
from uavaccel.sim.profile import PROFILES
from uavaccel.suites.dp1.flights import check_samples
from uavaccel.suites.experiment import CommandName, Experiment, Timing, positive, t_th_ns
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs import luma
from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.perturb import Kind, PerturbationSettings
from uavaccel.wire.image_api import lane_layout
from uavaccel.wire.session import Session

SCENE = "lane"

NotNegative = Annotated[float, Field(ge=0.0)]
Velocity = tuple[float, float]


class DrawnLane(Config):
    """A lane drawn from a seed."""

    seed: Annotated[int, Field(ge=0)]
    difficulty: Difficulty = Difficulty()


class GuardConfig(Config):
    """Limits of the image guard (uavaccel.vision.guard); `max_retries: 0` switches it off."""

    max_change: NotNegative = 0.10
    """Of the last image's mean brightness."""
    min_brightness: NotNegative = 10.0
    """Mean of 0 to 255 below which an image is too dark."""
    max_retries: Annotated[int, Field(ge=0)] = 3
    accept_identical: bool = True
    """An image asked for again that comes out identical is accepted."""

    def settings(self) -> GuardSettings:
        return GuardSettings(**self.model_dump())


class PerturbationConfig(Config):
    """A MODEL of images gone wrong on their way (uavaccel.vision.perturb); share 0 is off."""

    share: Share = 0.0
    """Of the images that are received, those asked for again included."""
    kinds: Annotated[tuple[Kind, ...], Field(min_length=1)] = tuple(Kind)


class Dp2Config(Experiment):
    """`suite: dp2`."""

    suite: Literal["dp2"]
    lane: Annotated[int, Field(ge=0)] | DrawnLane | LaneFile = 3
    """A seed; a seed with a difficulty; a lane of one's own, written out or the name of its YAML file."""
    path: Literal["planned"] | tuple[Velocity, ...] = "planned"
    """planned: a collision-free path to the lane's end; or velocities of one's own: north, east, m/s."""
    height_m: Annotated[float, Field(lt=0.0)] = -10.0
    """NED z of the start, and held: -10 is 10 m up."""
    t_move_s: float = 1.0
    t_sample_s: float = 0.33
    reference_timing: Timing = "virtual"
    """Of the run at 1x that each command is compared with, unless the run flies that one anyway."""
    guard: GuardConfig = GuardConfig()
    perturbation: PerturbationConfig = PerturbationConfig()
    """Of the games alone; what they are compared with stays clean."""
    dvs_preset: Literal["clean", "constructor", "command_line", "noisy"] = "clean"
    """v2e's parameters of the DVS by which the report looks at the images."""
    sensor_seed: Annotated[int, Field(ge=0)] = 0
    """Of the DVS's thresholds: one sensor for all ClockSpeeds."""

    @field_validator("lane", mode="before")
    @classmethod
    def _written_out(cls, lane: Any) -> Any:
        return lane_written_out(lane)

    @field_validator("path")
    @classmethod
    def _not_empty(cls, path: Any) -> Any:
        if not path:
            raise ValueError("needs at least one velocity, or: planned")
        return path

    @field_validator("t_move_s", "t_sample_s")
    @classmethod
    def _above_zero(cls, value: float) -> float:
        return positive((value,))[0]

    @model_validator(mode="after")
    def _times_fit(self) -> Dp2Config:
        PROFILES[self.profile].check_duration(self.t_move_s, "t_move_s")
        check_samples(self.profile, self.t_move_s, self.t_sample_s)
        return self

    def wire_lane(self) -> Any:
        """The lane as Client.set_lane takes it."""
        return self.lane if isinstance(self.lane, int) else self.lane.model_dump(mode="json")

    def layout(self) -> LaneLayout:
        """Where the obstacles stand. Raises UserError where one stands on the start."""
        return lane_layout(self.wire_lane())


@dataclass(frozen=True)
class Case:
    """One game. `role`: "reference" (at 1x, its images clean), "lockstep" (TCSC without latency) or "game"."""

    role: str
    command: CommandName
    clock_speed: float
    timing: Timing
    planned_s: float

    @property
    def id(self) -> str:
        prefix = "" if self.role == "game" else f"{self.role}-"
        return f"{prefix}{self.command}-k{self.clock_speed:g}"

    def simulated_s(self) -> float:
        """Simulated time of the commands, without gaps between them."""
        return self.planned_s

    def seed(self, run_seed: int) -> np.random.SeedSequence:
        """The game's own generator: the same in any subset of a run, and in any order."""
        return np.random.SeedSequence(run_seed, spawn_key=(zlib.crc32(self.id.encode()),))


def cases(config: Dp2Config) -> Iterator[Case]:
    """Every game of a run in canonical order: references, lockstep, games."""
    planned_s = len(velocities(config)) * config.t_move_s
    grid = [(command, clock_speed) for command in config.command for clock_speed in config.clock_speed]
    clean = config.perturbation.share == 0
    flown_anyway = {command for command, clock_speed in grid if clock_speed == 1.0} if clean else set()
    if config.timing != config.reference_timing:
        flown_anyway = set()
    for command in config.command:
        if command not in flown_anyway:
            yield Case("reference", command, 1.0, config.reference_timing, planned_s)
    yield Case("lockstep", "tcsc", 1.0, "lockstep", planned_s)
    for command, clock_speed in grid:
        role = "reference" if clock_speed == 1.0 and command in flown_anyway else "game"
        yield Case(role, command, clock_speed, config.timing, planned_s)


def velocities(config: Dp2Config) -> tuple[Velocity, ...]:
    """One velocity a command: north, east, m/s. Raises UserError where no path is free."""
    if config.path != "planned":
        return config.path
    key = config.model_dump_json(include={"lane", "height_m", "t_move_s"})
    if key not in _planned:
        _planned[key] = tuple(plan_path(config.layout(), -config.height_m, command_s=config.t_move_s))
    return _planned[key]


_planned: dict[str, tuple[Velocity, ...]] = {}


class Flight(NamedTuple):
    """Samples with their indices: 0 is the start, then the place in the path, the same in every game."""

    samples: list[Sample]
    indices: list[int]
    commands: int
    wall_s: float
    collision: dict[str, Any]


def run_case(config: Dp2Config, case: Case, session: Session) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Fly one game: its row, without the arrays' path, and its arrays (see `arrays_of`)."""
    seed = case.seed(config.seed)
    client = session.start_game(case.clock_speed, seed, config.wire_lane(), config.height_m)
    camera = CameraClient(
        client, _picture(config, case), config.guard.settings(), _perturbation(config, case)
    )
    flight = fly(config, case, camera)
    speed, recording = client.speed(), client.recording()
    start = flight.samples[0].state
    row = {
        "suite": "dp2",
        "case": case.id,
        "role": case.role,
        "command": case.command,
        "clock_speed": case.clock_speed,
        "t_move_s": config.t_move_s,
        "t_sample_s": config.t_sample_s,
        "timing": case.timing,
        "profile": config.profile,
        "seed": config.seed,
        "commands": flight.commands,
        "planned_commands": len(velocities(config)),
        "samples": len(flight.samples),
        "distance_m": _north_m(flight) - start.position_m[0],
        "collision": _collision(flight),
        "guard_retries": sum(sample.retries for sample in flight.samples),
        "wall_s": flight.wall_s,
        "sim_time_s": speed["simulated_ns"] / NS_PER_S,
        "duration_s": round(int(recording.commands[-1, 1]) * recording.tick_ns / NS_PER_S, 9),
        "real_time_factor": speed["real_time_factor"],
        "lost_wall_s": speed["lost_wall_ns"] / NS_PER_S,
        "error": speed["failure"],
    }
    return row, arrays_of(flight, velocities(config)[: flight.commands])


def fly(config: Dp2Config, case: Case, camera: CameraClient) -> Flight:
    """Fly the path to its end or to a collision, and keep what was sampled up to there."""
    command, slots = COMMANDS[case.command], len(samples_due(config.t_move_s, config.t_sample_s))
    t_th = t_th_ns(config, case.clock_speed, config.t_sample_s)
    samples, indices, commands = [camera.gather(camera.kinematics())], [0], 0
    command.begin(camera)
    start_ns = camera.now_ns()
    for velocity in velocities(config):
        goal = VelocityGoal((*velocity, 0.0), config.height_m)
        flown = list(command.fly(camera, goal, config.t_move_s, config.t_sample_s, t_th))
        first, commands = 1 + commands * slots, commands + 1
        # The last sample is always that of the command's end; ADSC may come too late for one before it.
        indices += [*range(first, first + len(flown) - 1), first + slots - 1]
        samples += flown
        if _stands_still(samples) and camera.collision():
            break
    wall_s = (camera.now_ns() - start_ns) / NS_PER_S
    collision = camera.collision()
    kept = _before(collision, samples)
    return Flight(samples[:kept], indices[:kept], commands, wall_s, collision)


def _stands_still(samples: list[Sample]) -> bool:
    """Whether nothing has moved between the last two samples: a collision freezes the vehicle where it is."""
    return samples[-1].state.position_m == samples[-2].state.position_m


def _before(collision: dict[str, Any], samples: list[Sample]) -> int:
    """How many samples were taken before the collision; the others show a vehicle that stands frozen."""
    if not collision:
        return len(samples)
    return sum(sample.state.time_ns <= collision["time_ns"] for sample in samples)


def _picture(config: Dp2Config, case: Case) -> str:
    """Colour where colours can go wrong, and once a run, to study the guard with; else what the DVS needs."""
    return "colour" if case.role == "lockstep" or _perturbation(config, case) else "gray"


def _perturbation(config: Dp2Config, case: Case) -> PerturbationSettings | None:
    if case.role != "game" or config.perturbation.share == 0:
        return None
    seed = int(case.seed(config.seed).generate_state(1)[0])
    return PerturbationSettings(config.perturbation.share, config.perturbation.kinds, seed)


def _north_m(flight: Flight) -> float:
    collision = flight.collision
    return float(collision["position_m"][0] if collision else flight.samples[-1].state.position_m[0])


def _collision(flight: Flight) -> dict[str, Any] | None:
    if not flight.collision:
        return None
    since_start_ns = flight.collision["time_ns"] - flight.samples[0].state.time_ns
    return {
        "object": flight.collision["object"],
        "time_s": since_start_ns / NS_PER_S,
        "position_m": list(flight.collision["position_m"]),
    }


def arrays_of(flight: Flight, flown: tuple[Velocity, ...]) -> dict[str, np.ndarray]:
    """Arrays of a game, n samples: `sample_index`, `time_s` since the start, `position_m` (n, 3) NED,
    `orientation_wxyz` (n, 4), `image` (n, 144, 256) gray, `retries`; `command_velocity_m_s` (commands, 2);
    and, where the camera took it, `colour` (n, 144, 256, 3).
    """
    states = [sample.state for sample in flight.samples]
    images = np.stack([sample.image for sample in flight.samples])
    arrays = {
        "sample_index": np.array(flight.indices, np.int32),
        "time_s": np.array([(state.time_ns - states[0].time_ns) / NS_PER_S for state in states]),
        "position_m": np.array([state.position_m for state in states]),
        "orientation_wxyz": np.array([state.orientation_wxyz for state in states]),
        "retries": np.array([sample.retries for sample in flight.samples], np.int32),
        "command_velocity_m_s": np.array(flown),
    }
    if images.ndim == 3:
        return arrays | {"image": images}
    return arrays | {"image": np.stack([luma(image) for image in images]), "colour": images}
