"""Games as MCAP logs and as Minari datasets: read back by the formats' own libraries, equal bytes, clear refusals."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import sys
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import cv2
import gymnasium
import h5py
import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from tests.golden import assert_as_recorded
from tests.opengl import needs_opengl
from tests.running import configured, fly_into
from uavaccel.cli.flights import export
from uavaccel.config import Config
from uavaccel.envs.hover import HoverTask
from uavaccel.errors import UsageError, UserError
from uavaccel.export import NED_IN_ENU, OPTICAL_IN_BODY, TOPICS, _columns, _write_metadata, entries, event_columns
from uavaccel.files import file_sha256, to_json
from uavaccel.records import RunDirectory, provenance_of
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.dp2 import Dp2
from uavaccel.suites.evaluate import Evaluation, game_seed
from uavaccel.suites.evaluate_again import evaluation_of
from uavaccel.suites.flight import Commands, Flight, Window

pytestmark = pytest.mark.usefixtures("whole_messages")

mcap_reader = pytest.importorskip("mcap.reader")
# Minari's import warns where Minari's optional parts are missing.
minari = pytest.importorskip("minari")

SHORT_PATH = "path=[[1.0, 0.0], [1.0, 0.0], [0.0, 0.5]]"


@pytest.fixture(scope="module")
def dp1(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    out = tmp_path_factory.mktemp("dp1") / "run"
    small = "rounds=[1]", "t_move_s=[0.5]", "reference_games=1", "games=1", "clock_speed=[1]"
    return fly_into(out, Dp1(), configured("dp1", *small, timing="virtual"))


@pytest.fixture(scope="module")
def dp2(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    out = tmp_path_factory.mktemp("dp2") / "run"
    return fly_into(out, Dp2(), configured("dp2", SHORT_PATH, clock_speed=[1.0], command=["tcsc"], timing="virtual"))


def evaluated(out: Path, *overrides: str, **options: Any) -> RunDirectory:
    config = configured("evaluate", *overrides, **{"agent": "straight", "games": 2, **options})
    return fly_into(out, Evaluation(), config)


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    """Two lanes flown straight ahead, seen as a state: nothing has to be drawn."""
    out = tmp_path_factory.mktemp("evaluate") / "run"
    return evaluated(out, "task.observation=state", "task.command=adsc", "task.clock_speed=20")


class Log(NamedTuple):
    """What an MCAP file says, read by MCAP's own library."""

    messages: dict[str, list[tuple[int, Any]]]
    metadata: dict[str, str]
    schemas: dict[str, str]


def outlined(value: Any) -> Any:
    """The keys of a message, or those that its schema describes."""
    if isinstance(value, dict) and "type" in value:
        value = value.get("properties", [value["items"]] if "items" in value else None)
    if isinstance(value, dict):
        return {name: outlined(each) for name, each in value.items()}
    return [outlined(value[0])] if isinstance(value, list) else None


def read(path: Path) -> Log:
    messages: dict[str, list[tuple[int, Any]]] = {}
    schemas = {}
    with path.open("rb") as file:
        reader = mcap_reader.make_reader(file, validate_crcs=True)
        [metadata] = reader.iter_metadata()
        [attachment] = reader.iter_attachments()
        assert attachment.name == "config.yaml"
        last_ns = 0
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert message.log_time >= last_ns, "written in the order of time"
            last_ns = message.log_time
            assert message.publish_time == message.log_time
            assert schema.encoding == "jsonschema"
            assert outlined(json.loads(message.data)) == outlined(json.loads(schema.data))
            schemas[channel.topic] = schema.name
            messages.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
        summary = reader.get_summary()
        assert summary
        assert {each.topic for each in summary.channels.values()} == messages.keys()
    return Log(messages, metadata.metadata, schemas)


def vectors(entries: list[tuple[int, Any]], *keys: str) -> np.ndarray:
    found = []
    for _, message in entries:
        for key in keys:
            message = message[key]
        found.append([message[axis] for axis in "xyz"])
    return np.array(found)


# --- MCAP -------------------------------------------------------------------------------------------------------


def test_a_game_of_dp1_is_logged_as_its_arrays_have_it(
    dp1: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export(str(dp1.path), mcap=tmp_path / "logs")
    rows = dp1.rows()
    assert sorted(path.name for path in (tmp_path / "logs").iterdir()) == sorted(f"{row['case']}.mcap" for row in rows)
    for row in rows:
        log, arrays = read(tmp_path / "logs" / f"{row['case']}.mcap"), dp1.load_arrays(row)
        assert log.schemas == {topic: TOPICS[topic] for topic in log.schemas}
        poses = log.messages["/drone/pose"]
        np.testing.assert_array_equal(vectors(poses, "pose", "position"), arrays["position_m"])
        np.testing.assert_array_equal([at for at, _ in poses], np.rint(arrays["time_s"] * 1e9).astype(np.int64))
        quaternions = [[each["pose"]["orientation"][axis] for axis in "wxyz"] for _, each in poses]
        np.testing.assert_array_equal(quaternions, arrays["orientation_wxyz"])
        velocities = log.messages["/drone/velocity"]
        np.testing.assert_array_equal(vectors(velocities, "velocity_m_s"), arrays["linear_velocity_m_s"])
        commands = log.messages["/drone/command"]
        assert len(commands) == row["commands"]
        square = [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]
        path = [[1, 0, 0], [1, 0, 0], [-1, 0, 0]] if row["role"] == "figure2" else square
        np.testing.assert_array_equal(vectors(commands, "velocity_m_s"), path)
        assert {each["frame_id"] for _, each in (*poses, *commands)} == {"ned"}
        assert log.metadata["timing"] == row["timing"]
        assert log.metadata["numbers"] == ("measured" if row["timing"] == "wall" else "modelled")
        assert log.metadata["config_sha256"] == file_sha256(dp1.path / "config.yaml")
        assert json.loads(log.metadata["row"]) == row

    case = row["case"]  # alone, again, on a terminal: the same bytes
    monkeypatch.setattr("uavaccel.cli.terminal.console", Console(file=(shown := StringIO()), force_terminal=True))
    export(str(dp1.path), mcap=tmp_path / "one.mcap", case=case)
    assert "the files" in shown.getvalue()
    assert read(tmp_path / "one.mcap").metadata["case"] == case
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "logs" / f"{case}.mcap").read_bytes()


def turned(wxyz: tuple[float, ...], vector: tuple[int, ...]) -> np.ndarray:
    w, x, y, z = wxyz
    return np.asarray(Rotation.from_quat([x, y, z, w]).apply(vector))


def test_frames_turn_down_into_up_and_the_view_forward() -> None:
    """North, east, down are (0, 1, 0), (1, 0, 0), (0, 0, -1) in ENU; the optical axis is the body's x."""
    for axis, in_enu in (((1, 0, 0), (0, 1, 0)), ((0, 1, 0), (1, 0, 0)), ((0, 0, 1), (0, 0, -1))):
        np.testing.assert_allclose(turned(NED_IN_ENU, axis), in_enu, atol=1e-12)
    for optical, in_body in (((0, 0, 1), (1, 0, 0)), ((1, 0, 0), (0, 1, 0)), ((0, 1, 0), (0, 0, 1))):
        np.testing.assert_allclose(turned(OPTICAL_IN_BODY, optical), in_body, atol=1e-12)


def test_events_are_columns_of_pixels_microseconds_and_signs() -> None:
    rows = np.array([[0.2499996, 300, 2, 1], [0.125, 4, 100, -1]])  # rounded to whole microseconds
    message: Any = event_columns(rows, (144, 256))
    assert {name: message[name] for name in ("width", "height", "count")} == {"width": 256, "height": 144, "count": 2}
    columns = {name: values.tolist() for name, values in columns_of(message).items()}
    assert columns == {"t": [125_000, 250_000], "x": [4, 300], "y": [100, 2], "p": [0, 1]}


def test_a_game_is_told_in_order_and_in_its_own_colours() -> None:
    """Two poses; a picture at the second, and a command after one of no velocity; events, a collision at the end."""
    picture = np.zeros((1, 12, 24, 3), np.uint8)  # a camera of its own
    picture[..., 0], picture[..., 1] = 200, 50  # more red than green
    on = np.zeros((12, 24), np.int32)
    on[3, 7] = 9
    poses = np.array([[0.0, 0.0, -9.0], [1.0, 2.0, -8.0]]), np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    commands = Commands(np.array([0, 50]), np.array([50, 60]), np.array([[np.nan] * 3, [3.0, 4.0, 0.0]]))
    velocities = np.array([[5.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
    windows = (Window(20, np.array([[1e-8, 7, 3, 1.0]])), Window(60, None, (on, 0 * on)))
    seen: dict[str, Any] = {"image_ns": np.array([50]), "images": picture, "windows": windows}
    game = Flight("a", 1.0, np.array([0, 50]), *poses, commands, velocities, **seen, collision=(3_000_000_007, "wall"))
    told = []
    for time_ns, topic, message in entries({"case": "a"}, game):
        if "format" in message:  # blue first, as OpenCV has it; where it differs from the most of it
            shown = picture_of(message)
            odd = np.argwhere((shown != shown[0, 0]).any(axis=2))
            message["data"] = [shown.shape, shown[0, 0].tolist(), [(*at, *shown[tuple(at)]) for at in odd]]
        if "count" in message:
            message |= {name: column.tolist() for name, column in columns_of(message).items()}
        told.append(f"{time_ns} {topic} {to_json(message)}")
    assert_as_recorded("mcap_messages", "\n".join([*told, ""]))


@pytest.mark.parametrize(
    ("config", "timing", "told"),
    [
        ("suite: dp1\nseed: 4\ntiming: wall\n", None, ("dp1", 4, "wall", "measured")),
        ("suite: dp1\ntiming: wall\n", "virtual", ("dp1", 0, "virtual", "modelled")),
        ("suite: train\ntiming: virtual\ntask: {timing: wall}\n", None, ("train", 0, "wall", "measured")),
    ],
)
def test_numbers_come_with_the_clock_that_they_are_of(
    tmp_path: Path, config: str, timing: str | None, told: tuple[Any, ...]
) -> None:
    RunDirectory.create(tmp_path / "run", Config(), {"versions": {"uavaccel": "9.8"}})
    (tmp_path / "run" / "config.yaml").write_text(config)
    about = provenance_of(RunDirectory(tmp_path / "run"), timing)
    assert tuple(about[name] for name in ("suite", "seed", "timing", "numbers")) == told
    assert about["uavaccel"] == "9.8"
    assert about["config_sha256"] == hashlib.sha256(config.encode()).hexdigest()


def picture_of(message: Any) -> np.ndarray:
    assert message["format"] == "png"
    png = np.frombuffer(base64.b64decode(message["data"]), np.uint8)
    return np.asarray(cv2.imdecode(png, cv2.IMREAD_UNCHANGED))


def columns_of(message: Any) -> dict[str, np.ndarray]:
    kinds = {"x": "<u2", "y": "<u2", "t": "<u4", "p": "u1"}
    return {name: np.frombuffer(base64.b64decode(message[name]), kind) for name, kind in kinds.items()}


@needs_opengl
@pytest.mark.slow
def test_pictures_and_events_of_dp2(dp2: RunDirectory, tmp_path: Path) -> None:
    export(str(dp2.path), mcap=tmp_path / "logs")
    for row in dp2.rows():
        log, arrays = read(tmp_path / "logs" / f"{row['case']}.mcap"), dp2.load_arrays(row)
        shown = [picture_of(message) for _, message in log.messages["/camera/front_center"]]
        kept = arrays["colour"][..., ::-1] if "colour" in arrays else arrays["image"]
        np.testing.assert_array_equal(shown, kept)
        asked = vectors(log.messages["/drone/command"], "velocity_m_s")
        np.testing.assert_array_equal(asked, [[1, 0, 0], [1, 0, 0], [0, 0.5, 0]])
        windows = log.messages["/dvs/events"]
        assert len(windows) == len(arrays["image"]) - 1
        before_us = 0
        for (at, message), (_, drawn) in zip(windows, log.messages["/dvs/image"], strict=True):
            columns = columns_of(message)
            assert {len(column) for column in columns.values()} == {message["count"]}
            assert (before_us <= columns["t"]).all()
            assert (columns["t"] <= at / 1000 + 1).all()
            before_us = at // 1000
            touched = np.zeros((message["height"], message["width"]), bool)
            touched[columns["y"], columns["x"]] = True
            background = picture_of(drawn)[~touched]
            assert not len(background) or (background == background[0]).all()
        assert sum(message["count"] for _, message in windows) > 0


@needs_opengl
@pytest.mark.slow
def test_an_evaluation_is_logged_with_its_collision(tmp_path: Path) -> None:
    lane = "task.lane={obstacles: [{x_m: 3, y_m: 0, half_side_m: 0.5}]}"
    run = evaluated(tmp_path / "run", "task.max_commands=6", lane, games=1)
    assert run.rows()[0]["collision"] == "obstacle_00"
    export(str(run.path), mcap=tmp_path / "logs")
    for row in run.rows():
        log = read(tmp_path / "logs" / f"{row['case']}.mcap")
        asked = vectors(log.messages["/drone/command"], "velocity_m_s")
        headings = np.radians(np.array([-60.0, -30.0, 0.0, 30.0, 60.0])[row["actions"]])
        speed_m_s = run.config()["task"]["speed_m_s"]
        flown = speed_m_s * np.column_stack([np.cos(headings), np.sin(headings), np.zeros(len(headings))])
        np.testing.assert_allclose(asked, flown, atol=1e-12)
        north = vectors(log.messages["/drone/pose"], "pose", "position")[:, 0]
        assert north[-1] - north[0] == pytest.approx(row["distance_m"], abs=0.02)
        assert len(log.messages["/camera/front_center"]) == len(north)
        said = [message["message"] for _, message in log.messages["/log"]]
        assert said[0] == f"{row['case']} begins"
        assert said[1:] == ([f"hit {row['collision']}"] if row["collision"] else [])
        assert sum(message["count"] for _, message in log.messages["/dvs/events"]) > 0


# --- Minari -----------------------------------------------------------------------------------------------------


def load(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder.parent))
    return minari.load_dataset(folder.name)


def test_a_dataset_says_what_the_environment_says(
    straight: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Loaded by minari, its environment recovered, each episode's actions flown from its seed: the same steps."""
    export(str(straight.path), minari=tmp_path / "lane-v0")
    dataset, rows = load(tmp_path / "lane-v0", monkeypatch), straight.rows()
    assert dataset.total_episodes == len(rows)
    assert "timing" not in (gymnasium.spec("uavaccel/ObstacleLane-v0").kwargs or {}), "the environment's own spec"
    assert dataset.total_steps == sum(row["commands"] for row in rows)
    environment = dataset.recover_environment()
    assert environment.observation_space == dataset.observation_space
    assert environment.action_space == dataset.action_space
    episodes = zip(dataset.iterate_episodes(), dataset.storage.get_episode_metadata(range(2)), rows, strict=True)
    for episode, about, row in episodes:
        assert episode.actions.tolist() == row["actions"]
        assert len(episode.observations) == len(episode.actions) + 1
        assert about["options"]["lane"] == row["lane"]
        assert episode.terminations.tolist() == [False] * (row["commands"] - 1) + [True]
        assert not episode.truncations.any()
        observation, _ = environment.reset(seed=about["seed"], options={"lane": int(about["options"]["lane"])})
        np.testing.assert_array_equal(observation, episode.observations[0])
        for i, action in enumerate(episode.actions):
            environment.unwrapped.charge(0.0005)
            observation, reward, terminated, truncated, _ = environment.step(action)
            np.testing.assert_array_equal(observation, episode.observations[i + 1])
            assert (reward, terminated, truncated) == (
                episode.rewards[i],
                episode.terminations[i],
                episode.truncations[i],
            )
    environment.close()


def test_a_dataset_says_of_each_episode_and_of_itself_what_it_is(straight: RunDirectory, tmp_path: Path) -> None:
    """As another agent's game of the same actions, so that its name is the configuration's; the first is not over."""
    config, row = (straight.path / "config.yaml").read_text(), straight.rows()[1]
    renamed = other_run(
        tmp_path / "run", config.replace("agent: straight", "agent: offset:0.5"), json.dumps(row) + "\n"
    )
    (tmp_path / "a/lane-v3.unfinished/data").mkdir(parents=True)  # of an export that was killed
    for above in ("a", "b"):
        (tmp_path / above).mkdir(exist_ok=True)
        export(renamed, minari=tmp_path / above / "lane-v3")
    data = tmp_path / "a/lane-v3/data"
    for name in ("metadata.json", "main_data.hdf5"):  # the same run is the same dataset
        assert (data / name).read_bytes() == (tmp_path / "b/lane-v3/data" / name).read_bytes()
    with h5py.File(data / "main_data.hdf5") as file:
        assert list(file) == ["episode_0"]
        about = file["episode_0"].attrs
        assert (about["id"], about["options/lane"], row["lane"]) == (0, 1, 1)
        seeds = [game_seed(evaluation_of(straight, ""), number) for number in (0, 1)]
        assert about["seed"] == seeds[1] != seeds[0]
        assert about["total_steps"] == row["commands"]
    told = json.loads((data / "metadata.json").read_text())
    assert (told["dataset_id"], told["algorithm_name"], told["total_episodes"]) == ("lane-v3", "offset:0.5", 1)
    os.truncate(data / "main_data.hdf5", 10_700_000)
    _write_metadata(straight, evaluation_of(straight, ""), [], data, "lane-v3")
    assert json.loads((data / "metadata.json").read_text())["dataset_size"] == 10.7  # MB
    assert told["uavaccel"]["timing"] == straight.config()["task"]["timing"]
    assert json.loads(told["action_space"]) == {"type": "Discrete", "dtype": "int64", "start": 0, "n": 5}
    assert json.loads(told["env_spec"])["kwargs"]["clock_speed"] == 20.0


def test_an_episodes_arrays_are_of_the_environments_spaces() -> None:
    task: Any = HoverTask()
    seen = np.zeros(task.observation_space().shape, np.float32)
    told = {"given": seen, "observation": seen, "reward": 1, "terminated": 0, "truncated": 1}
    step: Any = SimpleNamespace(action=[0.1, 0.2, -0.3], **told)
    config: Any = SimpleNamespace(task=task)
    columns = _columns(config, [step, step])
    assert all(action in task.action_space() for action in columns["actions"])
    assert all(observation in task.observation_space() for observation in columns["observations"])
    kinds = {name: (array.dtype.name, len(array)) for name, array in columns.items()}
    assert kinds == {
        "observations": ("float32", 3), "actions": ("float32", 2), "rewards": ("float64", 2),
        "terminations": ("bool", 2), "truncations": ("bool", 2),
    }  # fmt: skip


@pytest.mark.slow
def test_a_game_of_the_kernels_is_flown_again_by_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = "simulator=kernels", "task.max_commands=5", "task.observation=depth", "task.also_state=true"
    run = evaluated(tmp_path / "run", *keys)
    export(str(run.path), minari=tmp_path / "kernels-v1")
    dataset = load(tmp_path / "kernels-v1", monkeypatch)
    for name, part in dataset[0].observations.items():
        assert part.shape == (len(dataset[0].actions) + 1, *dataset.observation_space[name].shape)
        assert (np.diff(part.reshape(len(part), -1), axis=0) != 0).any(axis=1).all()
    assert [episode.actions.tolist() for episode in dataset.iterate_episodes()] == [
        row["actions"] for row in run.rows()
    ]
    with pytest.raises(UserError, match="keeps no poses to log"):
        export(str(run.path), mcap=tmp_path / "logs")


# --- what cannot be ---------------------------------------------------------------------------------------------


def test_a_game_that_does_not_repeat_is_refused(straight: RunDirectory, tmp_path: Path) -> None:
    """And leaves nothing behind."""
    for name in ("config.yaml", "manifest.json"):
        (tmp_path / "run").mkdir(exist_ok=True)
        (tmp_path / "run" / name).write_bytes((straight.path / name).read_bytes())
    first = straight.rows()[0]
    changed = json.dumps({**first, "actions": [0, *first["actions"][1:]]})
    (tmp_path / "run/rows.jsonl").write_text(changed + "\n")
    with pytest.raises(UserError, match=rf"{first['case']}: flown again it differs in .*distance_m"):
        export(str(tmp_path / "run"), minari=tmp_path / "lane-v0")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def other_run(path: Path, text: str, rows: str = "") -> str:
    RunDirectory.create(path, Config(), {})
    (path / "config.yaml").write_text(text)
    (path / "rows.jsonl").write_text(rows)
    return str(path)


def test_refusals_are_one_clear_line(straight: RunDirectory, dp1: RunDirectory, tmp_path: Path) -> None:
    (tmp_path / "there-v0").mkdir()
    (tmp_path / "there.mcap").write_text("")
    flown = straight.rows()[0]
    row, (case, second) = json.dumps(flown) + "\n", [row["case"] for row in dp1.rows()][:2]
    (tmp_path / "some").mkdir()
    (tmp_path / f"some/{second}.mcap").write_text("mine")
    learned = dict.fromkeys(("exploration", "loss", "mean_q")) | {"game": 0, "environment": 0, "return": 0.0}
    game = json.dumps({**flown, "suite": "train", "case": "game-0000000", **learned}) + "\n"
    empty = other_run(tmp_path / "empty", "suite: evaluate\n")
    wall = other_run(tmp_path / "wall", "suite: evaluate\nagent: straight\ntask: {timing: wall}\n", row)
    training = other_run(tmp_path / "training", "suite: train\n", game)
    one, many, dataset = str(straight.path), str(dp1.path), tmp_path / "lane-v0"
    logs = tmp_path / "logs"
    for source, to, said in (
        (str(tmp_path / "none"), {"mcap": logs}, "not a run directory"),
        (empty, {"mcap": logs}, "holds no finished game"),
        (empty, {"minari": dataset}, "holds no finished game"),
        (wall, {"mcap": logs}, "never repeats, and this needs the games"),
        (wall, {"minari": dataset}, "never repeats, and --minari"),
        (training, {"mcap": logs}, "a run of train keeps no flights"),
        (training, {"minari": dataset}, "--minari needs the actions of an evaluation.s run, and this is one of train"),
        (many, {"minari": dataset}, "and this is one of dp1"),
        (one, {"minari": tmp_path / "there-v0"}, "there-v0: exists"),
        (one, {"minari": tmp_path / "lane"}, "named NAME-vNUMBER"),
        (one, {"minari": tmp_path / "lane-v0.5"}, "named NAME-vNUMBER"),
        (one, {"minari": tmp_path / "there.mcap/lane-v0"}, r"there\.mcap"),
        (many, {"mcap": tmp_path / "all.mcap"}, "take a folder, or one game by --case"),
        (many, {"mcap": tmp_path / "there.mcap", "case": case}, r"there\.mcap: exists"),
        (many, {"mcap": tmp_path / "there.mcap/logs"}, rf"there\.mcap/logs/{case}\.mcap: Not a directory$"),
        (many, {"mcap": tmp_path / "some"}, rf"{second}\.mcap: exists"),
        (many, {"mcap": logs, "case": "tcsc-k2"}, "--case tcsc-k2: not in"),
    ):
        with pytest.raises(UserError, match=said) as refused:
            export(source, **to)
        assert "\n" not in str(refused.value)
    others: list[dict[str, Any]] = [{"minari": dataset}, {"csv": dataset}, {"parquet": dataset}]
    for other in others:
        with pytest.raises(UsageError, match="--case: goes with --mcap"):
            export(one, **other, case="lane-000000")
    left = {"there-v0", "there.mcap", "empty", "wall", "training", "some"}
    assert {path.name for path in tmp_path.iterdir()} == left
    assert [path.read_text() for path in (tmp_path / "some").iterdir()] == ["mine"]


def test_a_missing_package_is_named(dp1: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap", None)
    with pytest.raises(UserError, match=r"^--mcap: needs mcap: pip install -e '/.*\[export\]'$"):
        export(str(dp1.path), mcap=tmp_path / "logs")
    assert not list(tmp_path.iterdir())
