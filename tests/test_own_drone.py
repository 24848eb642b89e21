"""The scene that docs/own-drone.md shows: put among the assets it is found by its name, flown in and touched."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from uavaccel import VelocityGoal, open_session, resources, tcsc

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
