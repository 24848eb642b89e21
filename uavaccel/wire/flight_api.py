"""AirSim's flight commands, from paths down to attitudes, body rates, motors, the remote control and the gains.

Sources: AirSim v1.8.1, MultirotorRpcLibServer.cpp (names, orders), MultirotorApiBase.cpp and SimpleFlightApi.hpp
(behaviour, answers). A command returns False if it is interrupted; otherwise one with a duration returns True at its
end, one to a place on arrival. Attitudes are in radians, FRD; throttle and motors range from 0 to 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated

import numpy as np

from uavaccel.kinematics import Kinematics, Vector
from uavaccel.sim import flight
from uavaccel.sim.earth import GeoPoint, geographic, ned_of
from uavaccel.sim.simulation import DeferredReply, Pilot
from uavaccel.sim.vehicle.autopilot import POSITION, STRAIGHT_ON, THROTTLE, Goal, Yaw
from uavaccel.units import euler_from_quaternion
from uavaccel.wire.calls import Calls, call, command
from uavaccel.wire.types import Coordinate, VehicleName, YawMode, coordinate, flag, number, place

FORWARD_ONLY = 1
LONGEST_S = 1e9  # longer durations are cut to this: AirSim's clients send 3e38 for ever
TAKEOFF_M, TAKEOFF_M_S = 2.0, 0.5
AUTO_LOOKAHEAD, ADAPTIVE = -1.0, 1.0

Answer = DeferredReply | bool
LARGEST_GAIN = 1e3  # thousands of times SimpleFlight's gains
STICK_NAMES = ("roll", "pitch", "throttle", "yaw")  # in the order of manual.Sticks


def places(value: object, name: str) -> list[Vector]:
    if not isinstance(value, list):
        raise ValueError(f"{name} must be a list of Vector3r")
    return [place(point, name) for point in value]


Seconds = Annotated[float, lambda value, name: min(number(value, name), LONGEST_S)]


class FlightApi(Calls, title="Flight"):
    """Speeds are metres per second, time-outs simulated seconds."""

    # --- to a place -------------------------------------------------------------------------------

    @command("takeoff")
    def takeoff(self, timeout_sec: float, vehicle: VehicleName = "") -> Answer:
        """Climb 2 m. Raises ValueError while the vehicle moves."""
        now = (pilot := self._taken(vehicle)).kinematics()
        if (speed := math.hypot(*now.linear_velocity_m_s)) > flight.AT_REST_M_S:
            raise ValueError(f"Cannot perform takeoff because vehicle is already moving with velocity {speed:f} m/s")
        north, east, down = now.position_m
        return self._fly_to(pilot, (north, east, down - TAKEOFF_M), TAKEOFF_M_S, timeout_sec)

    @command("land")
    def land(self, timeout_sec: float, vehicle: VehicleName = "") -> Answer:
        """Sink at 0.2 m/s until the ground stops the vehicle."""
        return self._taken(vehicle).start(flight.Land(timeout_sec), self.wall_ns)

    @command("goHome")
    def go_home(self, timeout_sec: float, vehicle: VehicleName = "") -> Answer:
        """Fly to the origin of the vehicle's frame at 0.5 m/s."""
        return self._fly_to(self._taken(vehicle), (0.0, 0.0, 0.0), TAKEOFF_M_S, timeout_sec)

    @call("hover", joined=True)
    def hover(self, vehicle: VehicleName = "") -> Answer:
        """End the running command; position hold follows after the goal time-out. Returns False, as in AirSim."""
        self._taken(vehicle)
        return False

    @call("cancelLastTask")
    def cancel(self, vehicle: VehicleName = "") -> None:
        self._taken(vehicle)

    @command("moveToPosition")
    def move_to_position(
        self, x: Coordinate, y: Coordinate, z: Coordinate, velocity: float, timeout_sec: float,
        drivetrain: float, yaw_mode: YawMode, lookahead: float, adaptive_lookahead: float,
        vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        how = (velocity, timeout_sec, drivetrain, yaw_mode, lookahead, adaptive_lookahead, vehicle)
        return self.move_on_path([(x, y, z)], *how)

    @command("moveToZ")
    def move_to_z(
        self, z: Coordinate, velocity: float, timeout_sec: float, yaw_mode: YawMode, lookahead: float,
        adaptive_lookahead: float, vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        north, east, _ = self.scenery.flying_pilot(vehicle).kinematics().position_m
        how = (velocity, timeout_sec, 0, yaw_mode, lookahead, adaptive_lookahead, vehicle)
        return self.move_on_path([(north, east, z)], *how)

    @command("moveToGPS")
    def move_to_gps(
        self, latitude: float, longitude: float, altitude: float, velocity: float, timeout_sec: float,
        drivetrain: float, yaw_mode: YawMode, lookahead: float, adaptive_lookahead: float,
        vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        """Fly to a place given in degrees and metres above sea level."""
        origin_m = self.scenery.flying_pilot(vehicle).vehicle.origin_m
        home = geographic(origin_m, self.scenery.settings.home)
        north, east, down = ned_of(GeoPoint(latitude, longitude, altitude), home)
        goal = (coordinate(north, "x"), coordinate(east, "y"), coordinate(down, "z"))
        how = (velocity, timeout_sec, drivetrain, yaw_mode, lookahead, adaptive_lookahead, vehicle)
        return self.move_on_path([goal], *how)

    @command("moveOnPath")
    def move_on_path(
        self, path: Annotated[list[Vector], places], velocity: float, timeout_sec: float, drivetrain: float,
        yaw_mode: YawMode, lookahead: float, adaptive_lookahead: float, vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        pilot, forward_only = self._taken(vehicle), drivetrain == FORWARD_ONLY
        if not path:
            return True
        if forward_only and yaw_mode.is_rate:
            raise ValueError("Yaw cannot be specified as rate if drivetrain is ForwardOnly")
        ahead = flight.check_lookahead(lookahead, velocity, adaptive_lookahead)
        points = np.array([pilot.kinematics().position_m, *path])
        follow = flight.FollowPath(points, velocity, timeout_sec, forward_only, yaw_mode, ahead, adaptive_lookahead)
        return pilot.start(follow, self.wall_ns)

    # --- to a heading -----------------------------------------------------------------------------

    @command("rotateToYaw")
    def rotate_to_yaw(self, yaw: float, timeout_sec: float, margin: float, vehicle: VehicleName = "") -> Answer:
        """Turn to a heading in degrees without moving."""
        pilot = self._taken(vehicle)
        if timeout_sec <= 0:
            return True
        place_m, heading = pilot.kinematics().position_m, math.remainder(math.radians(yaw), 2 * math.pi)
        return pilot.start(flight.RotateToYaw(place_m, heading, math.radians(margin), timeout_sec), self.wall_ns)

    @command("rotateByYawRate")
    def rotate_by_yaw_rate(self, yaw_rate: float, duration: Seconds, vehicle: VehicleName = "") -> Answer:
        """Turn at a rate in degrees per second without moving."""
        place_m = self.scenery.flying_pilot(vehicle).kinematics().position_m
        return _fly(self, flight.position(place_m, Yaw(math.radians(yaw_rate))), duration, vehicle)

    # --- by velocity ------------------------------------------------------------------------------

    @command("moveByVelocity", leaves_state=True)
    def move_by_velocity(
        self, vx: float, vy: float, vz: float, duration: Seconds, drivetrain: float, yaw_mode: YawMode,
        vehicle: VehicleName = "", exact: bool = False,
    ) -> Answer:  # fmt: skip
        """With `exact`, which our own client sends, refuse a duration that an exact profile's tick does not divide."""
        goal = flight.velocity((vx, vy, vz), facing(vx, vy, drivetrain, yaw_mode))
        return fly_for(self.scenery.flying_pilot(vehicle), goal, duration, self.wall_ns, exact=exact)

    @command("moveByVelocityZ", leaves_state=True)
    def move_by_velocity_z(
        self, vx: float, vy: float, z: float, duration: Seconds, drivetrain: float, yaw_mode: YawMode,
        vehicle: VehicleName = "", exact: bool = False,
    ) -> Answer:  # fmt: skip
        """Fly at a height; for a duration of 0 this command alone returns False."""
        goal = flight.velocity_z(vx, vy, z, facing(vx, vy, drivetrain, yaw_mode))
        pilot = self.scenery.flying_pilot(vehicle)
        return fly_for(pilot, goal, duration, self.wall_ns, at_once=False, exact=exact)

    @command("moveByVelocityBodyFrame")
    def move_by_velocity_body_frame(
        self, vx: float, vy: float, vz: float, duration: Seconds, drivetrain: float, yaw_mode: YawMode,
        vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        """Fly in the frame of the vehicle's heading at the start of the command."""
        north, east = turned(self.scenery.flying_pilot(vehicle).kinematics(), vx, vy)
        goal = flight.velocity((north, east, vz), facing(north, east, drivetrain, yaw_mode))
        return _fly(self, goal, duration, vehicle)

    @command("moveByVelocityZBodyFrame")
    def move_by_velocity_z_body_frame(
        self, vx: float, vy: float, z: float, duration: Seconds, drivetrain: float, yaw_mode: YawMode,
        vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        """Fly at a height in the frame of the vehicle's heading at the start of the command."""
        north, east = turned(self.scenery.flying_pilot(vehicle).kinematics(), vx, vy)
        goal = flight.velocity_z(north, east, z, facing(north, east, drivetrain, yaw_mode))
        return _fly(self, goal, duration, vehicle)

    @command("moveByManual")
    def move_by_manual(
        self, vx_max: float, vy_max: float, z_min: float, duration: float, drivetrain: float,
        yaw_mode: YawMode, vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        """Fly by the sticks that moveByRC sets."""
        pilot, forward_only = self._taken(vehicle), drivetrain == FORWARD_ONLY
        if duration <= 0:
            return True
        begun_at = pilot.kinematics().orientation_wxyz
        task = flight.MoveByManual(pilot.sticks, vx_max, vy_max, z_min, duration, forward_only, yaw_mode, begun_at)
        return pilot.start(task, self.wall_ns)

    # --- in common --------------------------------------------------------------------------------

    def _taken(self, vehicle: str) -> Pilot:
        """Cancel the vehicle's running command, and return its pilot."""
        pilot = self.scenery.flying_pilot(vehicle)
        pilot.end(False, self.wall_ns)
        return pilot

    def _fly_to(self, pilot: Pilot, place: Vector, velocity_m_s: float, timeout_s: float) -> Answer:
        points = np.array([pilot.kinematics().position_m, place])
        ahead = flight.check_lookahead(AUTO_LOOKAHEAD, velocity_m_s, ADAPTIVE)
        follow = flight.FollowPath(points, velocity_m_s, timeout_s, False, STRAIGHT_ON, ahead, ADAPTIVE)
        return pilot.start(follow, self.wall_ns)


def fly_for(
    pilot: Pilot, goal: Goal, duration_s: float, wall_ns: int, at_once: bool = True, exact: bool = False
) -> Answer:
    """Fly towards one goal for a time; for a duration of 0 or less return `at_once`.

    Raises UserError if an exact duration does not fit the profile.
    """
    if duration_s <= 0:
        pilot.end(False, wall_ns)
        return at_once
    profile = pilot.vehicle.profile
    ticks = profile.command_ticks(duration_s) if exact else profile.nearest_ticks(duration_s)
    return pilot.fly(goal, ticks, wall_ns)


def facing(north: float, east: float, drivetrain: float, yaw_mode: Yaw) -> Yaw:
    """Return the yaw goal for a horizontal direction of travel (MultirotorApiBase::adjustYaw)."""
    return flight.facing((north, east, 0.0), drivetrain == FORWARD_ONLY, yaw_mode)


def turned(now: Kinematics, ahead: float, right: float) -> tuple[float, float]:
    """Return a horizontal vector, given ahead of the vehicle and to its right, as north and east."""
    yaw = euler_from_quaternion(now.orientation_wxyz)[2]
    return ahead * math.cos(yaw) - right * math.sin(yaw), ahead * math.sin(yaw) + right * math.cos(yaw)


def gains(value: object, name: str) -> Vector:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{name} must be a list of three gains")
    a, b, c = (number(each, name) for each in value)
    if max(abs(a), abs(b), abs(c)) > LARGEST_GAIN:
        raise ValueError(f"{name} must be within {LARGEST_GAIN:g}, not {value}")
    return a, b, c


def sticks(value: object, name: str) -> flight.Sticks:
    """The sticks in an RCData."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a map, not {type(value).__name__}")
    positions = np.zeros(flight.STICKS)
    for index, stick in enumerate(STICK_NAMES):
        positions[index] = number(value.get(stick, 0.0), stick)
    positions[flight.RATE_MODE] = int(number(value.get("switches", 0), "switches")) & 1
    positions[flight.VALID] = flag(value.get("is_valid", False), "is_valid")
    return positions


Gains = Annotated[Vector, gains]


def _fly(calls: Calls, goal: Goal, duration_s: float, vehicle: str) -> Answer:
    return fly_for(calls.scenery.flying_pilot(vehicle), goal, duration_s, calls.wall_ns)


def _by_angles(name: str, yaw_is_rate: bool, z_mode: int) -> Callable[..., Answer]:
    """Declare a command for an attitude, whose yaw may be a rate and whose z may be a throttle."""

    @command(name)
    def move(
        self: Calls, roll: float, pitch: float, yaw: float, z: float, duration: Seconds,
        vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        return _fly(self, flight.attitude(roll, pitch, Yaw(yaw, yaw_is_rate), z, z_mode), duration, vehicle)

    return move


def _by_rates(name: str, z_mode: int) -> Callable[..., Answer]:
    """Declare a command for body rates, whose z may be a throttle."""

    @command(name)
    def move(
        self: Calls, roll_rate: float, pitch_rate: float, yaw_rate: float, z: float, duration: Seconds,
        vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        return _fly(self, flight.body_rates(roll_rate, pitch_rate, yaw_rate, z, z_mode), duration, vehicle)

    return move


def _set_gains(name: str, level: str) -> Callable[..., None]:
    """Declare a call that sets the gains of one level of the cascade."""

    @call(name)
    def set_gains(self: Calls, kp: Gains, ki: Gains, kd: Gains, vehicle: VehicleName = "") -> None:
        self.scenery.flying_pilot(vehicle).vehicle.set_gains(level, kp, ki, kd)

    return set_gains


class AttitudeApi(Calls, title="Flight"):
    move_by_angles_z = _by_angles("moveByRollPitchYawZ", False, POSITION)
    move_by_angles_throttle = _by_angles("moveByRollPitchYawThrottle", False, THROTTLE)
    move_by_yaw_rate_z = _by_angles("moveByRollPitchYawrateZ", True, POSITION)
    move_by_yaw_rate_throttle = _by_angles("moveByRollPitchYawrateThrottle", True, THROTTLE)
    move_by_rates_z = _by_rates("moveByAngleRatesZ", POSITION)
    move_by_rates_throttle = _by_rates("moveByAngleRatesThrottle", THROTTLE)
    set_rate_gains = _set_gains("setAngleRateControllerGains", "rate")
    set_angle_gains = _set_gains("setAngleLevelControllerGains", "angle")
    set_velocity_gains = _set_gains("setVelocityControllerGains", "velocity")
    set_position_gains = _set_gains("setPositionControllerGains", "position")

    @command("moveByMotorPWMs")
    def move_by_motor_pwms(
        self, front_right_pwm: float, rear_left_pwm: float, front_left_pwm: float, rear_right_pwm: float,
        duration: Seconds, vehicle: VehicleName = "",
    ) -> Answer:  # fmt: skip
        goal = flight.motors(front_right_pwm, rear_left_pwm, front_left_pwm, rear_right_pwm)
        return _fly(self, goal, duration, vehicle)

    @call("moveByRC")
    def move_by_rc(self, rcdata: Annotated[flight.Sticks, sticks], vehicle: VehicleName = "") -> None:
        """Set the sticks, which fly the vehicle while API control is off, and in moveByManual."""
        self.scenery.flying_pilot(vehicle).move_sticks(rcdata)


def rc_data_map(sticks: flight.Sticks) -> dict[str, object]:
    """Return the RCData of a vehicle, whose sticks are those of moveByRC."""
    moved = dict(zip(STICK_NAMES, sticks[: len(STICK_NAMES)].tolist(), strict=True))
    axes = {name: moved.get(name, 0.0) for name in ("pitch", "roll", "throttle", "yaw", "left_z", "right_z")}
    valid = bool(sticks[flight.VALID])
    how = {"switches": int(sticks[flight.RATE_MODE]), "vendor_id": "", "is_initialized": valid, "is_valid": valid}
    return {"timestamp": 0, **axes, **how}
