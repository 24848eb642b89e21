"""AirSim's wire types in the answers of calls: maps by field name."""

from __future__ import annotations

from uavaccel.kinematics import Kinematics, Quaternion, Vector
from uavaccel.sim.earth import GeoPoint
from uavaccel.sim.poses import Pose

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


def no_collision_map() -> dict[str, object]:
    """Return the CollisionInfo of a vehicle that has not collided."""
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


def rc_data_map() -> dict[str, object]:
    """Return the RCData of a vehicle without a remote control."""
    sticks = dict.fromkeys(("pitch", "roll", "throttle", "yaw", "left_z", "right_z"), 0.0)
    return {"timestamp": 0, **sticks, "switches": 0, "vendor_id": "", "is_initialized": False, "is_valid": False}
