"""An evaluation's game flown once more, by the actions of its row, to see what no run keeps.

In `virtual` and `lockstep` a game repeats to the byte. The row that the second flight makes has to equal the recorded
one; another version of the simulator, or another policy's row, is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.config import validate
from uavaccel.draw.labels import command_at_clock
from uavaccel.draw.panels import Decisions
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.observer import Onlooker, SecondEventCamera
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.simulators import EXACT, KERNELS
from uavaccel.envs.values import Action, Frame, Info
from uavaccel.errors import UserError
from uavaccel.files import parse_json, to_json
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import Agent, PolicyAgent, is_baseline, make_agent, policy_sha256
from uavaccel.sim.profile import PROFILES
from uavaccel.suites.evaluate import EvaluateConfig, Flyable, Step, fly_lane, row_of
from uavaccel.suites.flight import Commands, Flight, Window, windows_of
from uavaccel.units import NS_PER_S, to_ns
from uavaccel.wire.image_api import lane_layout

KEPT_ONLY_BY_THE_RUN = ("arrays", "arrays_sha256", "path_m")
WINDOW_NS = 50_000_000  # of the event camera beside the agent's own


def evaluation_of(run: RunDirectory, what: str) -> EvaluateConfig:
    """Return the configuration of an evaluation that repeats. Raises UserError for `wall` and for other suites."""
    suite = run.config().get("suite")
    if suite != "evaluate":
        raise UserError(f"{run.path}: a run of {suite} keeps no actions {what}; evaluate a policy, and take that")
    config = validate(EvaluateConfig, run.config(), str(run.path / "config.yaml"))
    refuse_wall(run, config, what)
    return config


def refuse_wall(run: RunDirectory, config: EvaluateConfig, what: str) -> None:
    """Raise UserError for games that never repeat."""
    if config.task.timing == "wall":
        raise UserError(
            f"{run.path}: timing = 'wall' never repeats, and {what} needs the games flown again; "
            "evaluate with --timing virtual or lockstep"
        )


def environment_of(config: EvaluateConfig) -> Flyable:
    """Return the environment of an evaluation, in the simulator that flew it."""
    keys = config.task.model_dump(mode="json")
    return OneOfKernels(keys) if config.simulator == KERNELS else ObstacleLane(**keys)


class OneOfKernels:
    """A game of the kernels as an environment: a batch of one, which flies as among others."""

    def __init__(self, keys: Mapping[str, Any]) -> None:
        self._batch = KernelBatch(ObstacleLane, 1, autoreset_mode="Disabled", **keys)
        self.close = self._batch.close

    def reset(self, *, seed: int, options: dict[str, Any]) -> tuple[Frame, Info]:
        info = self._batch.reset_each([seed], [options])[0]
        return self._batch.observations()[0].copy(), info

    def charge(self, duration_s: float) -> None:
        self._batch.charge(0, duration_s)

    def step(self, action: Action) -> tuple[Frame, float, bool, bool, Info]:
        self._batch.step_async(np.array([action]), [0])
        seen, rewards, terminated, truncated, infos = self._batch.step_wait([0])
        return seen[0].copy(), float(rewards[0]), bool(terminated[0]), bool(truncated[0]), infos[0]


class Recorded:
    """An agent that takes the actions of a row, and the first one of its space after them."""

    def __init__(self, actions: Sequence[int]) -> None:
        self._left = iter(actions)

    def act(self, observation: Frame, info: Info) -> int:
        return next(self._left, 0)


def fly_again(run: RunDirectory, config: EvaluateConfig, environment: Flyable, row: Mapping[str, Any]) -> list[Step]:
    """Return the commands of that row's game. Raises UserError if the flight made another row."""
    lane = int(row["lane"])
    steps = list(fly_lane(config, environment, Recorded(row["actions"]), lane))
    recorded = {key: value for key, value in row.items() if key not in KEPT_ONLY_BY_THE_RUN}
    again = parse_json(to_json(row_of(config, lane, steps[-1].info, [step.action for step in steps])))
    differing = [key for key in sorted(recorded | again) if recorded.get(key) != again.get(key)]
    if differing:
        raise UserError(
            f"{run.path / 'rows.jsonl'}: {row['case']}: flown again it differs in {', '.join(differing)}; "
            "take the version of uavaccel and the kind of machine that manifest.json names"
        )
    return steps


# --- as a flight ------------------------------------------------------------------------------------------------


def flight_again(
    run: RunDirectory, config: EvaluateConfig, row: Mapping[str, Any], pictures: bool, event_rate_hz: float | None
) -> Flight:
    """Return a game as `Evaluation.flight` does."""
    if event_rate_hz is not None and config.simulator != EXACT:
        raise UserError(
            f"{run.path}: simulator = {config.simulator!r} keeps no poses to log; evaluate with simulator mujoco"
        )
    films = pictures and event_rate_hz is None
    if not films:
        refuse_wall(run, config, "this")
    if config.simulator != EXACT or config.task.timing == "wall":
        return flight_of_agent(config, int(row["lane"]), pictures)
    agent, onlooker, camera = _agent_that_flew(run, config) if films else None, Onlooker(pictures), None
    with closing(ObstacleLane(**config.task.model_dump(mode="json"))) as environment:
        environment.add_observer(onlooker)
        if event_rate_hz is not None:
            ticks = int(NS_PER_S / event_rate_hz) // PROFILES[config.task.profile].tick_ns
            camera = SecondEventCamera(config.task, max(1, ticks))
            environment.add_observer(camera)
        steps = fly_again(run, config, environment, row)
        return _flight(config, environment, steps, onlooker, agent, camera)


def _agent_that_flew(run: RunDirectory, config: EvaluateConfig) -> Agent:
    """Return the agent, whose decisions a film shows. Raises UserError where its weights have changed since."""
    flew = run.manifest().get("policy_sha256")
    if flew is not None and flew != policy_sha256(config.agent):
        raise UserError(f"{run.path}: {config.agent} is another policy than the one that flew this run")
    return make_agent(config.agent, config.task)


def flight_of_agent(config: EvaluateConfig, lane: int, pictures: bool = True) -> Flight:
    """Let the agent fly a lane in the exact simulator, and return its flight.

    Raises UserError in `wall` for a policy whose observation has no events.
    """
    import torch as th

    th.set_num_threads(1)  # as the evaluation's own games are flown
    agent, onlooker = make_agent(config.agent, config.task), Onlooker(pictures)
    task = _seen_by_camera(config) if pictures else config.task
    with closing(ObstacleLane(**task.model_dump(mode="json"))) as environment:
        environment.add_observer(onlooker)
        steps = list(fly_lane(config, environment, agent, lane))
        return _flight(config, environment, steps, onlooker, agent if pictures else None)


def _seen_by_camera(config: EvaluateConfig) -> LaneTask:
    """Return the task; in `wall`, where only messages can request images, one whose observation requests them."""
    task = config.task
    if task.observation == "dvs" or task.timing != "wall":
        return task
    if not is_baseline(config.agent):
        raise UserError(f"timing = 'wall': of {task.observation} there is no film; take virtual or lockstep")
    return task.model_copy(update={"observation": "dvs"})


def _flight(
    config: EvaluateConfig,
    environment: ObstacleLane,
    steps: Sequence[Step],
    onlooker: Onlooker,
    agent: Agent | None,
    camera: SecondEventCamera | None = None,
) -> Flight:
    """Return the flight of the game that has ended; with an `agent`, what that saw and how it rated the actions."""
    task, samples, ended = environment.episode_task, onlooker.samples, steps[-1].info
    start_ns, lane = samples[0].time_ns, ended["lane"]
    hit = onlooker.hit and (onlooker.hit[0] - start_ns, onlooker.hit[1])
    end = "reached the end" if ended["is_success"] else f"hit {hit[1]}" if hit else "ran out of commands"
    other = config.simulator != EXACT or config.task.timing == "wall"
    once_more = ", flown once more in the exact simulator, where it may end otherwise" if other else ""
    title = f"lane {lane}, {command_at_clock(task.model_dump())}: {end}{once_more}"
    asked = [task.velocity_goal(step.action).velocity_m_s for step in steps]
    place: dict[str, Any] = {"scene": "lane", "lane": lane_layout(task.wire_lane(lane)), "collision": hit}
    if not onlooker.pictures:
        return Flight.of(title, task.clock_speed, environment.recording().arrays(), asked, **place)
    time_ns = np.array([sample.time_ns - start_ns for sample in samples], np.int64)
    images = np.stack([sample.image for sample in samples])
    # a command begins with the sample that it was decided on
    starts = time_ns[np.searchsorted([sample.command for sample in samples[1:]], np.arange(len(steps)))]
    windows = (
        windows_of(images, time_ns, task.dvs_parameters, task.dvs_seed)
        if camera is None
        else equal_windows(camera.events.pop_events(), int(time_ns[-1]))
    )
    return Flight(
        title,
        task.clock_speed,
        time_ns,
        np.array([sample.position_m for sample in samples], np.float64),
        np.array([sample.orientation_wxyz for sample in samples], np.float64),
        Commands(starts, np.array([*starts[1:], time_ns[-1]]), np.array(asked, np.float64)),
        image_ns=time_ns,
        images=images,
        windows=list(windows),
        decisions=_decisions(config, agent, steps, np.array([sample.command for sample in samples])),
        **place,
    )


def _decisions(
    config: EvaluateConfig, agent: Agent | None, steps: Sequence[Step], of_sample: NDArray[np.int64]
) -> Decisions | None:
    """Return what a policy saw and how it rates the actions; None for a baseline."""
    if not isinstance(agent, PolicyAgent):
        return None
    rated = [agent.policy.rate(step.given[None]) for step in steps]
    given = np.stack([step.given for step in steps])
    pictures = np.asarray(given, np.uint8) if given.ndim == 4 else None
    taken = np.array([step.action for step in steps])
    ratings = np.concatenate([ratings for _, ratings in rated])
    return Decisions(ratings, taken, config.task.headings_deg, of_sample, rated[0][0], pictures)


def equal_windows(events: NDArray[np.floating], last_ns: int) -> Iterator[Window]:
    """Yield events (n, 4) in windows of WINDOW_NS; the last one ends with the game."""
    ends = [*range(WINDOW_NS, last_ns, WINDOW_NS), last_ns]
    cuts = np.searchsorted(to_ns(events[:, 0]), ends, side="right")
    for end, first, last in zip(ends, [0, *cuts[:-1]], cuts, strict=True):
        yield Window(end, events[first:last])
