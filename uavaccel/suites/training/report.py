"""A training's report: summary.json, Figure 9, report.md and report.html; several trainings in one Figure 9."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from uavaccel.config import validate
from uavaccel.draw.document import Block, Paragraph, Picture, Table
from uavaccel.draw.phases import PhaseTimes, draw_phases
from uavaccel.draw.style import clock_label, command_name
from uavaccel.envs.stopwatch import PHASES
from uavaccel.records import RunDirectory
from uavaccel.rl.policy import trained_with
from uavaccel.suites import published
from uavaccel.suites.disturbed import disturbed_words
from uavaccel.suites.host_time import in_words, over_all_starts, pace, wall_s
from uavaccel.suites.report import Report, Summary, listed, summary_table
from uavaccel.suites.training.config import TrainConfig
from uavaccel.suites.training.curve import draw_over_games, draw_runs
from uavaccel.suites.training.evaluations import evaluations
from uavaccel.suites.training.real_time import REAL_TIME, in_real_time
from uavaccel.suites.training.summary import headline, summarise, summarise_evaluations

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
        return headline(self.summary)

    def pace(self) -> str:
        return pace(self.run)

    def figures(self) -> list[Picture]:
        path = draw_trainings([self.run], self.run.file(FIGURE))
        phases = Picture(path, f"Figure 9. Time of the training by phase. Source: {_source([self.run])}.")
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


def _evaluated(lines: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Success of the policy of the moment, where it was evaluated."""
    if not lines:
        return []
    rows = [
        (
            str(line["games"]),
            f"{line['success_ratio']:.1%} [{100 * line['wilson_low']:.0f}, {100 * line['wilson_high']:.0f}]",
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
        ("games", str(summary["games"]), str(published.TRAINING_GAMES), "counted"),
        ("wall clock", in_words(wall_s(run)) if wall_s(run) else "-", "-", "measured, start-up not counted"),
        (
            "in real time",
            "-" if real_time_s is None else in_words(real_time_s),
            in_words(published.REAL_TIME_S),
            "ours modelled, the paper's measured",
        ),
    ]
    return Table(("", "this training", "the paper's", "how"), rows)


def draw_trainings(runs: Sequence[RunDirectory], path: Path) -> Path:
    """Figure 9 with a bar for each training; returns `path`."""
    return draw_phases(_told_apart(runs), path, _source(runs))


def compare_trainings(runs: Sequence[RunDirectory]) -> list[Path]:
    """Figure 9 and the learning curves of several trainings, in the first one's folder."""
    labels = [training.label.replace("\n", ", ") for training in _told_apart(runs)]
    return [
        draw_trainings(runs, runs[0].file(COMPARISON)),
        draw_runs(runs, labels, runs[0].file(CURVES)),
        draw_over_games(runs, runs[0].file(GAMES_COMPARED)),
    ]


def _source(runs: Sequence[RunDirectory]) -> str:
    games = listed(sorted({len(run.rows()) for run in runs}))
    seeds = listed(sorted({run.config()["seed"] for run in runs}))
    clocks = " and ".join(sorted({_clock(run) for run in runs}))
    disturbed = disturbed_words([row for run in runs for row in run.rows()])
    return " · ".join([clocks, f"{games} games", f"seed {seeds}", *disturbed])


def _told_apart(runs: Sequence[RunDirectory]) -> list[PhaseTimes]:
    """Times of the trainings; where labels are alike, each has its folder below."""
    trainings = [phase_times(run) for run in runs]
    named = Counter(training.label for training in trainings)
    return [
        replace(training, label=f"{training.label}\n{run.path}") if named[training.label] > 1 else training
        for training, run in zip(trainings, runs, strict=True)
    ]


def phase_times(run: RunDirectory) -> PhaseTimes:
    """Of a training: by its own clock where that is simulated, else by the machine's."""
    config, rows = run.config(), run.rows()
    task = config["task"]
    flown_by = f"{command_name(task['command'])} {clock_label(task['clock_speed'])}"
    label = f"{flown_by}\n{task['timing']}, seed {config['seed']}"
    sim_time_s = sum(row["sim_time_s"] for row in rows)
    if task["timing"] == "virtual":
        phase_s = {phase: sum(row["phase_s"][phase] for row in rows) for phase in PHASES}
        return PhaseTimes(label, phase_s, sim_time_s / (sum(phase_s.values()) / config["environments"]))
    timings = run.timings()
    flown, learned = Counter[str](), over_all_starts([entry["learner_s"] for entry in timings])
    for entry in timings:
        flown.update(entry["host_phase_s"])
    return PhaseTimes(
        label, {phase: flown[phase] + learned[phase] for phase in PHASES}, sim_time_s / wall_s(run)
    )


def _clock(run: RunDirectory) -> str:
    if run.config()["task"]["timing"] == "virtual":
        return "modelled"
    return "measured, learning beside the flight"
