"""A game of an evaluation flown once more, and looked on at."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from uavaccel.draw.film import PANEL, Film
from uavaccel.draw.style import clock_label, command_name
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.simulators import EXACT
from uavaccel.errors import UserError
from uavaccel.rl.agents import is_baseline, make_agent
from uavaccel.sim.chase import ChaseView
from uavaccel.suites.dp2.scores import count_events
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.filmed import FilmedAgent, SamplesSeen
from uavaccel.suites.evaluation.flights import EvaluateRow, fly_lane
from uavaccel.wire.image_api import lane_layout


def best_first(rows: Iterable[EvaluateRow]) -> list[EvaluateRow]:
    """Games from the success in the fewest commands to the one that got least far."""

    def rank(row: EvaluateRow) -> tuple[bool, float]:
        return not row["is_success"], row["commands"] if row["is_success"] else -row["distance_m"]

    return sorted(rows, key=rank)


def film_lane(config: EvaluateConfig, lane: int) -> Film:
    """The game of that lane once more: the same one in `virtual` and `lockstep`, a new one in `wall`.

    It is flown in the exact simulator, as its title says where the evaluation was not. Raises UserError for a policy
    that sees no events, in `wall`.
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
    on, off = count_events(images, time_s, environment.flown.dvs_parameters, task.dvs_seed)
    end = "reached the end" if info["is_success"] else f"hit {hit}" if hit else "ran out of commands"
    again = "" if config.simulator == EXACT else " in the exact simulator"
    title = f"lane {lane}, {command_name(task.command)} at {clock_label(task.clock_speed)}: {end}{again}"
    layout = lane_layout(environment.flown.wire_lane(lane))
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
    """The task; where nothing but messages can ask for pictures, one that asks for them."""
    task = config.task
    if task.observation == "dvs" or task.timing != "wall":
        return task
    if not is_baseline(config.agent):
        raise UserError(f"timing = 'wall': of {task.observation} there is no film; take virtual or lockstep")
    return task.model_copy(update={"observation": "dvs"})
