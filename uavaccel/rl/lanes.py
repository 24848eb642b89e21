"""The environments that a learner flies: a batch or, in timing `wall`, one environment in this process."""

from __future__ import annotations

from typing import Any

from uavaccel.envs.batch import EnvironmentBatch, LanesHere
from uavaccel.envs.simulators import EXACT
from uavaccel.rl.config import LearnerConfig


def start_exact_lanes(config: LearnerConfig) -> EnvironmentBatch:
    """Start the processes of the exact simulator's lanes, and return while they load. Raises UserError as they do."""
    return EnvironmentBatch(config.environment_class, config.environments, **_keywords(config))


def _keywords(config: LearnerConfig) -> dict[str, Any]:
    """Return the keywords of a training's batch, whose infos include host times."""
    return {**config.task.model_dump(mode="json"), "report_host_times": True, "autoreset_mode": "SameStep"}


def make_lanes(config: LearnerConfig, begun: EnvironmentBatch | None = None) -> Any:
    """Make the environments of a training, of a batch of exact lanes that has `begun` already if there is one.

    In timing `wall` the one lane is flown in this process, so that nothing learns meanwhile and disturbs its clock.
    """
    environment, count, keywords = config.environment_class, config.environments, _keywords(config)
    if config.task.timing == "wall":
        return LanesHere(environment, count, **keywords)
    if config.simulator == EXACT:
        return begun or start_exact_lanes(config)
    if not config.on_device:
        from uavaccel.envs.kernel_batch import KernelBatch  # its machine code is loaded where it flies

        return KernelBatch(environment, count, **keywords)
    if config.algorithm == "ppo":
        from uavaccel.envs.cuda_batch import CudaBatch  # needs numba-cuda and a GPU

        return CudaBatch(environment, count, **keywords)
    import torch as th

    from uavaccel.envs.cuda_lanes import CudaLanes

    return CudaLanes(config.task, count, th.device(config.device))
