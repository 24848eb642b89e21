"""Finished flights as they are watched: of runs from their samples or actions, of scripts from their messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.learning import tiny_config, train_into
from tests.running import configured, fly_into
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UsageError, UserError
from uavaccel.files import read_arrays, to_json, write_arrays
from uavaccel.fly.options import FlightOptions
from uavaccel.fly.runs import fly
from uavaccel.records import RunDirectory
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.evaluation.flights import game_seed
from uavaccel.suites.evaluation.suite import Evaluation
from uavaccel.watch.replay import recorded

SCRIPT = """
import time
import airsim
client = airsim.MultirotorClient()
client.enableApiControl(True)
client.moveByVelocityAsync(2, 0, 0, 3).join()
client.simPause(True)
time.sleep(1.0)
client.simPause(False)
client.moveByVelocityZAsync(0, 2, -12, 3).join()
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `fly --clock 10 --out` keeps."""
    folder = tmp_path_factory.mktemp("script")
    (folder / "script.py").write_text(SCRIPT)
    options = FlightOptions(folder / "script.py", (), folder / "flight", clock_speed=10.0, scratch=folder)
    assert fly(options, quiet=True).status == 0
    return folder / "flight"


@pytest.fixture(scope="module")
def lanes(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    out = tmp_path_factory.mktemp("lanes") / "run"
    return fly_into(
        out, Evaluation(), configured("evaluate", "task.observation=state", agent="straight", games=3)
    )


def test_a_scripts_flight_has_both_clocks_and_its_commands(script: Path) -> None:
    replay = recorded(script)
    track, kept = replay.track, read_arrays(script / "trajectory.npz")
    assert replay.scene == "blocks"
    assert track.position_m.tobytes() == kept["position_m"].tobytes()
    assert track.clock_speed == 10.0
    assert track.velocities == [(2, 0, 0), (0, 2, 0.0)]
    np.testing.assert_allclose(track.command_end_s[:2] - track.command_start_s[:2], 3.0, atol=0.05)
    paused_s = float(np.interp(track.command_end_s[0], track.marks[:, 1], track.marks[:, 0]))
    before, after = (track.simulated_s(paused_s + wall_s) for wall_s in (0.1, 0.9))
    assert after - before < 0.02  # the clock stood while the script slept; 8 s at ClockSpeed 10
    assert track.simulated_s(track.wall_s) == pytest.approx(kept["time_ns"][-1] / 1e9)


def test_a_script_that_flew_nothing_has_no_path(tmp_path: Path, script: Path) -> None:
    for name in ("flight.json", "messages.jsonl"):
        (tmp_path / name).write_bytes((script / name).read_bytes())
    kept = read_arrays(script / "trajectory.npz")
    write_arrays(tmp_path / "trajectory.npz", {name: array[:1] for name, array in kept.items()})
    with pytest.raises(UserError, match=r"trajectory.npz: has no path"):
        recorded(tmp_path)
    for damage in ({"position_m": kept["position_m"]}, {**kept, "time_ns": kept["time_ns"][1:]}):
        write_arrays(tmp_path / "trajectory.npz", damage)
        with pytest.raises(UserError, match=r"trajectory.npz: is no trajectory: needs time_ns, position_m"):
            recorded(tmp_path)
    write_arrays(tmp_path / "trajectory.npz", kept)
    (tmp_path / "messages.jsonl").write_text("")  # a script that only looked on
    assert recorded(tmp_path).track.velocities == []
    (tmp_path / "flight.json").write_text("[]")
    with pytest.raises(UserError, match=r"flight.json: is no summary of a flight"):
        recorded(tmp_path)
    (tmp_path / "flight.json").unlink()
    with pytest.raises(UserError, match=r"flight.json: is missing or damaged"):
        recorded(tmp_path)


def test_an_evaluations_game_is_flown_again_from_its_actions(lanes: RunDirectory) -> None:
    row = lanes.rows()[1]
    replay = recorded(lanes.path, game=1)
    config = configured("evaluate", "task.observation=state", agent="straight", games=3)
    environment = ObstacleLane(**config.task.model_dump(mode="json"))
    _, info = environment.reset(seed=game_seed(config, 1), options={"lane": 1})
    for action in row["actions"]:
        environment.charge(config.inference_s)
        info = environment.step(action)[-1]
    samples = environment.recording().arrays()
    environment.close()
    assert replay.track.position_m.tobytes() == samples["position_m"].tobytes()
    assert abs(replay.track.position_m[-1, 0] - info["position_m"][0]) < 0.2
    assert len(replay.track.command_start_s) == len(row["actions"]) == len(replay.track.velocities)
    assert replay.scene == "lane"
    assert replay.lane is not None
    assert row["case"] in replay.title
    hit = f"hit {row['collision']}" if row["collision"] else "did not arrive"
    assert replay.title.endswith(f"; it {'reached the end' if row['is_success'] else hit}.")
    assert (
        recorded(lanes.path, case=row["case"]).track.position_m.tobytes() == samples["position_m"].tobytes()
    )


def test_an_evaluation_whose_row_does_not_repeat_is_not_shown(lanes: RunDirectory, tmp_path: Path) -> None:
    copied = tmp_path / "run"
    copied.mkdir()
    for name in ("config.yaml", "manifest.json"):
        (copied / name).write_bytes((lanes.path / name).read_bytes())
    row = {**lanes.rows()[0], "wall_s": 1.0}
    (copied / "rows.jsonl").write_text(to_json(row) + "\n")
    with pytest.raises(UserError, match="flown again it differs in wall_s"):
        recorded(copied)
    config = (copied / "config.yaml").read_text().replace("timing: virtual", "timing: wall")
    (copied / "config.yaml").write_text(config)
    with pytest.raises(UserError, match=r"timing = 'wall' never repeats.*--timing virtual or lockstep"):
        recorded(copied)


def test_a_game_of_dp1_has_its_commands(tmp_path: Path) -> None:
    keys = ("rounds=[1]", "t_move_s=[0.5]", "reference_games=1")
    run = fly_into(tmp_path / "run", Dp1(), configured("dp1", *keys, clock_speed=[1.0, 50.0], games=1))
    rows = run.rows()
    replay = recorded(run.path)
    assert replay.track.clock_speed == 50.0  # the fastest
    for number in (0, len(rows) - 1):
        track = recorded(run.path, game=number).track
        assert track.position_m.tobytes() == run.load_arrays(rows[number])["position_m"].tobytes()
    with pytest.raises(
        UserError, match=rf"--game {len(rows)}: .* has {len(rows)} games, from 0 to {len(rows) - 1}"
    ):
        recorded(run.path, game=len(rows))
    with pytest.raises(UsageError, match="--case, --game"):
        recorded(run.path, rows[0]["case"], 0)


@pytest.mark.parametrize(
    ("time_s", "starts", "ends", "wall_s"),
    [
        ([0.0, 0.33, 0.7, 1.1, 1.5], [0.0, 0.7], [0.66, 1.36], 0.15),
        (
            [0.0, 0.33, 0.5, 0.8, 1.0],
            [0.0, 0.5],
            [0.5, 1.0],
            0.1,
        ),  # the next one, and the flight's end, come before
    ],
)
def test_a_game_of_dp2_has_its_commands_and_its_lane(
    tmp_path: Path, time_s: list[float], starts: list[float], ends: list[float], wall_s: float
) -> None:
    """Two commands of two samples each, after that of the start."""
    config = configured("dp2", "path=[[1, 0], [0, 2]]", "t_move_s=0.66", "t_sample_s=0.33")
    run = RunDirectory.create(tmp_path / "run", config, {})
    arrays = {
        "time_s": np.array(time_s),
        "sample_index": np.arange(5),
        "position_m": np.arange(15.0).reshape(5, 3),
        "orientation_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)),
        "command_velocity_m_s": np.array([[1.0, 0.0], [0.0, 2.0]]),
    }
    row = {"suite": "dp2", "case": "adsc-k10", "role": "game", "command": "adsc", "clock_speed": 10.0}
    run.append_row(row | run.save_arrays("adsc-k10", arrays))
    replay = recorded(run.path)
    assert replay.track.velocities == [(1.0, 0.0, 0.0), (0.0, 2.0, 0.0)]
    assert replay.track.command_start_s.tolist() == starts
    assert replay.track.command_end_s.tolist() == pytest.approx(ends)
    assert (replay.scene, replay.track.wall_s) == ("lane", wall_s)
    assert replay.lane is not None
    np.testing.assert_array_equal(replay.lane.x_m, config.layout().x_m)


def test_what_keeps_no_path_says_what_does(tmp_path: Path, script: Path) -> None:
    train_into(tmp_path / "training", tiny_config())
    with pytest.raises(UserError, match=r"a training keeps no paths.*uavaccel evaluate"):
        recorded(tmp_path / "training")
    with pytest.raises(UserError, match=r"holds neither a run nor a flight.*--out FOLDER"):
        recorded(tmp_path)
    with pytest.raises(UserError, match=rf"has several flights.*{script.name}"):
        recorded(script.parent)
    with pytest.raises(UsageError, match="is the flight of one script"):
        recorded(script, game=0)
