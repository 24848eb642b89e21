"""How large a cell is, before it is flown, and whether its parts can be configured at all."""

from __future__ import annotations

from typing import Any

import numpy as np

from uavaccel.envs.simulators import EXACT
from uavaccel.rl.agents import DEFAULT
from uavaccel.rl.config import OWN, DqnOptions
from uavaccel.suites.parts import Part, part_cost, part_suite
from uavaccel.suites.rl.cases import (
    EVALUATION_SEED,
    Size,
    TrainingCase,
    evaluation_part,
    flights,
    training_part,
)
from uavaccel.suites.rl.config import RlConfig

GPU_RATE = 1_500.0  # simulated seconds per wall second of many lanes of the exact simulator on one GPU, about
CELL_BYTES = 2e6  # of a policy and its curves


def _parts(config: RlConfig, cell: TrainingCase) -> list[tuple[Part, int]]:
    """Training and evaluations with their seeds; the policy that ships stands for the cell's own."""
    flown = [evaluation_part(config, cell, flight, DEFAULT) for flight in flights(config, cell)]
    trained = [] if cell.exact else [(training_part(config, cell), cell.seed)]
    return [*trained, *((part, EVALUATION_SEED) for part in flown)]


def part_configs(config: RlConfig, cell: TrainingCase) -> list[Any]:
    """Configurations of the cell's training and evaluations. Raises UserError for what cannot be."""
    return [part_suite(part, seed)[1] for part, seed in _parts(config, cell)]


def size_of(config: RlConfig, cell: TrainingCase) -> Size:
    """Games, simulated and wall seconds, and bytes on disk of a cell, about."""
    configs = part_configs(config, cell)
    costs = [part_cost(part, seed) for part, seed in _parts(config, cell)]
    simulated_s = sum(part_s for part_s, _ in costs)
    first = configs[0]
    drawn_by_gpu = first.simulator == EXACT and str(first.device).startswith("cuda")
    return Size(
        sum(part.games for part in configs),
        simulated_s,
        simulated_s / GPU_RATE if drawn_by_gpu else sum(cost.wall_s for _, cost in costs),
        sum(cost.disk_bytes for _, cost in costs) + (0.0 if cell.exact else CELL_BYTES),
    )


def checkpoint_bytes(config: RlConfig, cell: TrainingCase) -> float:
    """What a training's checkpoint holds at most: the replay buffer, which each process writes for its own training."""
    training = part_configs(config, cell)[0]
    if getattr(training, "algorithm", "") != OWN or training.games <= training.checkpoint_games:
        return 0.0
    space = training.task.observation_space()
    flown = training.games * training.task.typical_s / training.task.t_move_s
    kept = min(DqnOptions.of(training).buffer_size, flown)
    return float(2 * kept * np.prod(space.shape) * space.dtype.itemsize)
