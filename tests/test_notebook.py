"""The notebooks run from top to bottom, and print what they were saved with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pytest

DOCS = Path(__file__).parents[1] / "docs"


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("first_flight", marks=pytest.mark.opengl), "real_time"])
def test_a_notebook_prints_what_it_was_saved_with(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cell by cell in one namespace, as a kernel runs them; its flights are in lockstep or virtual, hence exact."""
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": "__main__"}
    cells = [
        cell for cell in json.loads((DOCS / f"{name}.ipynb").read_text("utf-8"))["cells"] if cell["cell_type"] == "code"
    ]
    assert any(printed(cell) for cell in cells)
    for cell in cells:
        exec(compile("".join(cell["source"]), name, "exec"), namespace)
        assert capsys.readouterr().out == printed(cell)
    plt.close("all")


def printed(cell: dict[str, Any]) -> str:
    """What a cell wrote to standard output when the notebook was saved."""
    streams = [output for output in cell["outputs"] if output.get("name") == "stdout"]
    return "".join("".join(output["text"]) for output in streams)
