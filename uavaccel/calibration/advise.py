"""The ClockSpeed that ADSC tolerates: of a path under a latency model, with TCSC's gain over it, and of a policy."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd

from uavaccel.commands import COMMANDS, VelocityGoal, velocities
from uavaccel.files import Plain
from uavaccel.metrics.intervals import NORMAL_QUANTILE
from uavaccel.metrics.stlc import mean_stlc
from uavaccel.metrics.trajectory import Trajectory, command_gaps_s, mean_position_rmse, trajectory
from uavaccel.sim.profile import PROFILES
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import LatencyConfig
from uavaccel.wire.session import Session, VirtualSession

CLOCK_SPEEDS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
GAMES = 5
T_TH_WALL_S = 0.001  # as in the experiments' configurations
T_MOVES, ERROR = 0.82, 3.7
"""The gap, in T_move, at which policies lose five points of success, and the factor by which that misses tasks that
were not fitted: tools/fit_gap_law.py, of docs/tables/gap_law.csv (docs/why.md)."""


class SquareGame(NamedTuple):
    """A game's trajectory, the simulated gaps between its commands, and its wall time."""

    flight: Trajectory
    gap_s: np.ndarray
    wall_s: float


def fly_square(
    session: Session, command_name: str, clock_speed: float, t_move_s: float, rounds: int, seed: int, t_th_ns: int = 0
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


def advise(latency: LatencyConfig, profile: str, t_move_s: float, rounds: int, seed: int = 0) -> pd.DataFrame:
    """Fly the square path with `rounds` rounds, and return a row for each of CLOCK_SPEEDS and command, ADSC first.

    `error_m` is the games' median RMSE against the flight without latency, `stlc` and `speedup` are against ADSC at
    ClockSpeed 1.
    """
    rows: list[dict[str, Plain]] = []
    with VirtualSession("blocks", profile) as lockstep, VirtualSession("blocks", profile, latency) as session:

        def t_th(clock_speed: float) -> int:
            return PROFILES[profile].t_th_ns(T_TH_WALL_S, clock_speed, t_move_s)

        def games(command: str, clock_speed: float) -> tuple[list[Trajectory], float]:
            """Fly GAMES, and return their trajectories and their mean wall time."""
            flown = [
                fly_square(session, command, clock_speed, t_move_s, rounds, seed * GAMES + game, t_th(clock_speed))
                for game in range(GAMES)
            ]
            return [game.flight for game in flown], float(np.mean([game.wall_s for game in flown]))

        ideal = fly_square(lockstep, "tcsc", 1.0, t_move_s, rounds, seed, t_th(1.0)).flight
        real_time, real_time_s = games("adsc", 1.0)
        for clock_speed, command in product(CLOCK_SPEEDS, ("adsc", "tcsc")):
            flights, wall_s = games(command, clock_speed)
            errors_m, stlc = mean_position_rmse(flights, [ideal]), mean_stlc(flights, real_time)
            scores = {"error_m": np.median(errors_m), "stlc": np.median(stlc), "speedup": real_time_s / wall_s}
            rows.append({"clock_speed": clock_speed, "command": command, **scores})
    return pd.DataFrame(rows)


def sentence(advice: pd.DataFrame, error_m: float, t_move_s: float) -> str:
    """Return in words the highest ClockSpeed at which either command stays within the error."""
    within = advice[advice.error_m <= error_m]
    fastest = within.loc[within.groupby("command").speedup.idxmax()].set_index("command")
    slow, fast = f"ADSC leaves {error_m:g} m at any ClockSpeed", "so does TCSC: its own timer is too coarse"
    if "adsc" in fastest.index:
        adsc = fastest.loc["adsc"]
        slow = f"ADSC stays within {error_m:g} m up to ClockSpeed {adsc.clock_speed:g}, {adsc.speedup:.1f}x real time"
    if "tcsc" in fastest.index:
        fast = "TCSC up to {clock_speed:g}, {speedup:.1f}x".format(**fastest.loc["tcsc"])
    return f"With commands of {t_move_s:g} s {slow}; {fast}. Modelled."


def policy_sentence(t_move_s: float, thinking_s: float) -> str:
    """Return in words the ClockSpeed at which a policy loses five points of success, with its 95 % interval."""
    spread, middle = ERROR**NORMAL_QUANTILE, T_MOVES * t_move_s / thinking_s
    speed, low, high = (f"{float(f'{each:.2g}'):g}" for each in (middle, middle / spread, middle * spread))
    return (
        f"Policies trained without a gap lose five points of success at one of about {T_MOVES:g} T_move: with "
        f"{thinking_s:g} s of thinking and messages at ClockSpeed {speed} (95 %: {low} to {high}). A rule of thumb, "
        f"which missed tasks that it was not fitted on by a factor of {ERROR:g} (docs/why.md)."
    )
