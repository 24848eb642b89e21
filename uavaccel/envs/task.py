"""A learning task: how a game is sampled, what actions and observations mean, and reward, success and failure.

As in dm_control, physics, environment and task are separate. A task is a configuration, whose keys are the keywords of
the environment, and a few pure functions of what happened, each of which a subclass may replace.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from functools import lru_cache, reduce
from numbers import Integral
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple, Self, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field, model_validator

from uavaccel.commands import check_times, samples_due
from uavaccel.config import ClockSpeed, CommandName, Config, Cost, Count, Height, Seconds, Seed, Speed
from uavaccel.envs.arrays import constant
from uavaccel.envs.sensors import (
    PICTURE_SIZE,
    STATE_FIELDS,
    ColourCamera,
    ContextPlanes,
    DepthCamera,
    EventCamera,
    Sensor,
    StateSensor,
    blank_frame,
)
from uavaccel.envs.values import AT_REST, Action, AnyMoment, Course, Info, Moment, Number
from uavaccel.errors import UserError
from uavaccel.kinematics import AttitudeGoal, BodyRatesGoal, FlightGoal, Kinematics, MotorsGoal, Vector, VelocityGoal
from uavaccel.sim.lane import LaneLayout
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.scene import PLAIN
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs_sensor import PRESETS, DvsParameters, with_noise, with_thresholds
from uavaccel.wire.latency import LatencyModel, of_the_profile

if TYPE_CHECKING:  # which compiles
    from uavaccel.sim.clutter import ClutterLayout

ActionKind = Literal["velocity", "attitude", "rates", "motors"]
SIZES: dict[ActionKind, int] = {"velocity": 3, "attitude": 4, "rates": 4, "motors": 4}
"""Numbers of an action."""
TURNED: dict[ActionKind, Sequence[int]] = {
    "velocity": (1, -2, 3), "attitude": (-1, 2, -3, 4), "rates": (-1, 2, -3, 4), "motors": (3, 4, 1, 2),
}  # fmt: skip
"""Actions turned left to right, as a Mirror has them."""
HOVER_THROTTLE = 0.5941
"""Throttle that carries AirSim's generic quadrotor (1 kg, four rotors of 4.1794 N) 10 m above its default home."""
RAD = math.pi / 180.0  # as in math.radians


def throttle(share: Number) -> Number:
    """Return the throttle, 0 to 1, of a share from -1 to 1: 0 carries the vehicle's weight."""
    sinking, climbing = HOVER_THROTTLE * (1.0 + share), HOVER_THROTTLE + (1.0 - HOVER_THROTTLE) * share
    return sinking * (share < 0.0) + climbing * (share >= 0.0)


NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]
Positive = Annotated[float, Field(gt=0.0, le=1e6)]

RATE_ROUNDING = 1e-4  # of a rate that is written with few digits, as 333.33


class Mediation(Config):
    """What ADSC's gap between two commands changes, under TCSC and without latencies: all of it, or one part alone.

    All are simulated seconds of whole physics steps, which need command tcsc, timing lockstep and profile native.
    """

    gap_s: Annotated[float, Field(ge=0.0, le=60.0)] = 0.0
    """Time for which the vehicle flies on before each command, after the agent has observed: as under ADSC its last
    command's goal holds for 60 ms more, then its position."""
    start_speed: Annotated[float, Field(ge=-1.0, le=1.0)] | None = None
    """Share of its velocity and turn rate at the last command's end with which it begins the next one, with attitude,
    autopilot and rotors as they were then; its position is the one after the gap. None: all as the gap leaves it."""
    image_age_s: NotNegative = 0.0
    """Age of the images when a command begins to act, less than T_move: until then the last one acts, for T_move in
    all, and samples are taken when they were."""


class Mirror(NamedTuple):
    """How numbers change when all is turned left to right: the place, from 1, of what each becomes, with its sign."""

    fields: Sequence[int]
    action: Sequence[int]

    def check(self, space: spaces.Space[Any], actions: int) -> None:
        """Raise ValueError unless it has the places of all fields in an observation space and of an action."""
        seen = space.values() if isinstance(space, spaces.Dict) else [space]
        widths = [part.shape[-1] for part in seen if part.shape and len(part.shape) < 3]  # of one frame or of several
        count = len(self.fields)
        fits = {"fields": not any(width % count if count else width for width in widths)}
        fits["action"] = len(self.action) == actions
        for name, places in self._asdict().items():
            whole = all(isinstance(place, Integral) for place in places)
            if not (fits[name] and whole and sorted(map(abs, places)) == list(range(1, len(places) + 1))):
                raise ValueError(f"{name} = {list(places)}: must be all places, each once, from 1 on and with its sign")


AnyLayout: TypeAlias = "LaneLayout | ClutterLayout"


class Task(Config):
    """The keys that all tasks share, and the functions that define one; subclasses replace those from `actions` on."""

    scene: ClassVar[str] = "blocks"
    reset_options: ClassVar[tuple[str, ...]] = ()
    """Keys that `reset(options=...)` accepts."""
    flat_state: ClassVar[bool] = False
    """Whether a frame of observation "state" is a vector (n,), not a row (1, n)."""
    sees_start: ClassVar[bool] = True
    """Whether the first observation shows the start; otherwise its frames are blank."""

    observation: Literal["dvs", "state", "colour", "depth"] = "state"
    """What the agent observes: event images, the state as numbers, colour pictures or depth pictures."""
    also_state: bool = False
    """Whether observations are mappings: `image`, the frames, and `state`, the numbers of observation "state" at the
    command's end, all 0 after a collision."""
    history: Annotated[int, Field(ge=1, le=8)] = 1
    """Number of commands whose frames make one observation, the newest last."""
    picture_size: tuple[Annotated[int, Field(ge=16, le=256)], Annotated[int, Field(ge=16, le=256)]] = PICTURE_SIZE
    """Columns and rows of pictures. Those of 256 x 144 are reduced to frames of 64 x 36; others are not reduced."""
    blank_images: bool = False
    """Whether all frames are blank: the baseline of what can be learned without seeing."""
    dvs_preset: Literal["clean", "constructor", "command_line", "noisy"] = "clean"
    """v2e's preset of the event camera."""
    dvs_seed: Seed = 0
    """Seed of the pixels' thresholds, which stay the same from game to game."""
    dvs_threshold_ratio: Positive = 1.0
    """Factor on the preset's contrast thresholds."""
    dvs_spread_ratio: NotNegative = 1.0
    """Factor on the standard deviation of the thresholds from pixel to pixel."""
    dvs_shot_noise_hz: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """Noise events per second of a black pixel, added to the preset's; a white pixel has a quarter of them. A frame of
    the event camera holds at most one ON and one OFF noise event of a pixel."""
    dvs_leak_hz: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """ON events per second of a pixel that sees no change, added to the preset's."""
    dvs_hot_pixels: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Share of hot pixels, 0 to 1, which emit 10 ON events per second whatever they see; chosen by dvs_seed."""
    image_noise: Annotated[float, Field(ge=0.0, le=255.0)] = 0.0
    """Standard deviation, in grey levels of 255, of Gaussian noise on each picture before the event camera sees it."""

    dvs_rate_hz: Positive | None = None
    """Frames per simulated second that the event camera sees, at most one per physics step; None: one per sample."""
    list_events: bool = False
    """Whether the event camera keeps individual events for `pop_events`."""

    command: CommandName = "tcsc"
    """The synchronous command that flies each action."""
    t_move_s: Seconds = 0.2
    """T_move, the simulated seconds of a command."""
    t_sample_s: Seconds = 0.2
    """T_sample, the simulated seconds between two samples of a command."""
    action: ActionKind = "velocity"
    """What continuous actions are shares of: velocity north, east, down; attitude (roll, pitch, yaw rate, throttle);
    body rates (roll, pitch, yaw, throttle); or the four motors. 0 hovers in all of them; below velocities T_move wants
    to be short, 0.02 s say."""
    speed_m_s: Speed = 1.0
    """Speed of a velocity at full deflection, m/s."""
    tilt_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 30.0
    """Roll and pitch of an attitude at full deflection, degrees."""
    rate_deg_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 180.0
    """Turn rate at full deflection, degrees per second: an attitude's yaw, all three of body rates."""
    altitude_m: Height = 10.0
    """Height of the start above the ground, metres."""
    max_commands: Count = 100
    """Commands after which a game is truncated."""

    timing: Literal["wall", "virtual", "lockstep"] = "lockstep"
    """Wall clock of the simulation: measured, modelled with latencies, or modelled without any."""
    clock_speed: ClockSpeed = 1.0
    """Simulated seconds per wall second."""
    profile: Literal["native", "airsim"] = "native"
    """How time is handled: exact to the tick, or as AirSim does."""
    t_th_wall_s: Cost = 0.001
    """TCSC's T_th, the client's latency in wall seconds; only for profile airsim, whose continue-for may end early."""
    latency: LatencyModel = Field(default_factory=of_the_profile)
    """Latency model of timing virtual, or the YAML file of one; by default the one that ships for the profile."""
    image_processing_s: Cost = 0.0003
    """Seconds that the event camera takes for a frame on the simulated wall clock of timing virtual."""
    mediation: Mediation = Field(default_factory=Mediation)
    """What of ADSC's gap is in TCSC's commands; by default nothing."""
    report_host_times: bool = False
    """Whether infos include `host_phase_s`, seconds measured on this machine's clock, which differ from run to run."""

    @model_validator(mode="after")
    def _keys_fit(self) -> Self:
        check_times(self.t_move_s, self.t_sample_s, PROFILES[self.profile].check_duration)
        listed, size = self.dvs_rate_hz is not None or self.list_events, self.picture_size
        wrong = {
            "dvs_rate_hz and list_events need observation dvs, and timing virtual or lockstep": (
                listed and (self.observation != "dvs" or self.timing == "wall")
            ),
            f"picture_size = {list(size)}: context planes need [256, 144]": (
                size != PICTURE_SIZE and self.context_planes() is not None
            ),
            "also_state needs pictures, beside which the state is: observation dvs, colour or depth": (
                self.also_state and self.observation == "state"
            ),
            "image_noise is of grey levels: it needs observation dvs or colour": (
                self.image_noise and self.observation == "depth"
            ),
        }
        if why := next((why for why, holds in wrong.items() if holds), None):
            raise ValueError(why)
        if (self.dvs_ticks or 0) * PROFILES[self.profile].tick_s > self.t_sample_s * (1 + RATE_ROUNDING):
            raise ValueError(
                f"dvs_rate_hz = {self.dvs_rate_hz:g}: must give a frame in each sample of {self.t_sample_s:g} s"
            )
        return self

    @model_validator(mode="after")
    def _gap_is_mediated_alone(self) -> Self:
        gap = self.mediation
        if gap == Mediation():
            return self
        if (self.command, self.timing, self.profile) != ("tcsc", "lockstep", "native") or self.dvs_rate_hz is not None:
            raise ValueError("mediation needs command tcsc, timing lockstep, profile native, and no dvs_rate_hz")
        if gap.image_age_s >= self.t_move_s:
            raise ValueError(f"mediation.image_age_s = {gap.image_age_s:g}: must be less than t_move_s")
        for name in ("gap_s", "image_age_s"):
            if seconds := getattr(gap, name):
                PROFILES[self.profile].check_duration(seconds, f"mediation.{name}")
        return self

    @property
    def dvs_ticks(self) -> int | None:
        """Ticks between two frames of the event camera; None if it sees only the samples."""
        return None if self.dvs_rate_hz is None else rate_ticks(self.dvs_rate_hz, self.profile)

    @property
    def scenery(self) -> str:
        """The scenery of its scene."""
        return PLAIN

    @property
    def typical_s(self) -> float:
        """Simulated seconds of a game that gets far, for estimates of the duration."""
        return self.max_commands * self.t_move_s

    @property
    def t_th_ns(self) -> int:
        """TCSC's T_th in simulated nanoseconds (Profile.t_th_ns)."""
        return PROFILES[self.profile].t_th_ns(self.t_th_wall_s, self.clock_speed, self.t_sample_s)

    @classmethod
    def __pydantic_init_subclass__(cls, **keys: Any) -> None:
        super().__pydantic_init_subclass__(**keys)
        owner = next(base for base in cls.__mro__ if "mirrored" in vars(base))
        replaced = {name for base in cls.__mro__[: cls.__mro__.index(owner)] for name in vars(base)}
        if any(hasattr(owner, name) for name in replaced if not name.startswith(("_", "model_"))):
            cls.mirrored = Task.mirrored  # type: ignore[method-assign]

    # --- senses -----------------------------------------------------------------------------------

    @property
    def frames_per_command(self) -> int:
        """Number of samples of a command."""
        return len(samples_due(self.t_move_s, self.t_sample_s))

    def sensor(self) -> Sensor:
        """Make the sensor that turns samples into frames."""
        if self.observation == "state":
            return StateSensor(self.features, self._blank_features())
        if self.observation == "dvs":
            return EventCamera(self.dvs_parameters, self.dvs_seed, self.list_events, self.picture_size)
        camera = ColourCamera if self.observation == "colour" else DepthCamera
        return camera(blank_frame(self.observation, self.picture_size))

    def _blank_features(self) -> NDArray[np.float32]:
        features = self.features(AT_REST, self.sample(np.random.default_rng(0), {}))
        return np.zeros_like(as_frame(self, features, "features"))

    @property
    def dvs_parameters(self) -> DvsParameters:
        """Parameters of the event camera."""
        noise = self.dvs_shot_noise_hz, self.dvs_leak_hz, self.dvs_spread_ratio, self.dvs_hot_pixels
        return _parameters(self.dvs_preset, self.dvs_threshold_ratio, *noise)

    def events_seed(self, seed: int) -> int:
        """Return the seed of the event camera's noise in a game with that seed; v2e's presets use 0 for all games."""
        return seed if self.dvs_shot_noise_hz > 0.0 or self.dvs_leak_hz > 0.0 else 0

    def observation_space(self) -> Any:
        """Return the space of observations, the Box of frames or, with `also_state`, a Dict of `image` and `state`."""
        if not self.also_state:
            return self.frames_space()
        state = spaces.Box(-np.inf, np.inf, (self.told,), np.float32)
        return spaces.Dict({"image": self.frames_space(), "state": state})

    @property
    def told(self) -> int:
        """Number of fields of the state beside frames; 0 without it."""
        return self._blank_features().size if self.also_state else 0

    def frames_space(self) -> spaces.Box:
        """Return the space of frames: those of `history` commands, then the context planes, on axis 0."""
        kind, size = self.observation, self.picture_size
        blank = self._blank_features() if kind == "state" else blank_frame(kind, size)
        context = self.context_planes()
        planes = 0 if context is None else len(context.knows)
        shape = (self.frames_per_command * self.history * blank.shape[0] + planes, *blank.shape[1:])
        if blank.dtype == np.uint8:
            return spaces.Box(0, 255, shape, np.uint8)
        return spaces.Box(-np.inf, np.inf, shape, np.float32)

    def context_planes(self) -> ContextPlanes | None:
        """Make the extra observations beside the frames; None without any."""
        return None

    def fields(self, state: Kinematics, course: Course) -> Sequence[Number]:
        """List the numbers of a frame of observation "state", for one state or for a `Kinematics` of arrays.

        They are position, attitude, velocity and body rate, in the units of `Kinematics`.
        """
        return [number for name in STATE_FIELDS for number in getattr(state, name)]

    def features(self, state: Kinematics, course: Course) -> NDArray[np.float32]:
        """Make a frame of observation "state"; a task's own may return lists of numbers, nested as its frames.

        Of n games, each number is an array (n,), and arrays of a frame (..., n).
        """
        features = as_frame(self, self.fields(state, course), "fields")
        return features if self.flat_state else features[None]

    def mirrored(self) -> Mirror | None:
        """Return how `fields` and actions turn left to right, if it is as likely that way round; None: it is not.

        A task that replaces another's functions does not inherit this one.
        """
        return None

    # --- actions: by default a velocity ---------------------------------------------------------------

    def action_space(self) -> spaces.Space[Action]:
        """Return the space of actions: shares, -1 to 1, of what `action` says (envs/task)."""
        return spaces.Box(-1.0, 1.0, (SIZES[self.action],), np.float32)

    @property
    def directions(self) -> Sequence[Vector] | None:
        """North, east and down of each discrete action, as shares of `speed_m_s`; None: the action is a direction."""
        return None

    @property
    def held_z_m(self) -> float | None:
        """NED z that every command holds, metres; None: commands also climb and descend."""
        return None

    def goal(self, action: Action) -> FlightGoal:
        """Return what an action asks for.

        An action is an int or an array (k,) of float64; those of n games are an array (n,) or (k, n), numbers of the
        goal then arrays (n,), and of the task's keys those that are sampled for each game (`with_conditions`), too.
        All actions ask for the same kind of goal. Those of "attitude" are roll, pitch (nose up), yaw rate and throttle;
        of "rates" roll, pitch and yaw rate and throttle, FRD; of "motors" front right, rear left, front left, rear
        right (AirSim v1.8.1, SimpleFlightApi.hpp: commandRollPitchYawrateThrottle, commandAngleRatesThrottle,
        commandMotorPWMs).
        """
        if self.action == "velocity":
            return self.velocity_goal(action)
        first, second, third, fourth = action
        tilt, rate = self.tilt_deg * RAD, self.rate_deg_s * RAD
        if self.action == "attitude":
            return AttitudeGoal(first * tilt, second * tilt, third * rate, throttle(fourth))
        if self.action == "rates":
            return BodyRatesGoal(first * rate, second * rate, third * rate, throttle(fourth))
        return MotorsGoal(throttle(first), throttle(second), throttle(third), throttle(fourth))

    def velocity_goal(self, action: Action) -> VelocityGoal:
        """Return the velocity that an action asks for; one action or those of n games, as `goal` has them."""
        if self.directions is not None:
            action = constant(np.array(self.directions), action)[action].T
        north, east, down = action
        return VelocityGoal((north * self.speed_m_s, east * self.speed_m_s, down * self.speed_m_s), self.held_z_m)

    # --- a game ---------------------------------------------------------------------------------------

    def sample(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        """Sample a game, or take it from the options of `reset`. Raises UserError for a wrong option."""
        return {}

    def sample_conditions(self, random: np.random.Generator, games: int) -> Mapping[str, float]:
        """Sample the conditions of a game, after `games` of its environment; empty: as the task has them."""
        return {}

    def with_conditions(self, conditions: Mapping[str, float]) -> Self:
        """Return the task under the conditions that `sample_conditions` returned."""
        return self

    def layout(self, course: Course) -> object:
        """Return a game's scene in the form of Client.set_lane; None: it stays as it is."""
        return None

    def lane_layout(self, course: Course) -> AnyLayout | None:
        """Return the same as a layout. Raises UserError for a wrong one."""
        from uavaccel.wire.image_api import lane_layout  # as heavy as the simulation

        layout = self.layout(course)
        if layout is not None and self.scene != "lane":
            raise UserError(f"a layout is of obstacles, light and wind of the lane: return None in scene {self.scene}")
        return None if layout is None else lane_layout(layout)

    def advance(self, before: AnyMoment, now: AnyMoment) -> Course:
        """Return the course after a command."""
        course: Course = now.course
        return course

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        """Return the reward of one command."""
        return 0.0 * now.commands

    def success(self, now: AnyMoment) -> Number:
        """Return whether the game is won, which ends it."""
        return now.touched & now.free

    def failure(self, now: AnyMoment) -> Number:
        """Return whether the game is lost, which ends it."""
        return now.touched

    def info(self, now: AnyMoment) -> Info:
        """Return the task's own items of infos, beside those of `FlightEnv`."""
        return dict(now.course)


def as_frame(task: Task, numbers: object, name: str) -> NDArray[np.float32]:
    """Return what a task's function of that name returned, as an array. Raises UserError for what has no shape."""
    try:
        return np.array(numbers, np.float32)  # of its own, which is kept
    except (TypeError, ValueError) as error:
        from uavaccel.envs.checks import Functions

        said = str(error).partition(". ")[0]
        raise Functions(task).wrong(name, f"must return numbers, in lists of equal length: {said}") from error


@lru_cache(maxsize=256)
def _parameters(preset: str, threshold_ratio: float, *noise: float) -> DvsParameters:
    return with_noise(with_thresholds(PRESETS[preset], threshold_ratio), *noise)


def rate_ticks(rate_hz: float, profile: str, key: str = "dvs_rate_hz") -> int:
    """Return the ticks between two frames. Raises ValueError unless the rate divides that of the physics."""
    physics_hz = NS_PER_S / PROFILES[profile].tick_ns
    ticks = round(physics_hz / rate_hz)
    if not ticks > 0 or abs(ticks * rate_hz / physics_hz - 1) > RATE_ROUNDING:
        raise ValueError(
            f"{key} = {rate_hz:g} does not divide the {physics_hz:g} steps per second of the physics; "
            f"{physics_hz / max(ticks, 1):g} does"
        )
    return ticks


def position_option(options: Mapping[str, object], name: str, drawn: NDArray[np.float64]) -> list[Number]:
    """Return a reset option of NED positions (3,) or (n, 3), with as many axes as `drawn`, the default.

    Raises UserError unless it is a list of finite numbers of that form.
    """
    try:
        given = np.array(options.get(name, drawn), float)
    except (TypeError, ValueError):
        given = np.array(np.nan)
    if given.ndim != drawn.ndim or given.shape[-1:] != (3,) or not np.isfinite(given).all() or not given.size:
        form = "[north, east, down]" if drawn.ndim == 1 else "[[north, east, down], ...]"
        raise UserError(f"reset: option {name} = {options[name]!r} must be {form} in metres")
    positions: list[Number] = given.tolist()
    return positions


def distance(a: Sequence[Number], b: Sequence[Number]) -> Number:
    """Return the metres between two positions, of one game or of many."""
    squares = ((here - there) * (here - there) for here, there in zip(a, b, strict=True))
    squared = reduce(operator.add, squares)  # Python 3.12's sum() rounds floats otherwise than arrays
    if isinstance(squared, np.ndarray):  # whose powers of 0.5 are not the square roots' bits on every processor
        return np.sqrt(squared)
    return math.sqrt(squared) if isinstance(squared, float) else squared.sqrt()


def told_of(task: Task, now: Moment) -> Info:
    """Return what infos say of a game's moment, beside the task's own items."""
    place = [float(each) for each in now.position_m]
    flown = {"position_m": place, "collision": now.collision, "commands": now.commands}
    return {"is_success": task.success(now), **flown}
