"""Every scene that travels with the package is sound, and so is the lane in a wood."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.scenes import object_names
from uavaccel import open_session
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.resources import asset
from uavaccel.sim.flight import of_velocity
from uavaccel.sim.lane import Difficulty, layout_from, named, sample_layout
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.scene import load_scene, physics_state
from uavaccel.sim.world import World
from uavaccel.units import mujoco_to_ned

SCENES = sorted(path.name for path in asset("mjcf").glob("*.xml"))


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_holds_the_drone_and_steps_without_a_warning(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(asset(f"mjcf/{name}")))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=200)
    assert not data.warning.number.any()
    assert data.time == pytest.approx(200 * model.opt.timestep)
    assert model.body("quadrotor").mass[0] == 1.0
    assert model.camera("front_center").pos.tolist() == [0.46, 0.0, 0.0]
    assert model.sensor("collision").dim[0] == 1
    assert name in asset("mjcf/README.md").read_text(encoding="utf-8"), "with the sources of its numbers"


INCLUDED = '<include file="quadrotor.xml"/>'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where scenes are looked for, with the quadrotor."""
    (tmp_path / "quadrotor.xml").write_bytes(asset("mjcf/quadrotor.xml").read_bytes())
    monkeypatch.setattr("uavaccel.sim.scene.asset", lambda name: tmp_path / Path(name).name)
    monkeypatch.setattr("uavaccel.sim.scene.scene_file", lambda name: tmp_path / f"{name}.xml")
    return tmp_path


@pytest.mark.parametrize(("text", "said"), [
    ("", "empty file"),
    (f"<mujoco>{INCLUDED}", "XML parse error"),
    (f'<mujoco>{INCLUDED}<worldbody><geom type="bax"/></worldbody></mujoco>', "invalid keyword: 'bax'.*line 1"),
    ('<mujoco><include file="nowhere.xml"/></mujoco>', "nowhere.xml"),
    ("<mujoco/>", "has no quadrotor: needs <include"),
    (f'<mujoco>{INCLUDED}<worldbody><geom name="far" size="1" pos="1e300 0 0"/></worldbody></mujoco>', 'geom "far": '),
])  # fmt: skip
@pytest.mark.parametrize("airsim", [False, True])
def test_a_scene_that_cannot_be_flown_is_one_line(folder: Path, text: str, said: str, airsim: bool) -> None:
    (folder / "mine.xml").write_text(text)
    with pytest.raises(UserError, match=rf"^{folder / 'mine.xml'}: .*{said}") as caught:
        load_scene("mine", airsim=airsim)
    assert "\n" not in str(caught.value)


def test_a_name_that_spawned_objects_have_is_refused(folder: Path) -> None:
    """Their geoms stand by without contacts, as one of the scene must not."""
    (folder / "mine.xml").write_text(
        f'<mujoco>{INCLUDED}<worldbody><geom name="spare_car" size="1"/></worldbody></mujoco>'
    )
    assert load_scene("mine").geom("spare_car").contype[0] == 1
    with pytest.raises(UserError, match=r'mine\.xml: geom "spare_car": names with "spare_"'):
        load_scene("mine", airsim=True)


def test_the_ground_for_airsims_clients_reaches_the_horizon(folder: Path) -> None:
    """Stretched 50 times over 200 m, a texture is 5000 times over 20 km; a uniform one counts per metre anyway."""
    plane = """
      <mujoco><include file="quadrotor.xml"/><asset><texture name="t" type="2d" builtin="checker" width="8" height="8"/>
      <material name="stretched" texture="t" texrepeat="50 20"/>
      <material name="uniform" texture="t" texrepeat="2 3" texuniform="true"/></asset><worldbody>
      <geom name="ground" type="plane" size="100 50 1" material="stretched"/>
      <geom name="beside" type="plane" size="100 50 1" material="uniform"/>
      <geom name="endless" type="plane" size="0 0 1"/></worldbody></mujoco>"""
    (folder / "mine.xml").write_text(plane)
    plain, wide = (load_scene("mine", airsim=airsim) for airsim in (False, True))
    for name in ("ground", "beside"):
        assert plain.geom(name).size[:2].tolist() == [100.0, 50.0]
        assert wide.geom(name).size[:2].tolist() == [10_000.0, 5_000.0]
    assert wide.geom("endless").size[:2].tolist() == [0.0, 0.0]
    assert plain.material("stretched").texrepeat.tolist() == [50.0, 20.0]
    assert wide.material("stretched").texrepeat.tolist() == [5_000.0, 2_000.0]
    assert wide.material("uniform").texrepeat.tolist() == [2.0, 3.0]


# --- the lane in a wood -----------------------------------------------------------------------------------------------


PLACES_M = [(0.0, 0.0), (33.0, 1.0), (118.0, -2.0)]
POSTS = [
    {"x_m": 12.0, "y_m": 1.0, "half_side_m": 0.4},
    {"x_m": 20.0, "y_m": -2.0, "half_side_m": 0.1},
    {"x_m": 30.0, "y_m": 0.5, "half_side_m": 2.0},
    {"x_m": 40.0, "y_m": 3.0, "radius_m": 0.7},
]


def pictures(world: World, kind: str) -> NDArray[Any]:
    """Along the lane, 2 m up."""
    camera, seen = world.camera(256, 144), []
    for north, east in PLACES_M:
        world.data.qpos[:3] = north, -east, 2.0
        seen.append(getattr(camera, kind)(world.data))
    return np.stack(seen)


@pytest.mark.opengl
def test_a_wood_changes_the_colours_and_nothing_else() -> None:
    """Depth to the bit, what is segmented by name; and the plain lane looks as it did before."""
    world, seen = World("lane", NATIVE), []
    for scenery in ("plain", "forest", "plain"):
        world.set_lane(sample_layout(3, Difficulty(scenery=scenery)))
        names = [object_names(world.model, picture) for picture in pictures(world, "segmentation")]
        seen.append((pictures(world, "depth"), names, pictures(world, "colour"), pictures(world, "gray")))
    world.close()
    plain, forest, again = seen
    np.testing.assert_array_equal(forest[0], plain[0])
    assert forest[1] == plain[1]
    assert (forest[2] != plain[2]).any(axis=-1).mean() > 0.9
    for kind in (0, 2, 3):
        np.testing.assert_array_equal(again[kind], plain[kind])


@pytest.mark.opengl
def test_it_is_darker_in_less_light() -> None:
    """Below the horizon everything is lit: in proportion."""
    world, seen = World("lane", NATIVE), {}
    for light in (0.4, 0.8):
        world.set_lane(layout_from({"obstacles": POSTS, "light": light, "scenery": "forest"}, "test"))
        seen[light] = pictures(world, "gray")[:, 100:].mean()
    world.close()
    assert seen[0.4] / seen[0.8] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("azimuth_rad", [0.0, 0.9, -0.6])
def test_trunks_stand_where_posts_do_and_shadow_away_from_the_sun(azimuth_rad: float) -> None:
    world = World("lane", NATIVE)
    lane = {"obstacles": POSTS, "scenery": "forest", "sun_azimuth_rad": azimuth_rad}
    world.set_lane(layout_from(lane, "test"))
    model, data = world.model, world.data
    for geom, post in zip(named(model, "trunk_"), POSTS, strict=False):
        first, count = (model.mesh_vertadr[model.geom_dataid[geom]], model.mesh_vertnum[model.geom_dataid[geom]])
        turn = data.geom_xmat[geom].reshape(3, 3)
        points = mujoco_to_ned(model.mesh_vert[first : first + count] @ turn.T + data.geom_xpos[geom])
        points = points - (post["x_m"], post["y_m"], 0.0)
        breast = points[np.abs(points[:, 2] + 0.7) < 0.01]
        radius_m = np.hypot(breast[:, 0], breast[:, 1]) / post.get("half_side_m", post.get("radius_m"))
        least, most = (1.08, 1.42) if "half_side_m" in post else (0.92, 1.08)  # a side's middle, a corner
        assert least < radius_m.min() <= radius_m.max() < most
        assert points[:, 2].min() == pytest.approx(-20.0, abs=0.01)
        tip = points[points[:, 2] > -0.015][:, :2]
        tip = tip[np.hypot(*tip.T) > 10.0].mean(axis=0)
        assert np.arctan2(tip[1], tip[0]) == pytest.approx(azimuth_rad, abs=1e-3)
    assert model.geom_rgba[named(model, "trunk_")[len(POSTS) :], 3].max() == 0.0
    assert not model.geom_contype[named(model, "trunk_")].any()


def test_a_vehicle_hits_the_same_when_the_scenery_changes() -> None:
    flown = []
    for sceneries in (["plain"], ["forest"], ["plain", "forest"], ["forest", "plain"]):
        world = World("lane", NATIVE)
        for scenery in sceneries:  # the second one in the middle of the flight
            world.set_lane(sample_layout(0, Difficulty(scenery=scenery, wind_m_s=2.0)))
            if scenery == sceneries[0]:
                world.reset((0.0, 0.0, -2.0))
                world.lead.set_goal(of_velocity(VelocityGoal((2.0, 0.6, 0.0), -2.0)))
                world.advance(1500)
        world.advance(20_000)
        touched = getattr(world.lead.contact_log.first, "object", "")
        flown.append((touched, world.lead.collision_tick, physics_state(world.model, world.data).tobytes()))
    assert flown[0][0]
    assert all(each == flown[0] for each in flown)


@pytest.mark.opengl
def test_clients_change_the_scenery_and_find_the_same_objects() -> None:
    with open_session(timing="lockstep", scene="lane") as session:
        client, seen = session.start_game(10, lane=1), []
        for difficulty in ({}, {"scenery": "forest"}):
            client.set_lane({"seed": 1, "difficulty": difficulty})
            poses = [client.call("simGetObjectPose", name) for name in ("ground", "obstacle_05")]
            ids = client.call("simGetImage", "0", 5, "", False)
            seen.append((client.call("simListSceneObjects", ".*"), poses, ids, client.image("colour")))
    plain, forest = seen
    assert forest[:3] == plain[:3]
    assert (forest[3] != plain[3]).mean() > 0.9


def test_sceneries_and_lanes_that_there_are_not_are_refused() -> None:
    with pytest.raises(UserError, match=r"difficulty\.scenery.*'plain' or 'forest'"):
        ObstacleLane(difficulty={"scenery": "jungle"})
    with pytest.raises(UserError, match=r"lane.*scenery"):
        layout_from({"obstacles": [], "scenery": "jungle"}, "lane")
    with pytest.raises(UserError, match="scenery = forest: the scene blocks has none of that name"):
        World("blocks", NATIVE).set_lane(sample_layout(0, Difficulty(scenery="forest")))
    with pytest.raises(UserError, match="the scene is no lane"):
        World("blocks", NATIVE).set_lane(layout_from({"obstacles": []}, "lane"))
    own = LaneTask(lane={"obstacles": [], "scenery": "forest"})
    assert own.scenery == own.wire_lane(0)["scenery"] == "forest"
