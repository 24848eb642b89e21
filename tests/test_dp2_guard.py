"""DP2's study of the image guard: sums over its streams, table and sentence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uavaccel.suites.dp2 import guard as dp2_guard
from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.guard_study import guard_study


def test_the_guard_study_is_the_sum_of_its_streams() -> None:
    images = np.random.default_rng(0).integers(0, 256, (40, 6, 6, 3), np.uint8)
    settings = GuardSettings(max_retries=2)
    result = dp2_guard.study(images, settings, seed=5)
    streams = [guard_study(list(images), 0.05, 5 + i, settings) for i in range(20)]
    assert (result["modelled"], result["images"], result["share"], result["streams"]) == (True, 40, 0.05, 20)
    for kind, modes in result["by_kind"].items():
        for mode, counted in modes.items():
            sent, passed = (sum(s[mode]["by_kind"][kind][key] for s in streams) for key in ("sent", "passed"))
            assert counted == {
                "sent": sent,
                "passed": passed,
                "share_passed": passed / sent if sent else None,
            }
    for mode, share in result["perturbed_share_handed_on"].items():
        assert share == pytest.approx(sum(s[mode]["perturbed_share_handed_on"] for s in streams) / 20)
    assert result["perturbed_share_handed_on"]["on"] < result["perturbed_share_handed_on"]["off"]
    assert result["clean_false_alarms"] == streams[0]["clean"]["false_alarms"]
    assert result["clean_retries"] == streams[0]["clean"]["retries"]


def test_the_guards_table_and_sentence() -> None:
    def kind(off: tuple[int, int], on: tuple[int, int]) -> dict[str, Any]:
        return {
            mode: {"sent": sent, "passed": passed, "share_passed": passed / sent if sent else None}
            for mode, (sent, passed) in (("off", off), ("on", on))
        }

    guard = {
        "by_kind": {"salt_and_pepper": kind((10, 9), (16, 4)), "empty": kind((0, 0), (4, 0))},
        "perturbed_share_handed_on": {"off": 0.049, "on": 0.0123},
        "clean_false_alarms": 3,
        "images": 200,
        "share": 0.05,
    }
    assert [dict(zip(dp2_guard.HEADER, line, strict=True)) for line in dp2_guard.table(guard)] == [
        dict(zip(dp2_guard.HEADER, line, strict=True))
        for line in (
            ("salt and pepper", "16", "90.0%", "25.0%"),
            ("empty", "4", "-", "0.0%"),
            ("all", "20", "90.0%", "20.0%"),
        )
    ]
    assert dp2_guard.HEADER[1:] == ("perturbed images sent", "pass without guard", "pass the guard")
    assert dp2_guard.sentence(guard) == (
        "False alarms: 3 of 200 clean images. With 5% of the images perturbed, 4.9% of those handed on are "
        "perturbed without the guard and 1.2% with it."
    )
