"""One game of DP1: the path flown with one command at one ClockSpeed, and what is kept of it."""

from __future__ import annotations

import numpy as np

from uavaccel.commands import COMMANDS
from uavaccel.commands.paths import velocities
from uavaccel.kinematics import VelocityGoal
from uavaccel.suites.disturbed import note_stalls
from uavaccel.suites.dp1.cases import Case, Dp1Row
from uavaccel.suites.dp1.config import Dp1Config
from uavaccel.suites.experiment import t_th_ns
from uavaccel.units import NS_PER_S
from uavaccel.wire.client import Client
from uavaccel.wire.session import Session

SCENE = "blocks"


def fly_game(config: Dp1Config, case: Case, session: Session) -> tuple[Dp1Row, dict[str, np.ndarray]]:
    """Fly one game: its row, without the arrays' path, and its arrays."""
    client = session.start_game(case.clock_speed, case.seed(config.seed))
    wall_s = fly_path(config, case, client)
    speed, recording = client.speed(), client.recording()
    tick_s = recording.tick_ns / NS_PER_S
    row: Dp1Row = {
        "suite": "dp1",
        "case": case.id,
        "role": case.role,
        "command": case.command,
        "clock_speed": case.clock_speed,
        "t_move_s": case.t_move_s,
        "rounds": case.rounds,
        "game": case.game,
        "timing": case.timing,
        "profile": config.profile,
        "seed": config.seed,
        "commands": len(recording.commands),
        "samples_dropped": recording.dropped,
        "wall_s": wall_s,
        "sim_time_s": speed["simulated_ns"] / NS_PER_S,
        "duration_s": round(int(recording.commands[-1, 1]) * tick_s, 9),
        "real_time_factor": speed["real_time_factor"],
        "lost_wall_s": speed["lost_wall_ns"] / NS_PER_S,
        "error": speed["failure"],
    }
    note_stalls(row, client.transport.stalled_ns)
    return row, recording.arrays()


def fly_path(config: Dp1Config, case: Case, client: Client) -> float:
    """Fly the case's path; seconds of wall time from the first issue to the last return."""
    command = COMMANDS[case.command]
    t_sample_s = config.t_sample_s or case.t_move_s
    t_th = t_th_ns(config, case.clock_speed, t_sample_s)
    command.begin(client)
    start_ns = client.now_ns()
    for velocity in velocities(case.path, case.rounds, config.speed_m_s):
        for _ in command.fly(
            client, VelocityGoal(velocity, config.height_m), case.t_move_s, t_sample_s, t_th
        ):
            pass
    return (client.now_ns() - start_ns) / NS_PER_S
