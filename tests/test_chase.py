"""The view from behind: the drone is in it, seen along its heading, in the lane that was flown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.opengl import needs_opengl
from uavaccel.draw.chase import ChaseView
from uavaccel.sim.clutter import Clutter, sample_world
from uavaccel.sim.lane import SUN_ELEVATION_RAD, sample_layout


def drone(picture: np.ndarray) -> np.ndarray:
    """Rows and columns of its orange rotors (n, 2), where no red obstacle is: low and in the middle."""
    picture = picture.copy()
    picture[:72] = picture[:, :96] = picture[:, 160:] = 0
    red, green, blue = (picture[..., channel].astype(int) for channel in range(3))
    return np.argwhere((red > 70) & (red > 2 * green) & (green > blue))


@needs_opengl
def test_the_drone_is_seen_from_behind_along_its_heading() -> None:
    position_m = np.array([[3.0, 0.0, -2.0], [23.0, 1.5, -2.0], [3.0, 0.0, -2.0], [3.0, 0.0, -2.0]])
    half = np.sqrt(0.5)
    attitude = np.array([[1.0, 0, 0, 0], [1.0, 0, 0, 0], [half, 0, 0, half], [np.cos(0.1), np.sin(0.1), 0, 0]])
    views = [ChaseView("lane", sample_layout(seed), position_m, attitude, (256, 144)) for seed in (3, 4)]
    start, further, east, rolled = (views[0](number) for number in range(4))
    assert start.shape == (144, 256, 3)
    places = drone(start)
    assert len(places) > 20
    rows, columns = places.T
    assert abs(np.median(columns) - 128) < 6
    assert np.ptp(rows) < 20  # in one piece
    # of the front rotors, 0.16 m ahead: from 2.4 m behind and 1.15 m above, looking 20 degrees down at 140 pixels
    # per tangent; those behind would be 7 rows lower
    below = np.arctan((1.15 - 0.025) / (2.4 + 0.16)) - np.radians(20.0)
    assert np.median(rows) == pytest.approx(72 + 140 * np.tan(below), abs=2.0)
    west, other = columns[columns < 128], columns[columns >= 128]
    assert min(len(west), len(other)) > 8  # both front rotors
    by_roll = drone(rolled)
    left, right = (np.median(by_roll[side][:, 0]) for side in (by_roll[:, 1] < 128, by_roll[:, 1] >= 128))
    assert left < right - 2  # rolled to the right, the horizon stays level
    assert abs(np.median(drone(further)[:, 1]) - 128) < 6  # wherever it is
    for other_view in (further, east, views[1](0)):
        assert (np.abs(other_view.astype(int) - start) > 20).mean() > 0.1
    for view in views:
        view.close()


@needs_opengl
def test_the_drones_shadow_falls_away_from_the_sun() -> None:
    """It lies as far to its side as the sun is low and the drone high, and is turned as that is."""
    position_m = np.array([[3.0, 0.0, -2.0], [3.0, 0.0, -1.0]])
    level = np.array([[1.0, 0.0, 0.0, 0.0], [np.cos(0.3), 0.0, 0.0, np.sin(0.3)]])
    for azimuth_rad in (np.pi / 2, -np.pi / 2):  # the light comes across the lane
        layout = replace(sample_layout(3), sun_azimuth_rad=azimuth_rad)
        view = ChaseView("lane", layout, position_m, level, (256, 144))
        for number, height_m in enumerate((2.0, 1.0)):
            view(number)
            north, west, _ = view._data.mocap_pos[0]
            assert north == pytest.approx(3.0)
            np.testing.assert_allclose(view._data.mocap_quat[0], view._data.qpos[3:7], atol=1e-12)
            assert -west == pytest.approx(height_m * np.sign(np.sin(azimuth_rad)) / np.tan(SUN_ELEVATION_RAD))
        view.close()


@needs_opengl
def test_a_dark_lane_is_seen_in_daylight_and_a_scenery_as_it_is() -> None:
    at, seen = (np.array([[3.0, 0.0, -2.0]]), np.array([[1.0, 0.0, 0.0, 0.0]])), []
    lane = sample_layout(3)
    for layout in (lane, replace(lane, light=0.1, scenery="forest")):
        view = ChaseView("lane", layout, *at, (64, 36))
        seen.append(view(0).astype(int))
        view.close()
    plain, forest = seen
    assert (np.abs(forest - plain) > 20).mean() > 0.1
    assert forest.mean() > 0.5 * plain.mean()


@needs_opengl
@pytest.mark.parametrize("scene", ["blocks", "clutter"])
def test_other_scenes_are_seen_from_behind_with_their_goals(scene: str) -> None:
    """Its sphere is where it says, ahead and to the right, and what stands in the clutter is there."""
    world = sample_world(1, Clutter(), (30.0, 0.0, -2.0)) if scene == "clutter" else None
    level = np.array([[1.0, 0.0, 0.0, 0.0]])
    views = [
        ChaseView(scene, layout, np.array([[0.0, 0.0, -2.0]]), level, (256, 144), target_m)
        for layout, target_m in ((world, None), (world, [2.0, 0.8, -2.0]), (None, None))
    ]
    plain, marked, bare = (view(0).astype(int) for view in views)
    assert len(drone(plain.astype(np.uint8))) > 20
    green = marked[..., 1] - np.maximum(marked[..., 0], marked[..., 2])
    _, columns = np.argwhere((green > 20) & (np.abs(marked - plain).sum(axis=2) > 30)).T
    assert np.median(columns) == pytest.approx(128 + 140 * 0.8 / 4.4, abs=12)
    assert (np.abs(bare - plain).sum(axis=2) > 30).any() == (scene == "clutter")
    for view in views:
        view.close()
