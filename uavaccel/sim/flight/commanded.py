"""What a simulation's leading vehicle is told, for all who know of one alone."""

from __future__ import annotations

from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.sim.flight.pilot import Pilot
from uavaccel.sim.profile import Profile
from uavaccel.sim.recording import CommandLog
from uavaccel.sim.vehicle.goal import of_velocity


class Commanded:
    """Has a pilot for each vehicle, and passes on to the first what names none."""

    pilots: list[Pilot]
    profile: Profile

    def fly_velocity(self, goal: VelocityGoal, duration_s: float, wall_ns: int) -> DeferredReply:
        """Fly a velocity for a simulated time; a running command ends with False (latest wins).

        Raises UserError where an exact profile's tick does not divide the time. Without API control the command
        takes its time and has no effect (OffboardApi.hpp).
        """
        ticks = self.profile.command_ticks(duration_s)
        return self.lead.fly(of_velocity(goal), ticks, wall_ns)

    def cancel(self, wall_ns: int) -> None:
        """End the leading vehicle's command, if any, with False; position hold follows after the goal timeout."""
        self.lead.cancel(wall_ns)

    def arm(self, armed: bool) -> bool:
        """Switch the leading vehicle's rotors on or off; needs API control (OffboardApi::arm)."""
        return self.lead.arm(armed)

    @property
    def lead(self) -> Pilot:
        """Who flies the first vehicle, which is meant wherever none is named."""
        return self.pilots[0]

    @property
    def api_control(self) -> bool:
        """Whether programs may fly the leading vehicle."""
        return self.lead.api_control

    @api_control.setter
    def api_control(self, given: bool) -> None:
        self.lead.api_control = given

    @property
    def commands(self) -> CommandLog:
        """The leading vehicle's, since the last reset."""
        return self.lead.log
