"""Types of the values that tasks, sensors and environments exchange."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from uavaccel.kinematics import Kinematics, Vector

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

CONDITIONS: Final = "conditions"
"""Key in the course, and in infos, of a game with sampled conditions."""

AT_REST = Kinematics(0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Moment(NamedTuple):
    """A game's state at its start or at the end of a command.

    The functions of a task take the `Moment` of one game or the `Moments` of many: they compute with plain arithmetic,
    which is the same for a float and for an array.
    """

    state: Kinematics
    """State of the last sample, of those before a collision."""
    position_m: Vector
    """Position of the vehicle or, after a collision, of its first contact: NED."""
    collision: str | None
    """Name of the object it hit; None without a collision."""
    commands: int
    """Commands flown so far."""
    course: Course
    """The task's own variables, sampled at reset and updated by `advance`: plain numbers, lists and mappings."""

    @property
    def touched(self) -> bool:
        return self.collision is not None

    @property
    def free(self) -> bool:
        return self.collision is None


class Collisions:
    """What the vehicles of n games hit: `== "ground"` is an array (n,), as it is a bool for the name of one game's.

    `index` (n,) is that of the name in `objects`, -1 without a collision, for which `touched` and `free` ask.
    """

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, index: Number, objects: tuple[str, ...]) -> None:
        self.index, self.objects = index, objects

    def __eq__(self, name: object) -> Number:
        if not isinstance(name, str):
            raise TypeError("a collision is compared with the name of an object; touched and free say if there is any")
        return self.index == (self.objects.index(name) if name in self.objects else len(self.objects))

    def __ne__(self, name: object) -> Number:
        return ~(self == name)

    def __bool__(self) -> bool:
        return bool(self == None)  # noqa: E711 - which is refused


class Moments(NamedTuple):
    """The state of n games: where `Moment` has a number, a NumPy array or a PyTorch tensor (n,)."""

    state: Kinematics
    position_m: Sequence[Number]
    """Three arrays: north, east, down."""
    collision: Collisions
    commands: Number
    course: Course
    """A list of numbers in a game's course is a list of arrays here."""

    @property
    def touched(self) -> Number:
        return self.collision.index >= 0

    @property
    def free(self) -> Number:
        return self.collision.index < 0


AnyMoment: TypeAlias = Any
"""A Moment or Moments; a user's task may handle only one of them."""
