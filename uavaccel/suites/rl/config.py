"""Configuration of the RL experiment: the trainings, how they are evaluated, and which of them a run selects."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from uavaccel.config import Config
from uavaccel.limits import ClockSpeed, Games
from uavaccel.suites.experiment import ClockSpeeds, CommandName, CommandNames, Experiment, ProfileName
from uavaccel.suites.parts import Part

SimulatedTiming = Literal["virtual", "lockstep"]


class Block(Config):
    """Trainings that differ in command and ClockSpeed."""

    profile: ProfileName
    """How the simulator handles time: native is exact to the step, airsim behaves like AirSim."""
    timing: SimulatedTiming = "virtual"
    """Which simulated wall clock the policies are trained under: virtual with latencies, lockstep without."""
    command: CommandNames = ("adsc", "tcsc")
    """tcsc pauses the simulation while the program works, adsc does not; each value is flown."""
    clock_speed: ClockSpeeds
    """Simulated seconds per wall second that are asked for; each value is flown."""
    variant: Annotated[str, Field(pattern=r"^[a-z0-9_]*$")] = ""
    """Distinguishes these trainings from others of the same command and ClockSpeed; claims use those without one."""
    task: dict[str, Any] = Field(default_factory=dict)
    """Dotted keys of the task, in training and evaluation."""
    training: dict[str, Any] = Field(default_factory=dict)
    """Other dotted keys of the training; `inference_s`, the time of a decision, also applies to evaluations."""


class RlConfig(Experiment):
    """`suite: rl`."""

    suite: Literal["rl"]
    seeds: Annotated[int, Field(ge=1, le=1000)] = 1
    """Trainings of each cell, with seeds `seed`, `seed` + 1 and so on; evaluations have seed 0 or their keys'."""
    games: Games = 5000
    """Games of each training."""
    cells: Annotated[tuple[Block, ...], Field(min_length=1)]
    """Which policies are trained: blocks of profile, timing, commands and ClockSpeeds."""
    training: Part = Part(experiment="train")
    """How each policy is trained: an experiment, and keys that differ from it."""
    evaluation: Part = Part(experiment="evaluate", keys={"games": 100})
    """How each policy is evaluated: an experiment, and keys that differ from it."""
    evaluation_clock_speed: ClockSpeed = 1.0
    """ClockSpeed of the evaluations; 1 is real time, as in the paper (section IV-D), on a simulated wall clock."""
    as_trained: bool = False
    """Whether policies are also evaluated at the ClockSpeed of their training."""
    interchange: bool = True
    """Whether policies are also evaluated with the command that they were not trained with (section III-C3)."""
    exact_seeds: Annotated[int, Field(ge=0, le=1000)] = 0
    """Number of seeds whose policies are also evaluated in the exact simulator, once all are trained."""
    exact: Part = Part(experiment="evaluate")
    """That evaluation: in real time, with the command of the training, on the lanes of `evaluation`."""

    command: tuple[CommandName, ...] = ()
    """Commands to select; this and the next three keys select all cells where they are left out."""
    clock_speed: tuple[float, ...] = ()
    """Choose the cells of these ClockSpeeds; without values, all."""
    profile: ProfileName | None = None
    """Choose the cells of this profile; without it, of both."""
    timing: SimulatedTiming | None = None
    """Choose the cells of this timing; without it, of both."""

    @model_validator(mode="after")
    def _has_what_it_selects(self) -> RlConfig:
        for name in ("command", "clock_speed"):
            known = {value for block in self.cells for value in getattr(block, name)}
            for value in getattr(self, name):
                if value not in known:
                    there_are = ", ".join(str(each) for each in sorted(known))
                    raise ValueError(f"{name} = {value} is in no cell; there are {there_are}")
        if not any(self.selects(block, each) for block in self.cells for each in pairs(block)):
            raise ValueError("command, clock_speed, profile and timing together select no cell")
        return self

    @model_validator(mode="after")
    def _names_each_cell_once(self) -> RlConfig:
        kinds = [((block.variant, block.profile, block.timing), pairs(block)) for block in self.cells]
        names = [(*kind, *pair) for kind, each in kinds for pair in each]
        for name in names:
            if names.count(name) > 1:
                _, profile, timing, clock_speed, command = name
                raise ValueError(
                    f"cells has {profile} {timing} {command} at {clock_speed:g}x twice; give one a `variant`"
                )
        return self

    def selects(self, block: Block, pair: tuple[float, CommandName]) -> bool:
        """Return whether a run selects this cell of a block."""
        clock_speed, command = pair
        return (
            clock_speed in (self.clock_speed or (clock_speed,))
            and command in (self.command or (command,))
            and block.profile == (self.profile or block.profile)
            and block.timing == (self.timing or block.timing)
        )


def pairs(block: Block) -> list[tuple[float, CommandName]]:
    """Return ClockSpeed and command of each cell of a block."""
    return [(clock_speed, command) for clock_speed in block.clock_speed for command in block.command]
