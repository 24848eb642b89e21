"""The paper's two synchronous commands, ADSC and TCSC, which depend only on a client's interface."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

from uavaccel.commands import adsc as _adsc
from uavaccel.commands import tcsc as _tcsc
from uavaccel.commands.adsc import adsc
from uavaccel.commands.protocol import FutureT, MissionClient, Pausable, SampleT
from uavaccel.commands.tcsc import tcsc
from uavaccel.kinematics import FlightGoal, VelocityGoal

__all__ = ["COMMANDS", "MissionClient", "SynchronousCommand", "VelocityGoal", "adsc", "tcsc"]


class Fly(Protocol):
    """The function of a command: it flies, and yields what the client gathers every T_sample."""

    def __call__(
        self,
        client: MissionClient[FutureT, SampleT],
        goal: FlightGoal,
        t_move_s: float,
        t_sample_s: float,
        t_th_ns: int = 0,
        late_ns: int = 0,
    ) -> Iterator[SampleT]: ...


class SynchronousCommand(NamedTuple):
    """A command, and what a game has to do before its first one."""

    begin: Callable[[Pausable], None]
    fly: Fly


COMMANDS = {"adsc": SynchronousCommand(_adsc.begin, adsc), "tcsc": SynchronousCommand(_tcsc.begin, tcsc)}
