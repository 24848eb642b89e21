"""A game on the square path, flown in any session, for advice and for the agreement of clocks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.commands.paths import velocities
from uavaccel.metrics.trajectory import Trajectory, command_gaps_s, trajectory
from uavaccel.units import NS_PER_S
from uavaccel.wire.session import Session


class SquareGame(NamedTuple):
    """A game's trajectory, the simulated gaps between its commands, and its wall time."""

    flight: Trajectory
    gap_s: np.ndarray
    wall_s: float


def fly_square(
    session: Session,
    command_name: str,
    clock_speed: float,
    t_move_s: float,
    rounds: int,
    seed: int,
    t_th_ns: int = 0,
) -> SquareGame:
    """Fly the square of 1 m/s commands `rounds` times, one sample per command; `seed` is that of the latencies."""
    client = session.start_game(clock_speed, np.random.SeedSequence(seed))
    command = COMMANDS[command_name]
    command.begin(client)
    start_ns = client.now_ns()
    for velocity in velocities("square", rounds):
        for _ in command.fly(client, VelocityGoal(velocity), t_move_s, t_move_s, t_th_ns):
            pass
    wall_s = (client.now_ns() - start_ns) / NS_PER_S
    arrays = client.recording().arrays()
    gap_s = command_gaps_s(arrays["command_start_s"], arrays["command_end_s"])
    return SquareGame(trajectory(arrays["time_s"], arrays["position_m"]), gap_s, wall_s)
