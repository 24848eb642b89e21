"""ADSC, the AirSim Default Synchronous Command (paper, section II-B).

The simulation runs on while the client waits for the command's end, gathers and thinks: what TCSC removes.
"""

from __future__ import annotations

from collections.abc import Iterator

from uavaccel.commands.protocol import MissionClient
from uavaccel.commands.slices import samples_due
from uavaccel.kinematics import Kinematics, VelocityGoal


def begin(client: MissionClient) -> None:
    """Before the first command of a game: the clock runs from now on."""
    client.run()


def adsc(
    client: MissionClient, velocity: VelocityGoal, t_move_s: float, t_sample_s: float
) -> Iterator[Kinematics]:
    """Fly `velocity` for T_move, join, and yield the state every T_sample.

    One thread: it waits for the future or the next sample, whichever is due first. Every sample is taken by
    pause, gather, continue, the last one after the join.
    """
    t_issue = client.now_ns()
    future = client.move_async(velocity, t_move_s)
    paused_ns = 0
    for t_due in samples_due(t_move_s, t_sample_s)[:-1]:
        if client.join(future, t_issue + paused_ns + round(t_due / client.clock_speed)):
            break
        t_pause = client.now_ns()
        state = gather(client)
        paused_ns += client.now_ns() - t_pause
        yield state
    client.join(future)
    yield gather(client)


def gather(client: MissionClient) -> Kinematics:
    """One sample: the state of a moment at which the clock stood."""
    client.pause()
    state = client.kinematics()
    client.run()
    return state
