"""Grids: an experiment flown at each point of a grid over its keys. Ablations of DP1; sweeps and maps of a policy.

An ablation flies the games of DP1 under each variant. A sweep and a robustness map evaluate one policy at each point,
on the same lanes, each evaluation in a run directory of its own below the run's.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from copy import copy
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
import pandas as pd
from pydantic import Field, field_validator

from uavaccel.config import Config, validate
from uavaccel.draw import style
from uavaccel.draw.labels import clock_label, command_at_clock, command_name
from uavaccel.draw.page import Block, Heading, Picture, Table, unknown
from uavaccel.envs.conditions import CONDITIONS
from uavaccel.errors import UsageError, UserError, suggestion
from uavaccel.files import Plain
from uavaccel.forms import Count, NotNegative, Number, Positive
from uavaccel.limits import MOST_SCALE, Games
from uavaccel.metrics.intervals import Proportion, mcnemar_exact
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.metrics.trajectory import quartiles
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT, policy_sha256
from uavaccel.suites import plots
from uavaccel.suites.dp1 import ARRAYS, SIMILAR_STLC, Dp1, Dp1Config, Dp1Row, Game, summary_cells
from uavaccel.suites.experiment import (
    ClockSpeeds,
    CommandName,
    CommandNames,
    Experiment,
    ProfileName,
    Timing,
    distinct,
    merged,
    timing_of,
)
from uavaccel.suites.flight import Flight
from uavaccel.suites.gpu import on_own_gpu
from uavaccel.suites.parts import OUTCOMES, Part, fly_part, outcomes, part_run, part_suite
from uavaccel.suites.report import Report, Summary, finished, source_line, table_of
from uavaccel.suites.rows import GameRow, Row
from uavaccel.suites.suite import AnySuite, CaseType, ConfigType, GameResult, SimpleCase, Suite
from uavaccel.yaml_io import parse_yaml

if TYPE_CHECKING:
    from uavaccel.wire.session import Session


@dataclass(frozen=True)
class Point:
    """A point of a grid: its name, the dotted keys that set it, and the entries of its rows that say which it is.

    Where a whole run is flown at it, it is the case as well.
    """

    id: str
    keys: Mapping[str, object]
    labels: Mapping[str, object]
    timing: str = "virtual"
    typical_s: float = 0.0

    def simulated_s(self) -> float:
        return self.typical_s


class Grid(Suite[ConfigType, CaseType]):
    """An experiment at each point of a grid over its keys."""

    @abstractmethod
    def points(self, config: ConfigType) -> Iterator[Point]:
        """Yield every point, in canonical order."""

    @abstractmethod
    def experiment(self, config: ConfigType, point: Point) -> tuple[AnySuite, Any]:
        """Return the suite that flies a point, and its configuration there. Raises UserError, which names the key."""

    def check(self, config: ConfigType) -> None:
        for point in self.points(config):
            self.experiment(config, point)


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
    base: dict[str, Plain]
    """A DP1 configuration; `suite` and `seed` may be left out. Its latency is a block or what ships for the profile."""
    variants: Annotated[tuple[Variant, ...], Field(min_length=1)]
    """The variants of the DP1 configuration, each flown in full."""

    @field_validator("variants")
    @classmethod
    def _distinct(cls, variants: tuple[Variant, ...]) -> tuple[Variant, ...]:
        names = [variant.name for variant in variants]
        if len(set(names)) < len(names):
            raise ValueError("must have names of their own")
        return variants

    @property
    def timing(self) -> str:
        return str(self.base.get("timing", "virtual"))


class AblationRow(Dp1Row):
    """The row of a game of DP1 under a variant."""

    variant: str


@dataclass(frozen=True)
class VariantGame(SimpleCase):
    """A game of DP1 under a variant, by the variant's place in the configuration."""

    variant: int
    game: Game


OpenedVariant = Callable[[int], tuple[Dp1Config, "Session"]]
GOAL_TIMEOUT_S = 0.063  # AirSim's, on its 3 ms grid
ABLATION = (
    "STLC and position error against ADSC at 1x under the same variant: medians over games, T_moves and rounds pooled; "
    "effective speed-up: its mean over the T_moves of the most rounds."
)


class Ablation(Grid[AblationConfig, VariantGame]):
    """`uavaccel run ablation`: the games of DP1 under each variant, with the same seeds."""

    name = "ablation"
    config = AblationConfig
    row = AblationRow
    arrays = ARRAYS
    dp1: ClassVar[Dp1] = Dp1()

    def points(self, config: AblationConfig) -> Iterator[Point]:
        return (Point(variant.name, variant.changes, {"variant": variant.name}) for variant in config.variants)

    def experiment(self, config: AblationConfig, point: Point) -> tuple[Dp1, Dp1Config]:
        base = {**config.base, "suite": "dp1", "seed": config.seed}
        validate(Dp1Config, base, "base")
        return self.dp1, validate(Dp1Config, merged(base, point.keys), f"variant {point.id!r}")

    def cases(self, config: AblationConfig) -> Iterator[VariantGame]:
        for variant, point in enumerate(self.points(config)):
            for game in self.dp1.cases(self.experiment(config, point)[1]):
                if game.role != "figure2":
                    yield VariantGame(f"v{variant:02d}-{game.id}", game.timing, game.simulated_s(), variant, game)

    @contextmanager
    def open(self, config: AblationConfig, timing: str, run: RunDirectory) -> Iterator[OpenedVariant]:
        """Yield what returns a variant's experiment and its session, opened when its first game is flown."""
        points = list(self.points(config))
        with ExitStack() as stack:

            @cache
            def opened(variant: int) -> tuple[Dp1Config, Session]:
                dp1, experiment = self.experiment(config, points[variant])
                return experiment, stack.enter_context(dp1.open(experiment, timing, run))

            yield opened

    def fly(self, config: AblationConfig, case: VariantGame, opened: OpenedVariant) -> GameResult:
        experiment, session = opened(case.variant)
        flown = self.dp1.fly(experiment, case.game, session)
        return GameResult({**flown.row, "variant": config.variants[case.variant].name}, flown.arrays)

    def flight(
        self, report: Report, game: Mapping[str, Any], pictures: bool = True, event_rate_hz: float | None = None
    ) -> Flight:
        return self.dp1.flight(self._under(report, str(game["variant"])), game, pictures, event_rate_hz)

    def _under(self, report: Report, variant: str) -> Report:
        """Return the report's games under one variant as those of a run of DP1."""
        own = copy(report)
        [point] = [point for point in self.points(report.config) if point.id == variant]
        own.config = self.experiment(report.config, point)[1]
        own.games = report.games[report.games.variant == variant]
        return own

    def score(self, report: Report) -> pd.DataFrame:
        return pd.concat([self.dp1.score(self._under(report, each)) for each in report.games.variant.unique()])

    def summary(self, report: Report) -> Summary:
        """Return an entry for each variant, command and ClockSpeed, with the games of all T_moves and rounds pooled.

        Games in lockstep are left out. The speed-up is the mean over the T_moves of the most rounds, as in the paper.
        """
        config, entries = report.config, []
        for point in self.points(config):
            own = report.scores[report.scores.variant == point.id]
            cells = pd.DataFrame(summary_cells(own, config.seed))
            for (command, clock_speed), games in own[own.timing != "lockstep"].groupby(["command", "clock_speed"]):
                same = (cells.command == command) & (cells.clock_speed == clock_speed) & (cells.timing != "lockstep")
                longest = cells[same & (cells["rounds"] == games["rounds"].max())]
                key = {**point.labels, "command": command, "clock_speed": clock_speed}
                entries.append(key | pooled(games, longest.effective_speedup))
        return {"suite": self.name, "title": config.title, "seed": config.seed, "entries": entries}

    def title(self, report: Report) -> str:
        return str(report.config.title)

    def headline(self, report: Report) -> str:
        """Return the least and the most accurate variant of each command at the highest ClockSpeed."""
        known = [entry for entry in report.summary["entries"] if entry["stlc_quartiles"]]
        fastest = [entry for entry in known if entry["clock_speed"] == max(each["clock_speed"] for each in known)]
        said = []
        for command in sorted({entry["command"] for entry in fastest}):
            own = sorted((each for each in fastest if each["command"] == command), key=lambda e: e["stlc_quartiles"][1])
            low, high = (f"{entry['stlc_quartiles'][1]:.3f} with {entry['variant']}" for entry in (own[0], own[-1]))
            said.append(f"{command_at_clock(own[0])}: STLC {f'from {low} to {high}' if len(own) > 1 else low}")
        return "; ".join(said) or "no variant has games to compare"

    def overview(self, report: Report) -> Table:
        return Table.of(
            entries_of(report),
            {
                "variant": "{variant}",
                "command": "{command!u}",
                "ClockSpeed": "{clock_speed:g}x",
                "games": "{games}{failed_games!f}",
                "STLC median [q25, q75]": "{stlc:.3f} [{stlc_q25:.3f}, {stlc_q75:.3f}]",
                "RMSE median, m": "{position_rmse_m_median:.3f}",
                "effective speed-up": "{effective_speedup:.2f}",
                "gaps beyond the goal timeout": "{share_beyond_goal_timeout:.0%}",
            },
        )

    def page(self, report: Report) -> Iterator[Block | str]:
        yield self.overview(report)
        yield ABLATION
        yield variants_figure(report)


def pooled(games: pd.DataFrame, speedups: pd.Series) -> dict[str, Any]:
    """Return the numbers of an entry from its scored games, and its speed-ups; None where one cannot be known."""
    own = finished(games)
    stlc, gap_s = own.stlc.dropna(), np.array([gap for each in own.gap_s for gap in each])
    return {
        "games": len(own),
        "failed_games": len(games) - len(own),
        "stlc_quartiles": list(quartiles(stlc)) if len(stlc) else None,
        "position_rmse_m_median": float(own.position_rmse_m.median()) if len(stlc) else None,
        "effective_speedup": float(speedups.mean()) if len(speedups) and speedups.notna().all() else None,
        "share_beyond_goal_timeout": float(np.mean(gap_s > GOAL_TIMEOUT_S + 1e-9)) if gap_s.size else None,
    }


def entries_of(report: Report) -> pd.DataFrame:
    """Return the entries of an ablation's summary as a table, with a column for each quartile."""
    names = "stlc_q25", "stlc", "stlc_q75"
    entries = report.summary["entries"]
    return table_of(
        [{**entry, **dict(zip(names, entry["stlc_quartiles"] or [np.nan] * 3, strict=True))} for entry in entries]
    )


def variants_figure(report: Report) -> Picture:
    """Draw STLC, position error and speed-up over the variants, on a logarithmic axis if their names are far apart."""
    config, entries, source = report.config, entries_of(report), source_line(report.games)
    figure, grid = plots.panels(1, 3, config.title, source, (10.4 / 3, 3.0))
    if len(entries):
        clocks = sorted(entries.clock_speed.unique())
        place, names = _places(entries, config.times_clock_speed)
        for (command, clock), own in entries.assign(place=place).groupby(["command", "clock_speed"]):
            line: style.LineStyle = {"marker": "o", "markersize": 4, "color": style.colour(clocks.index(clock))}
            line |= {"linestyle": {"adsc": "-", "tcsc": "--"}[command]}
            for axes, (column, label) in zip(grid[0], VARIANT_PANELS.items(), strict=True):
                values = own[column].astype(float)
                axes.plot(own.place, values, **line, label=f"{command_name(command)} {clock_label(clock)}")
                axes.set(ylabel=label, xlabel=config.axis)
        for axes in grid[0]:
            above = place[place > 0]
            if names is not None:
                axes.set_xticks(range(len(names)), names, rotation=20, ha="right")
            elif len(above) and above.max() / above.min() > 20:
                axes.set_xscale("symlog", linthresh=above.min())
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside right center", fontsize=7.5)
    grid[0, 0].axhline(SIMILAR_STLC, color="#C00000", linewidth=1.0, zorder=1)
    grid[0, 2].set_yscale("log")
    return report.figure("ablation", figure, f"{config.title}. {ABLATION}", source)


VARIANT_PANELS = {
    "stlc": "STLC, median",
    "position_rmse_m_median": "position error, m (RMSE, median)",
    "effective_speedup": "effective speed-up",
}


def _places(entries: pd.DataFrame, times_clock_speed: bool) -> tuple[pd.Series, Sequence[str] | None]:
    """Return the entries' places on the axis, and the names of the variants there unless all are numbers."""
    try:
        return entries.variant.astype(float) * (entries.clock_speed if times_clock_speed else 1.0), None
    except ValueError:
        places, names = pd.factorize(entries.variant)
        return pd.Series(places, entries.index), list(names)


class PolicyExperiment(Experiment):
    """Keys of suites that evaluate one policy under several conditions."""

    agent: str = DEFAULT
    """The policy, as `uavaccel evaluate` takes it."""
    games: Games = 300
    """Number of evaluation lanes, which are the same under each condition."""
    evaluation: Part = Part(experiment="evaluate")
    """How each policy is evaluated: an experiment, and keys that differ from it."""


class PolicyRow(GameRow):
    """The row of an evaluation; suites add the keys of their conditions."""

    games: Games
    successes: Count
    distance_m_median: Number
    sim_time_s: NotNegative


PolicyConfig = TypeVar("PolicyConfig", bound=PolicyExperiment)


class PolicyGrid(Grid[PolicyConfig, Point]):
    """One policy, evaluated on the same lanes at each point."""

    batch = 1
    arrays = OUTCOMES
    kept: ClassVar[Sequence[str]] = ("games", "successes", "distance_m_median", "sim_time_s")
    """Keys of the evaluation's summary that its row keeps."""

    def part(self, config: PolicyConfig, point: Point) -> Part:
        """Return the evaluation at a point."""
        keys = {"agent": config.agent, "games": config.games, **config.evaluation.keys, **point.keys}
        return Part(experiment=config.evaluation.experiment, keys=keys)

    def experiment(self, config: PolicyConfig, point: Point) -> tuple[AnySuite, Any]:
        suite, evaluation = part_suite(self.part(config, point), config.seed)
        if suite.name != "evaluate":
            raise UserError(f"evaluation.experiment = {config.evaluation.experiment}: is no evaluation")
        return suite, evaluation

    def first(self, config: PolicyConfig) -> tuple[AnySuite, Any]:
        """Return suite and configuration of the first evaluation, which represents all where they do not differ."""
        return self.experiment(config, next(self.points(config)))

    def cases(self, config: PolicyConfig) -> Iterator[Point]:
        simulated_s = _simulated_s(*self.first(config))
        return (replace(point, typical_s=simulated_s) for point in self.points(config))

    def games(self, config: PolicyConfig, case: Point) -> int:
        return config.games

    def renders(self, config: PolicyConfig) -> bool:
        suite, evaluation = self.first(config)
        return suite.renders(evaluation)

    def provenance(self, config: PolicyConfig) -> Mapping[str, object]:
        """Return the policy's hash. Raises UserError for a device that this machine does not have."""
        suite, evaluation = self.first(config)
        suite.provenance(evaluation)
        return {"policy_sha256": policy_sha256(config.agent)}

    def open(self, config: PolicyConfig, timing: str, run: RunDirectory) -> AbstractContextManager[RunDirectory]:
        return on_own_gpu(run)

    def fly(self, config: PolicyConfig, case: Point, opened: RunDirectory) -> GameResult:
        """Evaluate; the row has keys of the evaluation's summary, the arrays the outcome of each lane."""
        summary = fly_part(opened, case.id, self.part(config, case), config.seed)
        found = {name: summary[name] for name in self.kept}
        return GameResult({**case.labels, **found}, outcomes(part_run(opened, case.id)))

    def status(self, rows: Sequence[Row]) -> str:
        return f"{rows[-1]['case']} won {rows[-1]['successes']} of {rows[-1]['games']}"


def _simulated_s(suite: AnySuite, config: Any) -> float:
    return sum(case.simulated_s() for case in suite.cases(config))


def agent_name(agent: str) -> str:
    """Return an agent as it is named in a sentence."""
    return "the policy that ships" if agent == DEFAULT else agent


def key_of(name: str) -> str:
    """Return the dotted key of a condition. Raises UsageError for a name that is neither short nor a task's key."""
    if name in CONDITIONS:
        return f"task.{CONDITIONS[name].key}"
    if name.startswith("task."):
        return name
    raise UsageError(f"--sweep {name}: is unknown; {suggestion(name, [*CONDITIONS, 'task.KEY'])}")


class SweepConfig(PolicyExperiment):
    """`suite: sweep`."""

    suite: Literal["sweep"]
    sweep: dict[str, tuple[object, ...]]
    """Values by short name (envs/conditions.py) or dotted key; one is changed at a time, all else is as trained."""

    @field_validator("sweep")
    @classmethod
    def _conditions(cls, sweep: dict[str, tuple[object, ...]]) -> dict[str, tuple[object, ...]]:
        if not sweep:
            raise ValueError("needs at least one condition, such as wind: [0, 3, 6]")
        for name, values in sweep.items():
            key_of(name)
            texts = [value_text(value) for value in values]
            if not texts or len(set(texts)) < len(texts):
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


def parse_sweep(text: str) -> tuple[str, list[object]]:
    """Parse NAME=VALUE,VALUE,... into name and values. Raises UsageError."""
    name, equals, values = text.partition("=")
    if not equals or not name or not values:
        raise UsageError(f"--sweep {text}: must be NAME=VALUE,VALUE,..., as in wind=0,3,6")
    key_of(name)
    return name, list(parse_yaml(f"[{values}]", source=f"--sweep {text}"))


def value_text(value: object) -> str:
    """Return a value as names, tables and figures have it: 3, 0.15, noisy."""
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


AS_TRAINED = "as-trained"
SWEEP_COLUMNS = 3
SWEEP = (
    "One condition is changed at a time; the lanes are the same throughout. p is that of McNemar's exact test against "
    "the flights as trained, lane by lane. Where spacing or gap change, the obstacles stand elsewhere, and a lane may "
    "be harder or easier for any policy."
)


class Sweep(PolicyGrid[SweepConfig]):
    """`uavaccel evaluate --sweep`, `uavaccel run sweep`: one condition at a time departs from the training's."""

    name = "sweep"
    config = SweepConfig
    row = SweepRow
    kept = (*PolicyGrid.kept, "timing")

    def points(self, config: SweepConfig) -> Iterator[Point]:
        """Yield the evaluation as trained, then those with one condition changed."""
        yield Point(AS_TRAINED, {}, {"condition": "", "value": None})
        for name, values in config.sweep.items():
            for value in values:
                key = key_of(name)  # a single level of light is a range of one level
                level = [value, value] if key == key_of("light") and not isinstance(value, list) else value
                case_id = f"{name}-{value_text(value)}".replace("/", "_")
                yield Point(case_id, {key: level}, {"condition": name, "value": value})

    def cases(self, config: SweepConfig) -> Iterator[Point]:
        """Yield the evaluations to fly; conditions that change nothing are flown once, as trained."""
        (trained, *departed) = [(point, *self.experiment(config, point)) for point in self.points(config)]
        same = [point.id for point, _, evaluation in departed if evaluation == trained[2]]
        for point, suite, evaluation in [trained, *departed]:
            if point.id not in same:
                labels = {**point.labels, "same": same if point.id == AS_TRAINED else []}
                timing, simulated_s = timing_of(evaluation), _simulated_s(suite, evaluation)
                yield replace(point, labels=labels, timing=timing, typical_s=simulated_s)

    def why_serial(self, config: SweepConfig) -> str:
        suite, evaluation = self.first(config)
        if timing_of(evaluation) == "wall":
            return "neighbours would spoil the measurement on the wall clock"
        return suite.why_serial(evaluation)

    def summary(self, report: Report) -> Summary:
        """Return each condition's success with its interval, and McNemar's test against the flights as trained."""
        rows = {row["case"]: row for row in report.games.to_dict("records")}
        usual = rows.get(AS_TRAINED)
        same = () if usual is None else usual["same"]
        won = {case: report.arrays(row)["is_success"] for case, row in rows.items()}
        cells = []
        for point in self.points(report.config):
            row = usual if point.id in same else rows.get(point.id)
            if row is not None:
                tested = usual is not None and row is not usual
                p = mcnemar_exact(won[AS_TRAINED], won[row["case"]]).p_value if tested else None
                found = {"distance_m_median": row["distance_m_median"], "mcnemar_p": p}
                cells.append({**point.labels, **Proportion.of(row).as_summary(), **found})
        return {
            "suite": self.name,
            "agent": report.config.agent,
            "seed": report.config.seed,
            "lanes": report.config.games,
            "provenance": sorted({timing_provenance(timing) for timing in report.games.timing}),
            "cells": cells,
        }

    def title(self, report: Report) -> str:
        return f"Success of {agent_name(report.config.agent)}, one condition changed at a time"

    def headline(self, report: Report) -> str:
        """Return the success as trained, and the condition that costs most."""
        summary, said = report.summary, []
        if (usual := as_trained(summary)) is not None:
            said.append(f"{usual:.1%} as trained")
        if departed := [cell for cell in summary["cells"] if cell["condition"]]:
            worst = min(departed, key=lambda cell: float(cell["success_ratio"]))
            where = f"{worst['condition']} = {value_text(worst['value'])}"
            said.append(f"{worst['success_ratio']:.1%} at {where}, the least of {len(departed)} conditions")
        provenance = " and ".join(summary["provenance"])
        return f"{agent_name(summary['agent'])} wins {', '.join(said)}; {provenance}, {summary['lanes']} lanes each"

    def overview(self, report: Report) -> Table:
        return Table.of(
            conditions_of(report.summary),
            {
                "condition": "{name}",
                "value": "{text}",
                "success": "{success_ratio:.1%}",
                "95 % interval": "{wilson_low:.1%} to {wilson_high:.1%}",
                "lanes": "{successes} of {games}",
                "median distance, m": "{distance_m_median:.1f}",
                "p": lambda cell: "" if unknown(cell["mcnemar_p"]) else f"{cell['mcnemar_p']:.2g}",
            },
        )

    def page(self, report: Report) -> Iterator[Block | str]:
        yield sweep_figure(report)
        yield self.overview(report)
        yield SWEEP


def as_trained(summary: Summary) -> float | None:
    """Return the success under the conditions of the training, if that was flown."""
    return next((cell["success_ratio"] for cell in summary["cells"] if not cell["condition"]), None)


def conditions_of(summary: Summary) -> pd.DataFrame:
    """Return the cells of a sweep's summary as a table, with the condition's name and unit and the value as a text."""
    names = {"": "as trained"} | {name: f"{name}, {each.unit}" for name, each in CONDITIONS.items() if each.unit}
    cells = table_of(summary["cells"])
    values = zip(cells.condition, cells.value, strict=True)
    texts = [value_text(value) if condition else "" for condition, value in values]
    return cells.assign(name=[names.get(each, each) for each in cells.condition], text=texts)


def sweep_figure(report: Report) -> Picture:
    """Draw success at each value of a condition, a panel per condition; the dashed line is success as trained."""
    summary, title = report.summary, report.suite.title(report)
    source = f"{' and '.join(summary['provenance'])} · {summary['lanes']} lanes each · seed {summary['seed']}"
    cells = conditions_of(summary).query("condition != ''")
    count = cells.name.nunique()
    columns = max(min(count, SWEEP_COLUMNS), 1)
    size_in = max(2.4, 4.0 / columns), 2.1
    figure, grid = plots.panels(math.ceil(count / columns), columns, title, source, size_in, sharey=True)
    for axes, (name, own) in zip(grid.flat, cells.groupby("name", sort=False), strict=False):
        line: style.LineStyle = {"color": style.BLUE, "markersize": 4, "capsize": 3}
        intervals = list(zip(own.wilson_low, own.wilson_high, strict=True))
        plots.points(axes, range(len(own)), own.success_ratio.tolist(), intervals, **line)
        if (usual := as_trained(summary)) is not None:
            axes.axhline(usual, color=style.GREY, linestyle="--", linewidth=1.0)
        crowded = own.text.str.len().sum() > 24
        axes.set_xticks(range(len(own)), own.text, **({"rotation": 20, "ha": "right"} if crowded else {}))
        axes.set(ylim=(-0.03, 1.03), xlim=(-0.5, len(own) - 0.5), xlabel=name)
        axes.yaxis.set_major_formatter("{x:.0%}")
    for axes in grid.flat[count:]:
        axes.set_visible(False)
    for axes in grid[:, 0]:
        axes.set_ylabel("success")
    caption = f"{title}, with 95 % Wilson intervals; the dashed line is the success as trained."
    return report.figure("sweep", figure, caption, source)


class RobustnessConfig(PolicyExperiment):
    """`suite: robustness`."""

    suite: Literal["robustness"]
    profile: ProfileName = "airsim"
    """How time is handled: exact to the tick, or as AirSim does."""
    command: CommandNames = ("tcsc", "adsc")
    """The synchronous commands to fly with."""
    clock_speed: ClockSpeeds
    """ClockSpeeds to fly at: simulated seconds per wall second."""
    latency_scale: tuple[float, ...]
    """Factors of the latencies of the profile's model, flown in this order: put what matters most first."""
    games: Games = 100
    """Lanes flown in each cell."""

    @field_validator("latency_scale")
    @classmethod
    def _not_negative(cls, scales: tuple[float, ...]) -> tuple[float, ...]:
        if any(not 0 <= scale <= MOST_SCALE for scale in scales):
            raise ValueError(f"must be 0 to {MOST_SCALE:g}")
        return distinct(scales)


class RobustnessRow(PolicyRow):
    """The row of an evaluation with one command at one latency and ClockSpeed."""

    command: CommandName
    clock_speed: Positive
    latency_scale: NotNegative


FITTED = 1.0
COLLAPSED = 0.5  # share of the success in real time with the fitted latency
COLOURS = "cividis"  # which the common colour-vision deficiencies keep apart
ROBUSTNESS = (
    "Latencies are those of all messages of the profile's frozen model, requests, replies and callbacks, times the "
    "factor; the costs of frames, ticks and timers stay as they are, and are all that is left at ×0. Policy and lanes "
    "are the same in all cells: the map shows what a policy that was trained without latency tolerates; training with "
    "latency may do better or worse."
)


class Robustness(PolicyGrid[RobustnessConfig]):
    """`uavaccel run robustness`: success over latency and ClockSpeed, and where it collapses."""

    name = "robustness"
    config = RobustnessConfig
    row = RobustnessRow

    def points(self, config: RobustnessConfig) -> Iterator[Point]:
        """Yield the cells latency by latency, so that an interrupted run has complete rows of the map."""
        for scale, clock_speed, command in product(config.latency_scale, config.clock_speed, config.command):
            set_to = {"profile": config.profile, "command": command, "clock": clock_speed, "latency": scale}
            keys = {key_of(name): value for name, value in set_to.items()}
            labels = {"command": command, "clock_speed": clock_speed, "latency_scale": scale}
            yield Point(self.case_of(labels), {**keys, "task.timing": "virtual"}, labels)

    def case_of(self, row: Plain) -> str:
        return f"latency{row['latency_scale']:g}-{row['command']}-{row['clock_speed']:g}x"

    def summary(self, report: Report) -> Summary:
        """Return each cell with its interval, and where each command and ClockSpeed collapses."""
        config, kept = report.config, ["command", "clock_speed", "latency_scale", "distance_m_median"]
        rows = report.games.to_dict("records")
        cells = [{**{name: row[name] for name in kept}, **Proportion.of(row).as_summary()} for row in rows]
        flown = pd.DataFrame(cells)
        settings = sorted(set(zip(flown.command, flown.clock_speed, strict=True)))
        return {
            "suite": self.name,
            "agent": config.agent,
            "profile": config.profile,
            "seed": config.seed,
            "cells": cells,
            "collapses": [collapse(flown, *setting) for setting in settings],
        }

    def title(self, report: Report) -> str:
        return f"Success of {agent_name(report.config.agent)} over latency and ClockSpeed"

    def headline(self, report: Report) -> str:
        """Return the worst cell and the best."""
        cells, who = report.summary["cells"], agent_name(report.config.agent)
        by_success = sorted(cells, key=lambda cell: float(cell["success_ratio"]))
        worst, best = (
            f"{cell['success_ratio']:.1%} with {command_at_clock(cell)} and latency ×{cell['latency_scale']:g}"
            for cell in (by_success[0], by_success[-1])
        )
        games = sum(cell["games"] for cell in cells)
        points = f"{games} games over {len(cells)} points of latency and ClockSpeed"
        return f"{who} wins from {worst} to {best}: {points}, all of it modelled under {report.config.profile}"

    def overview(self, report: Report) -> Table:
        cells = pd.DataFrame(report.summary["cells"])
        cells["text"] = [Proportion.of(cell).text(0) for cell in report.summary["cells"]]
        texts = cells.pivot(index=["command", "latency_scale"], columns="clock_speed", values="text").fillna("-")
        rows = [(command_name(command), f"×{scale:g}", *line) for (command, scale), *line in texts.itertuples()]
        return Table(("command", "latency", *map(clock_label, texts.columns)), rows)

    def page(self, report: Report) -> Iterator[Block | str]:
        yield success_map(report)
        yield self.overview(report)
        yield Heading("Where success collapses")
        yield Table.of(
            report.summary["collapses"],
            {
                "command": "{command!u}",
                "ClockSpeed": "{clock_speed:g}x",
                "success at the fitted latency": "{fitted:.1%}",
                "falls below half of that in real time": collapse_words,
            },
        )
        yield ROBUSTNESS


def collapse(cells: pd.DataFrame, command: str, clock_speed: float) -> Summary:
    """Return the latencies between which success falls below half of that in real time at the fitted latency.

    `above` is the largest latency up to which it does not, `below` the next that was flown; None where there is none.
    Without the cell in real time both are None.
    """
    success = cells[cells.command == command].set_index(["clock_speed", "latency_scale"]).success_ratio.sort_index()
    real_time, fitted = (success.get((clock, FITTED)) for clock in (1.0, clock_speed))
    line = success[clock_speed]
    fallen = (line < COLLAPSED * (real_time or 0.0)).cummax()
    above = max(line.index[~fallen], default=None) if real_time is not None else None
    below = min(line.index[fallen], default=None)
    found = {"fitted": fitted, "real_time": real_time, "above": above, "below": below}
    return {"command": command, "clock_speed": clock_speed, **found}


def collapse_words(found: Mapping[str, Any]) -> str:
    """Return in words where a command collapses at a ClockSpeed."""
    above, below = found["above"], found["below"]
    if found["real_time"] is None:
        return "- (1x at the fitted latency was not flown)"
    if below is None:
        return f"nowhere up to ×{above:g}"
    return f"at ×{below:g} or less" if above is None else f"between ×{above:g} and ×{below:g}"


def success_map(report: Report) -> Picture:
    """Draw a map per command: success as colour and text above its interval, with a frame around the fitted latency."""
    from matplotlib.patches import Rectangle

    cells, title = pd.DataFrame(report.summary["cells"]), report.suite.title(report)
    clocks, scales = (sorted(cells[name].unique()) for name in ("clock_speed", "latency_scale"))
    commands = cells.groupby("command")
    lanes = f"{cells.games.max()} lanes each"
    source = f"modelled, profile {report.config.profile} · {lanes} · seed {report.config.seed}"
    size_in = 0.95 * len(clocks), 0.6 + 0.62 * len(scales)
    figure, grid = plots.panels(1, len(commands), title, source, size_in, sharey=True)
    for axes, (command, own) in zip(grid[0], commands, strict=True):
        success = own.pivot(index="latency_scale", columns="clock_speed", values="success_ratio")
        ratios = success.reindex(index=scales, columns=clocks)
        image = axes.imshow(ratios, COLOURS, aspect="auto", origin="lower", vmin=0.0, vmax=1.0)
        for cell in own.to_dict("records"):
            place = clocks.index(cell["clock_speed"]), scales.index(cell["latency_scale"])
            text: dict[str, Any] = {"ha": "center", "color": "white" if cell["success_ratio"] < 0.5 else "black"}
            axes.annotate(f"{cell['success_ratio']:.0%}", place, va="bottom", fontweight="bold", **text)
            interval = f"{100 * cell['wilson_low']:.0f}–{100 * cell['wilson_high']:.0f}"
            below = {"xytext": (0, -2), "textcoords": "offset points", "va": "top", "fontsize": 7}
            axes.annotate(interval, place, **below, **text)
        axes.set_title(command_name(command), loc="center")
        plots.clock_axis(axes, clocks)
        axes.set_yticks(range(len(scales)), [f"×{scale:g}" for scale in scales])
        axes.grid(visible=False)
        if FITTED in scales:
            corner = -0.5, scales.index(FITTED) - 0.5
            axes.add_patch(Rectangle(corner, len(clocks), 1.0, fill=False, edgecolor=style.VERMILION, linewidth=2.0))
    grid[0, 0].set_ylabel("latency, times the fitted one")
    figure.colorbar(image, ax=list(grid[0]), label="success", fraction=0.04)
    caption = f"{title}, with 95 % Wilson intervals; the frame is the latency as fitted."
    return report.figure("robustness_map", figure, caption, source)
