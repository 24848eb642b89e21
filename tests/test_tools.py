"""Tools: numbers of pages that are computed must be said; wrong changes, and whether the tests hear them."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tools import mutate
from tools.check_numbers import Page, check, main

SOURCE = """def clipped(value: int = 0, most: int = 3) -> int:
    if value > most:
        return most
    return value
"""
TEST = """from uavaccel.clip import clipped

def test_clips():
    assert [clipped(value) for value in (2, 4)] == [2, 3]
"""


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of one module, its test, and a test that imports it through another module."""
    monkeypatch.setattr(mutate, "ROOT", tmp_path)
    for name in ("uavaccel", "tests"):
        (tmp_path / name).mkdir()
    (tmp_path / "uavaccel/__init__.py").touch()
    (tmp_path / "uavaccel/clip.py").write_text(SOURCE)
    (tmp_path / "uavaccel/above.py").write_text("from uavaccel.clip import clipped\n")
    (tmp_path / "tests/test_clip.py").write_text(TEST)
    (tmp_path / "tests/test_above.py").write_text("import uavaccel.above\n\ndef test_it(): pass\n")
    (tmp_path / "tests/test_other.py").write_text("def test_it(): assert False\n")
    mutate.imported.cache_clear()
    mutate.nearest_tests.cache_clear()
    mutate._files.cache_clear()
    return tmp_path


def test_changes_are_heard_or_not_and_kept(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`>` for `>=` changes nothing of this function, and `value` has a default that no test leaves out."""
    command = [str(tree / "uavaccel/clip.py"), "--out", str(tree / "out/kept.jsonl")]
    assert mutate.main(command) == 1
    said = capsys.readouterr().out
    assert sorted(said.splitlines()[:3]) == [
        "UNHEARD  uavaccel/clip.py:1: 0 -> 1",
        "UNHEARD  uavaccel/clip.py:2: value > most -> (value >= most)",
        "heard    uavaccel/clip.py:1: 3 -> 4  [tests/test_clip.py::test_clips]",
    ]
    assert said.splitlines()[3:] == ["comparison 0 of 1; constant 1 of 2", "1 of 3 changes heard"]
    assert (tree / "uavaccel/clip.py").read_text() == SOURCE
    kept = (tree / "out/kept.jsonl").read_text()
    assert mutate.main(command) == 1
    assert capsys.readouterr().out == said
    assert (tree / "out/kept.jsonl").read_text() == kept, "nothing ran again"


def test_tests_that_fail_anyway_are_told(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = [str(tree / "uavaccel"), "--out", str(tree / "kept.jsonl"), "--sample", "1"]
    assert mutate.main([*command, "--", "tests/test_other.py"]) == 1
    assert capsys.readouterr().out == "fails without a change: tests/test_other.py::test_it\n"


def test_only_lines_that_differ_are_changed(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    identity = ["-c", "user.name=a", "-c", "user.email=a"]
    for command in (["init", "-q"], ["add", "."], [*identity, "commit", "-qm", "first"]):
        subprocess.run(["git", *command], cwd=tree, check=True)
    (tree / "uavaccel/clip.py").write_text(SOURCE.replace("value > most", "most < value"))
    assert mutate.main([str(tree / "uavaccel"), "--diff", "HEAD", "--list"]) == 0
    assert capsys.readouterr().out == (
        "uavaccel/clip.py:2: most < value -> (most <= value)  tests/test_clip.py tests/test_above.py\n"
    )


def test_each_kind_of_change_is_made() -> None:
    source = b"""
def work(a, b=True):
    total = not a or -a if b else f(a, b, key=a)
    total += a[1:b]
    raise total
"""
    found = {(each.kind, each.after) for each in mutate.mutants("module.py", source)}
    assert found >= {
        ("constant", "False"),
        ("sign", "(a)"),
        ("Bool", "(not a and -a)"),
        ("branches", "(f(a, b, key=a) if b else not a or -a)"),
        ("arguments", "(f(b, a, key=a))"),
        ("option", "(f(a, b))"),
        ("slice", "1:b + 1"),
        ("statement", "pass"),
    }


# --- numbers of pages -------------------------------------------------------------------------------------------------


PAGE = """# Results 2

Of 300 lanes it wins
97.2 % at 10x, `--games 300`.

<!-- made by: uavaccel run rl -->

| seed | won |
|---|---|
| 0 | 299 |

<!-- no results -->

A command lasts 1 s.

```sh
uavaccel run rl --seed 7
```
"""
SAYS = ("Of 300 lanes it wins 97.2 % at 10x",)


def test_a_page_that_says_what_is_computed_is_right() -> None:
    assert check(PAGE, Page(SAYS, ())) == ([], 3, ["uavaccel run rl"])


def test_a_number_that_differs_is_told_with_the_line_most_like_it() -> None:
    wrong, *_ = check(PAGE, Page(("Of 300 lanes it wins 96.9 % at 10x",), (r"300 lanes", r"10x")))
    assert wrong == [
        "computed: Of 300 lanes it wins 96.9 % at 10x\n    page: Of 300 lanes it wins 97.2 % at 10x, `--games 300`.",
        "line 4: no source of 97.2 in: 97.2 % at 10x, `--games 300`.",
    ]


@pytest.mark.parametrize("added", ["And 12 more.", "| last | 12 |", "- 12 of them"])
def test_a_number_without_rows_or_command_has_no_source(added: str) -> None:
    assert check(f"{PAGE}\n{added}\n", Page(SAYS, ())).wrong == [f"line 20: no source of 12 in: {added}"]


def test_a_command_counts_for_the_block_below_it_alone() -> None:
    apart = PAGE.replace("| 0 | 299 |", "| 0 | 299 |\n\nAnother wins 298.")
    assert [line.partition(" in: ")[0] for line in check(apart, Page(SAYS, ())).wrong] == ["line 12: no source of 298."]


@pytest.mark.slow
def test_every_number_of_the_pages_is_that_of_its_rows(capsys: pytest.CaptureFixture[str]) -> None:
    status, said = main(["--all"]), capsys.readouterr().out
    assert status == 0, said
    assert "docs/results-paper.md: " in said
    assert "    not recomputed: uavaccel run realtime --jobs 2" in said
