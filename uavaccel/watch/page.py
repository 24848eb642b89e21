"""The page in the browser: a flight in its scene, its clocks and images, and a player that the spectators control.

It shows what a `Source` tells, be that a recorded flight (`watch.show`) or one that is still flown (`watch.beside`).
"""

from __future__ import annotations

import html
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.kinematics import Vector
from uavaccel.sim.camera.camera import make_camera
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.units import NS_PER_S
from uavaccel.watch.scene import (
    ARROW,
    BLANK,
    COMMANDED,
    IDEAL,
    PLUMB,
    THINKING,
    Drone,
    Eyes,
    Floats,
    Scene,
    light_up,
    pose_of,
    show_surroundings,
)

if TYPE_CHECKING:
    from viser import ClientHandle, GuiDropdownHandle, GuiImageHandle, GuiSliderHandle, ViserServer

UPDATES_PER_S = 30
PICTURES_EVERY = 3  # updates
FLAT_OUT = "as fast as it flies"
PACES = {f"{pace:g}x": pace for pace in (0.25, 0.5, 1.0, 2.0, 5.0, 20.0)}  # and FLAT_OUT
PACE = "1x"
CLOCK_SPEEDS = (1.0, 5.0, 10.0, 50.0, 100.0)
LAST = 1e6  # in the order of the panel's elements, below the images
SCRUB_S = 0.01  # of simulated time, to which a spectator goes
WITHOUT_PAUSE = "Cannot be paused: its client is on the machine's clock. With --timing virtual or lockstep it can."
FROM_BEHIND = (-1.15, 0.0, 0.85)  # to the first view, in reaches of the flights; x north, y west, z up
WIDE = 1.5  # width over height, below which a wide scene is seen from farther away
WORTH_M = 0.02  # a move that the view follows
# The panel of viser, with its player in one row, and nothing that moves when words or numbers change; on a phone the
# scene has the upper half.
STYLE = """
:has(> div > .clocks) { display: flex; flex-wrap: wrap }
:has(> div > .clocks) > * { flex: 0 0 100%; max-width: 100% !important }
:has(> div > .clocks) > :has(> button) { flex: 1 0 3.4em; margin-inline: 0 0.3em !important }
:has(> div > .clocks) > div:has(> .clocks) + :has(> button) { margin-left: 0.7em !important }
:has(> div > .clocks) > :has(> button) > button { padding-inline: 0 }
:has(> div > .clocks) > :has(.mantine-Slider-root) { flex: 6 0 9em }
:has(> div > .clocks) > :has(.mantine-Slider-root) div:has(> p > label) { position: absolute !important; opacity: 0 }
.clocks, .legend { padding: 0 1em; font-size: 0.85em; line-height: 1.4; font-variant-numeric: tabular-nums }
.clocks p { margin: 0.3em 0; white-space: nowrap; overflow: hidden; text-overflow: ellipsis }
.clocks .note { height: 2.8em; white-space: normal }
.clocks table { width: 100%; table-layout: fixed; border-spacing: 0 }
.clocks td { padding: 0; white-space: nowrap; overflow: hidden; text-overflow: ellipsis }
.clocks td + td { width: 5.5em; text-align: right }
.clocks tr + tr td:only-child { opacity: 0.75 }
.legend { padding-bottom: 0.6em }
.legend span { display: inline-block; margin-right: 0.9em }
:root { --mantine-color-dimmed: var(--mantine-color-text) !important }
h1 { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%) }
.legend i { display: inline-block; width: 1.2em; height: 0.4em; margin-right: 0.4em; vertical-align: middle;
  outline: 1px solid #888 }
@media (max-width: 36em) {
  div:has(> canvas[style*="pointer-events: none"]) { bottom: 50% !important }
  .mantine-Paper-root:has(.clocks) { width: 100% !important; max-height: 50% !important }
  .mantine-Paper-root:has(.clocks) [style*="width: 20em"] { width: 100% !important }
}
"""
# What viser's page lacks for who hears it: a heading, a landmark, and names.
NAMES = """
const NAMES = {
  "[role=slider], [inputmode=decimal]": "Time, s", "img": "Camera image with its events",
  "button[class*=close]": "Close", "button:has(svg)": "Connection and settings",
};
addEventListener("DOMContentLoaded", () => {
  const header = document.body.insertAdjacentElement("afterbegin", document.createElement("header"));
  header.appendChild(document.createElement("h1")).textContent = document.title;
  new MutationObserver(() => {
    document.getElementById("root").setAttribute("role", "main");
    for (const [what, name] of Object.entries(NAMES))
      for (const each of document.querySelectorAll(what))
        if (!each.textContent.trim() && !each.ariaLabel) each.ariaLabel = name;
    for (const each of document.querySelectorAll("div[aria-expanded]:not([role])")) each.setAttribute("role", "button");
  }).observe(document.body, { childList: true, subtree: true });
});
"""


class DroneState(NamedTuple):
    """A drone at simulated time `time_s`; its pose (7,) is place in m and wxyz in MuJoCo's frame.

    It was `commanded` on the way here if it was flying a command. `towards`, NED, is where its command leads, None
    where that is no direction; `does` says in words what it does.
    """

    time_s: float
    pose: Floats
    commanded: bool
    towards: Vector | None
    does: str


class Moment(NamedTuple):
    """A state of drones that fly at once; `wall` is the wall clock in words. Another `flight` begins the paths anew."""

    flight: object
    may_pause: bool
    clock_speed: float
    wall: str
    drones: Sequence[DroneState]


class Source(ABC):
    """A flight, and its player: whether it is held, its pace, and the steps that it is still to make."""

    scene: Scene | None = None
    held, steps = False, 0
    step_hint: str
    pace: float | None = PACES[PACE]  # simulated seconds per second; None for as fast as it flies
    note = ""  # what is to be said of the flight, below its clocks
    ideal_m: Mapping[str, Floats] = {}  # by drones' names, the path (n, 3) to compare with, in MuJoCo's frame
    ideal = ""  # whose path that is
    sought_s: float | None = None  # where a spectator has gone in a recorded flight, in seconds of a show at 1x
    clock_speed: float | None = None  # of a recorded flight; None of one that cannot begin anew
    fly_at: Callable[[float], None] | None = None  # flies it at another ClockSpeed

    @property
    def progress_s(self) -> tuple[float, float] | None:
        """How far a recorded flight is shown, and its length, in seconds of a show at 1x; None of one that is flown."""
        return None

    @abstractmethod
    def update(self, passed_s: float, seen: bool) -> Sequence[Moment]:
        """Return the states of the last `passed_s` seconds, of the machine's; `seen` says that somebody looks."""

    def toggle(self) -> None:
        """Pause, or go on."""
        self.held = not self.held

    def step(self) -> None:
        """Pause a step further on."""
        self.held = True
        self.steps += 1

    def begin(self) -> None:
        """Go on, a recorded flight from its beginning."""
        self.held = False


class Page:
    """Shows what a source tells until `run` is interrupted; `opened` is called when no other browser shows the page."""

    def __init__(self, server: ViserServer, source: Source, title: str, opened: Callable[[], object]) -> None:
        self._server, self._source, self._clock = server, source, MonotonicClock()
        self._scene: Scene | None = None
        self._moment: Moment | None = None
        self._flight: object = None
        self._drones: dict[str, Drone] = {}
        self._eyes: dict[str, Eyes] = {}
        self._images: dict[str, GuiImageHandle] = {}
        self._updates = 0
        self._views = Views(server, opened)
        light_up(server)
        gui = server.gui
        self._clocks = gui.add_html(clock_table(source.clock_speed or 1.0, "0.000 s", [], "Waits for a flight."))
        self._play = gui.add_button("Pause")
        self._play.on_click(lambda _: source.toggle())
        self._step = gui.add_button("Step", hint=f"{source.step_hint}, and pause there")
        self._step.on_click(lambda _: source.step())
        self._scrub: GuiSliderHandle[float] | None = None
        self._scrubbed_s = 0.0  # where the show has put the slider
        if (progress := source.progress_s) is not None:
            self._scrub = gui.add_slider("Time", self._scrubbed_s, round(progress[1], 2), SCRUB_S, self._scrubbed_s)
        gui.add_html(legend(source.ideal))
        if (fly_at := source.fly_at) is not None:
            own = f"{source.clock_speed:g}x"
            speeds = {f"{speed:g}x": speed for speed in sorted({*CLOCK_SPEEDS, source.clock_speed or 1.0})}
            menu = gui.add_dropdown("ClockSpeed", list(speeds), initial_value=own)
            menu.on_update(lambda _: fly_at(speeds[chosen(menu, speeds, own)]))
        paces = [*PACES, FLAT_OUT]
        self._pace = gui.add_dropdown("Shown at", paces, initial_value=PACE, hint="simulated s per second")
        self._pace.on_update(lambda _: setattr(source, "pace", PACES.get(chosen(self._pace, paces, PACE))))
        follows = source.scene is None or source.scene.follows
        self._follow = gui.add_checkbox("Follow", initial_value=follows, hint="the view goes along with the drone")
        gui.add_markdown(title, order=LAST)
        self._no_images = gui.add_markdown("", visible=False)
        if source.scene is not None:
            self._change_scene(source.scene)

    def run(self) -> None:
        """Show the flight, until interrupted."""
        before = self._clock.now_ns()
        while True:
            self._clock.sleep_until(before + NS_PER_S // UPDATES_PER_S)
            now, flight = self._clock.now_ns(), self._flight
            self.update((now - before) / NS_PER_S)
            before = now if self._flight == flight else self._clock.now_ns()  # flying anew took no time of the show

    def update(self, passed_s: float) -> None:
        """Show what has happened in the last `passed_s` seconds, while somebody looks."""
        seen = bool(self._server.get_clients())
        if self._scrub is not None and self._scrub.value != self._scrubbed_s:  # a spectator has moved the slider
            self._source.sought_s = self._scrubbed_s = self._scrub.value
        moments = self._source.update(passed_s, seen)
        if not seen:
            self._flight = self._moment = None  # the path begins anew for whoever opens the page next
            return
        with self._server.atomic():
            if self._source.scene is not None and self._source.scene is not self._scene:
                self._change_scene(self._source.scene)
            self._show([moment for moment in moments if len(moment.drones) == len(self._drones)])
        if self._moment is not None and self._updates % PICTURES_EVERY == 0:
            if self._scrub is not None and (progress := self._source.progress_s) is not None:
                shown_s, self._scrub.max = (round(seconds, 2) for seconds in progress)
                if self._scrub.value == self._scrubbed_s:  # not where a spectator has just moved it
                    self._scrubbed_s = shown_s
                    setattr(self._scrub, "value", shown_s)  # noqa: B010  to a type checker it cannot be set
            for (name, eyes), state in zip(self._eyes.items(), self._moment.drones, strict=False):
                self._images[name].image = eyes.render(state.pose, state.time_s)
        self._updates += 1

    def _show(self, moments: Sequence[Moment]) -> None:
        for moment in moments:
            if moment.flight != self._flight:
                self._flight = moment.flight
                for name, drone in self._drones.items():
                    drone.begin(self._source.ideal_m.get(name))
                self._play.disabled = self._step.disabled = self._pace.disabled = not moment.may_pause
            for drone, state in zip(self._drones.values(), moment.drones, strict=True):
                drone.go_to(state.pose[:3], state.commanded)
            self._moment = moment
        label = "Play" if self._source.held else "Pause"
        if self._play.label != label:
            self._play.label = label
        if (last := self._moment) is None:
            return
        flown = list(zip(self._drones.items(), last.drones, strict=True))
        if moments:
            for (_, drone), state in flown:
                drone.show(state.pose, state.towards)
            if self._follow.value:
                self._views.follow(last.drones[0].pose[:3])
        lines = [(name, state.time_s, drone.height_m, state.does) for (name, drone), state in flown]
        note = self._source.note or ("" if last.may_pause else WITHOUT_PAUSE)
        self._clocks.content = clock_table(last.clock_speed, last.wall, lines, note)

    def _change_scene(self, scene: Scene) -> None:
        first, self._scene, self._moment, self._flight = self._scene is None, scene, None, None
        show_surroundings(self._server, scene)
        for drone in self._drones.values():
            drone.begin(None)
        middle = (len(scene.bodies) - 1) / 2
        self._drones = {
            name: Drone(self._server, name, scene, np.array([0.0, (middle - number) * scene.apart_m, 0.0]))
            for number, name in enumerate(scene.bodies)
        }
        if first:
            self._views.look_at(scene.centre_m, scene.reach_m, wide=not scene.follows)
        self._no_images.visible, first_body = False, next(iter(scene.bodies.values()))
        try:
            camera = make_camera(scene.model, WIDTH, HEIGHT)  # that of the first body
            seeing = [name for name, body in scene.bodies.items() if body == first_body]
            self._eyes = {name: Eyes(camera, scene.data, pose_of(scene.model, first_body)) for name in seeing}
        except UserError as error:
            self._eyes, self._no_images.content, self._no_images.visible = {}, f"No pictures: {error}", True
        for name in self._images.keys() - self._eyes.keys():
            self._images.pop(name).remove()
        for name in self._eyes:
            if name not in self._images:
                self._images[name] = self._server.gui.add_image(BLANK, label=f"{name}: camera, events", format="jpeg")


class Views:
    """Where the browsers look from: the first view, and one that goes along; in MuJoCo's frame.

    `on_first` is called when a browser opens the page and no other has it open.
    """

    def __init__(self, server: ViserServer, on_first: Callable[[], object]) -> None:
        self._server = server
        self.look_at(np.zeros(3), 3.0)

        @server.on_client_connect
        def _(client: ClientHandle) -> None:
            self._aim(client)
            if len(server.get_clients()) == 1:
                on_first()

    def look_at(self, centre: Floats, reach_m: float, wide: bool = True) -> None:
        """Look at `reach_m` around a place, from the south and above; a `wide` scene from farther on narrow screens."""
        self._back, self._wide = reach_m * np.array(FROM_BEHIND), wide
        self._move_to(np.array(centre, float))
        for client in self._server.get_clients().values():
            self._aim(client)

    def follow(self, place: Floats) -> None:
        """Go along with a drone that is at this place now; everyone may turn and zoom as before."""
        moved = place - self._at
        if float(np.linalg.norm(moved)) >= WORTH_M:
            self._move_to(place)
            for client in self._server.get_clients().values():
                client.camera.position = client.camera.position + moved

    def _move_to(self, place: Floats) -> None:
        self._at, camera = place, self._server.initial_camera
        camera.look_at, camera.position = place, place + self._back

    def _aim(self, client: ClientHandle) -> None:
        farther = max(1.0, WIDE / client.camera.aspect) if self._wide else 1.0
        client.camera.position, client.camera.look_at = self._at + farther * self._back, self._at


def clock_table(
    clock_speed: float, wall: str, drones: Sequence[tuple[str, float, float | None, str]], note: str = ""
) -> str:
    """Return ClockSpeed and wall clock, name, simulated time, height and state of each drone, and a note, as HTML."""
    rows = "".join(
        f"<tr><td><b>{html.escape(name)}</b></td><td>{time_s:.2f} s</td>"
        f"<td>{'' if height_m is None else f'{height_m:.1f} m up'}</td></tr>"
        f"<tr><td colspan='3'>{html.escape(state)}</td></tr>"
        for name, time_s, height_m, state in drones
    )
    return (
        f"<div class='clocks'><p>ClockSpeed <b>{clock_speed:g}x</b> &nbsp; wall clock <b>{wall}</b></p>"
        f"<table>{rows}</table><p class='note'>{html.escape(note)}</p></div>"
    )


def legend(ideal: str) -> str:
    """Return what the colours mean, as HTML; `ideal` is the drone with whose path the others' are compared."""
    meanings = {
        COMMANDED: "flies a command; events: brighter",
        THINKING: "client thinks; events: darker",
        **({IDEAL: f"path of {ideal}"} if ideal else {}),
        ARROW: "commanded velocity",
        PLUMB: "plumb line",
    }
    entries = "".join(
        f"<span><i style='background:rgb{colour}'></i>{html.escape(text)}</span> " for colour, text in meanings.items()
    )
    return f"<div class='legend'>{entries}</div>"


def head_of(title: str) -> str:
    """Return what the page's HTML has in its head: its title, the first sentence of this Markdown, style and names."""
    plain = re.sub("[`*]", "", title.partition(". ")[0].rstrip("."))
    return f"<title>{html.escape(plain)} – uavaccel</title><style>{STYLE}</style><script>{NAMES}</script>"


def chosen(menu: GuiDropdownHandle[str], known: Collection[str], otherwise: str) -> str:
    """Return what is chosen in a menu, or `otherwise` for what it does not offer, which a page could send."""
    if menu.value not in known:
        setattr(menu, "value", otherwise)  # noqa: B010  to a type checker it cannot be set
    value: str = menu.value
    return value
