"""Every scene that travels with the package is sound."""

from __future__ import annotations

import mujoco
import pytest

from uavaccel.resources import asset

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


def test_the_scenes_numbers_have_their_sources() -> None:
    readme = asset("mjcf/README.md").read_text(encoding="utf-8")
    assert all(name in readme for name in SCENES)
