"""Run directories: rows and arrays read back, equal values are equal bytes, a crash leaves them resumable."""

import json
import math
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch as th
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from uavaccel.config import Config, load_yaml
from uavaccel.errors import UserError
from uavaccel.files import (
    ARRAYS_BYTES,
    LINES_BYTES,
    TEXT_BYTES,
    append_lines,
    file_sha256,
    inside,
    lock_of,
    open_bounded,
    read_arrays,
    read_lines,
    replacing,
    to_json,
    write_arrays,
)
from uavaccel.fly.script import compiled
from uavaccel.machine import describe_run, gpu
from uavaccel.records import RunDirectory
from uavaccel.wire.settings import LARGEST_BYTES, read_settings

pytestmark = pytest.mark.usefixtures("whole_messages")


class Clock(Config):
    speed: float = 1.0
    note: str = ""


class Flight(Config):
    games: int = 3
    clock: Clock = Clock()


class Chosen(Config):
    cells: tuple[str, ...] = ()


MANIFEST = {"seed": 7}
FINITE = st.floats(allow_nan=False, allow_infinity=False)
SCALARS = st.none() | st.booleans() | st.integers() | FINITE | st.text()
ROWS = st.dictionaries(st.text(), SCALARS | st.lists(SCALARS, max_size=3), max_size=6)


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    return RunDirectory.create(tmp_path / "run", Flight(), MANIFEST)


def resume(run: RunDirectory, config: Config | None = None) -> RunDirectory:
    return RunDirectory.create(run.path, config or Flight(), MANIFEST, resume=True)


# --- creating and resuming ----------------------------------------------------------------------------------


def test_a_new_run_holds_its_configuration_and_manifest(run: RunDirectory) -> None:
    assert (run.path / "config.yaml").read_text() == "games: 3\nclock:\n  speed: 1.0\n  note: ''\n"
    assert run.config() == {"games": 3, "clock": {"speed": 1.0, "note": ""}}
    assert run.manifest() == MANIFEST
    assert run.rows() == run.timings() == []
    assert run.done_cases() == set()


@pytest.mark.parametrize(
    ("name", "resume", "said"),
    [
        ("", False, "exists; take another --out, or --resume"),
        ("", True, r"not a run directory, but holds thesis\.tex"),
        ("thesis.tex", True, "File exists"),
        ("thesis.tex/below", False, "Not a directory"),
    ],
)
def test_what_is_in_the_way_is_refused_and_left_alone(tmp_path: Path, name: str, resume: bool, said: str) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(UserError, match=said):
        RunDirectory.create(tmp_path / name, Flight(), MANIFEST, resume=resume)
    with pytest.raises(UserError, match=r"not a run directory: no config\.yaml in it"):
        RunDirectory(tmp_path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["thesis.tex"]


def test_resume_keeps_the_rows_and_says_what_it_was_gone_on_with(run: RunDirectory) -> None:
    run.append_row({"case": "a"})
    for seed in (8, 9):
        again = RunDirectory.create(run.path, Flight(), {"seed": seed}, resume=True)
    assert again.done_cases() == {"a"}
    assert again.manifest() == {"seed": 7, "resumed": [{"seed": 8}, {"seed": 9}]}


def test_resume_with_another_configuration_names_what_differs(run: RunDirectory, tmp_path: Path) -> None:
    before = (run.path / "config.yaml").read_bytes()
    other = Flight(games=5, clock=Clock(speed=50.0))
    with pytest.raises(UserError, match=r"clock\.speed \(1\.0 there, 50\.0 here\), games \(3 there, 5 here\)"):
        resume(run, other)
    with pytest.raises(UserError, match=r"clock\.note \(\"\" there, unset here\)"):
        resume(run, Clock())
    shrunk = "games = 2: 3 were asked for before, and a run that goes on can only have more; leave it out"
    other_key = r"games \(3 there, 5 here\)"
    for games, may_grow, said in ((2, {"games": ""}, shrunk), (5, {"clock.speed": ""}, other_key)):
        with pytest.raises(UserError, match=said):
            RunDirectory.create(run.path, Flight(games=games), MANIFEST, resume=True, may_grow=may_grow)
    assert (run.path / "config.yaml").read_bytes() == before
    grown = RunDirectory.create(run.path, Flight(games=5), MANIFEST, resume=True, may_grow={"games": ""})
    assert (run.path / "config.yaml").read_bytes() == before.replace(b"games: 3", b"games: 5")
    for some, more in ((("a",), ("a", "b")), (("a", "b"), ())):  # none are all there are
        for cells in (some, more):
            resumed = RunDirectory.create(tmp_path / "cells", Chosen(cells=cells), {}, True, {"cells": ""})
        with pytest.raises(UserError, match=r"cells = .* and a run that goes on can only have more"):
            RunDirectory.create(tmp_path / "cells", Chosen(cells=("c",)), {}, resume=True, may_grow={"cells": ""})
    assert resumed.config() == {"cells": []}
    with pytest.raises(UserError, match=r'cells = \["a"\]: \[\] were asked for before'):
        RunDirectory.create(tmp_path / "cells", Chosen(cells=("a",)), {}, resume=True, may_grow={"cells": ""})
    (run.path / "config.yaml").write_text("gams: 3\n")  # of a version that had another name for them
    with pytest.raises(UserError, match=r"games \(unset there, 5 here\), gams \(3 there, unset here\)"):
        RunDirectory.create(run.path, Flight(games=5), MANIFEST, resume=True, may_grow={"games": ""})
    (run.path / "config.yaml").write_text("games: 5\n")  # of a version that had no clock
    assert resume(grown, Flight(games=5)).config() == {"games": 5}
    for damaged in ("x", "[[1]]", ".nan", "null"):
        (run.path / "config.yaml").write_text(f"games: {damaged}\n")
        with pytest.raises(UserError, match=r"has another configuration: .*games \(.* there, 5 here\)"):
            RunDirectory.create(run.path, Flight(games=5), MANIFEST, resume=True, may_grow={"games": ""})


# --- rows ---------------------------------------------------------------------------------------------------


@settings(max_examples=5)
@given(rows=st.lists(ROWS, min_size=10, max_size=20))
def test_rows_read_back_equal_whatever_the_order_of_their_keys(
    rows: list[dict[str, Any]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    run = RunDirectory.create(tmp_path_factory.mktemp("rows") / "run", Flight(), MANIFEST)
    named = [{**row, "case": str(number)} for number, row in enumerate(rows)]
    for row in named:
        run.append_row(row)
        for each in (row, row | {"loss": np.nan}):
            assert to_json(dict(reversed(each.items()))) == to_json(each)
    assert run.rows() == named


def test_rows_are_lines_in_their_order_one_for_each_case(run: RunDirectory) -> None:
    for case in ("b", "a", "c"):
        run.append_row({"error": None, "case": case, "wall_s": 0.1}, on_disk=case != "a")
        assert [row["case"] for row in run.rows()] == {"b": ["b"], "a": ["b"], "c": ["b", "a", "c"]}[case]
    with pytest.raises(ValueError, match="case a has a row already"):
        run.append_row({"case": "a"})
    with pytest.raises(TypeError, match="not JSON serializable"):
        run.append_row({"case": "d", "path": Path("x")})
    lines = (run.path / "rows.jsonl").read_text().splitlines()
    assert lines[0] == '{"case": "b", "error": null, "wall_s": 0.1}'
    assert [json.loads(line)["case"] for line in lines] == ["b", "a", "c"]
    assert RunDirectory(run.path).done_cases() == run.done_cases() == {"a", "b", "c"}
    (run.path / "rows.jsonl").write_text("\n".join([*lines, lines[0], ""]))
    for look in (lambda path: RunDirectory(path).rows(), lambda path: resume(run)):
        with pytest.raises(UserError, match=r"rows\.jsonl: line 4: b has a row already"):
            look(run.path)


def test_numpy_values_become_plain_and_non_finite_ones_null(run: RunDirectory) -> None:
    run.append_row(
        {
            "case": "a",
            "float64": np.float64(0.1),
            "float32": np.float32(0.1),
            "integer": np.int64(2**53 + 1),
            "truth": np.bool_(True),
            "array": np.array([[1.0, math.nan], [math.inf, -0.0]]),
            "pair": (1, -math.inf),
        }
    )
    assert run.rows() == [
        {
            "case": "a",
            "float64": 0.1,
            "float32": float(np.float32(0.1)),
            "integer": 2**53 + 1,
            "truth": True,
            "array": [[1.0, None], [None, -0.0]],
            "pair": [1, None],
        }
    ]


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_the_first_rows_can_be_kept_with_their_times_alone(run: RunDirectory, count: int) -> None:
    for case in "abc":
        run.append_row({"case": case})
        run.append_timing({"case": case, "load": 0.5})
    run.truncate_to(count)
    for again in (run, RunDirectory(run.path)):
        assert [row["case"] for row in again.rows()] == list("abc"[:count])
        assert [entry["case"] for entry in again.timings()] == list("abc"[:count])
        assert again.done_cases() == {*"abc"[:count]}


# --- crashes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kept", range(len('{"case": "c", "wall_s": 1.5}')))
def test_a_row_cut_short_anywhere_is_flown_again(run: RunDirectory, kept: int) -> None:
    """Its times too, which are written beside it."""
    rows = [{"case": case, "wall_s": 1.5} for case in ("a", "b", "c")]
    for row in rows:
        run.append_row(row)
        run.append_timing(row)
    whole = (run.path / "rows.jsonl").read_bytes()
    last = whole.rindex(b"\n", 0, -1) + 1
    for name in ("rows.jsonl", "timing.jsonl"):
        (run.path / name).write_bytes(whole[: last + kept])

    assert RunDirectory(run.path).done_cases() == {"a", "b"}
    again = resume(run)
    assert again.done_cases() == {"a", "b"}
    again.append_row(rows[2])
    again.append_timing(rows[2])
    for name in ("rows.jsonl", "timing.jsonl"):
        assert (run.path / name).read_bytes() == whole


def test_a_crash_before_its_row_leaves_a_case_to_be_flown(run: RunDirectory) -> None:
    run.save_arrays("a", {"time_s": np.zeros(3)})
    (run.path / "arrays" / "b.npz.unfinished").write_bytes(b"PK half")
    again = resume(run)
    assert again.done_cases() == set()
    assert [entry.name for entry in (run.path / "arrays").iterdir()] == ["a.npz"]
    again.append_row({"case": "a", **again.save_arrays("a", {"time_s": np.ones(3)})})
    np.testing.assert_array_equal(again.load_arrays(again.rows()[0])["time_s"], np.ones(3))


def test_a_crash_before_a_whole_configuration_starts_afresh(tmp_path: Path) -> None:
    path = tmp_path / "run"
    path.mkdir()
    (path / "config.yaml.unfinished").write_text("gam")
    assert resume(RunDirectory.create(path, Flight(), MANIFEST, resume=True)).config()["games"] == 3


def test_a_crash_before_the_manifest_is_made_good(run: RunDirectory) -> None:
    (run.path / "manifest.json").unlink()
    assert resume(run).manifest() == MANIFEST


def test_a_writer_that_fails_leaves_the_old_file(run: RunDirectory) -> None:
    row = {"case": "a", **run.save_arrays("a", {"time_s": np.zeros(3)})}
    with pytest.raises(ValueError, match="Object arrays cannot be saved"):
        run.save_arrays("a", {"position_m": np.ones(3), "time_s": np.array([object()])})
    assert list(run.load_arrays(row)) == ["time_s"]
    assert [file.name for file in (run.path / "arrays").iterdir()] == ["a.npz"], "no half file takes a full disk's room"


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        *((b"\x00\x00\n", "not JSON"), (b"3\n", "not a JSON object"), (b"{}\n", "no name")),
        *((b'{"case": 3}\n', "no name"), pytest.param(bytes(1 << 24), "16,777,216 bytes each", id="long")),
    ],
)
def test_a_damaged_line_is_named(run: RunDirectory, damage: bytes, said: str) -> None:
    run.append_row({"case": "a"})
    with (run.path / "rows.jsonl").open("ab") as file:
        file.write(damage)
    with pytest.raises(UserError, match=rf"rows\.jsonl: line 2: .*{said}"):
        RunDirectory(run.path).rows()


# --- arrays -------------------------------------------------------------------------------------------------


@given(
    array=hnp.arrays(
        dtype=st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_]),
        shape=hnp.array_shapes(min_dims=0, max_dims=3, min_side=0),
    )
)
def test_arrays_read_back_equal_and_equal_arrays_are_equal_bytes(
    array: np.ndarray, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("arrays")
    write_arrays(folder / "one.npz", {"a": array, "b": np.arange(3)})
    write_arrays(folder / "two.npz", {"b": np.arange(3), "a": np.asarray(array, order="F")})
    assert (folder / "one.npz").read_bytes() == (folder / "two.npz").read_bytes()
    read = read_arrays(folder / "one.npz")
    assert list(read) == ["a", "b"]
    with zipfile.ZipFile(folder / "one.npz") as archive:
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    np.testing.assert_array_equal(read["a"], array, strict=True)


def test_missing_and_damaged_arrays_are_named(run: RunDirectory) -> None:
    mend = r"delete the row's line and --resume the run$"
    with pytest.raises(UserError, match=rf"a\.npz: cannot be read: No such file or directory; {mend}"):
        run.load_arrays({"case": "a", "arrays": "arrays/a.npz"})
    row = {"case": "a", **run.save_arrays("a", {"time_s": np.zeros(100)})}
    name = row["arrays"]
    whole = (run.path / name).read_bytes()
    for damaged in (whole[:100], whole.replace(bytes(8), b"damaged!", 1), b""):
        (run.path / name).write_bytes(damaged)
        with pytest.raises(UserError, match=rf"a\.npz: cannot be read: .*{mend}"):
            run.load_arrays(row)


def test_arrays_that_are_not_the_row_s_own_are_named(run: RunDirectory) -> None:
    rows = [{"case": case, **run.save_arrays(case, {"time_s": np.full(3, n)})} for n, case in enumerate("ab")]
    with pytest.raises(UserError, match=r"rows\.jsonl: a: has the arrays of another case, arrays/b\.npz"):
        run.load_arrays({**rows[0], "arrays": rows[1]["arrays"]})
    (run.path / rows[0]["arrays"]).write_bytes((run.path / rows[1]["arrays"]).read_bytes())
    with pytest.raises(UserError, match=r"a\.npz: is not the file of its row: another hash"):
        run.load_arrays(rows[0])
    np.testing.assert_array_equal(run.load_arrays(rows[1])["time_s"], np.ones(3))


def test_a_folder_that_was_deleted_is_not_begun_again(run: RunDirectory) -> None:
    shutil.rmtree(run.path)
    for write in (
        lambda: run.append_row({"case": "a"}),
        lambda: run.save_arrays("a", {"time_s": np.zeros(3)}),
        lambda: run.write_text("report.md", "text"),
    ):
        with pytest.raises(UserError, match="was deleted"):
            write()
    assert not run.path.exists()


def test_a_run_has_one_process_that_flies_it(
    run: RunDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lock goes with its process, even a killed one; within a process a run may be gone on with."""
    program = (
        "import sys\nfrom uavaccel.files import lock_of\nfrom pathlib import Path\n"
        "held = lock_of(Path(sys.argv[1]))\nprint('held', flush=True)\nsys.stdin.read()"
    )
    resume(run)
    monkeypatch.chdir(tmp_path)
    RunDirectory.create("run", Flight(), MANIFEST, resume=True)  # by whatever name
    moved = run.path.rename("moved")
    RunDirectory.create(moved, Flight(), MANIFEST, resume=True)
    command = [sys.executable, "-c", program, str(moved)]
    refused = subprocess.run(command, input="", capture_output=True, text=True, check=False)
    assert "UserError" in refused.stderr
    assert "another process is flying this run" in refused.stderr
    other = tmp_path / "other"
    other.mkdir()
    with subprocess.Popen([*command[:-1], str(other)], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(UserError, match="another process is flying this run"):
            lock_of(other)
        process.kill()
        process.wait()
    lock_of(other)


# --- single files -------------------------------------------------------------------------------------------


def test_json_files_read_back_are_stable_and_named_where_damaged(run: RunDirectory) -> None:
    path = run.write_json("traces/adsc.json", [{"wall_s": np.float64(0.5), "event": "call"}])
    assert path.read_text() == '[\n  {\n    "event": "call",\n    "wall_s": 0.5\n  }\n]\n'
    assert run.read_json("traces/adsc.json") == [{"event": "call", "wall_s": 0.5}]
    with pytest.raises(UserError, match=r"summary\.json: No such file"):
        run.read_json("summary.json")
    run.write_text("summary.json", "{")
    with pytest.raises(UserError, match=r"summary\.json: not JSON"):
        run.read_json("summary.json")
    run.write_text("manifest.json", "[]")
    with pytest.raises(UserError, match=r"manifest\.json: should be a mapping"):
        resume(run)


# --- manifest -----------------------------------------------------------------------------------------------


def test_the_manifest_names_versions_and_host(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 5, 9}, raising=False)  # as in a container
    manifest = describe_run(["uavaccel", "run", "dp1"], 7, "2026-11-21T10:00:00+00:00", gl_renderer="llvmpipe")
    assert json.loads(to_json(manifest)) == manifest
    assert manifest["seed"] == 7
    assert manifest["gl_renderer"] == "llvmpipe"
    assert manifest["versions"]["numpy"] == np.__version__
    assert manifest["host"]["cores"] == 3
    assert manifest["host"]["memory_bytes"] > 0
    assert "LP_NUM_THREADS" in manifest["environment"]


def test_the_manifest_names_the_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    assert gpu("cpu") == gpu("mps") == {}
    found = SimpleNamespace(name="H100", uuid="e1b2")
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.get_device_properties", lambda device: found)
    monkeypatch.setattr("torch.backends.cudnn.version", lambda: 91900)
    versions = {"cuda": th.version.cuda, "cudnn": 91900}
    named = {"gpu": {"name": "H100", "uuid": "e1b2", **versions}}
    assert gpu("cuda") == named
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    assert gpu("cuda") == {}, "a process takes one later"
    monkeypatch.setattr("torch.cuda.is_initialized", lambda: True)
    assert gpu("cuda:1") == named


def test_the_manifest_names_the_commit_and_whether_files_differ(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> str:
        identity = ["-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false"]
        command = ["git", "-C", str(tmp_path), *identity, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    monkeypatch.setattr("uavaccel.machine.source_tree", lambda: tmp_path)
    assert describe_run([], 0, "")["git"] is None
    git("init")
    (tmp_path / "file").write_text("one")
    git("add", "file")
    git("commit", "--message", "one")
    (tmp_path / "run").write_text("which git does not know")
    assert describe_run([], 0, "")["git"] == {"commit": git("rev-parse", "HEAD"), "dirty": False}
    (tmp_path / "file").write_text("two")
    assert describe_run([], 0, "")["git"]["dirty"] is True
    monkeypatch.setattr("uavaccel.machine.source_tree", lambda: None)
    assert describe_run([], 0, "")["git"] is None


# --- folders and files from elsewhere -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("read", "most"),
    [
        (load_yaml, TEXT_BYTES),
        (compiled, TEXT_BYTES),
        (read_settings, LARGEST_BYTES),
        (read_lines, LINES_BYTES),
        (read_arrays, ARRAYS_BYTES),
        (file_sha256, ARRAYS_BYTES),
    ],
)
def test_what_is_no_file_or_a_huge_one_is_not_read(read: Any, most: int, tmp_path: Path) -> None:
    pipe, huge = tmp_path / "pipe", tmp_path / "huge"
    os.mkfifo(pipe)
    with huge.open("wb") as file:
        file.truncate(most + 1)
    for path, said in (
        (pipe, "no regular file"),
        (Path("/dev/zero"), "no regular file"),
        (huge, f"has {most + 1:,} bytes, where at most {most:,} are read"),
    ):
        with pytest.raises(UserError, match=f"^{path}: {said}$"):
            read(path)


def test_a_file_as_large_as_may_be_is_read(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"1234")
    with open_bounded(tmp_path / "file", 4) as file:
        assert file.read() == b"1234"


def test_an_archive_that_unpacks_to_too_much_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_arrays(tmp_path / "a.npz", {"a": np.zeros(100_000, np.uint8)})
    monkeypatch.setattr("uavaccel.files.ARRAYS_BYTES", 10_000)
    with pytest.raises(UserError, match="unpacks to more than 10,000 bytes"):
        read_arrays(tmp_path / "a.npz")


@pytest.mark.parametrize("name", ["../x", "/tmp/x", "..", ".", "", "a/../../x", "link/x", "circle/x", "a\0b"])
def test_a_file_outside_of_its_folder_is_refused(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    (folder / "circle").symlink_to("circle")
    with pytest.raises(UserError, match="would be a file outside of"):
        inside(folder, name)
    assert inside(folder, "a/../b") == folder / "a/../b"


@pytest.mark.parametrize("case", ["../../x", "/tmp/x", "a/b", "..", "", "a\n", "a\0"])
def test_a_row_whose_case_is_no_name_of_a_file_is_refused(run: RunDirectory, case: str) -> None:
    append_lines(run.path / "rows.jsonl", [json.dumps({"case": case})])
    with pytest.raises(UserError, match=r"line 1: no game can be called .*: its name is that of a file"):
        RunDirectory(run.path).done_cases()


def test_nothing_is_written_through_a_link(run: RunDirectory, tmp_path: Path) -> None:
    """A folder from elsewhere may have one in the place of any of its files."""
    outside = tmp_path / "outside"
    (run.path / "rows.jsonl").symlink_to(outside)
    (run.path / "summary.json.unfinished").symlink_to(outside)
    (run.path / "figures").symlink_to(tmp_path)
    for write in (
        lambda: run.append_row({"case": "a"}),
        lambda: run.write_json("summary.json", {}),
        lambda: run.write_text("figures/outside", ""),
    ):
        with pytest.raises(UserError):
            write()
    (run.path / "report.md").symlink_to(outside)
    with replacing(run.path / "report.md") as file:  # a link to a file is replaced itself
        file.write(b"x")
    assert not outside.exists()


def test_a_folder_in_a_files_place_is_named(run: RunDirectory) -> None:
    (run.path / "summary.json").mkdir()
    with pytest.raises(UserError, match=r"/summary\.json: Is a directory$"):
        run.write_json("summary.json", {})
