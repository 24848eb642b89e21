"""The learner that a configuration asks for."""

from __future__ import annotations

from uavaccel.rl.algorithms import OWN
from uavaccel.rl.baseline import Baseline
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.double_dqn import DoubleDQN
from uavaccel.rl.lanes import Lanes
from uavaccel.rl.learner import Learner


def make_learner(config: LearnerConfig, lanes: Lanes) -> Learner:
    """Untrained. Raises UserError for options that it does not know."""
    return DoubleDQN(config, lanes) if config.algorithm == OWN else Baseline(config, lanes)
