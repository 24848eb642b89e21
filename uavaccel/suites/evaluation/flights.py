"""One game of an evaluation: an agent flies a lane that no training has seen, the same one for every agent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NotRequired

import numpy as np

from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import EXACT
from uavaccel.envs.values import Info
from uavaccel.rl.agents import Agent
from uavaccel.suites.disturbed import note_disturbances
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.report import LaneRow


@dataclass(frozen=True)
class Case:
    """The game on one evaluation lane."""

    lane: int
    timing: str
    typical_s: float

    @property
    def id(self) -> str:
        return lane_case(self.lane)

    def simulated_s(self) -> float:
        return self.typical_s


def cases(config: EvaluateConfig) -> Iterator[Case]:
    """The lanes in their order."""
    for lane in range(config.first_lane, config.first_lane + config.games):
        yield Case(lane, config.task.timing, config.task.typical_s)


class EvaluateRow(LaneRow):
    """A game of an evaluation."""

    wall_s: float
    actions: list[int]
    simulator: NotRequired[str]
    """Which one flew, unless that is the exact one."""


def fly_game(config: EvaluateConfig, environment: ObstacleLane, agent: Agent, lane: int) -> EvaluateRow:
    """Fly the lane to its end; the game's row."""
    infos = list(fly_lane(config, environment, agent, lane))
    return row_of(config, lane, infos[-1], [info["action"] for info in infos])


def row_of(config: EvaluateConfig, lane: int, ended: Info, actions: list[int]) -> EvaluateRow:
    """A game's row, made of the info of its end."""
    row: EvaluateRow = {
        "case": lane_case(lane),
        "suite": "evaluate",
        "is_success": ended["is_success"],
        "distance_m": ended["distance_m"],
        "collision": ended["collision"],
        "lane": ended["lane"],
        "commands": ended["commands"],
        "wall_s": ended["wall_s"],
        "phase_s": ended["phase_s"],
        "sim_time_s": ended["commands"] * config.task.t_move_s,
        "actions": actions,
    }
    note_disturbances(row, ended)
    if config.simulator != EXACT:
        row["simulator"] = config.simulator
    if CONDITIONS in ended:
        row[CONDITIONS] = ended[CONDITIONS]
    return row


def fly_lane(config: EvaluateConfig, environment: ObstacleLane, agent: Agent, lane: int) -> Iterator[Info]:
    """One game, an info after each command; the same game for the same seed and lane."""
    observation, info = environment.reset(seed=game_seed(config, lane), options={"lane": lane})
    over = False
    while not over:
        environment.charge(config.inference_s)
        action = agent.act(observation, info)
        observation, _, terminated, truncated, info = environment.step(action)
        over = terminated or truncated
        yield {**info, "action": action}


def game_seed(config: EvaluateConfig, lane: int) -> int:
    """The seed of the game on that lane."""
    return int(np.random.SeedSequence([config.seed, lane]).generate_state(1)[0])


def lane_case(lane: int) -> str:
    """Name of the game on an evaluation lane."""
    return f"lane-{lane:06d}"
