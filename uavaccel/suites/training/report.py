"""The report of a training: its summary, learning curves and Figure 9, and the comparison of several trainings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from uavaccel.config import validate
from uavaccel.draw.document import Block, Picture, Table, or_dash
from uavaccel.envs.stopwatch import PHASES
from uavaccel.metrics.intervals import Proportion
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.rl.policy import trained_with
from uavaccel.suites import paper_results
from uavaccel.suites.host_time import in_words, pace, wall_s
from uavaccel.suites.old_report import Report, Summary, Values, summary_table
from uavaccel.suites.rows import Row, disturbed_games
from uavaccel.suites.training.config import TrainConfig
from uavaccel.suites.training.evaluations import EvaluationLine, evaluations
from uavaccel.suites.training.learning_curves import plot_over_games, plot_over_time, plot_progress
from uavaccel.suites.training.phases import plot_trainings, uniquely_labelled
from uavaccel.suites.training.real_time import REAL_TIME, in_real_time
from uavaccel.suites.training.rows import TrainRow


def summarise(config: TrainConfig, rows: Sequence[TrainRow], weights_sha256: str | None) -> Values:
    """Summarise a training: sums over all games, and the hash of the resulting weights."""
    task = config.task
    disturbed = disturbed_games(rows)
    return {
        **({"disturbed_games": disturbed} if disturbed else {}),
        "suite": "train",
        "profile": task.profile,
        "command": task.command,
        "clock_speed": task.clock_speed,
        "timing": task.timing,
        "seed": config.seed,
        "games": len(rows),
        "successes": sum(row["is_success"] for row in rows),
        "commands": sum(row["commands"] for row in rows),
        "sim_time_s": sum(row["sim_time_s"] for row in rows),
        "phase_s": {phase: sum(row["phase_s"][phase] for row in rows) for phase in PHASES},
        "weights_sha256": weights_sha256,
    }


def summarise_evaluations(lines: Sequence[EvaluationLine]) -> list[Values]:
    """Summarise each line of evaluations.jsonl: success with its 95 % Wilson interval, and the distances flown."""
    return [
        {
            **Proportion(line["successes"], len(line["lanes"])).as_summary(),
            "games": line["games"],
            "lanes": len(line["lanes"]),
            "distance_m_median": float(np.median(line["distance_m"])),
        }
        for line in lines
    ]


COMPARISON = "figures/figure9_phases_compared.png"
CURVES = "figures/learning_curves_compared.png"
GAMES_COMPARED = "figures/learning_games_compared.png"


class TrainingReport(Report):
    """The report of `uavaccel train`."""

    def summarise(self) -> Summary:
        config = validate(TrainConfig, self.config, str(self.run.path / "config.yaml"))
        trained = trained_with(self.run.path)
        over = trained.get("games") == len(self.rows)
        summary = summarise(config, self.rows, trained["weights_sha256"] if over else None)
        if over and (self.run.path / REAL_TIME).is_file():
            summary |= in_real_time(summary["commands"], self.run)
        if evaluated := summarise_evaluations(evaluations(self.run)):
            summary["evaluations"] = evaluated
        return summary

    def title(self) -> str:
        return f"Training, {self.config['algorithm']}, seed {self.config['seed']}"

    def headline(self) -> str:
        """Return the result in a sentence."""
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
        return [*_curves(self.run), plot_trainings([self.run], self.run.file("figures/figure9_phases.png"))]

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        *curves, phases = figures
        return [
            _beside_the_papers(self.run, self.summary),
            *curves,
            *_evaluated(self.summary.get("evaluations", ())),
            phases,
            summary_table(self.summary),
        ]


def _curves(run: RunDirectory) -> list[Picture]:
    """Plot success over the games and, where wall times were recorded, over the wall clock."""
    over_games = plot_over_games([run], run.file("figures/learning_games.png"))
    pictures = [
        Picture(over_games, "Success over the games: the share won of the last 100, or of all so far.")
    ]
    source = f"{timing_provenance(run.config()['task']['timing'])} · seed {run.config()['seed']}"
    progress = plot_progress(run.rows(), run.file("figures/progress.png"), source)
    caption = (
        "Return and length of each game, loss and mean Q of the gradient steps before its end, and the share of "
        "random actions; lines are means of the last 100 games."
    )
    pictures.append(Picture(progress, f"{caption} Source: {source}."))
    if wall_s(run):
        over_time = plot_over_time([run], [run.path.name], run.file("figures/learning_curve.png"))
        caption = (
            "The same over the wall clock, measured; a dashed line, unless it is far beyond, is the paper's training "
            "in real time."
        )
        pictures.append(Picture(over_time, caption))
    return pictures


def _evaluated(lines: Sequence[Row]) -> list[Table]:
    """Return a table of the evaluations during the training, if there were any."""
    if not lines:
        return []
    return [
        Table.of(
            lines,
            ("games learned from", lambda line: str(line["games"])),
            (
                "success on evaluation lanes [95 %]",
                lambda line: Proportion(line["successes"], line["lanes"]).text(),
            ),
            ("lanes", lambda line: str(line["lanes"])),
            ("median distance, m", lambda line: f"{line['distance_m_median']:.1f}"),
        )
    ]


def _beside_the_papers(run: RunDirectory, summary: Summary) -> Table:
    """Return a table of games and time of this training and of the paper's (sections III-C3, IV-D)."""
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
    """Plot Figure 9 and the learning curves of several trainings into the first one's folder."""
    labels = [training.label.replace("\n", ", ") for training in uniquely_labelled(runs)]
    return [
        plot_trainings(runs, runs[0].file(COMPARISON)).path,
        plot_over_time(runs, labels, runs[0].file(CURVES)),
        plot_over_games(runs, runs[0].file(GAMES_COMPARED)),
    ]
