"""Where something is: AirSim's poses and points of the Earth."""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from uavaccel.airsim.vectors import Quaternionr, Vector3r
from uavaccel.airsim.wire_type import MsgpackMixin


@dataclass(repr=False, eq=False, init=False)
class Pose(MsgpackMixin):
    position: Vector3r
    orientation: Quaternionr

    def __init__(
        self, position_val: Vector3r | None = None, orientation_val: Quaternionr | None = None
    ) -> None:
        self.position = Vector3r() if position_val is None else position_val
        self.orientation = Quaternionr() if orientation_val is None else orientation_val

    @staticmethod
    def nanPose() -> Pose:
        return Pose(Vector3r.nanVector3r(), Quaternionr.nanQuaternionr())

    def containsNan(self) -> bool:
        return self.position.containsNan() or self.orientation.containsNan()

    def __iter__(self) -> Iterator[Vector3r | Quaternionr]:
        return iter((self.position, self.orientation))


@dataclass(repr=False, eq=False)
class GeoPoint(MsgpackMixin):
    """Degrees, and metres above the sea."""

    latitude: float = 0.0
    longitude: float = 0.0
    altitude: float = 0.0
