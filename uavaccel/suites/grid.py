"""Grids: an experiment flown at each point of a grid over its keys. Ablations of DP1; sweeps and maps of a policy.

An ablation flies the games of DP1 under each variant. A sweep and a robustness map evaluate one policy at each point,
on the same lanes, each evaluation in a run directory of its own below the run's.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from copy import copy
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice, product
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NotRequired

import numpy as np
import pandas as pd
from pydantic import AfterValidator, Field, field_validator

from uavaccel.config import MOST_SCALE, CommandName, Config, Games, parse_yaml, suggested_key, validate
from uavaccel.draw import style
from uavaccel.draw.page import (
    Block,
    Column,
    Heading,
    Picture,
    Table,
    clock_label,
    command_at_clock,
    command_name,
    counted,
    unknown,
)
from uavaccel.envs.conditions import SHORT_NAMES, Condition
from uavaccel.errors import UsageError, UserError, suggestion
from uavaccel.files import Plain
from uavaccel.forms import Count, NotNegative, Number, Positive
from uavaccel.metrics.intervals import Proportion, mcnemar_exact
from uavaccel.metrics.trajectory import quartiles
from uavaccel.records import RunDirectory, timing_provenance
from uavaccel.rl.agents import DEFAULT, agent_name, origin_of
from uavaccel.sim.recording import RECORDED
from uavaccel.suites import experiment, plots
from uavaccel.suites.dp1 import SIMILAR_STLC, Dp1, Dp1Config, Dp1Row, Game, summary_cells
from uavaccel.suites.experiment import ClockSpeeds, CommandNames, Experiment, GameRow, ProfileName, Timing, subset
from uavaccel.suites.flight import Flight
from uavaccel.suites.parts import OUTCOMES, Part, Run, SuiteOfRuns, fly_part, outcomes
from uavaccel.suites.registry import merged
from uavaccel.suites.report import Report, Summary, finished, method_note, table_of
from uavaccel.suites.suite import GameResult, SimpleCase, Suite

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from uavaccel.wire.session import Session


# --- ablations ------------------------------------------------------------------------------------------------------


class Variant(Config):
    """A variant of the experiment, by what it changes."""

    name: str
    """The name in the table and on the figure's axis; where all names are numbers, they are values on it."""
    changes: dict[str, Plain] = Field(default_factory=dict)
    """Values by dotted key of the DP1 configuration, as for --set."""


class AblationConfig(Experiment):
    """`suite: ablation`."""

    suite: Literal["ablation"]
    title: str = "Ablation"
    """Title of the report."""
    axis: str = "variant"
    """Label of the figure's axis: the quantity whose values are the variants' names."""
    times_clock_speed: bool = False
    """Whether the figure's axis is the variants' value times ClockSpeed."""
    band: bool = False
    """Whether the figure has ClockSpeed as its axis, and the first variant as a line in the range of all."""
    base: dict[str, Plain]
    """A DP1 configuration; `suite` and `seed` may be left out. Its latency is a block or what ships for the profile."""
    variants: tuple[Variant, ...]
    """The variants of the DP1 configuration, each flown in full."""

    @field_validator("variants")
    @classmethod
    def _distinct(cls, variants: tuple[Variant, ...]) -> tuple[Variant, ...]:
        experiment.distinct(tuple(variant.name for variant in variants))
        return variants

    @property
    def timing(self) -> str:
        return str(self.base.get("timing", "virtual"))


class AblationRow(Dp1Row):
    """The row of a game of DP1 under a variant."""

    variant: str


@dataclass(frozen=True)
class VariantGame(SimpleCase):
    """A game of DP1 under a variant."""

    variant: str
    game: Game


OpenedVariant = Callable[[str], tuple[Dp1Config, "Session"]]
BEYOND_TIMEOUT_S = 0.063 + 1e-9  # AirSim's goal timeout, on its 3 ms grid


class Ablation(Suite[AblationConfig, VariantGame]):
    """`uavaccel run ablation`: the games of DP1 under each variant, with the same seeds."""

    name = "ablation"
    config = AblationConfig
    row = AblationRow
    arrays = RECORDED
    dp1: ClassVar[Dp1] = Dp1()

    def dp1_of(self, config: AblationConfig, variant: str) -> Dp1Config:
        """Return the DP1 configuration of a variant. Raises UserError, which names the variant and the key."""
        base = {**config.base, "suite": "dp1", "seed": config.seed}
        validate(Dp1Config, base, "base")
        changes = next(each.changes for each in config.variants if each.name == variant)
        return validate(Dp1Config, merged(base, changes), f"variant {variant!r}")

    def check(self, config: AblationConfig) -> None:
        for variant in config.variants:
            self.dp1_of(config, variant.name)

    def cases(self, config: AblationConfig) -> Iterator[VariantGame]:
        for number, variant in enumerate(config.variants):
            for game in self.dp1.cases(self.dp1_of(config, variant.name)):
                if game.role != "figure2":
                    name = f"v{number:02d}-{game.id}"
                    yield VariantGame(name, game.timing, game.simulated_s(), variant.name, game)

    @contextmanager
    def open(self, config: AblationConfig, timing: str, run: RunDirectory) -> Iterator[OpenedVariant]:
        """Yield what returns a variant's experiment and its session, opened when its first game is flown."""
        with ExitStack() as stack:

            @cache
            def opened(variant: str) -> tuple[Dp1Config, Session]:
                experiment = self.dp1_of(config, variant)
                return experiment, stack.enter_context(self.dp1.open(experiment, timing, run))

            yield opened

    def fly(self, config: AblationConfig, case: VariantGame, opened: OpenedVariant) -> GameResult:
        experiment, session = opened(case.variant)
        flown = self.dp1.fly(experiment, case.game, session)
        return GameResult({**flown.row, "variant": case.variant}, flown.arrays)

    def flight(
        self, report: Report, game: Mapping[str, Any], pictures: bool = True, event_rate_hz: float | None = None
    ) -> Flight:
        return self.dp1.flight(self._under(report, str(game["variant"])), game, pictures, event_rate_hz)

    def _under(self, report: Report, variant: str) -> Report:
        """Return the report's games under one variant as those of a run of DP1."""
        own = copy(report)
        own.config = self.dp1_of(report.config, variant)
        own.games = report.games[report.games.variant == variant]
        return own

    def score(self, report: Report) -> pd.DataFrame:
        return pd.concat([self.dp1.score(self._under(report, name)) for name in report.games.variant.unique()])

    def summary(self, report: Report) -> Summary:
        """Return an entry for each variant, command and ClockSpeed, of all T_moves and rounds but those in lockstep.

        The speed-up is the mean over the T_moves of the most rounds, as in the paper; what is unknown is None.
        """
        config, entries = report.config, []
        for variant in config.variants:
            scored = report.scores[report.scores.variant == variant.name]
            cells = pd.DataFrame(summary_cells(scored, config.seed))
            for (command, clock_speed), games in scored[scored.timing != "lockstep"].groupby(
                ["command", "clock_speed"]
            ):
                own, most_rounds = finished(games), games["rounds"].max()
                stlc, gap_s = own.stlc.dropna(), np.array([gap for gaps in own.gap_s for gap in gaps])
                same = (cells.command == command) & (cells.clock_speed == clock_speed) & (cells.timing != "lockstep")
                speedups = cells.effective_speedup[same & (cells["rounds"] == most_rounds)].astype(float)
                entries.append(
                    {
                        "command": command,
                        "clock_speed": clock_speed,
                        "variant": variant.name,
                        "games": len(own),
                        "failed_games": len(games) - len(own),
                        "stlc_quartiles": list(quartiles(stlc)) if len(stlc) else None,
                        "position_rmse_m_median": float(own.position_rmse_m.median()) if len(stlc) else None,
                        "effective_speedup": float(speedups.mean(skipna=False)),
                        "share_beyond_goal_timeout": float(np.mean(gap_s > BEYOND_TIMEOUT_S)) if gap_s.size else None,
                    }
                )
        return {"suite": self.name, "title": config.title, "seed": config.seed, "entries": entries}

    def title(self, report: Report) -> str:
        return str(report.config.title)

    def headline(self, report: Report) -> str:
        """Return the least and the most accurate variant of each command at the highest ClockSpeed."""
        known, said = entries_of(report.summary).dropna(subset="stlc"), []
        if known.empty:
            return "no variant has games to compare"
        for _, own in known[known.clock_speed == known.clock_speed.max()].sort_values("stlc").groupby("command"):
            least, *_, most = [f"{entry.stlc:.3f} with {entry.variant}" for entry in own.itertuples()] * 2
            said.append(f"{command_at_clock(own.iloc[0])}: STLC {f'from {least} to {most}' if len(own) > 1 else least}")
        return "; ".join(said)

    def overview(self, report: Report) -> Table:
        return Table.of(entries_of(report.summary), ENTRIES)

    def page(self, report: Report) -> Iterator[Block | str]:
        yield self.overview(report)
        if len(entries := entries_of(report.summary)):
            alt = f"Lines of STLC, position error and speed-up by {report.config.axis}. {self.headline(report)}."
            caption = f"{report.config.title}. {ABOUT_ENTRIES}"
            figure = (band_figure if report.config.band else ablation_figure)(report.config, entries)
            yield report.figure("ablation", figure, caption, alt)


ENTRIES: dict[str, Column] = {
    "variant": "{variant}",
    "command": "{command!u}",
    "ClockSpeed": "{clock_speed:g}x",
    "games": "{games}{failed_games!f}",
    "STLC median [q25, q75]": "{stlc:.3f} [{stlc_quartiles[0]:.3f}, {stlc_quartiles[2]:.3f}]",
    "RMSE median, m": "{position_rmse_m_median:.3f}",
    "effective speed-up": "{effective_speedup:.2f}",
    "gaps beyond the goal timeout": "{share_beyond_goal_timeout:.0%}",
}
ABOUT_ENTRIES = (
    "STLC and position error against ADSC at 1x under the same variant: medians over games, T_moves and rounds "
    "pooled; effective speed-up: its mean over the T_moves of the most rounds."
)
PANELS = {
    "stlc": "STLC, median",
    "position_rmse_m_median": "error, m (RMSE)",
    "effective_speedup": "effective speed-up",
}


def entries_of(summary: Summary) -> pd.DataFrame:
    """Return the entries of an ablation's summary as a table, which has the median `stlc` too."""
    medians = [entry["stlc_quartiles"][1] if entry["stlc_quartiles"] else np.nan for entry in summary["entries"]]
    return table_of(summary["entries"]).assign(stlc=medians)


def band_figure(config: AblationConfig, entries: pd.DataFrame) -> Figure:
    """Draw STLC, error and speed-up over ClockSpeed: the first variant's as lines, all variants' as bands."""
    figure, grid = plots.panels(len(PANELS), config.title, 2.6)
    clocks, first = sorted(entries.clock_speed.unique()), config.variants[0].name
    for axes, (column, label) in zip(grid, PANELS.items(), strict=True):
        for command, own in entries.groupby("command"):
            look: style.LineStyle = {"color": style.COMMAND_COLOUR[str(command)]}
            by_clock, label_of = own.groupby("clock_speed")[column], f"{command_name(str(command))}, {first}"
            low, high = (ends.reindex(clocks) for ends in (by_clock.min(), by_clock.max()))
            axes.fill_between(range(len(clocks)), low, high, alpha=0.3, linewidth=0, **look)
            line = own[own.variant == first].set_index("clock_speed")[column].reindex(clocks)
            axes.plot(range(len(clocks)), line, marker="o", label=label_of, **look)
        plots.clock_axis(axes, clocks)
        axes.set_title(label)
    note_unknown(grid, entries)
    style.legend(figure)
    return figure


def note_unknown(grid: Sequence[Axes], entries: pd.DataFrame) -> None:
    """Say so in the panels of which no entry has a value."""
    for axes, column in zip(grid, PANELS, strict=True):
        if entries[column].isna().all():
            style.note(axes, "no game to compare")


def ablation_figure(config: AblationConfig, entries: pd.DataFrame) -> Figure:
    """Draw STLC, error and speed-up over the variants, on a logarithmic axis if their names are far apart."""
    figure, grid = plots.panels(len(PANELS), config.title, 2.6)
    places, names = pd.factorize(entries.variant)
    values = pd.to_numeric(entries.variant, errors="coerce")
    if are_numbers := bool(values.notna().all()):
        places = (values * (entries.clock_speed if config.times_clock_speed else 1.0)).to_numpy(float)
    clocks, positive = sorted(entries.clock_speed.unique()), places[places > 0]
    for axes, (column, label) in zip(grid, PANELS.items(), strict=True):
        for (command, clock), own in entries.assign(place=places).groupby(["command", "clock_speed"]):
            number = clocks.index(clock)
            look: style.LineStyle = {"color": style.COMMAND_COLOUR[command], "marker": style.marker(number)}
            look |= {"alpha": 1.0 - 0.6 * (len(clocks) - 1 - number) / len(clocks)}  # the slower, the paler
            name = f"{command_name(command)} {clock_label(clock)}"
            plots.line(axes, own.place, own[column], **look, label=name)
        axes.set_title(label)
        if not are_numbers:
            axes.set_xticks(range(len(names)), names, rotation=35, ha="right")
        elif len(positive) and positive.max() / positive.min() > 20:
            axes.set_xscale("symlog", linthresh=positive.min())
            axes.xaxis.set_major_formatter("{x:g}")
    grid[1].set_xlabel(config.axis)
    grid[0].axhline(SIMILAR_STLC, **style.LIMIT)
    if entries.effective_speedup.notna().any():
        plots.log_axis(grid[2], "y", "{:g}x")
    note_unknown(grid, entries)
    style.legend(figure, {f"alike above {SIMILAR_STLC:g}": style.LIMIT})
    return figure


# --- one policy -----------------------------------------------------------------------------------------------------


class PolicyExperiment(Experiment):
    """Keys of suites that evaluate one policy under several conditions."""

    agent: str = DEFAULT
    """The policy, as `uavaccel evaluate` takes it."""
    games: Games = 300
    """Number of evaluation lanes, which are the same under each condition."""
    evaluation: Part = Part(experiment="evaluate")
    """How each policy is evaluated: an experiment, and keys that differ from it."""

    @property
    def who(self) -> str:
        """The agent as it is named in a sentence."""
        return agent_name(self.agent)


class PolicyRow(GameRow):
    """The row of an evaluation; suites add the keys of their conditions."""

    games: Games
    successes: Count
    distance_m_median: NotRequired[Number]
    return_mean: NotRequired[Number]
    """Of environments beside the lane."""
    sim_time_s: NotNegative


MEASURES = ("distance_m_median", "return_mean")
KEPT = ("games", "successes", *MEASURES, "sim_time_s", "timing")


@dataclass(frozen=True)
class Point(SimpleCase):
    """A point of a grid: its name, the dotted keys that set it, and the entries of its row that say which it is."""

    keys: Mapping[str, object]
    labels: Mapping[str, object]


class PolicyGrid(SuiteOfRuns[Any, Point]):
    """One policy, evaluated on the same lanes at each point of a grid over the evaluation's keys."""

    arrays = OUTCOMES

    @abstractmethod
    def points(self, config: Any) -> Iterator[Point]:
        """Yield every point, in canonical order."""

    def check(self, config: Any) -> None:
        for point in self.points(config):
            self.runs(config, point)

    def runs(self, config: Any, case: Point) -> list[Run]:
        keys = {"agent": config.agent, "games": config.games, **config.evaluation.keys, **case.keys}
        part = Part(experiment=config.evaluation.experiment, keys=keys).resolve(config.seed)
        if part[0].name != "evaluate":
            raise UserError(f"evaluation.experiment = {config.evaluation.experiment}: is no evaluation")
        return [part]

    def first(self, config: Any) -> Run:
        """Return suite and configuration of the first evaluation, which represents all where they do not differ."""
        return self.runs(config, next(self.points(config)))[0]

    def cases(self, config: Any) -> Iterator[Point]:
        typical_s = sum(self.size(config, point)[1] for point in islice(self.points(config), 1))
        return (replace(point, typical_s=typical_s) for point in self.points(config))

    def provenance(self, config: Any) -> Mapping[str, object]:
        """Return the policy's hash. Raises UserError for a device that this machine does not have."""
        return {**super().provenance(config), "policy_sha256": origin_of(config.agent).sha256()}

    def fly(self, config: Any, case: Point, opened: RunDirectory) -> GameResult:
        """Evaluate; the row has keys of the evaluation's summary, the arrays the outcome of each lane."""
        report = fly_part(opened, case.id, self.runs(config, case)[0])
        kept = [name for name in KEPT if name in self.row.__annotations__ and name in report.summary]
        return GameResult({**case.labels, **subset(report.summary, *kept)}, outcomes(report.run))


INFERENCE = Condition("inference", "inference_s", "s")
"""The condition that is a key of the evaluation, not of its task: how long a decision takes."""


def key_of(name: str) -> str:
    """Return the dotted key of a condition, by its short name or that key."""
    if name in SHORT_NAMES:
        return f"task.{SHORT_NAMES[name].key}"
    return INFERENCE.key if name == INFERENCE.short else name


def value_text(value: object) -> str:
    """Return a value as names, tables and figures have it: 3, 0.15, noisy."""
    return f"{value + 0.0:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def parse_sweep(text: str) -> tuple[str, list[object]]:
    """Parse NAME=VALUE,VALUE,... into name and values. Raises UsageError."""
    name, _, values = text.partition("=")
    if not name or not values:
        raise UsageError(f"--sweep {text}: must be NAME=VALUE,VALUE,..., as in wind=0,3,6")
    return name, list(parse_yaml(f"[{values}]", source=f"--sweep {text}"))


# --- sweeps ---------------------------------------------------------------------------------------------------------


class SweepConfig(PolicyExperiment):
    """`suite: sweep`."""

    suite: Literal["sweep"]
    sweep: Annotated[dict[str, tuple[object, ...]], Field(min_length=1)]
    """Values by short name (envs/conditions.py) or dotted key; one is changed at a time, all else is as trained."""

    @field_validator("sweep")
    @classmethod
    def _conditions(cls, sweep: dict[str, tuple[object, ...]]) -> dict[str, tuple[object, ...]]:
        for name, values in sweep.items():
            if not values or len(set(map(value_text, values))) < len(values):
                raise ValueError(f"{name} needs values, each once, not {list(values)}")
        return sweep


class SweepRow(PolicyRow):
    """The row of an evaluation under one condition."""

    condition: str
    """Short name or dotted key; empty as trained."""
    value: Plain
    same: list[str]
    """In the row as trained, the cases that change nothing and are not flown again."""
    timing: Timing


AS_TRAINED = "as-trained"


class Sweep(PolicyGrid):
    """`uavaccel evaluate --sweep`, `uavaccel run sweep`: one condition at a time departs from the training's."""

    name = "sweep"
    config = SweepConfig
    row = SweepRow

    def check(self, config: SweepConfig) -> None:
        """Raise UserError for a condition that the environment of the agent does not have, too."""
        evaluation = self.first(config)[1]
        keys = type(evaluation.task).keys_of({})
        known = [*(name for name, each in SHORT_NAMES.items() if each.key.partition(".")[0] in keys), INFERENCE.short]
        for name in config.sweep:
            if name not in (*SHORT_NAMES, INFERENCE.short) and not name.startswith("task."):
                there = suggested_key({**{short: {} for short in known}, "task": keys}, (), name)
                raise UsageError(f"--sweep {name}: is unknown; {there}{'.KEY' * there.endswith(', task')}")
            _, task, key = key_of(name).rpartition("task.")
            if task and key.partition(".")[0] not in keys:
                there = suggestion(name, known)
                raise UserError(f"--sweep {name}: {evaluation.env_id} has no {task}{key}; {there}")
            on_clock = key.partition(".")[0] in ("latency", INFERENCE.key)
            if on_clock and experiment.timing_of(evaluation) == "lockstep":
                raise UserError(f"--sweep {name}: changes nothing in timing lockstep, which has no latencies")
        super().check(config)

    def points(self, config: SweepConfig) -> Iterator[Point]:
        """Yield the evaluation as trained, then those with one condition changed."""
        yield Point(AS_TRAINED, "virtual", 0.0, {}, {"condition": "", "value": None})
        for name, values in config.sweep.items():
            for value in values:
                key = key_of(name)  # a single level of light is a range of one level
                level = [value, value] if key == key_of("light") and not isinstance(value, list) else value
                case_id = f"{name}-{value_text(value)}".replace("/", "_")
                yield Point(case_id, "virtual", 0.0, {key: level}, {"condition": name, "value": value})

    def cases(self, config: SweepConfig) -> Iterator[Point]:
        """Yield the evaluations to fly; conditions that change nothing are flown once, as trained."""
        trained, *departed = [(point, self.runs(config, point)[0][1]) for point in self.points(config)]
        same = [point.id for point, evaluation in departed if evaluation == trained[1]]
        for point, evaluation in [trained, *departed]:
            if point.id not in same:
                labels = {**point.labels, "same": same if point.id == AS_TRAINED else []}
                timing, typical_s = experiment.timing_of(evaluation), self.size(config, point)[1]
                yield replace(point, timing=timing, typical_s=typical_s, labels=labels)

    def why_serial(self, config: SweepConfig) -> str:
        suite, evaluation = self.first(config)
        on_wall = experiment.timing_of(evaluation) == "wall"
        return "neighbours would spoil the measurement on the wall clock" if on_wall else suite.why_serial(evaluation)

    def summary(self, report: Report) -> Summary:
        """Return each condition's success with its interval, and McNemar's test against the flights as trained."""
        rows = {row["case"]: row for row in report.games.to_dict("records")}
        usual, cells = rows.get(AS_TRAINED), []
        won = {case: report.arrays(row)["is_success"] for case, row in rows.items()}
        for point in self.points(report.config):
            row = usual if usual and point.id in usual["same"] else rows.get(point.id)
            if row is not None:
                tested = usual is not None and row is not usual
                p = mcnemar_exact(won[AS_TRAINED], won[row["case"]]).p_value if tested else None
                found = {name: row[name] for name in MEASURES if name in row}
                cells.append({**point.labels, **Proportion.of(row).as_summary(), **found, "mcnemar_p": p})
        return {
            "suite": self.name,
            "agent": report.config.agent,
            "seed": report.config.seed,
            flown_in(report.games): report.config.games,
            "provenance": sorted({timing_provenance(timing) for timing in report.games.timing}),
            "cells": cells,
        }

    def title(self, report: Report) -> str:
        return f"Success of {report.config.who}, one condition changed at a time"

    def headline(self, report: Report) -> str:
        """Return the success as trained, and the condition that costs most."""
        summary = report.summary
        flown = [(cell["success_ratio"], lanes_or_games(cell["games"], report.games)) for cell in usual_of(summary)]
        said = [f"{ratio:.1%} of {lanes} as trained" for ratio, lanes in flown]
        if departed := [cell for cell in summary["cells"] if cell["condition"]]:
            worst = min(departed, key=lambda cell: float(cell["success_ratio"]))
            where = f"{worst['condition']} = {value_text(worst['value'])}"
            least = f", the least of {len(departed)} conditions" if len(departed) > 1 else ""
            said.append(f"{worst['success_ratio']:.1%} at {where}{least}")
        return f"{report.config.who} wins {' and '.join(said)}"

    def source(self, report: Report) -> str:
        summary, games = report.summary, flown_in(report.games)
        how, flown = " and ".join(summary["provenance"]), lanes_or_games(summary[games], report.games)
        return f"{how} · {flown} each · seed {summary['seed']}"

    def overview(self, report: Report) -> Table:
        games = flown_in(report.games)
        distance, mean = {"median distance, m": "{distance_m_median:.1f}"}, {"mean return": "{return_mean:.4g}"}
        columns: dict[str, Column] = {
            "condition": "{name}",
            "value": "{text}",
            "success": "{success_ratio:.1%}",
            "95 % interval": "{wilson_low:.1%} to {wilson_high:.1%}",
            games: "{successes} of {games}",
            **(distance if games == "lanes" else mean),
            "p": lambda cell: "" if unknown(cell["mcnemar_p"]) else f"{cell['mcnemar_p']:.2g}",
        }
        return Table.of(conditions_of(report.summary), columns)

    def page(self, report: Report) -> Iterator[Block | str]:
        """Yield success at each value, a panel per condition, and the same as a table."""
        summary, title, games = report.summary, self.title(report), flown_in(report.games)
        cells = conditions_of(summary).query("condition != ''")
        options = {"sharex": False, "empty": "no condition changed"}
        figure, panels = plots.facets(cells, "name", title, height_in=1.7, **options)
        for axes, name, own in panels:
            ends = own.wilson_low, own.wilson_high
            plots.line(axes, range(len(own)), own.success_ratio, ends, color=style.GREEN)
            for usual in usual_of(summary):
                axes.axhline(usual["success_ratio"], **style.LIMIT)
            turned: dict[str, Any] = {"rotation": 25, "ha": "right"} if own.text.str.len().sum() > 16 else {}
            axes.set_xticks(range(len(own)), own.text, **turned)
            axes.set(ylim=(-0.03, 1.03), xlim=(-0.5, len(own) - 0.5), title=name)
            axes.yaxis.set_major_formatter("{x:.0%}")
        plots.label_outer([axes for axes, *_ in panels])
        style.legend(figure, {"as trained": style.LIMIT})
        caption = f"{title}, with 95 % Wilson intervals."
        alt = f"Lines of success by the value of each condition. {self.headline(report)}."
        yield report.figure("sweep", figure, caption, alt)
        yield self.overview(report)
        moved = " Where spacing or gap change, the obstacles stand elsewhere: a lane may be harder for anyone."
        yield method_note(
            f"One condition is changed at a time; the {games} are the same throughout. p is that of McNemar's exact "
            f"test against the flights as trained, {games[:-1]} by {games[:-1]}.{moved if games == 'lanes' else ''}"
        )


def flown_in(games: pd.DataFrame) -> str:
    """Return what evaluations have flown: lanes, or games of another environment, of which the returns are known."""
    return "games" if "return_mean" in games else "lanes"


def lanes_or_games(count: int, games: pd.DataFrame) -> str:
    """Return a number of what evaluations have flown with its noun: 1 lane, 300 lanes, 40 games."""
    return counted(count, flown_in(games).removesuffix("s"))


def usual_of(summary: Summary) -> list[Any]:
    """Return the cell of a sweep as trained, if that was flown."""
    return [cell for cell in summary["cells"] if not cell["condition"]]


def conditions_of(summary: Summary) -> pd.DataFrame:
    """Return the cells of a sweep's summary as a table, with the condition's name and unit and the value as a text."""
    known = [*SHORT_NAMES.values(), INFERENCE]
    names = {"": "as trained"} | {each.short: f"{each.short}, {each.unit}" for each in known if each.unit}
    cells = table_of(summary["cells"])
    texts = [value_text(cell["value"]) if cell["condition"] else "" for cell in summary["cells"]]
    return cells.assign(name=cells.condition.replace(names), text=texts)


# --- maps of robustness ---------------------------------------------------------------------------------------------


Scale = Annotated[float, Field(ge=0.0, le=MOST_SCALE)]


class RobustnessConfig(PolicyExperiment):
    """`suite: robustness`."""

    suite: Literal["robustness"]
    profile: ProfileName = "airsim"
    """How time is handled: exact to the tick, or as AirSim does."""
    command: CommandNames = ("adsc", "tcsc")
    """The synchronous commands to fly with."""
    clock_speed: ClockSpeeds
    """ClockSpeeds to fly at: simulated seconds per wall second."""
    latency_scale: Annotated[tuple[Scale, ...], AfterValidator(experiment.distinct)]
    """Factors of the latencies of the profile's model, flown in this order: put what matters most first."""
    games: Games = 100
    """Lanes flown in each cell."""


class RobustnessRow(PolicyRow):
    """The row of an evaluation with one command at one latency and ClockSpeed."""

    command: CommandName
    clock_speed: Positive
    latency_scale: NotNegative


FITTED = 1.0
COLLAPSED = 0.5  # share of the success in real time with the fitted latency


class Robustness(PolicyGrid):
    """`uavaccel run robustness`: success over latency and ClockSpeed, and where it collapses."""

    name = "robustness"
    config = RobustnessConfig
    row = RobustnessRow

    def points(self, config: RobustnessConfig) -> Iterator[Point]:
        """Yield the cells latency by latency, so that an interrupted run has complete rows of the map."""
        for scale, clock_speed, command in product(config.latency_scale, config.clock_speed, config.command):
            set_to = {"profile": config.profile, "command": command, "clock": clock_speed, "latency": scale}
            keys = {key_of(name): value for name, value in set_to.items()} | {"task.timing": "virtual"}
            labels = {"command": command, "clock_speed": clock_speed, "latency_scale": scale}
            yield Point(self.case_of(labels), "virtual", 0.0, keys, labels)

    def case_of(self, row: Plain) -> str:
        return f"latency{row['latency_scale']:g}-{row['command']}-{row['clock_speed']:g}x"

    def summary(self, report: Report) -> Summary:
        """Return each cell with its interval, and where each command and ClockSpeed collapses.

        `above` is the largest latency up to which its success does not fall below half of that in real time at the
        fitted latency, `below` the next that was flown; None where there is none, or no cell in real time.
        """
        measures = [name for name in MEASURES if name in report.games]
        kept = ["command", "clock_speed", "latency_scale", *measures]
        won = [Proportion.of(row).as_summary() for row in report.rows]
        cells = [own | ratio for own, ratio in zip(report.games[kept].to_dict("records"), won, strict=True)]
        collapses = []
        success = pd.DataFrame(cells).set_index(["command", "clock_speed", "latency_scale"]).success_ratio.sort_index()
        for (command, clock_speed), line in success.groupby(level=[0, 1]):
            line, real_time = line.droplevel([0, 1]), success.get((command, 1.0, FITTED))
            fallen = (line < COLLAPSED * (real_time or 0.0)).cummax()
            above, below = max(line.index[~fallen], default=None), min(line.index[fallen], default=None)
            found = {"command": command, "clock_speed": clock_speed, "fitted": line.get(FITTED), "real_time": real_time}
            collapses.append(found | {"above": None if real_time is None else above, "below": below})
        shared = subset(vars(report.config), "suite", "agent", "profile", "seed")
        return {**shared, "cells": cells, "collapses": collapses}

    def title(self, report: Report) -> str:
        return f"Success of {report.config.who} over latency and ClockSpeed"

    def headline(self, report: Report) -> str:
        """Return the worst cell and the best."""
        worst, *_, best = [
            f"{cell['success_ratio']:.1%} with {command_at_clock(cell)} and latency ×{cell['latency_scale']:g}"
            for cell in sorted(report.summary["cells"], key=lambda cell: float(cell["success_ratio"])) * 2
        ]
        span = f"from {worst} to {best}" if len(report.summary["cells"]) > 1 else best
        return f"{report.config.who} wins {span}"

    def source(self, report: Report) -> str:
        cells, config = report.summary["cells"], report.config
        points, lanes = counted(len(cells), "point"), lanes_or_games(max(c["games"] for c in cells), report.games)
        return f"modelled, profile {config.profile} · {points}, {lanes} each · seed {config.seed}"

    def overview(self, report: Report) -> Table:
        cells = pd.DataFrame(report.summary["cells"])
        cells["text"] = [Proportion.of(cell).text(0) for cell in report.summary["cells"]]
        texts = cells.pivot(index=["command", "latency_scale"], columns="clock_speed", values="text").fillna("-")
        rows = [(command_name(command), f"×{scale:g}", *line) for (command, scale), *line in texts.itertuples()]
        return Table(("command", "latency", *map(clock_label, texts.columns)), rows)

    def page(self, report: Report) -> Iterator[Block | str]:
        def words(found: Mapping[str, Any]) -> str:
            above, below = found["above"], found["below"]
            if found["real_time"] is None:
                return "- (1x at the fitted latency was not flown)"
            if not found["real_time"]:
                return "- (nothing was won at 1x and the fitted latency)"
            if below is None:
                return f"nowhere up to ×{above:g}"
            return f"at ×{below:g} or less" if above is None else f"between ×{above:g} and ×{below:g}"

        yield self.figure(report)
        yield self.overview(report)
        yield Heading("Where success collapses")
        yield Table.of(
            report.summary["collapses"],
            {
                "command": "{command!u}",
                "ClockSpeed": "{clock_speed:g}x",
                "success at the fitted latency": "{fitted:.1%}",
                "falls below half of that in real time": words,
            },
        )
        yield method_note(
            "Latencies are those of all messages of the profile's frozen model, requests, replies and callbacks, times "
            "the factor; the costs of frames, ticks and timers stay as they are, and are all that is left at ×0. "
            "Policy and lanes are the same in all cells: the map shows what a policy that was trained without latency "
            "tolerates; training with latency may do better or worse."
        )

    def figure(self, report: Report) -> Picture:
        """Draw a map per command: success as colour and text above its interval, framed at the fitted latency."""
        from matplotlib.patches import Rectangle

        cells, title = pd.DataFrame(report.summary["cells"]), self.title(report)
        clocks, scales = (sorted(cells[name].unique()) for name in ("clock_speed", "latency_scale"))
        across = 2 if len(clocks) < 6 else 1
        figure, panels = plots.facets(cells, "command", title, height_in=0.4 + 0.5 * len(scales), across=across)
        for axes, command, own in panels:
            success = own.pivot(index="latency_scale", columns="clock_speed", values="success_ratio")
            ratios = success.reindex(index=scales, columns=clocks)
            plots.success_map(axes, ratios, origin="lower")
            for cell in own.to_dict("records"):
                place = clocks.index(cell["clock_speed"]), scales.index(cell["latency_scale"])
                text: dict[str, Any] = {"ha": "center", "color": plots.ink_on(cell["success_ratio"])}
                axes.annotate(f"{cell['success_ratio']:.0%}", place, va="bottom", fontweight="bold", **text)
                interval = f"{100 * cell['wilson_low']:.0f}–{100 * cell['wilson_high']:.0f}"
                text |= {"xytext": (0, -2), "textcoords": "offset points", "va": "top", "fontsize": 8}
                axes.annotate(interval, place, **text)
            axes.set_title(command_name(command))
            plots.clock_axis(axes, clocks)
            axes.set_yticks(range(len(scales)), [f"×{scale:g}" for scale in scales])
            if FITTED in scales:
                corner = -0.5, scales.index(FITTED) - 0.5
                frame = Rectangle(corner, len(clocks), 1.0, fill=False, edgecolor=style.BLACK, linewidth=2.0)
                axes.add_patch(frame)
            axes.set_ylabel("latency, times the fitted one")
        plots.label_outer([axes for axes, *_ in panels])
        caption = f"{title}, with 95 % Wilson intervals; the frame is the latency as fitted."
        return report.figure("robustness_map", figure, caption, f"A map of success. {self.headline(report)}.")
