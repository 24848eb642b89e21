"""The page of finished flights: they fly in their scene, with clocks and pictures, as the spectator's clicks say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.sim.lane.layout import LaneLayout
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S, ned_to_mujoco, quaternion_ned_to_mujoco
from uavaccel.watch.clocks import Line, clock_table
from uavaccel.watch.drone import Drone
from uavaccel.watch.figure import Figure
from uavaccel.watch.pictures import BLANK, Eyes, camera_of
from uavaccel.watch.playhead import Playhead
from uavaccel.watch.scene import light_up, pose_of, show_surroundings
from uavaccel.watch.server import PICTURES_EVERY, UPDATES_PER_S, chosen
from uavaccel.watch.track import Track
from uavaccel.watch.view import Views

if TYPE_CHECKING:
    from viser import GuiImageHandle, ViserServer

STEP_S = 0.05  # simulated
PACES = {"0.25x": 0.25, "0.5x": 0.5, "1x": 1.0, "2x": 2.0, "5x": 5.0}
PACE = "1x"
CLOCK_SPEEDS = ("1x", "5x", "10x", "50x", "100x")
APART_M = 4.6
FARTHEST_M = 10.0  # of a flight that is seen whole; the view goes along with a longer one
NEAR_M = 3.0


class Page:
    """Tracks that begin together, shown side by side until `run` is interrupted.

    `fly_at` flies them at another ClockSpeed, which the spectator may then choose.
    """

    def __init__(
        self,
        server: ViserServer,
        tracks: Sequence[Track],
        scene: str,
        title: str,
        lane: LaneLayout | None = None,
        fly_at: Callable[[float], Sequence[Track]] | None = None,
    ) -> None:
        self._server, self._clock, self._fly_at = server, MonotonicClock(), fly_at
        world = World(scene, PROFILES["native"])
        if lane is not None:
            world.set_lane(lane)
        self._model, self._data, self._body = world.model, world.data, world.lead.body_id
        server.scene.set_up_direction("+z")
        light_up(server)
        show_surroundings(server, self._model, self._data)
        self._figures = [Figure(server, track.name, self._model, self._data, self._body) for track in tracks]
        self.updates = 0
        self._wanted: float | None = None
        self.speed = tracks[0].clock_speed
        self._make_controls(title)
        self._eyes = self._make_eyes(tracks)
        self._take(tracks)
        self._look_at(tracks)
        self._show()

    def _take(self, tracks: Sequence[Track]) -> None:
        """Show these tracks, from their beginning."""
        self.speed = tracks[0].clock_speed
        end_s = max(track.wall_s for track in tracks)
        self.playhead = Playhead(end_s, self.speed / PACES[chosen(self._pace, PACES, PACE)], STEP_S / self.speed)
        middle = (len(tracks) - 1) / 2
        ideal = tracks[-1]
        self.drones = [
            Drone(
                self._server,
                track,
                figure,
                np.array([0.0, (n - middle) * APART_M, 0.0]),
                None if track is ideal else ideal.position_m,
            )
            for n, (track, figure) in enumerate(zip(tracks, self._figures, strict=True))
        ]
        self._note = "; ".join(
            f"{track.name} leaves the path of {ideal.name} by up to {track.farthest_from(ideal):.2f} m"
            for track in tracks
            if track is not ideal
        )

    def _look_at(self, tracks: Sequence[Track]) -> None:
        """The first view: all of the flights in it or, of a long one, its beginning, with which the view goes along."""
        places = np.concatenate([track.position_m for track in tracks])
        reach_m = float(np.ptp(places, axis=0).max()) / 2
        self._follows = len(tracks) == 1 and reach_m > FARTHEST_M
        centre = places[0] if self._follows else (places.min(axis=0) + places.max(axis=0)) / 2
        aside_m = APART_M * (len(tracks) - 1) / 2
        self._views = Views(self._server, lambda: self.playhead.replay())  # who comes first has missed nothing
        reach_m = NEAR_M if self._follows else max(reach_m + aside_m, NEAR_M)
        self._views.look_at(ned_to_mujoco(centre), reach_m, wide=not self._follows)

    def _make_controls(self, title: str) -> None:
        gui = self._server.gui
        self._clocks = gui.add_html("")
        gui.add_markdown(title)
        if self._fly_at is not None:
            own = f"{self.speed:g}x"
            known = sorted({*CLOCK_SPEEDS, own}, key=_speed)
            speeds = gui.add_dropdown("ClockSpeed", known, initial_value=own)
            speeds.on_update(lambda _: self._want(_speed(chosen(speeds, known, own))))
        self._play = gui.add_button("Pause")
        self._step = gui.add_button("Step", hint=f"{STEP_S:g} simulated seconds, and pause there")
        self._replay = gui.add_button("Replay")
        self._pace = gui.add_dropdown("Shown at", list(PACES), initial_value=PACE, hint="simulated s per second")
        self._play.on_click(lambda _: self.playhead.toggle())
        self._step.on_click(lambda _: self.playhead.step())
        self._replay.on_click(lambda _: self.playhead.replay())
        self._pace.on_update(lambda _: self._set_pace())

    def _set_pace(self) -> None:
        self.playhead.slowness = self.speed / PACES[chosen(self._pace, PACES, PACE)]

    def _want(self, clock_speed: float) -> None:
        self._wanted = clock_speed

    def _make_eyes(self, tracks: Sequence[Track]) -> list[tuple[Eyes, GuiImageHandle]]:
        """Pictures below the controls; none where nothing can draw."""
        pose = pose_of(self._model, self._body)
        try:
            camera = camera_of(self._model)
        except UserError as error:
            self._server.gui.add_markdown(f"No pictures: {error}")
            return []
        return [
            (
                Eyes(camera, self._data, pose),
                self._server.gui.add_image(BLANK, label=f"{track.name}: camera, events", format="jpeg"),
            )
            for track in tracks
        ]

    def run(self) -> None:
        """Show what the playhead points to, until interrupted."""
        before = self._clock.now_ns()
        while True:
            self._clock.sleep_until(before + NS_PER_S // UPDATES_PER_S)
            now = self._clock.now_ns()
            if self._wanted is not None and self._fly_at is not None:
                wanted, self._wanted = self._wanted, None
                self._take(self._fly_at(wanted))
                now = self._clock.now_ns()
                before = now  # flying took no time of the show
            self.playhead.pass_time((now - before) / NS_PER_S)
            before = now
            self._show()

    def _show(self) -> None:
        wall_s = self.playhead.at_s
        with self._server.atomic():
            for drone in self.drones:
                drone.show(wall_s)
            self._clocks.content = self._clock_table(wall_s)
            label = "Pause" if self.playhead.playing else "Play"
            if self._play.label != label:
                self._play.label = label
        if self._follows:
            track = self.drones[0].track
            self._views.follow(ned_to_mujoco(track.pose(track.simulated_s(wall_s))[0]))
        if self.updates % PICTURES_EVERY == 0:
            for drone, (eye, shown) in zip(self.drones, self._eyes, strict=False):
                time_s = drone.track.simulated_s(wall_s)
                place, attitude = drone.track.pose(time_s)
                shown.image = eye.render(ned_to_mujoco(place), quaternion_ned_to_mujoco(attitude), time_s)
        self.updates += 1

    def _clock_table(self, wall_s: float) -> str:
        lines = [
            Line(drone.track.name, drone.track.simulated_s(wall_s), drone.height_m, drone.state(wall_s))
            for drone in self.drones
        ]
        wall = f"{1000 * wall_s:.1f} ms" if self.playhead.end_s < 1.0 else f"{wall_s:.3f} s"
        return clock_table(self.speed, wall, lines, self._note)


def _speed(label: str) -> float:
    return float(label.removesuffix("x"))
