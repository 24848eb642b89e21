"""The DVS model against v2e's own emulator (recorded in tests/data/v2e_clean.npz), and its properties."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from uavaccel.vision import dvs

SHAPE = (144, 256)
CLEAN = dvs.PRESETS["clean"]
EXACT = replace(CLEAN, threshold_sigma=0.0)
LEAK = replace(EXACT, leak_rate_hz=0.1, leak_jitter_fraction=0.0, leak_rate_spread_decades=0.0)
CASES = {
    "sigma0": (EXACT, 0.33),
    "sigma02": (CLEAN, 0.33),
    "leak": (LEAK, 0.33),
    "lowpass_dt5ms": (replace(EXACT, cutoff_hz=30.0), 0.005),
}
small_frames = hnp.arrays(np.uint8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9))


@pytest.fixture(scope="module")
def recorded() -> dict[str, NDArray]:
    with np.load(Path(__file__).parent / "data" / "v2e_clean.npz") as archive:
        return dict(archive)


def sensor_of(case: str, recorded: dict[str, NDArray]) -> dvs.DvsSensor:
    sensor = dvs.make_sensor(CASES[case][0], SHAPE, seed=0)
    if case != "sigma02":
        return sensor
    return sensor._replace(
        positive_threshold=recorded["sigma02_pos_thres"], negative_threshold=recorded["sigma02_neg_thres"]
    )


@pytest.mark.parametrize("case", CASES)
def test_counts_and_stamps_equal_v2e_to_the_last_event(case: str, recorded: dict[str, NDArray]) -> None:
    sensor, dt_s = sensor_of(case, recorded), CASES[case][1]
    state = dvs.init_state(sensor, recorded["frames"][0])
    stamps_s = []
    for i, frame in enumerate(recorded["frames"][1:]):
        state, on, off, events = dvs.step_with_events(sensor, state, frame, (i + 1) * dt_s)
        np.testing.assert_array_equal(on, recorded[f"{case}_on"][i])
        np.testing.assert_array_equal(off, recorded[f"{case}_off"][i])
        stamps_s.append(np.unique(events[:, 0]))
    np.testing.assert_array_equal([len(s) for s in stamps_s], recorded[f"{case}_stamp_counts"])
    np.testing.assert_array_equal(np.concatenate(stamps_s), recorded[f"{case}_stamps"])
