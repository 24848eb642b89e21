"""A game of an evaluation flown once more, by an environment that keeps what it sees."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.film import Film
from uavaccel.draw.style import clock_label, command_name
from uavaccel.envs.flight_client import FlightSample
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.rl.agents import make_agent
from uavaccel.suites.dp2.scores import count_events
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import fly_lane
from uavaccel.wire.image_api import lane_layout


class FilmedLane(ObstacleLane):
    """An `ObstacleLane` that remembers the samples of the running game."""

    def __init__(self, **task: Any) -> None:
        super().__init__(**task)
        self.samples: list[FlightSample] = []

    def _see(self, sample: FlightSample) -> NDArray[Any]:
        self.samples.append(sample)
        return super()._see(sample)


def best_first(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Games from the success in the fewest commands to the one that got least far."""

    def rank(row: dict[str, Any]) -> tuple[bool, float]:
        return not row["is_success"], row["commands"] if row["is_success"] else -row["distance_m"]

    return sorted(rows, key=rank)


def film_lane(config: EvaluateConfig, lane: int) -> Film:
    """The game of that lane once more: the same one in `virtual` and `lockstep`, a new one in `wall`."""
    task = config.task
    pictures = task if task.observation == "dvs" else task.model_copy(update={"observation": "dvs"})
    environment = FilmedLane(**pictures.model_dump(mode="json"))
    try:
        info = list(fly_lane(config, environment, make_agent(config.agent, task), lane))[-1]
    finally:
        environment.close()
    samples = environment.samples
    images = np.stack([sample.image for sample in samples])
    time_s = np.array([sample.state.time_ns - samples[0].state.time_ns for sample in samples]) / 1e9
    on, off = count_events(images, time_s, environment.flown.dvs_parameters, task.dvs_seed)
    end = (
        "reached the end"
        if info["is_success"]
        else f"hit {info['collision'] or 'nothing, ran out of commands'}"
    )
    title = f"lane {lane}, {command_name(task.command)} at {clock_label(task.clock_speed)}: {end}"
    position_m = np.array([sample.state.position_m for sample in samples])
    layout = lane_layout(environment.flown.wire_lane(lane))
    return Film(title, time_s, images, on, off, position_m, layout)
