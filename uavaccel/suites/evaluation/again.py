"""An evaluation's game flown once more, by the actions of its row, to see what no run keeps: observations and rewards.

In `virtual` and `lockstep` a game repeats to the byte. The row that the second flight makes has to equal the recorded
one; another version of the simulator, or another policy's row, is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

import numpy as np

from uavaccel.config import validate
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import KERNELS
from uavaccel.envs.values import Action, Frame, Info
from uavaccel.errors import UserError
from uavaccel.files import parse_json, to_json
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import EvaluateRow, game_seed, row_of

KEPT_ONLY_BY_THE_RUN = ("arrays", "arrays_sha256", "path_m")


class Step(NamedTuple):
    """One command: what it was decided on, and what Gymnasium's `step` returned."""

    action: int
    observation: Frame
    reward: float
    terminated: bool
    truncated: bool
    info: Info


class Flyable(Protocol):
    """What of an environment a second flight needs."""

    def reset(self, *, seed: int, options: Mapping[str, object]) -> tuple[Frame, Info]: ...
    def charge(self, duration_s: float) -> None: ...
    def step(self, action: Action) -> tuple[Frame, float, bool, bool, Info]: ...
    def close(self) -> None: ...


def evaluation_of(run: RunDirectory, what: str) -> EvaluateConfig:
    """Return the configuration of an evaluation that repeats. Raises UserError for `wall` and for other suites."""
    suite = run.config().get("suite")
    if suite != "evaluate":
        raise UserError(
            f"{run.path}: a run of {suite} keeps no actions {what}; evaluate a policy, and take that"
        )
    config = validate(EvaluateConfig, run.config(), str(run.path / "config.yaml"))
    if config.task.timing == "wall":
        raise UserError(
            f"{run.path}: timing = 'wall' never repeats, and {what} needs the games flown again; "
            "evaluate with --timing virtual or lockstep"
        )
    return config


@contextmanager
def opened(config: EvaluateConfig) -> Iterator[Flyable]:
    """The environment of that evaluation, in the simulator that flew it."""
    keys = config.task.model_dump(mode="json")
    flyable: Flyable = _OneOfKernels(keys) if config.simulator == KERNELS else ObstacleLane(**keys)
    try:
        yield flyable
    finally:
        flyable.close()


def fly_again(
    run: RunDirectory,
    config: EvaluateConfig,
    environment: Flyable,
    row: EvaluateRow,
    begun: Callable[[Frame], None] = lambda _: None,
) -> Iterator[Step]:
    """Yield the commands of that row's game; `begun` is given the first observation.

    Raises UserError after the last one if the flight made another row.
    """
    lane, ended = int(row["lane"]), False
    observation, info = environment.reset(seed=game_seed(config, lane), options={"lane": lane})
    begun(observation)
    for action in row["actions"]:
        if ended:
            break
        environment.charge(config.inference_s)
        observation, reward, terminated, truncated, info = environment.step(action)
        ended = terminated or truncated
        yield Step(action, observation, float(reward), bool(terminated), bool(truncated), info)
    _check_same(run, row, row_of(config, lane, info, list(row["actions"])))


def _check_same(run: RunDirectory, row: EvaluateRow, flown: EvaluateRow) -> None:
    recorded = {key: value for key, value in row.items() if key not in KEPT_ONLY_BY_THE_RUN}
    again = parse_json(to_json(flown))
    differing = [key for key in sorted(recorded | again) if recorded.get(key) != again.get(key)]
    if differing:
        raise UserError(
            f"{run.path / 'rows.jsonl'}: {row['case']}: flown again it differs in {', '.join(differing)}; "
            "take the version of uavaccel and the kind of machine that manifest.json names"
        )


class _OneOfKernels:
    """A game of the kernels as an environment: a batch of one, which flies as among others."""

    def __init__(self, keys: Mapping[str, Any]) -> None:
        self._batch = KernelBatch(ObstacleLane, 1, autoreset_mode="Disabled", **keys)

    def reset(self, *, seed: int, options: Mapping[str, object]) -> tuple[Frame, Info]:
        info = self._batch.reset_each([seed], [options])[0]
        return self._batch.observations()[0].copy(), info

    def charge(self, duration_s: float) -> None:
        self._batch.charge(0, duration_s)

    def step(self, action: Action) -> tuple[Frame, float, bool, bool, Info]:
        self._batch.step_async(np.array([action]), [0])
        seen, rewards, terminated, truncated, infos = self._batch.step_wait([0])
        return seen[0].copy(), float(rewards[0]), bool(terminated[0]), bool(truncated[0]), infos[0]

    def close(self) -> None:
        self._batch.close()
