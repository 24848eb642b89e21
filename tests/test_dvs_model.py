"""Every parameter of the DVS, against a pixel written out here and against statistics over many pixels."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from uavaccel.vision import dvs

SHAPE = (144, 256)
PIXELS = SHAPE[0] * SHAPE[1]
EXACT = replace(dvs.PRESETS["clean"], threshold_sigma=0.0)
TIMES_S = np.array([0.0, 0.05, 0.4, 0.401, 1.0, 1.02])  # uneven

NAMES = ("threshold_sigma", "cutoff_hz", "leak_rate_hz", "shot_noise_rate_hz", "refractory_s")
V2E = {  # v2e's own settings (v2ecore/v2e_args.py; EventEmulator's constructor)
    "constructor": (0.03, 0.0, 0.1, 0.0, 0.0),
    "command_line": (0.03, 300.0, 0.01, 0.001, 0.0005),
    "clean": (0.02, 0.0, 0.0, 0.0, 0.0),
    "noisy": (0.05, 30.0, 0.1, 5.0, 0.0),
}


def grey(level: int) -> NDArray[np.uint8]:
    return np.full(SHAPE, level, np.uint8)


def lin_log(intensity: int) -> float:
    return intensity * math.log(20) / 20 if intensity <= 20 else math.log(intensity)


def test_presets_are_v2es() -> None:
    assert set(dvs.PRESETS) == set(V2E)
    for name, values in V2E.items():
        parameters = asdict(dvs.PRESETS[name])
        assert tuple(parameters[key] for key in NAMES) == values
        assert (parameters["positive_threshold"], parameters["negative_threshold"]) == (0.2, 0.2)
        leaks = (parameters["leak_jitter_fraction"], parameters["leak_rate_spread_decades"])
        assert leaks == ((0.1, 0.1) if parameters["leak_rate_hz"] else (0.0, 0.0))


Event = tuple[float, int]


class Pixel:
    """v2e's pixel without random numbers: a log intensity remembered, and an event for each threshold passed."""

    def __init__(self, parameters: dvs.DvsParameters, up: float, down: float, leak: float, first: int) -> None:
        self.parameters, self.up, self.down, self.leak = parameters, up, down, leak
        self.base = self.filtered = lin_log(first)
        self.last_s = -math.inf

    def change(self, intensity: int, dt_s: float) -> int:
        """Whole thresholds between what is seen and what is remembered; the last frame was `dt_s` ago."""
        p, weight = self.parameters, 1.0
        if p.cutoff_hz > 0:
            weight = min(1.0, (intensity + 20) / 275 * dt_s * 2 * math.pi * p.cutoff_hz)
        self.filtered += weight * (lin_log(intensity) - self.filtered)
        self.base -= dt_s * p.leak_rate_hz * self.leak * self.up
        difference = self.filtered - self.base
        return math.floor(difference / self.up) if difference > 0 else -math.floor(-difference / self.down)

    def emit(self, count: int, stamps_s: NDArray[np.float64], refractory_s: float) -> list[Event]:
        sign, events = (1 if count > 0 else -1), []
        for stamp_s in stamps_s[: abs(count)]:
            if refractory_s and stamp_s - self.last_s <= refractory_s:
                continue
            if refractory_s:
                self.last_s = stamp_s
            self.base += self.up if sign > 0 else -self.down
            events.append((float(stamp_s), sign))
        return events


@pytest.mark.parametrize("start_s", [0.0, 2.0])
@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"cutoff_hz": 3.0},
        {"leak_rate_hz": 0.7},
        {"refractory_s": 0.1},
        {"cutoff_hz": 12.0, "leak_rate_hz": 2.0, "refractory_s": 0.03},
    ],
)
def test_every_event_of_a_pixel(changed: dict[str, float], start_s: float) -> None:
    """No event comes before the first frame, so that none is too early after another one."""
    parameters, rng, times_s = replace(EXACT, **changed), np.random.default_rng(11), start_s + TIMES_S
    frames = rng.integers(0, 256, (len(times_s), 5, 6), np.uint8)
    up, down, leak = rng.uniform((0.1, 0.3, 0.5), (0.2, 0.5, 2.0), (5, 6, 3)).transpose(2, 0, 1)
    sensor = dvs.sensor_from_maps(parameters, up, down, leak)
    state = dvs.init_state(sensor, frames[0], times_s[0])
    places = list(np.ndindex(5, 6))
    pixels = {
        place: Pixel(parameters, float(up[place]), float(down[place]), float(leak[place]), int(frames[0][place]))
        for place in places
    }
    for before_s, now_s, frame in zip(times_s, times_s[1:], frames[1:], strict=False):
        state, on, off, events = dvs.step_with_events(sensor, state, frame, float(now_s))
        counts = {place: pixels[place].change(int(frame[place]), now_s - before_s) for place in places}
        most = max(1, *(abs(count) for count in counts.values()))
        stamps_s = before_s + (now_s - before_s) * np.arange(1, most + 1) / most
        refractory_s = parameters.refractory_s if parameters.refractory_s > (now_s - before_s) / most else 0.0
        for place in places:
            expected = pixels[place].emit(counts[place], stamps_s, refractory_s)
            here = events[(events[:, 2] == place[0]) & (events[:, 1] == place[1])]
            np.testing.assert_allclose(here[:, [0, 3]], np.array(expected).reshape(-1, 2), rtol=1e-6)
            assert on[place] - off[place] == sum(sign for _, sign in expected)
            assert on[place] * off[place] == 0
        assert state.time_s == now_s


def test_thresholds_spread_by_sigma_around_their_own_nominal_values() -> None:
    parameters = replace(EXACT, positive_threshold=0.3, negative_threshold=0.5, threshold_sigma=0.04)
    sensor = dvs.make_sensor(parameters, SHAPE, seed=4)
    for map_, nominal in ((sensor.positive_threshold, 0.3), (sensor.negative_threshold, 0.5)):
        assert map_.mean() == pytest.approx(nominal, abs=4 * 0.04 / PIXELS**0.5)
        assert map_.std() == pytest.approx(0.04, rel=0.03)
    assert abs(np.corrcoef(sensor.positive_threshold.ravel(), sensor.negative_threshold.ravel())[0, 1]) < 0.03
    flat = dvs.make_sensor(replace(parameters, threshold_sigma=0.0), SHAPE, seed=4)
    assert (flat.positive_threshold == np.float32(0.3)).all()
    assert (flat.negative_threshold == np.float32(0.5)).all()


def test_leak_rates_spread_by_decades_around_one() -> None:
    sensor = dvs.make_sensor(replace(EXACT, leak_rate_hz=0.1, leak_rate_spread_decades=0.25), SHAPE, seed=4)
    decades = np.log10(sensor.leak_rate_factor)
    assert decades.std() == pytest.approx(0.25, rel=0.03)
    assert decades.mean() == pytest.approx(0.0, abs=4 * 0.25 / PIXELS**0.5)


def test_leak_jitters_by_its_fraction_and_anew_in_each_frame() -> None:
    """The memorised intensity falls by leak rate x dt positive thresholds, so that ON events come of nothing."""
    parameters = replace(EXACT, positive_threshold=0.3, leak_rate_hz=0.5, leak_jitter_fraction=0.2)
    sensor = dvs.make_sensor(parameters, SHAPE, seed=0)
    state, falls = dvs.init_state(sensor, grey(90), noise_seed=3), []
    for t_s, dt_s in ((0.25, 0.25), (0.75, 0.5)):
        last, (state, _, _) = state.base_log, dvs.step(sensor, state, grey(90), t_s)
        falls.append((last - state.base_log) / (dt_s * 0.5 * 0.3))
        assert falls[-1].mean() == pytest.approx(1.0, abs=4 * 0.2 / PIXELS**0.5)
        assert falls[-1].std() == pytest.approx(0.2, rel=0.03)
    assert abs(np.corrcoef(falls[0].ravel(), falls[1].ravel())[0, 1]) < 0.03


@pytest.mark.parametrize(("level", "dt_s"), [(0, 0.02), (0, 0.1), (100, 0.1), (255, 0.1)])
def test_shot_noise_falls_with_brightness_and_is_on_as_often_as_off(level: int, dt_s: float) -> None:
    sensor = dvs.make_sensor(replace(EXACT, shot_noise_rate_hz=2.0), SHAPE, seed=0)
    _, on, off = dvs.step(sensor, dvs.init_state(sensor, grey(level)), grey(level), dt_s)
    expected = PIXELS * 2.0 / 2 * dt_s * (1 - 0.75 * (level + 20) / 275)
    assert on.sum() == pytest.approx(expected, abs=4 * expected**0.5)
    assert off.sum() == pytest.approx(expected, abs=4 * expected**0.5)


def test_shot_noise_hits_other_pixels_in_each_frame() -> None:
    sensor = dvs.make_sensor(replace(EXACT, shot_noise_rate_hz=1.0), SHAPE, seed=0)
    state, hit = dvs.init_state(sensor, grey(0)), []
    for t_s in (0.2, 0.4):
        state, on, off = dvs.step(sensor, state, grey(0), t_s)
        hit.append((on + off) > 0)
    share = hit[0].mean()
    assert (hit[0] & hit[1]).mean() == pytest.approx(share**2, rel=0.2)


def test_shot_noise_follows_each_polaritys_own_threshold() -> None:
    """The nominal threshold over the pixel's: half of it doubles the rate."""
    up, down = np.full((2, *SHAPE), 0.2)
    up[:, :128], down[:, 128:] = 0.1, 0.4
    sensor = dvs.sensor_from_maps(replace(EXACT, shot_noise_rate_hz=1.0), up, down)
    _, on, off = dvs.step(sensor, dvs.init_state(sensor, grey(0)), grey(0), 0.1)
    once = PIXELS / 2 * 0.05 * (1 - 0.75 * 20 / 275)
    for mask, factor in ((on[:, :128], 2), (on[:, 128:], 1), (off[:, :128], 1), (off[:, 128:], 0.5)):
        assert mask.sum() == pytest.approx(factor * once, abs=4 * (factor * once) ** 0.5)


def test_shot_noise_is_listed_at_the_last_stamp_where_it_hit() -> None:
    sensor = dvs.make_sensor(replace(EXACT, shot_noise_rate_hz=3.0), SHAPE, seed=0)
    _, on, off, events = dvs.step_with_events(sensor, dvs.init_state(sensor, grey(60)), grey(60), 0.1)
    assert (events[:, 0] == np.float32(0.1)).all()
    for counts, polarity in ((on, 1), (off, -1)):
        rows, columns = np.nonzero(counts)
        np.testing.assert_array_equal(events[events[:, 3] == polarity][:, 1:3], np.stack([columns, rows], axis=1))


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_depends_on_the_seed_and_not_on_the_sensors(seed: int) -> None:
    parameters = replace(EXACT, shot_noise_rate_hz=2.0)

    def step(sensor_seed: int, noise_seed: int) -> NDArray:
        sensor = dvs.make_sensor(parameters, SHAPE, sensor_seed)
        state, _, _ = dvs.step(sensor, dvs.init_state(sensor, grey(9), noise_seed=noise_seed), grey(9), 0.3)
        return dvs.step(sensor, state, grey(9), 0.6)[1]  # of a later frame: the seed is carried on

    np.testing.assert_array_equal(step(seed, 5), step(seed + 1, 5))
    assert (step(seed, 5) != step(seed, 6)).any()
