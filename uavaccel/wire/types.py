"""AirSim's types on the wire: the maps of answers, and the coercions that convert or refuse a client's values.

A coercion takes a value and the parameter's name, which the ValueError that it raises mentions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, get_origin

from uavaccel.kinematics import Kinematics, Quaternion, Vector
from uavaccel.sim.earth import GeoPoint
from uavaccel.sim.poses import LONGEST_NAME, Pose
from uavaccel.sim.vehicle.autopilot import Yaw
from uavaccel.wire.rpc import Received

LARGEST = 3.4028235e38  # of single precision, AirSim's real_T
FARTHEST_M = 1e6  # the farthest place that the physics resolves
Coercion = Callable[[object, str], object]
EPOCH_NS = 1_577_836_800_000_000_000  # 1 January 2020, 0 h UTC: when simulated time begins on AirSim's calls


def stamp(time_ns: int) -> int:
    """Return a simulated time as AirSim's time stamp, in nanoseconds since 1970; the same in every run."""
    return EPOCH_NS + time_ns


def vector_map(vector: Vector) -> dict[str, float]:
    x, y, z = vector
    return {"x_val": x, "y_val": y, "z_val": z}


def quaternion_map(quaternion: Quaternion) -> dict[str, float]:
    w, x, y, z = quaternion
    return {"w_val": w, "x_val": x, "y_val": y, "z_val": z}


def kinematics_map(kinematics: Kinematics) -> dict[str, dict[str, float]]:
    return pose_map(kinematics) | {
        "linear_velocity": vector_map(kinematics.linear_velocity_m_s),
        "angular_velocity": vector_map(kinematics.angular_velocity_rad_s),
        "linear_acceleration": vector_map(kinematics.linear_acceleration_m_s2),
        "angular_acceleration": vector_map(kinematics.angular_acceleration_rad_s2),
    }


def pose_map(pose: Pose | Kinematics) -> dict[str, dict[str, float]]:
    return {"position": vector_map(pose.position_m), "orientation": quaternion_map(pose.orientation_wxyz)}


def geo_map(point: GeoPoint) -> dict[str, float]:
    return {"latitude": point.latitude, "longitude": point.longitude, "altitude": point.altitude}


def coercion_of(annotation: object) -> Coercion:
    """The coercion of an annotated type, or of one in `PLAIN`. Raises TypeError for any other."""
    if get_origin(annotation) is Annotated:
        coercion: Coercion = annotation.__metadata__[0]  # type: ignore[attr-defined]
        return coercion
    if annotation not in PLAIN:
        raise TypeError(f"no client's value becomes {annotation}; there are {', '.join(map(str, PLAIN))}")
    return PLAIN[annotation]


def number(value: object, name: str) -> float:
    """A finite number in the range of single precision."""
    if type(value) is not float and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise ValueError(f"{name} must be a number, not {type(value).__name__}")
    if not abs(value) <= LARGEST:
        raise ValueError(f"{name} must be finite, not {value}")
    return float(value)


def whole(value: object, name: str) -> int:
    """A whole number of 32 bits."""
    wide = number(value, name)
    if wide != int(wide) or abs(wide) >= 1 << 31:
        raise ValueError(f"{name} must be a whole number of 32 bits, not {wide:g}")
    return int(wide)


def flag(value: object, name: str) -> bool:
    """A truth value, or 1 or 0, as clients in C++ may pack it."""
    if not isinstance(value, bool | int):
        raise ValueError(f"{name} must be true or false, not {type(value).__name__}")
    return bool(value)


def text(value: object, name: str) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{name} must be a text, not {type(value).__name__}")
    return value


def object_name(value: object, name: str) -> str:
    named = text(value, name)
    if len(named) > LONGEST_NAME:
        raise ValueError(f"{name} must have at most {LONGEST_NAME} characters, not {len(named)}")
    return named


def coordinate(value: object, name: str) -> float:
    metres = number(value, name)
    if abs(metres) > FARTHEST_M:
        raise ValueError(f"{name} must be within {FARTHEST_M:g} m, not {metres:g}")
    return metres


def place(value: object, name: str) -> Vector:
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a Vector3r, not {type(value).__name__}")
    x, y, z = (coordinate(value.get(key), f"{name}.{key}") for key in ("x_val", "y_val", "z_val"))
    return x, y, z


def vector(value: Received, name: str) -> Vector:
    try:
        x, y, z = (number(value[key], f"{name}.{key}") for key in ("x_val", "y_val", "z_val"))
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError(f"{name} must be {{x_val, y_val, z_val}}") from error
    return x, y, z


def pose(value: Received, name: str) -> Pose:
    """A Pose with its orientation normalised; NaN is allowed."""
    try:
        position, orientation = value["position"], value["orientation"]
        x, y, z = (float(position[key]) for key in ("x_val", "y_val", "z_val"))
        wxyz = tuple(float(orientation[key]) for key in ("w_val", "x_val", "y_val", "z_val"))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError("pose must be {position: {x_val, ...}, orientation: {w_val, ...}}") from error
    length = math.hypot(*wxyz)
    if length in (0.0, math.inf) or any(abs(place) > FARTHEST_M for place in (x, y, z)):
        raise ValueError(f"pose must be within {FARTHEST_M:g} m, its orientation finite and not zero")
    w, i, j, k = (part / length for part in wxyz)
    return Pose((x, y, z), (w, i, j, k))


def finite(given: Pose) -> Pose:
    """The pose itself. Raises ValueError if a part of it is NaN."""
    if math.isnan(sum(given.position_m) + sum(given.orientation_wxyz)):
        raise ValueError("pose must be finite")
    return given


def point(value: Received, name: str) -> GeoPoint | Vector:
    """A GeoPoint on the Earth, or a Vector3r in metres of the world, which scripts send in its place."""
    if isinstance(value, Mapping) and "x_val" in value:
        return place(value, name)
    try:
        latitude, longitude, altitude = (number(value[key], key) for key in ("latitude", "longitude", "altitude"))
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError("a point must be {latitude, longitude, altitude}") from error
    if abs(latitude) > 90.0 or abs(longitude) > 360.0:
        within = "a latitude within 90 degrees and a longitude within 360"
        raise ValueError(f"a point must have {within}, not {[latitude, longitude]}")
    return GeoPoint(latitude, longitude, altitude)


def yaw_mode(value: object, name: str) -> Yaw:
    """A YawMode, in degrees or degrees per second."""
    if not isinstance(value, dict):
        raise ValueError(f"{name} must be a map, not {type(value).__name__}")
    is_rate = flag(value.get("is_rate", True), f"{name}.is_rate")
    return Yaw(math.radians(number(value.get("yaw_or_rate", 0.0), f"{name}.yaw_or_rate")), is_rate)


PLAIN: dict[object, Coercion] = {float: number, int: whole, bool: flag, str: text, object: lambda value, _: value}
Truthy = Annotated[bool, lambda value, _: bool(value)]
ObjectName = Annotated[str, object_name]
VehicleName = Annotated[str, lambda value, _: str(value)]  # the call itself refuses an unknown one
Coordinate = Annotated[float, coordinate]
Vector3r = Annotated[Vector, vector]
AnyPose = Annotated[Pose, pose]
FinitePose = Annotated[Pose, lambda value, name: finite(pose(value, name))]
Point = Annotated[GeoPoint | Vector, point]
YawMode = Annotated[Yaw, yaw_mode]
