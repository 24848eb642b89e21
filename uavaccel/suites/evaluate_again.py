"""An evaluation's game flown once more, by the actions of its row, to see what no run keeps.

In `virtual` and `lockstep` a game repeats to the byte. The row that the second flight makes has to equal the recorded
one; another version of the simulator, or another policy's row, is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.config import validate
from uavaccel.draw.page import command_at_clock
from uavaccel.draw.style import Decisions
from uavaccel.envs.arrays import picture_of, select
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.observer import Onlooker, SecondEventCamera, receives_whole
from uavaccel.envs.sensors import PICTURE_SIZE
from uavaccel.envs.simulators import EXACT, KERNELS
from uavaccel.envs.values import Action, Info, Observation
from uavaccel.errors import UserError
from uavaccel.files import parse_json, to_json
from uavaccel.records import RunDirectory
from uavaccel.resources import require
from uavaccel.rl.agents import Agent, Baseline, PolicyAgent, make_agent, origin_of
from uavaccel.rl.config import LANE, environment_class
from uavaccel.sim.profile import PROFILES
from uavaccel.suites.evaluate import EvaluateConfig, Flyable, Step, ended, fly_lane, row_of
from uavaccel.suites.experiment import number_of
from uavaccel.suites.flight import Commands, Flight, Window, windows_of
from uavaccel.units import NS_PER_S, to_ns

KEPT_ONLY_BY_THE_RUN = ("arrays", "arrays_sha256", "path_m")
TARGETS = ("waypoint_m", "goal_m")  # in the infos of environments, NED
WINDOW_NS = 50_000_000  # of the event camera beside the agent's own


def evaluation_of(run: RunDirectory, what: str) -> EvaluateConfig:
    """Return the configuration of an evaluation that repeats. Raises UserError for `wall` and for other suites."""
    suite = run.config().get("suite")
    if suite != "evaluate":
        raise UserError(f"{run.path}: {what} needs the actions of an evaluation's run, and this is one of {suite}")
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
    keys, environment = config.task.model_dump(mode="json"), environment_class(config.env_id)
    return OneOfKernels(environment, keys) if config.simulator == KERNELS else environment(**keys)


class OneOfKernels:
    """A game of the kernels as an environment: a batch of one, which flies as among others."""

    def __init__(self, environment: type[FlightEnv[Any]], keys: Mapping[str, Any]) -> None:
        self._batch = KernelBatch(environment, 1, autoreset_mode="Disabled", **keys)
        self.close = self._batch.close

    def reset(self, *, seed: int, options: dict[str, Any]) -> tuple[Observation, Info]:
        info = self._batch.reset_each([seed], [options])[0]
        return select(self._batch.observations(), 0), info

    def charge(self, duration_s: float) -> None:
        self._batch.charge(0, duration_s)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, Info]:
        self._batch.step_async(np.array([action]), [0])
        seen, rewards, terminated, truncated, infos = self._batch.step_wait([0])
        return select(seen, 0), float(rewards[0]), bool(terminated[0]), bool(truncated[0]), infos[0]


class Recorded:
    """An agent that takes the actions of a row, and zeros after them."""

    def __init__(self, actions: Sequence[Action]) -> None:
        self._left = list(actions)
        self._after: Action = np.zeros_like(actions[0]).tolist()

    def act(self, observation: Observation, info: Info) -> Action:
        return self._left.pop(0) if self._left else self._after


def fly_again(run: RunDirectory, config: EvaluateConfig, environment: Flyable, row: Mapping[str, Any]) -> list[Step]:
    """Return the commands of that row's game. Raises UserError if the flight made another row."""
    lane = number_of(row)
    steps = list(fly_lane(config, environment, Recorded(row["actions"]), lane))
    recorded = {key: value for key, value in row.items() if key not in KEPT_ONLY_BY_THE_RUN}
    again = parse_json(to_json(row_of(config, lane, ended(steps), [step.action for step in steps])))
    if differing := [key for key in sorted(recorded | again) if recorded.get(key) != again.get(key)]:
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
    films, agent, camera = pictures and event_rate_hz is None, None, None
    if not films:
        refuse_wall(run, config, "this")
    if config.simulator != EXACT or config.task.timing == "wall":
        return flight_of_agent(config, number_of(row), pictures)
    if films:  # they show the agent's decisions, so that it has to be the one that flew
        flew = run.manifest().get("policy_sha256")
        if flew is not None and flew != origin_of(config.agent).sha256():
            raise UserError(f"{run.path}: {config.agent} is another policy than the one that flew this run")
        agent = make_agent(config.agent, config.task)
    if event_rate_hz is not None:
        ticks = int(NS_PER_S / event_rate_hz) // PROFILES[config.task.profile].tick_ns
        camera = SecondEventCamera(config.task, max(1, ticks))
    with closing(environment_class(config.env_id)(**config.task.model_dump(mode="json"))) as environment:
        return _flight(config, environment, partial(fly_again, run, config, row=row), pictures, agent, camera)


def flight_of_agent(config: EvaluateConfig, lane: int, pictures: bool = True) -> Flight:
    """Let the agent fly a lane in the exact simulator, and return its flight.

    Raises UserError in `wall` for a policy that sees no events of whole pictures: only messages can request images.
    """
    require("torch", config.agent, "learn", "PyTorch")
    import torch as th

    th.set_num_threads(1)  # as the evaluation's own games are flown
    agent, task = make_agent(config.agent, config.task), config.task
    if pictures and task.timing == "wall" and not receives_whole(task):
        if not isinstance(origin_of(config.agent), Baseline):
            seen = task.observation if task.observation != "dvs" else f"picture_size = {list(task.picture_size)}"
            raise UserError(f"timing = 'wall': of {seen} there is no film; take virtual or lockstep")
        task = task.model_copy(update={"observation": "dvs", "picture_size": PICTURE_SIZE})
    with closing(environment_class(config.env_id)(**task.model_dump(mode="json"))) as environment:
        fly = partial(fly_lane, config, agent=agent, lane=lane)
        return _flight(config, environment, fly, pictures, agent if pictures else None)


def _flight(
    config: EvaluateConfig,
    environment: FlightEnv[Any],
    fly: Callable[[FlightEnv[Any]], Iterable[Step]],
    pictures: bool,
    agent: Agent | None,
    camera: SecondEventCamera | None = None,
) -> Flight:
    """Return the flight of the game that `fly` flies; of a policy with what that saw and how it rated the actions."""
    onlooker = Onlooker(pictures)
    for observer in filter(None, (onlooker, camera)):
        environment.add_observer(observer)
    steps = list(fly(environment))
    task, samples, ended = environment.episode_task, onlooker.samples, steps[-1].info
    start_ns, in_lane = samples[0].time_ns, config.env_id == LANE
    game = f"lane {ended['lane']}" if in_lane else config.env_id.removeprefix("uavaccel/")
    hit = onlooker.hit and (onlooker.hit[0] - start_ns, onlooker.hit[1])
    end = f"hit {hit[1]}" if hit else "ran out of commands" if in_lane or steps[-1].truncated else "lost"
    if ended["is_success"]:
        end = "reached the end" if in_lane else "won"
    other = config.simulator != EXACT or config.task.timing == "wall"
    once_more = ", flown once more in the exact simulator, where it may end otherwise" if other else ""
    title = f"{game}, {command_at_clock(task.model_dump())}: {end}{once_more}"
    goals = [task.goal(step.action) for step in steps]
    asked = np.array([getattr(goal, "velocity_m_s", (np.nan,) * 3) for goal in goals], np.float64)
    more: dict[str, Any] = {"scene": task.scene, "lane": task.lane_layout(ended), "collision": hit}
    more["target_m"] = next((ended[key] for key in TARGETS if key in ended), None)
    if not pictures:
        return Flight.of(title, task.clock_speed, environment.recording().arrays(), asked, **more)
    time_ns = np.array([sample.time_ns - start_ns for sample in samples], np.int64)
    images, of_sample = np.stack([sample.image for sample in samples]), [sample.command for sample in samples]
    # a command begins with the sample that it was decided on
    starts = time_ns[np.searchsorted(of_sample[1:], np.arange(len(steps)))]
    if camera is None:
        more["windows"] = list(windows_of(images, time_ns, task.dvs_parameters, task.dvs_seed))
    else:
        more["windows"] = list(equal_windows(camera.events.pop_events(), int(time_ns[-1])))
    if isinstance(agent, PolicyAgent) and in_lane:
        (named, *_), ratings = zip(*(agent.policy.rate(select(step.given, None)) for step in steps), strict=True)
        given, taken = np.stack([picture_of(step.given) for step in steps]), np.array([step.action for step in steps])
        seen = np.asarray(given, np.uint8) if given.ndim == 4 else None
        at = np.array(of_sample)
        more["decisions"] = Decisions(np.concatenate(ratings), taken, config.task.headings_deg, at, named, seen)
    poses = ([sample.position_m for sample in samples], [sample.orientation_wxyz for sample in samples])
    position_m, orientation_wxyz = (np.array(values, np.float64) for values in poses)
    commands = Commands(starts, np.array([*starts[1:], time_ns[-1]]), asked)
    more |= {"image_ns": time_ns, "images": images}
    return Flight(title, task.clock_speed, time_ns, position_m, orientation_wxyz, commands, **more)


def equal_windows(events: NDArray[np.floating], last_ns: int) -> Iterator[Window]:
    """Yield events (n, 4) in windows of WINDOW_NS; the last one ends with the game."""
    ends = [*range(WINDOW_NS, last_ns, WINDOW_NS), last_ns]
    cuts = np.searchsorted(to_ns(events[:, 0]), ends, side="right")
    for end, first, last in zip(ends, [0, *cuts[:-1]], cuts, strict=True):
        yield Window(end, events[first:last])
