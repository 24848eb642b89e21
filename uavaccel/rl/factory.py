"""The learner that a configuration asks for."""

from __future__ import annotations

from uavaccel.rl.baseline import Baseline
from uavaccel.rl.checks import OWN
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.double_dqn import DoubleDQN
from uavaccel.rl.lanes import AnyLanes
from uavaccel.rl.learner import Learner


def make_learner(config: LearnerConfig, lanes: AnyLanes) -> Learner:
    """Untrained. Raises UserError for options that it does not know."""
    if config.on_device:
        from uavaccel.rl.device_dqn import DeviceDQN  # needs numba-cuda and a GPU

        return DeviceDQN(config, lanes)
    return DoubleDQN(config, lanes) if config.algorithm == OWN else Baseline(config, lanes)
