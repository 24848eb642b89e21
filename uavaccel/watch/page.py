"""The page: flights in their scene, clocks and pictures beside them, and what the spectator may click."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import redirect_stdout
from typing import TYPE_CHECKING

import numpy as np

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S, ned_to_mujoco
from uavaccel.watch.drone import Drone
from uavaccel.watch.pictures import Eyes
from uavaccel.watch.playhead import Playhead
from uavaccel.watch.scene import light_up, show_surroundings
from uavaccel.watch.track import Track

if TYPE_CHECKING:
    from viser import ClientHandle, GuiImageHandle, ViserServer

MISSING = "watch: needs the package viser: pip install 'uavaccel[watch]'"
UPDATES_PER_S = 30
PICTURES_EVERY = 3  # updates
STEP_S = 0.05  # simulated
PACES = {"0.25x": 0.25, "0.5x": 0.5, "1x": 1.0, "2x": 2.0, "5x": 5.0}
APART_M = 4.6
FROM_BEHIND = (-1.15, 0.0, 0.85)  # to the first view, in reaches of the flights; x north, y west, z up
LOWER = 0.3  # of the distance, by which a phone's view looks below the flights
BRAND = (0, 114, 178)


def open_server(host: str, port: int) -> ViserServer:
    """A page's server, without a word. Raises UserError where viser is missing."""
    try:
        import viser
    except ImportError:
        raise UserError(MISSING) from None
    with redirect_stdout(io.StringIO()):  # it greets, even where it is asked to be silent
        server = viser.ViserServer(host=host, port=port, label="uavaccel watch", verbose=False)
    server.gui.configure_theme(
        control_layout="collapsible", show_logo=False, show_share_button=False, brand_color=BRAND
    )
    server.gui.set_panel_label("uavaccel watch")
    return server


class Page:
    """Tracks that begin together, shown side by side until `run` is interrupted."""

    def __init__(self, server: ViserServer, tracks: Sequence[Track], scene: str, title: str) -> None:
        self._server, self._clock = server, MonotonicClock()
        self._world = World(scene, PROFILES["native"])
        self.speed = tracks[0].clock_speed
        end_s = max(track.wall_s for track in tracks)
        self.playhead = Playhead(end_s, self.speed, STEP_S / self.speed)
        self.updates = 0
        self._make_scene(tracks)
        self._make_controls(title)
        self._eyes = self._make_eyes()
        self._show()

    def _make_scene(self, tracks: Sequence[Track]) -> None:
        server, world = self._server, self._world
        server.scene.set_up_direction("+z")
        light_up(server)
        show_surroundings(server, world.model, world.data)
        middle = (len(tracks) - 1) / 2
        ideal = tracks[-1].position_m if len(tracks) > 1 else None
        self.drones = [
            Drone(
                server,
                track,
                world.model,
                np.array([0.0, (n - middle) * APART_M, 0.0]),
                None if track is tracks[-1] else ideal,
            )
            for n, track in enumerate(tracks)
        ]
        self._look_at(np.concatenate([track.position_m for track in tracks]), APART_M * middle)

    def _look_at(self, places_m: np.ndarray, aside_m: float) -> None:
        """The first view: from the south and above, all of the flights in it, on a narrow screen from farther off."""
        centre = ned_to_mujoco((places_m.min(axis=0) + places_m.max(axis=0)) / 2)
        reach = max(float(np.ptp(places_m, axis=0).max()) / 2 + aside_m, 3.0)
        back = reach * np.array(FROM_BEHIND)
        camera = self._server.initial_camera
        camera.look_at, camera.position = tuple(centre), tuple(centre + back)

        @self._server.on_client_connect
        def _(client: ClientHandle) -> None:
            if client.camera.aspect < 1.0:  # a phone: the controls take the lower half
                farther = 1.25 * back / client.camera.aspect
                client.camera.position = centre + farther
                client.camera.look_at = centre - np.array([0.0, 0.0, LOWER * float(np.linalg.norm(farther))])
            if len(self._server.get_clients()) == 1:  # who comes first has missed nothing
                self.playhead.replay()

    def _make_controls(self, title: str) -> None:
        gui = self._server.gui
        self._clocks = gui.add_html("")
        gui.add_markdown(title)
        self._play = gui.add_button("Pause")
        self._step = gui.add_button("Step", hint=f"{STEP_S:g} simulated seconds, and pause there")
        self._replay = gui.add_button("Replay")
        self._pace = gui.add_dropdown(
            "Shown at", list(PACES), initial_value="1x", hint="simulated s per second"
        )
        self._play.on_click(lambda _: self.playhead.toggle())
        self._step.on_click(lambda _: self.playhead.step())
        self._replay.on_click(lambda _: self.playhead.replay())
        self._pace.on_update(lambda _: self._set_pace())

    def _set_pace(self) -> None:
        self.playhead.slowness = self.speed / PACES[self._pace.value]

    def _make_eyes(self) -> list[tuple[Eyes, GuiImageHandle]]:
        """Pictures below the controls; none where nothing can draw."""
        try:
            eyes = [Eyes(self._world) for _ in self.drones]
        except UserError as error:
            self._server.gui.add_markdown(f"No pictures: {error}")
            return []
        blank = np.full((288, 256, 3), 246, np.uint8)
        shown = []
        for drone, eye in zip(self.drones, eyes, strict=True):
            handle = self._server.gui.add_image(
                blank, label=f"{drone.track.name}: camera, events", format="jpeg"
            )
            shown.append((eye, handle))
        return shown

    def run(self) -> None:
        """Show what the playhead points to, until interrupted."""
        before = self._clock.now_ns()
        while True:
            self._clock.sleep_until(before + NS_PER_S // UPDATES_PER_S)
            now = self._clock.now_ns()
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
        if self.updates % PICTURES_EVERY == 0:
            for drone, (eye, shown) in zip(self.drones, self._eyes, strict=False):
                time_s = drone.track.simulated_s(wall_s)
                shown.image = eye.look(*drone.track.pose(time_s), time_s)
        self.updates += 1

    def _clock_table(self, wall_s: float) -> str:
        rows = "".join(
            f"<tr><td><b>{drone.track.name}</b></td><td style='text-align:right'>"
            f"{drone.track.simulated_s(wall_s):.2f} s</td><td>{drone.state(wall_s)}</td></tr>"
            for drone in self.drones
        )
        return (
            "<div class='clocks' style='padding:0 1em;font-variant-numeric:tabular-nums;font-size:0.85em'>"
            f"<p style='margin:0.3em 0'>ClockSpeed <b>{self.speed:g}x</b> &nbsp; wall clock "
            f"<b>{1000 * wall_s:.1f} ms</b></p><table style='width:100%;line-height:1.5'>{rows}</table></div>"
        )
