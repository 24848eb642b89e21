"""A flight on a simulated wall clock: the script's connection, its clock, and the waits of its threads."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from uavaccel.clock import MonotonicClock, VirtualClock, WallClock, datetime_module, time_module
from uavaccel.fly.environment import ended_by_refusals, refusal, script_environment
from uavaccel.fly.log import INTERVAL_NS, MessageLog, filming, write_states
from uavaccel.fly.options import THINK_S, FlightOptions, FlightSummary
from uavaccel.fly.script import FlightOver, ScriptResult, run_script
from uavaccel.fly.threads import OutsideEvents, SharedModules, ThreadModules, end_pools
from uavaccel.fly.turns import TURN_POLL_NS, Turns
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:
    from uavaccel.wire.rpc import Future, Received
    from uavaccel.wire.settings import Settings
    from uavaccel.wire.transport import PendingCall

KEEP_NS = 10 * NS_PER_S  # interval at which the recorder's bounded buffer is emptied
READING_NS = 10_000  # what reading the clock costs the script, so that a loop that waits for a time ends
# In `lockstep` so many calls since the last wait are free; each further one costs POLL_NS, so that a loop that waits
# for a state ends.
FREE_CALLS = 100
POLL_NS = round(THINK_S["virtual"] * NS_PER_S)
PATIENCE_NS = 3600 * NS_PER_S  # simulated wait that is reported: AirSim's commands have no time-out


class ScriptWorld:
    """A settled hover at time 0 of the script's clock, advanced to the clock's present. Raises UserError."""

    def __init__(self, options: FlightOptions, settings: Settings, clock_speed: float, clock: VirtualClock) -> None:
        from uavaccel.sim.world import World
        from uavaccel.wire.api import Api
        from uavaccel.wire.latency import ZERO_LATENCY, Latency, shipped_latency
        from uavaccel.wire.settings import naming_settings
        from uavaccel.wire.transport import VirtualTransport, modelled_simulation

        latency = ZERO_LATENCY if options.timing == "lockstep" else shipped_latency(options.profile)
        draws = Latency(latency, np.random.SeedSequence(options.seed or 0))
        with naming_settings(options.settings):
            profile = settings.recorder_of(latency.platform.profile(options.profile, clock_speed))
        self.world = World(options.scene, profile, airsim=True)
        settings.prepare(self.world)
        self.simulation = modelled_simulation(self.world, clock_speed, draws)
        recordings = options.folder / "recordings" if options.own_folder else settings.recordings
        with naming_settings(options.settings):
            self.api = Api(self.simulation, settings, recordings=recordings, say=warn)
        self.api.refusals.say = warn
        self.simulation.settle(0)
        self.states, tick_ns = [self.simulation.kinematics()], profile.tick_ns
        self.world.watch(INTERVAL_NS // tick_ns, lambda _: self.states.append(self.simulation.kinematics()))
        self.world.watch(KEEP_NS // tick_ns, lambda _: self.api.scenery.recorder.keep())
        self.transport = VirtualTransport(self.api, clock, draws)
        self.transport.catch_up()


def warn(line: str) -> None:
    print(f"uavaccel: warning: {line.removeprefix('warning: ')}", file=sys.stderr, flush=True)


class SimulatedConnection:
    """A client's connection to a flight, on whose clock an answer may take `timeout_s` from when it is waited for.

    `watched` are its calls that scripts have attached callbacks to, with their numbers in the log.
    """

    def __init__(self, send: Callable[..., PendingCall], timeout_s: float) -> None:
        from uavaccel.airsim.connection import patience_ns

        self._send, self.timeout_ns = partial(send, self), patience_ns(timeout_s)
        self.watched: dict[PendingCall, int] = {}

    def call(self, method: str, *params: object) -> Received:
        return self._send(method, params, blocking=True).get()

    def call_async(self, method: str, *params: object) -> Future:
        return self._send(method, params, blocking=False)

    def close(self) -> None:
        pass


class SimulatedFlight:
    """Runs a script on a simulated clock. Equal scripts and options give equal messages and trajectories, to the byte.

    `options.until_s` bounds wall time times ClockSpeed: the call, sleep or reading of the clock that reaches it raises
    FlightOver. The simulation is made when a client connects.
    """

    def __init__(self, options: FlightOptions, settings: Settings | None, clock_speed: float, log: MessageLog) -> None:
        self._options, self._settings, self._clock_speed = options, settings, clock_speed
        self._log = log
        self._clock: WallClock = VirtualClock()
        self._think_ns = round(options.thinks_s * NS_PER_S)
        self._poll_ns = POLL_NS if options.timing == "lockstep" and not self._think_ns else 0
        until_s = options.until_s
        self._until_ns = None if until_s is None else round(until_s * NS_PER_S / clock_speed)
        self._patience_ns = round(PATIENCE_NS / clock_speed)
        self._calls_since_wait, self._slept_ns = 0, 0
        self._made_s = 0.0  # wall time that making the simulation took
        self._over = False
        self._turns = Turns(self._clock, self._until_ns)
        self._stack = contextlib.ExitStack()  # what is around the script
        self._is_child = False

    @cached_property
    def _world(self) -> ScriptWorld:
        assert isinstance(self._clock, VirtualClock)
        machine = MonotonicClock()
        begun_ns = machine.now_ns()
        from uavaccel.sim.camera.gl import let_go
        from uavaccel.wire.settings import Settings

        self._turns.before_passing = let_go
        world = ScriptWorld(self._options, self._settings or Settings(), self._clock_speed, self._clock)
        self._turns.flown_ns = lambda: world.simulation.time_ns
        self._made_s += (machine.now_ns() - begun_ns) / NS_PER_S
        return world

    def _has_world(self) -> bool:
        return "_world" in vars(self)

    @property
    def unflown_s(self) -> float:
        """The wall time of the script that making the simulation and its client took."""
        return self._made_s + self._client.spent_s

    def run(self) -> ScriptResult:
        """Run the script in its environment. Raises UserError."""
        modules, options = ThreadModules(self._turns), self._options
        clock = time_module(self.epoch_now_ns, self.pass_time)
        outside = OutsideEvents(self._turns, clock)
        in_scripts = {"time": clock, "datetime": datetime_module(self.epoch_now_ns)}
        in_scripts |= modules.in_scripts() | outside.in_scripts()
        with self._stack as stack:
            environment = script_environment(self._connect, in_scripts, options, None, self._forked)
            patches, self._client = stack.enter_context(environment)
            stack.enter_context(ended_by_refusals(lambda: self._log.calls))
            SharedModules(patches, self._turns, modules, outside, clock)
            if options.film:
                stack.enter_context(filming(self._world.simulation, options.folder))
            stack.callback(self._let_nobody_fly)
            outcome = run_script(options.script, options.arguments, self._outlive)
            self._catch_up()  # to the end of the script's last wait
            return outcome._replace(wall_s=outcome.wall_s - self.unflown_s)

    def _let_nobody_fly(self) -> None:
        """Let later calls, such as those of destructors, raise FlightOver."""
        self._over = True

    def end(self) -> None:
        """Write the trajectory, and print which calls were refused."""
        self._let_nobody_fly()
        self._stack.close()  # it is open where the script did not let it end
        if not self._has_world():
            return
        api = self._world.api
        api.scenery.recorder.stop()
        write_states(self._options.folder, self._world.states)
        if refused := api.refusals.lines():
            print("uavaccel: refused calls:", *refused, sep="\n  ", file=sys.stderr)

    def summary(self) -> FlightSummary:
        """Return the flight's durations and its last position: SI units, NED; no position if no client connected."""
        summary: FlightSummary = {"simulated_s": 0.0, "position_m": None, "refused": []}
        if self._has_world():
            simulation = self._world.simulation
            summary = {
                "simulated_s": simulation.time_ns / NS_PER_S,
                "position_m": list(simulation.kinematics().position_m),
                "failure": simulation.failure,
                "refused": self._world.api.refusals.lines(),
            }
        return {
            **summary,
            "script_s": self._clock.now_ns() / NS_PER_S,
            "slept_s": self._slept_ns / NS_PER_S,
            "think_s": self._think_ns / NS_PER_S,
        }

    def _forked(self) -> None:
        """In a forked process: drop its copy of the world, and use the machine's clock."""
        self._is_child, self._until_ns, self._clock = True, None, MonotonicClock()
        self._turns.forked(self._clock)
        self._log.abandon()
        vars(self).pop("_world", None)

    def _connect(self, host: str, port: int, timeout_s: float) -> SimulatedConnection:
        self._check_process()
        self._world  # noqa: B018  makes it
        return SimulatedConnection(self._send, timeout_s)

    # --- the script's clock -----------------------------------------------------------------------

    def epoch_now_ns(self) -> int:
        """Return the time that the script reads."""
        from uavaccel.wire.types import stamp

        self._clock.charge(READING_NS)
        self._stop_at_the_end()
        return stamp(self._clock.now_ns())

    def pass_time(self, seconds: float) -> None:
        """Let the script wait while the simulation runs. Raises ValueError below 0, as time.sleep does."""
        self._turns.check_thread()
        if seconds < 0:
            raise ValueError("sleep length must be non-negative")
        wait_ns = round(seconds * NS_PER_S)
        self._calls_since_wait = 0
        if not (self._has_world() and self._world.simulation.paused):
            self._slept_ns += wait_ns
        end_ns = self._clock.now_ns() + wait_ns
        self._turns.wait_until(end_ns if self._until_ns is None else min(end_ns, self._until_ns))
        self._catch_up()
        self._stop_at_the_end()

    # --- the script's calls -----------------------------------------------------------------------

    def _send(
        self, client: SimulatedConnection, method: str, params: tuple[object, ...], blocking: bool
    ) -> PendingCall:
        self._check_caller()
        from uavaccel.airsim.connection import as_sent

        self._stop_at_the_end()
        self._calls_since_wait += 1
        self._clock.charge(self._think_ns + (self._poll_ns if self._calls_since_wait > FREE_CALLS else 0))
        sent, world = [as_sent(value) for value in params], self._world
        number = self._log.call(self._clock.now_ns(), world.simulation.time_ns, method, sent)
        call = world.transport.send(method, sent, blocking)
        call.wait = partial(self._wait, number=number, client=client)  # an error has been reported as a refusal
        call.watch = lambda call: client.watched.update({call: number})
        return call

    def _check_caller(self) -> None:
        self._check_process()
        self._turns.check_thread()
        if self._over:
            raise FlightOver

    def _wait(self, call: PendingCall, number: int, client: SimulatedConnection) -> None:
        self._check_caller()
        from uavaccel.airsim.connection import answer_late, print_once

        if call.deferred is not None:
            self._calls_since_wait = 0
        now_ns = self._clock.now_ns()
        patient_until_ns: int | None = now_ns + self._patience_ns
        late_ns, world = now_ns + client.timeout_ns, self._world
        client.watched.pop(call, None)
        while not call.done:
            self._tell(client)
            told_ns = self._next_told_ns(client)
            wake_ns = earliest(patient_until_ns, late_ns, told_ns, self._until_ns, self._turns.earliest_ns())
            if world.transport.wait(call, wake_ns):
                self._arrive(call, number)
                return
            self._stop_at_the_end()
            now_ns = self._clock.now_ns()
            if told_ns is not None and now_ns >= told_ns:
                continue
            if patient_until_ns is not None and now_ns >= patient_until_ns:
                patient_until_ns = None
                if not world.simulation.paused:
                    position = " ".join(f"{metres:.1f}" for metres in world.simulation.kinematics().position_m)
                    touch = world.world.lead.contact_log.latest
                    where = f"{position} m" + (f", last touched {touch.object}" if touch else "")
                    waited = f"the script has waited {PATIENCE_NS / NS_PER_S:g} simulated s for {call.method}"
                    warn(f"{waited}; the vehicle is at {where}")
            elif now_ns >= late_ns:
                answer_late(call, client.timeout_ns)
                call.reply_wall_ns = now_ns
                self._arrive(call, number)
                print_once(call.method, str(call.error))
            else:
                event_ns = call.reply_wall_ns
                if event_ns is None:
                    event_ns = world.simulation.next_event_wall_ns()
                expected_ns = now_ns + TURN_POLL_NS if event_ns is None else max(now_ns, event_ns)
                wake_ns = earliest(expected_ns, late_ns, told_ns, self._until_ns) or now_ns
                self._turns.wait_until(wake_ns, call.ended_early)  # another thread's time has come

    def _arrive(self, call: PendingCall, number: int) -> None:
        from uavaccel.airsim.connection import as_received

        call.result = as_received(call.result)
        self._log.answer(number, call.reply_wall_ns or 0, call.error, call.result)

    def _tell(self, client: SimulatedConnection) -> None:
        """Call what is attached to a client's calls whose answers have arrived, in the order of their arrival."""
        now_ns, transport = self._clock.now_ns(), self._world.transport
        arrived = [call for call in client.watched if transport.wait(call, now_ns)]
        for call in sorted(arrived, key=lambda call: call.reply_wall_ns or 0):
            if (number := client.watched.pop(call, None)) is not None:  # not yet told meanwhile
                self._arrive(call, number)
                call.tell()

    def _next_told_ns(self, client: SimulatedConnection) -> int | None:
        """Return when such an answer arrives next or, of a flight command in progress, something happens."""
        replies_ns = [call.reply_wall_ns for call in client.watched]
        event_ns = self._world.simulation.next_event_wall_ns() if None in replies_ns else None
        return earliest(*replies_ns, event_ns)

    def _outlive(self) -> None:
        """Wait for the script's other threads, except daemons, when its first one is done."""
        end_pools()
        self._turns.until(lambda: all(thread.daemon for thread in self._turns.running))

    def _catch_up(self) -> None:
        if self._has_world():
            self._world.transport.catch_up()

    def _stop_at_the_end(self) -> None:
        if self._until_ns is not None and self._clock.now_ns() >= self._until_ns:
            self._catch_up()
            raise FlightOver

    def _check_process(self) -> None:
        if self._is_child:
            raise refusal()


def earliest(*times_ns: int | None) -> int | None:
    return min((time_ns for time_ns in times_ns if time_ns is not None), default=None)
