"""Evaluation: an agent flies lanes that no training has seen; every lane is the same for every agent."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Annotated, Any, Literal

import numpy as np
import torch as th
from pydantic import Field

from uavaccel.config import Config, validate
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.metrics.intervals import wilson_interval
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import Agent, agent_task, make_agent

Report = Callable[[dict[str, Any]], None]


class EvaluateConfig(Config):
    """What is evaluated, on which lanes and under which clock."""

    suite: Literal["evaluate"] = "evaluate"
    agent: str
    """Folder of a policy (a training's run directory), or a baseline: straight, offset:METRES."""
    games: Annotated[int, Field(ge=1)] = 300
    first_lane: Annotated[int, Field(ge=0)] = 0
    seed: Annotated[int, Field(ge=0)] = 0
    inference_s: Annotated[float, Field(ge=0.0)] = 0.0005
    """What a decision costs the simulated wall clock of `virtual`."""
    task: LaneTask = LaneTask(split="evaluation", timing="virtual")


def evaluate(
    config: EvaluateConfig, run: RunDirectory, jobs: int = 1, report: Report = lambda row: None
) -> dict[str, Any]:
    """Fly the lanes that have no row yet, in `jobs` processes; the summary, which is also written."""
    done = run.done_cases()
    lanes = range(config.first_lane, config.first_lane + config.games)
    for row in _rows(config, [lane for lane in lanes if lane_case(lane) not in done], jobs):
        run.append_row(row)
        report(row)
    summary = summarise(config, run.rows())
    run.write_json("summary.json", summary)
    return summary


def summarise(config: EvaluateConfig, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Success ratio with its 95 % Wilson interval, and how far the agent got."""
    successes = sum(row["is_success"] for row in rows)
    low, high = wilson_interval(successes, len(rows))
    task = config.task
    sim_time_s, wall_s = (sum(row[name] for row in rows) for name in ("sim_time_s", "wall_s"))
    return {
        "suite": "evaluate",
        "agent": config.agent,
        "profile": task.profile,
        "command": task.command,
        "clock_speed": task.clock_speed,
        "timing": task.timing,
        "seed": config.seed,
        "games": len(rows),
        "successes": successes,
        "success_ratio": successes / len(rows),
        "wilson_low": low,
        "wilson_high": high,
        "sim_time_s": sim_time_s,
        "wall_s": wall_s,
        "simulated_s_per_wall_s": sim_time_s / wall_s,
        "distance_m_median": float(np.median([row["distance_m"] for row in rows])),
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


def make_lane(config: EvaluateConfig, render_mode: str | None = None) -> tuple[ObstacleLane, Agent]:
    """An environment with the agent's own senses, and the agent."""
    th.set_num_threads(1)
    task = agent_task(config.agent, config.task)
    return ObstacleLane(render_mode, **task.model_dump(mode="json")), make_agent(config.agent, task)


def _rows(config: EvaluateConfig, lanes: list[int], jobs: int) -> Iterator[dict[str, Any]]:
    """Rows in the order of the lanes, whatever the number of processes."""
    if jobs == 1:
        environment, agent = make_lane(config)
        yield from (_row(config, environment, agent, lane) for lane in lanes)
        environment.close()
        return
    context = multiprocessing.get_context("spawn")  # what renders must not be forked
    with ProcessPoolExecutor(
        jobs, context, initializer=_start_worker, initargs=(config.model_dump(mode="json"),)
    ) as pool:
        yield from pool.map(_fly_in_worker, lanes)


_worker: list[Any] = []  # configuration, environment and agent of a worker process


def _start_worker(config: dict[str, Any]) -> None:
    checked = validate(EvaluateConfig, config, "evaluation")
    _worker[:] = [checked, *make_lane(checked)]


def _fly_in_worker(lane: int) -> dict[str, Any]:
    config, environment, agent = _worker
    return _row(config, environment, agent, lane)


def _row(config: EvaluateConfig, environment: ObstacleLane, agent: Agent, lane: int) -> dict[str, Any]:
    infos = list(fly_lane(config, environment, agent, lane))
    names = ("is_success", "distance_m", "collision", "lane", "commands", "wall_s", "phase_s")
    return {
        "case": lane_case(lane),
        "suite": "evaluate",
        **{name: infos[-1][name] for name in names},
        "sim_time_s": infos[-1]["commands"] * config.task.t_move_s,
        "actions": [info["action"] for info in infos],
    }


def lane_case(lane: int) -> str:
    """Name of the game on an evaluation lane."""
    return f"lane-{lane:06d}"
