"""The world of a script on a simulated clock: a simulation, its calls, and the trajectory that it records."""

from __future__ import annotations

import sys

import numpy as np

from uavaccel.clock import VirtualClock
from uavaccel.fly.options import FlightOptions, FlightSummary
from uavaccel.fly.trajectory import INTERVAL_NS, Trajectory
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S
from uavaccel.wire.api import Api
from uavaccel.wire.latency import ZERO_LATENCY, Latency, shipped_latency
from uavaccel.wire.settings import Settings
from uavaccel.wire.transport import VirtualTransport, modelled_simulation

KEEP_NS = 10 * NS_PER_S  # interval at which the recorder's bounded buffer is emptied


class ScriptWorld:
    """A settled hover at time 0 of the script's clock, advanced to the clock's present. Raises UserError."""

    def __init__(self, options: FlightOptions, settings: Settings, clock_speed: float, clock: VirtualClock) -> None:
        latency = ZERO_LATENCY if options.timing == "lockstep" else shipped_latency(options.profile)
        draws = Latency(latency, np.random.SeedSequence(options.seed or 0))
        profile = settings.recorder_of(latency.platform.profile(options.profile, clock_speed))
        self.world = World(options.scene, profile, airsim=True)
        settings.prepare(self.world)
        self.simulation = modelled_simulation(self.world, clock_speed, draws)
        self.api = Api(self.simulation, settings, recordings=options.folder / "recordings", say=warn)
        self.api.refusals.say = warn
        self.simulation.settle(0)
        self.trajectory = self._watched()
        self.transport = VirtualTransport(self.api, clock, draws)
        self.transport.catch_up()

    def _watched(self) -> Trajectory:
        """Sample the flight from its start on."""
        trajectory, simulation = Trajectory(), self.simulation
        trajectory.add(simulation.kinematics())
        tick_ns = simulation.profile.tick_ns
        self.world.watch(INTERVAL_NS // tick_ns, lambda _: trajectory.add(simulation.kinematics()))
        self.world.watch(KEEP_NS // tick_ns, lambda _: self.api.scenery.recorder.keep())
        return trajectory

    def whereabouts(self) -> str:
        """Return the vehicle's position and its last collision, in words."""
        position = " ".join(f"{metres:.1f}" for metres in self.simulation.kinematics().position_m)
        touch = self.world.lead.contact_log.latest
        return f"{position} m" + (f", last touched {touch.object}" if touch else "")

    def summary(self) -> FlightSummary:
        """Return the simulated duration, the last position and what went wrong: SI units, NED."""
        return {
            "simulated_s": self.simulation.time_ns / NS_PER_S,
            "position_m": list(self.simulation.kinematics().position_m),
            "failure": self.simulation.failure,
            "refused": self.api.refusals.lines(),
        }


def warn(line: str) -> None:
    """Print a warning on standard error."""
    print(f"uavaccel: warning: {line}", file=sys.stderr, flush=True)
