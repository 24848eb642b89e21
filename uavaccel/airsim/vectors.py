"""AirSim's vectors, quaternions and places under AirSim's names, and the base of all its types.

Source of names, fields, defaults and the order of arguments: AirSim v1.8.1, PythonClient/airsim/types.py.
"""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from numbers import Real
from pprint import pformat
from typing import Self, dataclass_transform

import numpy as np
from numpy.typing import NDArray

from uavaccel.wire.rpc import Received

FloatArray = NDArray[np.float32]
Number = float | np.floating | np.integer


@dataclass_transform(eq_default=False)
class MsgpackMixin:
    """Base of AirSim's types, which are dataclasses: their fields are those of a map on the wire."""

    def __init_subclass__(cls, eq: bool = False) -> None:
        dataclass(repr=False, eq=eq)(cls)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}> " + pformat(vars(self), indent=4, width=1)

    def to_msgpack(self, *args: object, **options: object) -> dict[str, object]:
        """Return the fields; nested objects stay objects."""
        return self.__dict__

    @classmethod
    def from_msgpack(cls, encoded: Mapping[str, Received]) -> Self:
        """Make an object from a map: unknown fields are kept, missing ones get their defaults."""
        self = cls.__new__(cls)
        fields = vars(self)
        nested: dict[str, type[MsgpackMixin] | None] = _fields(cls)  # type: ignore[arg-type]
        for key, value in encoded.items():
            inner = nested.get(key) if type(value) is dict else None
            fields[key] = inner.from_msgpack(value) if inner else value
        if not nested.keys() <= fields.keys():
            self.__dict__ = vars(cls()) | fields
        return self


@cache
def _fields(cls: type[MsgpackMixin]) -> dict[str, type[MsgpackMixin] | None]:
    """Return the fields of a type, each with its own type if that is one of AirSim's."""
    return {key: type(value) if isinstance(value, MsgpackMixin) else None for key, value in vars(cls()).items()}


class Vector2r(MsgpackMixin, eq=True):
    x_val: float = 0.0
    y_val: float = 0.0


class _Components(MsgpackMixin):
    """Base of vectors and quaternions: the arithmetic that they share, component by component."""

    def __iter__(self) -> Iterator[float]:
        names: Iterable[str] = _fields(type(self))  # type: ignore[arg-type]
        return (getattr(self, name) for name in names)  # in this order: maps from the wire have another

    def containsNan(self) -> bool:
        return any(math.isnan(value) for value in self)

    def __add__(self, other: Self) -> Self:
        _alike(other, "+", self)
        return type(self)(*map(operator.add, self, other))

    def __sub__(self, other: Self) -> Self:
        _alike(other, "-", self)
        return type(self)(*map(operator.sub, self, other))

    def dot(self, other: Self) -> float:
        _alike(other, "dot", self)
        return float(reduce(operator.add, map(operator.mul, self, other)))  # sum() rounds by the version of Python

    def get_length(self) -> float:
        return math.sqrt(self.dot(self))

    def to_numpy_array(self) -> FloatArray:
        """Return the components in the order of the arguments."""
        return np.array([*self], np.float32)


class Vector3r(_Components):
    x_val: float = 0.0
    y_val: float = 0.0
    z_val: float = 0.0

    @staticmethod
    def nanVector3r() -> Vector3r:
        return Vector3r(math.nan, math.nan, math.nan)

    def __mul__(self, other: Number) -> Vector3r:
        factor = _number(other, "*", self)
        return Vector3r(*(value * factor for value in self))

    def __truediv__(self, other: Number) -> Vector3r:
        divisor = _number(other, "/", self)
        return Vector3r(*(value / divisor for value in self))

    def cross(self, other: Vector3r) -> Vector3r:
        _alike(other, "cross", self)
        (a, b, c), (x, y, z) = self, other
        return Vector3r(b * z - c * y, c * x - a * z, a * y - b * x)

    def distance_to(self, other: Vector3r) -> float:
        return (self - other).get_length()

    def to_Quaternionr(self) -> Quaternionr:
        """Return the quaternion without a scalar part."""
        return Quaternionr(self.x_val, self.y_val, self.z_val, 0.0)


class Quaternionr(_Components):
    """A quaternion, whose scalar part comes last."""

    x_val: float = 0.0
    y_val: float = 0.0
    z_val: float = 0.0
    w_val: float = 1.0

    @staticmethod
    def nanQuaternionr() -> Quaternionr:
        return Quaternionr(math.nan, math.nan, math.nan, math.nan)

    def __mul__(self, other: Quaternionr) -> Quaternionr:
        """Return the Hamilton product."""
        _alike(other, "*", self)
        (x, y, z, w), (a, b, c, d) = self, other
        return Quaternionr(
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        )

    def __truediv__(self, other: Quaternionr | Number) -> Quaternionr:
        if isinstance(other, Quaternionr):
            return self * other.inverse()
        divisor = _number(other, "/", self)
        return Quaternionr(*(value / divisor for value in self))

    def cross(self, other: Quaternionr) -> Quaternionr:
        _alike(other, "cross", self)
        return (self * other - other * self) / 2

    def outer_product(self, other: Quaternionr) -> Quaternionr:
        _alike(other, "outer_product", self)
        return (self.inverse() * other - other.inverse() * self) / 2

    def rotate(self, other: Quaternionr) -> Quaternionr:
        """Return this quaternion rotated by `other`. Raises ValueError unless `other` has length 1."""
        _alike(other, "rotate", self)
        if not math.isclose(other.get_length(), 1.0, rel_tol=1e-6):
            raise ValueError("length of the other Quaternionr must be 1")
        return other * self * other.inverse()

    def conjugate(self) -> Quaternionr:
        return Quaternionr(-self.x_val, -self.y_val, -self.z_val, self.w_val)

    star = conjugate

    def inverse(self) -> Quaternionr:
        return self.conjugate() / self.dot(self)

    def sgn(self) -> Quaternionr:
        """Return the quaternion of length 1 in the same direction."""
        return self / self.get_length()


def _number(value: object, operator: str, left: object) -> float:
    if isinstance(value, Real | np.number):
        return float(value)
    raise _unsupported(operator, left, value)


def _alike(right: object, operator: str, left: object) -> None:
    if not (isinstance(right, type(left)) or isinstance(left, type(right))):
        raise _unsupported(operator, left, right)


def _unsupported(operator: str, left: object, right: object) -> TypeError:
    return TypeError(f"unsupported operand type(s) for {operator}: {type(left).__name__} and {type(right).__name__}")


class Pose(MsgpackMixin):
    position: Vector3r
    orientation: Quaternionr

    def __init__(self, position_val: Vector3r | None = None, orientation_val: Quaternionr | None = None) -> None:
        self.position = Vector3r() if position_val is None else position_val
        self.orientation = Quaternionr() if orientation_val is None else orientation_val

    @staticmethod
    def nanPose() -> Pose:
        return Pose(Vector3r.nanVector3r(), Quaternionr.nanQuaternionr())

    def containsNan(self) -> bool:
        return self.position.containsNan() or self.orientation.containsNan()

    def __iter__(self) -> Iterator[Vector3r | Quaternionr]:
        return iter((self.position, self.orientation))


class GeoPoint(MsgpackMixin):
    """A place on the Earth: degrees, and metres above sea level."""

    latitude: float = 0.0
    longitude: float = 0.0
    altitude: float = 0.0
