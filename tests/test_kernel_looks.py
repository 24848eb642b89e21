"""Pictures by arithmetic against pictures by OpenGL: the same lanes, the same poses, and what an event camera sees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.compiling import Alone, kept
from tests.opengl import needs_opengl
from tests.scenes import Pose, Scene
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UserError
from uavaccel.kernels import cpu as _cpu
from uavaccel.kernels import events
from uavaccel.kernels import fields as at
from uavaccel.kernels.appearance import empty_scenes, fill_scenes, mipmaps, read_appearance
from uavaccel.kernels.faces import project
from uavaccel.kernels.fields import Appearance, Scenes
from uavaccel.kernels.pictures import render_lanes
from uavaccel.kernels.quads import (
    MOST_INTERVALS,
    MOST_PIECES,
    Column,
    add_interval,
    fill_column,
    overtaken,
    quad_lumas,
    quick_count,
    settle,
    update_quad,
)
from uavaccel.kernels.rays import touches
from uavaccel.resources import asset
from uavaccel.sim.camera.camera import Camera, make_cameras_with
from uavaccel.sim.lane import MAX_OBSTACLES, Difficulty, LaneLayout, apply_layout, lane_seed, sample_layout
from uavaccel.units import mujoco_to_ned, ned_to_mujoco, quaternion_mujoco_to_ned, quaternion_ned_to_mujoco
from uavaccel.vision.dvs import PRESETS, DvsParameters, init_state, make_sensor, step
from uavaccel.vision.dvs_kernels import count_single_pixel
from uavaccel.vision.dvs_sensor import sample_pixels

cpu = Alone(_cpu)
Floats = NDArray[np.float64]
View = tuple[LaneLayout, Floats, Floats]  # lane, position, quaternion; NED

# With llvmpipe 0.002 levels apart, 0.015 % of pixels differ (docs/kernels.md), and 0.11 % of the events of ten lanes;
# the bounds leave room for renderers that round elsewhere.
MEAN_LEVELS, SHARE_ABOVE_10 = 0.05, 1e-3
EVENTS_SHARE = 0.005


@pytest.fixture(scope="module")
def appearance() -> Appearance:
    return read_appearance(mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml"))))


@pytest.fixture
def camera(lane_scene: Scene) -> Iterator[Camera]:
    with Camera(lane_scene[0]) as camera:
        yield camera


def drawn_views(count: int, seed: int) -> list[View]:
    """Training and evaluation lanes in all light, posts and cylinders of many sizes, poses all over them."""
    rng, views = np.random.default_rng(seed), []
    for number in range(count):
        lane = lane_seed("training" if number % 2 else "evaluation", int(rng.integers(1000)))
        layout = sample_layout(lane, Difficulty(light=(0.1, 1.0)))
        if number % 4 == 3:
            sizes = rng.uniform(0.2, 0.7, len(layout))
            layout = replace(layout, round=rng.random(len(layout)) < 0.6, half_width_m=sizes)
        low = number % 3 < 2
        place = [rng.uniform(-2, 155), rng.uniform(-4.7, 4.7), -rng.uniform(0.8, 3.0 if low else 25.0)]
        tilt, turn = (15.0, 8.0) if low else (40.0, 180.0)
        roll, pitch, yaw = rng.uniform(-1, 1, 3) * (tilt, tilt, turn)
        views.append((layout, np.array(place), Pose((0.0, 0.0, 0.0), (roll, pitch, yaw)).quaternion()))
    return views


def show(scene: Scene, view: View) -> mujoco.MjData:
    model, data = scene
    layout, place, quaternion = view
    apply_layout(model, data, layout)
    data.qpos[:3], data.qpos[3:7] = ned_to_mujoco(place), quaternion_ned_to_mujoco(quaternion)
    return data


def laid_out(appearance: Appearance, views: list[View]) -> tuple[Appearance, Scenes, NDArray[np.int32], Floats, Floats]:
    """Arguments of the drawing functions: a lane for each view."""
    layouts, places, quaternions = zip(*views, strict=True)
    scenes, lanes = empty_scenes(len(views)), np.arange(len(views), dtype=np.int32)
    fill_scenes(appearance, scenes, lanes.tolist(), layouts)
    return appearance, scenes, lanes, np.array(places), np.array(quaternions)


@needs_opengl
@pytest.mark.parametrize(("kind", "views"), [("gray", 48), ("colour", 16), ("depth", 16)])
def test_pictures_are_those_of_opengl(
    appearance: Appearance, lane_scene: Scene, camera: Camera, kind: Any, views: int
) -> None:
    drawn = drawn_views(views, seed=views + len(kind))
    theirs = np.array([getattr(camera, kind)(show(lane_scene, view)).copy() for view in drawn])
    ours = render_lanes(kind, *laid_out(appearance, drawn))
    if kind == "depth":
        assert np.mean(np.abs(ours / theirs - 1) > 1e-3) <= SHARE_ABOVE_10
        return
    apart = np.abs(theirs.astype(int) - ours)
    assert np.mean(apart) <= MEAN_LEVELS
    assert np.mean(apart > 10) <= SHARE_ABOVE_10
    assert max(np.mean(picture) for picture in apart) <= 10 * MEAN_LEVELS


class Witness(Camera):
    """Keeps the poses and the pictures that somebody is shown."""

    seen: list[tuple[Floats, NDArray[np.uint8]]]

    def gray(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        picture = super().gray(data)
        Witness.seen.append((data.qpos[:7].copy(), picture.copy()))
        return picture


@needs_opengl
@pytest.mark.parametrize("lane", [3, 7])
def test_an_event_camera_sees_a_flight_as_in_opengl(appearance: Appearance, lane: int) -> None:
    Witness.seen = []
    make_cameras_with(Witness)
    with ObstacleLane(split="evaluation", timing="lockstep") as environment:
        environment.reset(seed=0, options={"lane": lane})
        for action in (2, 2, 1, 3, 2, 0, 4, 2):
            environment.step(action)
    poses = np.array([pose for pose, _ in Witness.seen])
    scenes = empty_scenes(1)
    fill_scenes(appearance, scenes, [0], [sample_layout(lane_seed("evaluation", lane))])
    places, quaternions = mujoco_to_ned(poses[:, :3]), quaternion_mujoco_to_ned(poses[:, 3:])
    ours = render_lanes("gray", appearance, scenes, np.zeros(len(poses), np.int32), places, quaternions)
    theirs = np.array([picture for _, picture in Witness.seen])
    assert len(theirs) >= 24
    mine, gl = seen_events(ours), seen_events(theirs)
    assert gl.sum() > 20_000
    assert np.abs(mine - gl).sum() <= EVENTS_SHARE * gl.sum()


def seen_events(pictures: NDArray[np.uint8]) -> NDArray[np.int64]:
    """ON and OFF counts (frames, 2, H, W) of a sensor that sees a picture each third of a second."""
    sensor = make_sensor(PRESETS["clean"], pictures.shape[1:], seed=0)
    state, counts = init_state(sensor, pictures[0]), []
    for number, picture in enumerate(pictures[1:], 1):
        state, on, off = step(sensor, state, picture, 0.33 * number)
        counts.append((on, off))
    return np.array(counts, np.int64)


@needs_opengl
def test_textures_are_those_that_opengl_has(lane_scene: Scene, camera: Camera) -> None:
    from OpenGL import GL

    model = lane_scene[0]
    camera.gray(lane_scene[1])
    for name in ("asphalt", "grass", "concrete", "brick", "bands"):
        texture = model.texture(name)
        data = model.tex_data[texture.adr[0] :][: 3 * texture.width[0] * texture.height[0]]
        for number, level in enumerate(mipmaps(data.reshape(texture.height[0], texture.width[0], 3))):
            GL.glBindTexture(GL.GL_TEXTURE_2D, int(camera._context.texture[texture.id]))
            GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
            drawn = GL.glGetTexImage(GL.GL_TEXTURE_2D, number, GL.GL_RGB, GL.GL_UNSIGNED_BYTE)
            apart = level.ravel().astype(int) - np.frombuffer(drawn, np.uint8)
            assert np.abs(apart).max() <= 1, f"{name}, level {number}"


def test_refuses_what_it_cannot_draw(appearance: Appearance) -> None:
    scenes = empty_scenes(1)
    with pytest.raises(UserError, match=r"^scenery: .*'forest'"):
        fill_scenes(appearance, scenes, [0], [replace(sample_layout(0), scenery="forest")])
    for scene, says in (("blocks", "obstacle lane alone"), ("forest/lane", "geom 'trunk_")):
        with pytest.raises(UserError, match=says):
            read_appearance(mujoco.MjModel.from_xml_path(str(asset(f"mjcf/{scene}.xml"))))
    lane = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    for numbers, wrong, says in (
        (lane.tex_height, lane.tex_height // 2, "^texture .* squares with sides of a power of two$"),
        (lane.tex_nchannel, 4, "^texture .* linear red, green and blue$"),
        (lane.vis.headlight.ambient, 0.1, "headlight"),
    ):
        right, numbers[:] = numbers.copy(), wrong
        with pytest.raises(UserError, match=says):
            read_appearance(lane)
        numbers[:] = right
    lane.geom("wall_east").group = 3
    assert len(read_appearance(lane).fixed) == 2, "the ground and a wall: what is hidden is not drawn, nor the drone"


def test_a_scene_has_room_for_a_lane_of_most_obstacles(appearance: Appearance) -> None:
    scenes, layout = empty_scenes(1), sample_layout(0, Difficulty(obstacles_per_row=4, row_spacing_m=8.6))
    fill_scenes(appearance, scenes, [0], [layout])
    assert scenes.counts.tolist() == [len(layout) + 3] == [MAX_OBSTACLES + 3]


# --- as a GPU's threads draw, column by column and quad by quad ----------------------------------------------------


def room() -> Column:
    intervals, pieces = (MOST_INTERVALS, at.COLUMNS), (MOST_PIECES, at.COLUMNS)
    rows, w = np.zeros(intervals, np.int32), np.zeros((2, *intervals), np.float32)
    return Column(rows, w[0], w[1], np.zeros(pieces, np.int32))


@kept()
def draw(appearance: Any, scenes: Any, lane: Any, place: Any, turn: Any, room: Column, faces: Any, shown: Any) -> Any:
    """The lumas of a picture, with the faces that it has, and which of them each pixel shows (ROWS, COLUMNS)."""
    project(appearance, scenes, lane, place, turn, True, faces)
    picture = np.zeros((at.ROWS, at.COLUMNS), np.uint8)
    for column in range(at.COLUMNS):
        x, count = np.uintp(column), np.int32(0)
        for face in range(1, int(faces[0, at.COUNT])):
            if faces[face, at.NEAREST_W] > 0:
                count = add_interval(faces, np.int32(face), np.int32(column), room, x, count)
        settle(faces[0, at.FAR_W], room, x, count)
        fill_column(room, x, shown, x)
    for row in range(0, at.ROWS, 2):
        for column in range(0, at.COLUMNS, 2):
            a, b = np.int32(shown[row, column]), np.int32(shown[row, column + 1])
            c, d = np.int32(shown[row + 1, column]), np.int32(shown[row + 1, column + 1])
            quad = quad_lumas(
                faces, (a, b, c, d), appearance.texels, appearance.textures, np.int32(row), np.int32(column)
            )
            picture[row, column], picture[row, column + 1] = quad[0], quad[1]
            picture[row + 1, column], picture[row + 1, column + 1] = quad[2], quad[3]
    return picture


@pytest.mark.parametrize("views", [48])
def test_columns_and_quads_are_the_picture_of_faces_that_tiles_touch(appearance: Appearance, views: int) -> None:
    looks, scenes, lanes, places, turns = laid_out(appearance, drawn_views(views, seed=1))
    faces, shown = np.zeros((at.FACES, at.FIELDS), np.float32), np.zeros((at.ROWS, at.COLUMNS), np.int16)
    drawn = np.zeros((views, at.ROWS, at.COLUMNS), np.uint8)
    for view in range(views):
        drawn[view] = draw(looks, scenes, lanes[view], places[view], turns[view], room(), faces, shown)
        for top, left in np.ndindex(3, 4):
            ends = [np.float32(end) for end in (48 * top, 48 * top + 47, 64 * left, 64 * left + 63)]
            seen = set(shown[48 * top : 48 * top + 48, 64 * left : 64 * left + 64].ravel().tolist()) - {0}
            assert all(touches.py_func(faces, np.int32(face), *ends) for face in seen)
    apart = np.abs(drawn.astype(int) - render_lanes("gray", looks, scenes, lanes, places, turns))
    assert np.mean(apart > 0) <= 5e-5


def test_a_face_shows_from_the_first_row_in_which_it_is_nearer() -> None:
    """Also where rounding puts that beyond the last one, in which it is nearer by a bit."""
    random, first_row = np.random.default_rng(0), getattr(overtaken, "py_func", overtaken)
    for _ in range(1000):
        begin, last = sorted(random.choice(144, 2, replace=False))
        between = random.uniform(begin, last)
        crossing, slope = random.choice([begin, between, last]), np.float32(random.normal())
        start, rows = np.nextafter(-slope * np.float32(crossing), np.float32(np.inf)), np.arange(begin, last + 1)
        nearer = rows[start + slope * rows.astype(np.float32) > 0]
        row = first_row(start, slope, np.int32(begin), np.int32(last + 1), np.int32(999))
        wanted = 999 if {begin, last}.isdisjoint(nearer.tolist()) else nearer[0]
        assert row == wanted or (crossing == last and row in nearer), (begin, last, crossing, slope)


def test_counts_without_a_double_division_are_v2es() -> None:
    rng = np.random.default_rng(0)
    base = rng.uniform(0, 5.5, 200_000).astype(np.float32)
    up, down = (np.abs(rng.normal(0.2, 0.05, (2, len(base)))) + 0.01).astype(np.float32)
    whole = rng.integers(-9, 10, len(base)).astype(np.float32)
    for log in (rng.uniform(0, 5.5, len(base)).astype(np.float32), base + whole * np.where(whole > 0, up, down)):
        exact = [count_single_pixel(*each) for each in zip(log, base, up, down, strict=True)]
        quick: NDArray[Any] = np.array([quick_count(*each) for each in zip(log, base, up, down, strict=True)])
        np.testing.assert_array_equal(quick, exact)
        assert np.abs(quick).max() > 5


@kept()
def see_both(levels: Any, camera: Any, sensor: Any, plain: Any, full: Any) -> tuple[int, int]:
    """A picture as quads without noise see it, and as `events.update_pixel` does: ON minus OFF events."""
    quick = slow = 0
    none, zero = full[0:0], (np.float32(0.0), np.float32(0.0))
    for row in range(0, at.ROWS, 2):
        for column in range(0, at.COLUMNS, 2):
            place = np.uintp(row * at.COLUMNS + column)
            shown, before = (levels[row : row + 2, column : column + 2], plain[0, row : row + 2, column : column + 2])
            lumas = (shown[0, 0], shown[0, 1], shown[1, 0], shown[1, 1])
            known = (before[0, 0], before[0, 1], before[1, 0], before[1, 1])
            quick += update_quad(lumas, known, camera, sensor, plain, place, place)
            for part in range(4):
                y, x = row + part // 2, column + part % 2
                slow += events.update_pixel(levels[y, x], camera, sensor, full, none, zero, y, x, (0, 0.0, 0.1), ())
    return quick, slow


@pytest.mark.parametrize(("sigma", "negative"), [(0.0, 0.2), (0.0, 0.004), (0.05, 0.2), (0.05, 0.3)])
def test_quads_without_noise_see_what_pixels_see(sigma: float, negative: float) -> None:
    rng, shape = np.random.default_rng(0), (at.ROWS, at.COLUMNS)
    parameters = replace(PRESETS["clean"], threshold_sigma=sigma, negative_threshold=negative)
    sensor, row = events.sensor_of(sample_pixels(parameters, shape, 3)), events.camera_row(parameters, 0.0)
    full = sensor.logs[rng.integers(0, 256, shape)]
    plain = full[None].copy()
    for _ in range(3):
        quick, slow = see_both(rng.integers(0, 256, shape), tuple(row), sensor, plain, full)
        assert quick == slow != 0
        np.testing.assert_array_equal(plain[0], full)


NOISES: dict[str, dict[str, float]] = {
    "plain": {},
    "leak": {"leak_rate_hz": 40.0, "leak_jitter_fraction": 0.1, "leak_rate_spread_decades": 0.1, "hot_share": 0.1},
    "shots": {"shot_noise_rate_hz": 300.0},
    "filter": {"cutoff_hz": 60.0, "leak_rate_hz": 9.0, "shot_noise_rate_hz": 9.0},
}


@kept(error_model="numpy")
def see_twice(lane: int, levels: Any, time_s: float, pixels: Any, sensor: Any, camera: Any, seed: int) -> None:
    """As `cpu.see`, pixel by pixel: they count before they see, as a GPU's threads do."""
    columns, most = levels.shape[1], np.ones(lane + 1, np.int32)
    base, filtered = pixels.base[lane], pixels.filtered.reshape(-1, columns)
    for counting in (1, 0):
        rest = events.Rest(pixels.last_s, most, counting)
        for block in range(levels.size // 4):
            normals, draws = events.block_draws(camera, seed, pixels.clock[lane] + 1, block)
            for number in range(4):
                y, x = divmod(4 * block + number, columns)
                draw, moment = (normals[number], draws[number]), (lane, pixels.time_s[lane], time_s)
                pixels.gathered[lane, y, x] += events.update_pixel(
                    levels[y, x], camera, sensor, base, filtered, draw, y, x, moment, rest
                )
    pixels.clock[lane] += 1
    pixels.time_s[lane] = time_s


@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES)
@pytest.mark.parametrize("refractory_s", [0.0001, 0.0005, 0.01])
def test_pixels_rest_as_v2es_do(refractory_s: float, noise: dict[str, float]) -> None:
    """Frames come 1 to 20 ms after one another, and a pixel has up to several tens of events in one."""
    rng, shape, seed, now_ns, rests = np.random.default_rng(1), (24, 32), 5, 0, 0
    parameters = DvsParameters(threshold_sigma=0.05, refractory_s=refractory_s, **noise)
    sensor, row = events.sensor_of(sample_pixels(parameters, shape, 3)), events.camera_row(parameters)
    seen = {see: events.pixels_of(1, parameters, shape, shape) for see in (cpu.see, see_twice)}
    levels, v2es = rng.integers(0, 256, shape, np.uint8), make_sensor(parameters, shape, 3)
    restless = v2es._replace(parameters=replace(parameters, refractory_s=0.0))
    state = init_state(v2es, levels, noise_seed=seed)
    for pixels in seen.values():
        cpu.start(0, levels, pixels, sensor, row)
    for _ in range(40):
        now_ns += int(rng.choice([1, 2, 7, 20])) * 1_000_000
        levels = np.where(rng.random(shape) < 0.4, rng.integers(0, 256, shape, np.uint8), levels)
        before, time_s = state, now_ns * events.NS
        state, on, off = step(v2es, before, levels, time_s)
        for see, pixels in seen.items():
            pixels.gathered[:] = 0
            see(0, levels, time_s, pixels, sensor, row, seed)
            np.testing.assert_array_equal(pixels.gathered[0], on - off)
            np.testing.assert_array_equal(pixels.base[0], state.base_log)
            np.testing.assert_array_equal(pixels.last_s[0], state.last_event_s)
            np.testing.assert_array_equal(pixels.filtered, state.filtered_log[None][: len(pixels.filtered)])
        rests += int(np.sum(step(restless, before, levels, time_s)[1:]) - on.sum() - off.sum())
    assert rests > 500
