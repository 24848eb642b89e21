"""The benchmark of agents that need time to think: its bytes, its cells one by one, its frozen version."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import yaml

from tests.running import configured, fly_into
from tests.test_realtime_suite import short_rollouts  # noqa: F401 - a fixture
from uavaccel.config import load_yaml
from uavaccel.errors import UserError
from uavaccel.files import to_json
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment, source_tree
from uavaccel.suites.realtime import Evaluation, Realtime
from uavaccel.suites.realtime_report import CELL, RESULTS, results
from uavaccel.suites.session import RunRequest, planned

PENDULUM = "environments={pendulum: {id: InvertedPendulum-v5, train_steps: 2048, scale: [10, 60]}}"
NO_FLIGHTS = "flights={}", PENDULUM
SHORT = (
    "environments.pendulum.train_steps=512",
    "flights.hover.trainings.naive.keys.games=16",
    "flights.hover.trainings.delayed.keys.games=16",
    "agents.delayed.latency_factor=2",
)


def flown(out: Path, *overrides: str, resume: bool = False, jobs: int = 1) -> RunDirectory:
    return fly_into(out, Realtime(), configured("benchmark_smoke", *SHORT, *overrides), resume, jobs)


def bytes_of(run: RunDirectory) -> tuple[str, ...]:
    """Of results and policies; rows are in the order in which they were flown."""
    policies = [hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(run.path.rglob("policy.pt"))]
    return results(Realtime().report(run)), *policies


@pytest.fixture(scope="module")
def smoke(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return flown(tmp_path_factory.mktemp("benchmark") / "smoke")


@pytest.mark.slow
def test_flown_in_parts_interrupted_in_parallel_it_is_the_same(
    smoke: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trainings come with the cells of a part. Then it is interrupted in the midst of a training, whose games have rows
    of their own, and of the evaluations, and ended in parallel.
    """
    alone = flown(tmp_path / "run", "cells=[pendulum-look_ahead-adsc-50ms-5x, hover-delayed-*-1x]")
    names = ["hover-delayed-s0", "pendulum-naive-s0"]
    names += [f"hover-delayed-s0-adsc-{latency}-1x" for latency in ("0ms", "50ms")]
    names.append("pendulum-look_ahead-s0-adsc-50ms-5x")
    rows = {row["case"]: row for row in smoke.rows()}
    assert alone.rows() == [rows[name] for name in names]
    report = Realtime().report(alone)
    lines, whole = results(report).splitlines(), results(Realtime().report(smoke)).splitlines()
    assert len(lines) == 1 + 3
    assert set(lines) <= set(whole)
    assert " · 3 of 32 cells · " in Realtime().source(report)

    append, left = RunDirectory.append_row, [0]

    def interrupted(self: RunDirectory, row: Any, on_disk: bool = True) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        append(self, row, on_disk)

    flew: list[int] = []
    for left[0] in (9, 25):
        with monkeypatch.context() as patch:
            patch.setattr(RunDirectory, "append_row", interrupted)
            with pytest.raises(KeyboardInterrupt):
                flown(tmp_path / "run", resume=True)
        flew.append(len(alone.rows()))
    assert flew[0] == len(names) < len(names) + 6 < flew[1] < len(rows)
    ended = flown(tmp_path / "run", resume=True, jobs=2)
    assert sorted(ended.rows(), key=str) == sorted(smoke.rows(), key=str)
    assert bytes_of(ended) == bytes_of(smoke)
    assert " of 32 cells" not in Realtime().source(Realtime().report(ended))


@pytest.mark.slow
def test_flights_go_on_where_there_is_no_gpu_to_train(smoke: RunDirectory, tmp_path: Path) -> None:
    """Once they are trained; before that it is one line."""
    keys = "flights.hover.trainings.naive.keys.device=cuda"
    with pytest.raises(UserError, match=r"^device = 'cuda': "):
        flown(tmp_path / "new", keys, "cells=[hover-naive-*]")
    there = Path(shutil.copytree(smoke.path, tmp_path / "run"))
    config = load_yaml(there / "config.yaml")
    config["flights"]["hover"]["trainings"]["naive"]["keys"]["device"] = "cuda"
    (there / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    lines = (there / "rows.jsonl").read_text().splitlines(keepends=True)
    (there / "rows.jsonl").write_text("".join(line for line in lines if "hover-naive-s0-adsc-50ms-1x" not in line))
    assert sorted(flown(there, keys, resume=True).rows(), key=str) == sorted(smoke.rows(), key=str)


@pytest.mark.slow
def test_scores_and_hashes_are_in_the_results(smoke: RunDirectory) -> None:
    """Of a flight the score is the share of won games; elsewhere 0 and 1 are the returns that the file says."""
    Realtime().report(smoke).write()
    table = pd.read_csv(smoke.path / "results.csv").set_index(["environment", "agent", "latency_s", "clock_speed"])
    rows = {row["case"]: row for row in smoke.rows()}
    pendulum, hover = table.loc["pendulum", "naive", 0.05, 5], table.loc["hover", "naive", 0.05, 1]
    returns = rows["pendulum-naive-s0-adsc-50ms-5x"]["returns"]
    assert pendulum.score_mean == pytest.approx((sum(returns) / 2 - 5) / 995, rel=1e-5)
    won = rows["hover-naive-s0-adsc-50ms-1x"]["returns"]
    assert (len(won), set(won) - {0.0, 1.0}) == (4, set())
    assert hover.score_mean == hover.return_mean == sum(won) / 4
    assert rows["hover-delayed-s0-adsc-50ms-5x"]["delays_s"] == [0.5] * 4, "it thinks twice as long"
    ahead = table.loc["pendulum", "look_ahead", 0.05, 5].policies
    assert ahead == pendulum.policies == rows["pendulum-naive-s0"]["agent_sha256"][:12]


def test_version_1_is_frozen() -> None:
    """A change of what is flown, here or in the trainings that it names, is another version with a file of its own."""
    names = ("benchmark_v1", "navigate_ppo", "train_kernels", "hover_ppo", "evaluate")
    said = {name: load_yaml(experiment(f"{name}.yaml")) for name in names}
    flights = said["benchmark_v1"]["flights"].values()
    parts = [part for flight in flights for part in (*flight["trainings"].values(), flight["evaluation"])]
    assert {part["experiment"] for part in parts} == set(names[1:])
    assert hashlib.sha256(to_json(said).encode()).hexdigest()[:16] == "c607a07082c7a991"


def test_the_published_cells_are_of_version_1() -> None:
    """Each with all of its trainings and a score, in the order of results.csv, so that runs can be compared by diff."""
    config = configured("benchmark_v1")
    cells = {case.cell for case in Realtime().cases(config) if isinstance(case, Evaluation)}
    table = pd.read_csv((source_tree() or Path()) / "docs/tables/benchmark_v1.csv")
    assert list(table.columns) == [*RESULTS, "policies"]
    found = list(table[CELL].itertuples(index=False, name=None))
    assert found == sorted(set(found))
    assert {f"{a}-{b}-{c}-{1e3 * latency_s:g}ms-{speed:g}x" for a, b, c, latency_s, speed in found} <= cells
    assert set(table.seeds) == {config.seeds}
    assert table.score_mean.notna().all()


# --- policies of one's own ------------------------------------------------------------------------


POLICY = "def policy(observation):\n    return [3.0 * observation[1] + 0.5 * observation[3]]\n"


def test_a_policy_of_ones_own_flies_where_it_can(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not trained, and its row has the hash of its file; other environments it does not fly."""
    (tmp_path / "mine.py").write_text(POLICY)
    monkeypatch.chdir(tmp_path)
    environments = "environments={pendulum: {id: InvertedPendulum-v5}, hopper: {id: Hopper-v5}}"
    yaml = tmp_path / "mine.yaml"
    yaml.write_text("suite: realtime\nagents: {mine: {policies: {pendulum: 'mine.py:policy'}}}\n")
    more = (environments, "latency_s=[0, 0.1]", "episodes=2", "command=[adsc]")
    with planned(RunRequest(str(yaml), {}, more, out=tmp_path / "run")) as plan:
        run = plan.begin(lambda line: None)
        plan.fly(run, lambda case, row: None)
    first, *others = run.rows()
    digest = hashlib.sha256(POLICY.encode()).hexdigest()
    assert (first["case"], first["steps"], first["agent_sha256"]) == ("pendulum-mine-s0", 0, digest)
    assert [row["case"] for row in others] == [f"pendulum-mine-s0-adsc-{ms}ms-1x" for ms in (0, 100)]
    assert min(others[0]["returns"]) > max(others[1]["returns"])


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("agents={a: {policies: {pendulum: 'tcp://127.0.0.1:5555'}}}", "no server, whose answers nobody can repeat"),
        ("agents={a: {policies: {pole: p.zip}}}", "agents.a.policies: pole is none of the environments"),
        ("agents={a: {policies: {pendulum: p.zip}}}", "environments.pendulum, agents.a: p.zip"),
        ("environments.pendulum.scale=[3, 3]", r"must rise, not \[3.0, 3.0\]"),
        ("flights={x: {trainings: {b: {experiment: hover_ppo}}}}", "flights.x.trainings: b is none of the agents, "),
        ("flights={x: {trainings: {naive: {experiment: dp1}}}}", "flights.x.trainings.naive: dp1 is of dp1, not of"),
        ("flights={pendulum: {trainings: {naive: {experiment: hover_ppo}}}}", "flights.pendulum: one of the environ"),
        ("cells=[hopper-*]", "cells: none is called hopper-"),
        ("environments={}", "needs at least one of environments or flights"),
    ],
)
def test_what_does_not_fit_is_one_line(override: str, said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        Realtime().check(configured("benchmark_smoke", *NO_FLIGHTS, override))
    assert "\n" not in str(caught.value)


def test_flights_may_be_all_that_is_flown() -> None:
    config = configured("benchmark_smoke", "environments={}")
    assert {case.environment for case in Realtime().cases(config)} == {"hover"}


def test_of_very_many_cells_some_are_named() -> None:
    with pytest.raises(UserError, match=r"none is called hoper-\*; known: navigate-naive.*, \.\.\. \(396 in all\)$"):
        Realtime().check(configured("benchmark_v1", "cells=[hoper-*]"))
