"""What a command loads before its first flight: nothing that only a report, a figure or a compiler wants."""

from __future__ import annotations

import subprocess
import sys

import pytest

from uavaccel.envs import batch
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.sim.camera import gl

LOADED = """
import sys
from uavaccel.cli.main import app
try:
    app({arguments!r}, standalone_mode=False)
finally:
    print(*(name for name in {unwanted!r} if name in sys.modules), file=sys.stderr)
"""


@pytest.mark.parametrize(
    ("command", "unwanted"),
    [
        ("train", ("matplotlib", "scipy.stats", "torch._dynamo")),
        ("evaluate", ("matplotlib", "scipy.stats", "torch._dynamo", "sympy")),
    ],
)
def test_a_command_does_not_load_what_only_its_report_needs(command: str, unwanted: tuple[str, ...]) -> None:
    code = LOADED.format(arguments=[command, "--dry-run"], unwanted=unwanted)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == ""


def test_no_renderer_is_started_where_this_process_knows_that_software_draws(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def started(*arguments: object) -> None:
        raise AssertionError("a renderer was started")

    monkeypatch.setattr(batch, "RenderService", started)
    monkeypatch.setattr(gl, "_found", gl.GlRenderer("egl", "llvmpipe", software=True))
    assert batch._service(LaneTask(), 2, 2, "auto") is None
    with pytest.raises(AssertionError, match="started"):
        batch._service(LaneTask(), 2, 2, "shared")
