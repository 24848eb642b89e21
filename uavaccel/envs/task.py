"""Configuration of the obstacle lane as a learning task: all that the paper leaves open is chosen here."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from uavaccel.config import Config
from uavaccel.errors import UserError
from uavaccel.sim.lane.file import LaneFile, lane_written_out
from uavaccel.sim.lane.layout import EVALUATION_SEEDS, LENGTH_M, Difficulty, Split, lane_seed
from uavaccel.sim.profile import PROFILES
from uavaccel.units import seconds_to_ns
from uavaccel.wire.latency import LatencyConfig, shipped_latency

NotNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]


class LaneTask(Config):
    """What an `ObstacleLane` environment is made of. T_move, T_sample and speed are the paper's (III-C1)."""

    split: Split = "training"
    """Which lanes are drawn; no lane is both a training and an evaluation lane."""
    difficulty: Difficulty = Difficulty()
    lane: LaneFile | None = None
    """One lane for all games, instead of drawn ones: written out, or the name of its YAML file."""
    observation: Literal["dvs", "state", "colour", "depth"] = "dvs"
    history: Annotated[int, Field(ge=1, le=8)] = 1
    """Commands whose frames are in one observation, the newest last."""
    blank_images: bool = False
    """Frames without content, for the baseline that shows what can be learned without seeing."""
    dvs_preset: Literal["clean", "constructor", "command_line", "noisy"] = "clean"
    dvs_seed: Annotated[int, Field(ge=0)] = 0
    """Draws the thresholds of the sensor's pixels, which stay as they are from game to game."""

    command: Literal["adsc", "tcsc"] = "tcsc"
    t_move_s: Positive = 1.0
    t_sample_s: Positive = 0.33
    speed_m_s: Positive = 1.0
    headings_deg: tuple[float, ...] = (-60.0, -30.0, 0.0, 30.0, 60.0)
    """The actions: directions of flight, 0 along the lane, positive to the east."""
    altitude_m: Positive = 2.0
    """Height that every command holds, as AirSim's moveByVelocityZ; SimpleFlight answers slower the higher it is."""
    max_commands: Annotated[int, Field(ge=1)] = 300

    progress_reward: float = 0.1
    """A metre northwards."""
    collision_reward: float = -1.0
    goal_reward: float = 0.0

    timing: Literal["wall", "virtual", "lockstep"] = "lockstep"
    clock_speed: Positive = 1.0
    profile: Literal["native", "airsim"] = "native"
    t_th_wall_s: NotNegative = 0.001
    """TCSC's T_th, the client's latency; used by `airsim` alone, whose continue-for may end early."""
    latency: LatencyConfig | None = None
    """The latency model that `virtual` draws from; the shipped one where none is given."""
    image_processing_s: NotNegative = 0.0003
    """What the DVS of one frame costs the simulated wall clock of `virtual`."""
    report_host_times: bool = False
    """Whether infos have `host_phase_s`, measured on this machine's clock: never the same twice."""

    @field_validator("lane", mode="before")
    @classmethod
    def _written_out(cls, lane: Any) -> Any:
        return lane_written_out(lane)

    @field_validator("headings_deg")
    @classmethod
    def _any_heading(cls, headings: tuple[float, ...]) -> tuple[float, ...]:
        if not headings:
            raise ValueError("needs at least one heading")
        return headings

    @property
    def t_th_ns(self) -> int:
        """T_th in simulated nanoseconds: 0 where continue-for is exact; else the latency times ClockSpeed.

        At most a tenth of T_sample, at least a tick: a shorter continue-for may not bring any.
        """
        profile = PROFILES[self.profile]
        if profile.exact_times:
            return 0
        latency_s = min(self.t_th_wall_s * self.clock_speed, 0.1 * self.t_sample_s)
        return max(seconds_to_ns(latency_s), profile.tick_ns)

    @property
    def typical_s(self) -> float:
        """Simulated seconds of a game that gets far, for estimates."""
        return min(self.max_commands * self.t_move_s, 1.3 * LENGTH_M / self.speed_m_s)

    def wire_lane(self, index: int) -> dict[str, Any]:
        """Lane `index` of the split, or the own one, as Client.set_lane takes it. Raises UserError past a million."""
        if self.lane is not None:
            return self.lane.model_dump(mode="json")
        if not 0 <= index < EVALUATION_SEEDS:
            raise UserError(f"lane {index} does not exist: lanes are 0 to {EVALUATION_SEEDS - 1}")
        return {"seed": lane_seed(self.split, index), "difficulty": self.difficulty.model_dump(mode="json")}

    def latency_model(self) -> LatencyConfig:
        """The given latency model, or the one that ships."""
        if self.latency is not None:
            return self.latency
        return shipped_latency(self.profile)
