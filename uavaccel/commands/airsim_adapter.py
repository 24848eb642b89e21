"""An adapter of AirSim's own Python client, with which ADSC and TCSC fly a real AirSim.

    import airsim
    client = AirSimAdapter(airsim.MultirotorClient(), clock_speed=10)
    for state in tcsc(client, VelocityGoal((1.0, 0.0, 0.0)), t_move_s=1.0, t_sample_s=0.33, t_th_ns=...):

This module does not import airsim: any object with the methods of its MultirotorClient will do.
"""

from __future__ import annotations

from typing import Any, TypeAlias

from uavaccel.clock import MonotonicClock
from uavaccel.kinematics import FlightGoal, Kinematics, Quaternion, Vector, airsim_command
from uavaccel.units import NS_PER_S

OfAirSim: TypeAlias = Any  # an object of AirSim's client, which has no types


class AirSimAdapter:
    """A `MissionClient` around an airsim.MultirotorClient that is connected and has API control.

    `clock_speed` is the simulator's ClockSpeed: AirSim's simContinueForTime takes wall seconds. There it ends by the
    scheduler's grain early or late, so TCSC wants a `t_th_ns` of the client's latency times ClockSpeed.
    """

    def __init__(self, client: OfAirSim, clock_speed: float, vehicle_name: str = "") -> None:
        self.client = client
        self.clock_speed = float(clock_speed)
        self.vehicle_name = vehicle_name
        self._clock = MonotonicClock()

    def now_ns(self) -> int:
        """See `MissionClient`."""
        return self._clock.now_ns()

    def move_async(self, goal: FlightGoal, t_move_s: float) -> OfAirSim:
        """Issue AirSim's command for the goal, and return its msgpack-rpc future."""
        name, arguments = airsim_command(goal, t_move_s)
        return getattr(self.client, f"{name}Async")(*arguments, self.vehicle_name)

    def join(self, future: OfAirSim, deadline_ns: int | None = None) -> bool:
        """Wait for the command's end; with a deadline, for that alone.

        AirSim's client cannot wait for both. ADSC's samples fall before the command's end, so it asks for no more.
        Raises msgpack-rpc's RPCError with the server's text, which AirSim's own join() keeps to itself.
        """
        if deadline_ns is not None:
            self._clock.sleep_until(deadline_ns)
            return False
        future.get()
        return True

    def pause(self) -> None:
        self.client.simPause(True)

    def run(self) -> None:
        self.client.simPause(False)

    def continue_for(self, duration_ns: int) -> Kinematics:
        self.client.simContinueForTime(duration_ns / NS_PER_S / self.clock_speed)
        return self.kinematics()

    def kinematics(self) -> Kinematics:
        state = self.client.getMultirotorState(self.vehicle_name)
        truth = state.kinematics_estimated  # SimpleFlight estimates by looking at the truth
        return Kinematics(
            int(state.timestamp),
            _vector(truth.position),
            _quaternion(truth.orientation),
            _vector(truth.linear_velocity),
            _vector(truth.angular_velocity),
            _vector(truth.linear_acceleration),
            _vector(truth.angular_acceleration),
        )

    def read_sample(self, state: Kinematics) -> Kinematics:
        return state


def _vector(vector: OfAirSim) -> Vector:
    return vector.x_val, vector.y_val, vector.z_val


def _quaternion(quaternion: OfAirSim) -> Quaternion:
    return quaternion.w_val, quaternion.x_val, quaternion.y_val, quaternion.z_val
