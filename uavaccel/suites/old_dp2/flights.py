"""DP2's games: which are flown, in canonical order, how one is flown, and what is recorded of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from typing_extensions import TypedDict

from uavaccel.commands import COMMANDS
from uavaccel.commands.slices import samples_due
from uavaccel.envs.camera_client import CameraClient, Sample
from uavaccel.envs.task import rate_ticks
from uavaccel.forms import ArrayForm, Count, NotNegative, Number, Positive
from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.lane.path import plan_path
from uavaccel.suites.experiment import t_th_ns
from uavaccel.suites.old_dp2.config import Dp2Config, Velocity
from uavaccel.suites.rows import FlightCase, FlightRow, Role, flight_row, named_seed
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs import PRESETS, luma, make_sensor
from uavaccel.vision.event_counter import EventCounter
from uavaccel.vision.perturb import AutoExposure, PerturbationSettings, share_at
from uavaccel.wire.game_api import Collision
from uavaccel.wire.session import Session

Arrays = dict[str, NDArray[np.generic]]


@dataclass(frozen=True)
class Case(FlightCase):
    """One game: a reference flies at 1x with clean images; the one in lockstep flies TCSC without latency."""

    planned_s: float

    def simulated_s(self) -> float:
        """Return the simulated time of the commands, without gaps between them."""
        return self.planned_s

    def seed(self, run_seed: int) -> np.random.SeedSequence:
        """Return the game's own seed."""
        return named_seed(run_seed, self.id)


class Dp2Collision(TypedDict):
    """What a flight collided with: the object, simulated seconds since the start, and the place in NED metres."""

    object: str
    time_s: NotNegative
    position_m: Annotated[list[Number], Field(min_length=3, max_length=3)]


class Dp2Row(FlightRow):
    """The row of a game of DP2."""

    t_move_s: Positive
    t_sample_s: Positive
    commands: Count
    planned_commands: Count
    samples: Count
    distance_m: Number
    collision: Dp2Collision | None
    guard_retries: Count


_PICTURES = ("samples", HEIGHT, WIDTH)
ARRAYS = {
    "sample_index": ArrayForm("iu", ("samples",), ascends=True),
    "time_s": ArrayForm("f8", ("samples",), ascends=True),
    "position_m": ArrayForm("f8", ("samples", 3)),
    "orientation_wxyz": ArrayForm("f8", ("samples", 4)),
    "image": ArrayForm("u1", _PICTURES),
    "colour": ArrayForm("u1", (*_PICTURES, 3), optional=True),
    "retries": ArrayForm("iu", ("samples",)),
    "command_velocity_m_s": ArrayForm("f8", ("commands", 2)),
    "dvs_on": ArrayForm("u", _PICTURES, optional=True),
    "dvs_off": ArrayForm("u", _PICTURES, optional=True),
}
"""What `fly_game` records, as `arrays_of` makes it."""


def cases(config: Dp2Config) -> Iterator[Case]:
    """Yield every game of a run in canonical order: references, lockstep, games."""
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
        role: Role = "reference" if clock_speed == 1.0 and command in flown_anyway else "game"
        yield Case(role, command, clock_speed, config.timing, planned_s)


def velocities(config: Dp2Config) -> tuple[Velocity, ...]:
    """Return the velocity of each command, north and east in m/s. Raises UserError where no path is free."""
    if config.path != "planned":
        return config.path
    key = config.model_dump_json(include={"lane", "height_m", "t_move_s"})
    if key not in _planned:
        _planned[key] = tuple(plan_path(config.layout(), -config.height_m, command_s=config.t_move_s))
    return _planned[key]


_planned: dict[str, tuple[Velocity, ...]] = {}


SCENE = "lane"


class Flight(NamedTuple):
    """A flight's samples with their indices: 0 at the start, then the place in the path, the same in every game."""

    samples: list[Sample]
    indices: list[int]
    commands: int
    wall_s: float
    collision: Collision | None


def fly_game(config: Dp2Config, case: Case, session: Session) -> tuple[Dp2Row, dict[str, np.ndarray]]:
    """Fly one game, and return its row, without the arrays' path, and its arrays (see `arrays_of`)."""
    seed = case.seed(config.seed)
    client = session.start_game(case.clock_speed, seed, config.wire_lane(), config.height_m)
    perturbation, exposure = _perturbation(config, case), AutoExposure() if config.auto_exposure else None
    # in colour where colours may be perturbed, and once per run for the guard study
    kind = "colour" if case.role == "lockstep" or perturbation else "gray"
    settings = client, kind, config.guard.settings(), perturbation, exposure
    counts: Arrays = {}
    if config.dvs_rate_hz is None:
        flight = fly_path(config, case, CameraClient(*settings))
    else:
        with EventClient(config, session, *settings) as camera:
            flight = fly_path(config, case, camera)
            counts = camera.arrays(len(flight.samples))
    end_m = flight.collision["position_m"] if flight.collision else flight.samples[-1].state.position_m
    shared, _ = flight_row(case, config, client, flight.wall_s)
    row: Dp2Row = {
        **shared,  # type: ignore[typeddict-item]
        "t_move_s": config.t_move_s,
        "t_sample_s": config.t_sample_s,
        "commands": flight.commands,
        "planned_commands": len(velocities(config)),
        "samples": len(flight.samples),
        "distance_m": float(end_m[0]) - flight.samples[0].state.position_m[0],
        "collision": _collision(flight),
        "guard_retries": sum(sample.retries for sample in flight.samples),
    }
    return row, arrays_of(flight, velocities(config)[: flight.commands]) | counts


def fly_path(config: Dp2Config, case: Case, camera: CameraClient) -> Flight:
    """Fly the path to its end or to a collision, and return the samples up to there."""
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
        stands_still = samples[-1].state.position_m == samples[-2].state.position_m  # a collision freezes it
        if stands_still and camera.client.collision():
            break
    wall_s = (camera.now_ns() - start_ns) / NS_PER_S
    collision = camera.client.collision()
    kept = sum(not collision or sample.state.time_ns <= collision["time_ns"] for sample in samples)
    return Flight(samples[:kept], indices[:kept], commands, wall_s, collision)


def _perturbation(config: Dp2Config, case: Case) -> PerturbationSettings | None:
    if case.role != "game" or config.perturbation.share == 0:
        return None
    seed, model = int(case.seed(config.seed).generate_state(1)[0]), config.perturbation
    share = share_at(case.clock_speed, model.share, model.half_excess)
    return PerturbationSettings(share, model.kinds, seed)


def _collision(flight: Flight) -> Dp2Collision | None:
    if (hit := flight.collision) is None:
        return None
    time_s = (hit["time_ns"] - flight.samples[0].state.time_ns) / NS_PER_S
    return {"object": hit["object"], "time_s": time_s, "position_m": list(hit["position_m"])}


def arrays_of(flight: Flight, flown: tuple[Velocity, ...]) -> dict[str, np.ndarray]:
    """Return the arrays of a game with n samples: `sample_index`, `time_s` since the start, `position_m` (n, 3) NED,
    `orientation_wxyz` (n, 4), `image` (n, 144, 256) gray, `retries`, `command_velocity_m_s` (commands, 2) and, where
    the images are in colour, `colour` (n, 144, 256, 3).
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
        self._stop = session.watch(rate_ticks(config.dvs_rate_hz, config.profile), self._look)

    def _look(self, time_ns: int) -> None:
        self._counter.look(self._session.picture(), time_ns)

    def gather(self, state: Kinematics) -> Sample:
        """Return the sample, and count the events since the last one; the first sample begins the game."""
        if not self._counts:
            self._counter.start(self._session.picture(), state.time_ns, self._noise_seed)
        elif not self._counter.has_seen(state.time_ns):
            self._look(state.time_ns)
        self._counts.append(self._counter.take())
        return super().gather(state)

    def arrays(self, samples: int) -> Arrays:
        """Return `dvs_on` and `dvs_off` (n, 144, 256) of the first n samples: uint8, or uint16 beyond 255 events."""
        both = np.array(self._counts[:samples])
        both = both.astype(np.uint8 if both.max() < 256 else np.uint16)
        return {"dvs_on": both[:, 0], "dvs_off": both[:, 1]}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
