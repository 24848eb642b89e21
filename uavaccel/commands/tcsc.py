"""TCSC, the Time-Controlled Simulation Command (paper, section III-B and Figure 4).

The simulation is paused whenever no command flies, so that latencies do not affect the trajectory.
"""

from __future__ import annotations

from collections.abc import Iterator

from uavaccel.commands.protocol import FutureT, MissionClient, Pausable, SampleT
from uavaccel.commands.slices import slice_of
from uavaccel.kinematics import FlightGoal
from uavaccel.units import seconds_to_ns


def begin(client: Pausable) -> None:
    """Prepare a game for its first command: the simulation is paused between commands."""
    client.pause()


def tcsc(
    client: MissionClient[FutureT, SampleT],
    goal: FlightGoal,
    t_move_s: float,
    t_sample_s: float,
    t_th_ns: int = 0,
    late_ns: int = 0,
) -> Iterator[SampleT]:
    """Fly `goal` for T_move and yield the state every T_sample, the simulation paused before and after.

    `t_th_ns`: simulated time below which a slice that ended early counts as complete; the client's latency times
    ClockSpeed where continue-for is a wall timer, 0 where it is exact. The paper never advances T_start; here
    deadlines are absolute, so neither an early nor a late end adds up. `late_ns`, less than T_move: simulated time for
    which the last command's goal acts on before this one does, to study what the age of its images costs.
    """
    state = client.kinematics()  # 1  measure the start, issue the command
    t_start = state.time_ns
    t_issue: int | None = t_start + late_ns
    t_move, t_sample = seconds_to_ns(t_move_s), seconds_to_ns(t_sample_s)
    while t_move > 0:
        t_wakeup = slice_of(t_move, t_sample)
        if t_issue is not None and t_issue < t_start + t_wakeup:
            if t_issue > state.time_ns:
                state = client.continue_for(t_issue - state.time_ns)
            client.move_async(goal, t_move_s)
            t_issue = None
        while (t_left := t_start + t_wakeup - state.time_ns) > t_th_ns:
            state = client.continue_for(t_left)  # 2  run, then pause; 3  woke early: run the difference
        yield client.read_sample(state)  # 4  gather, the clock stopped
        t_start, t_move = t_start + t_wakeup, t_move - t_wakeup
