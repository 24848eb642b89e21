"""The ClockSpeed that ADSC tolerates under a latency model, and TCSC's gain over it, both modelled on a square path."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.commands.paths import velocities
from uavaccel.metrics.stlc import mean_stlc
from uavaccel.metrics.trajectory import Trajectory, command_gaps_s, mean_position_rmse, trajectory
from uavaccel.sim.profile import PROFILES
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import LatencyConfig
from uavaccel.wire.session import Session, VirtualSession

CLOCK_SPEEDS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
GAMES = 5
T_TH_WALL_S = 0.001  # as in the experiments' configurations


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


class Advice(NamedTuple):
    """At one ClockSpeed, each command's median RMSE against the flight without latency, its STLC, and its speed-up."""

    clock_speed: float
    adsc_error_m: float
    adsc_stlc: float
    adsc_speedup: float
    tcsc_error_m: float
    tcsc_stlc: float
    tcsc_speedup: float


def advise(latency: LatencyConfig, profile: str, t_move_s: float, rounds: int, seed: int = 0) -> Iterator[Advice]:
    """Yield the advice for each of CLOCK_SPEEDS, from flights of the square path with `rounds` rounds."""
    with VirtualSession("blocks", profile) as lockstep, VirtualSession("blocks", profile, latency) as session:

        def t_th(clock_speed: float) -> int:
            return PROFILES[profile].t_th_ns(T_TH_WALL_S, clock_speed, t_move_s)

        def games(command: str, clock_speed: float) -> list[SquareGame]:
            return [
                fly_square(session, command, clock_speed, t_move_s, rounds, seed * GAMES + game, t_th(clock_speed))
                for game in range(GAMES)
            ]

        ideal = fly_square(lockstep, "tcsc", 1.0, t_move_s, rounds, seed, t_th(1.0))
        real_time = games("adsc", 1.0)
        for clock_speed in CLOCK_SPEEDS:
            scores = [_score(games(command, clock_speed), ideal, real_time) for command in ("adsc", "tcsc")]
            yield Advice(clock_speed, *scores[0], *scores[1])


def _score(
    games: Sequence[SquareGame], ideal: SquareGame, real_time: Sequence[SquareGame]
) -> tuple[float, float, float]:
    flights = [game.flight for game in games]
    error_m = float(np.median(mean_position_rmse(flights, [ideal.flight])))
    stlc = float(np.median(mean_stlc(flights, [game.flight for game in real_time])))
    speedup = np.mean([game.wall_s for game in real_time]) / np.mean([game.wall_s for game in games])
    return error_m, stlc, float(speedup)


def sentence(advice: Sequence[Advice], error_m: float, t_move_s: float) -> str:
    """Return in words the highest ClockSpeed at which either command stays within the error."""
    adsc = _fastest([each for each in advice if each.adsc_error_m <= error_m], "adsc_speedup")
    tcsc = _fastest([each for each in advice if each.tcsc_error_m <= error_m], "tcsc_speedup")
    slow = (
        f"ADSC stays within {error_m:g} m up to ClockSpeed {adsc.clock_speed:g}, {adsc.adsc_speedup:.1f}x real time"
        if adsc
        else f"ADSC leaves {error_m:g} m at any ClockSpeed"
    )
    fast = (
        f"TCSC up to {tcsc.clock_speed:g}, {tcsc.tcsc_speedup:.1f}x"
        if tcsc
        else "so does TCSC: its own timer is too coarse"
    )
    return f"With commands of {t_move_s:g} s {slow}; {fast}. Modelled."


def _fastest(within: Sequence[Advice], key: str) -> Advice | None:
    return max(within, key=lambda each: float(getattr(each, key)), default=None)
