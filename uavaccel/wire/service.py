"""A free-running server for AirSim's clients, until Ctrl-C (`uavaccel serve`), or for a session, until its input ends.

    python -m uavaccel.wire.service '{"scene": "blocks", "profile": "native", "core": null, "parent": 1}'

serves a session on a free loopback port, and prints one line of JSON: {"port": ...} when it listens, {"error": ...} for
a scene that cannot be flown in.
"""

from __future__ import annotations

import gc
import ipaddress
import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.processes.lifetime import end_with_parent
from uavaccel.resources import scene_file
from uavaccel.sim.profile import PROFILES, Profile
from uavaccel.sim.simulation import Simulation, Speed
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S
from uavaccel.wire.api import Api
from uavaccel.wire.broadcast import show_on_page
from uavaccel.wire.game_api import FASTEST
from uavaccel.wire.server import Server
from uavaccel.wire.settings import Settings, naming_settings, read_settings

PERIOD_NS = 2 * NS_PER_S  # interval of the reports on the achieved speed
WORTH_TELLING = 0.005  # fraction of lost wall time that is reported


@dataclass(frozen=True)
class ServeOptions:
    """The options on the command line; None leaves the choice to the settings."""

    settings: Path | None = None
    clock_speed: float | None = None
    port: int | None = None
    host: str | None = None
    profile: str = "native"
    scene: str = "blocks"
    recordings: Path | None = None


def main() -> None:
    """Serve a session."""
    options = json.loads(sys.argv[1])
    end_with_parent(options["parent"])
    if options["core"] is not None:
        os.sched_setaffinity(0, {options["core"]})
    try:
        simulation = ready_simulation(options["scene"], PROFILES[options["profile"]])
    except UserError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return
    simulation.pause(MonotonicClock().now_ns())
    server = Server(Api(simulation), port=0, stop_at_eof=sys.stdin.buffer)
    with suppress(BrokenPipeError):  # the session has gone: standard input has ended too
        print(json.dumps({"port": server.address[1]}), flush=True)
    server.serve()


def ready_simulation(scene: str, profile: Profile, clock_speed: float = 1.0, airsim: bool = False) -> Simulation:
    """Return a settled hover on the machine's clock, with everything compiled and loaded that could delay it later.

    `airsim` prepares the scene for AirSim's clients (uavaccel.sim.scene).
    """
    world = World(scene, profile, airsim)
    world.advance(1)  # compiles the hot loop, or loads it
    world.reset()
    gc.freeze()  # what is loaded by now stays; collecting it again would delay the clock
    simulation = Simulation(world, clock_speed, MonotonicClock().now_ns(), profile.catch_up_wall_ns)
    show_on_page(simulation, may_pause=False)
    return simulation


def serve(options: ServeOptions) -> None:
    """Listen, print the address, and serve until SIGINT or SIGTERM. Raises UserError with one line."""
    settings = read_settings(options.settings) if options.settings else Settings()
    host = address_of(options, settings)
    api = api_of(options, settings)
    try:  # draw once, so that no client's first image delays the clock
        api.scenery.pictures.warm_up()
    except UserError as error:
        say(f"warning: there are no images: {error}")
    gc.freeze()  # OpenGL's modules stay too: collecting them again and again would delay the clock
    api.simulation.reset(MonotonicClock().now_ns())
    api.simulation.settle(MonotonicClock().now_ns())  # the clock starts now
    server = Server(api, host, settings.api_server_port if options.port is None else options.port)
    if settings.recording.enabled:
        try:
            api.scenery.recorder.start(MonotonicClock().now_ns())
        except (OSError, ValueError) as error:  # the latter for a name with a zero byte
            raise UserError(f"the recording cannot be written: {error}") from None
    api.refusals.say = lambda line: say(f"warning: {line}")
    report = ServerReport(server)
    with stopped_by_signals(server):
        greet(server, options, settings)
        try:
            server.serve(report.each_turn)
        finally:
            report.finish()


def address_of(options: ServeOptions, settings: Settings) -> str:
    """Return the address to listen on: beyond this machine only if the command line names it. Raises UserError."""
    if options.host is None and not is_loopback(settings.address):
        raise UserError(
            f"{options.settings}: LocalHostIp = {settings.address!r} listens beyond this machine, where anybody may "
            f"fly the drone; if that is meant, add --host {settings.address}"
        )
    return options.host or settings.address


def is_loopback(host: str) -> bool:
    """Return whether an address is reachable from this machine only."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def api_of(options: ServeOptions, settings: Settings) -> Api:
    """Return the calls on a simulation of the scene, settled and running; options go before settings.

    Raises UserError for a ClockSpeed that is too high, an unknown scene or profile, wrong settings, and a folder of
    recordings that is a file.
    """
    chosen = options.clock_speed
    speed = settings.clock_speed if chosen is None else chosen
    if speed > FASTEST:  # the simulation refuses 0 and below
        raise UserError(f"ClockSpeed must be at most {FASTEST:g}, not {speed:g}")
    if options.profile not in PROFILES:
        raise UserError(f"--profile {options.profile}: there are {', '.join(PROFILES)}")
    scene_file(options.scene, "--scene ")
    with naming_settings(options.settings):
        profile = settings.recorder_of(PROFILES[options.profile])
    simulation = ready_simulation(options.scene, profile, speed, airsim=True)
    settings.prepare(simulation.world)
    folder = options.recordings or settings.recordings
    if folder.exists() and not folder.is_dir():
        where = "--recordings" if options.recordings else f"{options.settings}: Recording.Folder ="
        raise UserError(f"{where} {folder}: is no folder")
    with naming_settings(options.settings):
        return Api(simulation, settings, recordings=folder, say=say)


def greet(server: Server, options: ServeOptions, settings: Settings) -> None:
    """Print where the server listens, and the state of its vehicles."""
    host, port = server.address
    simulation = server.api.simulation
    lead, *others = simulation.world.vehicles
    listens = f"listening on {host}:{port}: scene {options.scene}, profile {options.profile}"
    say(f"{listens}, ClockSpeed {float(simulation.clock_speed):g}")
    how = "stands" if lead.start.idle else f"hovers {-lead.start.position_m[2]:g} m up"
    more = f", {len(others)} more beside it" if others else ""
    state = f"{lead.name} {'is a camera' if settings.flightless else how}{more}"
    say(f"{state}; the clock runs and API control is off, as in AirSim; Ctrl-C stops")
    if not is_loopback(host):
        say(f"warning: whoever reaches {host}:{port} may fly the drone; AirSim's protocol has no password")
    if warning := settings.warning(options.settings):
        say(warning)


@contextmanager
def stopped_by_signals(server: Server) -> Iterator[None]:
    """Let SIGINT and SIGTERM stop the server after its present wake-up."""
    before = {kind: signal.signal(kind, lambda *_: server.stop()) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


class ServerReport:
    """The server's periodic report on the terminal, and the periodic upkeep of its recording."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self._simulation = server.api.simulation
        self._next_ns = server.clock.now_ns() + PERIOD_NS
        self._speed = self._simulation.speed
        self._total = Speed()
        self._warned_of_lost_ns = 0
        self._failure: str | None = None

    def each_turn(self) -> None:
        """To be called after every wake-up; cheap except once in PERIOD_NS."""
        if self._simulation.speed is not self._speed:  # a reset begins a new count
            self._total, self._speed = self._sum(), self._simulation.speed
        if self._server.clock.now_ns() >= self._next_ns:
            self._next_ns = self._server.clock.now_ns() + PERIOD_NS
            self._each_period()

    def finish(self) -> None:
        """Close the recording, and print the achieved speed and the refused calls."""
        self._server.api.scenery.recorder.stop()
        say(f"stopped; {self._text()}")
        for line in self._server.api.refusals.lines():
            say(f"  {line}")

    def _each_period(self) -> None:
        self._server.api.scenery.recorder.keep()
        speed = self._sum()
        if speed.lost_wall_ns > max(2 * self._warned_of_lost_ns, speed.wall_ns * WORTH_TELLING):
            self._warned_of_lost_ns = speed.lost_wall_ns  # a few lines, however long it goes on
            say(f"warning: the machine does not keep up; {self._text()}")
        failure = self._simulation.failure
        if failure and failure != self._failure:
            say(f"warning: the flight cannot go on ({failure}); a reset starts anew")
        self._failure = failure
        if sys.stdout.isatty():
            say(self._text(), end="\r")

    def _sum(self) -> Speed:
        one, other = self._total, self._speed
        lost_ns = one.lost_wall_ns + other.lost_wall_ns
        return Speed(one.simulated_ns + other.simulated_ns, one.wall_ns + other.wall_ns, lost_ns)

    def _text(self) -> str:
        speed, requested = self._sum(), float(self._simulation.clock_speed)
        lost = f", {speed.lost_wall_ns / NS_PER_S:.3f} s of wall time lost" if speed.lost_wall_ns else ""
        achieved = f"achieved {speed.real_time_factor:.2f}x over {speed.wall_ns / NS_PER_S:.1f} s"
        return f"requested {requested:g}x, {achieved}{lost}"


def say(text: str, end: str = "\n") -> None:
    """Print a line at once; on a terminal it overwrites what "\\r" left there."""
    print(text + ("\x1b[K" if sys.stdout.isatty() else ""), end=end, flush=True)


if __name__ == "__main__":
    main()
