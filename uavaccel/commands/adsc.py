"""ADSC, the AirSim Default Synchronous Command (paper, section II-B).

The simulation continues while the client waits for the command's end and computes, which TCSC avoids.
"""

from __future__ import annotations

from collections.abc import Iterator

from uavaccel.commands.protocol import FutureT, MissionClient, Pausable, SampleT
from uavaccel.commands.slices import samples_due
from uavaccel.kinematics import FlightGoal


def begin(client: Pausable) -> None:
    """Prepare a game for its first command: the clock runs from now on."""
    client.run()


def adsc(
    client: MissionClient[FutureT, SampleT],
    goal: FlightGoal,
    t_move_s: float,
    t_sample_s: float,
    t_th_ns: int = 0,
    late_ns: int = 0,
) -> Iterator[SampleT]:
    """Fly `goal` for T_move, join, and yield a sample every T_sample; the last two arguments are TCSC's, and ignored.

    One thread: it waits for the future or the next sample, whichever is due first. Every sample is taken by
    pause, gather, continue, the last one after the join.
    """
    t_issue = client.now_ns()
    future = client.move_async(goal, t_move_s)
    paused_ns = 0
    for t_due in samples_due(t_move_s, t_sample_s)[:-1]:
        if client.join(future, t_issue + paused_ns + round(t_due / client.clock_speed)):
            break
        t_pause = client.now_ns()
        sample = read_sample(client)
        paused_ns += client.now_ns() - t_pause
        yield sample
    client.join(future)
    yield read_sample(client)


def read_sample(client: MissionClient[FutureT, SampleT]) -> SampleT:
    """Gather one sample while the simulation is paused."""
    client.pause()
    sample = client.read_sample(client.kinematics())
    client.run()
    return sample
