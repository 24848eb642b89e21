"""A flight on a simulated wall clock: the simulation, the script's connection to it, and the script's time."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from uavaccel.airsim.connection import Future, plain
from uavaccel.clock import VirtualClock
from uavaccel.errors import UserError
from uavaccel.fly.messages import MessageLog
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.watched import WatchedWorld
from uavaccel.units import NS_PER_S
from uavaccel.wire.api import Api
from uavaccel.wire.latency import ZERO_LATENCY, Latency, LatencyConfig
from uavaccel.wire.settings import Settings
from uavaccel.wire.transport import Call, VirtualTransport

EPOCH_NS = 1_767_225_600 * NS_PER_S  # what the script's clock shows at the start: 2026-01-01, 0:00 UTC
READING_NS = 10_000  # what a look at the clock costs the script, so that a loop that waits for a time ends
FREE_CALLS = 100  # without latencies, so many calls at one time are taken for granted;
POLL_NS = 1_000_000  # each one more costs so much, so that a loop that waits for a state ends


class Enough(BaseException):
    """The script has flown as long as it was allowed to; no `except Exception` of its own holds that up."""


def running_api(
    settings: Settings, clock_speed: float, profile: str, scene: str, latency: LatencyConfig
) -> Api:
    """A settled hover, the clock running and API control off, as a server has it. Raises UserError."""
    draws, platform = Latency(latency, np.random.SeedSequence(1)), latency.platform
    recorded = settings.recorder_of(platform.profile(profile, clock_speed))
    simulation = Simulation(
        WatchedWorld(scene, recorded),
        clock_speed,
        timer_lateness_ns=draws.timer_ns,
        executor=platform.executor(),
        frames=platform.new_frames(draws.frame_ns),
    )
    simulation.world.state["wind"] = (settings.wind.x, settings.wind.y, settings.wind.z)
    return Api(simulation, settings)


class Flight:
    """What a script lives in: its calls, its clock and its waits. Deterministic.

    `until_s` bounds wall time times ClockSpeed: the call, sleep or look at the clock that reaches it raises Enough.
    """

    def __init__(
        self,
        api: Api,
        latency: LatencyConfig,
        log: MessageLog,
        think_s: float = 0.0,
        until_s: float | None = None,
    ) -> None:
        self.api, self.simulation, self.log = api, api.simulation, log
        self._clock = VirtualClock()
        self._transport = VirtualTransport(api, self._clock, Latency(latency, np.random.SeedSequence(0)))
        self._think_ns = round(think_s * NS_PER_S)
        self._poll_ns = POLL_NS if latency is ZERO_LATENCY else 0
        speed = self.simulation.clock_speed
        self._until_ns = None if until_s is None else round(until_s * NS_PER_S / speed)
        self._calls_at_once = 0
        self._thread = threading.get_ident()

    # --- the script's clock -----------------------------------------------------------------------

    def epoch_now_ns(self) -> int:
        """What the script reads."""
        self._clock.charge(READING_NS)
        self._stop_at_the_end()
        return EPOCH_NS + self._clock.now_ns()

    def sleep(self, seconds: float) -> None:
        """The script waits so long; the simulation goes on. Raises ValueError below 0, as time.sleep does."""
        self._check_thread()
        if seconds < 0:
            raise ValueError("sleep length must be non-negative")
        self._calls_at_once = 0
        until_ns = self._clock.now_ns() + round(seconds * NS_PER_S)
        self._clock.sleep_until(until_ns if self._until_ns is None else min(until_ns, self._until_ns))
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

    def end(self) -> None:
        """Fly what the script still waited for, and close the log. Raises DifferenceError."""
        self._transport.catch_up()
        self.log.close()

    def summary(self) -> dict[str, Any]:
        """Where and when the flight ended, in SI units, NED."""
        state = self.simulation.kinematics()
        return {
            "clock_speed": float(self.simulation.clock_speed),
            "simulated_s": self.simulation.time_ns / NS_PER_S,
            "script_s": self._clock.now_ns() / NS_PER_S,
            "calls": self.log.calls,
            "position_m": list(state.position_m),
            "failure": self.simulation.failure,
        }

    def _send(self, method: str, params: tuple[Any, ...], blocking: bool) -> tuple[Call, int]:
        self._check_thread()
        self._think()
        sent = as_sent(list(params))
        number = self.log.call(self._clock.now_ns(), self.simulation.time_ns, method, sent)
        return self._transport.send(method, sent, blocking), number

    def _think(self) -> None:
        self._stop_at_the_end()
        self._clock.charge(self._think_ns)
        self._calls_at_once += 1
        if self._calls_at_once > FREE_CALLS:
            self._clock.charge(self._poll_ns)

    def _join(self, future: Future, call: Call, number: int) -> None:
        self._check_thread()
        self._wait(call, number)
        future.answer(call.error, call.value)  # the server's side tells of an error already

    def _wait(self, call: Call, number: int) -> None:
        if call.deferred is not None:
            self._calls_at_once = 0
        if not self._transport.wait(call, self._until_ns):
            raise Enough
        self.log.answer(number, call.reply_wall_ns or 0, call.error, call.value)

    def _stop_at_the_end(self) -> None:
        if self._until_ns is not None and self._clock.now_ns() >= self._until_ns:
            raise Enough

    def _check_thread(self) -> None:
        if threading.get_ident() != self._thread:
            raise UserError(
                "a second thread of the script calls; on a simulated clock one thread flies: --timing wall"
            )


def as_sent(value: Any) -> Any:
    """A value as it would arrive at a server: AirSim's types as maps, NumPy's numbers as numbers."""
    if isinstance(value, bool | int | float | str | bytes) or value is None:
        return value if type(value) in (bool, int, float, str, bytes, type(None)) else as_builtin(value)
    if isinstance(value, Mapping):
        return {key: as_sent(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [as_sent(inner) for inner in value]
    return as_sent(plain(value))


def as_builtin(value: Any) -> Any:
    """The plain value of an enumeration's member, or of NumPy's float64, which is a float."""
    for kind in (int, float, str, bytes):
        if isinstance(value, kind):
            return kind(value)
    return value
