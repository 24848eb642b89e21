"""Films: what a frame shows where, H.264 that decodes to what was drawn, the contact sheet, and the map's geometry."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from tests.running import full_device
from uavaccel.draw import film as films
from uavaccel.draw.film import Film, frames, movie, poster, write_contact_sheet, write_video
from uavaccel.draw.page import Movie, to_html
from uavaccel.draw.style import Decisions, dvs_picture
from uavaccel.errors import UserError
from uavaccel.files import UNFINISHED
from uavaccel.sim.clutter import PARKED_Z_M, Clutter, Z, sample_world
from uavaccel.sim.lane import sample_layout

LOOKS = Path(__file__).parent / "data/frames.png"
SAMPLES = 30
TWICE = np.ones((2, 2, 1), np.uint8)


def flown(samples: int = SAMPLES, colour: bool = False) -> Film:
    """A ramp that moves, ON events left and OFF events right, 1.5 m and 0.33 s a sample."""
    ramp = np.arange(256)[None, :] + np.arange(144)[:, None]
    images = np.stack([(ramp + 4 * i) % 256 for i in range(samples)]).astype(np.uint8)
    if colour:
        images = np.stack([images, images // 2, 255 - images], axis=-1)
    on, off = np.zeros((2, samples, 144, 256), np.uint16)
    on[1:, :, :128], off[1:, :, 128:] = 3, 3
    position_m = np.column_stack([1.5 * np.arange(samples), np.zeros(samples), np.full(samples, -2.0)])
    return Film("A title", np.arange(samples) * np.float64(0.33), images, on, off, position_m, sample_layout(3))


def test_what_a_frame_says(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    def write(page: np.ndarray, text: str, at: tuple[int, int], size: float, *_: Any, anchor: float = 0.0) -> None:
        said.append(text)
        width = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0]
        assert 0 <= at[0] - anchor * width <= page.shape[1] - width, f"{text} leaves the frame"

    monkeypatch.setattr(films, "write", write)
    list(frames(flown(samples=3)))
    assert said[0] == "A title"
    # Two steps of 0.33 s in two twelfths of a second.
    assert said[-2:] == ["  0.33 s,   1.5 m, shown at 4.0x", "  0.66 s,   3.0 m, shown at 4.0x"]


def decided(of_sample: list[int], given: bool = True) -> Decisions:
    """Two commands, to the east and then ahead, of three headings that are not in order."""
    planes = np.stack([np.full((2, 3, 36, 64), 10 * (1 + command), np.uint8) for command in (0, 1)])[:, 0]
    planes[:, 1] += 100  # the second plane of three
    ratings = np.array([[3.0, 3.5, 4.0], [1.5, 1.25, 1.0]])
    taken, headings = np.array([2, 0]), (0.0, -30.0, 30.0)
    return Decisions(ratings, taken, headings, np.array(of_sample), "action values", planes if given else None)


def test_outside_of_a_lane_the_map_is_of_the_whole_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is parked is not in the world; below the title is how far it is to what is to be reached."""
    said: list[str] = []
    monkeypatch.setattr(films, "write", lambda page, text, *_, **__: said.append(text))
    world = sample_world(1, Clutter(), (30.0, 10.0, -2.0))
    parked = replace(world, rows=world.rows.copy())
    parked.rows[:, Z] = PARKED_Z_M
    film = replace(flown(samples=3), target_m=[30.0, 10.0, -2.0])
    of_nothing, standing, gone = ([*frames(replace(film, layout=each))] for each in (None, world, parked))
    assert not np.array_equal(standing, of_nothing)
    assert np.array_equal(gone, of_nothing)
    assert "the whole lane, start on the left" not in said
    assert said[-1].startswith("  0.66 s,  28.8 m to go, shown at")


def test_the_frame_of_an_impact_is_held() -> None:
    plain, shown = list(frames(flown(samples=3))), list(frames(replace(flown(samples=3), hit="obstacle_03")))
    assert len(shown) == 2 + 24
    assert np.array_equal(shown[:2], plain[:2])
    assert all(np.array_equal(frame, shown[2]) for frame in shown[3:])


def test_frames_and_sheets_look_as_they_did_when_they_were_seen(tmp_path: Path) -> None:
    """Means of 32 by 18 parts of each, every colour's, within a few steps of those that are recorded."""
    film = flown(samples=7, colour=True)
    time_s, wide = np.float64(0.4) * np.arange(7.0) ** 1.5, np.linspace(0.0, 1.0, 7)[:, None]
    film = replace(film, title="A way", time_s=time_s, position_m=film.position_m + wide * [2.5, -3.0, -4.0])
    film.on_events[2, :40], film.off_events[5, 100:] = 1, 2
    rated = replace(decided([0, 0, 0, 0, 1, 1, 1]), rated_as="chances")
    behind = replace(film, chase=lambda number: np.full((288, 512, 3), (200, 100, 30 * number), np.uint8))
    clutter = sample_world(1, Clutter(), (30.0, 10.0, -2.0))
    of = {
        "lane": film, "hit": replace(behind, hit="obstacle_03"), "rated": replace(behind, decisions=rated),
        "not given": replace(film, decisions=decided([0, 0, 0, 0, 1, 1, 1], given=False)),
        "clutter": replace(behind, layout=clutter, target_m=[30.0, 10.0, -2.0], decisions=rated),
        "nothing": replace(film, layout=None, hit="x"),
    }  # fmt: skip
    shown: dict[str, Any] = {
        f"{name} {place}": [*frames(each)][place] for name, each in of.items() for place in (2, -1)
    }
    shown["sheet"] = cv2.imread(str(write_contact_sheet(replace(film, hit="x"), tmp_path / "sheet.png")))
    parts = {name: cv2.resize(frame, (32, 18), interpolation=cv2.INTER_AREA) for name, frame in shown.items()}
    if os.environ.get("RECORD"):
        cv2.imwrite(str(LOOKS), np.vstack([*parts.values()]))
    recorded = cv2.imread(str(LOOKS))
    assert recorded is not None
    for name, one, other in zip(parts, parts.values(), np.split(recorded, len(parts)), strict=True):
        assert np.abs(one.astype(int) - other).max() <= 4, name


# --- the file -----------------------------------------------------------------------------------------------


def test_a_film_is_h264_that_decodes_to_what_was_drawn(tmp_path: Path) -> None:
    film = flown()
    path = write_video(film, tmp_path / "films" / "one.mp4")
    assert [file.name for file in path.parent.iterdir()] == ["one.mp4"]
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        context = stream.codec_context
        assert (context.name, context.pix_fmt, context.width, context.height) == ("h264", "yuv420p", 1280, 480)
        assert (float(stream.average_rate or 0), stream.frames) == (12.0, SAMPLES)
        decoded = [frame.to_ndarray(format="bgr24") for frame in file.decode(stream)]
    assert len(decoded) == SAMPLES
    for seen, drawn in zip(decoded, frames(film), strict=True):
        difference = np.abs(seen.astype(int) - drawn)
        assert difference.mean() < 3
        for x in (600, 1000, 700):  # ON, OFF and paper: the decoder knows which colours were meant
            assert difference[50 if x == 700 else 200, x].max() <= 6
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # plays before it is all there
    assert len(data) < 10_000 * SAMPLES
    assert write_video(film, tmp_path / "two.mp4").read_bytes() == data


def test_no_film_is_larger_than_the_largest_however_noisy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert films.LARGEST == 3_000_000
    monkeypatch.setattr(films, "LARGEST", 400_000)
    noise = np.random.default_rng(0).integers(0, 256, (60, 144, 256), np.uint8)
    path = write_video(replace(flown(samples=60), images=noise), tmp_path / "noise.mp4")
    assert 250_000 < path.stat().st_size < 400_000
    with av.open(str(path)) as file:
        assert len(list(file.decode(video=0))) == 60


def test_a_films_poster_is_its_middle_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    film = flown()
    path = write_video(film, tmp_path / "one.mp4")
    picture = cv2.imdecode(np.frombuffer(poster(path), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    drawn = [cv2.resize(frame, (960, 360), interpolation=cv2.INTER_AREA).astype(int) for frame in frames(film)]
    apart = [np.abs(frame - picture).mean() for frame in drawn]
    assert (np.argmin(apart) in range(13, 18), min(apart) < 4) == (True, True)
    page = to_html("A page.", [Movie(path, path, "A film.")])
    for missing in ("av", "uavaccel.draw.film"):  # without the extra `film` a browser shows the first frame
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, missing, None)
            bare = to_html("A page.", [Movie(path, path, "A film.")])
        assert ("poster=" in page, "poster=" in bare, "<video" in bare) == (True, False, True)
    path.write_bytes(b"no film")
    assert poster(path) == b""


def test_a_film_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = write_video(flown(samples=2), tmp_path / "one.mp4")
    before = path.read_bytes()
    broken = replace(flown(samples=3), chase=lambda number: np.empty((0, 4, 4, 3), np.uint8)[number])
    with pytest.raises(IndexError):
        write_video(broken, path)
    assert path.read_bytes() == before
    with pytest.raises(UserError, match=r"one\.mp4/two\.mp4: cannot be written: "):
        write_video(broken, path / "two.mp4")


def test_a_full_disk_is_one_line_whatever_is_caught(tmp_path: Path) -> None:
    full_device(tmp_path / f"film.mp4{UNFINISHED}")

    def write() -> None:
        with movie(tmp_path / "film.mp4", (64, 48), 12) as add:
            for _ in range(60):  # x264 looks ahead by 40
                with suppress(Exception):
                    add(np.zeros((48, 64, 3), np.uint8))

    with pytest.raises(UserError, match=r"film\.mp4\S*: No space left on device; make room$"):
        write()
    assert not [*tmp_path.iterdir()]


def test_a_contact_sheet_shows_moments_to_the_last(tmp_path: Path) -> None:
    film = flown()
    sheet = cv2.imread(str(write_contact_sheet(film, tmp_path / "sheets" / "one.png")))
    assert sheet is not None
    assert sheet.shape == (44 + 4 * (2 * 144 + 34), 10 + 5 * 266, 3)
    for place, i in ((0, 1), (6, round(1 + 6 * 28 / 19)), (19, 29)):  # 20 moments from sample 1 to sample 29
        x, y = 10 + place % 5 * 266, 44 + place // 5 * 322 + 24
        camera, events = sheet[y : y + 144, x : x + 256], sheet[y + 144 : y + 288, x : x + 256]
        assert np.array_equal(camera, np.repeat(film.images[i, :, :, None], 3, axis=2))
        assert np.array_equal(events, dvs_picture(film.on_events[i], film.off_events[i]))
    short = cv2.imread(str(write_contact_sheet(flown(samples=1), tmp_path / "two.png")))
    assert short is not None
    assert short.shape[0] == 44 + 322
