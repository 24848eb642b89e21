"""What a training tells beside its weights: real time, modelled; its curves in TensorBoard; its latest success."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.learning import tiny_config
from tests.made_runs import STATE, trained, walls, won
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.errors import UserError
from uavaccel.rl.learner import Game
from uavaccel.suites import trainer
from uavaccel.suites.train import Training, curves_figure
from uavaccel.suites.trainer import model_real_time
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import shipped_latency


def test_real_time_has_flight_pictures_decisions_and_learning() -> None:
    """While a TCSC's client decides and learns nothing flies, so that these add up exactly."""
    state = {**STATE, "clock_speed": 50.0}  # as it was trained is not how it is modelled
    keys = {"mirror": False, "inference_s": 0.0, "learning_s": 0.0}
    blind, seen = (model_real_time(tiny_config(task, **keys))["command_s"] for task in (state, {"observation": "dvs"}))
    assert 1.0 < blind < 1.05
    # Three pictures and DVS per command; a picture waits for up to two frames, one on average.
    frame_s = shipped_latency("airsim").platform.frame_ns() / 1e9
    assert 3 * 0.5 * frame_s < seen - blind < 3 * 2 * frame_s
    working = {**keys, "inference_s": 0.25, "learning_s": 2.0, "commands_per_gradient_step": 4}
    assert model_real_time(tiny_config(state, **working))["command_s"] == pytest.approx(blind + 0.25 + 0.5)
    on_policy = {**working, "algorithm": "sb3_ppo", "options": {}}
    assert model_real_time(tiny_config(state, **on_policy))["command_s"] == pytest.approx(blind + 0.25)


def test_real_time_is_modelled_with_the_trainings_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty commands straight ahead in an empty lane; all else is AirSim's: its profile, ClockSpeed and latencies."""
    made: list[Any] = []

    class Lane:
        def __init__(self, **keys: Any) -> None:
            self.task, self.commands = LaneTask(**keys), 0
            self.charge = lambda seconds, phase: made.append((phase, seconds))
            self.close = lambda: made.append("closed")
            made.append(keys)

        def reset(self, seed: int) -> Any:
            return None, {"commands": 0}

        def step(self, action: int) -> Any:
            made.append(action)
            self.commands += 1
            return None, 0.0, False, False, {"commands": self.commands, "wall_s": 1.0 + 3.0 * self.commands}

    monkeypatch.setattr(trainer, "ObstacleLane", Lane)
    own: dict[str, Any] = {
        "command": "adsc", "observation": "depth", "history": 2, "image_processing_s": 0.01, "t_move_s": 0.8,
        "t_sample_s": 0.2, "speed_m_s": 1.5, "headings_deg": [-40.0, -20.0, 5.0, 30.0], "altitude_m": 3.0,
    }  # fmt: skip
    elsewhere = {"clock_speed": 50.0, "timing": "lockstep", "profile": "native", "difficulty": {"wind_m_s": 3.0}}
    config = tiny_config(own | elsewhere, mirror=False, inference_s=0.25, learning_s=2.0)
    assert model_real_time(config)["command_s"] == 61.0 / 20
    assert made[0] == own | {"timing": "virtual", "profile": "airsim", "clock_speed": 1.0, "lane": {"obstacles": []}}
    assert made[1:] == [*[("inference", 0.25), ("learning", 2.0 / 4), 2] * 20, "closed"]


def test_a_training_tells_its_latest_success(tmp_path: Path) -> None:
    rows = won(*[True] * 150, *[False] * 75, *[True] * 25)
    assert Training().status(rows) == "success of the last 100: 25%"
    assert Training().status(rows[148:152]) == "success of the last 4: 50%"
    report = trained(tmp_path / "run", [{"disturbed": True}, {}], timing="wall")
    assert report.summary["disturbed_games"] == 1
    assert report.pace() == ""


def test_wall_times_that_are_missing_are_one_line(tmp_path: Path) -> None:
    for times in ([], [*walls(1), {}]):
        report = trained(tmp_path / f"lacks{len(times)}", won(True, True), times)
        with pytest.raises(UserError, match=r"timing\.jsonl: lacks the wall time of a game"):
            curves_figure("wall clock", [report])


def test_curves_count_from_this_start_without_evaluations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Success of the last 100, an earlier start's among them; simulated over wall time of this start's.

    They are what TensorBoard reads.
    """
    # It is made; a game ends; an evaluation is flown from 110 to 115 s; another game ends.
    now_s = iter([100.0, 104.0, 110.0, 115.0, 120.0])
    monkeypatch.setattr(trainer, "MonotonicClock", lambda: SimpleNamespace(now_ns=lambda: int(next(now_s) * NS_PER_S)))
    monkeypatch.setattr("uavaccel.suites.event_file.epoch_s", lambda: 1_234.5)
    earlier = won(*[False] * 50, *[True] * 3, *[False] * 90, *[True] * 7)  # of the last 100 ten
    rows = trainer.GameRows(tiny_config({"t_move_s": 0.5}), tmp_path, earlier)
    info: dict[str, Any] = {
        "is_success": False, "distance_m": 7.0, "collision": None, "lane": 3, "commands": 16,
        "phase_s": {}, "host_phase_s": {},
    }  # fmt: skip
    (first,) = rows.finished([Game(40, 1, info, -2.5, 0.25)], {})
    with rows.clock_stopped():
        pass
    rows.finished([Game(41, 0, info, 1.0, None, 0.5, 2.0)], {})
    rows.close()
    assert (first.row["sim_time_s"], first.host["wall_s"]) == (8.0, 4.0)
    read = EventAccumulator(str(tmp_path / "tensorboard"))
    read.Reload()
    drawn = {name: [(scalar.step, scalar.value) for scalar in read.Scalars(name)] for name in read.Tags()["scalars"]}
    assert {scalar.wall_time for scalar in read.Scalars("games/loss")} == {1_234.5}
    expected = {
        "success_recent": [(41, 0.09), (42, 0.08)],
        "distance_m": [(41, 7.0), (42, 7.0)],
        "return": [(41, -2.5), (42, 1.0)],
        "commands": [(41, 16.0), (42, 16.0)],
        "exploration": [(41, 0.25)],
        "loss": [(42, 0.5)],
        "mean_q": [(42, 2.0)],
        "real_time_factor": [(41, 8.0 / 4.0), (42, 16.0 / 15.0)],
    }
    assert {name.removeprefix("games/"): each for name, each in drawn.items()} == {
        name: [(step, pytest.approx(value)) for step, value in each] for name, each in expected.items()
    }
