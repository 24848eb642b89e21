"""What there is to be sensed at one tick."""

from __future__ import annotations

from typing import NamedTuple

from uavaccel.kinematics import Kinematics
from uavaccel.sim.poses import Pose
from uavaccel.sim.sensors.earth import GeoPoint, geographic
from uavaccel.units import NS_PER_S


class Truth(NamedTuple):
    """A vehicle's state, the simulation's tick, seconds since the last reset, and the place of NED's origin."""

    kinematics: Kinematics
    tick_s: float
    since_reset_s: float
    home: GeoPoint
    body: str = "quadrotor"  # the vehicle's in the model, which no ray meets

    @property
    def time_s(self) -> float:
        return self.kinematics.time_ns / NS_PER_S

    @property
    def sample(self) -> int:
        """The number of the tick since the simulation was made."""
        return round(self.time_s / self.tick_s)

    @property
    def pose(self) -> Pose:
        return Pose(self.kinematics.position_m, self.kinematics.orientation_wxyz)

    @property
    def place(self) -> GeoPoint:
        return geographic(self.kinematics.position_m, self.home)
