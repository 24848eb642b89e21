"""Games of an evaluation flown again, to be filmed or seen by a second event camera."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.film import PANEL, Film
from uavaccel.draw.labels import clock_label, command_name
from uavaccel.draw.panels import Decisions
from uavaccel.envs.camera_client import FlightSample
from uavaccel.envs.observer import Game, Observer
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.simulators import EXACT
from uavaccel.envs.task import rate_ticks
from uavaccel.envs.values import Frame, Info
from uavaccel.errors import UserError
from uavaccel.kinematics import Quaternion, Vector
from uavaccel.rl.agents import Agent, PolicyAgent, is_baseline, make_agent
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.chase import ChaseView
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import EvaluateRow, fly_lane
from uavaccel.suites.old_dp2.scores import count_events
from uavaccel.vision.dvs import make_sensor
from uavaccel.vision.event_counter import EventCounter
from uavaccel.wire.image_api import lane_layout


class Seen(NamedTuple):
    """The front camera's gray image, when and where it was taken, and the command during which it was."""

    time_ns: int
    image: NDArray[np.uint8]
    position_m: Vector
    orientation_wxyz: Quaternion
    command: int


class SamplesSeen(Observer):
    """Collects the samples of the current game, the last one at the moment of impact.

    Images that the agent does not receive are rendered without a message, which needs `virtual` or `lockstep`.
    """

    def __init__(self) -> None:
        self.samples: list[Seen] = []

    def game_begun(self, game: Game) -> None:
        self._game = game
        self.samples = []

    def sample_taken(self, sample: FlightSample, command: int) -> None:
        state, hit = sample.state, sample.collision
        time_ns = hit["time_ns"] if hit else state.time_ns
        north, east, down = hit["position_m"] if hit else state.position_m
        shown = self._game.task.observation == "dvs" and not hit
        image = sample.image if shown else self._game.session.picture()
        self.samples.append(Seen(time_ns, image, (north, east, down), state.orientation_wxyz, command))


class FilmedAgent:
    """An agent that records its observations, its ratings of the actions, and the actions that it took."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._rated_as = ""
        self._given: list[Frame] = []
        self._ratings: list[NDArray[np.float64]] = []
        self._taken: list[int] = []

    def act(self, observation: Frame, info: Info) -> int:
        if not isinstance(self._agent, PolicyAgent):
            return self._agent.act(observation, info)
        self._rated_as, ratings = self._agent.policy.rate(observation[None])
        action = int(
            ratings[0].argmax()
        )  # what the agent would do; asking it would rate the observation once more
        self._given.append(observation.copy())
        self._ratings.append(ratings[0])
        self._taken.append(action)
        return action

    def decisions(self, headings_deg: tuple[float, ...], of_sample: list[int]) -> Decisions | None:
        """Return the decisions of the game, with the command of each sample; None for a baseline."""
        if not self._taken:
            return None
        given = np.stack(self._given)
        pictures = np.asarray(given, np.uint8) if given.ndim == 4 else None
        ratings, taken = np.stack(self._ratings), np.array(self._taken)
        return Decisions(ratings, taken, headings_deg, np.array(of_sample), self._rated_as, pictures)


def best_first(rows: Iterable[EvaluateRow]) -> list[EvaluateRow]:
    """Sort games from the success in the fewest commands to the failure with the least distance."""

    def rank(row: EvaluateRow) -> tuple[bool, float]:
        return not row["is_success"], row["commands"] if row["is_success"] else -row["distance_m"]

    return sorted(rows, key=rank)


def film_lane(config: EvaluateConfig, lane: int) -> Film:
    """Fly the game on a lane again, and return its film; in `virtual` and `lockstep` it is the same game.

    It is flown in the exact simulator, and its title says so where the evaluation was not. Raises UserError in `wall`
    for a policy whose observation has no events.
    """
    import torch as th

    th.set_num_threads(1)  # as the evaluation's own games are flown
    task = config.task
    agent = FilmedAgent(make_agent(config.agent, task))
    environment, seen = ObstacleLane(**_seen_by_camera(config).model_dump(mode="json")), SamplesSeen()
    environment.add_observer(seen)
    try:
        info = list(fly_lane(config, environment, agent, lane))[-1]
    finally:
        environment.close()
    samples, hit = seen.samples, str(info["collision"] or "")
    images = np.stack([sample.image for sample in samples])
    time_s = np.array([sample.time_ns - samples[0].time_ns for sample in samples]) / 1e9
    position_m = np.array([sample.position_m for sample in samples])
    attitude = np.array([sample.orientation_wxyz for sample in samples])
    on, off = count_events(images, time_s, environment.episode_task.dvs_parameters, task.dvs_seed)
    end = "reached the end" if info["is_success"] else f"hit {hit}" if hit else "ran out of commands"
    again = "" if config.simulator == EXACT else " in the exact simulator"
    title = f"lane {lane}, {command_name(task.command)} at {clock_label(task.clock_speed)}: {end}{again}"
    layout = lane_layout(environment.episode_task.wire_lane(lane))
    return Film(
        title,
        time_s,
        images,
        on,
        off,
        position_m,
        layout,
        chase=ChaseView(layout, position_m, attitude, PANEL),
        decisions=agent.decisions(task.headings_deg, [sample.command for sample in samples]),
        hit=hit,
    )


def _seen_by_camera(config: EvaluateConfig) -> LaneTask:
    """Return the task; in `wall`, where only messages can request images, one whose observation requests them."""
    task = config.task
    if task.observation == "dvs" or task.timing != "wall":
        return task
    if not is_baseline(config.agent):
        raise UserError(f"timing = 'wall': of {task.observation} there is no film; take virtual or lockstep")
    return task.model_copy(update={"observation": "dvs"})


class SecondEventCamera(Observer):
    """An event camera beside the agent's own, which receives a frame every few ticks of the game."""

    def __init__(self, task: LaneTask, every_ticks: int) -> None:
        self._every_ticks = every_ticks
        self.events = EventCounter(
            make_sensor(task.dvs_parameters, (HEIGHT, WIDTH), task.dvs_seed), listed=True
        )
        self._stop: Callable[[], None] = lambda: None

    def game_begun(self, game: Game) -> None:
        self._stop()
        now_ns, seed = game.start.time_ns, game.task.events_seed(game.noise.seed)
        self.events.start(game.picture(now_ns), now_ns, seed)
        self._stop = game.session.watch(
            self._every_ticks, lambda time_ns: self.events.look(game.picture(time_ns), time_ns)
        )


def lane_events(config: EvaluateConfig, lane: int, rate_hz: float) -> NDArray[np.float32]:
    """Fly the game on a lane again, and return its events (n, 4): t in s, x, y, and p, which is 1 or -1.

    Raises UserError for a rate that the physics step does not divide.
    """
    task = config.task
    try:
        camera = SecondEventCamera(task, rate_ticks(rate_hz, task.profile, "--events-rate-hz"))
    except ValueError as error:
        raise UserError(str(error)) from None
    environment = ObstacleLane(**task.model_dump(mode="json"))
    environment.add_observer(camera)
    try:
        for _ in fly_lane(config, environment, make_agent(config.agent, task), lane):
            pass
        return camera.events.take_events()
    finally:
        environment.close()
