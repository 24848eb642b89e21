"""One game of an evaluation: an agent flies a lane that no training has seen, the same one for every agent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import EXACT
from uavaccel.rl.agents import Agent
from uavaccel.suites.disturbed import measured_disturbances
from uavaccel.suites.evaluation.config import EvaluateConfig


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


def fly_game(config: EvaluateConfig, environment: ObstacleLane, agent: Agent, lane: int) -> dict[str, Any]:
    """Fly the lane to its end; the game's row."""
    infos = list(fly_lane(config, environment, agent, lane))
    return row_of(config, lane, infos[-1], [info["action"] for info in infos])


def row_of(config: EvaluateConfig, lane: int, ended: dict[str, Any], actions: list[int]) -> dict[str, Any]:
    """A game's row, of the info of its end; it says which simulator flew, unless that is the exact one."""
    names = ("is_success", "distance_m", "collision", "lane", "commands", "wall_s", "phase_s")
    return {
        "case": lane_case(lane),
        "suite": "evaluate",
        **({} if config.simulator == EXACT else {"simulator": config.simulator}),
        **{name: ended[name] for name in names},
        **{name: ended[name] for name in (CONDITIONS,) if name in ended},
        "sim_time_s": ended["commands"] * config.task.t_move_s,
        "actions": actions,
        **measured_disturbances(ended),
    }


def fly_lane(
    config: EvaluateConfig, environment: ObstacleLane, agent: Agent, lane: int
) -> Iterator[dict[str, Any]]:
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
