"""DP2's scores and summary: errors of each image against the same command's run at 1x, paired by place in the path.

The DVS is applied to the stored images here, so that its parameters can be changed without flying again. It is one
sensor for all ClockSpeeds, with one map of thresholds from `sensor_seed` (paper, section III-C2b).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.metrics.dvs_ed import dvs_ed_percent
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.suites.old_dp2.flights import Dp2Row
from uavaccel.suites.old_report import Arrays, LoadArrays, Summary, Values
from uavaccel.suites.rows import Row, subset
from uavaccel.units import attitude_difference_rad
from uavaccel.vision.dvs import PRESETS, DvsParameters, init_state, make_sensor, step
from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.guard_study import guard_study
from uavaccel.vision.perturb import PerturbationKind

Counts = NDArray[np.unsignedinteger]
ERRORS = ("position_error_m", "attitude_error_deg", "dvs_ed_percent")


@dataclass(frozen=True)
class ObservedFlight:
    """A game's samples with the DVS's event counts `on` and `off` (n, H, W), 0 for the first sample."""

    row: Dp2Row
    sample_index: NDArray[np.int32]
    position_m: NDArray[np.float64]
    orientation_wxyz: NDArray[np.float64]
    on: Counts
    off: Counts


@dataclass(frozen=True)
class GameScore:
    """The errors of one game's images that the run at 1x has too, but for the first, which is that of the start.

    `equal_poses` and `equal_counts` say whether poses and DVS counts equal those of the game without latency to the
    last bit; they are None where the run has no such game. `reference` is the row of the run at 1x, None without one.
    """

    row: Dp2Row
    reference: Dp2Row | None
    position_error_m: NDArray[np.float64]
    attitude_error_deg: NDArray[np.float64]
    dvs_ed_percent: NDArray[np.float64]
    equal_poses: bool | None
    equal_counts: bool | None

    def by_image(self) -> dict[str, Any]:
        """Return the errors of every image for scores.json, with the keys that identify the game."""
        errors = {name: getattr(self, name).tolist() for name in ERRORS}
        return subset(self.row, "command", "clock_speed", "role") | errors


def count_events(
    images: NDArray[np.uint8], time_s: NDArray[np.float64], dvs: DvsParameters, sensor_seed: int
) -> tuple[Counts, Counts]:
    """Return ON and OFF counts (n, H, W) of gray images (n, H, W) taken at `time_s`; the first causes no events."""
    sensor = make_sensor(dvs, images.shape[1:], sensor_seed)
    state = init_state(sensor, images[0], float(time_s[0]), noise_seed=sensor_seed)
    on, off = np.zeros(images.shape, np.uint16), np.zeros(images.shape, np.uint16)
    for i in range(1, len(images)):
        state, on[i], off[i] = step(sensor, state, images[i], float(time_s[i]))
    return on, off


def counts_of(arrays: Arrays, preset: str, sensor_seed: int) -> tuple[Counts, Counts]:
    """Return the DVS's counts in a game: those counted in flight, or else those of the stored images."""
    if "dvs_on" in arrays:
        return arrays["dvs_on"], arrays["dvs_off"]
    return count_events(arrays["image"], arrays["time_s"], PRESETS[preset], sensor_seed)


def score_games(
    rows: Sequence[Dp2Row], load_arrays: LoadArrays, preset: str, sensor_seed: int
) -> Iterator[GameScore]:
    """Yield the scores of the finished games, by command and ClockSpeed; the run at 1x is one of them.

    Only two games beside the present one are held in memory at a time.
    """
    finished = [row for row in rows if row["error"] is None]

    def observe(row: Dp2Row) -> ObservedFlight:
        arrays = load_arrays(row)
        poses = arrays["sample_index"], arrays["position_m"], arrays["orientation_wxyz"]
        return ObservedFlight(row, *poses, *counts_of(arrays, preset, sensor_seed))

    lockstep = next((observe(row) for row in finished if row["role"] == "lockstep"), None)
    for command in sorted({row["command"] for row in finished}):
        own = [row for row in finished if row["command"] == command and row["role"] != "lockstep"]
        reference = next((observe(row) for row in own if row["role"] == "reference"), None)
        for row in sorted(own, key=lambda row: (row["clock_speed"], row["role"] != "reference")):
            is_reference = reference is not None and row is reference.row
            yield score_game(reference if is_reference and reference else observe(row), reference, lockstep)


def score_game(
    flight: ObservedFlight, reference: ObservedFlight | None, lockstep: ObservedFlight | None
) -> GameScore:
    """Return one game's score; without a reference its errors are empty."""
    equal_poses = None if lockstep is None else _equal(flight, lockstep, "position_m", "orientation_wxyz")
    equal_counts = None if lockstep is None else _equal(flight, lockstep, "on", "off")
    if reference is None:
        none = np.empty(0)
        return GameScore(flight.row, None, none, none, none, equal_poses, equal_counts)
    _, own, other = np.intersect1d(flight.sample_index, reference.sample_index, return_indices=True)
    own, other = own[1:], other[1:]  # the start has made no events yet
    offset_m = flight.position_m[own] - reference.position_m[other]
    turn_rad = attitude_difference_rad(flight.orientation_wxyz[own], reference.orientation_wxyz[other])
    dissimilarity = dvs_ed_percent(flight.on[own], flight.off[own], reference.on[other], reference.off[other])
    return GameScore(
        flight.row,
        reference.row,
        np.linalg.norm(offset_m, axis=1),
        np.degrees(turn_rad),
        dissimilarity,
        equal_poses,
        equal_counts,
    )


def _equal(flight: ObservedFlight, other: ObservedFlight, *names: str) -> bool:
    return all(np.array_equal(getattr(flight, name), getattr(other, name)) for name in names)


def summary_of(config: Row, scores: Sequence[GameScore], guard: Summary | None) -> Values:
    """Summarise a run's scores, with an entry for each command and ClockSpeed; `guard` is the guard study.

    Errors are those of the images that a game shares with the same command's run at 1x: the images of a game that
    collides end at its collision. Numbers that cannot be known are None.
    """
    return {
        "suite": "dp2",
        **subset(config, "profile", "seed", "dvs_preset", "sensor_seed"),
        "perturbed_share": config["perturbation"]["share"],
        "cells": [_cell(score) for score in scores],
        "guard_study": guard,
    }


def _cell(score: GameScore) -> Values:
    row = score.row
    cell = subset(
        row, "command", "clock_speed", "t_move_s", "timing", "guard_retries", "collision", "distance_m"
    )
    cell |= subset(row, "wall_s", "real_time_factor", "lost_wall_s")
    cell |= {key: row[key] for key in ("disturbed", "stalled_wall_s", "restarts") if key in row}
    for name in ERRORS:
        values = getattr(score, name)
        cell[f"{name}_median"] = float(np.median(values)) if values.size else None
        cell[f"{name}_max"] = float(np.max(values)) if values.size else None
    return cell | {
        "provenance": timing_provenance(row["timing"]),
        "reference": _reference_of(score),
        "images": row["samples"],
        "paired_images": len(score.position_error_m),
        "poses_equal_lockstep": score.equal_poses,
        "dvs_counts_equal_lockstep": score.equal_counts,
        "simulated_s_per_wall_s": row["duration_s"] / row["wall_s"] if row["wall_s"] > 0 else None,
    }


def _reference_of(score: GameScore) -> Values | None:
    if score.reference is None:
        return None
    return {
        **subset(score.reference, "case", "clock_speed", "timing"),
        "provenance": timing_provenance(score.reference["timing"]),
        "is_this_cell": score.reference["case"] == score.row["case"],
    }


SHARE, STREAMS = 0.05, 20  # of the perturbed images; of the guard study


def study_guard(images: NDArray[np.uint8], settings: GuardSettings, seed: int) -> Values:
    """Count what the guard accepts (MODELLED) where a share of the run's own images (n, H, W, 3) is perturbed, by kind.

    The images are sent `STREAMS` times, perturbed with another seed each time, as one stream has too few of each kind.
    An image that the guard requests again may be perturbed again, so with the guard more are sent.
    """
    streams = [guard_study(list(images), SHARE, seed + stream, settings) for stream in range(STREAMS)]
    return {
        "modelled": True,
        "images": len(images),
        "share": SHARE,
        "streams": STREAMS,
        "by_kind": {str(kind): _by_kind(streams, str(kind)) for kind in PerturbationKind},
        "perturbed_share_handed_on": {
            guard: float(np.mean([stream[guard]["perturbed_share_handed_on"] for stream in streams]))
            for guard in ("off", "on")
        },
        "clean_false_alarms": streams[0]["clean"]["false_alarms"],
        "clean_retries": streams[0]["clean"]["retries"],
    }


def _by_kind(streams: list[Values], kind: str) -> Values:
    result = {}
    for guard in ("off", "on"):
        counts = [stream[guard]["by_kind"][kind] for stream in streams]
        sent, passed = (sum(count[key] for count in counts) for key in ("sent", "passed"))
        result[guard] = {"sent": sent, "passed": passed, "share_passed": passed / sent if sent else None}
    return result
