"""`uavaccel bench`: measure this machine; print the figures and, with --out, keep them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console
from rich.table import Table

from uavaccel.bench import images as bench_images
from uavaccel.bench import speed as bench
from uavaccel.bench.machine import check_host
from uavaccel.clock import calendar_time
from uavaccel.errors import UsageError, UserError
from uavaccel.manifest import describe_run

BENCHES: dict[str, Callable[[], Iterator[bench.Figure]]] = {
    "hot-loop": bench.bench_hot_loop,
    "tcsc": bench.bench_tcsc,
    "virtual": bench.bench_virtual,
    "camera": bench_images.bench_camera,
    "image": bench_images.bench_image,
    "dvs": bench_images.bench_dvs,
}

console = Console(highlight=False)


def run_benches(names: list[str], soak_s: float, out: Path | None) -> None:
    """Run the named benches (all if none). Raises UsageError for an unknown name, UserError if `out` exists."""
    unknown = [name for name in names if name not in BENCHES]
    if unknown:
        raise UsageError(f"no bench {unknown[0]!r}; there are {', '.join(BENCHES)}")
    if out is not None and out.exists():
        raise UserError(f"{out}: exists; take another --out")
    verdict = check_host()
    console.print(f"host check: {verdict['verdict']}")
    figures = [figure for name in names or BENCHES for figure in _shown(_possible(BENCHES[name]))]
    if soak_s:
        figures += _shown(bench.bench_soak(soak_s))
    if out is not None:
        manifest = describe_run(["bench", *names], 0, calendar_time()) | {"host_check": verdict}
        out.write_text(
            json.dumps({"figures": [f._asdict() for f in figures], "manifest": manifest}, indent=2) + "\n"
        )


def _possible(work: Callable[[], Iterator[bench.Figure]]) -> Iterator[bench.Figure]:
    """The figures, or one line that says why this machine has none."""
    try:
        yield from work()
    except UserError as error:
        console.print(f"left out: {error}")


def _shown(figures: Iterator[bench.Figure]) -> Iterator[bench.Figure]:
    for figure in figures:
        row = Table.grid(padding=(0, 2))
        for width in (38, 22, 18, 60):
            row.add_column(min_width=width)
        bound = "" if figure.bound is None else f"of {figure.bound:,.2f}"
        row.add_row(figure.name, f"{figure.value:,.2f} {figure.unit}", bound, figure.note)
        console.print(row)
        yield figure
