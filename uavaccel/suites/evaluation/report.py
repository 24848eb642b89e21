"""The report of an evaluation: success with its interval, distances flown (the paper's Figure 8), paired tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uavaccel.config import validate
from uavaccel.draw import style
from uavaccel.draw.document import Block, Heading, Movie, Paragraph, Picture, Table
from uavaccel.draw.style import command_name
from uavaccel.envs.simulators import EXACT, flown_by
from uavaccel.errors import UserError
from uavaccel.metrics.intervals import Proportion, mcnemar_exact
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.sim.lane.layout import LENGTH_M
from uavaccel.suites import paper_results
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import EvaluateRow
from uavaccel.suites.evaluation.lost import MOST_PANELS, ended_by, lost_rows, lost_table, plot_lost
from uavaccel.suites.host_time import pace
from uavaccel.suites.old_report import Report, Summary, Values, listed, summary_table
from uavaccel.suites.provenance import disturbed_words
from uavaccel.suites.rows import Row, disturbed_games


def summarise(config: EvaluateConfig, rows: Sequence[EvaluateRow]) -> Values:
    """Summarise an evaluation: the success ratio with its 95 % Wilson interval, and the distances flown."""
    task = config.task
    sim_time_s, wall_s = (sum(row[name] for row in rows) for name in ("sim_time_s", "wall_s"))
    disturbed = disturbed_games(rows)
    return {
        **({"disturbed_games": disturbed} if disturbed else {}),
        "suite": "evaluate",
        "agent": config.agent,
        "profile": task.profile,
        "command": task.command,
        "clock_speed": task.clock_speed,
        "timing": task.timing,
        "simulator": config.simulator,
        **({} if config.simulator == EXACT else {"device": config.device}),
        "seed": config.seed,
        **Proportion(sum(row["is_success"] for row in rows), len(rows)).as_summary(),
        "sim_time_s": sim_time_s,
        "wall_s": wall_s,
        "simulated_s_per_wall_s": sim_time_s / wall_s,
        "distance_m_median": float(np.median([row["distance_m"] for row in rows])),
    }


def how_flown(keys: Row) -> str:
    """Return "measured" or "modelled", and the simulator, from a summary or a configuration with its timing."""
    by = flown_by(keys.get("simulator", EXACT), keys.get("device", ""))
    return ", ".join([timing_provenance(keys["timing"]), *filter(None, [by])])


def compare(rows: Sequence[EvaluateRow], other: RunDirectory) -> str:
    """Return McNemar's test on the lanes that both evaluations flew, in words. Raises UserError without such lanes."""
    theirs = {row["lane"]: row["is_success"] for row in other.rows() if row.get("suite") == "evaluate"}
    paired = [(row["is_success"], theirs[row["lane"]]) for row in rows if row["lane"] in theirs]
    if not paired:
        raise UserError(f"{other.path}: is no evaluation of the same lanes")
    first, second = np.array(paired).T
    test = mcnemar_exact(first, second)
    return (
        f"against {other.path} on the same {len(paired)} lanes: {int(first.sum())} v {int(second.sum())} successes, "
        f"exact McNemar p = {test.p_value:.3g}"
    )


COMPARISON = "figures/figure8_survival_compared.png"


def plot_evaluations(runs: Sequence[RunDirectory], path: Path) -> Picture:
    """Plot Figure 8 with a line for each evaluation."""
    distances = {_run_label(run, runs): [row["distance_m"] for row in run.rows()] for run in runs}
    source = _source(runs)
    caption = "Figure 8. Share of the games that got at least so far north, with its 95 % Wilson interval."
    return style.picture(plot_survival(distances, source), path, caption, source)


def _source(runs: Sequence[RunDirectory]) -> str:
    timings = {how_flown(run.config() | {"timing": run.config()["task"]["timing"]}) for run in runs}
    games = sorted({len(run.rows()) for run in runs})
    seeds = sorted({run.config()["seed"] for run in runs})
    parts = [
        f"{' and '.join(sorted(timings))} · {listed(games)} games each · seed {listed(seeds)}",
        *disturbed_words([row for run in runs for row in run.rows()]),
    ]
    return " · ".join(parts)


def _run_label(run: RunDirectory, runs: Sequence[RunDirectory]) -> str:
    name = _agent_and_simulator(run)
    alike = [other for other in runs if _agent_and_simulator(other) == name]
    return name if len(alike) == 1 else f"{name} ({run.path})"  # folders may share their last name


def _agent_and_simulator(run: RunDirectory) -> str:
    config = run.config()
    by = flown_by(config.get("simulator", EXACT), config.get("device", ""))
    return ", ".join([str(config["agent"]), *filter(None, [by])])


def plot_survival(distances_m: Mapping[str, Sequence[float]], source: str) -> Figure:
    """Plot the share of games that reached each distance, a line per evaluation in its 95 % Wilson interval.

    `distances_m` has the distances in metres by the name of the evaluation.
    """
    with style.project_style():
        figure = style.new_figure(8.0, 4.6, "Distance travelled", source)
        axes = figure.subplots()
        for name, values in distances_m.items():
            places, share = style.survival(values, LENGTH_M)
            games = len(values)
            (line,) = axes.step(places, share, where="post", label=name)
            low, high = zip(*(Proportion(left, games).interval for left in range(games, -1, -1)), strict=True)
            axes.fill_between(places, low, high, step="post", color=line.get_color(), alpha=0.15, linewidth=0)
        axes.axvline(LENGTH_M, color=style.BLACK, linewidth=1.2, linestyle="--", label="end of the lane")
        axes.set_xlabel("distance north, m")
        axes.set_ylabel("share of games that got there")
        axes.set_ylim(0.0, 1.05)
        axes.legend(loc="lower left")
        return figure


class EvaluationReport(Report):
    """The report of `uavaccel evaluate`."""

    def summarise(self) -> Summary:
        config = validate(EvaluateConfig, self.config, str(self.run.path / "config.yaml"))
        return summarise(config, self.rows)

    def title(self) -> str:
        return f"Evaluation of {self.summary['agent']}"

    def headline(self) -> str:
        """Return the success with its interval, clock and seed in a sentence."""
        summary = self.summary
        return (
            f"{summary['successes']} of {summary['games']} lanes ({summary['success_ratio']:.1%}, 95 % Wilson interval "
            f"{summary['wilson_low']:.1%} to {summary['wilson_high']:.1%}), {how_flown(summary)}, "
            f"{summary['command']} at {summary['clock_speed']:g}x, {summary['simulated_s_per_wall_s']:.4g} simulated "
            f"seconds per wall second, seed {summary['seed']}"
        )

    def pace(self) -> str:
        return pace(self.run)

    def figures(self) -> list[Picture]:
        config = validate(EvaluateConfig, self.config, str(self.run.path / "config.yaml"))
        survival = plot_evaluations([self.run], self.run.file("figures/figure8_survival.png"))
        paths = plot_lost(config, self.rows, self.run.file("figures/lost_lanes.png"), _source([self.run]))
        return [survival, *([paths] if paths else [])]

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        beside = _beside_the_papers(self.summary)
        survival, *paths = figures
        lost = _lost_lanes(self.rows, paths)
        return [beside, survival, *lost, *_films(self.run), summary_table(self.summary)]


def _lost_lanes(rows: Sequence[EvaluateRow], paths: Sequence[Picture]) -> list[Block]:
    """Return the lanes that were not won with what ended them, the shortest flight first."""
    lost = lost_rows(rows)
    if not lost:
        return []
    named = [f"{row['lane']} ({row['distance_m']:.1f} m, {ended_by(row)})" for row in lost[:MOST_PANELS]]
    more = [f"and {len(lost) - len(named)} more"] if len(lost) > len(named) else []
    said = (
        f"Lost, the shortest flight first: lanes {', '.join([*named, *more])}. Each is flown again and filmed by "
        "`uavaccel view RUN` with the option in its line of the table."
    )
    return [Heading("Lost lanes"), Paragraph(said), *paths, lost_table(lost)]


def _films(run: RunDirectory) -> list[Block]:
    """Return the films of the best and the worst game that `uavaccel evaluate` has made."""
    named = {"best": "The best game", "worst": "The worst game"}
    found = {run.path / "films" / f"{name}.mp4": caption for name, caption in named.items()}
    films: list[Block] = [
        Movie(path, path.with_suffix(".png"), f"{caption}. On paper: moments of it, camera above events.")
        for path, caption in found.items()
        if path.is_file() and path.with_suffix(".png").is_file()
    ]
    return [Heading("Films"), *films] if films else []


def _beside_the_papers(summary: Summary) -> Table:
    """Return a table of the success beside that of the paper's best training with each command (Table I)."""
    own = Proportion.of(summary).text()
    rows: list[tuple[str, ...]] = [(str(summary["agent"]), own, str(summary["games"]), how_flown(summary))]
    for command, by_clock in paper_results.SUCCESSES.items():
        theirs = Proportion(max(by_clock.values()), paper_results.GAMES).text()
        name = f"the paper's best, trained with {command_name(command)}"
        rows.append((name, theirs, str(paper_results.GAMES), "measured, in AirSim and another lane"))
    return Table(("", "success [95 %]", "lanes", "how"), rows)
