"""Assets and experiments are found from a source tree and from an installed wheel alike."""

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from uavaccel import resources
from uavaccel.errors import UserError
from uavaccel.suites.session import RunRequest, configure

ROOT = Path(__file__).parents[1]


def test_assets_and_experiments_lie_beside_the_package() -> None:
    assert resources.source_tree() == ROOT
    assert resources.asset("mjcf") == ROOT / "assets" / "mjcf"
    assert resources.experiment("README.md") == ROOT / "experiments" / "README.md"
    names = resources.experiments()  # what `uavaccel run` takes, which claims and latencies are not
    assert [name in names for name in ("dp1", "claims", "latency")] == [True, False, False]
    assert [name for name, about in names.items() if about.startswith("#") or not about.endswith((".", "?"))] == []


@pytest.mark.parametrize(
    ("origin", "told"),
    [
        (None, "'uavaccel[sb3]'"),
        ('{"url": "file:///a/uavaccel-1-py3-none-any.whl", "archive_info": {}}',
         "'uavaccel[sb3] @ file:///a/uavaccel-1-py3-none-any.whl'"),
        ('{"url": "https://example.org/uavaccel.git", "vcs_info": {"vcs": "git", "commit_id": "1"}}',
         "'uavaccel[sb3] @ git+https://example.org/uavaccel.git'"),
    ],
)  # fmt: skip
def test_what_installs_an_extra_is_where_uavaccel_came_from(
    origin: str | None, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UserError, match=f"^a key: needs not-there: pip install -e '{ROOT}\\[sb3\\]'$"):
        resources.require("not_there", "a key", "sb3", "not-there")
    monkeypatch.setattr(resources, "source_tree", lambda: None)
    monkeypatch.setattr(resources, "distribution", lambda name: SimpleNamespace(read_text=lambda file: origin))
    with pytest.raises(UserError, match=f"^a key: needs not_there: pip install {re.escape(told)}$"):
        resources.require("not_there", "a key", "sb3")
    resources.require("json", "a key", "sb3")


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A folder laid out as a wheel leaves it: the assets inside the package, no project beside it."""
    package = tmp_path / "uavaccel"
    for name in ("assets/mjcf/blocks.xml", "experiments/dp1.yaml"):
        (package / name).parent.mkdir(parents=True)
        (package / name).write_text("packaged")
    for module in ("__init__.py", "errors.py", "resources.py"):
        (package / module).write_bytes((ROOT / "uavaccel" / module).read_bytes())
    return tmp_path


def test_a_wheel_carries_them_inside_the_package(installed: Path) -> None:
    program = (
        "from uavaccel.resources import asset, experiment, source_tree\n"
        "print(asset('mjcf/blocks.xml'), experiment('dp1.yaml'), source_tree(), sep='\\n')"
    )
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=installed, capture_output=True, text=True, check=True)
    package = installed / "uavaccel"
    assert done.stdout.splitlines() == [
        str(package / "assets" / "mjcf" / "blocks.xml"),
        str(package / "experiments" / "dp1.yaml"),
        "None",
    ]


@pytest.mark.parametrize("experiment", ["train", "evaluate", "sweep", "rl_smoke"])
def test_what_needs_pytorch_says_so_before_anything_is_written(
    experiment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(UserError, match=r"^(training|evaluation): needs PyTorch: pip install -e '.*\[learn\]'$"):
        configure(RunRequest(experiment))
