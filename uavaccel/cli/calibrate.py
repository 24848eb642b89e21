"""`uavaccel calibrate`: measures this machine's latencies, and writes the model from which `virtual` draws."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from uavaccel.bench.agreement import Agreement, check_agreement
from uavaccel.bench.calibration import calibrate
from uavaccel.bench.machine import check_machine
from uavaccel.cli.checks import check_file, check_number, check_profile
from uavaccel.cli.terminal import console
from uavaccel.clock import calendar_time
from uavaccel.errors import UserError
from uavaccel.manifest import describe_run
from uavaccel.sim.camera.gl import describe_renderer
from uavaccel.wire.latency import read_latency, shipped_latency
from uavaccel.yaml_io import dump_yaml

MOST_COMMANDS = 1_000_000


def _can_draw() -> bool:
    try:
        describe_renderer()
    except UserError as error:
        console.print(f"without images, whose latencies become those of any call: {error}")
        return False
    return True


def write_calibration(out: Path, commands: int, profile: str) -> None:
    """Measure and write `out`. Raises UserError if it exists."""
    check_file(out)
    check_profile(profile)
    check_number("--commands", commands, 1, MOST_COMMANDS)
    verdict = check_machine()["verdict"]
    console.print(f"machine check: {verdict}")
    latencies = calibrate(profile, commands, images=_can_draw())
    block, host = latencies.block(), describe_run([], 0, "")["host"]
    head = (
        f"# Measured by `uavaccel calibrate`, profile {profile}, on {calendar_time()}; machine: {verdict}\n"
        f"# {host['cpu_model']}, {host['cores']} cores, {host['platform']}\n# {latencies.counts()}\n"
    )
    out.write_text(head + dump_yaml({"latency": block}))
    middle = block["quantiles"].index(0.5)
    for kind in ("request", "reply"):
        for channel, table in block[f"{kind}_us"].items():
            if "@" not in channel:  # the quantiles after a wait are in the file alone
                console.print(
                    f"{kind:8} {channel:13} median {table[middle]:7.1f} us, 99 % {table[-3]:7.1f} us"
                )
    console.print(f"{out}: use it with --set latency={out}")


def show_agreement(latency: Path | None, profile: str, games: int) -> None:
    """Fly the same games on the machine's clock and on the simulated one, and print their quantiles side by side."""
    check_profile(profile)
    check_number("--games", games, 1, MOST_COMMANDS)
    model = shipped_latency() if latency is None else read_latency(latency)
    verdict = check_machine()["verdict"]
    console.print(f"machine check: {verdict}; latency model: {latency or 'the shipped one'}")
    header = ("command", "clock", "T_move s", "", "wall", "wall again", "virtual", "")
    table = Table(*header, box=None, pad_edge=False)
    found = list(check_agreement(model, profile, games))
    for each in found:
        table.add_row(*_row(each))
    console.print(
        "10, 50 and 90 % quantiles; agreement: median within 20 %, the others within 1.5 times wall v wall"
    )
    console.print(table)
    console.print(f"{sum(each.agrees for each in found)} of {len(found)} agree")


def _row(each: Agreement) -> tuple[str, ...]:
    quantiles = (
        " ".join(f"{value:.3g}" for value in run) for run in (each.wall, each.wall_again, each.virtual)
    )
    verdict = "agrees" if each.agrees else f"differs, median by {each.median_off:.0%}"
    cell = each.command.upper(), f"{each.clock_speed:g}x", f"{each.t_move_s:g}", each.quantity
    return *cell, *quantiles, verdict
