"""Types of the values that tasks, sensors and environments exchange."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

Number: TypeAlias = Any
"""A number of one game, or those of n games: a NumPy array or PyTorch tensor (n,)."""

Course = Mapping[str, Number]
"""A task's variables of a game: numbers, and lists and mappings of numbers."""

Action: TypeAlias = Any
"""An element of the action space: an int, or an array."""

Frame = NDArray[np.integer | np.floating]
"""A frame, which a sensor makes of a sample, or an observation, several frames on axis 0: uint8 or float32."""

Seen: TypeAlias = Any
"""An observation: a Frame, or a mapping of those by name."""

Info = dict[str, Any]
"""The info dictionary of Gymnasium's `reset` and `step`."""

Actions = Sequence[Action] | NDArray[np.generic]
"""Actions of many environments."""

Outcomes = NDArray[np.float64 | np.bool_]
"""Rewards, terminations or truncations of many environments."""

Batch = VectorEnv[Seen, Actions, Outcomes]
"""Many environments of one task."""

Steps = tuple[Seen, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], list[Info]]
"""Observations, rewards, terminations, truncations and infos of many environments."""

Answer: TypeAlias = Any
"""Result of a method of an environment, or value of its attribute."""
