"""`uavaccel advise`: how fast ADSC may fly on this machine, or in AirSim, and what TCSC would gain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from uavaccel.bench.advice import Advice, advise, sentence
from uavaccel.config import Config, validate
from uavaccel.errors import UserError
from uavaccel.limits import MOST_SECONDS
from uavaccel.sim.profile import PROFILES
from uavaccel.wire.latency import LatencyModel

HEADER = ("ClockSpeed", "ADSC error m", "STLC", "speed-up", "TCSC error m", "STLC", "speed-up")

MOST_ROUNDS = 1000

console = Console(highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class AdviceRequest:
    """What was asked for."""

    t_move_s: float
    error_m: float
    rounds: int
    latency: Path | None
    profile: str


class _Model(Config):
    profile: str
    latency: LatencyModel


def show_advice(request: AdviceRequest) -> None:
    """Fly the model, print a table and a sentence. Raises UserError with one clear line."""
    if request.profile not in PROFILES:
        raise UserError(f"--profile {request.profile}: must be {' or '.join(PROFILES)}")
    if not request.error_m > 0:
        raise UserError(f"--error {request.error_m:g}: must be above 0 metres")
    if not 1 <= request.rounds <= MOST_ROUNDS:
        raise UserError(f"--rounds {request.rounds}: must be 1 to {MOST_ROUNDS}")
    if not 0.0 < request.t_move_s <= MOST_SECONDS:
        raise UserError(
            f"--t-move {request.t_move_s:g}: must be above 0 and at most {MOST_SECONDS:g} seconds"
        )
    PROFILES[request.profile].check_duration(request.t_move_s, "--t-move")
    given = {} if request.latency is None else {"latency": str(request.latency)}
    latency = validate(_Model, {"profile": request.profile, **given}, "advise").latency
    table = Table(*HEADER, box=None, pad_edge=False)
    found = []
    for each in advise(latency, request.profile, request.t_move_s, request.rounds):
        found.append(each)
        table.add_row(*_row(each))
    console.print(table)
    console.print(sentence(found, request.error_m, request.t_move_s))


def _row(each: Advice) -> tuple[str, ...]:
    numbers = (
        each.adsc_error_m,
        each.adsc_stlc,
        each.adsc_speedup,
        each.tcsc_error_m,
        each.tcsc_stlc,
        each.tcsc_speedup,
    )
    return (f"{each.clock_speed:g}x", *(f"{number:.3g}" for number in numbers))
