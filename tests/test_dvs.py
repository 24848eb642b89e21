"""The event camera's model against v2e's own emulator (recorded in tests/data/v2e_clean.npz); and DVS-ED, its error."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from uavaccel.metrics.trajectory import active_pixels, dvs_ed_percent
from uavaccel.vision import dvs
from uavaccel.vision import dvs_kernels as kernels

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


@pytest.mark.parametrize("cutoff_hz", [0.0, 30.0])
def test_counts_are_numpys_floor_division_next_to_whole_thresholds(cutoff_hz: float) -> None:
    rng = np.random.default_rng(3)
    sensor = dvs.make_sensor(replace(CLEAN, threshold_sigma=0.05, cutoff_hz=cutoff_hz), SHAPE, seed=1)
    positive, negative = sensor.positive_threshold, sensor.negative_threshold
    log = rng.integers(0, 40, SHAPE).astype(positive.dtype) * positive
    log = np.nextafter(log, np.where(rng.random(SHAPE) < 0.5, np.inf, -np.inf).astype(log.dtype))
    count: Any = kernels.count_double_pixel if cutoff_hz else kernels.count_single_pixel
    counts = [
        count(*pixel) for pixel in zip(log.flat, np.zeros_like(log).flat, positive.flat, negative.flat, strict=True)
    ]
    expected = np.floor_divide(np.maximum(log, 0), positive) - np.floor_divide(np.maximum(-log, 0), negative)
    np.testing.assert_array_equal(counts, expected.ravel())


def test_a_quotient_that_is_rounded_up_counts_one_less() -> None:
    change, threshold = 1.7825321262297023, 0.16204837511179113
    assert change / threshold == 11
    assert kernels.count_double_pixel(change, 0.0, threshold, threshold) == 10


@given(small_frames, st.integers(0, 99), st.sampled_from(["clean", "noisy", "command_line"]))
def test_counts_do_not_depend_on_the_layout_of_the_frame(frame: NDArray, seed: int, preset: str) -> None:
    sensor = dvs.make_sensor(dvs.PRESETS[preset], frame.shape, seed)
    state = dvs.init_state(sensor, frame[::-1, ::-1])
    strided = np.repeat(np.repeat(frame, 2, axis=0), 3, axis=1)[::2, ::3]
    for view in (np.asfortranarray(frame), strided, frame[::-1][::-1]):
        expected, actual = dvs.step(sensor, state, frame, 0.1), dvs.step(sensor, state, view, 0.1)
        np.testing.assert_array_equal(expected[1:], actual[1:])


def noise_frames(count: int, shape: tuple[int, int]) -> NDArray:
    return np.random.default_rng(5).integers(0, 256, (count, *shape), np.uint8)


@pytest.mark.parametrize("preset", dvs.PRESETS)
def test_step_is_a_pure_function_of_its_arguments(preset: str) -> None:
    first, second = noise_frames(2, (7, 9))
    sensor = dvs.make_sensor(dvs.PRESETS[preset], first.shape, seed=2)
    state = dvs.init_state(sensor, first, noise_seed=4)
    before = [np.copy(part) for part in state]
    once, again = (dvs.step(sensor, state, second, 0.01) for _ in range(2))
    for a, b in zip((*once[0], *once[1:]), (*again[0], *again[1:]), strict=True):
        np.testing.assert_array_equal(a, b)
    for part, copy in zip(state, before, strict=True):
        np.testing.assert_array_equal(part, copy)


@pytest.mark.parametrize("preset", dvs.PRESETS)
def test_listed_events_add_up_to_the_counts_in_order_of_their_stamps(preset: str) -> None:
    frames = noise_frames(6, (7, 9))
    sensor = dvs.make_sensor(dvs.PRESETS[preset], (7, 9), seed=2)
    state = dvs.init_state(sensor, frames[0])
    for i, frame in enumerate(frames[1:]):
        plain = dvs.step(sensor, state, frame, 0.01 * (i + 1))
        state, on, off, events = dvs.step_with_events(sensor, state, frame, 0.01 * (i + 1))
        np.testing.assert_array_equal(plain[1:], (on, off))
        listed = np.zeros((2, 7, 9), int)
        x, y, polarity = events[:, 1:].astype(int).T
        np.add.at(listed, ((polarity < 0).astype(int), y, x), 1)
        np.testing.assert_array_equal(listed, (on, off))
        assert (np.diff(events[:, 0]) >= 0).all()


def test_luma_is_opencvs_grey_of_the_reversed_channels() -> None:
    rgb = np.random.default_rng(1).integers(0, 256, (31, 17, 3), np.uint8)
    np.testing.assert_array_equal(dvs.luma(rgb), cv2.cvtColor(rgb[:, :, ::-1].copy(), cv2.COLOR_BGR2GRAY))
    np.testing.assert_array_equal(dvs.luma(rgb[::-1]), dvs.luma(rgb)[::-1])


def test_maps_of_another_emulator_are_taken_over() -> None:
    maps = np.random.default_rng(0).uniform(0.1, 0.3, (2, 5, 6)).astype(np.float32)
    sensor = dvs.sensor_from_maps(dvs.PRESETS["noisy"], *maps)
    np.testing.assert_array_equal((sensor.positive_threshold, sensor.negative_threshold), maps)
    assert sensor.positive_threshold.dtype == np.float64  # behind a low-pass v2e computes in double precision
    np.testing.assert_array_equal(sensor.leak_rate_factor, 1)


def test_a_pixel_rests_up_to_its_refractory_period_and_fires_after_it() -> None:
    """0.75 s after its event at 0.5 s; a frame of the same time as the last one is none too early."""
    sensor = dvs.make_sensor(replace(CLEAN, threshold_sigma=0.0, refractory_s=0.75), (1, 1), seed=0)
    for last_s, fires in ((1.25, 0), (1.265625, 1)):
        state, on, _ = dvs.step(sensor, dvs.init_state(sensor, np.full((1, 1), 100, np.uint8)), bright(125), 0.5)
        assert on.sum() == 1
        for now_s in (1.125, 1.125):
            state, on, _ = dvs.step(sensor, state, bright(125), now_s)
            assert on.sum() == 0
        _, on, _ = dvs.step(sensor, state, bright(155), last_s)
        assert on.sum() == fires


DRIVEN: dict[str, float] = {"threshold_sigma": 0.03, "leak_rate_hz": 20.0, "hot_share": 0.2, "refractory_s": 0.0005}
LEAKS: dict[str, float] = {"leak_rate_hz": 100.0, "refractory_s": 0.005}


@pytest.mark.parametrize(
    ("noise", "spacing_s", "can"),
    [
        *((DRIVEN, 0.002, True), (DRIVEN, 0.02, True), (DRIVEN, 0.06, False), (DRIVEN, 0.5, False)),
        *((LEAKS, 0.2, True), (LEAKS, 0.4, False)),
        (LEAKS | {"leak_jitter_fraction": 0.1}, 0.4, True),
        (LEAKS | {"leak_rate_spread_decades": 0.1}, 0.4, True),
        *(({"hot_share": 0.01, "refractory_s": 0.09}, 20.0, True), ({"refractory_s": 0.09}, 20.0, False)),
    ],
)
def test_frames_far_apart_leave_no_events_to_suppress(noise: dict[str, float], spacing_s: float, can: bool) -> None:
    """Where none can be, not even one black and one white frame after another have events that are too close."""
    parameters = replace(dvs.PRESETS["clean"], **{"threshold_sigma": 0.0} | noise)
    sensor = dvs.make_sensor(parameters, (144, 256), seed=0)
    assert dvs.can_suppress(sensor, spacing_s) == can
    for name in ("positive_threshold", "negative_threshold"):  # of which the lower one decides
        assert dvs.can_suppress(sensor._replace(**{name: 8.0 * getattr(sensor, name)}), spacing_s) == can
    assert not dvs.can_suppress(sensor._replace(parameters=replace(parameters, refractory_s=0.0)), spacing_s)
    state, suppressed = dvs.init_state(sensor, np.zeros((144, 256), np.uint8)), False
    for number in range(1, 7):
        state, _, _ = dvs.step(sensor, state, np.full((144, 256), 255 * (number % 2), np.uint8), number * spacing_s)
        suppressed |= bool((state.last_event_s > 0.0).any())
    assert suppressed == can


def bright(level: int) -> NDArray:
    return np.full((1, 1), level, np.uint8)


@pytest.mark.parametrize(
    ("frame", "t_s", "message"),
    [
        (np.zeros((3, 4), np.float32), 1.0, "uint8"),
        (np.zeros((4, 3), np.uint8), 1.0, r"\(3, 4\)"),
        (np.zeros((3, 4), np.uint8), -1.0, "cannot follow"),
        (np.zeros((3, 4), np.uint8), float("nan"), "cannot follow"),
    ],
)
def test_frames_that_cannot_be_are_refused(frame: NDArray, t_s: float, message: str) -> None:
    sensor = dvs.make_sensor(CLEAN, (3, 4), seed=0)
    state = dvs.init_state(sensor, np.zeros((3, 4), np.uint8))
    with pytest.raises(ValueError, match=message):
        dvs.step(sensor, state, frame, t_s)


@pytest.mark.parametrize(
    ("before_s", "now_s", "count", "index", "torchs"),
    [
        (199844.142, 199844.162, 131, 65, 199844.140625),
        (115421.722, 115421.724, 435, 217, 115421.7265625),
        (87894.222, 87894.223, 373, 186, 87894.2265625),
    ],
)
def test_stamps_late_in_a_long_game_are_torchs(
    before_s: float, now_s: float, count: int, index: int, torchs: float
) -> None:
    """Where a sum needs more than a double's bits: each is the float32 nearest to the exact sum, rounded once."""
    stamps = dvs.time_stamps(before_s, now_s, count)
    assert stamps[index] == np.float32(torchs)
    start, end = np.float32(before_s + (now_s - before_s) / count), np.float32(now_s)
    spacing = Fraction(float((end - start) / np.float32(count - 1)))
    for place, stamp in enumerate(stamps):
        rising = place < count // 2
        exact = Fraction(float(start)) + spacing * place
        exact = exact if rising else Fraction(float(end)) - spacing * (count - 1 - place)
        around = (np.nextafter(stamp, np.float32(-np.inf)), stamp, np.nextafter(stamp, np.float32(np.inf)))
        assert min(around, key=lambda value: abs(Fraction(float(value)) - exact)) == stamp


# --- DVS-ED -----------------------------------------------------------------------------------------------------------


def random_run(seed: int, images: int = 3) -> NDArray:
    return np.random.default_rng(seed).integers(0, 3, (2, images, 4, 5))


def test_it_counts_pixels_of_each_polarity_not_events() -> None:
    on, off = np.zeros((2, 1, 10, 10), int)
    on[0, :2, :3], off[0, 5, 5] = 7, 1
    nothing, one = np.zeros((1, 10, 10), int), np.ones((1, 10, 10), int)
    assert active_pixels(on)[0] == 6
    assert dvs_ed_percent(on, off, nothing, nothing)[0] == 7.0
    assert dvs_ed_percent(one, nothing, nothing, one)[0] == 200.0


def test_images_are_paired_by_index_as_far_as_both_runs_have_them() -> None:
    run, reference = random_run(1, images=5), random_run(2, images=3)
    shorter = dvs_ed_percent(*run[:, :3], *reference)
    np.testing.assert_array_equal(dvs_ed_percent(*run, *reference), shorter)
    np.testing.assert_array_equal(dvs_ed_percent(*reference, *run), shorter)
    np.testing.assert_array_equal(dvs_ed_percent(*run, *run), 0.0)
    for one, other in ((run, reference[..., 1:]), ((run[0], run[1, 1:]), reference), (run[..., 0], reference[..., 0])):
        for counts in ((*one, *other), (*other, *one)):
            with pytest.raises(ValueError, match="event counts"):
                dvs_ed_percent(*counts)
