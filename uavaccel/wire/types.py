"""AirSim's wire types: maps by field name, and the checks that arguments have to pass."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from uavaccel.kinematics import Kinematics, Quaternion, Vector
from uavaccel.sim.sensors.earth import GeoPoint

STRONGEST_WIND_M_S = 100.0  # more than any storm's
EPOCH_NS = 1_577_836_800_000_000_000  # 1 January 2020, 0 h UTC: when simulated time begins on AirSim's calls
LARGEST = 3.4028235e38  # of single precision, AirSim's real_T
FARTHEST_M = 1e6  # a place that physics still resolves


def stamp(time_ns: int) -> int:
    """Simulated time as AirSim tells it, in nanoseconds since 1970; the same in every run."""
    return EPOCH_NS + time_ns


def vector_map(vector: Vector) -> dict[str, float]:
    return dict(zip(("x_val", "y_val", "z_val"), vector, strict=True))


def quaternion_map(quaternion: Quaternion) -> dict[str, float]:
    return dict(zip(("w_val", "x_val", "y_val", "z_val"), quaternion, strict=True))


def kinematics_map(kinematics: Kinematics) -> dict[str, Any]:
    """KinematicsState."""
    return {
        "position": vector_map(kinematics.position_m),
        "orientation": quaternion_map(kinematics.orientation_wxyz),
        "linear_velocity": vector_map(kinematics.linear_velocity_m_s),
        "angular_velocity": vector_map(kinematics.angular_velocity_rad_s),
        "linear_acceleration": vector_map(kinematics.linear_acceleration_m_s2),
        "angular_acceleration": vector_map(kinematics.angular_acceleration_rad_s2),
    }


def pose_map(kinematics: Kinematics) -> dict[str, Any]:
    return {
        "position": vector_map(kinematics.position_m),
        "orientation": quaternion_map(kinematics.orientation_wxyz),
    }


def geo_map(point: GeoPoint) -> dict[str, float]:
    """GeoPoint."""
    return {"latitude": point.latitude, "longitude": point.longitude, "altitude": point.altitude}


def no_collision_map() -> dict[str, Any]:
    """CollisionInfo of a vehicle that has touched nothing."""
    zero = vector_map((0.0, 0.0, 0.0))
    return {
        "has_collided": False,
        "penetration_depth": 0.0,
        "time_stamp": 0,
        "normal": zero,
        "impact_point": zero,
        "position": zero,
        "object_name": "",
        "object_id": -1,
    }


def rc_data_map() -> dict[str, Any]:
    """RCData of a vehicle without a remote control."""
    sticks = dict.fromkeys(("pitch", "roll", "throttle", "yaw", "left_z", "right_z"), 0.0)
    return {
        "timestamp": 0,
        **sticks,
        "switches": 0,
        "vendor_id": "",
        "is_initialized": False,
        "is_valid": False,
    }


def number(value: Any, name: str) -> float:
    """A finite number of single precision's range; raises ValueError."""
    if type(value) is not float and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise ValueError(f"{name} must be a number, not {type(value).__name__}")
    if not abs(value) <= LARGEST:
        raise ValueError(f"{name} must be finite, not {value}")
    return float(value)


def whole(value: Any, name: str) -> int:
    """A whole number of 32 bits; raises ValueError."""
    wide = number(value, name)
    if wide != int(wide) or abs(wide) >= 1 << 31:
        raise ValueError(f"{name} must be a whole number of 32 bits, not {wide:g}")
    return int(wide)


def coordinate(value: Any, name: str) -> float:
    """Metres from the origin; raises ValueError."""
    metres = number(value, name)
    if abs(metres) > FARTHEST_M:
        raise ValueError(f"{name} must be within {FARTHEST_M:g} m, not {metres:g}")
    return metres


def place(value: Any, name: str) -> Vector:
    """A Vector3r in metres; raises ValueError."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a Vector3r, not {type(value).__name__}")
    x, y, z = (coordinate(value.get(key), f"{name}.{key}") for key in ("x_val", "y_val", "z_val"))
    return x, y, z


def pose(value: Any) -> tuple[Vector, Quaternion]:
    """A Pose's position and unit wxyz orientation, NaN allowed; raises ValueError."""
    try:
        position, orientation = value["position"], value["orientation"]
        xyz = tuple(float(position[key]) for key in ("x_val", "y_val", "z_val"))
        wxyz = tuple(float(orientation[key]) for key in ("w_val", "x_val", "y_val", "z_val"))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError("pose must be {position: {x_val, ...}, orientation: {w_val, ...}}") from error
    length = math.hypot(*wxyz)
    if length in (0.0, math.inf) or any(abs(place) > FARTHEST_M for place in xyz):
        raise ValueError(f"pose must be within {FARTHEST_M:g} m, its orientation finite and not zero")
    return xyz, tuple(part / length for part in wxyz)  # type: ignore[return-value]


def vector(value: Any, name: str) -> Vector:
    """A Vector3r of finite numbers; raises ValueError."""
    try:
        x, y, z = (number(value[key], f"{name}.{key}") for key in ("x_val", "y_val", "z_val"))
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError(f"{name} must be {{x_val, y_val, z_val}}") from error
    return x, y, z


def geo_point(value: Any) -> GeoPoint:
    """A GeoPoint on the Earth; raises ValueError."""
    try:
        parts = [number(value[key], key) for key in ("latitude", "longitude", "altitude")]
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError("a point must be {latitude, longitude, altitude}") from error
    if abs(parts[0]) > 90.0 or abs(parts[1]) > 360.0:
        raise ValueError(
            f"a point must have a latitude within 90 degrees and a longitude within 360, not {parts[:2]}"
        )
    return GeoPoint(*parts)


def wind(value: Vector) -> Vector:
    """A wind that physics can follow; raises ValueError."""
    if not math.hypot(*value) <= STRONGEST_WIND_M_S:
        raise ValueError(f"wind must be at most {STRONGEST_WIND_M_S:g} m/s, not {math.hypot(*value):g}")
    return value


def flag(value: Any, name: str) -> bool:
    """A truth value; raises ValueError."""
    if not isinstance(value, bool | int):
        raise ValueError(f"{name} must be true or false, not {type(value).__name__}")
    return bool(value)


def yaw_mode(value: Any) -> tuple[bool, float]:
    """YawMode {is_rate, yaw_or_rate in degrees or deg/s} as (is_rate, rad or rad/s); raises ValueError."""
    if type(value) is not dict and not isinstance(value, Mapping):
        raise ValueError(f"yaw_mode must be a map, not {type(value).__name__}")
    is_rate = flag(value.get("is_rate", True), "yaw_mode.is_rate")
    return is_rate, math.radians(number(value.get("yaw_or_rate", 0.0), "yaw_mode.yaw_or_rate"))
