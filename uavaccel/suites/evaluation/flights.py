"""One game of an evaluation: an agent flies a lane that no training has seen, the same one for every agent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.obstacle_lane import ObstacleLane
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
    names = ("is_success", "distance_m", "collision", "lane", "commands", "wall_s", "phase_s")
    return {
        "case": lane_case(lane),
        "suite": "evaluate",
        **{name: infos[-1][name] for name in names},
        **{name: infos[-1][name] for name in (CONDITIONS,) if name in infos[-1]},
        "sim_time_s": infos[-1]["commands"] * config.task.t_move_s,
        "actions": [info["action"] for info in infos],
        **measured_disturbances(infos[-1]),
    }


def fly_lane(
    config: EvaluateConfig, environment: ObstacleLane, agent: Agent, lane: int
) -> Iterator[dict[str, Any]]:
    """One game, an info after each command; the same game for the same seed and lane."""
    seed = int(np.random.SeedSequence([config.seed, lane]).generate_state(1)[0])
    observation, info = environment.reset(seed=seed, options={"lane": lane})
    over = False
    while not over:
        environment.charge(config.inference_s)
        action = agent.act(observation, info)
        observation, _, terminated, truncated, info = environment.step(action)
        over = terminated or truncated
        yield {**info, "action": action}


def lane_case(lane: int) -> str:
    """Name of the game on an evaluation lane."""
    return f"lane-{lane:06d}"
