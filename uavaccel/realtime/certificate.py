"""The result of an evaluation against latency: a score for each latency, and up to which of them it holds."""

from __future__ import annotations

import hashlib
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from uavaccel.files import Plain, replacing, to_json
from uavaccel.metrics.intervals import Proportion, bootstrap_interval
from uavaccel.resources import require

Row = dict[str, Plain]
SHARE = 0.9  # of the score without latency that has to be left
UNITS = SECONDS, FACTORS, STEPS = "seconds", "factors", "steps"
"""What latencies are counted in; factors are those on the times of a calibration file."""


@dataclass(frozen=True)
class Certificate:
    """The result of an evaluation: what was evaluated, and by latency the score with its 95 % interval.

    The score is the share of successes, in Wilson's interval, where the environment's infos tell them, else the mean
    return, in a bootstrap's.
    """

    setup: Mapping[str, Plain]
    rows: Sequence[Row]
    document: dict[str, Plain] = field(init=False)
    """What certificate.json holds."""

    def __post_init__(self) -> None:
        told = all("error" in row or row["success"] is not None for row in self.rows)
        score, count = "success" if told else "return", self.setup["episodes"]
        groups = (self.rows[at : at + count] for at in range(0, len(self.rows), count))
        cells = [_cell(list(rows), score) for rows in groups]
        lines = "".join(f"{to_json(row)}\n" for row in self.rows).encode()
        found = {"score": score, "cells": cells, "holds": _holds(cells)}
        object.__setattr__(self, "document", {**self.setup, **found, "rows_sha256": hashlib.sha256(lines).hexdigest()})

    @property
    def failed(self) -> int:
        """How many episodes failed."""
        return sum("error" in row for row in self.rows)

    @property
    def line(self) -> str:
        """The certificate in one line."""
        said, cells, holds = self.document, self.document["cells"], self.document["holds"]
        policy, by = said["policy"], said["calibration"]
        head = f"{policy['name']} in {said['environment']['id']}"
        hashes = {"policy": policy["sha256"], **({"times": by["sha256"]} if by else {}), "rows": said["rows_sha256"]}
        short = ", ".join(f"{name} {'of unknown hash' if of is None else of[:12]}" for name, of in hashes.items())
        tail = f"{said['episodes']} episodes a latency from seed {said['seed']}; {short}"
        if self.failed:
            return f"{head}: no certificate: {self.failed} of {len(self.rows)} episodes failed; {tail}"
        best, until = _scored(cells[0]["mean"], said["score"]), f"{1e3 * holds['latency_s']:.4g} ms"
        until += f", {holds['latency']:g} times {by['file']}" if by else ""
        if said["unit"] == STEPS:
            until += f", {holds['latency']} step{'s' * (holds['latency'] != 1)}"
        until += ", the longest tried" if holds["latency"] == cells[-1]["latency"] else ""
        more = f"holds {SHARE:.0%} of its {said['score']} without latency, {best}, up to {until}"
        return f"{head}: {more} ({tail})"

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Return a header and a line for each latency."""
        score = self.document["score"]
        header = [self.setup["unit"], "median ms", score, "95 %", "failed"]
        lines = []
        for cell in self.document["cells"]:
            known = ["-"] * 3
            if cell["mean"] is not None:
                ends = (_scored(cell[end], score) for end in ("low", "high"))
                known = [f"{1e3 * cell['latency_s']:.4g}", _scored(cell["mean"], score), " to ".join(ends)]
            lines.append([f"{cell['latency']:g}", *known, str(cell["errors"])])
        return header, lines

    def save(self, path: str | Path) -> Path:
        """Write certificate.json."""
        with replacing(written := Path(path)) as file:
            file.write(f"{to_json(self.document, indent=1)}\n".encode())
        return written

    def figure(self, path: str | Path) -> Path:
        """Draw the score against latency, in its intervals. Raises UserError without Matplotlib."""
        require("matplotlib", "the figure", "realtime")
        from matplotlib.figure import Figure

        figure = Figure((6.4, 4.0), dpi=150, layout="constrained")
        axes = figure.add_subplot()
        cells = [cell for cell in self.document["cells"] if cell["mean"] is not None]
        at = [1e3 * cell["latency_s"] for cell in cells]
        mean, low, high = ([cell[name] for cell in cells] for name in ("mean", "low", "high"))
        off = [np.subtract(mean, low), np.subtract(high, mean)]
        axes.errorbar(at, mean, off, fmt="o-", capsize=3)
        if (least := self.document["holds"]["least"]) is not None:
            axes.axhline(least, color="0.5", linestyle="--", label=f"{SHARE:.0%} of that without latency")
            axes.legend(frameon=False)
        score = self.document["score"]
        axes.set(xlabel="latency, ms", ylabel="share of successes" if score == "success" else "return")
        axes.set(**{"ylim": (-0.02, 1.02)} if score == "success" else {})
        axes.set_title(f"{self.setup['policy']['name']} in {self.setup['environment']['id']}", fontsize=10)
        with replacing(written := Path(path)) as file:
            figure.savefig(file, format=written.suffix[1:] or "png", metadata={"Software": None})
        return written


def _cell(rows: Sequence[Row], score: str) -> Row:
    """Return what is known of a latency's episodes."""
    whole_rows = [row for row in rows if "error" not in row]
    cell: Row = {"latency": rows[0]["latency"], "episodes": len(rows), "errors": len(rows) - len(whole_rows)}
    if not whole_rows:
        return {**cell, "latency_s": None, "mean": None, "low": None, "high": None}
    values = [float(row[score]) for row in whole_rows]
    if score == "success":
        low, high = Proportion(round(sum(values)), len(values)).interval
    else:
        low, high = bootstrap_interval((values,), lambda each: np.asarray(each.mean(axis=-1)), seed=0)
    latency_s = statistics.median(row["thinking_s"] for row in whole_rows)
    return {**cell, "latency_s": latency_s, "mean": statistics.fmean(values), "low": low, "high": high}


def _holds(cells: Sequence[Row]) -> Row:
    """Return up to which latency, of those that were flown, the score stays near that of the first one.

    `latency_s` is by the mean, `surely_s` by the low end of the interval; None where an episode failed.
    """
    if any(cell["errors"] for cell in cells):
        return {"share": SHARE, "least": None, "latency": None, "latency_s": None, "surely_s": None}
    best = cells[0]["mean"]
    least = best - (1 - SHARE) * abs(best)
    far = dict.fromkeys(("mean", "low"), cells[0])
    for name in far:
        for cell in cells[1:]:
            if cell[name] < least:
                break
            far[name] = cell
    held, surely = far["mean"], far["low"]
    return {
        "share": SHARE,
        "least": least,
        "latency": held["latency"],
        "latency_s": held["latency_s"],
        "surely_s": surely["latency_s"] if surely["low"] >= least else None,
    }


def _scored(value: float, score: str) -> str:
    return f"{value:.1%}" if score == "success" else f"{value:.4g}"
