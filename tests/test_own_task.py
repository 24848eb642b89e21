"""A task of one's own is trained as the lane is: from a YAML file or its own, resumed, and refused in one line."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch as th

from tests.conftest import forget_own_code
from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from tests.learning import fly_here
from tests.running import fly_into
from uavaccel.own_code import trusting
from uavaccel.rl.double_dqn import DeviceDQN
from uavaccel.rl.learner import Game
from uavaccel.rl.policy import weights_sha256
from uavaccel.suites.parts import Part
from uavaccel.suites.registry import own_folder
from uavaccel.suites.runner import run_suite, start_run
from uavaccel.suites.session import RunRequest, reading, schema_of
from uavaccel.suites.train import CHECKPOINTS, Training

POST = """
from gymnasium.spaces import Box, Discrete
from uavaccel.envs.task import Task, distance


class Post(Task):
    '''Fly to a place.'''

    flat_state = True
    altitude_m: float = 2.0
    speed_m_s: float = 2.0
    near_m: float = 0.7
    max_commands: int = 5

    def sample(self, random, options):
        return {"aim_m": [float(each) for each in random.uniform(-2, 2, 2)]}

    def action_space(self):
        return Discrete(4)

    @property
    def directions(self):
        return [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)]

    def fields(self, state, course):
        (north, east), (x_m, y_m, _) = course["aim_m"], state.position_m
        return [north - x_m, east - y_m, *state.linear_velocity_m_s]

    def far_m(self, now):
        return distance(now.course["aim_m"], now.position_m[:2])

    def reward(self, before, now):
        return self.far_m(before) - self.far_m(now) + 5.0 * self.success(now)

    def success(self, now):
        return self.far_m(now) < self.near_m
"""
MORE = """

class Free(Post):
    def action_space(self):
        return Task.action_space(self)

    @property
    def directions(self):
        return None
"""
BARE = """
from uavaccel.envs.flight_env import FlightEnv
class Mine(FlightEnv):
    pass
"""
YAML = """
suite: train
task: {{class: post.py:{task}, near_m: 1.0}}
games: 6
environments: 2
simulator: {simulator}
hidden: [8]
checkpoint_games: 2
options: {options}
"""
OPTIONS = {
    "Post": "{buffer_size: 200, learning_starts: 4, batch_size: 8}",
    "Free": "{rollout: 8, minibatches: 2, epochs: 1}",
}


@pytest.fixture(autouse=True)
def _two_tasks(here: Path) -> None:
    (here / "post.py").write_text(POST + MORE)


def yaml_of(here: Path, task: str, simulator: str = "mujoco") -> str:
    (here / "own.yaml").write_text(YAML.format(task=task, simulator=simulator, options=OPTIONS[task]))
    return "own.yaml"


@pytest.mark.parametrize("simulator", ["mujoco", "kernels"])
@pytest.mark.parametrize(("task", "algorithm", "kind"), [("Post", "double_dqn", int), ("Free", "ppo", float)])
def test_it_is_trained_and_flies_from_another_folder(
    task: str, algorithm: str, kind: type, simulator: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The learner follows from its actions; configuration and policy record what was trained.

    One is trained in a process of its own.
    """
    if (task, simulator) == ("Free", "mujoco"):
        fly_here(monkeypatch.setattr)
    with reading(RunRequest(yaml_of(here, task, simulator))) as (suite, config):
        run = fly_into(here / "run", suite, config)
    assert config.algorithm == algorithm
    for kept in (run.config(), json.loads((here / "run/policy.json").read_text())["config"]):
        assert (kept["env_id"], kept["task"]["near_m"]) == (f"post.py:{task}", 1.0)
    if simulator == "kernels":
        summary = suite.report(run).write()
        assert (summary["games"], summary["weights_sha256"] is None) == (6, False)
        assert {"learning_games", "progress"} <= {path.stem for path in (here / "run/figures").glob("*.png")}
        return
    elsewhere = here / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    forget_own_code(monkeypatch)
    place = f"post.py:{task}"
    if task == "Free":  # where there is another project's
        Path("post.py").write_text("raise SystemExit('it ran')\n")
        place = f"{here}/{place}"
    with reading(RunRequest("evaluate", {"agent": "../run", "games": 2})) as (evaluation, evaluated):
        assert (evaluation.name, evaluated.env_id) == ("evaluate", place)
        flown = fly_into(here / "flown", evaluation, evaluated)
    actions = [row["actions"][0] for row in flown.rows()]
    assert all(isinstance(each if kind is int else each[0], kind) for each in actions)


@pytest.mark.usefixtures("host_kernels")
def test_double_dqn_learns_it_with_its_lanes_on_a_gpu(here: Path) -> None:
    from uavaccel.envs.cuda_lanes import CudaLanes

    with reading(RunRequest(yaml_of(here, "Post", "kernels"), {}, ["device=cuda"])) as (_, config):
        learner = DeviceDQN(config, CudaLanes(config.task, 2, th.device("cpu")))
        before = weights_sha256(learner.policy)
        games: list[Game] = []
        while len(games) < 6:
            games += learner.advance()
    th.use_deterministic_algorithms(False)
    assert [game.number for game in games] == list(range(6))
    assert weights_sha256(learner.policy) != before


def test_resumed_it_ends_with_the_same_bytes(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint is taken on Ctrl-C; the rest is flown by another start."""
    fly_here(monkeypatch.setattr)
    with reading(RunRequest(yaml_of(here, "Post"))) as (suite, config):
        whole = fly_into(here / "whole", suite, config)
        parts = here / "parts"

        def stop(case: Any, row: Any) -> None:
            if row["game"] == 2:
                signal.raise_signal(signal.SIGINT)

        with pytest.raises(KeyboardInterrupt):
            run_suite(suite, config, start_run(suite, config, parts, {}), 1, stop)
        assert any((parts / CHECKPOINTS).iterdir())
    with reading(RunRequest(None, out=parts, resume=True)) as (suite, config):
        resumed = fly_into(parts, suite, config, resume=True)
    assert (resumed.path / "rows.jsonl").read_bytes() == (whole.path / "rows.jsonl").read_bytes()
    weights = [json.loads((run.path / "policy.json").read_text())["trained"] for run in (whole, resumed)]
    assert weights[0] == weights[1]


@pytest.mark.parametrize("name", ["pilot.py:act", "../pilot.py:act"])
def test_an_evaluation_of_ones_own_function_goes_on_from_another_folder(
    name: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("there", "else/where"):
        (here / folder).mkdir(parents=True)
    monkeypatch.chdir(here / "there")
    Path(name.partition(":")[0]).write_text("def act(observation): return 2")
    with reading(RunRequest("evaluate", {"agent": name, "games": 1}, trust=True)) as (suite, config):
        start_run(suite, config, here / "run", {})
    monkeypatch.chdir(here / "else/where")
    forget_own_code(monkeypatch)
    with reading(RunRequest(None, out=here / "run", resume=True)) as (suite, config):
        suite.check(config)
    assert config.agent == name


def test_its_file_alone_is_a_training(here: Path) -> None:
    """With settings by its actions and by what can fly it; --set and --games change them."""
    for name, algorithm, lanes in (("post.py:Post", "double_dqn", 8), ("post.py:Free", "ppo", 32)):
        with reading(RunRequest(name, {"games": 3}, ["task.near_m=2"])) as (suite, config):
            assert isinstance(suite, Training)
            suite.check(config)
            found = config.algorithm, config.simulator, config.environments, config.games, config.task.near_m
            assert found == (algorithm, "kernels", lanes, 3, 2.0)


@pytest.mark.parametrize("function", [
    "def success(self, now): return not self.far_m(now) > 1",
    "def reward(self, before, now): return 1.0 if now.commands > 1 else 0.0",
    "def fields(self, state, course): return [max(0.0, state.position_m[0])]",
    "def advance(self, before, now): return {**now.course, 'more': 1.0}",
    "def advance(self, before, now): return {'aim_m': now.course['aim_m']}",
    "def advance(self, before, now): return {**now.course, 'whole': now.course['whole'] + 0.5}",
    "def reward(self, before, now): return 1.0 * (now.collision is None)",
    "def reward(self, before, now): return 0.5 * ((now.commands > 3) + (now.commands > 5))",
    "def info(self, now): return {'hit': now.collision}",
    """count: int = 1
    def sample_conditions(self, random, games): return {'count': 2}
    def with_conditions(self, conditions): return self.model_copy(update=conditions)""",
])  # fmt: skip
def test_a_task_that_is_another_over_arrays_flies_in_mujoco_alone(function: str, here: Path) -> None:
    sample = "def sample(self, random, options): return {'aim_m': [1.0, 2.0], 'whole': 1}"
    (here / "mine.py").write_text(f"{POST}\n    {sample}\n")
    with reading(RunRequest("mine.py")) as (_, config):
        assert (config.env_id, config.simulator) == ("mine.py:Post", "kernels")
    (here / "own.py").write_text(f"{POST}\n    {sample}\n    {function}\n")
    with reading(RunRequest("own.py")) as (_, config):
        assert config.simulator == "mujoco"


def test_a_file_that_imports_relatively_is_a_part_of_its_package(here: Path) -> None:
    (here / "tasks" / "race").mkdir(parents=True)
    for name, text in {"tasks/__init__": "", "tasks/base": POST, "tasks/race/__init__": ""}.items():
        (here / f"{name}.py").write_text(text)
    (here / "tasks/race/fast.py").write_text("from ..base import Post\n\nclass Fast(Post):\n    near_m: float = 3.0\n")
    for name in ("tasks/race/fast.py", f"{here}/tasks/race/fast.py:Fast"):
        with reading(RunRequest(name)) as (_, config):
            assert (config.env_id, config.task.near_m) == ("tasks/race/fast.py:Fast", 3.0)
    (here / "there").mkdir()
    for name in (f"{here}/tasks/race/fast.py", "../tasks/race/fast.py"):
        (here / "there/own.yaml").write_text(f"suite: train\ntask: {name}\n")
        with reading(RunRequest("there/own.yaml")) as (suite, config):
            assert (config.env_id, config.task.near_m) == (f"{name}:Fast", 3.0)
            assert own_folder(suite, config) == here / "there", "from which a path that begins with ../ leads to it"


def test_code_that_nobody_trusts_does_not_run(here: Path, said: Callable[[str], str]) -> None:
    (here / "post.py").write_text("raise SystemExit('it ran')\n")
    asks = f"{here}/post.py is code that nobody has trusted here: read it, then add --trust, once"
    assert asks in said("train --set task=post.py:Post --dry-run")
    (here / "run").mkdir()
    (here / "run/config.yaml").write_text("suite: train\nenv_id: post.py:Post\n")
    (here / "run/manifest.json").write_text(json.dumps({"own_code": str(here)}))
    assert asks in said("train --out run --resume")


def test_its_schema_has_its_keys(here: Path) -> None:
    (here / "both.py").write_text(POST + BARE.replace("pass", "task_class = Post"))
    for name in (yaml_of(here, "Free"), "post.py:Post", "both.py"):
        _, task = schema_of(name)["properties"]["task"]["anyOf"]
        assert {"class", "near_m", "max_commands"} <= set(task["properties"])


@pytest.mark.parametrize(("key", "hint"), [
    ("task.wind_m_s", "did you mean 'task.difficulty.wind_m_s'?"),
    ("learning_rate", "did you mean 'options.learning_rate'?"),
    ("options.learning_rte", "did you mean 'learning_rate'?"),
    ("clock_sped", "did you mean 'task.clock_speed'?"),
    ("task.difficulty.wind", "did you mean 'task.difficulty.wind_m_s'?"),
    ("game", "did you mean 'games'?"),
])  # fmt: skip
def test_an_unknown_key_is_looked_for_at_every_level(key: str, hint: str, said: Callable[[str], str]) -> None:
    assert said(f"train --dry-run --set {key}=1").endswith(hint)


def test_a_part_has_keys_of_the_task_that_it_names(here: Path) -> None:
    (here / "named.yaml").write_text("{suite: train, task: post.py:Post}")
    with trusting(beside=here):
        _, config = Part(experiment="named.yaml", keys={"task.near_m": 0.5}).resolve(3)
    assert (config.env_id, config.task.near_m, config.seed) == ("post.py:Post", 0.5, 3)


def test_unknown_keys_of_ones_own_task_are_found_too(here: Path, said: Callable[[str], str]) -> None:
    for key, hint in {"near_m": "task.near_m", "task.near": "task.near_m", "task.rollout": "options.rollout"}.items():
        line = said(f"train {yaml_of(here, 'Free')} --dry-run --set {key}=1")
        assert line == f"--set: unknown key '{key}'; did you mean '{hint}'?"


@pytest.mark.parametrize(("file", "line"), [
    ("", "task 'mine.py': has no class of a task"),
    ("x = 1\ny = x / 0\n", "task 'mine.py': HERE/mine.py:2: ZeroDivisionError: division by zero"),
    ("import sys\nsys.exit(3)\n", "task 'mine.py': HERE/mine.py:2: SystemExit: 3"),
    ("def x(:\n", "task 'mine.py': HERE/mine.py:1: SyntaxError: invalid syntax"),
    ("import no_such_module\n", "task 'mine.py': HERE/mine.py:1: ModuleNotFoundError: No module named"),
    (BARE, "task 'mine.py:Mine': Mine has no task_class"),
    (POST + MORE, "task 'mine.py': has 2 tasks: name one, mine.py:Post or mine.py:Free"),
    (POST + "import uavaccel\nuavaccel.train(Post)\n", "HERE/mine.py: is imported for a class in it, and must not fly"),
    (POST + "import uavaccel\nuavaccel.make_vec(Post, 2)\n", "HERE/mine.py: is imported for a class in it, and must"),
])  # fmt: skip
def test_a_file_without_one_task_is_one_line(file: str, line: str, here: Path, said: Callable[[str], str]) -> None:
    (here / "mine.py").write_text(file)
    assert line.replace("HERE", str(here)) in said("train mine.py --dry-run")
    assert said("train theirs.py --dry-run") == "theirs.py: no such file"


MIRRORED = "action_space, mirrored = lambda self: Box(-1.0, 1.0, (3,)), lambda self:"


@pytest.mark.parametrize(("function", "line"), [
    ("reward = Task.reward", "Post.reward: is missing: def reward(self, before, now)"),
    ("def reward(self, before, now): return float('nan')", "Post.reward: returned nan: must be a finite number"),
    ("def reward(self, now): return 1.0", "Post.reward: TypeError: Post.reward() takes 2 positional arguments"),
    ("def success(self, now): pass", "Post.success: returned None: must be True or False"),
    ("def fields(self, state, course): return [1, [2, 3]]", "Post.fields: must return numbers, in lists of equal"),
    ("def observation_space(self): return Box(0, 1, (3,))", "Post.fields: observations are of shape (5,), in"),
    ("def sample(self, random, options): return {'a': {1}}", "Post.sample: must return plain numbers"),
    ("def fields(self, state, course): return (each for each in [1])", "Post.fields: must return numbers, in lists of"),
    ("def fields(self, state, course): return []", "Post.fields: returned no numbers"),
    ("def fields(self, state, course): return 1.0", "Post.fields: returned no list, but one number"),
    ("def fields(self, state, course): return [1e300]", "Post.fields: returned a number that is not finite: [inf]"),
    ("def reward(self, before, now): return __import__('numpy').ones(1)", "Post.reward: returned array("),
    ("def info(self, now): return {'commands': 'few'}", "Post.info: 'commands' is an item of all tasks"),
    ("def info(self, now): return {'conditions': 'windy'}", "Post.info: 'conditions' is an item of all tasks"),
    ("def sample(self, random, options): return {'conditions': 1.0}", "Post.sample: 'conditions' are those of"),
    ("def sample_conditions(self, random, games): return {'wind': 'strong'}",
     "Post.sample_conditions: 'wind' is 'strong': must be a finite number"),
    ("def sample_conditions(self, random, games): return {'wind': 1}\n    def with_conditions(self, conditions): pass",
     "Post.with_conditions: returned None: must be a task"),
    ("def sample_conditions(self, random, games): return {'speed_m_s': 1}",
     "Post.with_conditions: is missing: def with_conditions(self, conditions)"),
    ("def info(self, now): return {'lane': 'left'}", "Post.info: 'lane' is 'left': must be a whole number, or name"),
    ("def info(self, now): return {'distance_m': 0 * 1e400}", "Post.info: 'distance_m' is nan: must be a finite"),
    ("def action_space(self): return 4", "Post.action_space: must return a Discrete that begins with 0, or a Box"),
    ("def action_space(self): return Discrete(4, start=1)", "Post.action_space: must return a Discrete that begins"),
    ("def action_space(self): return Box(-1, 1, (0,))", "Post.action_space: must return a Discrete that begins with 0"),
    ("def action_space(self): return Box(-1, 1, (2,), int)", "Post.action_space: must return a Discrete that begins"),
    (f"{MIRRORED} 1", "Post.mirrored: must return a Mirror of envs.task or None"),
    (f"{MIRRORED} ([1, -2, 3, -4, 5], [1, -2])", "Post.mirrored: must return a Mirror of envs.task or None: action = "),
    (f"{MIRRORED} ([1, -2, 3], [1, -2, 3])", "Post.mirrored: must return a Mirror of envs.task or None: fields = "),
    (f"{MIRRORED} ([1], [1, -2, 3])", "Post.mirrored: must return a Mirror of envs.task or None: fields = [1]"),
    ("def goal(self, action): return 4", "Post.goal: must return a goal of uavaccel.kinematics"),
    ("@property\n    def directions(self): return [(float('nan'), 0, 0)] * 4",
     "Post.goal: must be of finite numbers, not VelocityGoal("),
    ("def advance(self, before, now): pass", "Post.advance: returned None: must be a mapping"),
    ("def advance(self, before, now): now.course['aim_m'][0] += 1; return now.course",
     "Post.advance: changes the course that it is given"),
    ("def fields(self, state, course): return course.pop('aim_m')", "Post.fields: changes the course that it is"),
    ("scene = 'lane'\n    def layout(self, course): return {'obstacles': [{'x': 1}]}",
     "Post.layout: lane: unknown key 'obstacles.0.x'"),
    *[(f"def {signature}: return __import__('numpy').random.random(2000)", f"Post.{name}: called again with the same,")
      for name, signature in {
          "reward": "reward(self, before, now)", "fields": "fields(self, state, course)",
          "sample": "sample(self, random, options)"
      }.items()],
    ("def layout(self, course): return {'obstacles': []}", "Post.layout: a layout is of obstacles, light"),
])  # fmt: skip
def test_a_function_with_a_mistake_is_named(function: str, line: str, here: Path, said: Callable[[str], str]) -> None:
    (here / "mine.py").write_text(f"{POST}\n    {function}\n")
    assert said("train mine.py --dry-run").startswith(f"{here}/mine.py: {line}")


@pytest.mark.parametrize("simulator", ["mujoco", "kernels"])
@pytest.mark.parametrize(("function", "line"), [
    ("reward(self, before, now): return 1 / (3 - now.commands)", "ZeroDivisionError: division by zero"),
    ("reward(self, before, now): return float('nan') ** (now.commands > 1)", "returned nan: must be a finite number"),
    ("fields(self, state, course): return [state.time_ns * 1e300 * 1e300]", "returned a number that is not"),
    ("layout(self, course): return {'obstacles': [dict(x_m=9, y_m=0, radius_m=course['aim_m'][0])]}\n    scene='lane'",
     "lane: obstacles.0.radius_m = -"),
])  # fmt: skip
def test_a_mistake_in_flight_is_one_line(
    function: str, line: str, simulator: str, here: Path, said: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first in a process of its own; arrays divide by zero without an error, to a number that is not finite."""
    if simulator == "mujoco" and "1 / " not in function:
        fly_here(monkeypatch.setattr)
    here.joinpath("post.py").write_text(f"{POST}\n    def {function}\n")
    error = said(f"train {yaml_of(here, 'Post', simulator)} --out run")
    assert f"{here}/post.py" in error
    assert f"Post.{function.partition('(')[0]}" in error
    assert line in error or simulator == "kernels"


def test_a_mistake_in_a_task_that_it_is_derived_from_is_one_line(
    here: Path, said: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a process of its own, and in this one."""
    here.joinpath("post.py").write_text(f"{POST}\n    def success(self, now): return 1 // (2 - now.commands) > 9\n")
    here.joinpath("leaf.py").write_text("from post import Post\n\nclass Leaf(Post):\n    near_m: float = 1.0\n")
    for folder in ("there", "here"):
        error = said(f"train {yaml_of(here, 'Post')} --set task.class=leaf.py:Leaf --trust --out {folder}")
        assert error.startswith(f"{here}/post.py:")
        assert error.endswith(": Post.success: ZeroDivisionError: integer division or modulo by zero")
        fly_here(monkeypatch.setattr)


def test_a_start_where_nothing_flies_is_one_line(
    here: Path, said: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fly_here(monkeypatch.setattr)
    high = "def sample_conditions(self, random, games): return {'altitude_m': 1e5}"
    under = "def with_conditions(self, conditions): return self.model_copy(update=conditions)"
    here.joinpath("post.py").write_text(f"{POST}\n    {high}\n    {under}\n")
    error = said(f"train {yaml_of(here, 'Post', 'mujoco')} --out run")
    assert error.endswith(
        "post.py: Post.altitude_m: position: NED z has to be from -19878 (thin air) to 0 m (the ground), not -100000"
    )


def test_actions_want_their_algorithm(here: Path, said: Callable[[str], str]) -> None:
    for task, algorithm, needed in (("Post", "ppo", "double_dqn"), ("Free", "double_dqn", "ppo")):
        line = said(f"train {yaml_of(here, task)} --dry-run --set algorithm={algorithm} --set options={{}}")
        assert line.startswith(f"--set: algorithm {algorithm} does not learn post.py:{task}, whose actions are ")
        assert line.endswith(f"it needs algorithm {needed}")
    wide = MORE.replace("Free", "Wide").replace("Task.action_space(self)", "Box(-3.0, 3.0, (3,))")
    (here / "wide.py").write_text(f"{POST}{wide}")
    (here / "wide.yaml").write_text("suite: train\ntask: wide.py:Wide\n")
    assert said("train wide.yaml --dry-run").startswith("wide.yaml: algorithm ppo learns actions from -1 to 1, which ")
