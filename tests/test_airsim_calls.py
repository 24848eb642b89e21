"""The table of AirSim's calls tells what the server answers."""

from __future__ import annotations

from pathlib import Path

from tests.simulating import simulate
from uavaccel.wire.api import Api, page, sections

PAGE = Path(__file__).parents[1] / "docs" / "airsim-calls.md"


def test_the_page_is_that_of_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python -m uavaccel.wire.api > docs/airsim-calls.md"


def test_every_call_of_airsims_client_is_in_it_once() -> None:
    names = [call.name for calls in sections().values() for call in calls]
    assert len(names) == len(set(names)) == 122
    assert {*names} == {name for name in Api(simulate()).methods if not name.startswith("uavaccel")}
