"""A flight shown while it is flown: a simulation tells a page, in another process, what happens in its world.

The page (uavaccel.watch.sources) listens on a Unix socket whose path is in the environment variable PAGE, which every
process of a command inherits. Nothing here is a message of a client: no wall time of a simulated clock passes, and no
flight changes. A flight on a simulated clock can be held, since that clock is paused too; one on the machine's cannot.
"""

from __future__ import annotations

import json
import os
import select
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict
from weakref import ReferenceType, WeakKeyDictionary, finalize, ref

import numpy as np

from uavaccel.clock import MonotonicClock
from uavaccel.kinematics import Vector
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:  # a command that opens a page needs none of them
    from uavaccel.sim.simulation import Simulation
    from uavaccel.sim.vehicle.vehicle import Vehicle
    from uavaccel.sim.world import World

PAGE = "UAVACCEL_WATCH_PAGE"
"""The environment variable with the path of the page's Unix socket, which every process of a command inherits."""
MESSAGE_BYTES = 1 << 16
REFRESH_NS = 33_000_000  # simulated, between two refreshes
SHORTEST_NS, UNSEEN_NS = (5_000_000, 200_000_000)  # of the machine's time, between two messages; where nobody looks
UNWATCHED_REFRESHES = 10  # of a simulated clock, of which one is taken where nobody looks
MEASURED_NS = 10_000_000  # of the machine's time, between two refreshes at a flight on its clock
SCENE_NS = 200_000_000  # the same between two scenes, of a script that moves objects all the time
LATE_NS = 250_000_000  # a flight that is later than this for its pace is not hurried
ANSWER_S = 5.0  # the longest wait for the page's first orders


class Orders(TypedDict):
    """The page's orders to a flight: `held` until it is told to go on, but for `refreshes` that are let pass."""

    seen: bool
    """Whether somebody looks at it: otherwise the page needs to hear now and then only that it flies."""
    held: bool
    pace: float | None
    """Simulated seconds per second of the machine's; None for as fast as it flies."""
    refreshes: int


FREE: Orders = {"seen": False, "held": False, "pace": None, "refreshes": 0}
"""Those of a flight that is not shown, or that nobody looks at."""


def show_on_page(simulation: Simulation, may_pause: bool) -> None:
    """Let the page, if the command has one, follow a new simulation; `may_pause` says that its clock is simulated."""
    page = os.environ.get(PAGE)
    if page is None:
        return
    known = _BROADCASTS.get(simulation.world)
    broadcast = None if known is None else known()
    if broadcast is None:
        try:
            broadcast = Broadcast(Path(page), may_pause)
        except OSError:  # the page has gone
            return
        _BROADCASTS[simulation.world] = ref(broadcast)
    broadcast.follow(simulation)


class Broadcast:
    """What one world does, as messages to the page; it is an observer of that world, which keeps it alive."""

    def __init__(self, page: Path, may_pause: bool) -> None:
        self._page, self._may_pause = page, may_pause
        self._clock = MonotonicClock()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        finalize(self, self._socket.close)
        self._socket.connect(str(page))
        self._socket.setblocking(False)
        self._ready = select.poll()
        self._ready.register(self._socket, select.POLLIN)
        self._orders: Orders = {**FREE}
        self._open, self._refreshes = True, 0
        self._stop_watching: Callable[[], None] = lambda: None
        self._flight = self._sent_ns = self._shown_ns = 0
        self._tick = self._told_tick = -1
        self._revision: int | None = None
        if may_pause:
            self._hear(ANSWER_S)

    def follow(self, simulation: Simulation) -> None:
        """Tell of this simulation from now on, which may be a further one of the same world."""
        if not self._open:
            return
        self._simulation = simulation
        self._begin()
        self._watch()
        if simulation.world.revision != self._revision:
            self._show_scene()

    def _watch(self) -> None:
        """Look as often as the page's orders need."""
        refreshes = 1 if self._orders["seen"] else UNWATCHED_REFRESHES
        if not self._may_pause:  # refreshes take some of the machine's time from a measured flight
            refreshes = max(1, int(self._simulation.clock_speed * MEASURED_NS / REFRESH_NS))
        if refreshes == self._refreshes:
            return
        self._stop_watching()
        every = max(1, round(REFRESH_NS / self._simulation.profile.tick_ns))
        self._stop_watching = self._simulation.world.watch(refreshes * every, self._refresh)
        self._refreshes = refreshes

    def _refresh(self, tick: int) -> None:
        if tick <= self._tick:  # reset
            self._begin()
        self._tick = tick
        due = self._clock.now_ns() - self._sent_ns >= (SHORTEST_NS if self._orders["seen"] else UNSEEN_NS)
        if due:
            self._tell()
            self._hear(0.0)
            self._watch()
        if self._may_pause and self._orders["seen"]:
            self._follow_pace()
        if not self._open:
            self._stop_watching()

    def _tell(self) -> None:
        """Send the present state, once."""
        if self._told_tick == self._tick:
            return
        now_ns = self._clock.now_ns()
        changed = self._simulation.world.revision != self._revision
        if changed and now_ns - self._shown_ns >= SCENE_NS:
            self._show_scene()
        self._send({"state": self._state()})
        self._sent_ns, self._told_tick = now_ns, self._tick

    def _begin(self) -> None:
        self._flight += 1
        self._tick = self._told_tick = -1
        self._anchor(self._clock.now_ns())

    def _state(self) -> dict[str, object]:
        simulation, world = self._simulation, self._simulation.world
        return {
            "flight": self._flight,
            "may_pause": self._may_pause,
            "clock_speed": float(simulation.clock_speed),
            "time_ns": world.tick * simulation.profile.tick_ns,
            "wall_ns": simulation.pacer.wall_due(world.tick),
            "qpos": world.data.qpos.tolist(),
            "commanded": [pilot.command is not None for pilot in simulation.pilots],
            "towards": [None if pilot.command is None else heading(pilot.vehicle) for pilot in simulation.pilots],
        }

    def _show_scene(self) -> None:
        """Send the model, as it is at present, through a file that the page removes."""
        import mujoco

        world = self._simulation.world
        self._shown_ns = self._clock.now_ns()
        model = np.zeros(mujoco.mj_sizeModel(world.model), np.uint8)
        mujoco.mj_saveModel(world.model, None, model)
        file = self._page.with_name(f"{os.getpid()}-{id(self)}-{self._shown_ns}.mjb")
        try:
            file.write_bytes(model.tobytes())
        except OSError:  # the page has gone, and its folder with it
            return self._close()
        vehicles = [{"name": vehicle.name, "body": vehicle.body_id} for vehicle in world.vehicles]
        scene = {"model": str(file), "vehicles": vehicles, "qpos": world.data.qpos.tolist()}
        if self._send({"scene": scene}):
            self._revision = world.revision
        else:
            file.unlink(missing_ok=True)
        return None

    # --- the page's orders ------------------------------------------------------------------------

    def _follow_pace(self) -> None:
        """Let the machine's time pass until the next refresh is due, in which the simulated clock is paused."""
        while self._open:
            if self._orders["held"]:
                if self._orders["refreshes"] > 0:
                    self._orders["refreshes"] -= 1
                    return
                self._tell()  # where it is held
                self._hear(None)
                continue
            now_ns, due_ns, pace = self._clock.now_ns(), self._anchor_ns, self._orders["pace"]
            if pace is not None:
                due_ns += round((self._simulation.time_ns - self._anchor_time_ns) / pace)
            if now_ns - due_ns > LATE_NS:
                self._anchor(now_ns)
            if due_ns <= now_ns or not self._hear((due_ns - now_ns) / NS_PER_S):
                return

    def _anchor(self, now_ns: int) -> None:
        self._anchor_ns, self._anchor_time_ns = now_ns, self._simulation.time_ns

    def _hear(self, seconds: float | None) -> bool:
        """Take the page's next orders, if they come within these seconds; None waits for ever."""
        if not self._open or not self._ready.poll(None if seconds is None else 1000.0 * seconds):
            return False
        try:
            message = self._socket.recv(MESSAGE_BYTES)
        except OSError:
            message = b""
        if not message:  # the page has gone: fly on without
            self._close()
            return False
        self._orders = json.loads(message)
        if self._refreshes:
            self._anchor(self._clock.now_ns())
        return True

    def _send(self, message: Mapping[str, object]) -> bool:
        """Send without waiting; False for what a busy page had no room for, which is dropped."""
        if not self._open:
            return False
        try:
            self._socket.send(json.dumps(message).encode())
            return True
        except BlockingIOError:
            return False
        except OSError:
            self._close()
            return False

    def _close(self) -> None:
        self._open = False
        self._socket.close()


_BROADCASTS: WeakKeyDictionary[World, ReferenceType[Broadcast]] = WeakKeyDictionary()


def heading(vehicle: Vehicle) -> Vector | None:
    """Return where a vehicle's goal leads, NED: its velocity in m/s, or the way to its place in m; None of others."""
    from uavaccel.sim.vehicle import autopilot

    state, towards = vehicle.state, [0.0, 0.0, 0.0]
    for axis, mode in enumerate((int(state["xy_mode"]), int(state["xy_mode"]), int(state["z_mode"]))):
        if mode == autopilot.VELOCITY:
            towards[axis] = float(state["goal"][axis])
        elif mode == autopilot.POSITION:
            towards[axis] = float(state["goal"][axis] - state["position"][axis])
    if int(state["xy_mode"]) not in (autopilot.VELOCITY, autopilot.POSITION):
        return None
    return towards[0], towards[1], towards[2]
