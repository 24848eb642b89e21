"""Mediation: what of ADSC's gap makes a policy fail, each part of it moved alone, in training and in flight.

Each case is a policy, trained or given, which is flown under every value of every factor, on the same lanes. Trainings
and evaluations are runs of other suites below parts/, resumed where they stopped.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, NotRequired

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, model_validator

from uavaccel.config import Config, Games, Name, Seed
from uavaccel.draw import style
from uavaccel.draw.page import Block, Column, Heading, Picture, Table, counted
from uavaccel.files import Plain
from uavaccel.forms import Count
from uavaccel.metrics.estimates import Success
from uavaccel.metrics.intervals import RESAMPLES, TAILS, student_quantile
from uavaccel.records import RunDirectory
from uavaccel.rl.config import LANE
from uavaccel.suites import plots
from uavaccel.suites.experiment import Experiment, GameRow, Row, subset
from uavaccel.suites.parts import OUTCOMES, Part, Run, SuiteOfRuns, evaluate_part, outcomes, part_folder, train_part
from uavaccel.suites.report import Report, Summary, method_note, table_of
from uavaccel.suites.suite import GameResult, SimpleCase

Keys = dict[str, Plain]
USUAL = "usual"  # the flight in which nothing is moved
MOST_LINES = 7  # policies that lines in a panel keep apart


class Factor(Config):
    """What is moved in flight, value by value."""

    label: str
    """What its axis shows, with a unit."""
    keys: Annotated[tuple[str, ...], Field(min_length=1)]
    """Dotted keys of the evaluation that are moved together; the figure's axis is the first one's."""
    values: Annotated[tuple[tuple[Plain, ...], ...], Field(min_length=1)]
    """The values of these keys, a list for each cell."""
    also: Keys = Field(default_factory=dict)
    """Dotted keys that are set in all of its cells."""

    @model_validator(mode="after")
    def _values_fit(self) -> Factor:
        if wrong := [line for line in self.values if len(line) != len(self.keys)]:
            raise ValueError(f"values has {list(wrong[0])}: needs a value for each of {', '.join(self.keys)}")
        if any(not isinstance(line[0], int | float) for line in self.values):
            raise ValueError(f"values: those of {self.keys[0]} must be numbers")
        if len({f"{line[0]:g}" for line in self.values}) < len(self.values):
            raise ValueError(f"values: each value of {self.keys[0]} once")
        return self


class Share(Config):
    """A question: how much of what `whole` loses does each of `parts` lose alone? Cells are POLICY/FLIGHT."""

    usual: str
    """The cell in which nothing is lost."""
    whole: str
    """The cell that loses."""
    parts: tuple[str, ...]
    """Cells that move a part of it."""


class Contrast(Config):
    """A question: what does one factor do, whatever the others are? Cells are POLICY/FLIGHT, and pair by pair alike."""

    label: str
    """The factor."""
    without: Annotated[tuple[str, ...], Field(min_length=1)]
    """Cells in which it is not moved."""
    moved: Annotated[tuple[str, ...], Field(min_length=1)]
    """As many in which it is."""


class MediationConfig(Experiment):
    """`suite: mediation`."""

    suite: Literal["mediation"]
    seeds: Annotated[int, Field(ge=1, le=1000)] = 1
    """Trainings of each policy, with seeds `seed`, `seed` + 1 and so on."""
    policies: Annotated[dict[Name, Keys], Field(min_length=1)]
    """Dotted keys of each policy's training that differ from `training`, or from the experiment that its key
    `experiment` names instead; beside `agent`, which names a policy that exists, keys of all its flights."""
    flights: Annotated[dict[Name, Factor], Field(min_length=1)]
    """What is moved in flight; each policy flies with every value, and as `evaluation` has it."""
    only_flights: tuple[str, ...] = ()
    """Names of the flights that are flown, such as usual and gap-2; by default all."""
    shares: tuple[Share, ...] = ()
    """Which cells' losses are compared; a flight is named FACTOR-VALUE or usual."""
    contrasts: tuple[Contrast, ...] = ()
    """Factors whose mean effect is asked for, each over cells of several trainings."""
    training: Part = Part(experiment="train_kernels")
    """How policies are trained: an experiment, and keys that differ from it."""
    evaluation: Part = Part(experiment="evaluate")
    """How policies are flown: an experiment, and keys that differ from it."""

    def named_flights(self) -> dict[str, Keys]:
        """Return the keys of each flight by its name, that in which nothing is moved first."""
        cells = {
            f"{name}-{values[0]:g}": factor.also | dict(zip(factor.keys, values, strict=True))
            for name, factor in self.flights.items()
            for values in factor.values
        }
        return {USUAL: {}, **cells}

    def flown(self) -> dict[str, Keys]:
        """Return the keys of the flights that are flown by their names."""
        flights, chosen = self.named_flights(), self.only_flights
        return {name: keys for name, keys in flights.items() if not chosen or name in chosen}

    @model_validator(mode="after")
    def _flights_and_cells_have_names(self) -> MediationConfig:
        flights = self.named_flights()
        if unknown := [name for name in self.only_flights if name not in flights]:
            raise ValueError(f"only_flights: {unknown[0]} is no flight; there are {', '.join(flights)}")
        if self.only_flights and USUAL not in self.only_flights:
            raise ValueError(f"only_flights: must have {USUAL}, with which others are compared")
        cells = {f"{policy}/{flight}" for policy in self.policies for flight in flights}
        named = {
            "shares": [cell for share in self.shares for cell in (share.usual, share.whole, *share.parts)],
            "contrasts": [cell for contrast in self.contrasts for cell in (*contrast.without, *contrast.moved)],
        }
        for key, names in named.items():
            if unknown := [name for name in names if name not in cells]:
                raise ValueError(f"{key}: {unknown[0]} is no cell; cells are POLICY/FLIGHT, as in {min(cells)}")
        for contrast in self.contrasts:
            if len(contrast.without) != len(contrast.moved):
                raise ValueError(f"contrasts: {contrast.label} needs as many cells moved as without")
        return self


class MediationRow(GameRow):
    """The row of a policy: what it won in each flight."""

    policy: str
    seed: Seed
    games: Games
    successes: dict[str, Count]
    """Games won by flight."""
    trained_games: NotRequired[Games]
    trained_successes: NotRequired[Count]
    weights_sha256: NotRequired[str]


@dataclass(frozen=True)
class PolicyCase(SimpleCase):
    """A policy, trained with a seed or given."""

    policy: str
    seed: int


class Mediation(SuiteOfRuns[MediationConfig, PolicyCase]):
    """`uavaccel run mediation`."""

    name = "mediation"
    config = MediationConfig
    row = MediationRow
    grows = ("seeds",)
    arrays: ClassVar = {f"*_{name}": replace(form, shape=("n",)) for name, form in OUTCOMES.items()}

    def check(self, config: MediationConfig) -> None:
        """Check that each policy's training and each flight can be configured. Raises UserError."""
        for case in self.policies_of(config.model_copy(update={"seeds": 1})):
            self.runs(config, case)

    def policies_of(self, config: MediationConfig) -> Iterator[PolicyCase]:
        """Yield the cases seed by seed, without estimates; a policy that exists has one."""
        for seed in range(config.seed, config.seed + config.seeds):
            for policy, keys in config.policies.items():
                if "agent" not in keys or seed == config.seed:
                    yield PolicyCase(f"{policy}-seed{seed}", "lockstep", 0.0, policy, seed)

    def cases(self, config: MediationConfig) -> Iterator[PolicyCase]:
        sizes: dict[str, float] = {}
        for case in self.policies_of(config):
            if case.policy not in sizes:
                sizes[case.policy] = self.size(config, case)[1]
            yield replace(case, typical_s=sizes[case.policy])

    def parts(self, config: MediationConfig, case: PolicyCase, agent: str) -> dict[str, Part]:
        """Return the training of a policy, unless it exists, and the flights of `agent`, by name."""
        keys, flying, also, training = dict(config.policies[case.policy]), config.evaluation, {}, {}
        if "agent" in keys:
            also = {key: value for key, value in keys.items() if key != "agent"}
        else:
            own = {} if "experiment" in keys else config.training.keys
            experiment = str(keys.pop("experiment", config.training.experiment))
            training = {"training": Part(experiment=experiment, keys={**own, **keys, "seed": case.seed})}
        return training | {
            flight: Part(experiment=flying.experiment, keys={**flying.keys, **also, **moved, "agent": agent})
            for flight, moved in config.flown().items()
        }

    def runs(self, config: MediationConfig, case: PolicyCase) -> list[Run]:
        """Return a policy's training and flights; of one to be trained in another environment, its training alone."""
        agent = str(config.policies[case.policy].get("agent", "default"))
        parts = [*self.parts(config, case, agent).values()]
        first = parts[0].resolve(config.seed)
        known = first[0].name != "train" or first[1].env_id == LANE
        return [first, *(part.resolve(config.seed) for part in parts[1:] if known)]

    def renders(self, config: MediationConfig) -> bool:
        return any(suite.renders(run) for suite, run in self.runs(config, next(self.policies_of(config))))

    def fly(self, config: MediationConfig, case: PolicyCase, opened: RunDirectory) -> GameResult:
        """Train, unless the policy exists, and fly it under each condition."""
        own = part_folder(opened, f"{case.id}/training").resolve()
        row: dict[str, Any] = {"policy": case.policy, "seed": case.seed, "successes": {}}
        arrays: dict[str, np.ndarray] = {}
        for name, part in self.parts(config, case, str(config.policies[case.policy].get("agent", own))).items():
            place, run = f"{case.id}/{name}", part.resolve(config.seed)
            if name == "training":
                learned = train_part(opened, place, run).summary
                row |= {f"trained_{key}": learned[key] for key in ("games", "successes")}
                row["weights_sha256"] = learned["weights_sha256"]
                continue
            report = evaluate_part(opened, place, run)
            row["games"], row["successes"][name] = report.summary["games"], report.summary["successes"]
            arrays |= {f"{name}_{key}": values for key, values in outcomes(report.run).items()}
        return GameResult(row, arrays)

    def status(self, rows: Sequence[Row]) -> str:
        return f"{rows[-1]['case']} won {rows[-1]['successes'][USUAL]} of {rows[-1]['games']}"

    def score(self, report: Report) -> pd.DataFrame:
        """Return a row for each policy and flight: `factor`, `value`, `won` (games,) bool, and `distance_m` or None."""
        cells = []
        for row in report.games.to_dict("records"):
            arrays = report.arrays(row)
            for flight in report.config.flown():
                factor, _, value = flight.partition("-")
                own = {"flight": flight, "factor": factor, "value": float(value) if value else None}
                own |= {"won": arrays[f"{flight}_is_success"], "distance_m": arrays.get(f"{flight}_distance_m")}
                cells.append(subset(row, "policy", "seed") | own)
        return table_of(cells)

    def summary(self, report: Report) -> Summary:
        """Return each cell's success, its seeds pooled, and the shares of the losses that are asked for."""
        cells = []
        for (policy, flight), own in report.scores.groupby(["policy", "flight"], sort=False):
            success = Success.on_lanes(own.won.tolist())
            over, distance_m = success.estimate, [each for each in own.distance_m if each is not None]
            cells.append(
                {
                    "policy": policy,
                    "flight": flight,
                    "factor": own.factor.iloc[0],
                    "value": own.value.iloc[0],
                    "seeds": own.seed.tolist(),
                    "successes_by_seed": [each.successes for each in success.policies],
                    **success.pooled.as_summary(),
                    "seeds_low": over.low,
                    "seeds_high": over.high,
                    "distance_m_median": float(np.median(np.concatenate(distance_m))) if distance_m else None,
                }
            )
        outcomes = {f"{policy}/{flight}": own for (policy, flight), own in report.scores.groupby(["policy", "flight"])}
        shares = [
            {"usual": share.usual, "whole": share.whole, "part": part, **share_of_loss(outcomes, share, part)}
            for share in report.config.shares
            for part in share.parts
            if all(cell in outcomes for cell in (share.usual, share.whole, part))
        ]
        contrasts = [
            {"label": contrast.label, **effect(outcomes, contrast)}
            for contrast in report.config.contrasts
            if all(cell in outcomes for cell in (*contrast.without, *contrast.moved))
        ]
        told = {"cells": cells, "shares": shares, "contrasts": contrasts}
        return {"suite": self.name, "seed": report.config.seed, **told}

    def title(self, report: Report) -> str:
        return "What of the gap makes a policy fail"

    def headline(self, report: Report) -> str:
        """Return the best and the worst cell."""
        worst, *_, best = sorted(report.summary["cells"], key=lambda cell: float(cell["success_ratio"])) * 2
        said = [f"{cell['success_ratio']:.1%} by {cell['policy']} in {cell['flight']}" for cell in (best, worst)]
        return f"success is {' and '.join(dict.fromkeys(said))}"

    def source(self, report: Report) -> str:
        policies, games = len(report.games), counted(report.games.games.iloc[0], "game")
        flown = f"1 policy, {games}" if policies == 1 else f"{policies} policies, {games} each"
        return f"modelled, without latency · {flown} · seed {report.config.seed}"

    def overview(self, report: Report) -> Table:
        """Return what is asked for, or all cells."""
        for asked, columns in (("contrasts", EFFECTS), ("shares", SHARES)):
            if found := report.summary[asked]:
                return Table.of(found, columns)
        return Table.of(report.summary["cells"], CELLS)

    def page(self, report: Report) -> Iterator[Block | str]:
        yield self.map(report) if len(report.config.policies) > MOST_LINES else self.lines(report)
        if contrasts := report.summary["contrasts"]:
            yield Heading("Effects")
            yield Table.of(contrasts, EFFECTS)
        if shares := report.summary["shares"]:
            yield Heading("Shares of the loss")
            yield Table.of(shares, SHARES)
        yield Heading("Success")
        yield Table.of(report.summary["cells"], CELLS)
        yield method_note(
            "All flights of a policy are on the same lanes. Brackets are 95 % intervals: of success over trainings, "
            "lanes and games, of a single training Wilson's, over its games alone; of shares a bootstrap over "
            "trainings and lanes. A share of 1 loses as much alone as the whole does; shares need not add up to 1. An "
            "effect is a difference of means over cells, its interval Welch's over trainings; cells of one policy are "
            "compared training by training. Intervals are not corrected for their number."
        )

    def map(self, report: Report) -> Picture:
        """Draw the success of each policy, a row each, in each flight, a column each."""
        cells = pd.DataFrame(report.summary["cells"])
        success = cells.pivot(index="policy", columns="flight", values="success_ratio")
        ratios = success.reindex(index=cells.policy.unique(), columns=cells.flight.unique())
        figure = style.new_figure(1.4 + 0.26 * len(ratios), self.title(report), self.source(report))
        axes = figure.subplots()
        plots.success_map(axes, ratios)
        for (row, column), ratio in np.ndenumerate(ratios):
            look: dict[str, Any] = {"ha": "center", "va": "center", "color": plots.ink_on(ratio), "fontsize": 8}
            axes.annotate(f"{100 * ratio:.0f}", (column, row), **look)
        names = [name.replace("_", " ").replace("-", " ", 1).replace("-", "\N{MINUS SIGN}") for name in ratios.columns]
        axes.set_xticks(range(len(names)), names, rotation=60, ha="right")
        trained = cells[cells.flight == USUAL].set_index("policy").seeds
        rows = [f"{str(name).replace('_', ' ')} ({len(trained[name])})" for name in ratios.index]
        axes.set_yticks(range(len(ratios)), rows, fontsize=8)
        axes.set(xlabel="flown with", ylabel="trained with (number of trainings)")
        caption = "Success in per cent, all trainings and lanes of a cell pooled."
        return report.figure("mediation", figure, caption, f"A map of success. {report.headline()}.")

    def lines(self, report: Report) -> Picture:
        """Draw success over the values of each factor, a panel each, a line for each policy."""
        cells = pd.DataFrame(report.summary["cells"])
        flights = {name: each for name, each in report.config.flights.items() if name in set(cells.factor)}
        figure, panels = plots.panels(len(flights), self.title(report), 2.2, empty="nothing was moved", sharey=True)
        for axes, (name, factor) in zip(panels, flights.items(), strict=True):
            for number, (policy, own) in enumerate(cells.groupby("policy", sort=False)):
                line, usual = own[own.factor == name].sort_values("value"), own[own.flight == USUAL].iloc[0]
                look = {"color": style.shade(number, cells.policy.nunique()), "marker": style.marker(number)}
                ends = line.seeds_low, line.seeds_high
                plots.line(axes, line.value, line.success_ratio, ends, label=str(policy), **look)
                axes.axhline(usual.success_ratio, color=look["color"], linestyle=":", linewidth=1.0)
            axes.set(title=name.replace("_", " "), xlabel=factor.label, ylim=(-0.03, 1.03))
            axes.yaxis.set_major_formatter("{x:.0%}")
        style.legend(figure)
        caption = "Success with 95 % intervals; dotted, nothing is moved."
        return report.figure("mediation", figure, caption, f"Lines of success. {report.headline()}.")


def share_of_loss(cells: Mapping[str, pd.DataFrame], share: Share, part: str) -> dict[str, float | None]:
    """Return the share of the success that `whole` loses which `part` loses alone, with a 95 % interval.

    It is resampled over trainings, of each policy once for all its flights, and over the lanes that all cells share.
    The ends are None where a loss of `whole` is not certain, as of a single training on a single lane.
    """
    names, random = (share.usual, share.whole, part), np.random.default_rng(0)
    won = {name: np.stack(cells[name].won.tolist()).astype(float) for name in names}
    seeds = {name.partition("/")[0]: len(values) for name, values in won.items()}
    lanes = next(iter(won.values())).shape[1]

    def losses(chosen: Mapping[str, NDArray[np.int64]], at: NDArray[np.int64]) -> tuple[float, float]:
        means = [won[name][np.ix_(chosen[name.partition("/")[0]], at)].mean() for name in names]
        return means[0] - means[1], means[0] - means[2]

    def resampled(count: int) -> NDArray[np.int64]:
        return random.integers(count, size=(count,))

    whole, alone = losses({policy: np.arange(count) for policy, count in seeds.items()}, np.arange(lanes))
    resamples = [{policy: resampled(count) for policy, count in seeds.items()} for _ in range(RESAMPLES)]
    drawn = np.array([losses(chosen, resampled(lanes)) for chosen in resamples])
    known = whole > 0.0 and max(lanes, *seeds.values()) > 1 and np.quantile(drawn[:, 0], TAILS[0]) > 0.0
    drawn = drawn[drawn[:, 0] > 0.0]  # of few games some may lose nothing
    low, high = np.quantile(drawn[:, 1] / drawn[:, 0], TAILS) if known else (None, None)
    return {"loss": whole, "alone": alone, "share": alone / whole if whole > 0.0 else None, "low": low, "high": high}


def effect(cells: Mapping[str, pd.DataFrame], contrast: Contrast) -> dict[str, Any]:
    """Return what a factor adds to success on average over its cells, and a 95 % interval over trainings.

    Welch's, with a variance for each policy; cells of a policy are compared training by training. Its ends are None
    where a policy has a single training.
    """
    count = len(contrast.moved)
    added: dict[str, NDArray[np.float64]] = {}
    means = []
    for sign, names in ((-1.0, contrast.without), (1.0, contrast.moved)):
        success = {name: np.array([won.mean() for won in cells[name].won]) for name in names}
        means.append(float(np.mean([values.mean() for values in success.values()])))
        for name, values in success.items():
            policy = name.partition("/")[0]
            added[policy] = added.get(policy, 0.0) + sign * values / count
    without, moved = means
    told = {"without": without, "moved": moved, "effect": moved - without, "low": None, "high": None}
    squared = [values.var(ddof=1) / len(values) for values in added.values() if len(values) > 1]
    if len(squared) == len(added) and sum(squared) > 0.0:
        spread = [square**2 / (len(values) - 1) for square, values in zip(squared, added.values(), strict=True)]
        width = student_quantile(max(1, int(sum(squared) ** 2 / sum(spread)))) * np.sqrt(sum(squared))
        told |= {"low": max(-1.0, moved - without - width), "high": min(1.0, moved - without + width)}
    return told | {"trainings": sum(map(len, added.values()))}


CELLS: dict[str, Column] = {
    "policy": "{policy}",
    "flight": "{flight}",
    "games won": "{successes} of {games}",
    "success [95 %]": "{success_ratio:.1%} [{seeds_low:.1%}, {seeds_high:.1%}]",
    "by seed": "{successes_by_seed!l}",
    "median distance, m": "{distance_m_median:.1f}",
}
SHARES: dict[str, Column] = {
    "the whole": "{whole}",
    "it loses": "{loss:.1%}",
    "moved alone": "{part}",
    "it loses ": "{alone:.1%}",
    "share [95 %]": "{share:.2f} [{low:.2f}, {high:.2f}]",
}
EFFECTS: dict[str, Column] = {
    "moved": "{label}",
    "success without": "{without:.1%}",
    "success with it": "{moved:.1%}",
    "effect [95 %]": "{effect:+.1%} [{low:+.1%}, {high:+.1%}]",
    "trainings": "{trainings}",
}
