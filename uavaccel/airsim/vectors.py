"""AirSim's vectors and quaternions, with its operators. Source: AirSim v1.8.1, PythonClient/airsim/types.py."""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from uavaccel.airsim.wire_type import MsgpackMixin

FloatArray = NDArray[np.float32]
Number = float | np.floating | np.integer


@dataclass(repr=False)
class Vector2r(MsgpackMixin):
    x_val: float = 0.0
    y_val: float = 0.0


@dataclass(repr=False, eq=False)
class Vector3r(MsgpackMixin):
    x_val: float = 0.0
    y_val: float = 0.0
    z_val: float = 0.0

    @staticmethod
    def nanVector3r() -> Vector3r:
        return Vector3r(math.nan, math.nan, math.nan)

    def containsNan(self) -> bool:
        return any(math.isnan(value) for value in self)

    def __add__(self, other: Vector3r) -> Vector3r:
        return Vector3r(*(mine + its for mine, its in zip(self, other, strict=True)))

    def __sub__(self, other: Vector3r) -> Vector3r:
        return Vector3r(*(mine - its for mine, its in zip(self, other, strict=True)))

    def __mul__(self, other: Number) -> Vector3r:
        factor = _number(other, "*", self)
        return Vector3r(*(value * factor for value in self))

    def __truediv__(self, other: Number) -> Vector3r:
        divisor = _number(other, "/", self)
        return Vector3r(*(value / divisor for value in self))

    def dot(self, other: Vector3r) -> float:
        _alike(other, "dot", self)
        return float(sum(mine * its for mine, its in zip(self, other, strict=True)))

    def cross(self, other: Vector3r) -> Vector3r:
        _alike(other, "cross", self)
        (a, b, c), (x, y, z) = self, other
        return Vector3r(b * z - c * y, c * x - a * z, a * y - b * x)

    def get_length(self) -> float:
        return math.sqrt(self.dot(self))

    def distance_to(self, other: Vector3r) -> float:
        return (self - other).get_length()

    def to_Quaternionr(self) -> Quaternionr:
        """The quaternion without a scalar part."""
        return Quaternionr(self.x_val, self.y_val, self.z_val, 0.0)

    def to_numpy_array(self) -> FloatArray:
        return np.array([*self], np.float32)

    def __iter__(self) -> Iterator[float]:
        return iter((self.x_val, self.y_val, self.z_val))


@dataclass(repr=False, eq=False)
class Quaternionr(MsgpackMixin):
    """A quaternion; the scalar part comes last among the arguments and first nowhere else in AirSim's clients."""

    x_val: float = 0.0
    y_val: float = 0.0
    z_val: float = 0.0
    w_val: float = 1.0

    @staticmethod
    def nanQuaternionr() -> Quaternionr:
        return Quaternionr(math.nan, math.nan, math.nan, math.nan)

    def containsNan(self) -> bool:
        return any(math.isnan(value) for value in self)

    def __add__(self, other: Quaternionr) -> Quaternionr:
        _alike(other, "+", self)
        return Quaternionr(*(mine + its for mine, its in zip(self, other, strict=True)))

    def __sub__(self, other: Quaternionr) -> Quaternionr:
        _alike(other, "-", self)
        return Quaternionr(*(mine - its for mine, its in zip(self, other, strict=True)))

    def __mul__(self, other: Quaternionr) -> Quaternionr:
        """Hamilton's product."""
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

    def dot(self, other: Quaternionr) -> float:
        _alike(other, "dot", self)
        return float(sum(mine * its for mine, its in zip(self, other, strict=True)))

    def cross(self, other: Quaternionr) -> Quaternionr:
        _alike(other, "cross", self)
        return (self * other - other * self) / 2

    def outer_product(self, other: Quaternionr) -> Quaternionr:
        _alike(other, "outer_product", self)
        return (self.inverse() * other - other.inverse() * self) / 2

    def rotate(self, other: Quaternionr) -> Quaternionr:
        """This one turned by `other`. Raises ValueError unless that has length 1."""
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
        """The quaternion of length 1 in the same direction."""
        return self / self.get_length()

    def get_length(self) -> float:
        return math.sqrt(self.dot(self))

    def to_numpy_array(self) -> FloatArray:
        """x, y, z, w."""
        return np.array([*self], np.float32)

    def __iter__(self) -> Iterator[float]:
        return iter((self.x_val, self.y_val, self.z_val, self.w_val))


def _number(value: object, operator: str, left: object) -> float:
    if isinstance(value, Real | np.number):
        return float(value)
    raise _unsupported(operator, left, value)


def _alike(right: object, operator: str, left: object) -> None:
    if type(right) is not type(left):
        raise _unsupported(operator, left, right)


def _unsupported(operator: str, left: object, right: object) -> TypeError:
    return TypeError(
        f"unsupported operand type(s) for {operator}: {type(left).__name__} and {type(right).__name__}"
    )
