"""DP2's per-image errors against the same command's run at 1x, paired by the sample's place in the path.

The DVS looks at the stored images here, so that its parameters can be changed without flying again. It is one sensor
for all ClockSpeeds: one map of thresholds, drawn from `sensor_seed` (paper, section III-C2b).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.metrics.dvs_ed import dvs_ed_percent
from uavaccel.suites.dp2.cases import Dp2Row
from uavaccel.suites.report import Arrays, LoadArrays
from uavaccel.units import attitude_difference_rad
from uavaccel.vision.dvs import PRESETS, DvsParameters, init_state, make_sensor, step

Counts = NDArray[np.unsignedinteger]


@dataclass(frozen=True)
class SeenFlight:
    """A game's samples and what the DVS made of them: `on` and `off` (n, H, W) event counts, 0 for the first."""

    row: Dp2Row
    sample_index: NDArray[np.int32]
    position_m: NDArray[np.float64]
    orientation_wxyz: NDArray[np.float64]
    on: Counts
    off: Counts


@dataclass(frozen=True)
class GameScore:
    """One game's errors, one value an image that both it and the run at 1x have; the first image is the start's.

    `equal_poses`, `equal_counts`: whether poses and DVS counts equal those of the game without latency to the last
    bit; None where the run has no such game. `reference`: the row of the run at 1x, None without one.
    """

    row: Dp2Row
    reference: Dp2Row | None
    position_error_m: NDArray[np.float64]
    attitude_error_deg: NDArray[np.float64]
    dvs_ed_percent: NDArray[np.float64]
    equal_poses: bool | None
    equal_counts: bool | None

    def by_image(self) -> dict[str, Any]:
        """The errors of every image, for JSON, with what tells the game from the run's others."""
        return {
            **{key: self.row[key] for key in ("command", "clock_speed", "role")},
            "position_error_m": self.position_error_m.tolist(),
            "attitude_error_deg": self.attitude_error_deg.tolist(),
            "dvs_ed_percent": self.dvs_ed_percent.tolist(),
        }


def count_events(
    images: NDArray[np.uint8], time_s: NDArray[np.float64], dvs: DvsParameters, sensor_seed: int
) -> tuple[Counts, Counts]:
    """ON and OFF counts (n, H, W) of gray images (n, H, W) taken at `time_s`; the first one makes no events."""
    sensor = make_sensor(dvs, images.shape[1:], sensor_seed)
    state = init_state(sensor, images[0], float(time_s[0]), noise_seed=sensor_seed)
    on, off = np.zeros(images.shape, np.uint16), np.zeros(images.shape, np.uint16)
    for i in range(1, len(images)):
        state, on[i], off[i] = step(sensor, state, images[i], float(time_s[i]))
    return on, off


def counts_of(arrays: Arrays, preset: str, sensor_seed: int) -> tuple[Counts, Counts]:
    """What the DVS saw in a game: counted while it was flown, or else in the images that were kept."""
    if "dvs_on" in arrays:
        return arrays["dvs_on"], arrays["dvs_off"]
    return count_events(arrays["image"], arrays["time_s"], PRESETS[preset], sensor_seed)


def see(row: Dp2Row, arrays: Arrays, preset: str, sensor_seed: int) -> SeenFlight:
    """A game with its DVS counts."""
    on, off = counts_of(arrays, preset, sensor_seed)
    return SeenFlight(row, arrays["sample_index"], arrays["position_m"], arrays["orientation_wxyz"], on, off)


def score_games(
    rows: Sequence[Dp2Row], load_arrays: LoadArrays, preset: str, sensor_seed: int
) -> Iterator[GameScore]:
    """Scores of the finished games at all ClockSpeeds, by command and ClockSpeed; the run at 1x is one of them.

    Only two games beside the present one are held at a time: images are many.
    """
    finished = [row for row in rows if row["error"] is None]

    def seen(row: Dp2Row | None) -> SeenFlight | None:
        return None if row is None else see(row, load_arrays(row), preset, sensor_seed)

    lockstep = seen(next((row for row in finished if row["role"] == "lockstep"), None))
    for command in sorted({row["command"] for row in finished}):
        own = [row for row in finished if row["command"] == command and row["role"] != "lockstep"]
        reference = seen(next((row for row in own if row["role"] == "reference"), None))
        for row in sorted(own, key=lambda row: (row["clock_speed"], row["role"] != "reference")):
            flight = reference if reference is not None and row is reference.row else seen(row)
            assert flight is not None
            yield score_game(flight, reference, lockstep)


def score_game(flight: SeenFlight, reference: SeenFlight | None, lockstep: SeenFlight | None) -> GameScore:
    """One game's score; without a reference its errors are empty."""
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


def _equal(flight: SeenFlight, other: SeenFlight, *names: str) -> bool:
    return all(np.array_equal(getattr(flight, name), getattr(other, name)) for name in names)
