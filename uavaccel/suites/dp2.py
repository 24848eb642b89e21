"""DP2: what the drone sees on its way through the lane, compared with real time (paper, sections III-C2b and IV-C)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, model_validator
from typing_extensions import TypedDict

from uavaccel.commands import check_times, samples_due
from uavaccel.config import MOST_HEIGHT_M, Seconds, Seed
from uavaccel.config import Velocity as Component
from uavaccel.draw import style
from uavaccel.draw.page import (
    Block,
    Column,
    Heading,
    Picture,
    Table,
    clock_label,
    command_name,
    counted,
    metres,
    number,
    unknown,
)
from uavaccel.envs.camera_client import EventClient, Sample
from uavaccel.envs.task import rate_ticks
from uavaccel.forms import ArrayForm, Count, NotNegative, Number, Positive
from uavaccel.metrics.trajectory import dvs_ed_percent
from uavaccel.records import timing_provenance
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.lane import Lane
from uavaccel.sim.profile import PROFILES
from uavaccel.suites import plots
from uavaccel.suites.experiment import Disturbances, FlightExperiment, Timing, named_seed, subset
from uavaccel.suites.flight import Commands, Flight, Window, windows_of
from uavaccel.suites.lane_path import plan_path
from uavaccel.suites.path_suite import FlightCase, FlightRow, PathSuite, flight_row, fly_path, reference_of
from uavaccel.suites.report import Report, Summary, finished, method_note, warnings
from uavaccel.suites.suite import GameResult
from uavaccel.units import NS_PER_S, attitude_difference_rad, to_ns
from uavaccel.vision import perturb
from uavaccel.vision.dvs import PRESETS, count_events, luma, make_sensor
from uavaccel.vision.guard import GuardSettings, GuardState, acquire
from uavaccel.wire.image_api import lane_layout

if TYPE_CHECKING:
    from uavaccel.wire.session import Session

ERRORS = ("position_error_m", "attitude_error_deg", "dvs_ed_percent")
"""Of each image against the one at the same place in the path of the same command's run at 1x."""
POSES, EVENTS = ("position_m", "orientation_wxyz"), ("dvs_on", "dvs_off")
LINEAR_PERCENT, LINEAR_M = 0.1, 0.001  # below, Figure 7 is linear, so that 0 has its place
SHARE, STREAMS = 0.05, 20  # of the images that the guard's study perturbs; of images

Velocity = tuple[Component, Component]
Arrays = dict[str, NDArray[Any]]
OwnPath = Annotated[tuple[Velocity, ...], Field(min_length=1)]


class Dp2Config(FlightExperiment):
    """`suite: dp2`."""

    suite: Literal["dp2"]
    lane: Lane = 3
    """A seed, a seed with a difficulty, or a custom lane, written out or as the name of its YAML file."""
    path: Literal["planned"] | OwnPath = "planned"
    """planned: a collision-free path to the lane's end; or a list of velocities north and east, in m/s."""
    height_m: Annotated[float, Field(lt=0.0, ge=-MOST_HEIGHT_M)] = -10.0
    """NED z at which the path starts, and which is held: -10 is 10 m up."""
    t_move_s: Seconds = 1.0
    """Simulated seconds of a command."""
    t_sample_s: Seconds = 0.33
    """Simulated seconds between two samples during a command."""
    reference_timing: Timing = "virtual"
    """Timing of the game at 1x that each command is compared with, unless the run flies that one anyway."""
    guard: GuardSettings = GuardSettings()
    """The check of an image's mean brightness, and what follows a rejection."""
    perturbation: perturb.PerturbationConfig = perturb.PerturbationConfig()
    """Perturbation of the games' images; those that they are compared with stay clean."""
    auto_exposure: bool = False
    """A MODEL of a game engine's auto-exposure (uavaccel.vision.perturb), in every game; the paper switched it off."""
    dvs_preset: Literal["clean", "constructor", "command_line", "noisy"] = "clean"
    """v2e's parameters of the DVS that the report applies to the images."""
    dvs_rate_hz: Positive | None = None
    """Frames per simulated second that the DVS receives in flight; without it the stored images are its frames."""
    sensor_seed: Seed = 0
    """Seed of the DVS's thresholds: one sensor for all ClockSpeeds."""

    @model_validator(mode="after")
    def _times_fit(self) -> Dp2Config:
        check_times(self.t_move_s, self.t_sample_s, PROFILES[self.profile].check_duration)
        if self.dvs_rate_hz is not None:
            rate_ticks(self.dvs_rate_hz, self.profile)
            if "wall" in (self.timing, self.reference_timing):
                raise ValueError("dvs_rate_hz needs timing and reference_timing virtual or lockstep")
        return self

    @property
    def wire_lane(self) -> object:
        """The lane as Client.set_lane takes it."""
        return self.lane if isinstance(self.lane, int) else self.lane.model_dump(mode="json")

    @cached_property
    def velocities(self) -> tuple[Velocity, ...]:
        """The velocity of each command, north and east in m/s. Raises UserError where no path is free."""
        if self.path != "planned":
            return self.path
        return tuple(plan_path(lane_layout(self.wire_lane), -self.height_m, command_s=self.t_move_s))

    @property
    def slots(self) -> int:
        """The samples of a command."""
        return len(samples_due(self.t_move_s, self.t_sample_s))


class Collision(TypedDict):
    """What a flight collided with: the object, simulated seconds since the start, and the place in NED metres."""

    object: str
    time_s: NotNegative
    position_m: Annotated[list[Number], Field(min_length=3, max_length=3)]


class Dp2Row(FlightRow):
    """The row of a game of DP2."""

    t_move_s: Positive
    t_sample_s: Positive
    commands: Count
    planned_commands: Count
    samples: Count
    distance_m: Number
    collision: Collision | None
    guard_retries: Count


PICTURES = ("samples", HEIGHT, WIDTH)
ARRAYS = {
    "sample_index": ArrayForm("iu", ("samples",), ascends=True),
    "time_s": ArrayForm("f8", ("samples",), ascends=True),
    "position_m": ArrayForm("f8", ("samples", 3)),
    "orientation_wxyz": ArrayForm("f8", ("samples", 4)),
    "image": ArrayForm("u1", PICTURES),
    "colour": ArrayForm("u1", (*PICTURES, 3), optional=True),
    "retries": ArrayForm("iu", ("samples",)),
    "command_velocity_m_s": ArrayForm("f8", ("commands", 2)),
    "dvs_on": ArrayForm("u", PICTURES, optional=True),
    "dvs_off": ArrayForm("u", PICTURES, optional=True),
}
"""What a game with n samples keeps, those in colour and the DVS's counts only where it has them."""


@dataclass(frozen=True)
class Game(FlightCase):
    """One game: a reference flies at 1x with clean images; the one in lockstep flies TCSC without latency."""

    planned_s: float

    def simulated_s(self) -> float:
        return self.planned_s


class Dp2(PathSuite[Dp2Config, Game]):
    """`uavaccel run dp2`."""

    name, scene = "dp2", "lane"
    config, case, row, arrays = Dp2Config, Game, Dp2Row, ARRAYS
    quick: ClassVar[Mapping[str, object]] = {}

    def cases(self, config: Dp2Config) -> Iterator[Game]:
        """Yield references, the flight without latency, and the grid."""
        planned_s = len(config.velocities) * config.t_move_s
        clean = config.perturbation.share == 0 and config.timing == config.reference_timing
        in_grid = clean and 1.0 in config.clock_speed
        for command in () if in_grid else config.command:
            yield Game("reference", command, 1.0, config.reference_timing, planned_s)
        yield Game("lockstep", "tcsc", 1.0, "lockstep", planned_s)
        for command, clock_speed in product(config.command, config.clock_speed):
            itself = in_grid and clock_speed == 1.0
            yield Game("reference" if itself else "game", command, clock_speed, config.timing, planned_s)

    def renders(self, config: Dp2Config) -> bool:
        return True

    def fly(self, config: Dp2Config, case: Game, opened: Session) -> GameResult:
        seed, perturbation = named_seed(config.seed, case.id), None
        client = opened.start_game(case.clock_speed, seed, config.wire_lane, config.height_m)
        if config.perturbation.share and case.role == "game":  # what it is compared with stays clean
            perturbation = config.perturbation.at(case.clock_speed, int(seed.generate_state(1)[0]))
        # in colour where colours may be perturbed, and once per run for the guard study
        kind = "colour" if case.role == "lockstep" or perturbation else "gray"
        exposure = perturb.AutoExposure() if config.auto_exposure else None
        with closing(EventClient(opened, client, kind, config.guard, perturbation, exposure)) as camera:
            if config.dvs_rate_hz is not None:
                sensor = make_sensor(PRESETS[config.dvs_preset], (HEIGHT, WIDTH), config.sensor_seed)
                camera.count(sensor, rate_ticks(config.dvs_rate_hz, config.profile), config.sensor_seed)
            samples, indices, commands, wall_s = fly_to_the_end(config, case, camera)
            start, hit, collision = samples[0].state, client.collision(), None
            samples = [sample for sample in samples if not hit or sample.state.time_ns <= hit["time_ns"]]
            counts = dict(zip(EVENTS, camera.counts(len(samples)), strict=False))
        end_m = hit["position_m"] if hit else samples[-1].state.position_m
        if hit:
            hit_s = (hit["time_ns"] - start.time_ns) / NS_PER_S
            collision = {"object": hit["object"], "time_s": hit_s, "position_m": list(end_m)}
        row = flight_row(case, config, client, wall_s)[0] | {
            **subset(vars(config), "t_move_s", "t_sample_s"),
            "commands": commands,
            "planned_commands": len(config.velocities),
            "samples": len(samples),
            "distance_m": float(end_m[0]) - start.position_m[0],
            "collision": collision,
            "guard_retries": sum(sample.retries for sample in samples),
        }
        states, images = [sample.state for sample in samples], np.stack([sample.image for sample in samples])
        in_colour = {"colour": images} if kind == "colour" else {}
        arrays = {
            "sample_index": np.array(indices[: len(samples)], np.int32),
            "time_s": np.array([(state.time_ns - start.time_ns) / NS_PER_S for state in states]),
            "position_m": np.array([state.position_m for state in states]),
            "orientation_wxyz": np.array([state.orientation_wxyz for state in states]),
            "retries": np.array([sample.retries for sample in samples], np.int32),
            "command_velocity_m_s": np.array(config.velocities[:commands]),
            "image": np.stack([luma(image) for image in images]) if in_colour else images,
        }
        return GameResult(row, arrays | in_colour | counts)

    def flight(
        self, report: Report, game: Mapping[str, Any], pictures: bool = True, event_rate_hz: float | None = None
    ) -> Flight:
        config, arrays = report.config, report.arrays(game)
        time_ns, flat = to_ns(arrays["time_s"]), arrays["command_velocity_m_s"]
        starts = time_ns[np.searchsorted(arrays["sample_index"], np.arange(len(flat)) * config.slots)]
        ends = np.minimum(starts + to_ns(config.t_move_s), [*starts[1:], time_ns[-1]])
        windows: Sequence[Window] = ()
        if pictures and "dvs_on" in arrays:
            counts = zip(time_ns.tolist(), arrays["dvs_on"], arrays["dvs_off"], strict=True)
            windows = [Window(at, None, (on, off)) for at, on, off in counts]
        elif pictures:
            windows = list(windows_of(arrays["image"], time_ns, PRESETS[config.dvs_preset], config.sensor_seed))
        hit, achieved = game["collision"], f"{game['real_time_factor']:.1f}x, {timing_provenance(game['timing'])}"
        end = f", hit {hit['object']}" if hit else ""
        return Flight(
            f"{game['command'].upper()} at ClockSpeed {game['clock_speed']:g}x (achieved {achieved}{end})",
            game["clock_speed"],
            time_ns,
            arrays["position_m"],
            arrays["orientation_wxyz"],
            Commands(starts, ends, np.column_stack([flat, np.zeros(len(flat))])),
            scene="lane",
            lane=lane_layout(config.wire_lane),
            image_ns=time_ns,
            images=arrays.get("colour", arrays["image"]),
            windows=windows,
            collision=hit and (round(hit["time_s"] * NS_PER_S), hit["object"]),
        )

    def score(self, report: Report) -> pd.DataFrame:
        """Return the finished games by command and ClockSpeed, with the ERRORS of their images as lists.

        `reference` is the case of the run at 1x, `equal_poses` and `equal_counts` say whether these are those of the
        game without latency to the last bit; None where there is none. Three games at a time are held in memory.
        """
        games, scores = finished(report.games), list[dict[str, Any]]()
        calm = next((observe(report, game) for game in games[games.role == "lockstep"].to_dict("records")), None)
        flown = games[games.role != "lockstep"]
        flown = flown.sort_values(["command", "clock_speed", "role"], ascending=[True, True, False])  # reference first
        for _, own in flown.groupby("command"):
            real = own[own.role == "reference"].case.head(1).tolist()
            at_1x = None
            for game in own.to_dict("records"):
                seen = observe(report, game)
                at_1x = seen if [game["case"]] == real else at_1x
                scores.append({"reference": real[0] if real else None, **compare(seen, at_1x, calm)})
        columns = ["reference", *ERRORS, "equal_poses", "equal_counts"]
        return flown.join(pd.DataFrame(scores, flown.index, columns, dtype=object))

    def summary(self, report: Report) -> Summary:
        """Return an entry for each command and ClockSpeed, and the guard study on the images that are in colour.

        Errors are of the images that a game, up to a collision, shares with the same command's at 1x; unknown is None.
        """
        config, games, cells = report.config, finished(report.games).set_index("case"), list[dict[str, Any]]()
        kept = ["command", "clock_speed", "t_move_s", "timing", "guard_retries", "collision", "distance_m"]
        kept += ["wall_s", "real_time_factor"]
        for game in report.scores.to_dict("records"):
            marks = [key for key in Disturbances.__annotations__ if not unknown(game.get(key))]
            cell = {**subset(game, *kept, *marks), "provenance": timing_provenance(game["timing"]), "reference": None}
            if (case := game["reference"]) is not None:
                cell["reference"] = reference_of(games.loc[case], case == game["case"], case=case)
            for name in ERRORS:
                cell[f"{name}_median"] = np.median(game[name]) if game[name] else None
                cell[f"{name}_max"] = max(game[name], default=None)
            cell |= {"images": game["samples"], "paired_images": len(game["position_error_m"])}
            cell |= {"poses_equal_lockstep": game["equal_poses"], "dvs_counts_equal_lockstep": game["equal_counts"]}
            cells.append({**cell, "simulated_s_per_wall_s": game["duration_s"] / game["wall_s"]})
        calm = games[games.role == "lockstep"].reset_index().to_dict("records")
        colour = report.arrays(calm[0])["colour"] if calm else None
        return {
            **subset(vars(config), "suite", "profile", "seed", "dvs_preset", "sensor_seed"),
            "perturbed_share": config.perturbation.share,
            "cells": cells,
            "guard_study": None if colour is None else study_guard(colour, config.guard, config.seed),
        }

    def headline(self, report: Report) -> str:
        """Return how far the images of each command's fastest game are from those of 1x."""
        said = dict[str, str]()
        for cell in report.summary["cells"]:  # they ascend
            error_m, events = cell["position_error_m_max"], cell["dvs_ed_percent_max"]
            if error_m is not None and cell["clock_speed"] > 1 and cell["timing"] != "lockstep":
                off = f"up to {metres(error_m)} m from where it takes them at 1x (DVS-ED up to {number(events, 3)} %)"
                where = off if error_m or events else "where it does at 1x, the same to the pixel"
                at = f"at {clock_label(cell['clock_speed'])} {command_name(cell['command'])}"
                said[cell["command"]] = f"{at} takes its images {where}"
        games = counted(len(report.games), "game")
        return "; ".join(said.values()) or f"{games}, none of them accelerated and comparable with 1x"

    def overview(self, report: Report) -> Table:
        columns: dict[str, Column] = {
            "command": "{command!u}",
            "ClockSpeed": "{clock_speed:g}x",
            "source": "{provenance}",
            "images": "{paired_images}",
            "position error, m: median, max": "{position_error_m_median!m}, {position_error_m_max!m}",
            "attitude error, deg: max": "{attitude_error_deg_max!m}",
            "DVS-ED, %: median, max": "{dvs_ed_percent_median!m}, {dvs_ed_percent_max!m}",
            "poses equal": "{poses_equal_lockstep}",
            "DVS counts equal": "{dvs_counts_equal_lockstep}",
            "guard retries": "{guard_retries}",
            "distance, m": "{distance_m:.1f}",
            "hit": lambda cell: (cell["collision"] or {}).get("object"),
            "simulated s a wall s": "{simulated_s_per_wall_s:.2f}",
            "disturbed": "{disturbed}",
        }
        return Table.of([{"disturbed": None, **cell} for cell in report.summary["cells"]], columns)

    def page(self, report: Report) -> Iterator[Block | str]:
        games, config, guard = report.games, report.config, report.summary["guard_study"]
        yield from warnings(games)
        if share := config.perturbation.share:
            yield f"Modelled: up to {share:.1%} of the games' images were perturbed on their way, none of those at 1x."
        if config.latency.reply_us.get("image") is None and (games.timing == "virtual").any():
            yield "The modelled wall times leave out drawing the images: the latency model has no channel for them."
        yield Heading("Each ClockSpeed against the run at 1x")
        yield self.overview(report)
        yield images_figure(report)
        if guard is not None:
            yield Heading("Image guard (modelled)")
            columns = {
                "kind of perturbation": "{kind}",
                "perturbed images sent": "{on[sent]}",
                "pass without guard": "{off[share_passed]:.1%}",
                "pass the guard": "{on[share_passed]:.1%}",
            }
            kinds = [{"kind": kind.replace("_", " "), **of} for kind, of in guard["by_kind"].items()]
            yield Table.of(kinds, columns)
            yield GUARD.format_map(guard)
        yield method_note(READING)


def fly_to_the_end(config: Dp2Config, case: Game, camera: EventClient) -> tuple[list[Sample], list[int], int, float]:
    """Fly the path to its end or to a collision; return samples, their places in the path, the commands and wall s."""
    samples, indices, commands, slots = [camera.read_sample(camera.kinematics())], [0], 0, config.slots
    path = [(*velocity, 0.0) for velocity in config.velocities]
    start_ns, flights = fly_path(case, config, camera, path, config.t_move_s, config.t_sample_s)
    for commands, flown in enumerate(flights, start=1):
        last = commands * slots
        # The last sample is always that of the command's end; ADSC may come too late for one before it.
        indices += [*range(last - slots + 1, last - slots + len(flown)), last]
        samples += flown
        stands_still = samples[-1].state.position_m == samples[-2].state.position_m  # a collision freezes it
        if stands_still and camera.client.collision():
            break
    return samples, indices, commands, (camera.now_ns() - start_ns) / NS_PER_S


def observe(report: Report, game: Mapping[str, Any]) -> Arrays:
    """Return places, POSES and EVENTS of a game, as counted in flight or else by the report's DVS."""
    arrays, config = report.arrays(game), report.config
    if "dvs_on" not in arrays:
        preset, times_ns = PRESETS[config.dvs_preset], to_ns(arrays["time_s"])
        counts = count_events(arrays["image"], times_ns, preset, config.sensor_seed)
        arrays |= zip(EVENTS, counts, strict=True)
    return {name: arrays[name] for name in ("sample_index", *POSES, *EVENTS)}


def compare(seen: Arrays, at_1x: Arrays | None, calm: Arrays | None) -> dict[str, Any]:
    """Return the ERRORS of a game's images against the run at 1x, none without it, and what equals that in lockstep."""
    found: dict[str, Any] = {name: [] for name in ERRORS} | {"equal_poses": None, "equal_counts": None}
    if calm is not None:
        found["equal_poses"], found["equal_counts"] = (
            all(np.array_equal(seen[name], calm[name]) for name in names) for names in (POSES, EVENTS)
        )
    if at_1x is not None:
        _, *shared = np.intersect1d(seen["sample_index"], at_1x["sample_index"], return_indices=True)
        own, real = (
            {name: game[name][places[1:]] for name in (*POSES, *EVENTS)}  # the start has made no events yet
            for game, places in zip((seen, at_1x), shared, strict=True)
        )
        away_m = np.linalg.norm(own["position_m"] - real["position_m"], axis=1)
        turn_deg = np.degrees(attitude_difference_rad(own["orientation_wxyz"], real["orientation_wxyz"]))
        dvs_ed = dvs_ed_percent(own["dvs_on"], own["dvs_off"], real["dvs_on"], real["dvs_off"])
        found |= zip(ERRORS, (away_m.tolist(), turn_deg.tolist(), dvs_ed.tolist()), strict=True)
    return found


def study_guard(images: NDArray[np.uint8], guard: GuardSettings, seed: int) -> dict[str, Any]:
    """Count what the guard accepts (MODELLED) where a SHARE of a run's images (n, H, W, 3) is perturbed, by kind.

    The images are sent STREAMS times, perturbed with another seed each time, as one stream has too few of each kind.
    """
    perturbed = [perturb.PerturbationSettings(SHARE, seed=seed + n) for n in range(STREAMS)]
    by_kind: dict[str, Any] = {str(kind): {} for kind in perturb.PerturbationKind}
    handed_on = dict[str, float]()
    for name, used in {"off": GuardSettings(max_retries=0), "on": guard}.items():
        sent = pd.concat(pass_guard(images, own, used) for own in perturbed)
        handed_on[name] = float((sent.kind[sent.passed] != "").mean())
        for kind, of_kind in by_kind.items():
            passed = sent.passed[sent.kind == kind]
            share = float(passed.mean()) if len(passed) else None
            of_kind[name] = {"sent": len(passed), "passed": int(passed.sum()), "share_passed": share}
    alarms = int((~pass_guard(images, perturb.PerturbationSettings(), guard).passed).sum())
    found: dict[str, Any] = {"modelled": True, "images": len(images), "share": SHARE, "streams": STREAMS}
    found |= {"by_kind": by_kind, "clean_false_alarms": alarms, "clean_retries": alarms}
    return found | {"perturbed_share_handed_on": handed_on}


def pass_guard(images: NDArray[np.uint8], perturbed: Any, guard: GuardSettings) -> pd.DataFrame:
    """Return each image sent, also those requested again: its `kind` of perturbation or "", and whether it `passed`."""
    state, kinds, passed = GuardState(), list[str](), list[bool]()

    def receive(scene: NDArray[np.uint8]) -> NDArray[np.uint8]:
        image, kind = perturb.perturb_share(scene, perturbed, len(kinds))
        kinds.append(kind or "")
        return image

    for scene in images:
        _, state, retries, _ = acquire(state, partial(receive, scene), guard)
        passed += [*[False] * retries, True]
    return pd.DataFrame({"kind": kinds, "passed": passed})


def images_figure(report: Report) -> Picture:
    """Draw Figure 7, position error over DVS-ED: a point an image, a panel a command."""
    scores, title = report.scores, "Position error and DVS-ED of each image"
    compared = scores[scores.reference.notna() & (scores.reference != scores.case)]
    images = compared.sort_values(["command", "clock_speed"])
    nothing, clocks, seen = "no accelerated game to compare with a run at 1x", sorted(images.clock_speed.unique()), []
    figure, panels = plots.facets(images, "command", title, height_in=2.6, across=1, empty=nothing)
    most_m = max((max(errors, default=0.0) for errors in images.position_error_m), default=0.0)
    for axes, command, own in panels:
        for game in own[::-1].to_dict("records"):  # few and near points lie on top
            place = clocks.index(game["clock_speed"])
            colour, marker = style.shade(place, len(clocks)), style.marker(place)
            x, y = np.array(game["dvs_ed_percent"]), np.array(game["position_error_m"])
            off = (x != 0) | (y != 0)
            label = f"{clock_label(game['clock_speed'])}: {np.count_nonzero(~off)} of {len(x)} at 0, 0"
            seen.append(f"{command_name(command)} at {label}")
            axes.scatter(x[off], y[off], 16, [colour], marker=marker, lw=0, alpha=0.8, clip_on=False, label=label)
            if not off.all():  # one ring for all of them
                size = (5.0 + 4.5 * place) ** 2
                axes.scatter(0, 0, size, facecolors="none", edgecolors=[colour], linewidths=1.6, clip_on=False)
        handles, labels = axes.get_legend_handles_labels()
        above: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (-0.02, 1.0), "alignment": "left", "ncols": 3}
        axes.legend(handles[::-1], labels[::-1], title=command_name(command), title_fontsize=10, **above)
        axes.set_xscale("symlog", linthresh=LINEAR_PERCENT, linscale=0.6)
        axes.set_yscale("symlog", linthresh=LINEAR_M, linscale=0.6)
        axes.set(xlabel="DVS-ED, % of the pixels", xlim=(-0.4 * LINEAR_PERCENT, 100))
        axes.set(ylabel="position error, m", ylim=(-0.4 * LINEAR_M, max(10.0, 2.0 * most_m)))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
    plots.label_outer([axes for axes, *_ in panels])
    caption = (
        "Figure 7. Position error over DVS-ED, a point an image, against the image of the same place in the path of "
        "the same command's run at 1x. Rings: images at the same place with as many DVS pixels as at 1x. Both axes are "
        f"logarithmic, but linear up to {LINEAR_PERCENT:g} % and {1e3 * LINEAR_M:g} mm."
    )
    alt = f"Clouds of points, an image each, by command and ClockSpeed: {'; '.join(seen) or 'none'}."
    return report.figure("figure7_images", figure, caption, alt, scores)


READING = (
    "Images are paired by their place in the path: the same sample of the same command. DVS-ED is the difference in "
    "the number of pixels with ON events plus that with OFF events, over all pixels; it cannot see events that moved "
    "elsewhere. One DVS, with one map of thresholds, is applied to all games' images. An error of 0 is exactly 0. A "
    "drone that hit something stands still: its images count up to that moment. Equal are every pose, and every "
    "pixel's event count, if they have the same bits as in the game flown without latency. Measured: the machine's "
    "clock. Modelled: a simulated clock."
)
GUARD = (
    "False alarms: {clean_false_alarms} of {images} clean images. With {share:.0%} of the images perturbed, "
    "{perturbed_share_handed_on[off]:.1%} of those handed on are perturbed without the guard and "
    "{perturbed_share_handed_on[on]:.1%} with it. The images are those of the game without latency, sent {streams} "
    "times with another seed. MuJoCo renders every image correctly: the perturbations are a model, whose sizes are "
    "this project's own choice. The guard checks mean brightness alone and cannot detect what leaves that as it is."
)
