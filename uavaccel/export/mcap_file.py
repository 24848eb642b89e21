"""A game as an MCAP file (mcap.dev), which Foxglove opens: one game a file, simulated time as its time.

The same game is the same bytes: nothing in it is of the hour or of the library's version. Chunks are compressed with
Zstandard, so the bytes also depend on that one's version.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2

from uavaccel.draw.film import dvs_picture
from uavaccel.errors import UserError
from uavaccel.export import foxglove
from uavaccel.export.provenance import provenance_of
from uavaccel.files import inside, read_bounded, replacing, to_json
from uavaccel.records import RunDirectory
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.suites.flight import Flight
from uavaccel.suites.registry import suite_of
from uavaccel.suites.rows import Row
from uavaccel.suites.suite import choose_row

MISSING = "--mcap needs the package mcap: pip install 'uavaccel[export]'"
EVENT_RATE_HZ = 100.0  # of the event camera beside the agent's own, where a game is flown again
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
    """A message, and when it is."""

    time_ns: int
    topic: str
    message: foxglove.Json


def write_mcap(run: RunDirectory, path: Path, case: str | None = None) -> Iterator[Path]:
    """Write the games of a run, or that `case` alone, and give each file as it is written.

    `path` is a folder, in which a game is CASE.mcap, or, for one game, a file that ends in .mcap. One game is held in
    memory at a time. Raises UserError where the run has no such game, a file exists or cannot be written, or the
    package mcap is missing.
    """
    try:
        import mcap.writer  # noqa: F401 - better said before a game is flown again
    except ImportError:
        raise UserError(MISSING) from None
    suite = suite_of(run)
    report = suite.report(run)
    rows: list[Row] = list(report.rows) if case is None else [choose_row(suite, report, case)]
    files = _files(run, path, rows)
    for row, file in zip(rows, files, strict=True):
        game = suite.flight(report, row, event_rate_hz=EVENT_RATE_HZ)
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            _write_game(run, row, game, file)
        except OSError as error:
            raise UserError(f"{file}: {error.strerror}") from error
        yield file


def _files(run: RunDirectory, path: Path, rows: list[Row]) -> list[Path]:
    """Return where each game goes. Raises UserError for one file of several games, and for a file that exists."""
    if path.suffix == ".mcap" and len(rows) > 1:
        raise UserError(f"--mcap {path}: {run.path} holds {len(rows)} games; take a folder, or one game by --case")
    files = [path] if path.suffix == ".mcap" else [inside(path, f"{row['case']}.mcap") for row in rows]
    there = next((file for file in files if file.exists()), None)
    if there is not None:
        raise UserError(f"{there}: exists; take another --mcap")
    return files


def _write_game(run: RunDirectory, row: Row, game: Flight, path: Path) -> None:
    from mcap.writer import Writer

    with replacing(path) as file:
        writer = Writer(file)
        writer.start(library="uavaccel")
        writer.add_metadata("uavaccel", _metadata(run, row))
        config = read_bounded(run.path / "config.yaml")
        writer.add_attachment(0, 0, "config.yaml", "application/yaml", config)
        schemas = {
            name: writer.register_schema(name, "jsonschema", to_json(schema).encode())
            for name, schema in foxglove.SCHEMAS.items()
        }
        channels: dict[str, int] = {}  # of what this game has
        for number, (time_ns, topic, message) in enumerate(_entries(row, game)):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schemas[TOPICS[topic]])
            writer.add_message(channels[topic], time_ns, to_json(message).encode(), time_ns, number)
        writer.finish()


def _metadata(run: RunDirectory, row: Row) -> dict[str, str]:
    """Texts by name; `row` is the game's line of rows.jsonl."""
    provenance = provenance_of(run, row.get("timing"))
    said = {name: str(value) for name, value in provenance.items() if value is not None}
    return {**said, "case": str(row["case"]), "frames": foxglove.FRAMES, "row": to_json(row)}


def _entries(row: Row, game: Flight) -> Iterator[Entry]:
    """Return all messages in the order of their time."""
    topics = (_poses(game), _commands(game), _images(game), _events(game), _said(row, game))
    return heapq.merge(*topics, key=lambda entry: entry.time_ns)


def _poses(game: Flight) -> Iterator[Entry]:
    for i, at in enumerate(game.time_ns.tolist()):
        place = (game.position_m[i], game.orientation_wxyz[i])
        yield Entry(at, "/tf", foxglove.transforms(at, *place))
        yield Entry(at, "/drone/pose", foxglove.pose(at, *place))
        if game.velocity_m_s is not None:
            yield Entry(at, "/drone/velocity", foxglove.velocity(at, game.velocity_m_s[i]))


def _commands(game: Flight) -> Iterator[Entry]:
    for at, asked in zip(game.commands.start_ns.tolist(), game.commands.velocity_m_s, strict=False):
        yield Entry(at, "/drone/command", foxglove.velocity(at, asked))


def _images(game: Flight) -> Iterator[Entry]:
    for at, picture in zip(game.image_ns.tolist(), game.images, strict=True):
        shown = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        yield Entry(at, "/camera/front_center", foxglove.image(at, shown))


def _events(game: Flight) -> Iterator[Entry]:
    for window in game.windows:
        at = window.time_ns
        if window.rows is not None:
            yield Entry(at, "/dvs/events", foxglove.events(at, window.rows, HEIGHT, WIDTH))
        counts = window.per_pixel((HEIGHT, WIDTH))
        yield Entry(at, "/dvs/image", foxglove.image(at, dvs_picture(*counts, (WIDTH, HEIGHT))))


def _said(row: Row, game: Flight) -> Iterator[Entry]:
    yield Entry(0, "/log", foxglove.log(0, foxglove.INFO, f"{row['case']} begins"))
    if game.collision:
        at, hit = game.collision
        yield Entry(at, "/log", foxglove.log(at, foxglove.WARNING, f"hit {hit}"))
