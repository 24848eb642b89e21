"""`uavaccel advise`: the ClockSpeed up to which ADSC is accurate on this machine, or in AirSim, and TCSC's gain."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from uavaccel.bench.advice import advise, sentence
from uavaccel.cli.checks import check_number, check_profile
from uavaccel.cli.terminal import console
from uavaccel.config import Config, validate
from uavaccel.errors import UserError
from uavaccel.limits import MOST_SECONDS
from uavaccel.sim.profile import PROFILES
from uavaccel.wire.latency import LatencyModel

HEADER = ("ClockSpeed", "ADSC error m", "STLC", "speed-up", "TCSC error m", "STLC", "speed-up")
MOST_ROUNDS = 1000


class _Model(Config):
    profile: str
    latency: LatencyModel


def show_advice(
    t_move_s: float, error_m: float, rounds: int, latency_file: Path | None, profile: str
) -> None:
    """Fly the model; print a table of ClockSpeeds and a sentence. Raises UserError with one line."""
    check_profile(profile)
    if not error_m > 0:
        raise UserError(f"--error {error_m:g}: must be above 0 metres")
    check_number("--rounds", rounds, 1, MOST_ROUNDS)
    if not 0.0 < t_move_s <= MOST_SECONDS:
        raise UserError(f"--t-move {t_move_s:g}: must be above 0 and at most {MOST_SECONDS:g} seconds")
    PROFILES[profile].check_duration(t_move_s, "--t-move")
    given = {} if latency_file is None else {"latency": str(latency_file)}
    latency = validate(_Model, {"profile": profile, **given}, "advise").latency
    table = Table(*HEADER, box=None, pad_edge=False)
    found = []
    for each in advise(latency, profile, t_move_s, rounds):
        found.append(each)
        adsc = (each.adsc_error_m, each.adsc_stlc, each.adsc_speedup)
        tcsc = (each.tcsc_error_m, each.tcsc_stlc, each.tcsc_speedup)
        table.add_row(f"{each.clock_speed:g}x", *(f"{number:.3g}" for number in adsc + tcsc))
    console.print(table)
    console.print(sentence(found, error_m, t_move_s))
