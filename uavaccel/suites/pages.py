"""What every suite's report begins and ends with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from uavaccel.draw.document import Block, Heading, Listing, Paragraph, Picture, Table, to_html, to_markdown
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory


def finished_rows(run: RunDirectory, suite: str) -> list[dict[str, Any]]:
    """The run's rows of that suite. Raises UserError if there is none."""
    rows = [row for row in run.rows() if row.get("suite") == suite]
    if not rows:
        raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game of {suite}")
    return rows


def summary_blocks(
    headline: str, summary: Mapping[str, Any], beside: Table, *shown: Picture | Table
) -> list[Block]:
    """The result in a sentence, `beside` the paper's, what is `shown`, and summary.json to unfold."""
    plain = [(key, str(value)) for key, value in summary.items() if not isinstance(value, list)]
    table = Table(("", ""), plain, folded="summary.json")
    return [Paragraph(headline + "."), beside, *shown, table]


def write_pages(run: RunDirectory, title: str, blocks: Sequence[Block]) -> None:
    """report.md and report.html of the blocks, configuration and manifest below them."""
    whole = [*blocks, Heading("Provenance"), *_provenance(run)]
    run.write_text("report.md", to_markdown(title, whole, run.path))
    run.write_text("report.html", to_html(title, whole))


def _provenance(run: RunDirectory) -> list[Block]:
    files = [run.path / "config.yaml", run.path / "manifest.json"]
    return [Listing(path.read_text(encoding="utf-8"), folded=path.name) for path in files if path.is_file()]


def listed(numbers: Sequence[Any]) -> str:
    """1, 2, 3."""
    return ", ".join(str(number) for number in numbers)
