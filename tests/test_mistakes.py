"""Wrong calls in Python, and what is said of them: lines of tests/data/mistakes.txt, below the module of each."""

from __future__ import annotations

import builtins
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uavaccel import errors
from uavaccel.config import validate
from uavaccel.sim.lane import layout_from

pytestmark = pytest.mark.usefixtures("whole_messages")

TABLE = Path(__file__).parent / "data/mistakes.txt"


def posts(*east_m: float) -> list[dict[str, float]]:
    return [{"x_m": 20.0, "y_m": y_m, "half_side_m": 0.8} for y_m in east_m]


def mistakes() -> Iterator[tuple[str, str, str]]:
    for block in TABLE.read_text(encoding="utf-8").split("\n\n"):
        module, *lines = block.splitlines()
        for line in lines:
            calls, said = line.split(" -> ")
            yield from ((module, call, said) for call in calls.split(" ; "))


@pytest.mark.parametrize(("module", "call", "said"), [*mistakes()])
def test_a_mistake_is_one_clear_line(module: str, call: str, said: str) -> None:
    """A UserError, unless the line begins with the name of another exception."""
    kind, _, text = said.rpartition("Error: ")
    name = f"{kind or 'User'}Error"
    error: type[Exception] = getattr(errors, name, None) or getattr(builtins, name)
    own: dict[str, Any] = {"np": np, "nan": np.nan, "inf": np.inf, "Path": Path, "posts": posts, "validate": validate}
    with pytest.raises(error, match=text) as raised:
        eval(call, {**own, "layout_from": layout_from, **vars(import_module(module))})
    assert "\n" not in str(raised.value) or name == "ValueError"
