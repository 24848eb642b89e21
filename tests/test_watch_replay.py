"""Finished flights as they are watched: of runs from their samples or actions, of scripts from their messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.learning import tiny_config, train_into
from tests.made_runs import line_row
from tests.running import configured, fly_into
from tests.scripts import fly_here
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UsageError, UserError
from uavaccel.files import read_arrays, to_json, write_arrays
from uavaccel.fly.options import FlightOptions
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import make_agent
from uavaccel.suites.evaluate import Evaluation, fly_lane
from uavaccel.watch.replay import recorded

pytestmark = pytest.mark.usefixtures("whole_messages")

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
    (out := folder / "flight").mkdir()
    assert fly_here(FlightOptions(folder / "script.py", (), out, clock_speed=10.0, scratch=folder)) == 0
    return out


@pytest.fixture(scope="module")
def lanes(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    out = tmp_path_factory.mktemp("lanes") / "run"
    return fly_into(out, Evaluation(), configured("evaluate", "task.observation=state", agent="straight", games=3))


def test_a_scripts_flight_has_both_clocks_and_its_commands(script: Path) -> None:
    track, kept = recorded(script), read_arrays(script / "trajectory.npz")
    assert track.flight.scene == "blocks"
    assert track.flight.position_m.tobytes() == kept["position_m"].tobytes()
    assert track.flight.clock_speed == 10.0
    assert track.flight.commands.velocity_m_s.tolist() == [[2, 0, 0], [0, 2, 0]]
    np.testing.assert_allclose(track.end_s[:2] - track.start_s[:2], 3.0, atol=0.05)
    paused_s = float(np.interp(track.end_s[0], track.marks[:, 1], track.marks[:, 0]))
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
    assert not len(recorded(tmp_path).start_s)
    (tmp_path / "flight.json").write_text("[]")
    with pytest.raises(UserError, match=r"flight.json: is no summary of a flight"):
        recorded(tmp_path)
    (tmp_path / "flight.json").unlink()
    with pytest.raises(UserError, match=r"flight.json: .*the flight is not whole"):
        recorded(tmp_path)


def test_an_evaluations_game_is_flown_again_from_its_actions(lanes: RunDirectory) -> None:
    row = lanes.rows()[1]
    track = recorded(lanes.path, game=1)
    config = configured("evaluate", "task.observation=state", agent="straight", games=3)
    environment = ObstacleLane(**config.task.model_dump(mode="json"))
    steps = list(fly_lane(config, environment, make_agent("straight", config.task), 1))
    samples = environment.recording().arrays()
    environment.close()
    for name in ("position_m", "orientation_wxyz"):
        assert getattr(track.flight, name).tobytes() == samples[name].tobytes()
    for seconds, name in ((track.time_s, "time_s"), (track.start_s, "command_start_s"), (track.end_s, "command_end_s")):
        assert seconds.tobytes() == samples[name].tobytes()
    assert abs(track.flight.position_m[-1, 0] - steps[-1].info["position_m"][0]) < 0.2
    assert len(track.flight.commands.velocity_m_s) == len(row["actions"])
    assert track.flight.lane is not None
    named = f"Game `{row['case']}` of `{lanes.path}`: lane 1, TCSC at 1x: hit {row['collision']}."
    assert (track.flight.scene, track.flight.title) == ("lane", named)
    assert recorded(lanes.path, case=row["case"]).flight.position_m.tobytes() == samples["position_m"].tobytes()


def test_an_evaluation_whose_row_does_not_repeat_is_not_shown(lanes: RunDirectory, tmp_path: Path) -> None:
    copied = tmp_path / "run"
    copied.mkdir()
    for name in ("config.yaml", "manifest.json"):
        (copied / name).write_bytes((lanes.path / name).read_bytes())
    row = lanes.rows()[0]
    for changed, said in (
        ({"wall_s": 1.0}, "wall_s"),
        ({"of_another_version": 1}, "of_another_version"),
        ({"actions": row["actions"][:-1]}, "actions"),
        ({"actions": [*row["actions"], 0]}, "actions"),
    ):
        (copied / "rows.jsonl").write_text(to_json({**row, **changed}) + "\n")
        with pytest.raises(UserError, match=f"flown again it differs in {said}[;,]"):
            recorded(copied)
    config = (copied / "config.yaml").read_text().replace("timing: virtual", "timing: wall")
    (copied / "config.yaml").write_text(config)
    with pytest.raises(UserError, match=r"timing = 'wall' never repeats.*--timing virtual or lockstep"):
        recorded(copied)


def test_a_run_shows_its_fastest_game_unless_one_is_named(tmp_path: Path) -> None:
    run = RunDirectory.create(tmp_path / "run", configured("dp1"), {})
    arrays = {
        "time_s": np.array([0.0, 0.5, 1.5]),
        "position_m": np.arange(9.0).reshape(3, 3),
        "orientation_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)),
        "linear_velocity_m_s": np.zeros((3, 3)),
        "angular_velocity_rad_s": np.zeros((3, 3)),
        "command_start_s": np.array([0.0, 0.75]),
        "command_end_s": np.array([0.5, 1.25]),
    }
    for role, clock_speed in (("reference", 100.0), ("game", 1.0), ("game", 50.0)):
        row = line_row(role, "tcsc", clock_speed, 0, 0.0, commands=2)
        run.append_row(row | run.save_arrays(row["case"], arrays))
    track = recorded(run.path)
    assert (track.flight.clock_speed, track.flight.scene, track.flight.lane) == (50.0, "blocks", None)
    assert track.flight.title == f"Game `tcsc-k50-t1-r1-g00` of `{run.path}`: TCSC at 50x."
    assert track.marks.tolist() == [[0.0, 0.0], [1.5 / 50.0, 1.5]]
    assert track.flight.commands.velocity_m_s.tolist() == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    assert [track.command(at) for at in (0.25, 0.6, 1.0, 1.3)] == [0, None, 1, None]
    assert [recorded(run.path, game=number).flight.clock_speed for number in range(3)] == [100.0, 1.0, 50.0]
    with pytest.raises(UserError, match=r"--game 3: .* has 3 games, from 0 to 2"):
        recorded(run.path, game=3)
    with pytest.raises(UsageError, match="--case, --game"):
        recorded(run.path, "tcsc-k50-t1-r1-g00", 0)


def test_a_policy_is_watched_in_an_evaluation_lane(tmp_path: Path) -> None:
    train_into(tmp_path / "training", tiny_config({"max_commands": 4}, games=1))
    flight = recorded(tmp_path / "training", case="lane-000003").flight
    assert flight.title.startswith(f"Game `lane-000003` of `{tmp_path / 'training'}`: lane 3, TCSC at 1x: ")
    assert len(flight.position_m) > 1
    with pytest.raises(UsageError, match="is a policy, which flies a lane"):
        recorded(tmp_path / "training", game=0)


def test_what_keeps_no_path_says_what_does(tmp_path: Path, script: Path) -> None:
    with pytest.raises(UserError, match=r"holds neither a run nor a flight.*--out FOLDER"):
        recorded(tmp_path)
    with pytest.raises(UserError, match=rf"has several flights.*{script.name}"):
        recorded(script.parent)
    with pytest.raises(UsageError, match="is the flight of one script"):
        recorded(script, game=0)
