"""Training: a policy learned, by default in the obstacle lane (paper, III-C3 and IV-D), and what its report draws."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NotRequired

import numpy as np
import pandas as pd
from pydantic import AfterValidator, Field, model_validator
from typing_extensions import TypedDict

from uavaccel.config import MOST_GAMES, validate
from uavaccel.config import Games as GameCount
from uavaccel.draw import style
from uavaccel.draw.page import Block, Column, Table, clock_label, command_name, counted, fill, in_words, listed
from uavaccel.envs.checks import check_functions
from uavaccel.envs.simulators import EXACT, KERNELS, flies_over_arrays
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.files import Plain, read_lines
from uavaccel.forms import Count, NotNegative, Number, Positive, check, check_all
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory, timing_provenance
from uavaccel.resources import require
from uavaccel.rl.agents import first_policy, origin_of
from uavaccel.rl.config import (
    DOUBLE_DQN,
    LANE,
    PPO,
    LearnerConfig,
    check_algorithm,
    environment_class,
    is_discrete,
    is_symmetric,
)
from uavaccel.rl.policy import trained_with
from uavaccel.suites import paper_results, plots
from uavaccel.suites.experiment import (
    Experiment,
    OutcomeRow,
    ReturnRow,
    Row,
    cumulative_wall_s,
    over_all_starts,
    subset,
)
from uavaccel.suites.report import Report, Summary, disturbed_games, source_of, summary_table
from uavaccel.suites.suite import GameResult, SimpleCase, Suite

if TYPE_CHECKING:  # they load what draws, and PyTorch
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from uavaccel.envs.task import Task
    from uavaccel.suites.trainer import Trainer

CHECKPOINTS = "checkpoints"  # the folder from which a training is resumed
EVALUATIONS = "evaluations.jsonl"  # a line for each evaluation of the current policy
REAL_TIME = "real_time.json"  # what its commands would have taken in real time
FIRST_GAMES = 2000  # of a training of which only the task is named
RECENT = 100  # games of the moving averages


class TrainConfig(LearnerConfig, Experiment):
    """`suite: train`."""

    suite: Literal["train"] = "train"
    evaluate_every_games: Annotated[int, Field(ge=0, le=MOST_GAMES)] = 0
    """Interval in games at which the greedy policy is evaluated, as it is after the last game; 0: never."""
    evaluation_games: GameCount = 100
    """Lanes of each of these evaluations, from number 500 000 on, so that those of `uavaccel evaluate` stay unseen."""
    wandb: Annotated[str, Field(min_length=1, max_length=128)] | None = None
    """Project of Weights & Biases to which the curves go, beside TensorBoard's; None: nothing is sent anywhere."""

    @model_validator(mode="after")
    def _evaluations_fit(self) -> TrainConfig:
        if self.evaluate_every_games and self.task.timing == "wall":
            raise ValueError("evaluate_every_games must be 0 with timing wall: the clock would run on meanwhile")
        return self


class TrainRow(OutcomeRow, ReturnRow):
    """The row of a game of a training; `lane` and `distance_m` where the task has them."""

    lane: NotRequired[Count]
    distance_m: NotRequired[Number]
    game: Count
    environment: Count
    exploration: NotNegative | None
    loss: Number | None
    mean_q: Number | None


class EvaluationLine(TypedDict):
    """A line of evaluations.jsonl: an evaluation of the current policy."""

    games: Count
    """Games learned from so far."""
    weights_sha256: str
    successes: Count
    lanes: list[Count]
    is_success: list[bool]
    """By lane, or game of another environment, as is `distance_m`, in metres north, or as the environment has it."""
    distance_m: NotRequired[list[Number]]


class RealTime(TypedDict):
    """What real_time.json holds: the modelled wall time of a command in real time."""

    command_s: Positive
    how: str


def completed(mapping: Mapping[str, Plain]) -> dict[str, Plain]:
    """Return a training's mapping with what follows from its environment: its algorithm, whether it is mirrored."""
    if (task := _task_of(mapping)) is None or mapping.get("env_id", LANE) == LANE:
        return dict(mapping)
    algorithm = DOUBLE_DQN if is_discrete(task) else PPO
    return {"algorithm": algorithm, "mirror": algorithm == PPO or is_symmetric(task), **mapping}


def _task_of(mapping: Mapping[str, Plain]) -> Task | None:
    """Return the task that a mapping names; None for one that validation will refuse. Raises as `check_functions`."""
    env_id, keys = mapping.get("env_id", LANE), mapping.get("task") or {}
    if not isinstance(env_id, str) or not isinstance(keys, Mapping):
        return None
    try:
        task: Task = validate(environment_class(env_id).task_class, keys, "task")
    except (UserError, AttributeError, ImportError):
        return None
    if ":" in env_id:
        check_functions(task)
    return task


def first_settings(mapping: Mapping[str, Plain]) -> dict[str, Plain]:
    """Return the mapping of a training that names no more than its task, with settings to begin with.

    Learner and network follow from actions and observations; the kernels fly it if they can.
    """
    mapping = {"games": FIRST_GAMES, **completed(mapping)}
    if (task := _task_of(mapping)) is None:
        return mapping
    numbers, over_arrays, discrete = task.observation == "state", flies_over_arrays(task), is_discrete(task)
    first: dict[str, Plain] = {"simulator": KERNELS if over_arrays else EXACT, "checkpoint_games": 500}
    first["environments"] = 32 if over_arrays and not discrete else 8
    if discrete:
        first["options"] = {"learning_rate": 1e-3, "buffer_size": 50_000}
    elif numbers:
        first["options"] = {"rollout": 32, "epochs": 5, "minibatches": 8, "learning_rate": 1e-3, "gamma": 0.97}
    return first | ({"hidden": [64, 64]} if numbers else {}) | mapping


def game_case(game: int) -> str:
    """Return the name of a game, counted from 0."""
    return f"game-{game:07d}"


class Training(Suite[TrainConfig, SimpleCase]):
    """`uavaccel train`: games flown one after another by a learner."""

    name = "train"
    config = TrainConfig
    row = TrainRow
    complete = staticmethod(completed)
    serial = "its games learn from each other; --set environments=N flies N lanes side by side, --seeds N trainings"

    def case_of(self, row: Plain) -> str:
        return game_case(row["game"])

    def check(self, config: TrainConfig) -> None:
        require("torch", "training", "learn", "PyTorch")
        check_algorithm(config)
        if config.wandb is not None:
            require("wandb", f"wandb = {config.wandb!r}", "wandb")
        if config.start_from is not None:
            first_policy(config)

    def cases(self, config: TrainConfig) -> Iterator[SimpleCase]:
        timing, typical_s = config.task.timing, config.task.typical_s
        for game in range(config.games):  # lane and environment of each come out of the training
            yield SimpleCase(game_case(game), timing, typical_s)

    def may_grow(self, folder: Path) -> Mapping[str, str]:
        """More games can be flown where there is a checkpoint to resume from."""
        if (folder / CHECKPOINTS).is_dir():
            from uavaccel.rl.learner import find_checkpoint

            if find_checkpoint(folder / CHECKPOINTS):
                return {"games": ""}
        return {"games": f"there is no checkpoint in {folder / CHECKPOINTS}"}

    def prepare(self, config: TrainConfig, run: RunDirectory) -> None:
        """Bring an unfinished training back to its last checkpoint."""
        if run.is_new():
            return  # PyTorch need not be there yet
        from uavaccel.suites.trainer import drop_games_after_checkpoint

        if trained_with(run.path).get("games") != config.games or len(run.rows()) < config.games:
            drop_games_after_checkpoint(run)

    def open(self, config: TrainConfig, timing: str, run: RunDirectory) -> AbstractContextManager[Trainer]:
        lanes = None
        if config.simulator == EXACT and timing != "wall":
            from uavaccel.rl.lanes import start_exact_lanes

            lanes = start_exact_lanes(config)
        from uavaccel.suites.trainer import open_trainer  # loads PyTorch, as they load

        return open_trainer(config, run, lanes)

    def fly(self, config: TrainConfig, case: SimpleCase, opened: Trainer) -> GameResult:
        return opened.next_game()

    def finish(self, config: TrainConfig, run: RunDirectory) -> None:
        if config.env_id != LANE:
            return  # the paper's real time is the lane's
        from uavaccel.suites.trainer import model_real_time

        run.write_json(REAL_TIME, model_real_time(config))

    def renders(self, config: TrainConfig) -> bool:
        """The kernels render without OpenGL, but evaluations during the training are flown in the exact simulator."""
        exact = config.simulator == EXACT or config.evaluate_every_games > 0
        return exact and config.task.observation != "state"

    def provenance(self, config: TrainConfig) -> Mapping[str, object]:
        """Return threads and initial weights. Raises UserError for a device that this machine does not have."""
        if config.device != "cpu":
            import torch as th

            try:
                th.zeros(1, device=config.device)
            except (RuntimeError, AssertionError) as error:
                raise UserError(f"device = {config.device!r}: {str(error).splitlines()[0]}") from error
        started = {} if config.start_from is None else {"start_from_sha256": origin_of(config.start_from).sha256()}
        return {"torch_threads": config.torch_threads, **started, **super().provenance(config)}

    def status(self, rows: Sequence[Row]) -> str:
        recent = [row["is_success"] for row in rows[-RECENT:]]
        return f"success of the last {len(recent)}: {sum(recent) / len(recent):.0%}"

    def summary(self, report: Report) -> Summary:
        """Return sums over all games, Python's, as the suite `rl` has them; evaluations; weights if it is over."""
        games, task = report.games, report.config.task
        trained, evaluated = trained_with(report.run.path), evaluations(report.run)
        over = trained.get("games") == len(games)
        summary: dict[str, Any] = {
            **disturbed_games(games),
            "suite": "train",
            **subset(vars(task), "profile", "command", "clock_speed", "timing"),
            "seed": report.config.seed,
            "games": len(games),
            "successes": sum(games.is_success.tolist()),
            "commands": sum(games.commands.tolist()),
            "sim_time_s": sum(games.sim_time_s.tolist()),
            "phase_s": {phase: sum(spent[phase] for spent in games.phase_s) for phase in PHASES},
            "weights_sha256": trained["weights_sha256"] if over else None,
        }
        if over and (report.run.path / REAL_TIME).is_file():
            modelled = report.run.read_json(REAL_TIME)
            check(RealTime, modelled, str(report.run.path / REAL_TIME))
            summary["modelled_real_time_s"] = summary["commands"] * modelled["command_s"]
            summary["modelled_real_time_how"] = modelled["how"]
        for line in evaluated:
            distance_m, won = line.get("distance_m"), Proportion(line["successes"], len(line["lanes"]))
            told: dict[str, Any] = {**won.as_summary(), "games": line["games"], "lanes": won.games}
            told["distance_m_median"] = distance_m and float(np.median(distance_m))
            summary.setdefault("evaluations", []).append(told)
        return summary

    def title(self, report: Report) -> str:
        config = report.config
        task = "" if config.env_id == LANE else f" of {config.env_id}"
        return f"Training{task}, {config.algorithm}, seed {config.seed}"

    def headline(self, report: Report) -> str:
        """Return how many games were won, and how long they would have taken in real time."""
        summary, recent = report.summary, report.games.is_success.tail(RECENT)
        said = f"{'' if summary['weights_sha256'] else 'not over yet: '}the policy won {{}} of {{}} training games"
        said = said.format(summary["successes"], summary["games"])
        said += f", {recent.mean():.0%} of the last {RECENT}" if len(report.games) > RECENT else ""
        real_time_s = summary.get("modelled_real_time_s")
        return said if real_time_s is None else f"{said}; in real time they take {in_words(real_time_s)} (modelled)"

    def source(self, report: Report) -> str:
        return source_of([timing_provenance(report.config.task.timing)], [report])

    def page(self, report: Report) -> Iterator[Block | str]:
        summary, wall_s = report.summary, cumulative_wall_s(report.timings)
        times = {"took": wall_s[-1] if wall_s else None, "modelled": summary.get("modelled_real_time_s")}
        lines = [
            ("games", str(summary["games"]), str(paper_results.TRAINING_GAMES), "counted"),
            ("wall clock", fill("{took!t}", times), "-", MEASURED),
            ("in real time", fill("{modelled!t}", times), in_words(paper_results.REAL_TIME_S), MODELLED_HERE),
        ]
        if report.config.env_id == LANE:
            yield Table(("", "this training", "the paper's", "how"), lines)
        else:  # which the paper does not train
            yield Table(("", "this training", "how"), [(name, ours, how) for name, ours, _, how in lines[:2]])
        recent = recent_mean(report.games.is_success)
        seen = f"Share of games won, of the last {RECENT}: {recent.max():.0%} at most, {recent.iloc[-1]:.0%} at the end"
        figure = curves_figure("games", [report])
        yield report.figure("learning_games", figure, OVER_GAMES, f"{seen}, over the games.")
        progress = progress_figure(report)
        names = listed(axes.get_title("left") for axes in progress.axes)
        yield report.figure("progress", progress, PROGRESS_IS, f"Points, a game each, and running means of {names}.")
        if wall_s:
            figure = curves_figure("wall clock", [report])
            yield report.figure("learning_curve", figure, OVER_TIME, f"{seen}, over the wall clock.")
        if "evaluations" in summary:
            yield Table.of(summary["evaluations"], EVALUATED)
        trainings = phase_times([report])
        shares = trainings[list(PHASES)].iloc[0] / max(trainings[list(PHASES)].sum(axis=1).iloc[0], 1e-9)
        alt = f"A bar of the training's time: {listed(f'{name} {share:.0%}' for name, share in shares.items())}."
        caption = FIGURE9.format(MODELLED if report.config.task.timing == "virtual" else BESIDE)
        yield report.figure("figure9_phases", phases_figure([report], trainings), caption, alt.replace("_", " "))
        yield summary_table(summary)

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        """Draw the learning curves and Figure 9 of several trainings into the first one's folder."""
        reports = [self.report(run) for run in runs]
        with style.project_style():
            figures = {
                "figure9_phases_compared": phases_figure(reports, phase_times(reports)),
                "learning_curves_compared": curves_figure("wall clock", reports),
                "learning_games_compared": curves_figure("games", reports),
            }
        return [style.save(figure, runs[0].file(f"figures/{name}.png")) for name, figure in figures.items()]


def evaluations(run: RunDirectory) -> list[EvaluationLine]:
    """Return the lines of evaluations.jsonl, in order. Raises UserError, naming the line, for one of another form."""

    def of_its_lanes(line: EvaluationLine) -> EvaluationLine:
        lanes = len(line["lanes"])
        if not lanes or {len(line["is_success"]), len(line.get("distance_m", line["lanes"]))} != {lanes}:
            raise ValueError("lanes, is_success and distance_m should have one entry for each lane")
        if line["successes"] != sum(line["is_success"]):
            raise ValueError("successes should be the number of lanes won")
        return line

    lines: list[EvaluationLine] = read_lines(run.path / EVALUATIONS)
    check_all(Annotated[EvaluationLine, AfterValidator(of_its_lanes)], lines, run.path / EVALUATIONS)
    return lines


def wall_times(report: Report) -> list[float]:
    """Return the wall time in seconds up to the end of each game, over all starts. Raises UserError where it lacks."""
    wall_s = cumulative_wall_s(report.timings)
    if len(wall_s) < len(report.games):
        raise UserError(f"{report.run.path / 'timing.jsonl'}: lacks the wall time of a game")
    return wall_s


# --- figures ------------------------------------------------------------------------------------------------------


def _label(report: Report) -> str:
    return f"{command_name(report.config.task.command)} {clock_label(report.config.task.clock_speed)}"


def recent_mean(values: pd.Series) -> pd.Series:
    """Return, after each game, the mean of a value over the last RECENT games, or all so far."""
    return values.astype(float).rolling(RECENT, min_periods=1).mean()


def curves_figure(over: Literal["games", "wall clock"], reports: Sequence[Report], names: Sequence[str] = ()) -> Figure:
    """Draw success of the last RECENT games over the games, or over the wall clock of all starts, and evaluations.

    Of several trainings return and length are drawn below. Those that differ in their seed alone, or have one of the
    `names`, are their mean in the band of their range. Up to RECENT games, where a training has no more, its share is
    that of all games so far. Raises UserError for a run without wall times.
    """
    alike: dict[str, list[Report]] = {}
    keys = names or [report.config.model_dump_json(exclude={"seed"}) for report in reports]
    for key, report in zip(keys, reports, strict=True):
        alike.setdefault(key, []).append(report)
    several, by_games = len(reports) > 1, over == "games"
    shown = CURVES if several else {"is_success": CURVES["is_success"]}
    title = f"{'Success, return and length' if several else 'Success'} over the {over}"
    told = [timing_provenance(report.config.task.timing) if by_games else MEASURED for report in reports]
    source, height_in = (source_of(told, reports), 2.2) if several else ("", 3.0)
    figure, panels = plots.panels(len(shown), title, height_in, across=1, source=source, sharex=True)
    last_s = 0.0
    for number, (key, group) in enumerate(alike.items()):
        more = f" and {counted(len(group) - 1, 'more seed')}: {OVER_SEEDS}" if len(group) > 1 else ""
        label = key if names else f"{_label(group[0])}, {group[0].run.path.name}{more}"
        colour = style.colour(number) if several else style.COMMAND_COLOUR[group[0].config.task.command]
        every = [list(range(1, len(report.games) + 1)) if by_games else wall_times(report) for report in group]
        last_s = max(last_s, *(ends[-1] for ends in every))
        for axes, name in zip(panels, shown, strict=True):
            means = [
                recent_mean(report.games[name]).set_axis(ends[: len(report.games)])
                for report, ends in zip(group, every, strict=True)
            ]
            curves = [mean[RECENT - 1 if len(mean) > RECENT else 0 :] for mean in means]
            draw_mean(axes, curves, color=colour, **({"label": label} if axes is panels[0] else {}))
        draw_evaluated(panels[0], group, every, colour)
    if by_games:
        panels[0].set_xlim(left=0)
    else:
        time_axis(panels, last_s)
    for axes, label in zip(panels, shown.values(), strict=True):
        axes.set_ylabel(label)
    panels[0].set_ylim(-0.02, 1.02)  # so that a line at 0 is seen
    panels[0].yaxis.set_major_formatter("{x:.0%}")
    panels[-1].set_xlabel("games" if by_games else "wall clock since the first command")
    plots.label_outer(panels)
    style.legend(figure)
    return figure


def time_axis(panels: Sequence[Axes], longest_s: float) -> None:
    """Make the shared axis that of seconds up to the end of the longest training, with the paper's real time."""
    paper_s, places = paper_results.REAL_TIME_S, np.concatenate([line.get_xdata() for line in panels[0].lines])
    if FAR * longest_s >= paper_s:
        longest_s = max(longest_s, paper_s)
        panels[0].axvline(paper_s, color=style.BLACK, linewidth=1.2, linestyle="--")
        panels[0].text(0.93 * paper_s, 0.5, PAPER, rotation=90, ha="right", va="center")
    low_s = max(min(0.5 * places.min(), longest_s / 30), 0.01)
    for axes in panels:
        axes.set_xscale("log")
        axes.set_xticks(list(TICKS_S.values()), list(TICKS_S))
        axes.set_xlim(low_s, 2.0 * longest_s)
        axes.minorticks_off()


def draw_evaluated(axes: Axes, reports: Sequence[Report], every: Sequence[Sequence[float]], colour: str) -> None:
    """Draw evaluations at the `every` game's places: of one seed with intervals, of several the mean in their range."""
    seeds = []
    for report, ends in zip(reports, every, strict=True):
        if flown := [line for line in evaluations(report.run) if line["games"] <= len(report.games)]:
            success = [Proportion(line["successes"], len(line["lanes"])) for line in flown]
            seeds.append(pd.Series(success, [ends[line["games"] - 1] for line in flown], dtype=object))
    ratios = [seed.map(lambda success: success.ratio) for seed in seeds]
    lanes = f"evaluated on {counted(seeds[0].iloc[0].games, 'lane')}" if seeds else ""
    line = {"color": colour, "linestyle": "--", "marker": "o", "markersize": 4}
    if len(seeds) == 1:
        line |= {"linewidth": 1.0, "label": f"{lanes}, 95 % Wilson interval"}
        low, high = zip(*(success.interval for success in seeds[0]), strict=True)
        plots.line(axes, seeds[0].index, ratios[0], (low, high), **line)
    elif seeds:
        draw_mean(axes, ratios, label=f"{lanes}: {OVER_SEEDS} of {len(seeds)} seeds", **line)


def draw_mean(axes: Axes, curves: Sequence[pd.Series], **look: Any) -> None:
    """Draw the mean of curves, where all have values, in the band of their range; where none does, ends are held."""
    first, last = max(curve.index[0] for curve in curves), min(curve.index[-1] for curve in curves)
    places = np.unique(np.concatenate([curve.index for curve in curves]))
    at = places[(places >= first) & (places <= last)] if first <= last else places
    values = np.array([np.interp(at, curve.index, curve.astype(float)) for curve in curves])
    plots.band(axes, at, values.mean(axis=0), values.min(axis=0), values.max(axis=0), **look)


def progress_figure(report: Report) -> Figure:
    """Draw what the algorithm has of PROGRESS over the games: points are games, lines means of the last RECENT."""
    games = report.games.reindex(columns=list(PROGRESS)).astype(float).set_axis(range(1, len(report.games) + 1))
    games, colour = games.loc[:, np.isfinite(games).any()], style.COMMAND_COLOUR[report.config.task.command]
    figure, grid = plots.panels(games.shape[1], "Progress of the training", 1.5, across=2)
    for axes, (name, values) in zip(grid, games.items(), strict=True):
        axes.set_title(PROGRESS[str(name)], loc="left")
        axes.set(xlabel="games", xlim=(0, len(games) + 1))
        if name == "exploration":
            axes.plot(values, color=colour)
            axes.set_ylim(-0.02, 1.02)
        else:
            axes.plot(values, ".", color=style.GREY, markersize=2.5, label="a game")
            axes.plot(recent_mean(values.dropna()), color=colour, label=f"mean of the last {RECENT}")
    style.legend(figure)
    return figure


def phase_times(reports: Sequence[Report]) -> pd.DataFrame:
    """Return the seconds of each training by phase, summed over its lanes, and its `speed`, by its label.

    They are of its simulated clock if it has one, else of the machine's.
    """
    trainings = {}
    labels = [f"{_label(report)}\n{report.config.task.timing}, seed {report.config.seed}" for report in reports]
    for report, label in zip(reports, labels, strict=True):
        if report.config.task.timing == "virtual":
            phase_s = report.summary["phase_s"]
            wall_s = sum(phase_s.values()) / report.config.environments
        else:
            if any(not {"wall_s", "learner_s", "host_phase_s"} <= entry.keys() for entry in report.timings):
                raise UserError(f"{report.run.path / 'timing.jsonl'}: has not the times of every game of a training")
            learned_s = over_all_starts([entry["learner_s"] for entry in report.timings])
            flown_s = pd.DataFrame([entry["host_phase_s"] for entry in report.timings]).sum()
            phase_s = {phase: learned_s[phase] + flown_s.get(phase, 0.0) for phase in PHASES}
            wall_s = wall_times(report)[-1]
        label += f"\n{report.run.path}" if labels.count(label) > 1 else ""
        trainings[label] = subset(phase_s, *PHASES) | {"speed": report.summary["sim_time_s"] / wall_s}
    return pd.DataFrame.from_dict(trainings, orient="index")


def phases_figure(reports: Sequence[Report], trainings: pd.DataFrame) -> Figure:
    """Draw Figure 9: a bar of stacked phases per training, with the simulated seconds that a wall second brought."""
    clocks = {MODELLED if report.config.task.timing == "virtual" else BESIDE for report in reports}
    games, phases = listed(sorted({len(report.games) for report in reports})), trainings[list(PHASES)]
    how = f"{' and '.join(sorted(clocks))} · {counted(games, 'game')}"
    told = source_of([how], reports) if len(reports) > 1 else ""
    height_in = 0.6 + 0.55 * len(trainings)
    figure, [axes] = plots.panels(1, "Time of training by phase", height_in, source=told)
    notes = [f"{speed:.3g} simulated s\na wall s" for speed in trainings.speed]
    plots.phases(axes, phases, plots.time_unit(phases.sum(axis=1).max()), notes)
    style.legend(figure)
    return figure


PAPER = "paper: 5 000 games in real time, 182 h"  # section IV-D: a week, 14 hours
OVER_SEEDS = "mean, least and most"
FAR = 30.0  # times the longest training: a mark beyond it would squeeze the curves
MODELLED_HERE = "ours modelled, the paper's measured"
MEASURED, BESIDE, MODELLED = "measured, start-up not counted", "measured, learning beside the flight", "modelled"
TICKS_S = {"10 ms": 0.01, "100 ms": 0.1, "1 s": 1.0, "10 s": 10.0, "1 min": 60.0, "10 min": 600.0} | {
    f"{hours} h": 3600.0 * hours for hours in (1, 10, 100)
}
CURVES = {
    "is_success": f"games won, of the last {RECENT}",
    "return": f"return, mean of {RECENT}",
    "commands": f"length, mean of {RECENT}",
}
PROGRESS = {
    "return": "return",
    "commands": "length, commands",
    "loss": "loss",
    "mean_q": "mean Q",
    "exploration": "random actions (ε)",
}
EVALUATED: dict[str, Column] = {
    "games learned from": "{games}",
    "success on evaluation lanes [95 %]": lambda line: Proportion(line["successes"], line["lanes"]).text(),
    "lanes": "{lanes}",
    "median distance, m": "{distance_m_median:.1f}",
}
OVER_GAMES = "Success over the games: the share won of the last 100, or of all so far."
PROGRESS_IS = (
    "Return and length of each game, loss and mean Q of the gradient steps before its end, and the share of random "
    "actions; lines are means of the last 100 games."
)
OVER_TIME = (
    "The same over the wall clock, measured; a dashed line, unless it is far beyond, is the paper's training in real "
    "time."
)
FIGURE9 = "Figure 9. Time of the training by phase, {}."
