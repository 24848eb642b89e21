"""The notebooks run from top to bottom, and print what they were saved with."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pytest

from tools import colab

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


@pytest.mark.parametrize("name", ["first_flight", "real_time"])
def test_a_notebook_opens_in_colab_and_installs_itself_there(name: str, tmp_path: Path) -> None:
    """Whatever address it had before; its own cells stay as they are."""
    notebook = Path(shutil.copy(DOCS / f"{name}.ipynb", tmp_path))
    own = json.loads(notebook.read_text("utf-8"))["cells"]
    for repository in ("someone/else", "an.owner/uavaccel"):
        colab.write(notebook, repository)
    badge, install, *others = json.loads(notebook.read_text("utf-8"))["cells"]
    assert others == own
    assert (
        f"](https://colab.research.google.com/github/an.owner/uavaccel/blob/main/docs/{name}.ipynb)"
        in badge["source"][0]
    )
    assert (
        install["source"][-1].strip()
        == '%pip install --quiet "uavaccel[learn] @ git+https://github.com/an.owner/uavaccel"'
    )
    elsewhere: dict[str, Any] = {}
    exec("".join(install["source"]).replace("%pip", "assert False, '%pip'  #"), elsewhere)  # no Colab here
    with pytest.raises(ValueError, match="must be OWNER/NAME"):
        colab.write(notebook, "https://example.org")


def printed(cell: dict[str, Any]) -> str:
    """What a cell wrote to standard output when the notebook was saved."""
    streams = [output for output in cell["outputs"] if output.get("name") == "stdout"]
    return "".join("".join(output["text"]) for output in streams)
