"""Every scene that travels with the package is sound."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

from uavaccel.errors import UserError
from uavaccel.resources import asset
from uavaccel.sim.scene.model import load_scene

SCENES = sorted(path.name for path in asset("mjcf").glob("*.xml"))


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_steps_without_a_warning(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(asset(f"mjcf/{name}")))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=200)
    assert not data.warning.number.any()
    assert data.time == pytest.approx(200 * model.opt.timestep)


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_holds_the_drone_and_its_camera(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(asset(f"mjcf/{name}")))
    assert model.body("quadrotor").mass[0] == 1.0
    assert model.camera("front_center").pos.tolist() == [0.46, 0.0, 0.0]
    assert model.sensor("collision").dim[0] == 1


INCLUDED = '<include file="quadrotor.xml"/>'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty file"),
        (f"<mujoco>{INCLUDED}", "XML parse error"),
        (f'<mujoco>{INCLUDED}<worldbody><geom type="bax"/></worldbody></mujoco>', "invalid keyword: 'bax'.*line 1"),
        ('<mujoco><include file="nowhere.xml"/></mujoco>', "nowhere.xml"),
        ("<mujoco/>", "has no quadrotor: needs <include"),
    ],
)
@pytest.mark.parametrize("airsim", [False, True])
def test_a_scene_that_cannot_be_flown_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, said: str, airsim: bool
) -> None:
    (tmp_path / "quadrotor.xml").write_bytes(asset("mjcf/quadrotor.xml").read_bytes())
    (tmp_path / "mine.xml").write_text(text)
    monkeypatch.setattr("uavaccel.sim.scene.model.asset", lambda name: tmp_path / Path(name).name)
    with pytest.raises(UserError, match=rf"^{tmp_path / 'mine.xml'}: .*{said}") as caught:
        load_scene("mine", airsim=airsim)
    assert "\n" not in str(caught.value)


def test_for_airsims_clients_the_ground_reaches_the_horizon_in_squares_of_the_same_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stretched 50 times over 200 m, a texture is 5000 times over 20 km; a uniform one counts per metre anyway."""
    plane = """
      <mujoco><include file="quadrotor.xml"/><asset><texture name="t" type="2d" builtin="checker" width="8" height="8"/>
      <material name="stretched" texture="t" texrepeat="50 20"/>
      <material name="uniform" texture="t" texrepeat="2 3" texuniform="true"/></asset><worldbody>
      <geom name="ground" type="plane" size="100 50 1" material="stretched"/>
      <geom name="beside" type="plane" size="100 50 1" material="uniform"/></worldbody></mujoco>"""
    (tmp_path / "quadrotor.xml").write_bytes(asset("mjcf/quadrotor.xml").read_bytes())
    (tmp_path / "mine.xml").write_text(plane)
    monkeypatch.setattr("uavaccel.sim.scene.model.asset", lambda name: tmp_path / Path(name).name)
    plain, wide = (load_scene("mine", airsim=airsim) for airsim in (False, True))
    for name in ("ground", "beside"):
        assert plain.geom(name).size[:2].tolist() == [100.0, 50.0]
        assert wide.geom(name).size[:2].tolist() == [10_000.0, 5_000.0]
    assert plain.material("stretched").texrepeat.tolist() == [50.0, 20.0]
    assert wide.material("stretched").texrepeat.tolist() == [5_000.0, 2_000.0]
    assert wide.material("uniform").texrepeat.tolist() == [2.0, 3.0]


def test_the_scenes_numbers_have_their_sources() -> None:
    readme = asset("mjcf/README.md").read_text(encoding="utf-8")
    assert all(name in readme for name in SCENES)
