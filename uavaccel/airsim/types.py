"""AirSim's types under AirSim's names; the wire carries them as maps of their fields.

Units are SI, positions NED, times in nanoseconds; YawMode alone is in degrees. Vectors in sensors' reports are in the
frame of the body, or of the sensor where that is stated. Sources of names, fields, defaults and the order of arguments:
AirSim v1.8.1, PythonClient/airsim/types.py; of the gains: simple_flight/Params.hpp.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from uavaccel.airsim import vectors
from uavaccel.airsim.vectors import GeoPoint as GeoPoint
from uavaccel.airsim.vectors import MsgpackMixin as MsgpackMixin
from uavaccel.airsim.vectors import Pose as Pose
from uavaccel.airsim.vectors import Quaternionr as Quaternionr
from uavaccel.airsim.vectors import Vector2r as Vector2r
from uavaccel.airsim.vectors import Vector3r as Vector3r


@dataclass
class PIDGains:
    kp: float
    ki: float
    kd: float

    def to_list(self) -> list[float]:
        return [self.kp, self.ki, self.kd]


class _Gains:
    """Base of the gains of three axes, in the order of the fields."""

    def to_lists(self) -> tuple[list[float], list[float], list[float]]:
        """Return kp, ki and kd, each a list of the three axes."""
        kp, ki, kd = zip(*(gains.to_list() for gains in vars(self).values()), strict=True)
        return list(kp), list(ki), list(kd)


@dataclass
class AngleRateControllerGains(_Gains):
    roll_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))
    pitch_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))
    yaw_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))


@dataclass
class AngleLevelControllerGains(_Gains):
    roll_gains: PIDGains = field(default_factory=lambda: PIDGains(2.5, 0, 0))
    pitch_gains: PIDGains = field(default_factory=lambda: PIDGains(2.5, 0, 0))
    yaw_gains: PIDGains = field(default_factory=lambda: PIDGains(2.5, 0, 0))


@dataclass
class VelocityControllerGains(_Gains):
    x_gains: PIDGains = field(default_factory=lambda: PIDGains(0.2, 0, 0))
    y_gains: PIDGains = field(default_factory=lambda: PIDGains(0.2, 0, 0))
    z_gains: PIDGains = field(default_factory=lambda: PIDGains(2.0, 2.0, 0))


@dataclass
class PositionControllerGains(_Gains):
    x_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))
    y_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))
    z_gains: PIDGains = field(default_factory=lambda: PIDGains(0.25, 0, 0))


class GnssFixType(MsgpackMixin):
    GNSS_FIX_NO_FIX, GNSS_FIX_TIME_ONLY, GNSS_FIX_2D_FIX, GNSS_FIX_3D_FIX = range(4)


class RotorStates(MsgpackMixin):
    """A map for each rotor: thrust in N, torque_scaler in N m, speed in rad/s."""

    timestamp: int = 0
    rotors: list[dict[str, float]] = field(default_factory=list)


class LidarData(MsgpackMixin):
    """A flat list of x, y, z in the sensor's frame, in metres, and an ID per point."""

    point_cloud: list[float] | float = 0.0
    time_stamp: int = 0
    pose: Pose = field(default_factory=Pose)
    segmentation: list[int] | int = 0


class ImuData(MsgpackMixin):
    time_stamp: int = 0
    orientation: Quaternionr = field(default_factory=Quaternionr)
    angular_velocity: Vector3r = field(default_factory=Vector3r)
    linear_acceleration: Vector3r = field(default_factory=Vector3r)


class BarometerData(MsgpackMixin):
    """Altitude in m, pressure in Pa, pressure at sea level (qnh) in hPa."""

    time_stamp: int = 0
    altitude: float = 0.0
    pressure: float = 0.0
    qnh: float = 0.0


class MagnetometerData(MsgpackMixin):
    """The magnetic field in gauss, in the body's frame."""

    time_stamp: int = 0
    magnetic_field_body: Vector3r = field(default_factory=Vector3r)
    magnetic_field_covariance: list[float] | float = 0.0


class GnssReport(MsgpackMixin):
    geo_point: GeoPoint = field(default_factory=GeoPoint)
    eph: float = 0.0
    epv: float = 0.0
    velocity: Vector3r = field(default_factory=Vector3r)
    fix_type: int = GnssFixType.GNSS_FIX_NO_FIX
    time_utc: int = 0


class GpsData(MsgpackMixin):
    time_stamp: int = 0
    gnss: GnssReport = field(default_factory=GnssReport)
    is_valid: bool = False


class DistanceSensorData(MsgpackMixin):
    time_stamp: int = 0
    distance: float = 0.0
    min_distance: float = 0.0
    max_distance: float = 0.0
    relative_pose: Pose = field(default_factory=Pose)


class ImageType:
    """AirSim's types of image; DepthPlanar was DepthPlanner before 1.5."""

    Scene, DepthPlanar, DepthPerspective, DepthVis, DisparityNormalized, Segmentation, SurfaceNormals = range(7)
    Infrared, OpticalFlow, OpticalFlowVis = range(7, 10)
    DepthPlanner = DepthPlanar


class DrivetrainType:
    """Whether the nose has to point in the direction of flight."""

    MaxDegreeOfFreedom, ForwardOnly = range(2)


class LandedState:
    Landed, Flying = range(2)


class WeatherParameter:
    Rain, Roadwetness, Snow, RoadSnow, MapleLeaf, RoadLeaf, Dust, Fog, Enabled = range(9)


class CollisionInfo(MsgpackMixin):
    has_collided: bool = False
    normal: Vector3r = field(default_factory=Vector3r)
    impact_point: Vector3r = field(default_factory=Vector3r)
    position: Vector3r = field(default_factory=Vector3r)
    penetration_depth: float = 0.0
    time_stamp: float = 0.0
    object_name: str = ""
    object_id: int = -1


class YawMode(MsgpackMixin):
    """A yaw in degrees, or a rate in degrees per second."""

    is_rate: bool = True
    yaw_or_rate: float = 0.0


class RCData(MsgpackMixin):
    """Sticks from -1 to 1, and switches."""

    timestamp: int = 0
    pitch: float = 0.0
    roll: float = 0.0
    throttle: float = 0.0
    yaw: float = 0.0
    switch1: int = 0
    switch2: int = 0
    switch3: int = 0
    switch4: int = 0
    switch5: int = 0
    switch6: int = 0
    switch7: int = 0
    switch8: int = 0
    is_initialized: bool = False
    is_valid: bool = False


class ImageRequest(MsgpackMixin):
    camera_name: str
    image_type: int
    pixels_as_float: bool
    compress: bool

    def __init__(
        self,
        camera_name: str | int = "0",
        image_type: int = ImageType.Scene,
        pixels_as_float: bool = False,
        compress: bool = True,
    ) -> None:
        self.camera_name = str(camera_name)
        self.image_type = image_type
        self.pixels_as_float = pixels_as_float
        self.compress = compress


class ImageResponse(MsgpackMixin):
    """An image: bytes (PNG, or height x width x 3 in blue, green, red), or a row-major list of floats."""

    image_data_uint8: bytes = b""
    image_data_float: list[float] | float = 0.0
    camera_position: Vector3r = field(default_factory=Vector3r)
    camera_orientation: Quaternionr = field(default_factory=Quaternionr)
    camera_name: str = ""
    time_stamp: int = 0
    message: str = ""
    pixels_as_float: bool = False
    compress: bool = True
    width: int = 0
    height: int = 0
    image_type: int = ImageType.Scene


class KinematicsState(MsgpackMixin):
    position: Vector3r = field(default_factory=Vector3r)
    orientation: Quaternionr = field(default_factory=Quaternionr)
    linear_velocity: Vector3r = field(default_factory=Vector3r)
    angular_velocity: Vector3r = field(default_factory=Vector3r)
    linear_acceleration: Vector3r = field(default_factory=Vector3r)
    angular_acceleration: Vector3r = field(default_factory=Vector3r)


class EnvironmentState(MsgpackMixin):
    """Gravity in m/s^2, pressure in Pa, temperature in K, density in kg/m^3."""

    position: Vector3r = field(default_factory=Vector3r)
    geo_point: GeoPoint = field(default_factory=GeoPoint)
    gravity: Vector3r = field(default_factory=Vector3r)
    air_pressure: float = 0.0
    temperature: float = 0.0
    air_density: float = 0.0


class MultirotorState(MsgpackMixin):
    collision: CollisionInfo = field(default_factory=CollisionInfo)
    kinematics_estimated: KinematicsState = field(default_factory=KinematicsState)
    gps_location: GeoPoint = field(default_factory=GeoPoint)
    timestamp: int = 0
    landed_state: int = LandedState.Landed
    rc_data: RCData = field(default_factory=RCData)
    ready: bool = False
    ready_message: str = ""
    can_arm: bool = False


class ProjectionMatrix(MsgpackMixin):
    matrix: list[list[float]] = field(default_factory=list)


class CameraInfo(MsgpackMixin):
    """The field of view is horizontal, in degrees."""

    pose: Pose = field(default_factory=Pose)
    fov: float = -1
    proj_mat: ProjectionMatrix = field(default_factory=ProjectionMatrix)


class Box2D(MsgpackMixin):
    """Corners in pixels."""

    min: Vector2r = field(default_factory=Vector2r)
    max: Vector2r = field(default_factory=Vector2r)


class Box3D(MsgpackMixin):
    """Corners in metres."""

    min: Vector3r = field(default_factory=Vector3r)
    max: Vector3r = field(default_factory=Vector3r)


class DetectionInfo(MsgpackMixin):
    name: str = ""
    geo_point: GeoPoint = field(default_factory=GeoPoint)
    box2D: Box2D = field(default_factory=Box2D)  # noqa: N815
    box3D: Box3D = field(default_factory=Box3D)  # noqa: N815
    relative_pose: Pose = field(default_factory=Pose)


class MeshPositionVertexBuffersResponse(MsgpackMixin):
    position: Vector3r = field(default_factory=Vector3r)
    orientation: Quaternionr = field(default_factory=Quaternionr)
    vertices: list[float] | float = 0.0
    indices: list[int] | float = 0.0
    name: str = ""


class CarControls(MsgpackMixin):
    """For scripts that import it; no car drives here."""

    throttle: float = 0.0
    steering: float = 0.0
    brake: float = 0.0
    handbrake: bool = False
    is_manual_gear: bool = False
    manual_gear: int = 0
    gear_immediate: bool = True


class CarState(MsgpackMixin):
    """For scripts that import it; no car drives here."""

    speed: float = 0.0
    gear: int = 0
    rpm: float = 0.0
    maxrpm: float = 0.0
    handbrake: bool = False
    collision: CollisionInfo = field(default_factory=CollisionInfo)
    kinematics_estimated: KinematicsState = field(default_factory=KinematicsState)
    timestamp: int = 0


if not TYPE_CHECKING:  # `from airsim import *` takes what is defined here, and nothing that is imported
    _HOMES = (__name__, vectors.__name__)
    __all__ = [name for name, kind in vars().items() if getattr(kind, "__module__", "") in _HOMES and name[0] != "_"]
