"""A flight on a simulated wall clock: the script's connection, its time and its waits, the waits of its threads."""

from __future__ import annotations

import contextlib
import sys
from typing import Any

import numpy as np

from uavaccel.airsim.connection import Future, connect_with
from uavaccel.clock import VirtualClock, datetime_module, time_module
from uavaccel.errors import UserError
from uavaccel.fly import shims
from uavaccel.fly.film import filming
from uavaccel.fly.messages import MessageLog
from uavaccel.fly.modules import client_modules, importing
from uavaccel.fly.old_gym import gym_modules
from uavaccel.fly.options import FlightOptions
from uavaccel.fly.script import Enough, Outcome, run_script
from uavaccel.fly.sent import as_received, as_sent
from uavaccel.fly.threads import Thread, thread_modules
from uavaccel.fly.trajectory import INTERVAL_NS, Trajectory
from uavaccel.fly.turns import LOOK_NS, Turns
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.watched import WatchedWorld
from uavaccel.units import NS_PER_S
from uavaccel.wire.api import Api
from uavaccel.wire.latency import ZERO_LATENCY, Latency, LatencyConfig, shipped_latency
from uavaccel.wire.settings import Settings
from uavaccel.wire.transport import Call, VirtualTransport
from uavaccel.wire.types import stamp

READING_NS = 10_000  # what a look at the clock costs the script, so that a loop that waits for a time ends
FREE_CALLS = 100  # without latencies, so many calls since the last wait are taken for granted;
POLL_NS = 1_000_000  # each one more costs so much, so that a loop that waits for a state ends
PATIENCE_NS = 3600 * NS_PER_S  # simulated time of a wait after which it is worth a line: AirSim's have no end
KEEP_NS = 10 * NS_PER_S  # between two looks at the recorder, whose buffer is bounded


class SimulatedFlight:
    """What a script lives in. The same script and options give the same messages and trajectory, byte for byte.

    `options.until_s` bounds wall time times ClockSpeed: the call, sleep or look at the clock that reaches it raises
    Enough.
    """

    def __init__(
        self, options: FlightOptions, settings: Settings, clock_speed: float, log: MessageLog
    ) -> None:
        latency = ZERO_LATENCY if options.timing == "lockstep" else shipped_latency(options.profile)
        self._options, self._log, self._clock = options, log, VirtualClock()
        draws = Latency(latency, np.random.SeedSequence(options.seed or 0))
        profile = settings.recorder_of(_profile(latency, options, clock_speed))
        self._world = WatchedWorld(options.scene, profile, furnished=True)
        settings.prepare(self._world)
        self._simulation = _simulation(self._world, clock_speed, latency, draws)
        self._api = Api(self._simulation, settings, recordings=options.folder / "recordings", say=_tell)
        self._api.refusals.tell = _tell
        self._transport = VirtualTransport(self._api, self._clock, draws)
        self._trajectory = self._watched()
        self._think_ns = round(options.think_s * NS_PER_S)
        self._poll_ns = POLL_NS if latency is ZERO_LATENCY else 0
        until_s = options.until_s
        self._until_ns = None if until_s is None else round(until_s * NS_PER_S / clock_speed)
        self._patience_ns = round(PATIENCE_NS / self._simulation.clock_speed)
        self._calls_since_wait = 0
        self._over = False
        self._turns = Turns(self._clock)

    def _watched(self) -> Trajectory:
        """A trajectory that grows with the flight, from the start on."""
        trajectory, simulation = Trajectory(), self._simulation
        trajectory.add(simulation.kinematics())
        tick_ns = simulation.profile.tick_ns
        self._world.watch(INTERVAL_NS // tick_ns, lambda _: trajectory.add(simulation.kinematics()))
        self._world.watch(KEEP_NS // tick_ns, lambda _: self._api.recorder.keep())
        return trajectory

    def run(self) -> Outcome:
        """Run the script with our client, its clock and what its Python lacks. Raises UserError."""
        shims.supply(self.pass_time)
        threads, running = thread_modules(self._turns)
        clocks = {
            "time": time_module(self.epoch_now_ns, self.pass_time),
            "datetime": datetime_module(self.epoch_now_ns),
        }
        options = self._options
        with contextlib.ExitStack() as stack:
            if options.film:
                stack.enter_context(filming(self._simulation, self._world, options.folder))
            stack.enter_context(connect_with(lambda host, port, timeout_s: self))
            stack.enter_context(
                importing(client_modules() | gym_modules() | shims.old_modules(), clocks | threads)
            )
            outcome = run_script(options.script, options.arguments, lambda: self._outlive(running))
            self._transport.catch_up()  # what the script still waited for
            return outcome

    def end(self) -> None:
        """Write what was flown, and say what was refused. Calls from then on, of destructors, raise Enough."""
        self._over = True
        self._api.recorder.stop()
        self._trajectory.write(self._options.folder)
        if refused := self._api.refusals.lines():
            print("uavaccel: refused calls:", *refused, sep="\n  ", file=sys.stderr)

    def summary(self) -> dict[str, Any]:
        """How long, and where to: SI units, NED."""
        return {
            "simulated_s": self._simulation.time_ns / NS_PER_S,
            "script_s": self._clock.now_ns() / NS_PER_S,
            "position_m": list(self._simulation.kinematics().position_m),
            "failure": self._simulation.failure,
            "refused": self._api.refusals.lines(),
        }

    # --- the script's clock -----------------------------------------------------------------------

    def epoch_now_ns(self) -> int:
        """What the script reads."""
        self._clock.charge(READING_NS)
        self._stop_at_the_end()
        return stamp(self._clock.now_ns())

    def pass_time(self, seconds: float) -> None:
        """The script waits so long; the simulation goes on. Raises ValueError below 0, as time.sleep does."""
        self._check_thread()
        if seconds < 0:
            raise ValueError("sleep length must be non-negative")
        self._calls_since_wait = 0
        end_ns = self._clock.now_ns() + round(seconds * NS_PER_S)
        self._turns.wait_until(end_ns if self._until_ns is None else min(end_ns, self._until_ns))
        self._transport.catch_up()
        self._stop_at_the_end()

    # --- a Connection of the client ---------------------------------------------------------------

    def call(self, method: str, *params: Any) -> Any:
        call, number = self._send(method, params, blocking=True)
        self._wait(call, number)
        return call.result()

    def call_async(self, method: str, *params: Any) -> Future:
        call, number = self._send(method, params, blocking=False)
        return Future(method, lambda future: self._join(future, call, number))

    def close(self) -> None:
        pass

    def _send(self, method: str, params: tuple[Any, ...], blocking: bool) -> tuple[Call, int]:
        self._check_thread()
        self._think()
        sent = as_sent(params)
        number = self._log.call(self._clock.now_ns(), self._simulation.time_ns, method, sent)
        return self._transport.send(method, sent, blocking), number

    def _think(self) -> None:
        if self._over:
            raise Enough
        self._stop_at_the_end()
        self._clock.charge(self._think_ns)
        self._calls_since_wait += 1
        if self._calls_since_wait > FREE_CALLS:
            self._clock.charge(self._poll_ns)

    def _join(self, future: Future, call: Call, number: int) -> None:
        self._check_thread()
        self._wait(call, number)
        future.answer(call.error, call.value)  # refusals tell of an error already

    def _wait(self, call: Call, number: int) -> None:
        if call.deferred is not None:
            self._calls_since_wait = 0
        patient_until_ns: int | None = self._clock.now_ns() + self._patience_ns
        while not self._transport.wait(
            call, earliest(patient_until_ns, self._until_ns, self._turns.earliest_ns())
        ):
            self._stop_at_the_end()
            if patient_until_ns is not None and self._clock.now_ns() >= patient_until_ns:
                patient_until_ns = None
                if not self._simulation.paused:
                    self._say_that_it_waits(call.method)
            else:
                self._turns.wait_until(self._expected_ns(call))  # another thread's time has come
        call.value = as_received(call.value)
        self._log.answer(number, call.reply_wall_ns or 0, call.error, call.value)

    def _expected_ns(self, call: Call) -> int:
        """When the answer is there, or may be due, or the flight ends."""
        event_ns, now_ns = call.reply_wall_ns, self._clock.now_ns()
        if event_ns is None:
            event_ns = self._simulation.next_event_wall_ns()
        expected_ns = now_ns + LOOK_NS if event_ns is None else max(now_ns, event_ns)
        return earliest(expected_ns, self._until_ns) or now_ns

    def _say_that_it_waits(self, method: str) -> None:
        position = " ".join(f"{metres:.1f}" for metres in self._simulation.kinematics().position_m)
        touch = self._world.touches.latest
        where = f"{position} m" + (f", last touched {touch.object}" if touch else "")
        _tell(
            f"the script has waited {PATIENCE_NS / NS_PER_S:g} simulated s for {method}; the vehicle is at {where}"
        )

    def _outlive(self, running: list[Thread]) -> None:
        """The script's first thread is done; wait for the others, but for daemons."""
        self._turns.until(lambda: all(thread.is_daemon for thread in running))

    def _stop_at_the_end(self) -> None:
        if self._until_ns is not None and self._clock.now_ns() >= self._until_ns:
            self._transport.catch_up()
            raise Enough

    def _check_thread(self) -> None:
        if not self._turns.is_mine():
            raise UserError(
                "a library's thread calls the simulation; on a simulated clock the script's own may: --timing wall"
            )


def earliest(*times_ns: int | None) -> int | None:
    """The first of the times that there are."""
    return min((time_ns for time_ns in times_ns if time_ns is not None), default=None)


def _profile(latency: LatencyConfig, options: FlightOptions, clock_speed: float) -> Any:
    return latency.platform.profile(options.profile, clock_speed)


def _simulation(
    world: WatchedWorld, clock_speed: float, latency: LatencyConfig, draws: Latency
) -> Simulation:
    """A settled hover, the clock running and API control off, as a server has it."""
    return Simulation(
        world,
        clock_speed,
        timer_lateness_ns=draws.timer_ns,
        executor=latency.platform.executor(),
        frames=latency.platform.new_frames(draws.frame_ns),
    )


def _tell(line: str) -> None:
    print(f"uavaccel: warning: {line}", file=sys.stderr, flush=True)
