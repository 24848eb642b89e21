"""Give the notebooks in docs/ a Colab badge and a cell that installs from the repository, once that has an address.

    python -m tools.colab OWNER/NAME    # on GitHub, from where Colab opens notebooks

Cells of an earlier address are replaced. In other notebooks than Colab's the cell does nothing.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1] / "docs"
BRANCH, OF_COLAB = "main", "of-colab"


def cells(name: str, repository: str) -> Iterator[dict[str, Any]]:
    """Yield the cells that stand before a notebook's own."""
    badge = "https://colab.research.google.com/assets/colab-badge.svg"
    opened = f"https://colab.research.google.com/github/{repository}/blob/{BRANCH}/docs/{name}"
    yield {"cell_type": "markdown", "source": [f"[![Open in Colab]({badge})]({opened})"]}
    installs = [
        "import sys\n",
        "\n",
        'if "google.colab" in sys.modules:\n',
        f'    %pip install --quiet "uavaccel[learn] @ git+https://github.com/{repository}"',
    ]
    yield {"cell_type": "code", "execution_count": None, "outputs": [], "source": installs}


def write(notebook: Path, repository: str) -> None:
    """Put the cells before a notebook's own, which stay as they are. Raises ValueError for what is no address."""
    if not re.fullmatch(r"[\w.-]+/[\w.-]+", repository):
        raise ValueError(f"{repository!r}: must be OWNER/NAME")
    content = json.loads(notebook.read_text("utf-8"))
    own = [cell for cell in content["cells"] if not cell.get("id", "").startswith(OF_COLAB)]
    added = [
        {"id": f"{OF_COLAB}-{number}", "metadata": {}, **cell}
        for number, cell in enumerate(cells(notebook.name, repository))
    ]
    notebook.write_text(json.dumps(content | {"cells": added + own}, indent=1, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    for path in sorted(DOCS.glob("*.ipynb")):
        write(path, sys.argv[1])
