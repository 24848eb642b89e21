"""Agents from elsewhere: models of stable-baselines3, ONNX files, functions; whose code runs, and what is refused."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import minari
import numpy as np
import pytest
import stable_baselines3 as sb3
import torch as th
from stable_baselines3.common.torch_layers import FlattenExtractor

from tests.learning import tiny_config
from tests.onnx_here import onnx, write  # noqa: F401 - a fixture
from tests.opengl import needs_opengl
from tests.running import configured, fly_into
from uavaccel.cli.experiments import evaluate_agent, sweep_agent
from uavaccel.cli.main import app
from uavaccel.envs.hover import HoverTask
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.task import Task
from uavaccel.errors import UsageError, UserError
from uavaccel.own_code import trusting
from uavaccel.realtime.policy_files import OnnxFile
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import BatchAgent, make_agent, origin_of
from uavaccel.rl.onnx_file import write_onnx
from uavaccel.rl.policy import export_policy, load_policy, make_policy
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.report import Report, Summary
from uavaccel.suites.session import RunRequest

pytestmark = pytest.mark.usefixtures("here")
HOVER = "env_id=uavaccel/Hover-v0"
SMALL = {"net_arch": [8], "activation_fn": th.nn.ReLU}


def evaluated(agent: str, *overrides: str, **options: Any) -> RunDirectory:
    """Two short games without latency."""
    config = configured(
        "evaluate", "task.max_commands=3", *overrides, agent=agent, games=2, timing="lockstep", **options
    )
    return fly_into(Path("run"), Evaluation(), config)


class Own(FlattenExtractor):
    """A class that only unpickling restores."""


class Trap:
    """Runs code where it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("sprung"),)


# --- stable-baselines3 ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("algorithm", "policy", "task"),
    [
        *((algorithm, "MlpPolicy", HoverTask()) for algorithm in ("PPO", "SAC", "TD3")),
        ("DQN", "MlpPolicy", LaneTask(observation="state")),
        ("DQN", "CnnPolicy", LaneTask()),
    ],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_a_model_of_stable_baselines3_acts_as_it_does_there(algorithm: str, policy: str, task: Task) -> None:
    name, keys = ("ObstacleLane", {"buffer_size": 10}) if algorithm == "DQN" else ("Hover", {})
    environment = gymnasium.make(f"uavaccel/{name}-v0", observation=task.observation)
    model = getattr(sb3, algorithm)(policy, environment, policy_kwargs=dict(SMALL), device="cpu", **keys)
    model.save("model.zip")
    seen = np.stack([task.observation_space().sample() for _ in range(5)])
    agent = make_agent("model.zip", task)
    assert isinstance(agent, BatchAgent)
    np.testing.assert_array_equal(agent.act_on(seen), model.predict(seen, deterministic=True)[0])
    np.testing.assert_array_equal(agent.act(seen[3], {}), model.predict(seen[3], deterministic=True)[0])


def hovering(**keywords: Any) -> None:
    sb3.PPO("MlpPolicy", gymnasium.make("uavaccel/Hover-v0"), policy_kwargs=keywords, device="cpu").save("model.zip")


def test_a_model_flies_the_environment_that_is_named() -> None:
    hovering(net_arch=[8])
    run = evaluated("model.zip", HOVER)
    assert [(row["case"], row["game"], "lane" in row) for row in run.rows()] == [
        ("game-000000", 0, False),
        ("game-000001", 1, False),
    ]
    with pytest.raises(UserError, match=r"model.zip: its observations are \(13,\), the task's \(3, 36, 64\): name the"):
        configured("evaluate", agent="model.zip")
    with pytest.raises(UserError, match=r"^task: default was trained with other observations or actions: omit what"):
        make_agent("default", HoverTask())


def test_only_what_is_trusted_is_unpickled(here: Path) -> None:
    hovering(features_extractor_class=Own)
    with pytest.raises(UserError, match=r"features_extractor_class = .*Own'>: only unpickling .* add --trust, once$"):
        make_agent("model.zip", HoverTask())
    with trusting():
        assert make_agent("model.zip", HoverTask()).act(np.zeros(13, np.float32), {}).shape == (3,)
    make_agent("model.zip", HoverTask())  # as remembered
    hovering(features_extractor_class=Own, net_arch=[4])
    with pytest.raises(UserError, match=r"add --trust, once$"):  # another file
        make_agent("model.zip", HoverTask())


def rewritten(change: Any) -> None:
    """Change the contents of model.zip, by name."""
    with zipfile.ZipFile("model.zip") as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    change(contents)
    with zipfile.ZipFile("model.zip", "w") as archive:
        for name, content in contents.items():
            archive.writestr(name, content)


def test_a_model_from_elsewhere_runs_no_code() -> None:
    """Neither its pickled data nor its weights, nor a class that it names which is no part of a network."""
    import base64
    import io
    import pickle

    trap = base64.b64encode(pickle.dumps(Trap())).decode()

    def pickled(contents: dict[str, bytes]) -> None:
        data = json.loads(contents["data"])
        contents["data"] = json.dumps(
            {
                key: {**value, ":serialized:": trap} if isinstance(value, dict) and ":serialized:" in value else value
                for key, value in data.items()
            }
        ).encode()

    def weights(contents: dict[str, bytes]) -> None:
        file = io.BytesIO()
        th.save({"trap": Trap()}, file)
        contents["policy.pth"] = file.getvalue()

    def named(contents: dict[str, bytes]) -> None:
        data = json.loads(contents["data"])
        keywords = {"filename": "sprung"}
        monitor = "<class 'stable_baselines3.common.monitor.Monitor'>"
        plain = "<class 'torch.nn.modules.activation.ReLU'>"
        data["policy_kwargs"] = {"activation_fn": plain, "features_extractor_class": monitor}
        data["policy_kwargs"]["features_extractor_kwargs"] = keywords
        contents["data"] = json.dumps(data).encode()

    hovering(net_arch=[8], activation_fn=th.nn.ReLU)
    rewritten(pickled)
    make_agent("model.zip", HoverTask())
    rewritten(weights)
    with pytest.raises(UserError, match=r"model.zip: its policy cannot be made for this task: "):
        make_agent("model.zip", HoverTask())
    rewritten(named)
    with pytest.raises(UserError, match=r"add --trust, once$"):
        make_agent("model.zip", HoverTask())
    assert not Path("sprung").exists()


@pytest.mark.usefixtures("onnx")
@pytest.mark.parametrize("name", ["model.zip", "model.onnx"])
def test_a_file_that_is_no_model_is_one_line(name: str) -> None:
    with pytest.raises(UserError, match=rf"^{name}: [Nn]o such file"):
        origin_of(name)
    Path(name).write_text("{}")
    with pytest.raises(UserError, match=f"^{name}: is no ") as caught:
        origin_of(name)
    assert "\n" not in str(caught.value)


# --- what is said outside of the lane ---------------------------------------------------------------------------


def asked(out: str, *keys: str, agent: str = "pilot.py:act", games: int = 2, **more: Any) -> RunRequest:
    """What the command line asks for; the user trusts the code."""
    Path("pilot.py").write_text(PILOT)
    options = {"agent": agent, "games": games, "timing": "lockstep", **more}
    return RunRequest("evaluate", options, keys, out=Path(out), trust=True)


@pytest.mark.parametrize("env_id", ["Hover", "Gates", "Navigate"])
def test_reports_of_other_environments_say_nothing_of_the_lane(env_id: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither page nor summary, rows or comparison; returns stand in for metres north."""
    keys = (f"env_id=uavaccel/{env_id}-v0", "task.max_commands=3", "task.observation=state")
    evaluate_agent(asked("first", *keys), None, False)
    evaluate_agent(asked("run", *keys), Path("first"), False)
    run, said = RunDirectory("run"), capsys.readouterr().out
    page, summary = Path("run/report.md").read_text().split("## Provenance")[0], run.read_json("summary.json")
    for text in (said, page, *map(str, (summary, run.rows()))):
        assert not re.search(r"\blanes?\b|Figure 8|obstacle", text)
    returns = [row["return"] for row in run.rows()]
    assert summary["return_mean"] == pytest.approx(sum(returns) / 2)
    assert ("distance_m_median" in summary) == (env_id != "Gates")
    assert "against first on the same 2 games: 0 v 0 successes" in said
    assert page.count("--case game-00000") == 2
    evaluate_agent(asked("kernels", "simulator=kernels", *keys), None, False)
    assert [row["return"] for row in RunDirectory("kernels").rows()] == pytest.approx(returns, abs=1e-9)


OWN_TASK = """
from typing import ClassVar

from uavaccel.envs.task import Task


class Up(Task):
    flat_state: ClassVar[bool] = True
    max_commands: int = 4

    def reward(self, before, now):
        return before.position_m[2] - now.position_m[2]

    def success(self, now):
        return now.free & (now.position_m[2] < -10.2)
"""


def test_an_own_task_is_evaluated_compared_swept_and_exported(capsys: pytest.CaptureFixture[str]) -> None:
    """By its name in `--set task`, in one process and in several, with the same rows."""
    Path("my_task.py").write_text(OWN_TASK)
    Path("climb.py").write_text("def act(observation):\n    return [0.0, 0.0, -1.0]\n")
    own: dict[str, Any] = {"agent": "climb.py:act", "games": 2}
    evaluate_agent(asked("run", "task=my_task.py:Up", "task.speed_m_s=2", **own), None, False)
    evaluate_agent(asked("many", "task=my_task.py", "task.speed_m_s=2", "environments=2", **own), Path("run"), False)
    rows = RunDirectory("run").rows()
    assert [row["is_success"] for row in rows] == [True, True]
    assert RunDirectory("many").rows() == rows
    assert "against run on the same 2 games: 2 v 2 successes" in capsys.readouterr().out
    sweep_agent(asked("sweep", "task=my_task.py:Up", **own), ["speed=0.1,2"], None)
    won = [cell["successes"] for cell in RunDirectory("sweep").read_json("summary.json")["cells"]]
    assert won == [won[0], 0, 2]
    assert not app(["export", "run", "--csv", "table", "--minari", "up-v0"], standalone_mode=False)
    assert len(Path("table/rows.csv").read_text().splitlines()) == 3
    dataset = minari.MinariDataset(Path("up-v0/data"))
    assert [len(episode.actions) for episode in dataset] == [row["commands"] for row in rows]


def test_evaluate_takes_a_yaml_file_that_says_all_of_it() -> None:
    """Whose code it names itself is trusted by naming the file."""
    Path("pilot.py").write_text(PILOT)
    Path("pilot.yaml").write_text(
        "{suite: evaluate, agent: pilot.py:act, env_id: uavaccel/Hover-v0, games: 1, "
        "task: {timing: lockstep, max_commands: 2}}"
    )
    assert not app(["evaluate", "pilot.yaml", "--no-films", "--out", "run"], standalone_mode=False)
    assert [row["case"] for row in RunDirectory("run").rows()] == ["game-000000"]
    with pytest.raises(UserError, match=r"^--sweep: takes an agent, not pilot\.yaml: a sweep's own YAML"):
        app(["evaluate", "pilot.yaml", "--sweep", "clock=1,2"], standalone_mode=False)


def test_evaluations_of_different_environments_are_not_compared() -> None:
    evaluate_agent(asked("hover", HOVER, "task.max_commands=1", games=1), None, False)
    with pytest.raises(UserError, match=r"^--against hover: is no evaluation of the same games$"):
        evaluate_agent(asked("gates", "env_id=uavaccel/Gates-v0", games=1), Path("hover"), False)


def test_a_sweep_has_the_conditions_of_its_environment(capsys: pytest.CaptureFixture[str]) -> None:
    request = asked("sweep", HOVER, "task.max_commands=2", timing="virtual")
    with pytest.raises(UserError, match=r"^--sweep wind: uavaccel/Hover-v0 has no task\.difficulty\.wind_m_s; known: "):
        sweep_agent(request, ["wind=0,3"], None)
    for name, meant in (("reach_m", "task.reach_m"), ("scale", "task.latency.scale"), ("clok", "clock")):
        with pytest.raises(UsageError, match=rf"^--sweep {name}: is unknown; did you mean '{meant}'\?$"):
            sweep_agent(request, [f"{name}=1,2"], None)
    sweep_agent(request, ["clock=1,10", "inference=0,0.1"], None)
    cells = RunDirectory("sweep").read_json("summary.json")["cells"]
    swept = [("clock", 1), ("clock", 10), ("inference", 0), ("inference", 0.1)]
    assert [(cell["condition"], cell["value"]) for cell in cells[1:]] == swept
    configs = [RunDirectory(part).config() for part in sorted(Path("sweep/parts").glob("inference-*"))]
    assert [config["inference_s"] for config in configs] == [0, 0.1]
    said = capsys.readouterr().out + Path("sweep/report.md").read_text().split("## Provenance")[0]
    assert not re.search(r"\blanes?\b|distance", said)


@needs_opengl
def test_films_are_announced_and_made_before_the_only_report(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written: list[bool] = []
    write = Report.write

    def noted(report: Report) -> Summary:
        written.append(Path("run/films/worst.mp4").exists())
        return write(report)

    monkeypatch.setattr(Report, "write", noted)
    keys = ("env_id=uavaccel/Navigate-v0", "task.observation=state", "task.max_commands=2")
    evaluate_agent(asked("run", *keys), None, True)
    said = capsys.readouterr().out.splitlines()
    assert written == [True]
    best, worst = (row["case"] for row in sorted(RunDirectory("run").rows(), key=lambda row: -row["return"]))
    assert [line for line in said if line.startswith("film ")] == [
        f"film 1 of 2, before the report: {best}, the best game, flown again",
        f"film 2 of 2, before the report: {worst}, the worst game, flown again",
    ]
    assert "report: run/report.html" in said
    assert re.fullmatch(r"[0-9.]+ \w+ in all, from this start to the report", said[-1])
    assert Path("run/report.md").read_text().count(".mp4)") == 2


# --- functions --------------------------------------------------------------------------------------------------

PILOT = """
import numpy as np

def act(observation):
    return np.clip(observation[:3], -1, 1)

def steer(observation, info):
    return [0.0, 0.0, 1.0 if info["commands"] else -1.0]

def wrong(observation):
    return 7

def broken(observation):
    return observation.nothing

def several(observation, info, more): ...

class Counting:
    def reset(self):
        self.flown = 0

    def __call__(self, observation):
        self.flown += 1
        return [0.0, 0.0, -0.25 * self.flown]

counts = Counting()
"""


def test_a_function_flies_once_it_is_trusted(here: Path) -> None:
    Path("pilot.py").write_text(PILOT)
    with pytest.raises(UserError, match=r"pilot\.py is code that nobody has trusted here: .* add --trust, once$"):
        configured("evaluate", HOVER, agent="pilot.py:act")
    with trusting():
        origin_of("pilot.py:act")
    with pytest.raises(UserError, match=r"^device = cuda: pilot.py:act decides game by game, on the CPU: take device"):
        configured("evaluate", HOVER, "simulator=kernels", "device=cuda", agent="pilot.py:act")
    run = evaluated("pilot.py:steer", HOVER)
    assert [row["actions"] for row in run.rows()] == [[[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]] * 2
    together = configured("evaluate", HOVER, "environments=2", *("task.max_commands=3",), agent="pilot:steer", games=2)
    rows = fly_into(Path("together"), Evaluation(), together).rows()
    assert [row["actions"] for row in rows] == [row["actions"] for row in run.rows()]


class Counts(th.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def forward(self, seen: th.Tensor) -> th.Tensor:
        self.count += 1
        return th.tensor([[0.0, 0.0, -0.25 * self.count]])

    @th.jit.export
    def reset(self) -> None:
        self.count = 0


@pytest.mark.parametrize("agent", ["pilot.py:counts", "counts.pt"])
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
def test_what_remembers_begins_anew_with_each_game(agent: str) -> None:
    Path("pilot.py").write_text(PILOT)
    th.jit.save(th.jit.script(Counts()), "counts.pt")
    with trusting():
        rows = evaluated(agent, HOVER).rows()
        assert [row["actions"] for row in rows] == [[[0.0, 0.0, -0.25], [0.0, 0.0, -0.5], [0.0, 0.0, -0.75]]] * 2
        together = configured("evaluate", HOVER, "simulator=kernels", "task.timing=lockstep", agent=agent)
        with pytest.raises(UserError, match=f"^simulator = kernels: {agent} has a reset, for a game at a time"):
            fly_into(Path("batch"), Evaluation(), together)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        ("wrong", r"pilot:wrong: returned 7, where an action is \(3,\)"),
        ("broken", r"pilot:broken: .*pilot\.py:14: broken: AttributeError: .*"),
        ("missing", r"agent 'pilot:missing': pilot has no function missing; known: act, steer, wrong, broken, .*"),
        ("several", r"agent 'pilot:several': must take an observation, or an observation and an info"),
        ("Counting", r"agent 'pilot:Counting': Counting is a class: name a function, or an object of that class"),
    ],
)
def test_what_is_wrong_with_a_function_is_one_line(function: str, said: str) -> None:
    Path("pilot.py").write_text(PILOT)
    with trusting(), pytest.raises(UserError, match=f"{said}$") as caught:
        evaluated(f"pilot:{function}", HOVER)
    assert "\n" not in str(caught.value)


# --- ONNX -------------------------------------------------------------------------------------------------------


class Twice(th.nn.Linear):
    def forward(self, seen: th.Tensor) -> Any:
        return (found := super().forward(seen)), -found


@pytest.mark.usefixtures("onnx")
@pytest.mark.parametrize("batch", [True, False])
@pytest.mark.parametrize(("outputs", "sign"), [("mean other", 1), ("other actions", -1), ("actions action", -1)])
def test_an_onnx_file_gives_the_actions_clipped(outputs: str, sign: int, batch: bool) -> None:
    """By the output `action`, `actions` or the first, also where it takes one observation at a time."""
    network = Twice(13, 3)
    write("model.onnx", network, th.zeros(2 if batch else 1, 13), batch=batch, output_names=outputs.split())
    seen = np.random.default_rng(0).normal(size=(20, 13)).astype(np.float32)
    agent = make_agent("model.onnx", HoverTask())
    assert isinstance(agent, BatchAgent)
    with th.inference_mode():
        expected = (sign * network(th.from_numpy(seen))[0]).clamp(-1.0, 1.0).numpy()
    np.testing.assert_allclose(agent.act_on(seen), expected, atol=1e-6)
    with pytest.raises(UserError, match=r"model.onnx: its observations are \(13,\), the task's \(3, 36, 64\): name"):
        configured("evaluate", agent="model.onnx")


NAVIGATE: dict[str, Any] = {"env_id": "uavaccel/Navigate-v0", "algorithm": "ppo", "options": {"minibatches": 2}}


@pytest.mark.usefixtures("onnx")
@pytest.mark.parametrize(
    ("task", "beside", "keys"),
    [
        ({"history": 2, "knows": ["last_action"], "headings_deg": [-30.0, 0.0, 30.0]}, ["told"], {}),
        ({"observation": "depth"}, [], {}),
        ({"observation": "colour", "picture_size": [33, 17]}, [], {}),
        ({"also_state": True, "knows": ["frame_age"]}, ["told", "state"], {"mirror": False}),
        ({"observation": "dvs", "also_state": True}, ["state"], NAVIGATE),
    ],
    ids=["dvs", "depth", "colour", "state", "actions"],
)
def test_a_policy_that_was_exported_flies_as_the_policy_does(
    task: dict[str, Any], beside: list[str], keys: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """Its file takes whole pictures and reduces them itself; it says what it flies, and the command what it takes."""
    Path("policy").mkdir()
    config = tiny_config(task, **keys)
    export_policy(Path("policy"), make_policy(config), config, {})
    policy = load_policy(Path("policy"))
    app(["export", "policy", "--onnx", "model.onnx"], standalone_mode=False)
    said, written = capsys.readouterr().out, OnnxFile("model.onnx")
    names = [[each.name for each in part()] for part in (written._session.get_inputs, written._session.get_outputs)]
    assert names == [["seen", *beside], ["action"] if keys is NAVIGATE else ["ratings", "action"]]
    assert all(f"{name}: {written.metadata[name]}" in said for name in names[0])
    evaluation, usual = (configured("evaluate", agent=agent) for agent in ("model.onnx", "policy"))
    assert evaluation.task == usual.task
    random = np.random.default_rng(0)
    seen: Any = random.integers(0, 256, (9, *config.task.frames_space().shape), np.uint8)
    if "state" in beside:
        seen = {"image": seen, "state": random.normal(size=(9, config.task.told)).astype(np.float32)}
    agent = make_agent("model.onnx", evaluation.task)
    assert isinstance(agent, BatchAgent)
    np.testing.assert_allclose(agent.act_on(seen), policy.act(seen), rtol=1e-5, atol=1e-5)


@pytest.mark.usefixtures("onnx")
def test_a_policy_of_pictures_of_another_kind_is_refused() -> None:
    """Depth and events have one form."""
    Path("policy").mkdir()
    config = tiny_config(**NAVIGATE)
    export_policy(Path("policy"), make_policy(config), config, {})
    write_onnx(load_policy(Path("policy")), Path("model.onnx"))
    for agent, said in (("policy", "with other observations or actions"), ("model.onnx", "model.onnx .* with 'depth'")):
        assert configured("evaluate", agent=agent).task.observation == "depth"
        with pytest.raises(UserError, match=said):
            configured("evaluate", "task.observation=dvs", agent=agent)


def test_without_onnxruntime_an_onnx_file_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaccel.resources.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"^model.onnx: needs onnxruntime: pip install .*\[onnx\]'$"):
        origin_of("model.onnx")
