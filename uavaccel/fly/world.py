"""What a script flies on a simulated clock: the simulation, its calls, and a trajectory that grows with it."""

from __future__ import annotations

import sys

import numpy as np

from uavaccel.clock import VirtualClock
from uavaccel.fly.options import FlightOptions, FlightSummary
from uavaccel.fly.trajectory import INTERVAL_NS, Trajectory
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S
from uavaccel.wire.api import Api
from uavaccel.wire.latency import ZERO_LATENCY, Latency, LatencyConfig, shipped_latency
from uavaccel.wire.settings import Settings
from uavaccel.wire.transport import VirtualTransport

KEEP_NS = 10 * NS_PER_S  # between two looks at the recorder, whose buffer is bounded


class FlownWorld:
    """A settled hover at time 0 of the script's clock, flown on to the clock's present. Raises UserError."""

    def __init__(
        self, options: FlightOptions, settings: Settings, clock_speed: float, clock: VirtualClock
    ) -> None:
        latency = ZERO_LATENCY if options.timing == "lockstep" else shipped_latency(options.profile)
        draws = Latency(latency, np.random.SeedSequence(options.seed or 0))
        profile = settings.recorder_of(latency.platform.profile(options.profile, clock_speed))
        self.world = World(options.scene, profile, airsim=True)
        settings.prepare(self.world)
        self.simulation = _simulation(self.world, clock_speed, latency, draws)
        self.api = Api(self.simulation, settings, recordings=options.folder / "recordings", say=tell)
        self.api.refusals.tell = tell
        self.trajectory = self._watched()
        self.transport = VirtualTransport(self.api, clock, draws)
        self.transport.catch_up()

    def _watched(self) -> Trajectory:
        """A trajectory that grows with the flight, from the start on."""
        trajectory, simulation = Trajectory(), self.simulation
        trajectory.add(simulation.kinematics())
        tick_ns = simulation.profile.tick_ns
        self.world.watch(INTERVAL_NS // tick_ns, lambda _: trajectory.add(simulation.kinematics()))
        self.world.watch(KEEP_NS // tick_ns, lambda _: self.api.recorder.keep())
        return trajectory

    def whereabouts(self) -> str:
        """Where the vehicle is, in words."""
        position = " ".join(f"{metres:.1f}" for metres in self.simulation.kinematics().position_m)
        touch = self.world.lead.contact_log.latest
        return f"{position} m" + (f", last touched {touch.object}" if touch else "")

    def summary(self) -> FlightSummary:
        """How long, and where to: SI units, NED."""
        return {
            "simulated_s": self.simulation.time_ns / NS_PER_S,
            "position_m": list(self.simulation.kinematics().position_m),
            "failure": self.simulation.failure,
            "refused": self.api.refusals.lines(),
        }


def _simulation(world: World, clock_speed: float, latency: LatencyConfig, draws: Latency) -> Simulation:
    """A settled hover, the clock running and API control off, as a server has it."""
    return Simulation(
        world,
        clock_speed,
        timer_lateness_ns=draws.timer_ns,
        executor=latency.platform.executor(),
        frames=latency.platform.new_frames(draws.frame_ns),
    )


def tell(line: str) -> None:
    print(f"uavaccel: warning: {line}", file=sys.stderr, flush=True)
