"""ADSC and TCSC on one square, by a client that thinks before each command: what `uavaccel watch` shows of itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.commands.paths import velocities
from uavaccel.draw.labels import command_name
from uavaccel.units import NS_PER_S, seconds_to_ns
from uavaccel.watch.track import Track, track_of
from uavaccel.wire.latency import shipped_latency
from uavaccel.wire.session import Session, open_session

T_MOVE_S = 2.0


def fly_side_by_side(clock_speed: float, think_s: float, rounds: int, seed: int) -> list[Track]:
    """The square under both commands, `think_s` of the client's wall time before each but the first.

    In `virtual`, with the latencies that ship: the same flights for the same arguments.
    """
    with open_session("virtual", latency=shipped_latency()) as session:
        return [fly_square(session, name, clock_speed, think_s, rounds, seed) for name in ("adsc", "tcsc")]


def fly_square(
    session: Session, command_name_: str, clock_speed: float, think_s: float, rounds: int, seed: int
) -> Track:
    """One flight on a simulated wall clock, to which the client's thinking is charged."""
    client, command = session.start_game(clock_speed, np.random.SeedSequence(seed)), COMMANDS[command_name_]
    path, origin_ns = velocities("square", rounds), client.kinematics().time_ns
    command.begin(client)
    issued_ns, returned = [], []
    for number, velocity in enumerate(path):
        if number:
            client.transport.clock.charge(seconds_to_ns(think_s))
        issued_ns.append(client.now_ns())
        for state in command.fly(client, VelocityGoal(velocity), T_MOVE_S, T_MOVE_S):
            returned.append((client.now_ns(), state.time_ns))
    arrays = client.recording().arrays()
    marks = _marks(issued_ns, arrays["command_start_s"], returned, origin_ns)
    return track_of(command_name(command_name_), clock_speed, arrays, path, marks)


def _marks(
    issued_ns: Sequence[int], command_start_s: NDArray[np.float64], returned: Sequence[tuple[int, int]], origin_ns: int
) -> NDArray[np.float64]:
    """Wall and simulated seconds (m, 2) at which commands were issued and had returned."""
    marks = []
    for issue_ns, start_s, (wall_ns, time_ns) in zip(issued_ns, command_start_s, returned, strict=True):
        marks.append(((issue_ns - issued_ns[0]) / NS_PER_S, start_s))
        marks.append(((wall_ns - issued_ns[0]) / NS_PER_S, (time_ns - origin_ns) / NS_PER_S))
    return np.maximum.accumulate(np.array(marks))
