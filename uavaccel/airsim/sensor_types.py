"""What AirSim's sensors report. SI units, times in nanoseconds; frames are the body's, or the sensor's where said."""

from __future__ import annotations

from dataclasses import dataclass, field

from uavaccel.airsim.poses import GeoPoint, Pose
from uavaccel.airsim.vectors import Quaternionr, Vector3r
from uavaccel.airsim.wire_type import MsgpackMixin


class GnssFixType(MsgpackMixin):
    GNSS_FIX_NO_FIX = 0
    GNSS_FIX_TIME_ONLY = 1
    GNSS_FIX_2D_FIX = 2
    GNSS_FIX_3D_FIX = 3


@dataclass(repr=False, eq=False)
class RotorStates(MsgpackMixin):
    """Per rotor a map: thrust in N, torque_scaler in N m, speed in rad/s."""

    timestamp: int = 0
    rotors: list[dict[str, float]] = field(default_factory=list)


@dataclass(repr=False, eq=False)
class LidarData(MsgpackMixin):
    """A flat list of x, y, z in the sensor's frame, in metres, and an ID per point."""

    point_cloud: list[float] | float = 0.0
    time_stamp: int = 0
    pose: Pose = field(default_factory=Pose)
    segmentation: list[int] | int = 0


@dataclass(repr=False, eq=False)
class ImuData(MsgpackMixin):
    time_stamp: int = 0
    orientation: Quaternionr = field(default_factory=Quaternionr)
    angular_velocity: Vector3r = field(default_factory=Vector3r)
    linear_acceleration: Vector3r = field(default_factory=Vector3r)


@dataclass(repr=False, eq=False)
class BarometerData(MsgpackMixin):
    """Altitude in m, pressure in Pa, the sea's pressure (qnh) in hPa."""

    time_stamp: int = 0
    altitude: float = 0.0
    pressure: float = 0.0
    qnh: float = 0.0


@dataclass(repr=False, eq=False)
class MagnetometerData(MsgpackMixin):
    """The field in gauss, in the body's frame."""

    time_stamp: int = 0
    magnetic_field_body: Vector3r = field(default_factory=Vector3r)
    magnetic_field_covariance: list[float] | float = 0.0


@dataclass(repr=False, eq=False)
class GnssReport(MsgpackMixin):
    geo_point: GeoPoint = field(default_factory=GeoPoint)
    eph: float = 0.0
    epv: float = 0.0
    velocity: Vector3r = field(default_factory=Vector3r)
    fix_type: int = GnssFixType.GNSS_FIX_NO_FIX
    time_utc: int = 0


@dataclass(repr=False, eq=False)
class GpsData(MsgpackMixin):
    time_stamp: int = 0
    gnss: GnssReport = field(default_factory=GnssReport)
    is_valid: bool = False


@dataclass(repr=False, eq=False)
class DistanceSensorData(MsgpackMixin):
    time_stamp: int = 0
    distance: float = 0.0
    min_distance: float = 0.0
    max_distance: float = 0.0
    relative_pose: Pose = field(default_factory=Pose)
