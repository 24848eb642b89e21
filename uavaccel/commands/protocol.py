"""The client interface of synchronous commands, which any object with these methods implements."""

from __future__ import annotations

from typing import Protocol, TypeVar

from uavaccel.kinematics import FlightGoal, Kinematics

FutureT = TypeVar("FutureT")
SampleT = TypeVar("SampleT", covariant=True)


class Pausable(Protocol):
    """A client that pauses and resumes the simulation."""

    def pause(self) -> None: ...

    def run(self) -> None: ...


class MissionClient(Pausable, Protocol[FutureT, SampleT]):
    """The mission computer's side of the Client API (paper, section II-B)."""

    @property
    def clock_speed(self) -> float:
        """Simulated seconds per wall second."""
        ...

    def now_ns(self) -> int:
        """Return the time on the client's wall clock."""
        ...

    def move_async(self, goal: FlightGoal, t_move_s: float) -> FutureT:
        """Issue a velocity command and return its future without waiting."""
        ...

    def join(self, future: FutureT, deadline_ns: int | None = None) -> bool:
        """Wait for the command's end and return True, or False if the wall deadline comes first."""
        ...

    def continue_for(self, duration_ns: int) -> Kinematics:
        """Run for a simulated time, pause, and return the state."""
        ...

    def kinematics(self) -> Kinematics:
        """Return the present state."""
        ...

    def read_sample(self, state: Kinematics) -> SampleT:
        """Gather a sample while the simulation is paused: the state, with or without images."""
        ...
