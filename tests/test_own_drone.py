"""Drones of one's own fly as in MuJoCo or are refused; the free body's step is MuJoCo's to the bit."""

from __future__ import annotations

import platform
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from uavaccel import VelocityGoal, open_session, resources, tcsc
from uavaccel.errors import UserError
from uavaccel.sim import flight as goals
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.vehicle import autopilot
from uavaccel.sim.vehicle.autopilot import Yaw
from uavaccel.sim.vehicle.free_body import HUGE, free_step
from uavaccel.sim.vehicle.quadrotor import parameters
from uavaccel.sim.world import FlightError, World

PAGE = Path(__file__).parents[1] / "docs" / "own-drone.md"


@pytest.fixture
def warehouse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of the page's scene, in a copy of the assets."""
    scene = PAGE.read_text(encoding="utf-8").split("```text\n")[1].split("```")[0]
    shutil.copytree(resources.asset("mjcf"), tmp_path / "assets" / "mjcf")
    (tmp_path / "assets" / "mjcf" / "warehouse.xml").write_text(scene)
    monkeypatch.setattr(resources, "_PACKAGE", tmp_path)
    return "warehouse"


def test_a_scene_of_ones_own_is_flown_in_and_touched(warehouse: str) -> None:
    with open_session(timing="lockstep", scene=warehouse) as session:
        client = session.start_game(clock_speed=1.0)
        down = VelocityGoal((0.0, 0.0, 3.0))
        *_, low = tcsc(client, down, t_move_s=2.5, t_sample_s=2.5)
        assert -4.0 < low.position_m[2] < -2.0  # beside the shelf, which is 4 m high
        assert not client.call("simGetCollisionInfo")["has_collided"]
        *_, end = tcsc(client, VelocityGoal((3.0, 0.0, 0.0)), t_move_s=6.0, t_sample_s=6.0)
        touched = client.call("simGetCollisionInfo")
        assert touched["has_collided"]
        assert touched["object_name"] == "shelf"
        assert 11.0 < end.position_m[0] < 11.5  # its near side less the hull's radius
        assert len(np.unique(client.image("gray", (32, 18)))) > 1, "a picture, without any material"


def test_what_is_touched_within_a_margin_is_not_penetrated(warehouse: str) -> None:
    file = resources.asset(f"mjcf/{warehouse}.xml")
    file.write_text(file.read_text().replace('name="shelf"', 'name="shelf" margin="0.5"'))
    with open_session(timing="lockstep", scene=warehouse) as session:
        client = session.start_game(clock_speed=1.0)
        for velocity, seconds in (((0.0, 0.0, 3.0), 2.5), ((3.0, 0.0, 0.0), 6.0)):
            list(tcsc(client, VelocityGoal(velocity), t_move_s=seconds, t_sample_s=seconds))
        touched = client.call("simGetCollisionInfo")
        assert (touched["object_name"], touched["penetration_depth"]) == ("shelf", 0.0)


def test_a_scene_in_which_other_things_move_is_refused(warehouse: str) -> None:
    file = resources.asset(f"mjcf/{warehouse}.xml")
    door = '<body name="door"><joint type="hinge"/><geom size="1" pos="0 9 9"/></body></worldbody>'
    file.write_text(file.read_text().replace("</worldbody>", door))
    with pytest.raises(UserError, match=r'warehouse\.xml: body "door": has joints'):
        World(warehouse, NATIVE)


SHIPPED = '<inertial pos="0 0 0" mass="1" diaginertia="0.0067211874 0.0080406871 0.014278876"/>'
JOINT = '<freejoint name="quadrotor"/>'
FLEX = '<flexcomp name="sail" type="grid" dim="2" count="3 3 1" spacing="1 1 1" pos="5 0 5" rigid="true"/>'
TETHER = (
    '<site name="hook"/></body><site name="peg"/></worldbody><tendon><spatial limited="true" range="0 12">'
    '<site site="peg"/><site site="hook"/></spatial></tendon>'
)


@pytest.fixture
def drone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., World]:
    """Makes the world of a drone whose quadrotor.xml has one text in place of another."""
    shutil.copytree(resources.asset("mjcf"), tmp_path / "assets" / "mjcf")
    file = tmp_path / "assets" / "mjcf" / "quadrotor.xml"
    shipped = file.read_text()
    monkeypatch.setattr(resources, "_PACKAGE", tmp_path)

    def make(new: str, old: str = SHIPPED) -> World:
        assert old in shipped
        file.write_text(shipped.replace(old, new))
        return World("blocks", NATIVE)

    return make


def inertials(count: int) -> Iterator[str]:
    """Random inertials: centres of mass, attitudes, full inertias, and child bodies, each now and then."""
    rng = np.random.default_rng(34)
    for _ in range(count):
        a, b, c = rng.permutation(rng.uniform(0.9, 1.1, 3) * (0.007, 0.008, 0.012))
        mass, products = rng.uniform(0.7, 1.2), rng.normal(size=3) * 3e-4 * rng.integers(0, 2)
        x, y, z = rng.normal(size=3) * 0.03 * (rng.random() < 0.2)
        quat = rng.choice(["", 'quat="0.5 0.5 0.5 0.5"', 'quat="0.9 0.1 0.2 0.3"'], p=[0.6, 0.2, 0.2])
        full = rng.random() < 0.5 and not quat
        moments = f'diaginertia="{a} {b} {c}"'
        if full:
            moments = f'fullinertia="{a} {b} {c} ' + " ".join(map(str, products)) + '"'
        heavy = rng.choice(["", "0", "0.1"], p=[0.6, 0.2, 0.2])
        child = f'<body name="pod"><geom size=".01" pos="0.1 0 0" mass="{heavy}"/></body>' if heavy else ""
        yield f'<inertial pos="{x} {y} {z}" mass="{mass}" {quat} {moments}/>{child}'


def manoeuvre(world: World, fly: Callable[[int], int]) -> NDArray[np.float64]:
    """Fly 3 s of turns; returns the poses, of which the accelerations are those of MuJoCo's last step."""
    poses = []
    for part in range(30):
        roll, pitch = 0.3 * np.sin(part), 0.2 * np.cos(part)
        world.lead.set_goal(goals.attitude(roll, pitch, Yaw(1.0, True), 0.65, autopilot.THROTTLE))
        assert fly(33) == 33
        poses.append(world.lead.qpos.copy())
    return np.array(poses)


def test_a_drone_of_ones_own_flies_as_in_mujoco_or_is_refused(drone: Callable[..., World]) -> None:
    flown, refused = 0, list[str]()
    for inertial in inertials(20):
        try:
            world = drone(inertial)
        except UserError as error:
            refused.append(str(error))
            continue
        flown += 1
        fast = manoeuvre(world, world.lead.fly_free)
        expected = world.lead.state["angular_acceleration"].copy()
        again = drone(inertial)
        np.testing.assert_allclose(fast, manoeuvre(again, again.lead.fly), rtol=0, atol=1e-9)
        again.lead.fly(1)  # MuJoCo's acceleration of the kick that was computed before
        np.testing.assert_allclose(again.lead.gained[3:] * (1, -1, -1), expected, rtol=0, atol=1e-8)
    assert 5 < flown < 15
    assert all('blocks.xml: body "quadrotor": ' in line and "\n" not in line for line in refused)


@pytest.mark.parametrize(("new", "old", "expected"), [
    ("", SHIPPED, "inertial is missing"),
    (SHIPPED.replace("0 0 0", "0.05 0 0"), SHIPPED, 'inertial pos="0.05 0 0"'),
    (SHIPPED.replace("mass", 'quat="0.9 0.1 0.2 0.3" mass'), SHIPPED, "inertial quat or fullinertia"),
    (SHIPPED.replace('"1"', '"0.5"'), SHIPPED, 'mass="0.5": never descends with its rotors: needs 0.56 to 1.5 kg'),
    (SHIPPED.replace('"1"', '"1.6"'), SHIPPED, 'inertial mass="1.6": never climbs'),
    (SHIPPED + '<body name="pod"><geom size=".01"/></body>', SHIPPED, 'child body "pod" has a mass'),
    ('<joint type="free" name="quadrotor" damping="0.1"/>', JOINT, "damping"),
    ('<body name="quadrotor" gravcomp="1"', '<body name="quadrotor"', "gravcomp"),
    ('gravity="0 0 -3.7"', 'gravity="0 0 -9.80665"', 'under gravity="0 0 -9.80665"'),
    ('density="1.2"', 'timestep="0.002"', "a fluid"),
    ('integrator="implicitfast"', 'integrator="Euler"', 'option: integrator must be "Euler"'),
    *(
        (f'<compiler {bound}/>\n  <option', "<option", "boundmass or boundinertia changes")
        for bound in ('settotalmass="1"', 'boundmass="1.1"', 'boundinertia="0.1"')
    ),
    *(
        (f'"Euler"><flag {flag}="disable"/></option>', '"Euler"/>', f'flag {flag}="disable": drones would fly through')
        for flag in ("contact", "constraint", "sensor")
    ),
    (FLEX + "</worldbody>", "</worldbody>", 'flex "sail": drones would fly through it'),
    (TETHER, "</body>\n  </worldbody>", 'tendon: pulls at site "hook"'),
    ('name="touch"', 'name="collision"', 'sensor "collision": is missing'),
    ('data="force"', 'data="found"', 'sensor "collision": is missing or another'),
    ('contype="0" conaffinity="0" type="cylinder"', 'type="cylinder"', "none of its geoms has contacts"),
])  # fmt: skip
def test_what_the_flight_would_ignore_is_refused(
    drone: Callable[..., World], new: str, old: str, expected: str
) -> None:
    with pytest.raises(UserError, match=re.escape(expected)) as raised:
        drone(new, old)
    assert "\n" not in str(raised.value)


# --- the free body ----------------------------------------------------------------------------------------------------


STEPS = 10
SPEEDS = (0.0, 1e-3, 1.0, 5.0)


@njit
def step(parameters_of: NDArray[np.void], *arrays: NDArray[np.float64]) -> bool:
    return free_step(parameters_of[0], *arrays)


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="MuJoCo adds up in another order there")
def test_a_step_has_the_bits_of_mujocos() -> None:
    """Any attitude, speed, spin, place and mass, zeros among them, ten steps on end."""
    world = World("lane", NATIVE)
    model, data = world.model, world.data
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    rng = np.random.default_rng(5)
    for ratio in (1.0, *rng.uniform(0.5, 1.5, 80)):
        world.lead.set_airframe(ratio, 1.0)
        changed, acceleration = np.array([world.lead.parameters]), np.zeros(6)
        data.qpos[:3] = rng.uniform(-100, 100, 3)
        data.qpos[3:] = np.append(rng.normal(), rng.normal(size=3) * rng.integers(0, 2, 3))
        data.qpos[3:] *= rng.choice([0.999, 1.0, 1.0, 1.001]) / np.linalg.norm(data.qpos[3:])
        data.qvel[:] = rng.normal(size=6) * rng.choice(SPEEDS, 6)
        qpos, qvel = data.qpos.copy(), data.qvel.copy()
        for _ in range(STEPS):
            data.qfrc_applied[:] = rng.normal(size=6) * rng.choice([0.0, 0.1, 10.0], 6)
            mujoco.mj_step(model, data)
            assert step(changed, qpos, qvel, data.qfrc_applied.copy(), acceleration)
            for mine, theirs in ((qpos, data.qpos), (qvel, data.qvel), (acceleration, data.qacc)):
                assert mine.tobytes() == theirs.tobytes()


@pytest.mark.parametrize("number", [np.nan, np.inf, -2 * HUGE])
@pytest.mark.parametrize("array", range(3))
def test_what_mujoco_warns_of_is_not_stepped(number: float, array: int) -> None:
    of = parameters(NATIVE.tick_s, 1, 1.0, np.full(3, 0.01))
    arrays = [np.array([0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0]), np.zeros(6), np.zeros(6)]
    arrays[array][2] = number
    before = [each.copy() for each in arrays]
    assert not step(of, *arrays, np.zeros(6))
    np.testing.assert_array_equal(arrays[0], before[0])
    np.testing.assert_array_equal(arrays[1], before[1])


def test_a_flight_that_breaks_down_in_open_air_is_mujocos_to_report() -> None:
    """A gale that only a wrong number can be: the flight says so, as with MuJoCo's own step."""
    world = World("lane", NATIVE)
    world.advance(100)
    assert world.clearance.left_out
    world.lead.state["wind"] = (1e9, 0.0, 0.0)
    with pytest.raises(FlightError, match="mjWARN_BAD"):
        world.advance(50)
