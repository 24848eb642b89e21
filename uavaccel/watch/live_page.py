"""The page of a command that flies: flights as they go on, clocks and pictures, and what the spectator may do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.units import NS_PER_S
from uavaccel.watch.clocks import Line, clock_table
from uavaccel.watch.feed import Feed, Moment, Scene, Source
from uavaccel.watch.figure import Figure
from uavaccel.watch.pictures import BLANK, Eyes, camera_of
from uavaccel.watch.scene import light_up, pose_of, show_surroundings
from uavaccel.watch.server import PICTURES_EVERY, UPDATES_PER_S, chosen
from uavaccel.watch.trail import Trail
from uavaccel.watch.view import Views
from uavaccel.wire.page_protocol import FREE, Orders

if TYPE_CHECKING:
    from collections.abc import Callable

    from viser import ViserServer

FLAT_OUT = "as fast as it flies"
PACES = {f"{pace:g}x": pace for pace in (0.25, 0.5, 1.0, 2.0, 5.0, 20.0)}  # and FLAT_OUT
PACE = "1x"
WITHOUT_PAUSE = (
    "Cannot be paused here: this flight is on the machine's clock, and its client would go on. "
    "`--timing virtual` or `lockstep` can."
)
REACH_M = 3.0
SILENT_S = 0.5  # after which the table says that nothing is flown


class LivePage:
    """Shows what `feed` hears until it is interrupted; `opened` is called when the first browser opens the page."""

    def __init__(self, server: ViserServer, feed: Feed, title: str, opened: Callable[[], None]) -> None:
        self._server, self._feed, self._clock = server, feed, MonotonicClock()
        self._views = Views(server, opened)
        self._source: Source | None = None
        self._scene: Scene | None = None
        self._figures: list[Figure] = []
        self._heights: list[float | None] = []
        self._trails: list[Trail] = []
        self._eyes: Eyes | None = None
        self._moment: Moment | None = None
        self._origin_wall_s = 0.0
        self._silent_s = 0.0
        self._held, self._looks = False, 0
        self.updates = 0
        server.scene.set_up_direction("+z")
        light_up(server)
        self._make_controls(title)

    def _make_controls(self, title: str) -> None:
        gui = self._server.gui
        self._clocks = gui.add_html(clock_table(1.0, "0.000 s", [], "Waits for a flight."))
        gui.add_markdown(title)
        self._play = gui.add_button("Pause")
        self._step = gui.add_button("Step", hint="to the next refresh, 0.033 simulated seconds on, and pause there")
        self._pace = gui.add_dropdown("Shown at", [*PACES, FLAT_OUT], initial_value=PACE, hint="simulated s per second")
        self._why_not = gui.add_markdown(WITHOUT_PAUSE, visible=False)
        self._follow = gui.add_checkbox("Follow", initial_value=True, hint="the view goes along with the drone")
        self._picture = gui.add_image(BLANK, label="camera, events", format="jpeg", visible=False)
        self._no_picture = gui.add_markdown("", visible=False)
        self._play.on_click(lambda _: self._toggle())
        self._step.on_click(lambda _: self._let_pass())

    def _toggle(self) -> None:
        self._held = not self._held

    def _let_pass(self) -> None:
        self._held = True
        self._looks += 1

    def run(self) -> None:
        """Listen and show, until interrupted."""
        before = self._clock.now_ns()
        while True:
            self._clock.sleep_until(before + NS_PER_S // UPDATES_PER_S)
            now = self._clock.now_ns()
            self.update((now - before) / NS_PER_S)
            before = now

    def update(self, passed_s: float) -> None:
        """Show what has come in the last `passed_s` seconds, and give the flights their orders."""
        self._feed.listen(passed_s)
        if self._held and self._source is not None:
            self._feed.forgive()
        looked_at = bool(self._server.get_clients())
        self._give_orders(looked_at)
        if not looked_at:
            self._moment = None  # the path begins anew for whoever opens the page next
            return
        source = self._feed.shown
        self._silent_s = 0.0 if source is not None and source.moments else self._silent_s + passed_s
        with self._server.atomic():
            if source is not None:
                self._show(source)
            self._show_clocks()
        if self._eyes is not None and self._moment is not None and self.updates % PICTURES_EVERY == 0:
            pose = self._moment.poses[0]
            self._picture.image = self._eyes.render(pose[:3], pose[3:], self._moment.time_s)
        self.updates += 1

    def _give_orders(self, looked_at: bool) -> None:
        """The shown flight obeys the page while somebody looks; the others fly as fast as they can."""
        orders: Orders = {"seen": True, "held": self._held, "pace": self._pace_now(), "refreshes": 0}
        for source in self._feed.sources:
            source.order(orders if looked_at and source is self._feed.shown else FREE)
        if self._looks and self._feed.shown is not None:
            self._feed.shown.let_pass(self._looks)
            self._looks = 0

    def _pace_now(self) -> float | None:
        return PACES.get(chosen(self._pace, (*PACES, FLAT_OUT), PACE))

    # --- the flight -------------------------------------------------------------------------------

    def _show(self, source: Source) -> None:
        if source.scene is not None and source.scene is not self._scene:
            self._change_scene(source.scene)
        if source is not self._source:
            self._source, self._moment = source, None
        for moment in source.moments:
            if np.isfinite(moment.poses).all() and len(moment.poses) == len(self._figures):
                self._add(moment)
        if self._moment is None or not source.moments:
            return
        for trail in self._trails:
            trail.draw()
        names = list(self._scene.bodies) if self._scene is not None else []
        self._heights = [
            figure.show(pose[:3], pose[3:], towards, f"{name}: {state_of(commanded)}")
            for figure, name, pose, commanded, towards in zip(
                self._figures, names, self._moment.poses, self._moment.commanded, self._moment.towards, strict=False
            )
        ]
        if self._follow.value:
            self._views.follow(self._moment.poses[0, :3])

    def _add(self, moment: Moment) -> None:
        before = self._moment
        if before is None or moment.flight != before.flight:
            self._begin(moment)
        for trail, pose, commanded in zip(self._trails, moment.poses, moment.commanded, strict=False):
            trail.add(pose[:3], commanded)
        self._moment = moment

    def _begin(self, moment: Moment) -> None:
        """Another flight: its path begins anew, and the controls are those that its clock allows."""
        for trail in self._trails:
            trail.clear()
        self._origin_wall_s = 0.0 if moment.may_pause else moment.wall_s - moment.time_s / moment.clock_speed
        for control in (self._play, self._step, self._pace):
            control.disabled = not moment.may_pause
        self._why_not.visible = not moment.may_pause

    def _change_scene(self, scene: Scene) -> None:
        first = self._scene is None
        self._scene = scene
        show_surroundings(self._server, scene.model, scene.data)
        for trail in self._trails:
            trail.clear()
        self._figures = [
            Figure(self._server, name, scene.model, scene.data, body) for name, body in scene.bodies.items()
        ]
        self._trails = [Trail(self._server, name) for name in scene.bodies]
        self._heights = [None] * len(self._figures)
        body = next(iter(scene.bodies.values()))
        pose = pose_of(scene.model, body)
        if first:
            self._views.look_at(scene.data.qpos[pose][:3], REACH_M, wide=False)
            self._views.aim_all()
        try:
            self._eyes = Eyes(camera_of(scene.model), scene.data, pose)
        except UserError as error:
            self._eyes = None
            self._no_picture.content = f"No pictures: {error}"
        self._picture.visible, self._no_picture.visible = self._eyes is not None, self._eyes is None

    def _show_clocks(self) -> None:
        label = "Play" if self._held else "Pause"
        if self._play.label != label:
            self._play.label = label
        moment, scene = self._moment, self._scene
        if moment is None or scene is None:
            return
        silent = self._silent_s > SILENT_S
        note = (
            ""
            if not silent
            else "Paused."
            if self._held and moment.may_pause
            else "Its clock is paused, or its flight is over."
        )
        lines = [
            Line(name, moment.time_s, height, state_of(commanded))
            for name, height, commanded in zip(scene.bodies, self._heights, moment.commanded, strict=False)
        ]
        kind = "simulated" if moment.may_pause else "the machine's"
        wall = f"{moment.wall_s - self._origin_wall_s:.3f} s, {kind}"
        self._clocks.content = clock_table(moment.clock_speed, wall, lines, note)


def state_of(commanded: bool) -> str:
    """In words, what a drone does."""
    return "flies its command" if commanded else "no command"
