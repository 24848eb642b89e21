"""What a synchronous command needs of a client: any object with these methods, ours or one around AirSim's own."""

from __future__ import annotations

from typing import Protocol, TypeVar

from uavaccel.kinematics import Kinematics, VelocityGoal

FutureT = TypeVar("FutureT")
SampleT = TypeVar("SampleT", covariant=True)


class Pausable(Protocol):
    """A client that stops and starts the simulation's clock."""

    def pause(self) -> None: ...

    def run(self) -> None: ...


class MissionClient(Pausable, Protocol[FutureT, SampleT]):
    """The mission computer's side of the Client API (paper, section II-B)."""

    @property
    def clock_speed(self) -> float:
        """Simulated seconds per wall second."""
        ...

    def now_ns(self) -> int:
        """The client's wall clock."""
        ...

    def move_async(self, goal: VelocityGoal, t_move_s: float) -> FutureT:
        """Issue a velocity command; returns its future without waiting."""
        ...

    def join(self, future: FutureT, deadline_ns: int | None = None) -> bool:
        """Wait for the command's end, or for the wall deadline if that comes first: then False."""
        ...

    def continue_for(self, duration_ns: int) -> Kinematics:
        """Run for a simulated time, pause again and return the state."""
        ...

    def kinematics(self) -> Kinematics: ...

    def gather(self, state: Kinematics) -> SampleT:
        """What the mission computer takes as a sample while the clock stands: the state, with images or without."""
        ...
