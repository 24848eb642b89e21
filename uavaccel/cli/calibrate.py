"""`uavaccel calibrate`: measure this machine's latencies and write the block that `virtual` reads."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from uavaccel.bench.calibration import calibrate
from uavaccel.bench.machine import check_machine
from uavaccel.errors import UserError
from uavaccel.sim.gl import describe_renderer
from uavaccel.yaml_io import dump_yaml

console = Console(highlight=False, markup=False, soft_wrap=True)


def _can_draw() -> bool:
    try:
        describe_renderer()
    except UserError as error:
        console.print(f"without images, whose latencies become those of any call: {error}")
        return False
    return True


def write_calibration(out: Path, commands: int, profile: str) -> None:
    """Measure and write `out`. Raises UserError if it exists."""
    if out.exists():
        raise UserError(f"{out}: exists; take another --out")
    verdict = check_machine()["verdict"]
    console.print(f"machine check: {verdict}")
    block = calibrate(profile, commands, images=_can_draw()).block()
    out.write_text(
        f"# Measured by `uavaccel calibrate`; machine: {verdict}\n" + dump_yaml({"latency": block})
    )
    names, middle = ("request_us", "reply_us"), block["quantiles"].index(0.5)
    for kind in names:
        for channel, table in block[kind].items():
            if "@" in channel:
                continue  # after waits of several lengths: in the file
            console.print(
                f"{kind[:-3]:8} {channel:13} median {table[middle]:7.1f} us, 99 % {table[-3]:7.1f} us"
            )
    console.print(f"{out}: use it with --set latency={out}")
