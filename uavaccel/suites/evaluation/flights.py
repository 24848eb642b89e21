"""The games of an evaluation: an agent flies lanes that no training has seen, the same ones for every agent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, NotRequired

import numpy as np
from pydantic import Field

from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import EXACT
from uavaccel.envs.values import Info
from uavaccel.forms import Count, NotNegative, Number
from uavaccel.rl.agents import Agent
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.rows import LaneRow, lane_row
from uavaccel.suites.suite import SimpleCase


@dataclass(frozen=True)
class Case(SimpleCase):
    """The game on an evaluation lane."""

    lane: int


class EvaluateRow(LaneRow):
    """The row of a game of an evaluation."""

    wall_s: NotNegative
    actions: list[Count]
    path_m: NotRequired[list[Annotated[list[Number], Field(min_length=2, max_length=2)]]]
    """Of a lane lost in the exact simulator: positions north and east at the ends of the commands."""


def fly_game(config: EvaluateConfig, environment: ObstacleLane, agent: Agent, lane: int) -> EvaluateRow:
    """Fly a game on a lane, and return its row."""
    infos = list(fly_lane(config, environment, agent, lane))
    ended = infos[-1] | {"path_m": [info["position_m"][:2] for info in infos]}
    return row_of(config, lane, ended, [info["action"] for info in infos])


def row_of(config: EvaluateConfig, lane: int, ended: Info, actions: list[int]) -> EvaluateRow:
    """Return a game's row from the info of its last step, to which its path may have been added."""
    shared = lane_row("evaluate", lane_case(lane), ended, config.task.t_move_s)
    row: EvaluateRow = {
        **shared,  # type: ignore[typeddict-item] # which has no key that is not required here
        "wall_s": ended["wall_s"],
        "actions": actions,
    }
    if not row["is_success"] and "path_m" in ended:
        row["path_m"] = ended["path_m"]
    if config.simulator != EXACT:
        row["simulator"] = config.simulator
    return row


def fly_lane(config: EvaluateConfig, environment: ObstacleLane, agent: Agent, lane: int) -> Iterator[Info]:
    """Fly a game, and yield the info after each command; equal seed and lane give equal games."""
    observation, info = environment.reset(seed=game_seed(config, lane), options={"lane": lane})
    over = False
    while not over:
        environment.charge(config.inference_s)
        action = agent.act(observation, info)
        observation, _, terminated, truncated, info = environment.step(action)
        over = terminated or truncated
        yield {**info, "action": action}


def game_seed(config: EvaluateConfig, lane: int) -> int:
    """Return the seed of the game on a lane."""
    return int(np.random.SeedSequence([config.seed, lane]).generate_state(1)[0])


def lane_case(lane: int) -> str:
    """Return the name of the game on an evaluation lane."""
    return f"lane-{lane:06d}"
