"""The numbers of the pages: what is computed must be said, and what is said must have a source."""

from __future__ import annotations

import pytest

from tools.check_numbers import Page, check, main

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
