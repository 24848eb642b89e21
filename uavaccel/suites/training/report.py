"""A training's report: summary.json, Figure 9, report.md and report.html; several trainings in one Figure 9."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from uavaccel.config import validate
from uavaccel.draw.document import Block, Paragraph, Picture, Table, or_dash
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory
from uavaccel.rl.policy import trained_with
from uavaccel.suites import paper_results
from uavaccel.suites.host_time import in_words, pace, wall_s
from uavaccel.suites.report import Report, Row, Summary, summary_table
from uavaccel.suites.training.config import TrainConfig
from uavaccel.suites.training.evaluations import evaluations
from uavaccel.suites.training.learning_curves import draw_over_games, draw_runs
from uavaccel.suites.training.phases import draw_trainings, told_apart, trainings_source
from uavaccel.suites.training.real_time import REAL_TIME, in_real_time
from uavaccel.suites.training.summary import summarise, summarise_evaluations

FIGURE = "figures/figure9_phases.png"
COMPARISON = "figures/figure9_phases_compared.png"
CURVES = "figures/learning_curves_compared.png"
GAMES_COMPARED = "figures/learning_games_compared.png"
OVER_GAMES, OVER_TIME = "figures/learning_games.png", "figures/learning_curve.png"


class TrainingReport(Report):
    """Of `uavaccel train`."""

    def summarise(self) -> Summary:
        config = validate(TrainConfig, self.config, str(self.run.path / "config.yaml"))
        trained = trained_with(self.run.path)
        over = trained.get("games") == len(self.rows)
        summary = summarise(config, self.rows, trained["weights_sha256"] if over else None)
        if over and (self.run.path / REAL_TIME).is_file():
            summary |= in_real_time(summary["commands"], self.run.read_json(REAL_TIME))
        if evaluated := summarise_evaluations(evaluations(self.run)):
            summary["evaluations"] = evaluated
        return summary

    def title(self) -> str:
        return f"Training, {self.config['algorithm']}, seed {self.config['seed']}"

    def headline(self) -> str:
        """The result in a sentence."""
        summary = self.summary
        weights, real_time_s = summary["weights_sha256"], summary.get("modelled_real_time_s")
        return (
            f"{summary['successes']} of {summary['games']} training games succeeded, "
            f"{'weights ' + weights[:12] if weights else 'the training is not over'}"
            f"{'' if real_time_s is None else f'; in real time {in_words(real_time_s)} (modelled)'}"
        )

    def pace(self) -> str:
        return pace(self.run)

    def figures(self) -> list[Picture]:
        path = draw_trainings([self.run], self.run.file(FIGURE))
        phases = Picture(
            path, f"Figure 9. Time of the training by phase. Source: {trainings_source([self.run])}."
        )
        return [*_curves(self.run), phases]

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        *curves, phases = figures
        return [
            Paragraph(self.headline() + "."),
            _beside_the_papers(self.run, self.summary),
            *curves,
            *_evaluated(self.summary.get("evaluations", ())),
            phases,
            summary_table(self.summary),
        ]


def _curves(run: RunDirectory) -> list[Picture]:
    """Success over the games and, where wall times were kept, over the wall clock."""
    over_games = draw_over_games([run], run.file(OVER_GAMES))
    pictures = [
        Picture(over_games, "Success over the games: the share won of the last 100, or of all so far.")
    ]
    if wall_s(run):
        over_time = draw_runs([run], [run.path.name], run.file(OVER_TIME))
        caption = (
            "The same over the wall clock, measured; the dashed line is the paper's training in real time."
        )
        pictures.append(Picture(over_time, caption))
    return pictures


def _evaluated(lines: Sequence[Row]) -> list[Table]:
    """Success of the policy of the moment, where it was evaluated."""
    if not lines:
        return []
    rows = [
        (
            str(line["games"]),
            Proportion(line["successes"], line["lanes"]).text(),
            str(line["lanes"]),
            f"{line['distance_m_median']:.1f}",
        )
        for line in lines
    ]
    return [
        Table(
            ("games learned from", "success on evaluation lanes [95 %]", "lanes", "median distance, m"), rows
        )
    ]


def _beside_the_papers(run: RunDirectory, summary: Summary) -> Table:
    """Games and time of the training, and of the paper's (III-C3, IV-D)."""
    real_time_s = summary.get("modelled_real_time_s")
    rows = [
        ("games", str(summary["games"]), str(paper_results.TRAINING_GAMES), "counted"),
        ("wall clock", or_dash(wall_s(run) or None, in_words), "-", "measured, start-up not counted"),
        (
            "in real time",
            or_dash(real_time_s, in_words),
            in_words(paper_results.REAL_TIME_S),
            "ours modelled, the paper's measured",
        ),
    ]
    return Table(("", "this training", "the paper's", "how"), rows)


def compare_trainings(runs: Sequence[RunDirectory]) -> list[Path]:
    """Figure 9 and the learning curves of several trainings, in the first one's folder."""
    labels = [training.label.replace("\n", ", ") for training in told_apart(runs)]
    return [
        draw_trainings(runs, runs[0].file(COMPARISON)),
        draw_runs(runs, labels, runs[0].file(CURVES)),
        draw_over_games(runs, runs[0].file(GAMES_COMPARED)),
    ]
