"""The comparison of one agent's evaluations in both simulators on the same lanes: simulators.md, simulators.html."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from uavaccel.draw.document import Block, Paragraph, Table, to_html, to_markdown
from uavaccel.envs.simulators import EXACT
from uavaccel.files import Plain
from uavaccel.metrics.intervals import mcnemar_exact
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.flights import EvaluateRow
from uavaccel.suites.evaluation.report import how_flown

PAGE = "simulators"
TITLE = "One agent in two simulators"


def write_simulators(runs: Sequence[RunDirectory]) -> list[Path]:
    """Write the pages into the first run's folder, if an agent flew the same lanes in both simulators."""
    pairs = list(_pairs(runs))
    if not pairs:
        return []
    blocks = [block for pair in pairs for block in _blocks(*pair)]
    into = runs[0]
    into.write_text(f"{PAGE}.md", to_markdown(TITLE, blocks, into.path))
    into.write_text(f"{PAGE}.html", to_html(TITLE, blocks))
    return [into.path / f"{PAGE}.md"]


def _pairs(runs: Sequence[RunDirectory]) -> Iterator[tuple[RunDirectory, RunDirectory]]:
    """Yield pairs of runs that can be compared, the exact simulator's first."""
    for pair in combinations(runs, 2):
        exact, other = sorted(pair, key=lambda run: _simulator(run) != EXACT)
        if (
            _simulator(exact) == EXACT != _simulator(other)
            and _who(exact) == _who(other)
            and _shared(exact, other)
        ):
            yield exact, other


def _simulator(run: RunDirectory) -> str:
    return str(run.config().get("simulator", EXACT))


def _who(run: RunDirectory) -> Plain:
    """Return what identifies the agent: the hash of a policy's weights, or the name of a baseline."""
    return run.manifest().get("policy_sha256") or run.config()["agent"]


def _shared(exact: RunDirectory, other: RunDirectory) -> list[tuple[EvaluateRow, EvaluateRow]]:
    """Return the rows of the lanes that both runs flew."""
    theirs = {row["lane"]: row for row in other.rows()}
    return [(row, theirs[row["lane"]]) for row in exact.rows() if row["lane"] in theirs]


def _blocks(exact: RunDirectory, other: RunDirectory) -> list[Block]:
    shared = _shared(exact, other)
    lines = [_line(run, [pair[side] for pair in shared]) for side, run in enumerate((exact, other))]
    won = np.array([[row["is_success"] for row in pair] for pair in shared], bool)
    same_end = int((won[:, 0] == won[:, 1]).sum())
    same_actions = sum(ours["actions"] == theirs["actions"] for ours, theirs in shared)
    test = mcnemar_exact(won[:, 0], won[:, 1])
    sentence = (
        f"{exact.config()['agent']} on the {len(shared)} lanes that both flew: {same_end} end alike, "
        f"won or lost, {same_actions} with the same actions throughout; exact McNemar p = {test.p_value:.3g}."
    )
    header = ("simulator", "run", "won", "of", "median distance m", "simulated s")
    return [Paragraph(sentence), Table(header, lines)]


def _line(run: RunDirectory, rows: Sequence[EvaluateRow]) -> tuple[str, ...]:
    config = run.config()
    how = config.get("simulator", EXACT), how_flown(config | {"timing": config["task"]["timing"]})
    distance_m = float(np.median([row["distance_m"] for row in rows]))
    won, simulated_s = sum(row["is_success"] for row in rows), sum(row["sim_time_s"] for row in rows)
    named = f"{how[0]} ({how[1]})"
    return named, str(run.path), str(won), str(len(rows)), f"{distance_m:.1f}", f"{simulated_s:,.0f}"
