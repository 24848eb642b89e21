"""What tasks, sensors and environments hand to each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

Number: TypeAlias = Any
"""A number of one game, or one of each of many games: an array (n,) of NumPy, or a tensor of PyTorch."""

Course = Mapping[str, Number]
"""What a task has drawn for a game, and what has become of it: numbers, and lists and mappings of numbers."""

Action: TypeAlias = Any
"""As the task's action space has it: an int, or an array."""

Frame = NDArray[np.integer | np.floating]
"""Of uint8 or float32: what a sensor makes of a sample, and an observation, which is several of them on one axis."""

Info = dict[str, Any]
"""Gymnasium's: what an environment says beside an observation."""

Actions = Sequence[Action] | NDArray[np.generic]
"""Those of many environments."""

Outcomes = NDArray[np.float64 | np.bool_]
"""Rewards or ends of many environments."""

Batch = VectorEnv[Frame, Actions, Outcomes]
"""Many environments of one task."""

Steps = tuple[Frame, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], list[Info]]
"""Observations, rewards, ends, truncations and infos of many environments."""

Answer: TypeAlias = Any
"""What a method of an environment returned, or the value of its attribute."""
