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

Observation: TypeAlias = Any
"""A Frame, or a mapping of frames by name; of many environments, an array (n, ...) or a mapping of these."""

Info = dict[str, Any]
"""The info dictionary of Gymnasium's `reset` and `step`."""

Actions = Sequence[Action] | NDArray[np.generic]
"""Actions of many environments."""

Outcomes = NDArray[np.float64 | np.bool_]
"""Rewards, terminations or truncations of many environments."""

Batch = VectorEnv[Observation, Actions, Outcomes]
"""Many environments of one task."""

Steps = tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], list[Info]]
"""Observations, rewards, terminations, truncations and infos of many environments."""

State = dict[str, Any]
"""What a saved game is restored from: texts, numbers and arrays by name, for np.savez."""

SavedState = Mapping[str, Any]
"""A `State` as it was, or as np.load returns it."""

Answer: TypeAlias = Any
"""Result of a method of an environment, or value of its attribute."""


def batch_of(observation: Observation) -> Observation:
    """Return one observation as a batch of one."""
    if isinstance(observation, Mapping):
        return {name: part[None] for name, part in observation.items()}
    return observation[None]


def rows_of(observations: Observation, which: Any) -> Observation:
    """Return the rows `which` of observations (n, ...): views for one, copies for several."""
    if isinstance(observations, Mapping):
        return {name: part[which] for name, part in observations.items()}
    return observations[which]


def copied(observations: Observation) -> Observation:
    """Return a copy."""
    if isinstance(observations, Mapping):
        return {name: part.copy() for name, part in observations.items()}
    return observations.copy()


def write(memory: Observation, observation: Observation) -> None:
    """Write an observation over another one."""
    for name in observation if isinstance(memory, Mapping) else ():
        memory[name][...] = observation[name]
    if not isinstance(memory, Mapping):
        memory[...] = observation


def stacked_observations(observations: Sequence[Observation]) -> Observation:
    """Return several observations as a batch."""
    if isinstance(observations[0], Mapping):
        return {name: np.stack([each[name] for each in observations]) for name in observations[0]}
    return np.stack(observations)
