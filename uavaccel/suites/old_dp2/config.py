"""DP2's configuration: lane, path, event camera, image guard, and a model of perturbed images."""

from __future__ import annotations

from collections.abc import Sized
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from uavaccel import limits
from uavaccel.commands.slices import check_times
from uavaccel.config import Config
from uavaccel.envs.task import rate_ticks
from uavaccel.limits import Seconds, Seed
from uavaccel.sim.lane.file import LaneFile, parse_lane
from uavaccel.sim.lane.layout import Difficulty, LaneLayout, Share
from uavaccel.sim.profile import PROFILES
from uavaccel.suites.experiment import FlightExperiment, Timing
from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.perturb import PerturbationKind
from uavaccel.wire.image_api import lane_layout

NotNegative = Annotated[float, Field(ge=0.0)]
Velocity = tuple[limits.Velocity, limits.Velocity]


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
        profile = PROFILES[self.profile]
        check_times(self.t_move_s, self.t_sample_s, profile.check_duration)
        return self

    @model_validator(mode="after")
    def _dvs_is_on_board(self) -> Dp2Config:
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
