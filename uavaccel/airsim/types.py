"""AirSim's types under AirSim's names; the wire carries them as maps of their fields.

Units are SI, positions NED, times in nanoseconds; YawMode alone is in degrees. Vectors in sensors' reports are in the
frame of the body, or of the sensor where that is stated. Sources of names, fields, defaults and the order of arguments:
AirSim v1.8.1, PythonClient/airsim/types.py; of the gains: simple_flight/Params.hpp.
"""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from numbers import Real
from pprint import pformat
from typing import TYPE_CHECKING, Self, dataclass_transform

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
        return float(sum(map(operator.mul, self, other)))

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
    GNSS_FIX_NO_FIX = 0
    GNSS_FIX_TIME_ONLY = 1
    GNSS_FIX_2D_FIX = 2
    GNSS_FIX_3D_FIX = 3


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
    """AirSim's types of image."""

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
    """Whether the nose has to point in the direction of flight."""

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
    __all__ = [name for name, kind in vars().items() if getattr(kind, "__module__", "") == __name__ and name[0] != "_"]
