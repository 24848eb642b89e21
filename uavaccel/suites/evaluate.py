"""The suite `evaluate`: an agent flies lanes that no training has seen, the same ones for every agent (paper, IV-D)."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import reduce
from operator import add
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, NotRequired, Protocol, cast

import numpy as np
import pandas as pd
from pydantic import Field, model_validator
from typing_extensions import TypedDict

from uavaccel.config import Cost, Games, KeyTree, Processes
from uavaccel.draw import style
from uavaccel.draw.page import Block, Heading, Movie, Table, command_at_clock, command_name, counted, listed
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.simulators import (
    CUDA,
    EXACT,
    KERNELS,
    Device,
    Simulator,
    check_flyable,
    check_names,
    check_simulator,
    flown_by,
)
from uavaccel.envs.values import Action, Info, Observation
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.forms import Count, NotNegative, Number
from uavaccel.metrics.estimates import Success
from uavaccel.metrics.intervals import Proportion, mcnemar_exact
from uavaccel.own_code import name_beside
from uavaccel.realtime.server import begin
from uavaccel.records import RunDirectory, timing_provenance
from uavaccel.resources import require
from uavaccel.rl.agents import (
    DEFAULT,
    Agent,
    OwnFunction,
    agent_name,
    evaluation_keys,
    make_agent,
    origin_of,
    reset_options,
)
from uavaccel.rl.config import ENVIRONMENTS, LANE, AnyTask, EnvId, environment_class, keys_with_task
from uavaccel.sim.lane import LENGTH_M, SPLIT_SIZE, WIDTH_M
from uavaccel.suites import paper_results, plots
from uavaccel.suites.experiment import Experiment, LaneRow, OutcomeRow, ReturnRow, Row, game_row, number_of, subset
from uavaccel.suites.flight import Flight
from uavaccel.suites.report import Report, disturbed_games, source_of, summary_table
from uavaccel.suites.suite import GameResult, SimpleCase, Suite
from uavaccel.wire.image_api import lane_layout

if TYPE_CHECKING:  # matplotlib is loaded by what draws
    from matplotlib.figure import Figure

    from uavaccel.envs.flight_env import FlightEnv

MOST_PANELS = 9
AHEAD_M = 10.0  # of the farthest end, shown on the map
COMPARISON = "figures/figure8_survival_compared.png"
HOW_LOST = {"ended by": "{end}", "commands": "{commands}", "seen with": "--case {case}"}
SEEN = "Each is flown again and filmed by `uavaccel watch RUN --film FILE` with the option in its line of the table."


class EvaluateConfig(Experiment):
    """`suite: evaluate`."""

    suite: Literal["evaluate"] = "evaluate"
    agent: str = DEFAULT
    """Folder of a policy (a training's run directory), `default` (the policy that ships), a .zip of stable-baselines3,
    an .onnx file, a function as file.py:function, or a baseline in the lane: straight, offset:METRES."""
    games: Games = 300
    """How many evaluation lanes, or games of another environment, are flown."""
    first_lane: Annotated[int, Field(ge=0)] = 0
    """The number of the first evaluation lane, or of the first game."""
    environments: Processes = 1
    """Lanes flown in parallel, by several processes; 1 with wall. It does not change the rows."""
    simulator: Simulator = "mujoco"
    """mujoco: exact, rendered with OpenGL; kernels: all lanes as one batch of arrays (docs/kernels.md)."""
    device: Device = "cpu"
    """Where the kernels run: cpu, in threads, or cuda, on one GPU."""
    inference_s: Cost = 0.0005
    """Time of a decision on the simulated wall clock of `virtual`."""
    env_id: EnvId = LANE
    """The environment, by default that of the agent's training, or else the obstacle lane."""
    task: AnyTask = LaneTask(split="evaluation", timing="virtual")
    """Omitted keys are those of the agent's training; those that its network cannot take are refused."""

    @property
    def environment_class(self) -> type[FlightEnv[Any]]:
        """The class of the environment."""
        return environment_class(self.env_id)

    @classmethod
    def keys_of(cls, mapping: Mapping[str, Any]) -> KeyTree:
        """Return its keys with those of the environment's task."""
        return keys_with_task(super().keys_of(mapping), mapping)

    @model_validator(mode="after")
    def _fits(self) -> EvaluateConfig:
        if self.first_lane + self.games > SPLIT_SIZE:
            raise ValueError(
                f"first_lane = {self.first_lane} and games = {self.games}: lanes are 0 to {SPLIT_SIZE - 1}"
            )
        if self.simulator == KERNELS and self.environments > 1:
            raise ValueError("environments needs simulator mujoco: the kernels fly all lanes as one batch")
        if self.task.timing == "wall" and self.environments > 1:
            raise ValueError("environments must be 1 with timing wall: neighbours would disturb the clock")
        return self


def completed(mapping: Mapping[str, Plain]) -> dict[str, Plain]:
    """Return the mapping completed by the keys of its agent's training. Raises UserError if there is no such agent."""
    agent, given = mapping.get("agent", DEFAULT), mapping.get("task") or {}
    if not isinstance(agent, str) or not isinstance(given, Mapping):
        return dict(mapping)  # which validation refuses
    agent = name_beside(agent)
    origin = origin_of(agent)
    env_id = mapping.get("env_id", origin.env_id or LANE)
    if origin.env_id not in (None, env_id):
        raise UserError(f"env_id = {env_id!r}: {agent} flies {origin.env_id}; omit the key, and the task's name")
    if not isinstance(env_id, str) or (env_id not in ENVIRONMENTS and ":" not in env_id):
        return dict(mapping)
    flown = {**origin.keys(), **evaluation_keys(env_id), "timing": "virtual", **given}
    return {**mapping, "env_id": env_id, "agent": agent, "task": flown}


class Evaluated(TypedDict):
    """What every row of an evaluation has beside the keys of a game."""

    wall_s: NotNegative
    actions: list[Count] | list[list[Number]]
    path_m: NotRequired[list[Annotated[list[Number], Field(min_length=2, max_length=2)]]]
    """Of a game lost in the exact simulator: positions north and east at the ends of the commands."""


class EvaluateRow(LaneRow, Evaluated):
    """The row of a game in the obstacle lane."""


class OtherRow(OutcomeRow, Evaluated, ReturnRow):
    """The row of a game in another environment: its number, from which its seed follows, and the sum of its rewards."""

    game: Count
    distance_m: NotRequired[Number]
    """As the environment's info has it; not in all of them."""


AnyRow = EvaluateRow | OtherRow


@dataclass(frozen=True)
class Game(SimpleCase):
    """The game on an evaluation lane, or the game of that number in another environment."""

    lane: int


class Evaluation(Suite[EvaluateConfig, Game]):
    """`uavaccel evaluate`."""

    name = "evaluate"
    config = EvaluateConfig
    row = AnyRow
    grows = ("games",)
    complete = staticmethod(completed)

    def case_of(self, row: Plain) -> str:
        return case_of(number_of(row), "lane" in row)

    def check(self, config: EvaluateConfig) -> None:
        require("torch", "evaluation", "learn", "PyTorch")
        origin = origin_of(config.agent)
        origin.check(config.task)
        check_names(config.simulator, config.device)
        if config.device == CUDA and isinstance(origin, OwnFunction):
            raise UserError(f"device = cuda: {config.agent} decides game by game, on the CPU: take device = cpu")
        if config.simulator == KERNELS:
            check_flyable(config.task, 1, config.device)

    def cases(self, config: EvaluateConfig) -> Iterator[Game]:
        timing, typical_s = config.task.timing, config.task.typical_s
        for lane in range(config.first_lane, config.first_lane + config.games):
            yield Game(case_of(lane, config.env_id == LANE), timing, typical_s, lane)

    @contextmanager
    def open(self, config: EvaluateConfig, timing: str, run: RunDirectory) -> Iterator[Callable[[int], GameResult]]:
        """Yield a function that flies the game on a lane, in one environment or in a batch."""
        from uavaccel.suites.evaluate_lanes import GamesInBatch

        if self.why_serial(config):
            done = run.done_cases()
            left = [case.lane for case in self.cases(config) if case.id not in done]
            with closing(GamesInBatch(config, left)) as batch:
                yield batch.game
            return
        import torch as th

        th.set_num_threads(1)
        with closing(config.environment_class(**config.task.model_dump(mode="json"))) as environment:
            agent = agent_of(config)
            yield lambda lane: GameResult(fly_game(config, environment, agent, lane))

    def fly(self, config: EvaluateConfig, case: Game, opened: Callable[[int], GameResult]) -> GameResult:
        return opened(case.lane)

    def why_serial(self, config: EvaluateConfig) -> str:
        """A batch has processes or threads of its own."""
        if config.simulator == KERNELS:
            return "simulator = kernels flies all lanes as one batch"
        many = config.environments
        return f"environments = {many} flies in processes of its own" if many > 1 else ""

    def renders(self, config: EvaluateConfig) -> bool:
        return config.task.observation != "state" and config.simulator != KERNELS

    def provenance(self, config: EvaluateConfig) -> Mapping[str, object]:
        """Return the policy's hash and the simulator.

        Raises UserError for unreadable weights, a missing device, and an agent that remembers where lanes are a batch.
        """
        check_simulator(config.simulator, config.device)
        agent_of(config)  # the weights too: nothing is written yet
        by = {"simulator": config.simulator, "device": config.device, **super().provenance(config)}
        return {"policy_sha256": origin_of(config.agent).sha256(), **by}

    def status(self, rows: Sequence[Row]) -> str:
        return f"success {sum(row['is_success'] for row in rows) / len(rows):.0%}"

    def interest(self, row: Row) -> tuple[bool, float]:
        """From the success in the fewest commands to the failure with the least distance, or with the least return."""
        lost_after = row["distance_m"] if "lane" in row else row.get("return", 0.0)
        return not row["is_success"], row["commands"] if row["is_success"] else -lost_after

    def flight(
        self, report: Report, game: Mapping[str, Any], pictures: bool = True, event_rate_hz: float | None = None
    ) -> Flight:
        """Fly the game again by the actions of its row; it has to make the same row.

        What does not repeat, of kernels or the wall clock, its agent flies once more in the exact simulator, and
        the title says so. Raises UserError.
        """
        from uavaccel.suites.evaluate_again import flight_again

        return flight_again(report.run, report.config, game, pictures, event_rate_hz)

    def summary(self, report: Report) -> dict[str, Any]:
        """Return the success ratio with its 95 % Wilson interval, and the distances or the returns."""
        games, config, task = report.games, report.config, report.config.task
        sim_time_s, wall_s = float(games.sim_time_s.sum()), float(games.wall_s.sum())
        return {
            **disturbed_games(games),
            "suite": "evaluate",
            "agent": config.agent,
            **({} if config.env_id == LANE else {"env_id": config.env_id}),
            **subset(vars(task), "profile", "command", "clock_speed", "timing"),
            "simulator": config.simulator,
            **({} if config.simulator == EXACT else {"device": config.device}),
            "seed": config.seed,
            **Proportion(int(games.is_success.sum()), len(games)).as_summary(),
            "sim_time_s": sim_time_s,
            "wall_s": wall_s,
            "simulated_s_per_wall_s": sim_time_s / wall_s,
            **({"distance_m_median": float(games.distance_m.median())} if "distance_m" in games else {}),
            **({"return_mean": float(games["return"].mean())} if "return" in games else {}),
        }

    def title(self, report: Report) -> str:
        return f"Evaluation of {report.config.agent}"

    def headline(self, report: Report) -> str:
        """Return the success with its interval, and what was flown, in a sentence."""
        summary, flown = report.summary, "lanes" if report.config.env_id == LANE else "games"
        flown = f"test {flown}" if getattr(report.config.task, "split", None) == "test" else flown
        mean = ", mean return {return_mean:.4g}" if "return_mean" in summary else ""
        return (
            f"{agent_name(summary['agent'])} wins {{successes}} of {{games}} {flown} with {command_at_clock(summary)} "
            f"({{success_ratio:.1%}}, 95 % Wilson interval {{wilson_low:.1%}} to {{wilson_high:.1%}}){mean}"
        ).format_map(summary)

    def source(self, report: Report) -> str:
        return source([report])

    def page(self, report: Report) -> Iterator[Block | str]:
        """Yield the success, in the lane beside the paper's, with Figure 8; the games that were lost; the films."""
        config, run, games, in_lane = report.config, report.run, report.games, report.config.env_id == LANE
        said = agent_name(config.agent), Proportion.of(report.summary).text()
        if in_lane:
            rows = [(*said, str(len(games)), how_flown(config))]
            for command, by_clock in paper_results.SUCCESSES.items():
                theirs = Proportion(max(by_clock.values()), paper_results.GAMES).text()
                best = f"the paper's best, trained with {command_name(command)}"
                rows.append((best, theirs, str(paper_results.GAMES), "measured, in AirSim and another lane"))
            yield Table(("", "success [95 %]", "lanes", "how"), rows)
            caption = "Figure 8. Share of the games that got at least so far north, with its 95 % Wilson interval."
            shares = listed(f"{(games.distance_m >= at_m).mean():.0%} got {at_m} m" for at_m in (50, 100, 150))
            alt = f"A falling curve of the share of games by distance north: {shares} far."
            yield report.figure("figure8_survival", survival_figure([report]), caption, alt)
        else:
            row = (*said, f"{report.summary['return_mean']:.4g}", str(len(games)), how_flown(config))
            yield Table(("", "success [95 %]", "mean return", "games", "how"), [row])
        measure = "distance_m" if in_lane else "return"
        if len(lost := games[~games.is_success].sort_values(measure, kind="stable")):
            yield from lost_games(report, lost)
        films = {name: (run.path / f"films/{name}.mp4", run.path / f"films/{name}.png") for name in ("best", "worst")}
        made = {name: both for name, both in films.items() if all(path.is_file() for path in both)}
        if made:
            yield Heading("Films")
        for name, both in made.items():
            yield Movie(*both, f"The {name} game. On paper: moments of it, camera above events.")
        yield summary_table(report.summary)

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        by_environment: dict[str, list[Report]] = {}
        for report in (Report(run, self) for run in runs):
            by_environment.setdefault(report.config.env_id, []).append(report)
        several = [reports for reports in by_environment.values() if len(reports) > 1]
        with style.project_style():
            return [style.save(survival_figure(reports), reports[0].run.file(COMPARISON)) for reports in several]


# --- a game -----------------------------------------------------------------------------------------------------


class Flyable(Protocol):
    """What of an environment a game needs."""

    def reset(self, *, seed: int, options: dict[str, Any]) -> tuple[Observation, Info]: ...
    def charge(self, duration_s: float) -> None: ...
    def step(self, action: Any) -> tuple[Observation, float, bool, bool, Info]: ...
    def close(self) -> None: ...


class Step(NamedTuple):
    """One command: the observation that it was decided on, and what Gymnasium's `step` returned."""

    given: Observation
    action: Action
    observation: Observation
    reward: float
    terminated: bool
    truncated: bool
    info: Info


def fly_lane(config: EvaluateConfig, environment: Flyable, agent: Agent, lane: int) -> Iterator[Step]:
    """Fly a game, and yield its commands; equal seed and lane give equal games."""
    seed = game_seed(config, lane)
    observation, info = environment.reset(seed=seed, options=reset_options(config.env_id, lane))
    begin(agent, seed)
    over = False
    while not over:
        environment.charge(config.inference_s)
        action = agent.act(observation, info)
        step = Step(observation, action, *environment.step(action))
        observation, info, over = step.observation, step.info, step.terminated or step.truncated
        yield step


def agent_of(config: EvaluateConfig) -> Agent:
    """Make the agent. Raises UserError for unreadable weights, and for one that remembers where lanes are a batch."""
    agent = make_agent(config.agent, config.task)
    if config.simulator == KERNELS and getattr(agent, "remembers", False):
        raise UserError(f"simulator = kernels: {config.agent} has a reset, for a game at a time: take mujoco")
    return agent


def fly_game(config: EvaluateConfig, environment: Flyable, agent: Agent, lane: int) -> AnyRow:
    """Fly a game, and return its row."""
    steps = list(fly_lane(config, environment, agent, lane))
    path_m = [step.info["position_m"][:2] for step in steps]
    return row_of(config, lane, ended(steps) | {"path_m": path_m}, [step.action for step in steps])


def ended(steps: Sequence[Step]) -> Info:
    """Return the info of a game's last step, with the sum of its rewards."""
    return steps[-1].info | {"return": reduce(add, (float(step.reward) for step in steps))}  # as batches add them up


def row_of(config: EvaluateConfig, lane: int, ended: Info, actions: Sequence[Action]) -> AnyRow:
    """Return a game's row from the info of its last step with its `return`; its path may have been added."""
    in_lane = config.env_id == LANE
    number = {"lane" if in_lane else "game": lane}
    row: Plain = game_row("evaluate", case_of(lane, in_lane), ended | number, config.task.t_move_s)
    row |= number | {
        key: ended[key] for key in (("distance_m",) if in_lane else ("distance_m", "return")) if key in ended
    }
    row |= {"actions": np.asarray(actions).tolist(), "wall_s": ended["wall_s"]}
    if not row["is_success"] and "path_m" in ended:
        row["path_m"] = ended["path_m"]
    if config.simulator != EXACT:
        row["simulator"] = config.simulator
    return cast(AnyRow, row)


def game_seed(config: EvaluateConfig, lane: int) -> int:
    """Return the seed of the game on a lane."""
    return int(np.random.SeedSequence([config.seed, lane]).generate_state(1)[0])


def case_of(number: int, in_lane: bool = True) -> str:
    """Return the name of the game on an evaluation lane, or of that number in another environment."""
    return f"{'lane' if in_lane else 'game'}-{number:06d}"


# --- what its report says ---------------------------------------------------------------------------------------


def worlds_of(config: Mapping[str, Any]) -> tuple[str, str | None]:
    """Return the environment of an evaluation, and the split that its lanes are of; None where there are no splits."""
    return config.get("env_id", LANE), (config.get("task") or {}).get("split")


def outcomes_of(other: RunDirectory, config: Mapping[str, Any], cases: Container[str]) -> dict[str, bool]:
    """Return whether another evaluation won the games of these cases. Raises UserError where it flew no such games."""
    rows = [row for row in other.rows() if row.get("suite") == "evaluate" and row["case"] in cases]
    if not rows or worlds_of(other.config()) != worlds_of(config):
        games = "lanes" if worlds_of(config)[0] == LANE else "games"
        raise UserError(f"--against {other.path}: is no evaluation of the same {games}")
    return {row["case"]: row["is_success"] for row in rows}


def against(run: RunDirectory, other: RunDirectory) -> str:
    """Return in words the paired difference on the games that both evaluations flew. Raises as `outcomes_of`."""
    won, config = {row["case"]: row["is_success"] for row in run.rows()}, run.config()
    theirs = outcomes_of(other, config, won)
    first, second = [won[case] for case in theirs], list(theirs.values())
    paired = Success.on_lanes([first]).difference(Success.on_lanes([second]))
    points = "{:+.1f} [{:+.1f}, {:+.1f}]".format(*(100 * each for each in paired))
    flown = counted(len(theirs), "lane" if worlds_of(config)[0] == LANE else "game")
    return (
        f"against {other.path} on the same {flown}: "
        f"{sum(first)} v {sum(second)} successes, {points} points, "
        f"exact McNemar p = {mcnemar_exact(first, second).p_value:.3g}"
    )


def how_flown(config: EvaluateConfig) -> str:
    """Return "measured" or "modelled", and the simulator unless that is the exact one."""
    by = flown_by(config.simulator, config.device)
    return ", ".join([timing_provenance(config.task.timing), *filter(None, [by])])


def source(reports: Sequence[Report]) -> str:
    """Return where the numbers of these evaluations come from."""
    how = " and ".join(sorted({how_flown(report.config) for report in reports}))
    games = counted(listed(sorted({len(report.games) for report in reports})), "game")
    return source_of([f"{how} · {games} each"], reports)


def survival_figure(reports: Sequence[Report]) -> Figure:
    """Plot the share of games that reached each distance, a line per evaluation in its 95 % Wilson interval.

    Outside of the lane it is the share that reached each return.
    """
    alone, in_lane = len(reports) == 1, reports[0].config.env_id == LANE
    title, measure = ("Distance travelled", "distance_m") if in_lane else ("Return", "return")
    figure, [axes] = plots.panels(1, title, 3.2, source="" if alone else source(reports))
    configs = [report.config for report in reports]
    flown = [(agent_name(config.agent), flown_by(config.simulator, config.device)) for config in configs]
    names = [", ".join(filter(None, by)) for by in flown]
    for number, (report, name) in enumerate(zip(reports, names, strict=True)):
        label = name if names.count(name) == 1 else f"{name} ({report.run.path})"  # folders may share their last name
        colour = style.COMMAND_COLOUR[report.config.task.command] if alone else style.colour(number)
        places, share = style.survival(report.games[measure], LENGTH_M if in_lane else math.inf)
        if not in_lane:
            places[0] = places[1]
        won = [Proportion(left, len(places) - 1) for left in range(len(places) - 1, -1, -1)]
        low, high = zip(*(each.interval for each in won), strict=True)
        plots.band(axes, places, share, low, high, step=True, label=label, color=colour)
    if in_lane:
        axes.axvline(LENGTH_M, **style.LIMIT, label="end of the lane")
    axes.set(xlabel="distance north, m" if in_lane else "return", ylim=(0.0, 1.05))
    axes.set_ylabel("share of games that got there")
    style.legend(figure)
    return figure


def lost_games(report: Report, lost: pd.DataFrame) -> Iterator[Block | str]:
    """Yield the games that were not won, what ended them, and their paths in the lane, the shortest flight first.

    The kernels record no path, and of a lane that is sampled anew with each game's conditions none is known.
    """
    task, in_lane, hit = report.config.task, report.config.env_id == LANE, "hitting " + lost.collision.astype(str)
    no_more = lost.commands >= (0 if in_lane else task.max_commands)  # a lane is lost in no other way
    lost = lost.assign(end=hit.where(lost.collision.notna(), np.where(no_more, "running out of commands", "failing")))
    if not in_lane:
        yield Heading("Lost games")
        yield f"The least return first. {SEEN}"
        yield Table.of(lost, {"game": "{game}", "return": "{return:.4g}", **HOW_LOST})
        return
    named = [f"{row.lane} ({row.distance_m:.1f} m, {row.end})" for row in lost.head(MOST_PANELS).itertuples()]
    more = [f"and {len(lost) - len(named)} more"] if len(lost) > len(named) else []
    yield Heading("Lost lanes")
    yield f"Lost, the shortest flight first: lane{'s' * (len(lost) > 1)} {', '.join([*named, *more])}. {SEEN}"
    drawn = lost[lost.path_m.notna()] if "path_m" in lost else lost.head(0)
    if len(drawn) and task.randomise is None:
        beyond = len(drawn) - MOST_PANELS
        more_below = f" {beyond} more in the table below." if beyond > 0 else ""
        caption = f"Paths of the lost lanes, from above, by the positions at the ends of the commands.{more_below}"
        figure = lost_figure(report, drawn.head(MOST_PANELS))
        alt = f"Lanes from above with obstacles and the path flown: {', '.join(named)}."
        yield report.figure("lost_lanes", figure, caption, alt)
    columns = {"lane": "{lane}", "distance, m": "{distance_m:.1f}", **HOW_LOST}
    yield Table.of(lost, columns, folded=counted(len(lost), "lost lane"))


def lost_figure(report: Report, lost: pd.DataFrame) -> Figure:
    """Draw lost lanes with their paths from above, a panel each, the west on top: to the left of the flight."""
    from matplotlib.patches import Circle, Rectangle

    colour = style.COMMAND_COLOUR[report.config.task.command]
    figure, panels = plots.panels(len(lost), "Lost lanes", 0.85, across=1, sharex=True)
    for axes, row in zip(panels, lost.itertuples(), strict=True):
        for edge in (-WIDTH_M / 2, WIDTH_M / 2):
            axes.axhline(edge, color=style.GREY, linewidth=2)
        axes.axvline(LENGTH_M, color=style.GREEN, linewidth=2)
        lane = lane_layout(report.config.task.wire_lane(row.lane))
        for x, y, half, is_round in zip(lane.x_m, lane.y_m, lane.half_width_m, lane.round, strict=True):
            shape = Circle((x, y), half) if is_round else Rectangle((x - half, y - half), 2 * half, 2 * half)
            shape.set(facecolor="#444444", linewidth=0)
            axes.add_patch(shape)
        axes.set(ylim=(WIDTH_M / 2, -WIDTH_M / 2), yticks=[])
        axes.grid(visible=False)
        north, east = zip((0.0, 0.0), *row.path_m, strict=True)
        axes.plot(north, east, color=colour, marker=".", markersize=3)
        axes.plot(north[-1], east[-1], "x", color=style.BLACK, markersize=8, markeredgewidth=2)
        axes.set_title(f"lane {row.lane}: {row.distance_m:.1f} m, {row.end}", fontsize=9)
    panels[-1].set_xlim(-2.0, min(max(float(lost.distance_m.max()), 0.0) + AHEAD_M, LENGTH_M + 2.0))
    panels[-1].set_xlabel("north, m; across, the 10 m between the walls are not to that scale")
    return figure
