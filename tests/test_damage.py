"""Damaged trainings and policies: one line that names the file and says what to do, and no number from them."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch as th

from tests.learning import tiny_config, train_into
from tests.running import configured
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.learner import find_checkpoint
from uavaccel.rl.policy import MANIFEST, WEIGHTS, load_policy, trained_with
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.train import CHECKPOINTS, TrainConfig

pytestmark = pytest.mark.usefixtures("trainings_here")

STATE: dict[str, Any] = {"observation": "state"}


def config(games: int = 5) -> TrainConfig:
    return tiny_config(STATE, mirror=False, games=games)


@pytest.fixture(scope="module")
def trained(trainings_here: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training of three games, its checkpoint at two."""
    folder = tmp_path_factory.mktemp("trained") / "run"
    train_into(folder, config(3))
    return folder


@pytest.fixture
def copy(trained: Path, tmp_path: Path) -> Path:
    shutil.copytree(trained, tmp_path / "run")
    return tmp_path / "run"


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:40])


def other_bytes(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2 :] = b"\x5a" * (len(content) - len(content) // 2)
    path.write_bytes(content)


def empty_json(path: Path) -> None:
    path.write_text("{}")


# --- checkpoints ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "damage"), [
    *(("state.json", damage) for damage in (cut, empty_json)),
    *(("learner.pt", damage) for damage in (cut, other_bytes, Path.unlink)),
    *(("buffer.npz", damage) for damage in (cut, Path.unlink)),
    *(("games.npz", damage) for damage in (cut, other_bytes)),
])  # fmt: skip
def test_a_damaged_checkpoint_is_one_line(copy: Path, name: str, damage: Callable[[Path], None]) -> None:
    checkpoint = find_checkpoint(copy / CHECKPOINTS)
    assert checkpoint is not None
    rows = (copy / "rows.jsonl").read_bytes()
    damage(checkpoint / name)
    with pytest.raises(UserError, match=r"a damaged checkpoint .*delete it and --resume") as caught:
        train_into(copy, config(), resume=True)
    assert "\n" not in str(caught.value)
    assert str(checkpoint) in str(caught.value)
    assert (copy / "rows.jsonl").read_bytes().startswith(rows[: rows.index(b"\n")])
    shutil.rmtree(checkpoint)  # what the line says
    assert RunDirectory(copy).config()["games"] == 5


def test_rows_that_only_the_checkpoint_knows_are_named(copy: Path) -> None:
    rows = copy / "rows.jsonl"
    rows.write_bytes(rows.read_bytes().splitlines(keepends=True)[0])
    with pytest.raises(UserError, match=r"rows\.jsonl: has 1 game, .* knows 2: rows are missing"):
        train_into(copy, config(), resume=True)


# --- policies ---------------------------------------------------------------------------------------------------


def edit_manifest(folder: Path, **keys: Any) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    (folder / MANIFEST).write_text(json.dumps({**manifest, **keys}))


def edit_config(folder: Path, **keys: Any) -> None:
    edit_manifest(folder, config={**json.loads((folder / MANIFEST).read_text())["config"], **keys})


def agree(folder: Path) -> None:
    """Let the manifest agree with the weights that are there."""
    edit_manifest(folder, weights_file_sha256=hashlib.sha256((folder / WEIGHTS).read_bytes()).hexdigest())


def write_weights(folder: Path, weights: Any) -> None:
    th.save(weights, folder / WEIGHTS)
    agree(folder)


class Trap:
    """Makes a file where it is unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.file,)


def weights_by(change: Callable[[th.Tensor], th.Tensor]) -> Callable[[Path], None]:
    """Weights that fit in all but what was done to each tensor."""

    def damage(folder: Path) -> None:
        weights = th.load(folder / WEIGHTS, weights_only=True)
        write_weights(folder, {name: change(tensor) for name, tensor in weights.items()})

    return damage


def cut_and_agreed(folder: Path) -> None:
    cut(folder / WEIGHTS)
    agree(folder)


def emptied_and_agreed(folder: Path) -> None:
    (folder / WEIGHTS).write_bytes(b"")
    agree(folder)


@pytest.mark.parametrize(("damage", "said"), [
    (weights_by(lambda tensor: tensor * float("nan")), r"policy\.pt: .* is not finite: a training that diverged"),
    (lambda folder: cut(folder / WEIGHTS), r"policy\.pt: is not the file that policy\.json describes"),
    (cut_and_agreed, r"policy\.pt: "),
    (lambda folder: (folder / WEIGHTS).unlink(), r"policy\.pt: cannot be read: No such file"),
    (emptied_and_agreed, r"policy\.pt: .* \(EOFError\); train"),
    (lambda folder: (folder / MANIFEST).unlink(), r"/run: holds no policy: no policy\.json in it; name the folder"),
    (lambda folder: shutil.copytree(folder, folder / "parts/seed0") and (folder / MANIFEST).unlink(),
     r"/run: holds no policy itself: name a training in .*/run/parts$"),
    (shutil.rmtree, r"/run: holds no policy: no such folder; name the folder of a training that ended$"),
    (lambda folder: write_weights(folder, [1, 2]), r"policy\.pt: is no state dict of tensors alone"),
    (lambda folder: write_weights(folder, {"trap": Trap(folder / "sprung")}), r"policy\.pt: is no state dict"),
    (lambda folder: write_weights(folder, {0: th.zeros(1)}), r"policy\.pt: is no state dict of tensors alone"),
    (lambda folder: write_weights(folder, {}), r"policy\.pt: does not fit the network"),
    (lambda folder: write_weights(folder, {"q_net.0.weight": th.zeros(1)}), r"policy\.pt: does not fit the network"),
    (weights_by(lambda tensor: tensor.to(th.int64)), r"policy\.pt: .* of torch\.int64; it should be of torch\.float32"),
    (weights_by(lambda tensor: tensor.to(th.complex64)), r"policy\.pt: .* is of torch\.complex64; it should be"),
    (weights_by(lambda tensor: tensor.to(th.float64)), r"policy\.pt: .* is of torch\.float64"),
    (weights_by(lambda tensor: tensor.to_sparse()), r"policy\.pt: .* is no plain tensor"),
    (weights_by(lambda tensor: tensor.to("meta")), r"policy\.pt: .* is no plain tensor"),
    (lambda folder: edit_manifest(folder, trained=3), r"policy\.json: trained = 3: should be a mapping"),
    (lambda folder: edit_config(folder, options={"tempo": 1}), r"policy\.json: .*unknown key 'tempo'"),
    (lambda folder: edit_config(folder, algorithm="sb3_ppo", options={"tempo": 1}),
     r"policy\.json: options of sb3_ppo: unknown key 'tempo'"),
    (lambda folder: cut(folder / MANIFEST), r"policy\.json: a damaged policy, not JSON"),
    (lambda folder: (folder / MANIFEST).write_text("[" * 100_000), r"policy\.json: a damaged policy, .* too deeply"),
    (lambda folder: (folder / MANIFEST).write_text("[]"), r"policy\.json: describes no policy"),
    (lambda folder: empty_json(folder / MANIFEST), r"policy\.json: describes no policy"),
    (lambda folder: edit_manifest(folder, config={"algorithm": "rl"}), r"algorithm = 'rl' is unknown"),
    (lambda folder: edit_manifest(folder, config={"hidden": "wide"}), r"policy\.json: hidden = 'wide'"),
])  # fmt: skip
def test_a_damaged_policy_is_one_line(copy: Path, damage: Callable[[Path], Any], said: str) -> None:
    assert isinstance(load_policy(copy).config, LearnerConfig)
    config = configured("evaluate", agent=str(copy))
    damage(copy)
    for read in (lambda: Evaluation().provenance(config), lambda: load_policy(copy)):
        with pytest.raises(UserError, match=said) as caught:
            read()
    assert str(caught.value).startswith(f"{copy}")
    assert "\n" not in str(caught.value)
    assert not (copy / "sprung").exists(), "no code runs"
    if "policy\\.json: d" in said or "a damaged" in said:
        assert trained_with(copy) == {}, "and it says nothing about a training"
