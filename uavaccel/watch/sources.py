"""What the page shows: recorded flights that are replayed, and flights that are told while they are flown."""

from __future__ import annotations

import json
import selectors
import socket
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import mujoco
import numpy as np

from uavaccel.files import Plain
from uavaccel.sim.clutter import ClutterLayout
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S, ned_to_mujoco
from uavaccel.watch.page import DroneState, Moment, Source
from uavaccel.watch.replay import Track
from uavaccel.watch.scene import Scene, pose_of
from uavaccel.wire.broadcast import FREE, MESSAGE_BYTES, Orders

STEP_S = 0.05  # simulated, of a replay
MOST_STOPS = 1000  # about, that a path is drawn through at once
APART_M = 4.6
FARTHEST_M = 10.0  # of a flight that is seen whole; the view goes along with a longer one
NEAR_M = 3.0
BACKLOG = 256
PATIENCE_S = 1.0  # after which a silent flight makes way for another
SILENT_S = 0.5  # after which the table says that nothing is flown
MACHINES = "the machine's"


class Replay(Source):
    """Recorded flights that begin together, side by side; the path of the last one is the others' ideal."""

    step_hint = f"{STEP_S:g} simulated seconds"
    clock_speed: float

    def __init__(self, tracks: Sequence[Track], fly_at: Callable[[float], Sequence[Track]] | None = None) -> None:
        """`fly_at` flies them at another ClockSpeed, which the spectators may then choose."""
        self._begun, self._wanted = 0, list[float]()
        self._fly_at, self.fly_at = fly_at, None if fly_at is None else self._wanted.append
        self._take(tracks)
        places = np.concatenate([track.flight.position_m for track in tracks])
        half_m = float(np.ptp(places, axis=0).max()) / 2
        follows = len(tracks) == 1 and half_m > FARTHEST_M
        centre = places[0] if follows else (places.min(axis=0) + places.max(axis=0)) / 2
        reach_m = NEAR_M if follows else max(half_m + APART_M * (len(tracks) - 1) / 2, NEAR_M)
        world = World(tracks[0].flight.scene, PROFILES["native"])
        layout = tracks[0].flight.lane
        if isinstance(layout, ClutterLayout):
            world.set_clutter(layout)
        elif layout is not None:
            world.set_lane(layout)
        bodies = dict.fromkeys([track.name for track in tracks], world.lead.body_id)
        self.scene = Scene(world.model, world.data, bodies, ned_to_mujoco(centre), reach_m, follows, APART_M)

    def _take(self, tracks: Sequence[Track]) -> None:
        self._tracks, (*others, ideal) = tracks, tracks
        self.clock_speed, self._end_s = ideal.flight.clock_speed, max(track.wall_s for track in tracks)
        stops_s = [np.interp(track.time_s, track.marks[:, 1], track.marks[:, 0]) for track in tracks]
        self._stops_s = np.unique(np.concatenate(stops_s))  # between two of them the drones fly straight on
        self.ideal = ideal.name if others else ""
        self.ideal_m = {track.name: ned_to_mujoco(ideal.flight.position_m) for track in others}
        self.note = "; ".join(
            f"{track.name} leaves the path of {ideal.name} by up to {track.farthest_from(ideal):.2f} m"
            for track in others
        )
        self.begin()

    def begin(self) -> None:
        """Show it from its beginning."""
        self._begun, self._at_s, self._fresh, self.held = self._begun + 1, 0.0, True, False

    @property
    def progress_s(self) -> tuple[float, float]:
        return self._at_s * self.clock_speed, self._end_s * self.clock_speed

    def toggle(self) -> None:
        """Pause, or go on; at the end begin anew."""
        if self._at_s < self._end_s:
            super().toggle()
        else:
            self.begin()

    def update(self, passed_s: float, seen: bool) -> Sequence[Moment]:
        """Go on, or by the steps asked for, to the end at most; the flight stands there."""
        if self._wanted and self._fly_at is not None:
            self._take(self._fly_at(self._wanted.pop()))
            self._wanted.clear()
        pace = self.clock_speed if self.pace is None else self.pace
        simulated_s = STEP_S * self.steps or (0.0 if self.held or self._fresh else pace * passed_s)
        before_s, self.steps = self._at_s, 0
        self._at_s = min(before_s + simulated_s / self.clock_speed, self._end_s)
        if self.sought_s is not None:  # the path up to there is drawn anew; what had ended goes on
            self.held &= self._at_s < self._end_s
            self._begun, before_s, self._fresh = self._begun + 1, 0.0, True
            self._at_s, self.sought_s = min(max(0.0, self.sought_s / self.clock_speed), self._end_s), None
        self.held |= self._at_s == self._end_s
        between_s = self._stops_s[(self._stops_s > before_s) & (self._stops_s < self._at_s)]
        between_s = between_s[:: len(between_s) // MOST_STOPS + 1]
        walls_s = [*[before_s] * self._fresh, *between_s.tolist(), *[self._at_s] * (self._at_s > before_s)]
        self._fresh = False
        return [self._moment(*walls) for walls in zip([before_s, *walls_s], walls_s, strict=False)]

    def _moment(self, before_s: float, wall_s: float) -> Moment:
        drones = []
        for track in self._tracks:
            time_s = track.simulated_s(wall_s)
            commanded = track.command((track.simulated_s(before_s) + time_s) / 2) is not None
            does, towards = track.state(wall_s), track.towards(time_s)
            drones.append(DroneState(time_s, track.pose(time_s), commanded, towards, does))
        wall = f"{1000 * wall_s:.1f} ms" if self._end_s < 1.0 else f"{wall_s:.3f} s"
        return Moment(self._begun, True, self.clock_speed, wall, drones)


class Told:
    """One world that tells of its flights. `moments` are those that were heard last."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.scene: Scene | None = None
        self.moments: list[Moment] = []
        self._flight: object = None
        self._told: Orders | None = None

    def order(self, orders: Orders) -> None:
        """Send these orders, if they are others than before or let refreshes pass."""
        if orders != self._told or orders["refreshes"]:
            self._told = {**orders, "refreshes": 0}
            with suppress(OSError):  # it has ended, which `receive` will notice
                self.connection.send(json.dumps(orders).encode())

    def receive(self) -> bool:
        """Take what was sent; False once the flight's end of the socket is closed."""
        while True:
            try:
                if not (message := self.connection.recv(MESSAGE_BYTES)):
                    return False
            except OSError as error:
                return isinstance(error, BlockingIOError)
            for kind, content in json.loads(message).items():
                if kind == "scene":
                    self.scene = self._load(content)
                elif self.scene is not None and np.isfinite(content["qpos"]).all():  # not of one that has come apart
                    self.moments.append(self._moment(content, self.scene))

    def _load(self, content: Plain) -> Scene:
        """Load the scene that a flight has left in a file, and remove that."""
        model = mujoco.MjModel.from_binary_path(content["model"])
        Path(content["model"]).unlink()
        data = mujoco.MjData(model)
        data.qpos[:] = content["qpos"]
        mujoco.mj_kinematics(model, data)
        bodies = {vehicle["name"]: vehicle["body"] for vehicle in content["vehicles"]}
        first = pose_of(model, next(iter(bodies.values())))
        return Scene(model, data, bodies, data.qpos[first][:3].copy())

    def _moment(self, state: Plain, scene: Scene) -> Moment:
        time_s, wall_s, clock_speed = state["time_ns"] / NS_PER_S, state["wall_ns"] / NS_PER_S, state["clock_speed"]
        may_pause, qpos = state["may_pause"], np.array(state["qpos"], np.float64)
        if self._flight != (self, state["flight"]):  # flights are counted in each world
            self._flight = self, state["flight"]
            self._origin_s = 0.0 if may_pause else wall_s - time_s / clock_speed  # the flight's begin
        wall = f"{wall_s - self._origin_s:.3f} s, {'simulated' if may_pause else MACHINES}"
        drones = []
        for body, commanded, towards in zip(scene.bodies.values(), state["commanded"], state["towards"], strict=True):
            pose, does = qpos[pose_of(scene.model, body)], "flies its command" if commanded else "no command"
            drones.append(DroneState(time_s, pose, commanded, towards and tuple(towards), does))
        return Moment(self._flight, may_pause, clock_speed, wall, drones)


class Live(Source):
    """Listens for flights on a Unix socket at `path`, and chooses the one to be shown, which obeys its player.

    That is the first to tell of itself, until it has ended or, unless it is held, has been silent for PATIENCE_S while
    another speaks. The others fly as fast as they can, and so does the shown one while nobody looks.
    """

    step_hint = "to the next refresh, 0.033 simulated seconds on"

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.bind(str(path))
        self._socket.listen(BACKLOG)
        self._socket.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._silent_s = 0.0
        self._may_pause = False
        self.worlds: list[Told] = []
        self.shown: Told | None = None

    def toggle(self) -> None:
        super().toggle()
        self._silent_s = 0.0  # it was held

    def update(self, passed_s: float, seen: bool) -> Sequence[Moment]:
        """Take what has come in the last `passed_s` seconds, without waiting, and give the flights their orders."""
        for world in self.worlds:
            world.moments = []
        for key, _ in self._selector.select(0):
            if key.data is None:  # a flight that begins to tell of itself
                connection, _ = self._socket.accept()
                connection.setblocking(False)
                self.worlds.append(Told(connection))
                self._selector.register(connection, selectors.EVENT_READ, self.worlds[-1])
                self.shown = self.shown or self.worlds[-1]
            elif not key.data.receive():
                self._drop(key.data)
        self._silent_s = 0.0 if self.shown is not None and self.shown.moments else self._silent_s + passed_s
        speaking = [world for world in self.worlds if world.moments]
        if speaking and (self.shown is None or (self._silent_s > PATIENCE_S and not self.held)):
            self.shown, self._silent_s = speaking[0], 0.0
        shown: Orders = {"seen": True, "held": self.held, "pace": self.pace, "refreshes": self.steps}
        for world in self.worlds:
            world.order(shown if seen and world is self.shown else FREE)
        if self.shown is None:
            return []
        self.steps, self.scene = 0, self.shown.scene or self.scene
        if moments := self.shown.moments:
            self._may_pause = moments[-1].may_pause
        stands = "Paused." if self.held and self._may_pause else "Its clock is paused, or its flight is over."
        self.note = stands if self._silent_s > SILENT_S else ""
        return moments

    def _drop(self, world: Told) -> None:
        self._selector.unregister(world.connection)
        world.connection.close()
        self.worlds.remove(world)
        self.shown = None if self.shown is world else self.shown

    def close(self) -> None:
        """Hang up on every flight, which then goes on without a page."""
        for world in list(self.worlds):
            self._drop(world)
        self._selector.close()
        self._socket.close()
