"""A training with several seeds: `uavaccel train ANY.yaml --seeds N`, a run directory for each below parts/.

Each of them is that of `uavaccel train --seed K` alone, byte for byte but for its manifest and what tells of wall time;
the report has all as a mean in a band.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired

from pydantic import Field, model_validator
from typing_extensions import TypedDict

from uavaccel.config import MOST_SEEDS, Games, Seed
from uavaccel.draw.page import Block, Column, Table, counted, fill, listed, unknown
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.task import Task
from uavaccel.forms import Count, Number
from uavaccel.metrics.estimates import Success, mean_estimate
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory, timing_provenance
from uavaccel.suites import train
from uavaccel.suites.experiment import Experiment, GameRow, subset
from uavaccel.suites.parts import SuiteOfRuns, fly_part, part_run
from uavaccel.suites.report import Report, Summary, method_note, summary_table
from uavaccel.suites.suite import GameResult, SimpleCase
from uavaccel.suites.train import RECENT, TrainConfig, Training, recent_mean


class SeedsConfig(Experiment):
    """`suite: seeds`."""

    suite: Literal["seeds"] = "seeds"
    seeds: Annotated[int, Field(ge=1, le=1000)]
    """Trainings, with the seeds `seed`, `seed` + 1 and so on."""
    training: TrainConfig
    """What all have in common: the keys of `suite: train`, whose own `seed` does not count."""

    @model_validator(mode="after")
    def _seeds_fit(self) -> SeedsConfig:
        if self.seed + self.seeds > MOST_SEEDS:
            raise ValueError(f"seed + seeds must be at most {MOST_SEEDS}")
        return self

    @property
    def task(self) -> Task:
        return self.training.task

    @property
    def environment_class(self) -> type[FlightEnv[Any]]:
        return self.training.environment_class


class Evaluated(TypedDict):
    """The evaluation of a policy after its last game."""

    lanes: Games
    successes: Count


class SeedRow(GameRow):
    """The row of the training with one seed; means are of its last 100 games."""

    seed: Seed
    games: Games
    successes: Count
    success_recent: Number
    return_recent: Number
    commands_recent: Number
    sim_time_s: Number
    weights_sha256: str
    evaluation: NotRequired[Evaluated]
    won: NotRequired[list[bool]]
    """Whether each lane of the evaluation was won, in their order, which is that of every seed."""


@dataclass(frozen=True)
class SeedCase(SimpleCase):
    """The training with one seed."""

    seed: int


RECENTLY = {"success_recent": "is_success", "return_recent": "return", "commands_recent": "commands"}


class Seeds(SuiteOfRuns[SeedsConfig, SeedCase]):
    """`uavaccel train --seeds`."""

    name = "seeds"
    config = SeedsConfig
    row = SeedRow
    unit = "training"
    training = Training()

    def check(self, config: SeedsConfig) -> None:
        self.training.check(config.training)

    def case_of(self, row: Mapping[str, Any]) -> str:
        return f"seed{row['seed']}"

    def cases(self, config: SeedsConfig) -> Iterator[SeedCase]:
        typical_s = config.training.games * config.task.typical_s
        for seed in range(config.seed, config.seed + config.seeds):
            yield SeedCase(f"seed{seed}", config.task.timing, typical_s, seed)

    def runs(self, config: SeedsConfig, case: SeedCase) -> list[tuple[Training, TrainConfig]]:
        return [(self.training, config.training.model_copy(update={"seed": case.seed}))]

    def may_grow(self, folder: Path) -> Mapping[str, str]:
        begun = sorted(folder.glob("parts/seed*"))
        lacking = (why for part in begun if (why := self.training.may_grow(part)["games"]))
        return {"seeds": "", "training.games": next(lacking, "")}

    def prepare(self, config: SeedsConfig, run: RunDirectory) -> None:
        """Let all trainings go on where they are to have more games."""
        if any(row["games"] < config.training.games for row in run.rows()):
            run.truncate_to(0)

    def provenance(self, config: SeedsConfig) -> Mapping[str, object]:
        return self.training.provenance(config.training)

    def fly(self, config: SeedsConfig, case: SeedCase, opened: RunDirectory) -> GameResult:
        report = fly_part(opened, case.id, self.runs(config, case)[0])
        row = subset(report.summary, "seed", "games", "successes", "sim_time_s", "weights_sha256")
        row |= {name: float(recent_mean(report.games[column]).iloc[-1]) for name, column in RECENTLY.items()}
        if evaluated := report.summary.get("evaluations"):
            row["evaluation"] = subset(evaluated[-1], *Evaluated.__annotations__)
            row["won"] = train.evaluations(report.run)[-1]["is_success"]
        return GameResult(row)

    def summary(self, report: Report) -> Summary:
        """Return each training, and over the seeds each number's mean with a 95 % interval, and its range.

        The intervals are Student's over seeds, None for a single one; those of success also cover its games, and its
        evaluation's the lanes, which are the same for all (`Success.estimate`).
        """
        kept = [name for name in SeedRow.__annotations__ if name != "won" and name not in GameRow.__annotations__]
        trainings = [{name: row[name] for name in kept if name in row} for row in report.rows]
        success = [evaluated for each in trainings if (evaluated := evaluation_of(each))]
        over = {name: [each[name] for each in trainings] for name in RECENTLY}
        estimates = {name: mean_estimate(values) for name, values in over.items()}
        recent = [min(each["games"], RECENT) for each in trainings]
        won = [Proportion(round(ratio * n), n) for ratio, n in zip(over["success_recent"], recent, strict=True)]
        estimates["success_recent"] = Success(tuple(won)).estimate
        if success:
            over["evaluation_success"] = [each.ratio for each in success]
            by_lane = [row.get("won") for row in report.rows]
            known = len({each and len(each) for each in by_lane}) == 1 and all(by_lane)
            estimates["evaluation_success"] = (Success.on_lanes(by_lane) if known else Success(tuple(success))).estimate
        over_seeds = {
            name: {"mean": mean, "low": low, "high": high, "least": min(over[name]), "most": max(over[name])}
            for name, (mean, low, high) in estimates.items()
        }
        conditions = subset(vars(report.config.task), "profile", "command", "clock_speed", "timing")
        seeds = {"seed": report.config.seed, "seeds": len(trainings), "training_games": report.config.training.games}
        return {"suite": self.name, **conditions, **seeds, "trainings": trainings, "over_seeds": over_seeds}

    def title(self, report: Report) -> str:
        return f"Training, {report.config.training.algorithm}, {counted(len(report.games), 'seed')}"

    def headline(self, report: Report) -> str:
        over, count = report.summary["over_seeds"], len(report.games)
        name = "evaluation_success" if "evaluation_success" in over else "success_recent"
        seeds = f"mean of {count} seeds, with its 95 % interval" if count > 1 else "one seed"
        return f"{QUANTITIES[name]}: {fill(MEAN[name], over[name])}, {seeds}"

    def source(self, report: Report) -> str:
        seeds = listed(training["seed"] for training in report.summary["trainings"])
        games = f"{counted(report.config.training.games, 'game')} each"
        return f"{timing_provenance(report.config.task.timing)} · {games} · seeds {seeds}"

    def overview(self, report: Report) -> Table:
        over = report.summary["over_seeds"]
        header = f"of {counted(len(report.games), 'seed')}", "mean [95 % over seeds]", "least to most"
        spans = {name: fill(SPAN[name], found) for name, found in over.items()}
        forms = {name: ALONE if unknown(found["low"]) else MEAN for name, found in over.items()}
        means = {name: fill(forms[name][name], found) for name, found in over.items()}
        return Table(header, [(QUANTITIES[name], means[name], span) for name, span in spans.items()])

    def page(self, report: Report) -> Iterator[Block | str]:
        yield self.overview(report)
        reports = [self.training.report(part_run(report.run, row["case"])) for row in report.rows]
        of = f"Success, return and length of {len(reports)} trainings" if len(reports) > 1 else "Success of 1 training"
        seen = f"{of}: {self.headline(report)}"
        caption = f"{train.OVER_GAMES} {WHAT_BANDS_ARE}"
        figure = train.curves_figure("games", reports)
        yield report.figure("learning_games", figure, caption, f"{seen}, over the games.")
        if all(training.timings for training in reports):
            figure = train.curves_figure("wall clock", reports)
            caption = f"{train.OVER_TIME} {WHAT_BANDS_ARE}"
            yield report.figure("learning_curve", figure, caption, f"{seen}, over the wall clock.")
        yield Table.of(report.summary["trainings"], TRAININGS)
        yield method_note(WHAT_INTERVALS_ARE)
        yield summary_table(report.summary)


def evaluation_of(training: Mapping[str, Any]) -> Proportion | None:
    """Return the success of a training's last evaluation; None where it was not evaluated."""
    found = training.get("evaluation")
    return None if found is None else Proportion(found["successes"], found["lanes"])


QUANTITIES = {
    "evaluation_success": "evaluation lanes won after the last game",
    "success_recent": f"games won, of the last {RECENT}",
    "return_recent": f"return, mean of the last {RECENT} games",
    "commands_recent": f"length in commands, mean of the last {RECENT} games",
}
_FORMS = {name: ".1%" if "success" in name else ".4g" for name in QUANTITIES}
MEAN = {name: f"{{mean:{form}}} [{{low:{form}}}, {{high:{form}}}]" for name, form in _FORMS.items()}
ALONE = {name: f"{{mean:{form}}}" for name, form in _FORMS.items()}
SPAN = {name: f"{{least:{form}}} to {{most:{form}}}" for name, form in _FORMS.items()}
TRAININGS: dict[str, Column] = {
    "seed": "{seed}",
    "games won": "{successes} of {games}",
    "of the last 100": "{success_recent:.1%}",
    "return": "{return_recent:.4g}",
    "length": "{commands_recent:.4g}",
    "evaluated": lambda training: (success := evaluation_of(training)) and success.text(),
    "weights": lambda training: training["weights_sha256"][:12],
    "run directory": "parts/seed{seed}",
}
WHAT_INTERVALS_ARE = (
    "A training is one sample: intervals are Student's of the mean over the seeds, and those of success also cover "
    "Wilson's over all games; on evaluation lanes, also that these are hard or easy for all. With two or three seeds "
    "they are wide, as they have to be."
)
WHAT_BANDS_ARE = "Lines are means over the seeds, bands reach from the least seed to the most."
