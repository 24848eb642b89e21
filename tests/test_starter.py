"""The folder that `uavaccel init` writes: its training can be flown, its task learned, its schema knows all keys."""

from __future__ import annotations

import json
import re
import runpy
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.golden import assert_as_recorded
from tests.test_document import parse
from uavaccel.cli.machine import SCHEMA, init, schema_text
from uavaccel.config import load_yaml
from uavaccel.errors import UserError
from uavaccel.resources import experiment
from uavaccel.suites.registry import SUITES, find_suite
from uavaccel.suites.runner import run_suite, start_run
from uavaccel.suites.session import RunRequest, configure, reading

pytestmark = pytest.mark.usefixtures("whole_messages")

EXPERIMENTS = [
    path for path in sorted(experiment("dp1.yaml").parent.rglob("*.yaml")) if "\nsuite: " in path.read_text("utf-8")
]


@cache
def schema_of(suite: str) -> dict[str, Any]:
    schema: dict[str, Any] = json.loads(schema_text(suite))
    return schema


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("starter") / "new"
    init(str(made))
    return made


def misfits(value: Any, schema: Any, whole: dict[str, Any], key: str = "") -> list[str]:
    """What the words of JSON schema that the suites' schemas have say against a value."""
    if isinstance(schema, bool):
        return [key] * (not schema)
    if "$ref" in schema:
        schema = whole["$defs"][schema["$ref"].rpartition("/")[2]]
    if "anyOf" in schema:
        found = [misfits(value, each, whole, key) for each in schema["anyOf"]]
        return min(found, key=lambda wrong: (wrong == [key], len(wrong)))
    if "const" in schema or "enum" in schema:
        return [] if value in schema.get("enum", [schema.get("const")]) else [key]
    kinds: dict[str, tuple[type, ...]] = {
        "object": (dict,), "array": (list,), "string": (str,), "integer": (int,), "number": (int, float),
        "boolean": (bool,), "null": (type(None),),
    }  # fmt: skip
    if "type" in schema and not isinstance(value, kinds[schema["type"]]):
        return [key]
    return misfits_inside(value, schema, whole, key)


def misfits_inside(value: Any, schema: dict[str, Any], whole: dict[str, Any], key: str) -> list[str]:
    wrong = [f"{key}.{name}" for name in schema.get("required", ()) if name not in value]
    for each in schema.get("allOf", ()):
        wrong += misfits(value, each["then"], whole, key) if not misfits(value, each["if"], whole, key) else []
    if isinstance(value, dict) and "properties" in schema:
        for name, inner in value.items():
            known = schema["properties"].get(name, schema.get("additionalProperties", True))
            wrong += misfits(inner, known, whole, f"{key}.{name}")
    if isinstance(value, list) and "items" in schema:
        for inner in value:
            wrong += misfits(inner, schema["items"], whole, key)
    return wrong


def misfits_of(mapping: dict[str, Any]) -> list[str]:
    schema = schema_of(mapping["suite"])
    return misfits(mapping, schema, schema)


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_shipped_experiments_fit_their_schemas(path: Path) -> None:
    assert misfits_of(load_yaml(path)) == []


def test_every_suite_has_a_schema_that_tells_wrong_keys() -> None:
    assert all(schema_of(suite)["properties"]["suite"] for suite in SUITES)
    named: list[Any] = ["hover", {"class": "my_task.py:MyTask"}, {"class": "navigate", "command": "TCSC"}]
    assert all(misfits_of({"suite": "train", "task": task}) == [] for task in named)
    wrong = {"suite": "train", "game": 3, "task": {"command": "fly", "lane": "lane.yaml", "speed_m_s": "1"}}
    assert misfits_of(wrong) == [".game", ".task.command", ".task.speed_m_s"]
    for learner, wanted in (
        ({"algorithm": "double_dqn", "options": {"clip": 0.1, "n_steps": 1}}, [".options.clip"]),
        (
            {"algorithm": "ppo", "options": {"clip": 0.1, "n_steps": 1, "epochs": "3"}},
            [".options.n_steps", ".options.epochs"],
        ),
        ({"options": {"clip": 0.1}}, []),  # of the one that learns the task
        ({"options": {"clips": 0.1}}, [".options.clips"]),
        ({"algorithm": "sb3_ppo", "options": {"vf_coef": 0.4}}, []),
        ({"algorithm": "sb3_sac"}, [".algorithm"]),
    ):
        assert misfits_of({"suite": "train", **learner}) == wanted
    with pytest.raises(UserError, match="did you mean 'train'"):
        schema_text("trai")


def test_the_page_of_keys_has_every_key_of_every_suite_and_its_meaning() -> None:
    """With the values that it takes and its default, as recorded."""
    page = runpy.run_path(str(Path(__file__).parents[1] / "docs/site/keys.py"))["page"]()
    for name in SUITES:
        table = page.split(f"\n## {name}\n")[1].split("\n## ")[0]
        for key in find_suite(name, "keys").config.model_fields:
            assert key == "suite" or f"| `{key}` |" in table, f"{name}: {key}"
    rows = [line for line in page.splitlines() if line.startswith(("## ", "| `"))]
    assert [row for row in rows if row[0] == "|" and row.rstrip(" |").count(" | ") != 3] == []
    kept = [re.sub(r"^\| |( \| )+[^|]* \|$", "", row) for row in rows]
    assert_as_recorded("keys", "\n".join([*kept, ""]))


def test_the_training_can_be_flown_and_its_schema_knows_the_task(folder: Path) -> None:
    schema = json.loads((folder / SCHEMA).read_text())
    assert misfits(load_yaml(folder / "train.yaml"), schema, schema) == []
    assert (folder / "train.yaml").read_text().splitlines()[0] == f"# yaml-language-server: $schema={SCHEMA}"
    config: Any
    suite, config = configure(RunRequest(str(folder / "train.yaml")))
    assert (suite.name, config.env_id, config.task.door_m) == ("train", "task.py:DoorTask", 1.6)
    assert len((folder / "task.py").read_text().splitlines()) <= 60


def test_commands_of_the_readme_parse(folder: Path) -> None:
    lines = [line for line in (folder / "README.md").read_text().splitlines() if line.startswith("uavaccel ")]
    assert len(lines) == 4
    for line in lines:
        parse(line.split()[1:])


def test_the_tests_of_the_task_pass(folder: Path, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(folder)
    tests = [made for name, made in runpy.run_path(str(folder / "test_task.py")).items() if name.startswith("test_")]
    monkeypatch.delitem(sys.modules, "task")
    assert len(tests) == 3
    for test in tests:
        test()


@pytest.mark.slow
def test_the_task_is_learned(folder: Path, tmp_path: Path) -> None:
    """It wins more than four of five games before half of its 800 are flown."""
    won: list[bool] = []

    def look(case: Any, row: Any) -> None:
        won.append(row["is_success"])
        if sum(won[-50:]) > 40 or len(won) == 400:
            raise KeyboardInterrupt

    with reading(RunRequest(str(folder / "train.yaml"))) as (suite, config), pytest.raises(KeyboardInterrupt):
        run_suite(suite, config, start_run(suite, config, tmp_path / "run", {}), on_game=look)
    assert sum(won[-50:]) > 40


def test_a_folder_with_something_in_it_is_left_alone(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(UserError, match="holds mine"):
        init(str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    with pytest.raises(UserError):
        init(str(tmp_path / "mine"))
