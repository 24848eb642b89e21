"""An evaluation's report: summary.json, Figure 8, report.md and report.html; several evaluations in one Figure 8."""

from __future__ import annotations

from collections.abc import Sequence

from uavaccel.config import validate
from uavaccel.draw.document import Block, Paragraph, Picture, Table
from uavaccel.draw.style import command_name
from uavaccel.metrics.intervals import Proportion
from uavaccel.suites import paper_results
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.summary import how_flown, summarise
from uavaccel.suites.evaluation.survival import draw_evaluations, evaluations_source
from uavaccel.suites.host_time import pace
from uavaccel.suites.report import Report, Summary, summary_table

FIGURE = "figures/figure8_survival.png"


class EvaluationReport(Report):
    """Of `uavaccel evaluate`."""

    def summarise(self) -> Summary:
        config = validate(EvaluateConfig, self.config, str(self.run.path / "config.yaml"))
        return summarise(config, self.rows)

    def title(self) -> str:
        return f"Evaluation of {self.summary['agent']}"

    def headline(self) -> str:
        """The result in a sentence, with its interval, its clock and its seed."""
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
        path = draw_evaluations([self.run], self.run.file(FIGURE))
        said = "Share of the games that got at least so far north, with its 95 % Wilson interval"
        return [Picture(path, f"Figure 8. {said}. Source: {evaluations_source([self.run])}.")]

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        beside = _beside_the_papers(self.summary)
        return [Paragraph(self.headline() + "."), beside, *figures, summary_table(self.summary)]


def _beside_the_papers(summary: Summary) -> Table:
    """Its success, and the best of the paper's trainings with each command (Table I)."""
    own = Proportion.of(summary).text()
    rows: list[tuple[str, ...]] = [(str(summary["agent"]), own, str(summary["games"]), how_flown(summary))]
    for command, by_clock in paper_results.SUCCESSES.items():
        theirs = Proportion(max(by_clock.values()), paper_results.GAMES).text()
        name = f"the paper's best, trained with {command_name(command)}"
        rows.append((name, theirs, str(paper_results.GAMES), "measured, in AirSim and another lane"))
    return Table(("", "success [95 %]", "lanes", "how"), rows)
