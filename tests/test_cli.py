"""The command line's shell: quick, complete, one line for a mistake, and tables as wide as the terminal."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from uavaccel.cli.completion import experiments, one_of
from uavaccel.cli.run import columns_within
from uavaccel.draw.document import Table

ROOT = Path(__file__).parents[1]


def uavaccel(*arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "uavaccel", *arguments],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )


def test_help_loads_nothing_heavy() -> None:
    program = "import sys, uavaccel.cli.main; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    heavy = {"cv2", "gymnasium", "matplotlib", "mujoco", "numba", "numpy", "pydantic", "scipy", "torch"}
    assert not heavy & set(done.stdout.split())


@pytest.mark.parametrize("arguments", [["--help"], []])
def test_help_names_the_commands(arguments: list[str]) -> None:
    done = uavaccel(*arguments)
    assert done.returncode == 0
    assert {"run", "report", "serve", "calibrate", "bench", "doctor"} <= set(done.stdout.split())


@pytest.mark.parametrize(
    ("words", "completion"), [("uavaccel do", "doctor"), ("uavaccel serve --sce", "--scene")]
)
def test_the_shell_can_complete(words: str, completion: str) -> None:
    done = uavaccel(
        _UAVACCEL_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(len(words.split()) - 1)
    )
    assert completion in done.stdout.split()
    assert (done.returncode, done.stderr) == (0, "")


def test_completion_can_be_installed(tmp_path: Path) -> None:
    in_bash = (
        f'"{sys.executable}" -m uavaccel --install-completion; exit $?'  # the shell above it is the one meant
    )
    done = subprocess.run(
        ["bash", "-c", in_bash],
        env={**os.environ, "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert any(path.is_file() for path in tmp_path.rglob("*"))


@pytest.mark.parametrize("arguments", [["--help"], ["schema", "train"]])
def test_who_reads_no_further_than_the_head_is_told_nothing(arguments: list[str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "uavaccel", *arguments],
            cwd=ROOT,
            stdout=writing,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("arguments", [["fly"], ["serve", "--speed", "3"], ["serve", "--clock", "fast"]])
def test_wrong_usage_is_one_line(arguments: list[str]) -> None:
    done = uavaccel(*arguments)
    assert done.returncode == 2
    assert done.stderr.startswith("uavaccel: error: ")
    assert done.stderr.count("\n") == 1


TABLE = Table(
    ("command", "effective speed-up", "source"), [("ADSC", "11.23", "modelled"), ("TCSC", "-", "x")]
)


@pytest.mark.parametrize(("width", "columns"), [(80, 3), (28, 3), (27, 2), (18, 2), (17, 1), (3, 1)])
def test_a_table_shows_the_columns_that_fit_uncut(width: int, columns: int) -> None:
    """Of "command", "effective" and "modelled", two characters apart."""
    assert columns_within(TABLE, width) == columns


def test_words_of_options_and_experiments_are_completed() -> None:
    words = one_of("wall", "virtual", "lockstep")  # each of which has an l
    assert [words(typed) for typed in ("l", "v", "lockstep", "")] == [
        ["lockstep"], ["virtual"], ["lockstep"], ["wall", "virtual", "lockstep"],
    ]  # fmt: skip
    assert words("k") == []
    assert experiments("dp") == ["dp1", "dp2", "dp2_airsim"]
    assert "claims" not in experiments("")
