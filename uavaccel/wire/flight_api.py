"""AirSim's flight commands: their arguments, and what each answers.

Sources: AirSim v1.8.1, MultirotorRpcLibServer.cpp (names, orders), MultirotorApiBase.cpp (what they do and answer).
A command that is interrupted answers False; one for a time answers True at its end, one for a place once it is there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from uavaccel.kinematics import Kinematics, Vector
from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.sim.flight.manual import MoveByManual
from uavaccel.sim.flight.path import FollowPath, check_lookahead
from uavaccel.sim.flight.path import facing as facing_along
from uavaccel.sim.flight.pilot import Pilot
from uavaccel.sim.flight.task import AT_REST_M_S, Land, RotateToYaw, Task
from uavaccel.sim.sensors.earth import GeoPoint, geographic
from uavaccel.sim.vehicle import goal as goals
from uavaccel.sim.vehicle.goal import Goal, Yaw
from uavaccel.units import euler_from_quaternion
from uavaccel.wire import types
from uavaccel.wire.geodesy import ned_of
from uavaccel.wire.method import Method

FORWARD_ONLY = 1
LONGEST_S = 1e9  # what is asked to last longer lasts so long: AirSim's clients write 3e38 for ever
TAKEOFF_M, TAKEOFF_M_S = 2.0, 0.5
AUTO_LOOKAHEAD, ADAPTIVE = -1.0, 1.0

Answer = DeferredReply | bool


class FlightApi:
    """The flight commands of the vehicles that `pilot_of` finds by name; `wall_ns` is when a call is handled."""

    def __init__(self, pilot_of: Callable[[Any], Pilot], wall_ns: Callable[[], int], home: GeoPoint) -> None:
        """`home` is where the world's NED begins."""
        self._pilot_of, self._wall_ns, self._home = pilot_of, wall_ns, home

    def methods(self) -> dict[str, Method]:
        """The calls, AirSim's names; the last argument of each is the vehicle's name."""
        return {
            "takeoff": Method(self.takeoff, 1, 1),
            "land": Method(self.land, 1, 1),
            "goHome": Method(self.go_home, 1, 1),
            "hover": Method(self.hover, 0, 1),
            "cancelLastTask": Method(self.cancel, 0, 1),
            "moveToPosition": Method(self.move_to_position, 9, 1),
            "moveToZ": Method(self.move_to_z, 6, 1),
            "moveToGPS": Method(self.move_to_gps, 9, 1),
            "moveOnPath": Method(self.move_on_path, 7, 1),
            "rotateToYaw": Method(self.rotate_to_yaw, 3, 1),
            "rotateByYawRate": Method(self.rotate_by_yaw_rate, 2, 1),
            "moveByVelocity": Method(self.move_by_velocity, 6, 2),
            "moveByVelocityZ": Method(self.move_by_velocity_z, 6, 2),
            "moveByVelocityBodyFrame": Method(self.move_by_velocity_body_frame, 6, 1),
            "moveByVelocityZBodyFrame": Method(self.move_by_velocity_z_body_frame, 6, 1),
            "moveByManual": Method(self.move_by_manual, 6, 1),
        }

    # --- to a place -------------------------------------------------------------------------------

    def takeoff(self, timeout: Any, vehicle: Any = "") -> Answer:
        """2 m up from where the vehicle is. Raises ValueError while it moves."""
        pilot, timeout_s = self._taken(vehicle), types.number(timeout, "timeout_sec")
        now = pilot.kinematics()
        if (speed := math.hypot(*now.linear_velocity_m_s)) > AT_REST_M_S:
            raise ValueError(
                f"Cannot perform takeoff because vehicle is already moving with velocity {speed:f} m/s"
            )
        north, east, down = now.position_m
        return self._fly_to(pilot, (north, east, down - TAKEOFF_M), TAKEOFF_M_S, timeout_s)

    def land(self, timeout: Any, vehicle: Any = "") -> Answer:
        """Down at .2 m/s until the vehicle sinks no more."""
        return self._start(self._taken(vehicle), Land(types.number(timeout, "timeout_sec")))

    def go_home(self, timeout: Any, vehicle: Any = "") -> Answer:
        """To the origin of the vehicle's frame, at .5 m/s."""
        timeout_s = types.number(timeout, "timeout_sec")
        return self._fly_to(self._taken(vehicle), (0.0, 0.0, 0.0), TAKEOFF_M_S, timeout_s)

    def hover(self, vehicle: Any = "") -> Answer:
        """End the running command; the goal timeout brings position hold. AirSim's, a path of no length, is False."""
        self._taken(vehicle)
        return False

    def cancel(self, vehicle: Any = "") -> None:
        """cancelLastTask."""
        self._taken(vehicle)

    def move_to_position(
        self, x: Any, y: Any, z: Any, velocity: Any, timeout: Any, drivetrain: Any, yaw: Any, *rest: Any
    ) -> Answer:
        """`rest`: lookahead, adaptive lookahead and the vehicle, as in every command for a place."""
        place = (types.coordinate(x, "x"), types.coordinate(y, "y"), types.coordinate(z, "z"))
        return self._on_path([place], velocity, timeout, drivetrain, yaw, *rest)

    def move_to_z(
        self,
        z: Any,
        velocity: Any,
        timeout: Any,
        yaw: Any,
        lookahead: Any,
        adaptive: Any,
        vehicle: Any = "",
    ) -> Answer:
        north, east, _ = self._pilot_of(vehicle).kinematics().position_m
        place = (north, east, types.coordinate(z, "z"))
        return self._on_path([place], velocity, timeout, 0, yaw, lookahead, adaptive, vehicle)

    def move_to_gps(
        self,
        latitude: Any,
        longitude: Any,
        altitude: Any,
        velocity: Any,
        timeout: Any,
        drivetrain: Any,
        yaw: Any,
        lookahead: Any,
        adaptive: Any,
        vehicle: Any = "",
    ) -> Answer:
        """Degrees, and metres over the sea."""
        goal = GeoPoint(
            types.number(latitude, "latitude"),
            types.number(longitude, "longitude"),
            types.number(altitude, "altitude"),
        )
        home = geographic(self._pilot_of(vehicle).vehicle.origin_m, self._home)
        north, east, down = ned_of(goal, home)
        rest = (timeout, drivetrain, yaw, lookahead, adaptive, vehicle)
        return self.move_to_position(north, east, down, velocity, *rest)

    def move_on_path(self, path: Any, *rest: Any) -> Answer:
        """`path`: Vector3r; `rest` as in move_to_position from the velocity on."""
        if not isinstance(path, list):
            raise ValueError("path must be a list of Vector3r")
        return self._on_path([types.place(point, "path") for point in path], *rest)

    def _on_path(
        self,
        path: list[Vector],
        velocity: Any,
        timeout: Any,
        drivetrain: Any,
        yaw: Any,
        lookahead: Any,
        adaptive: Any,
        vehicle: Any = "",
    ) -> Answer:
        speed, timeout_s = types.number(velocity, "velocity"), types.number(timeout, "timeout_sec")
        forward_only, mode = types.number(drivetrain, "drivetrain") == FORWARD_ONLY, yaw_of(yaw)
        adaptive = types.number(adaptive, "adaptive_lookahead")
        ahead = types.number(lookahead, "lookahead")
        pilot = self._taken(vehicle)
        if not path:
            return True
        if forward_only and mode.is_rate:
            raise ValueError("Yaw cannot be specified as rate if drivetrain is ForwardOnly")
        ahead = check_lookahead(ahead, speed, adaptive)
        points = np.array([pilot.kinematics().position_m, *path])
        follow = FollowPath(points, speed, timeout_s, forward_only, mode.value, mode.is_rate, ahead, adaptive)
        return self._start(pilot, follow)

    def _fly_to(self, pilot: Pilot, place: Vector, velocity_m_s: float, timeout_s: float) -> Answer:
        points = np.array([pilot.kinematics().position_m, place])
        ahead = check_lookahead(AUTO_LOOKAHEAD, velocity_m_s, ADAPTIVE)
        follow = FollowPath(points, velocity_m_s, timeout_s, False, 0.0, True, ahead, ADAPTIVE)
        return self._start(pilot, follow)

    # --- to a heading -----------------------------------------------------------------------------

    def rotate_to_yaw(self, yaw: Any, timeout: Any, margin: Any, vehicle: Any = "") -> Answer:
        """Degrees; where the vehicle is."""
        heading = math.remainder(math.radians(types.number(yaw, "yaw")), 2 * math.pi)
        timeout_s = types.number(timeout, "timeout_sec")
        margin_rad = math.radians(types.number(margin, "margin"))
        pilot = self._taken(vehicle)
        if timeout_s <= 0:
            return True
        place = pilot.kinematics().position_m
        return self._start(pilot, RotateToYaw(place, heading, margin_rad, timeout_s))

    def rotate_by_yaw_rate(self, yaw_rate: Any, duration: Any, vehicle: Any = "") -> Answer:
        """Degrees per second; where the vehicle is."""
        rate = math.radians(types.number(yaw_rate, "yaw_rate"))
        pilot = self._pilot_of(vehicle)
        return self._for_time(pilot, goals.position(pilot.kinematics().position_m, Yaw(rate)), duration)

    # --- by velocity ------------------------------------------------------------------------------

    def move_by_velocity(
        self,
        vx: Any,
        vy: Any,
        vz: Any,
        duration: Any,
        drivetrain: Any,
        yaw: Any,
        vehicle: Any = "",
        exact: Any = False,
    ) -> Answer:
        """`exact`, of our own client, refuses a duration that an exact profile's tick does not divide."""
        velocity = (types.number(vx, "vx"), types.number(vy, "vy"), types.number(vz, "vz"))
        goal = goals.velocity(velocity, facing(velocity, drivetrain, yaw))
        return self._for_time(self._pilot_of(vehicle), goal, duration, exact=exact)

    def move_by_velocity_z(
        self,
        vx: Any,
        vy: Any,
        z: Any,
        duration: Any,
        drivetrain: Any,
        yaw: Any,
        vehicle: Any = "",
        exact: Any = False,
    ) -> Answer:
        """Alone of all, it answers False to a duration of 0."""
        velocity = (types.number(vx, "vx"), types.number(vy, "vy"), 0.0)
        goal = goals.velocity_z(*velocity[:2], types.number(z, "z"), facing(velocity, drivetrain, yaw))
        return self._for_time(self._pilot_of(vehicle), goal, duration, at_once=False, exact=exact)

    def move_by_velocity_body_frame(
        self, vx: Any, vy: Any, vz: Any, duration: Any, drivetrain: Any, yaw: Any, vehicle: Any = ""
    ) -> Answer:
        """The vehicle's heading at the beginning counts, and stays."""
        pilot, down = self._pilot_of(vehicle), types.number(vz, "vz")
        north, east = turned(pilot.kinematics(), types.number(vx, "vx"), types.number(vy, "vy"))
        goal = goals.velocity((north, east, down), facing((north, east, 0.0), drivetrain, yaw))
        return self._for_time(pilot, goal, duration)

    def move_by_velocity_z_body_frame(
        self, vx: Any, vy: Any, z: Any, duration: Any, drivetrain: Any, yaw: Any, vehicle: Any = ""
    ) -> Answer:
        """As move_by_velocity_body_frame, at a height."""
        pilot, height = self._pilot_of(vehicle), types.number(z, "z")
        north, east = turned(pilot.kinematics(), types.number(vx, "vx"), types.number(vy, "vy"))
        goal = goals.velocity_z(north, east, height, facing((north, east, 0.0), drivetrain, yaw))
        return self._for_time(pilot, goal, duration)

    def move_by_manual(
        self,
        vx_max: Any,
        vy_max: Any,
        z_min: Any,
        duration: Any,
        drivetrain: Any,
        yaw: Any,
        vehicle: Any = "",
    ) -> Answer:
        """As the sticks of moveByRC say."""
        north, east = types.number(vx_max, "vx_max"), types.number(vy_max, "vy_max")
        climb = types.number(z_min, "z_min")
        seconds, mode = types.number(duration, "duration"), yaw_of(yaw)
        forward_only = types.number(drivetrain, "drivetrain") == FORWARD_ONLY
        pilot = self._taken(vehicle)
        if seconds <= 0:
            return True
        begun_at = pilot.kinematics().orientation_wxyz
        task = MoveByManual(
            pilot.sticks, north, east, climb, seconds, forward_only, mode.value, mode.is_rate, begun_at
        )
        return self._start(pilot, task)

    # --- in common --------------------------------------------------------------------------------

    def _taken(self, vehicle: Any) -> Pilot:
        """The vehicle's pilot; the command that ran is over."""
        pilot = self._pilot_of(vehicle)
        pilot.cancel(self._wall_ns())
        return pilot

    def _start(self, pilot: Pilot, task: Task) -> Answer:
        return pilot.start(task, self._wall_ns())

    def _for_time(
        self, pilot: Pilot, goal: Goal, duration: Any, at_once: bool = True, exact: Any = False
    ) -> Answer:
        """Fly towards a goal; `at_once` is what a duration of 0 or less answers."""
        return fly_for(pilot, goal, duration, self._wall_ns(), at_once, exact)


def fly_for(
    pilot: Pilot, goal: Goal, duration: Any, wall_ns: int, at_once: bool = True, exact: Any = False
) -> Answer:
    """Fly towards one goal for a time. Raises UserError if an exact one does not fit the profile."""
    seconds = min(types.number(duration, "duration"), LONGEST_S)
    if seconds <= 0:
        pilot.cancel(wall_ns)
        return at_once
    profile = pilot.vehicle.profile
    ticks = profile.command_ticks(seconds) if exact is True else profile.nearest_ticks(seconds)
    return pilot.fly(goal, ticks, wall_ns)


def yaw_of(value: Any) -> Yaw:
    """A YawMode, in radians."""
    is_rate, yaw = types.yaw_mode(value)
    return Yaw(yaw, is_rate)


def facing(velocity: Vector, drivetrain: Any, yaw_mode: Any) -> Yaw:
    """The yaw goal for a horizontal direction of travel (MultirotorApiBase::adjustYaw)."""
    forward_only = types.number(drivetrain, "drivetrain") == FORWARD_ONLY
    return facing_along((velocity[0], velocity[1], 0.0), forward_only, yaw_of(yaw_mode))


def turned(now: Kinematics, ahead: float, right: float) -> tuple[float, float]:
    """North and east of what is ahead of the vehicle and to its right."""
    yaw = euler_from_quaternion(now.orientation_wxyz)[2]
    return ahead * math.cos(yaw) - right * math.sin(yaw), ahead * math.sin(yaw) + right * math.cos(yaw)
