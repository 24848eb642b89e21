"""Games for other programs, as MCAP files and as a Minari dataset; both say where their numbers come from.

MCAP (mcap.dev), which Foxglove opens: one game a file, simulated time as its time. The same game is the same bytes:
nothing in it is of the hour or of the library's version, though the bytes depend on that of Zstandard, which compresses
chunks. Messages are JSON, by Foxglove's schemas (docs.foxglove.dev, "Message schemas") and three of this project's own,
in the frames of FRAMES: `ned` is the simulator's world, `enu` the same the right way up for a 3D panel.

Minari's own layout on disk (minari.farama.org, "Dataset standards"): NAME-vN/data holds metadata.json and
main_data.hdf5, in which each group `episode_i` has `observations` (one more than commands), `actions`, `rewards`,
`terminations` and `truncations`, and as attributes `id`, `seed`, `total_steps` and `options/lane`. It is written here
with h5py, game by game and deflated, since `minari` keeps whole buffers in memory and writes them as they are.
"""

from __future__ import annotations

import copy
import heapq
import json
import math
import re
import shutil
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.draw.style import dvs_picture
from uavaccel.envs.arrays import stacked_observations
from uavaccel.errors import UserError, naming
from uavaccel.files import UNFINISHED, inside, read_bounded, replacing, to_json
from uavaccel.own_code import errors_named, files_of
from uavaccel.records import RunDirectory, provenance_of
from uavaccel.resources import require
from uavaccel.rl.agents import reset_options
from uavaccel.rl.config import ENVIRONMENTS
from uavaccel.sim.camera.camera import FRONT_CENTER
from uavaccel.sim.camera.pixels import png
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.suites.evaluate import AnyRow, EvaluateConfig, Step, game_seed
from uavaccel.suites.evaluate_again import environment_of, evaluation_of, fly_again
from uavaccel.suites.experiment import Row, number_of
from uavaccel.suites.flight import Flight
from uavaccel.suites.registry import suite_of
from uavaccel.suites.suite import choose_row
from uavaccel.units import NS_PER_S

EVENT_RATE_HZ = 100.0  # of the event camera beside the agent's own, where a game is flown again
FRAMES = (
    "enu: x east, y north, z up; ned: x north, y east, z down; drone: x forward, y right, z down; "
    "front_center: x right, y down, z forward; orientations turn the body into the world"
)
HALF = math.sqrt(0.5)
NED_IN_ENU = (0.0, HALF, HALF, 0.0)  # w, x, y, z: half a turn about the diagonal of east and north
OPTICAL_IN_BODY = (0.5, 0.5, 0.5, 0.5)  # its x is the body's y, its y the body's z, its z the body's x
INFO, WARNING = 2, 3  # foxglove.LogLevel

Json = dict[str, object]


def _record(title: str, **properties: object) -> Json:
    return {"title": title, "type": "object", "properties": properties}


_TEXT, _NUMBER, _INTEGER = {"type": "string"}, {"type": "number"}, {"type": "integer"}
_BYTES = {"type": "string", "contentEncoding": "base64"}
_TIME = {"timestamp": _record("time", sec=_INTEGER, nsec=_INTEGER)}
_STAMPED = {**_TIME, "frame_id": _TEXT}
_VECTOR = _record("foxglove.Vector3", **dict.fromkeys("xyz", _NUMBER))
_QUATERNION = _record("foxglove.Quaternion", **dict.fromkeys("xyzw", _NUMBER))
_TRANSFORM = _record(
    "foxglove.FrameTransform",
    **{**_TIME, "parent_frame_id": _TEXT, "child_frame_id": _TEXT, "translation": _VECTOR, "rotation": _QUATERNION},
)
_POSE = _record("foxglove.Pose", position=_VECTOR, orientation=_QUATERNION)
_LINE = {"level": _INTEGER, "message": _TEXT, "name": _TEXT, "file": _TEXT, "line": _INTEGER}
SCHEMAS = [
    _record("foxglove.FrameTransforms", transforms={"type": "array", "items": _TRANSFORM}),
    _record("foxglove.PoseInFrame", **_STAMPED, pose=_POSE),
    _record("foxglove.CompressedImage", **_STAMPED, data=_BYTES, format=_TEXT),
    _record("foxglove.Log", **_TIME, **_LINE),
    _record("uavaccel.VelocityCommand", **_STAMPED, velocity_m_s=_VECTOR),
    _record("uavaccel.Velocity", **_STAMPED, velocity_m_s=_VECTOR),
    {
        **_record(
            "uavaccel.Events",
            **_STAMPED,
            **dict.fromkeys(("width", "height", "count"), _INTEGER),
            **dict.fromkeys("xytp", _BYTES),
        ),
        "description": "Events by column, sorted by time, little-endian: x, y uint16 pixels from the left and the "
        "top; t uint32 microseconds since the game's start; p uint8, 1 ON, 0 OFF.",
    },
]
TOPICS = {
    "/tf": "foxglove.FrameTransforms",
    "/drone/pose": "foxglove.PoseInFrame",
    "/drone/velocity": "uavaccel.Velocity",
    "/drone/command": "uavaccel.VelocityCommand",
    "/camera/front_center": "foxglove.CompressedImage",
    "/dvs/events": "uavaccel.Events",
    "/dvs/image": "foxglove.CompressedImage",
    "/log": "foxglove.Log",
}


class Entry(NamedTuple):
    time_ns: int
    topic: str
    message: Json


def write_mcap(run: RunDirectory, path: Path, case: str | None = None) -> Iterator[Path]:
    """Write the games of a run, or that `case` alone, and give each file as it is written.

    `path` is a folder, in which a game is CASE.mcap, or, for one game, a file that ends in .mcap. One game is held in
    memory at a time. Raises UserError where there is no such game, mcap is missing, or a file exists or cannot be.
    """
    require("mcap", "--mcap", "export")  # better said before a game is flown again
    suite = suite_of(run)
    report = suite.report(run)
    rows: list[Row] = list(report.rows) if case is None else [choose_row(suite, report, case)]
    if path.suffix == ".mcap" and len(rows) > 1:
        raise UserError(f"--mcap {path}: {run.path} holds {len(rows)} games; take a folder, or one game by --case")
    files = [path] if path.suffix == ".mcap" else [inside(path, f"{row['case']}.mcap") for row in rows]
    for there in filter(Path.exists, files):
        raise UserError(f"{there}: exists; take another --mcap")
    for row, file in zip(rows, files, strict=True):
        with errors_named(files_of(type(suite))):
            game = suite.flight(report, row, event_rate_hz=EVENT_RATE_HZ)
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            _write_game(run, row, game, file)
        except OSError as error:
            raise UserError(f"{file}: {error.strerror}") from error
        yield file


def _write_game(run: RunDirectory, row: Row, game: Flight, path: Path) -> None:
    from mcap.writer import Writer

    provenance = provenance_of(run, row.get("timing"))
    metadata = {name: str(value) for name, value in provenance.items() if value is not None}
    with replacing(path) as file:
        writer = Writer(file)
        writer.start(library="uavaccel")
        writer.add_metadata("uavaccel", {**metadata, "case": str(row["case"]), "frames": FRAMES, "row": to_json(row)})
        writer.add_attachment(0, 0, "config.yaml", "application/yaml", read_bounded(run.path / "config.yaml"))
        schemas = {
            each["title"]: writer.register_schema(str(each["title"]), "jsonschema", to_json(each).encode())
            for each in SCHEMAS
        }
        channels: dict[str, int] = {}  # of what this game has
        for number, (time_ns, topic, message) in enumerate(entries(row, game)):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schemas[TOPICS[topic]])
            writer.add_message(channels[topic], time_ns, to_json(message).encode(), time_ns, number)
        writer.finish()


def entries(row: Row, game: Flight) -> Iterator[Entry]:
    """Return all messages in the order of their time."""
    asked = zip(game.commands.start_ns.tolist(), game.commands.velocity_m_s, strict=False)
    seen = zip(game.image_ns.tolist(), game.images, strict=True)
    log = [(0, INFO, f"{row['case']} begins")]
    if game.collision:
        log.append((game.collision[0], WARNING, f"hit {game.collision[1]}"))
    own = {"name": "uavaccel", "file": "", "line": 0}
    topics = (
        _poses(game),
        (Entry(at, "/drone/command", _velocity(at, velocity)) for at, velocity in asked if np.isfinite(velocity).all()),
        (Entry(at, "/camera/front_center", _image(at, picture)) for at, picture in seen),
        _events(game),
        (Entry(at, "/log", _stamped(at, level=level, message=said, **own)) for at, level, said in log),
    )
    return heapq.merge(*topics, key=lambda entry: entry.time_ns)


def _poses(game: Flight) -> Iterator[Entry]:
    """Give all frames with each pose: whoever jumps to a moment is given the last message of a topic alone."""
    for i, at in enumerate(game.time_ns.tolist()):
        place, turn = _vector(game.position_m[i]), _quaternion(game.orientation_wxyz[i])
        frames = (
            ("enu", "ned", _vector((0.0, 0.0, 0.0)), _quaternion(NED_IN_ENU)),
            ("drone", "front_center", _vector(FRONT_CENTER.position_m), _quaternion(OPTICAL_IN_BODY)),
            ("ned", "drone", place, turn),
        )
        transforms = [
            _stamped(at, parent_frame_id=parent, child_frame_id=child, translation=moved, rotation=turned)
            for parent, child, moved, turned in frames
        ]
        yield Entry(at, "/tf", {"transforms": transforms})
        yield Entry(at, "/drone/pose", _stamped(at, frame_id="ned", pose={"position": place, "orientation": turn}))
        if game.velocity_m_s is not None:
            yield Entry(at, "/drone/velocity", _velocity(at, game.velocity_m_s[i]))


def _events(game: Flight) -> Iterator[Entry]:
    shape = game.images.shape[1:3] if len(game.images) else (HEIGHT, WIDTH)
    for window in game.windows:
        at = window.time_ns
        if window.rows is not None:
            yield Entry(at, "/dvs/events", _stamped(at, frame_id="front_center", **event_columns(window.rows, shape)))
        counts = window.per_pixel(shape)
        yield Entry(at, "/dvs/image", _image(at, dvs_picture(*counts)[..., ::-1]))


def _stamped(time_ns: int, **content: object) -> Json:
    seconds, nanoseconds = divmod(time_ns, NS_PER_S)
    return {"timestamp": {"sec": seconds, "nsec": nanoseconds}, **content}


def _vector(values: Sequence[float]) -> Json:
    return dict(zip("xyz", map(float, values), strict=True))


def _quaternion(wxyz: Sequence[float]) -> Json:
    return dict(zip("wxyz", map(float, wxyz), strict=True))


def _velocity(time_ns: int, velocity_m_s: Sequence[float]) -> Json:
    return _stamped(time_ns, frame_id="ned", velocity_m_s=_vector(velocity_m_s))


def _image(time_ns: int, picture: NDArray[np.uint8]) -> Json:
    """Return a picture, gray or RGB, as PNG."""
    return _stamped(time_ns, frame_id="front_center", data=b64encode(png(picture)).decode(), format="png")


def event_columns(rows: NDArray[np.floating], shape: tuple[int, int]) -> Json:
    """Return events of a camera (H, W), rows (n, 4) of t in s, x, y, p = 1 or -1, by column.

    Those of one microsecond keep their order.
    """
    t_us = np.rint(rows[:, 0].astype(np.float64) * 1e6).astype("<u4")
    order = np.argsort(t_us, kind="stable")
    x, y = rows[order, 1:3].astype("<u2").T
    packed = {"t": t_us[order], "x": x, "y": y, "p": (rows[order, 3] > 0).astype(np.uint8)}
    columns = {name: b64encode(values.tobytes()).decode() for name, values in packed.items()}
    return {"height": shape[0], "width": shape[1], "count": len(rows), **columns}


LAYOUT = "0.5.4"
"""The Minari whose layout this is: a constant of the format, and not the version that happens to be installed."""
DATASET_ID = re.compile(r"[-_\w]+-v\d+")
MAIN_FILE, METADATA = "main_data.hdf5", "metadata.json"


def write_minari(run: RunDirectory, folder: Path) -> Iterator[tuple[int, int]]:
    """Fly the games of an evaluation again and write them into `folder`; after each, how many of how many are done.

    `folder` appears once it is whole. Its name is the dataset's, such as lane-v0. Raises UserError for another name, a
    folder that exists, a run that is no evaluation or was flown in `wall`, and a game that does not repeat.
    """
    require("h5py", "--minari", "export")
    if not DATASET_ID.fullmatch(folder.name):
        raise UserError(f"--minari {folder}: a dataset's folder is named NAME-vNUMBER, as lane-v0")
    if folder.exists():
        raise UserError(f"{folder}: exists; take another --minari")
    config, rows = evaluation_of(run, "--minari"), run.rows()
    if not rows:
        raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game")
    unfinished = folder.with_name(folder.name + UNFINISHED)
    try:
        with naming(folder):
            shutil.rmtree(unfinished, ignore_errors=True)  # of an export that was killed
            (unfinished / "data").mkdir(parents=True)
            yield from _write_episodes(run, config, rows, unfinished / "data")
            _write_metadata(run, config, rows, unfinished / "data", folder.name)
            unfinished.replace(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _write_episodes(
    run: RunDirectory, config: EvaluateConfig, rows: list[AnyRow], data: Path
) -> Iterator[tuple[int, int]]:
    import h5py

    with closing(environment_of(config)) as environment, h5py.File(data / MAIN_FILE, "w", track_order=True) as file:
        for number, row in enumerate(rows):
            steps = fly_again(run, config, environment, row)
            episode = file.create_group(f"episode_{number}")
            options = reset_options(config.env_id, number_of(row)).items()
            numbers: Json = {"id": number, "seed": game_seed(config, number_of(row))}
            numbers |= {f"options/{name}": value for name, value in options}
            episode.attrs.update(numbers | {"total_steps": len(steps)})
            for name, values in _columns(config, steps).items():
                packed = {"compression": "gzip", "shuffle": True} if name.startswith("observations") else {}
                episode.create_dataset(name, data=values, **packed)
            yield number + 1, len(rows)


def _columns(config: EvaluateConfig, steps: Sequence[Step]) -> dict[str, Any]:
    """Return an episode's arrays by name; the observations of a mapping are below "observations/"."""
    seen = stacked_observations([steps[0].given, *(step.observation for step in steps)])
    parts = {f"observations/{name}": part for name, part in seen.items()} if isinstance(seen, Mapping) else {}
    return {
        **(parts or {"observations": seen}),
        "actions": np.array([step.action for step in steps], config.task.action_space().dtype),
        "rewards": np.array([step.reward for step in steps], np.float64),
        "terminations": np.array([step.terminated for step in steps], bool),
        "truncations": np.array([step.truncated for step in steps], bool),
    }


def _write_metadata(run: RunDirectory, config: EvaluateConfig, rows: list[AnyRow], data: Path, name: str) -> None:
    made = {}
    if config.env_id in ENVIRONMENTS:  # which whoever reads the dataset can make by its name
        spec = copy.deepcopy(gymnasium.spec(config.env_id))
        spec.kwargs = config.task.model_dump(mode="json")
        made = {"env_spec": spec.to_json()}
    observations, actions = config.task.observation_space(), config.task.action_space()
    metadata = {
        "total_episodes": len(rows),
        "total_steps": sum(len(row["actions"]) for row in rows),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "observation_space": json.dumps(_plain_space(observations)),
        "action_space": json.dumps(_plain_space(actions)),
        **made,
        "dataset_id": name,
        "minari_version": LAYOUT,
        "algorithm_name": config.agent,
        "dataset_size": round((data / MAIN_FILE).stat().st_size / 1e6, 1),
        "description": "Games of an evaluation of uavaccel, flown again from their seeds and actions.",
        "uavaccel": provenance_of(run),
    }
    (data / METADATA).write_text(to_json(metadata) + "\n", encoding="utf-8")


def _plain_space(space: spaces.Space[Any]) -> dict[str, object]:
    """Return a space as Minari's metadata has it: a Box, a Dict of these, or the Discrete actions of a lane.

    Bounds may be infinite, which Minari reads as Python's json writes it.
    """
    if isinstance(space, spaces.Discrete):
        return {"type": "Discrete", "dtype": "int64", "start": int(space.start), "n": int(space.n)}
    if isinstance(space, spaces.Dict):
        return {"type": "Dict", "subspaces": {name: _plain_space(part) for name, part in space.spaces.items()}}
    assert isinstance(space, spaces.Box)
    return {
        "type": "Box",
        "dtype": str(space.dtype),
        "shape": list(space.shape),
        "low": space.low.tolist(),
        "high": space.high.tolist(),
    }
