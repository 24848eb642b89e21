"""What a world tells of its leading vehicle, for all who know of one alone."""

from __future__ import annotations

from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.sim.vehicle.collisions import Touches
from uavaccel.sim.vehicle.goal import of_velocity
from uavaccel.sim.vehicle.quadrotor import Record
from uavaccel.sim.vehicle.vehicle import Vehicle


class Led:
    """Has a leading vehicle, and passes on what is asked of it."""

    lead: Vehicle

    @property
    def parameters(self) -> Record:
        """Of the leading quadrotor and its autopilot (quadrotor.PARAMETERS_DTYPE)."""
        return self.lead.parameters

    @property
    def state(self) -> Record:
        """Of the leading vehicle's flight (quadrotor.FLIGHT_DTYPE)."""
        return self.lead.state

    @property
    def tick(self) -> int:
        return self.lead.tick

    @property
    def collision_tick(self) -> int | None:
        """Tick of the first touch since the last reset."""
        return self.lead.collision_tick

    @property
    def collision_object(self) -> str:
        """What was touched first since the last reset; "" for nothing."""
        first = self.lead.touches.first
        return first.object if first else ""

    @property
    def touches(self) -> Touches:
        return self.lead.touches

    @property
    def landed(self) -> bool:
        return self.lead.landed

    def kinematics(self, origin_ns: int = 0) -> Kinematics:
        """The state at the present tick, NED and FRD; `origin_ns` is the simulated time of tick 0."""
        return self.lead.kinematics(origin_ns)

    def fly_velocity(self, goal: VelocityGoal) -> None:
        """Set the autopilot's goal to a velocity."""
        self.lead.set_goal(of_velocity(goal))

    def hold_from(self, tick: int | None) -> None:
        """Position hold sets in at `tick`; None: not at all."""
        self.lead.hold_from(tick)
