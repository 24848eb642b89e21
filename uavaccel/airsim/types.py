"""AirSim's types, by its names: what the wire carries as maps of their fields.

Units are SI, positions NED, times nanoseconds; YawMode alone has degrees. Source of names, fields, defaults and the
order of arguments: AirSim v1.8.1, PythonClient/airsim/types.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from uavaccel.airsim.gains import (
    AngleLevelControllerGains,
    AngleRateControllerGains,
    PIDGains,
    PositionControllerGains,
    VelocityControllerGains,
)
from uavaccel.airsim.poses import GeoPoint, Pose
from uavaccel.airsim.sensor_types import (
    BarometerData,
    DistanceSensorData,
    GnssFixType,
    GnssReport,
    GpsData,
    ImuData,
    LidarData,
    MagnetometerData,
    RotorStates,
)
from uavaccel.airsim.vectors import Quaternionr, Vector2r, Vector3r
from uavaccel.airsim.wire_type import MsgpackMixin

__all__ = [
    "AngleLevelControllerGains",
    "AngleRateControllerGains",
    "BarometerData",
    "Box2D",
    "Box3D",
    "CameraInfo",
    "CarControls",
    "CarState",
    "CollisionInfo",
    "DetectionInfo",
    "DistanceSensorData",
    "DrivetrainType",
    "EnvironmentState",
    "GeoPoint",
    "GnssFixType",
    "GnssReport",
    "GpsData",
    "ImageRequest",
    "ImageResponse",
    "ImageType",
    "ImuData",
    "KinematicsState",
    "LandedState",
    "LidarData",
    "MagnetometerData",
    "MeshPositionVertexBuffersResponse",
    "MsgpackMixin",
    "MultirotorState",
    "PIDGains",
    "Pose",
    "PositionControllerGains",
    "ProjectionMatrix",
    "Quaternionr",
    "RCData",
    "RotorStates",
    "Vector2r",
    "Vector3r",
    "VelocityControllerGains",
    "WeatherParameter",
    "YawMode",
]


class ImageType:
    """Kinds of images."""

    Scene = 0
    DepthPlanar = 1
    DepthPlanner = 1  # before 1.5
    DepthPerspective = 2
    DepthVis = 3
    DisparityNormalized = 4
    Segmentation = 5
    SurfaceNormals = 6
    Infrared = 7
    OpticalFlow = 8
    OpticalFlowVis = 9


class DrivetrainType:
    """Whether the nose has to point where the vehicle flies."""

    MaxDegreeOfFreedom = 0
    ForwardOnly = 1


class LandedState:
    Landed = 0
    Flying = 1


class WeatherParameter:
    Rain = 0
    Roadwetness = 1
    Snow = 2
    RoadSnow = 3
    MapleLeaf = 4
    RoadLeaf = 5
    Dust = 6
    Fog = 7
    Enabled = 8


@dataclass(repr=False, eq=False)
class CollisionInfo(MsgpackMixin):
    has_collided: bool = False
    normal: Vector3r = field(default_factory=Vector3r)
    impact_point: Vector3r = field(default_factory=Vector3r)
    position: Vector3r = field(default_factory=Vector3r)
    penetration_depth: float = 0.0
    time_stamp: float = 0.0
    object_name: str = ""
    object_id: int = -1


@dataclass(repr=False, eq=False)
class YawMode(MsgpackMixin):
    """A yaw in degrees, or a rate in degrees per second."""

    is_rate: bool = True
    yaw_or_rate: float = 0.0


@dataclass(repr=False, eq=False)
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


@dataclass(repr=False, eq=False, init=False)
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


@dataclass(repr=False, eq=False)
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


@dataclass(repr=False, eq=False)
class KinematicsState(MsgpackMixin):
    position: Vector3r = field(default_factory=Vector3r)
    orientation: Quaternionr = field(default_factory=Quaternionr)
    linear_velocity: Vector3r = field(default_factory=Vector3r)
    angular_velocity: Vector3r = field(default_factory=Vector3r)
    linear_acceleration: Vector3r = field(default_factory=Vector3r)
    angular_acceleration: Vector3r = field(default_factory=Vector3r)


@dataclass(repr=False, eq=False)
class EnvironmentState(MsgpackMixin):
    """Gravity in m/s^2, pressure in Pa, temperature in K, density in kg/m^3."""

    position: Vector3r = field(default_factory=Vector3r)
    geo_point: GeoPoint = field(default_factory=GeoPoint)
    gravity: Vector3r = field(default_factory=Vector3r)
    air_pressure: float = 0.0
    temperature: float = 0.0
    air_density: float = 0.0


@dataclass(repr=False, eq=False)
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


@dataclass(repr=False, eq=False)
class ProjectionMatrix(MsgpackMixin):
    matrix: list[list[float]] = field(default_factory=list)


@dataclass(repr=False, eq=False)
class CameraInfo(MsgpackMixin):
    """The field of view is horizontal, in degrees."""

    pose: Pose = field(default_factory=Pose)
    fov: float = -1
    proj_mat: ProjectionMatrix = field(default_factory=ProjectionMatrix)


@dataclass(repr=False, eq=False)
class Box2D(MsgpackMixin):
    """Corners in pixels."""

    min: Vector2r = field(default_factory=Vector2r)
    max: Vector2r = field(default_factory=Vector2r)


@dataclass(repr=False, eq=False)
class Box3D(MsgpackMixin):
    """Corners in metres."""

    min: Vector3r = field(default_factory=Vector3r)
    max: Vector3r = field(default_factory=Vector3r)


@dataclass(repr=False, eq=False)
class DetectionInfo(MsgpackMixin):
    name: str = ""
    geo_point: GeoPoint = field(default_factory=GeoPoint)
    box2D: Box2D = field(default_factory=Box2D)  # noqa: N815
    box3D: Box3D = field(default_factory=Box3D)  # noqa: N815
    relative_pose: Pose = field(default_factory=Pose)


@dataclass(repr=False, eq=False)
class MeshPositionVertexBuffersResponse(MsgpackMixin):
    position: Vector3r = field(default_factory=Vector3r)
    orientation: Quaternionr = field(default_factory=Quaternionr)
    vertices: list[float] | float = 0.0
    indices: list[int] | float = 0.0
    name: str = ""


@dataclass(repr=False, eq=False)
class CarControls(MsgpackMixin):
    """For scripts that import it; no car drives here."""

    throttle: float = 0.0
    steering: float = 0.0
    brake: float = 0.0
    handbrake: bool = False
    is_manual_gear: bool = False
    manual_gear: int = 0
    gear_immediate: bool = True


@dataclass(repr=False, eq=False)
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
