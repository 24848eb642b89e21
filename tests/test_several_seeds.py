"""A training with several seeds: a run for each that is the one of its seed alone, and numbers over the seeds."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import uavaccel
from tests.drawing import labelled, record_figures
from tests.learning import tiny_config, train_into
from tests.made_runs import run_of, trained
from tests.running import configured, fly_into, run_into
from uavaccel.config import validate
from uavaccel.errors import UsageError, UserError
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Row
from uavaccel.suites.parts import part_run
from uavaccel.suites.seeds import Seeds, SeedsConfig
from uavaccel.suites.session import RunRequest, configure, planned
from uavaccel.suites.train import TrainConfig, Training

pytestmark = pytest.mark.usefixtures("whole_messages")

TRAINING = tiny_config({"observation": "state"}, mirror=False)
SAME = ("config.yaml", "rows.jsonl", "summary.json", "policy.pt", "policy.json")


def over(seeds: int, training: TrainConfig = TRAINING, seed: int = 7) -> SeedsConfig:
    plain = {"seed": seed, "seeds": seeds, "training": training.model_dump(mode="json")}
    return validate(SeedsConfig, plain, "test")


def contents(run: Path) -> dict[str, bytes]:
    return {name: (run / name).read_bytes() for name in SAME}


@pytest.mark.slow
@pytest.mark.usefixtures("trainings_here")
def test_a_seeds_run_is_that_of_a_training_with_this_seed_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed in the second training, resumed with a third seed, and later with more games."""
    drawn: dict[str, Figure] = record_figures(monkeypatch)
    run = tmp_path / "run"
    append, rows = RunDirectory.append_row, count(1)

    def append_and_die(*row: Any, **how: Any) -> None:
        append(*row, **how)
        if next(rows) == 8:  # four games of seed 7 and its row; three of seed 8
            raise RuntimeError("killed")

    with monkeypatch.context() as patch:
        patch.setattr(RunDirectory, "append_row", append_and_die)
        with pytest.raises(RuntimeError, match="killed"):
            fly_into(run, Seeds(), over(2))
    assert [len(RunDirectory(path).rows()) for path in (run, run / "parts/seed7", run / "parts/seed8")] == [1, 4, 3]
    run_into(run, Seeds(), over(3), resume=True)
    for seed in (7, 8, 9):
        train_into(tmp_path / f"alone{seed}", TRAINING.model_copy(update={"seed": seed}))
        assert contents(run / f"parts/seed{seed}") == contents(tmp_path / f"alone{seed}")
    for name in ("learning_games", "learning_curve"):
        success, of_return, _ = drawn[name].axes
        assert any("mean, least and most" in label for label in labelled(success))
        assert len(of_return.collections) == 1  # the band
    with pytest.raises(UserError, match=r"training.games = 2: 4 were asked for before"):
        run_into(run, Seeds(), over(3, TRAINING.model_copy(update={"games": 2})), resume=True)
    longer = TRAINING.model_copy(update={"games": 6})
    assert run_into(run, Seeds(), over(3, longer), resume=True)["training_games"] == 6
    assert [len(part_run(RunDirectory(run), f"seed{seed}").rows()) for seed in (7, 8, 9)] == [6, 6, 6]
    (run / "parts/seed8/timing.jsonl").unlink()
    drawn.clear()
    assert [*Seeds().page(Seeds().report(RunDirectory(run)))]
    assert [*drawn] == ["learning_games"], "not those alone of which the time is known"


def test_a_row_is_of_the_end_of_its_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    won = np.random.default_rng(0).integers(2, size=130)
    games = [{"is_success": bool(one), "return": one - 0.5, "commands": 5 + one} for one in won.tolist()]
    flown = [{"games": n, "lanes": [1, 2], "successes": successes} for n, successes in ((60, 2), (130, 1))]
    report = trained(tmp_path / "part", games, evaluations=flown, games=130)
    monkeypatch.setattr("uavaccel.suites.seeds.fly_part", lambda *_: report)
    row = Seeds().fly(over(1), next(Seeds().cases(over(1))), report.run).row
    assert (row["games"], row["successes"], row["sim_time_s"]) == (130, won.sum(), 910.0)
    assert (row["evaluation"], row["won"]) == ({"lanes": 2, "successes": 1}, [True, False])
    recent = np.array([row["success_recent"], row["return_recent"] + 0.5, row["commands_recent"] - 5])
    np.testing.assert_allclose(recent, won[-100:].mean())


def test_an_interval_of_evaluations_covers_the_lanes(tmp_path: Path) -> None:
    """Ten lanes that all policies win or lose alike are ten samples, and not 200."""
    shared = {"games": 4, "successes": 2, "sim_time_s": 9.0, "weights_sha256": "a", "success_recent": 0.5}
    shared |= {"return_recent": 1.0, "commands_recent": 2.0, "evaluation": {"lanes": 10, "successes": 5}}
    widths = []
    for name, won in (("by_lane", {"won": [True, False] * 5}), ("counts", {})):
        rows: list[Row] = [{"case": f"seed{seed}", "seed": seed, **shared, **won} for seed in range(20)]
        summary = run_of(tmp_path / name, Seeds(), over(20, seed=0), rows).summary
        found = summary["over_seeds"]["evaluation_success"]
        widths.append((found["mean"] - found["low"], found["high"] - found["mean"]))
        assert "won" not in summary["trainings"][0]
        recent = summary["over_seeds"]["success_recent"]  # of twenty trainings of four games, not of a hundred
        assert (recent["low"], recent["high"]) == pytest.approx(Proportion(40, 80).interval)
    assert widths[0] == pytest.approx([1.96 * (0.25 / 9) ** 0.5] * 2, rel=1e-4)
    assert widths[1] == pytest.approx([0.0688] * 2, abs=1e-3)


def test_an_option_makes_a_training_one_over_seeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its other options and keys are the training's, on the way there as when it goes on."""
    config = configured("train", "task.speed_m_s=2", seeds=3, seed=5, games=4)
    assert (config.suite, config.seed, config.seeds) == ("seeds", 5, 3)
    assert config.training == configured("train", "task.speed_m_s=2", seed=5, games=4)
    assert Seeds().provenance(config) == Training().provenance(config.training) != {}
    (tmp_path / "own.yaml").write_text("suite: seeds\nseeds: 3\ntraining: {algorithm: sb3_sac}\n")
    with pytest.raises(UserError, match="algorithm = 'sb3_sac' is unknown"):
        configured(str(tmp_path / "own.yaml"))
    with planned(RunRequest("train", {"seeds": 3, "games": 4}, out=tmp_path / "run")) as plan:
        assert next(plan.lines()).startswith("12 games in 3 trainings (3 lockstep: modelled), 2,340 simulated s")
        RunDirectory.create(plan.out, plan.config, {})
    more = {"seeds": 4, "games": 6, "clock_speed": 1.0}
    asked = [RunRequest(None, more, out=tmp_path / "run", resume=True, suite="train")]
    monkeypatch.setattr("uavaccel.api._flown", asked.append)
    uavaccel.train(out=tmp_path / "run", resume=True, seeds=4, games=6)
    for request in asked:
        again = configure(request)[1]
        assert (again.seeds, again.training.games) == (4, 6)
    for key in ("task.max_commands", "training.task.max_commands"):
        with planned(RunRequest(None, {}, [f"{key}=300"], out=tmp_path / "run", resume=True, suite="train")) as plan:
            assert plan.config.model_dump() == validate(SeedsConfig, RunDirectory(plan.out).config(), "").model_dump()
        other = RunRequest(None, {}, [f"{key}=9"], out=tmp_path / "run", resume=True, suite="train")
        with (
            pytest.raises(UserError, match=r"other configuration: training.task.max_commands \(300 th"),
            planned(other),
        ):
            raise AssertionError("there is no plan for it")
    (tmp_path / "run/parts/seed5").mkdir(parents=True)  # whose training was killed early
    longer = RunRequest(None, {"games": 6}, out=tmp_path / "run", resume=True)
    with pytest.raises(UserError, match=r"training.games = 6: 4 .* no checkpoint in .*seed5"), planned(longer):
        raise AssertionError("there is no plan for it")
    with pytest.raises(UsageError, match="is of seeds, not of evaluate; take `uavaccel train`"):
        configure(RunRequest(None, out=tmp_path / "run", resume=True, suite="evaluate"))
    own = over(3, TRAINING.model_copy(update={"seed": 1}))  # of a YAML file, where the trainings' seeds go from 7
    RunDirectory.create(tmp_path / "own", own, {})
    assert configure(RunRequest(None, out=tmp_path / "own", resume=True, suite="train"))[1] == own


def test_fewer_games_than_before_are_refused_at_once(tmp_path: Path) -> None:
    RunDirectory.create(tmp_path / "run", TRAINING, {})
    (tmp_path / "run/checkpoints/0000004").mkdir(parents=True)
    for file in ("learner.pt", "state.json"):
        (tmp_path / "run/checkpoints/0000004" / file).touch()
    fewer = RunRequest(None, {"games": 2}, out=tmp_path / "run", resume=True)
    with pytest.raises(UserError, match="games = 2: 4 were asked for before") as refused, planned(fewer):
        raise AssertionError("there is no plan for it")
    assert "\n" not in str(refused.value)
