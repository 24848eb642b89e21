"""An evaluation's report: summary.json, Figure 8, report.md and report.html; several evaluations in one Figure 8."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uavaccel.config import validate
from uavaccel.draw.document import Block, Paragraph, Picture, Table
from uavaccel.draw.style import command_name
from uavaccel.draw.survival import draw_survival
from uavaccel.envs.simulators import EXACT, flown_by
from uavaccel.metrics.intervals import wilson_interval
from uavaccel.records import RunDirectory
from uavaccel.suites import published
from uavaccel.suites.disturbed import disturbed_words
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.summary import headline, how_flown, summarise
from uavaccel.suites.host_time import pace
from uavaccel.suites.report import Report, Summary, listed, summary_table

FIGURE = "figures/figure8_survival.png"
COMPARISON = "figures/figure8_survival_compared.png"


class EvaluationReport(Report):
    """Of `uavaccel evaluate`."""

    def summarise(self) -> Summary:
        config = validate(EvaluateConfig, self.config, str(self.run.path / "config.yaml"))
        return summarise(config, self.rows)

    def title(self) -> str:
        return f"Evaluation of {self.summary['agent']}"

    def headline(self) -> str:
        return headline(self.summary)

    def pace(self) -> str:
        return pace(self.run)

    def figures(self) -> list[Picture]:
        path = draw_evaluations([self.run], self.run.file(FIGURE))
        said = "Share of the games that got at least so far north, with its 95 % Wilson interval"
        return [Picture(path, f"Figure 8. {said}. Source: {_source([self.run])}.")]

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        beside = _beside_the_papers(self.summary)
        return [Paragraph(self.headline() + "."), beside, *figures, summary_table(self.summary)]


def _beside_the_papers(summary: Summary) -> Table:
    """Its success, and the best of the paper's trainings with each command (Table I)."""
    own = f"{summary['success_ratio']:.1%} [{100 * summary['wilson_low']:.0f}, {100 * summary['wilson_high']:.0f}]"
    rows: list[tuple[str, ...]] = [(str(summary["agent"]), own, str(summary["games"]), how_flown(summary))]
    for command, by_clock in published.SUCCESSES.items():
        best = max(by_clock.values())
        low, high = wilson_interval(best, published.GAMES)
        theirs = f"{best / published.GAMES:.1%} [{100 * low:.0f}, {100 * high:.0f}]"
        name = f"the paper's best, trained with {command_name(command)}"
        rows.append((name, theirs, str(published.GAMES), "measured, in AirSim and another lane"))
    return Table(("", "success [95 %]", "lanes", "how"), rows)


def draw_evaluations(runs: Sequence[RunDirectory], path: Path) -> Path:
    """Figure 8 with a line for each evaluation; returns `path`."""
    distances = {_name(run, runs): [row["distance_m"] for row in run.rows()] for run in runs}
    return draw_survival(distances, path, _source(runs))


def _source(runs: Sequence[RunDirectory]) -> str:
    timings = {how_flown(run.config() | {"timing": run.config()["task"]["timing"]}) for run in runs}
    games = sorted({len(run.rows()) for run in runs})
    seeds = sorted({run.config()["seed"] for run in runs})
    told = [
        f"{' and '.join(sorted(timings))} · {listed(games)} games each · seed {listed(seeds)}",
        *disturbed_words([row for run in runs for row in run.rows()]),
    ]
    return " · ".join(told)


def _name(run: RunDirectory, runs: Sequence[RunDirectory]) -> str:
    name = _agent_and_simulator(run)
    alike = [other for other in runs if _agent_and_simulator(other) == name]
    return name if len(alike) == 1 else f"{name} ({run.path})"  # folders may share their last name


def _agent_and_simulator(run: RunDirectory) -> str:
    config = run.config()
    by = flown_by(config.get("simulator", EXACT), config.get("device", ""))
    return ", ".join([str(config["agent"]), *filter(None, [by])])
