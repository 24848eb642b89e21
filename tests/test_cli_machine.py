"""What doctor, bench, advise and calibrate print and write, of findings and measurements that are given here."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uavaccel.bench import speed
from uavaccel.bench.advice import Advice
from uavaccel.bench.agreement import Agreement
from uavaccel.bench.batch import BatchSize
from uavaccel.bench.calibration import Latencies
from uavaccel.bench.speed import Measurement
from uavaccel.cli import advise, bench, calibrate, doctor
from uavaccel.errors import UserError
from uavaccel.wire.latency import QUANTILES, read_latency, shipped_latency

QUIET: dict[str, Any] = {
    "verdict": "quiet", "cores": 3, "load_1min": 0.25, "timer_late_median_us": 11.0, "timer_late_p90_us": 22.0,
}  # fmt: skip
NOISY = {**QUIET, "verdict": "noisy: load 9.00 on 3 cores; measured latencies are pessimistic"}
DRAWS = {"backend": "egl", "name": "a card", "software": False}


# --- doctor ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("machine", "versions", "loop", "draws", "problems"),
    [
        (QUIET, {"uavaccel": "1.0", "numpy": "2.0"}, {"cached": True, "seconds": 0.25}, DRAWS, []),
        (QUIET, {"numpy": "2.0", "ray": None}, {"cached": False, "seconds": 30.0}, DRAWS, ["versions"]),
        (
            NOISY,
            {"numpy": None},
            None,
            {**DRAWS, "software": True},
            ["versions", "timing", "hot loop", "images"],
        ),
    ],
)
def test_the_doctor_marks_and_counts_what_is_to_be_looked_at(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    machine: dict[str, Any],
    versions: dict[str, Any],
    loop: dict[str, Any] | None,
    draws: dict[str, Any],
    problems: list[str],
) -> None:
    def probe(program: str) -> Any:
        if program == doctor.RENDERER:
            return draws
        if loop is None:
            raise doctor.ProbeError("it crashed")
        return loop

    host = {"platform": "Linux", "cpu_model": "a processor"}
    monkeypatch.setattr(doctor, "describe_run", lambda *_: {"versions": versions, "host": host})
    monkeypatch.setattr(doctor, "check_machine", lambda: machine)
    monkeypatch.setattr(doctor, "probe", probe)
    found = {finding.name: finding for finding in doctor.findings()}
    assert list(found) == ["versions", "host", "cores", "timers", "timing", "hot loop", "images"]
    assert [name for name, finding in found.items() if finding.problem] == problems
    assert found["host"].text == "Linux, a processor"
    assert found["cores"].text == "3, load 0.25"
    assert found["timers"].text == "a sleep ends 11 us late (median), 22 us (90th percentile)"
    assert found["timing"].text == f"wall: {machine['verdict']}"
    assert found["versions"].text == ", ".join(f"{name} {at or 'missing'}" for name, at in versions.items())
    if loop is not None:
        told = (
            "ready in 0.2 s, from numba's cache"
            if loop["cached"]
            else "compiled in 30.0 s; numba's cache has it"
        )
        assert found["hot loop"].text.startswith(told)
    doctor.examine()
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == (f"{len(problems)} to look at, marked with !" if problems else "nothing to mend")
    assert sum(" ! " in line for line in lines[:-1]) == len(problems)


# --- bench -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def benches(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Which benches were run, and with what: three of them, of which the second one cannot run here."""
    ran: list[Any] = []

    def measured(name: str, *how: Any) -> Iterator[Measurement]:
        ran.append((name, *how))
        if name == "broken":
            raise UserError("no card")
        yield Measurement(name, 1234.5, "per s", None if how else 2000.0, "noted")

    known = {"first": lambda: measured("first"), "broken": lambda: measured("broken"), "batch": None}
    monkeypatch.setattr(bench, "BENCHES", known)
    monkeypatch.setattr(bench, "bench_batch", lambda size: measured("batch", size))
    monkeypatch.setattr(speed, "bench_soak", lambda seconds: measured("soak", seconds))
    monkeypatch.setattr(bench, "check_machine", lambda: NOISY)
    return ran


def test_the_named_benches_are_run_in_their_order_and_kept(
    benches: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    size, out = BatchSize((4, 16), 2, 3, "own"), tmp_path / "bench.json"
    bench.run_benches(["batch", "first"], 0.0, out, size)
    assert benches == [("batch", size), ("first",)]
    kept = json.loads(out.read_text())
    assert [each["name"] for each in kept["measurements"]] == ["batch", "first"]
    first = {"name": "first", "value": 1234.5, "unit": "per s", "bound": 2000.0, "note": "noted"}
    assert kept["measurements"][1] == first
    assert kept["manifest"]["host_check"] == NOISY
    assert kept["manifest"]["command_line"] == ["bench", "batch", "first"]
    told = capsys.readouterr().out.splitlines()
    assert " ".join(told[-1].split()) == "first 1,234.50 per s of 2,000.00 noted"


def test_without_a_name_all_benches_are_run_then_the_soak_and_one_that_cannot_is_left_out(
    benches: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    size = BatchSize((8,))
    bench.run_benches([], 2.5, None, size)
    assert benches == [("first",), ("broken",), ("batch", size), ("soak", 2.5)]
    lines = capsys.readouterr().out.splitlines()
    assert [" ".join(line.split()) for line in lines[-4:]] == [
        "first 1,234.50 per s of 2,000.00 noted", "left out: no card", "batch 1,234.50 per s noted",
        "soak 1,234.50 per s noted",
    ]  # fmt: skip


# --- advise ----------------------------------------------------------------------------------------------------------


def test_advice_has_adsc_before_tcsc_and_is_of_what_was_asked_for(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Any] = []

    def advised(*how: Any) -> Iterator[Advice]:
        asked.append(how)
        yield Advice(1.0, 0.01, 1.99, 0.98, 0.001, 2.0, 0.999)
        yield Advice(50.0, 0.75, 1.5, 30.0, 0.05, 1.95, 45.0)

    monkeypatch.setattr(advise, "advise", advised)
    own = tmp_path / "latency.yaml"
    own.write_text("latency: {request_us: {call: " + str([7.0] * len(QUANTILES)) + "}}\n")
    for file, profile, model in (
        (None, "airsim", shipped_latency("airsim")),
        (None, "native", shipped_latency("native")),
        (own, "native", read_latency(own)),
    ):
        advise.show_advice(0.5, 0.1, 3, file, profile)
        assert asked[-1] == (model, profile, 0.5, 3)
        lines = [line.split() for line in capsys.readouterr().out.splitlines()]
        assert lines[1] == ["1x", "0.01", "1.99", "0.98", "0.001", "2", "0.999"]
        assert lines[2] == ["50x", "0.75", "1.5", "30", "0.05", "1.95", "45"]
        assert " ".join(lines[3]).startswith(
            "With commands of 0.5 s ADSC stays within 0.1 m up to ClockSpeed 1,"
        )


# --- calibrate -------------------------------------------------------------------------------------------------------


def test_a_calibration_is_a_latency_model_and_its_medians_are_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of 0, 1, ... 1000 us the quantiles are 1000 times their shares."""
    asked: list[Any] = []

    def calibrated(profile: str, commands: int, images: bool) -> Latencies:
        asked.append((profile, commands, images))
        latencies = Latencies()
        for number in range(1001):
            latencies.add(latencies.request, "call", None, 1000 * number)
            latencies.add(latencies.reply, "call", None, 500 * number)
            latencies.add(latencies.reply, "move", 10_000_000, 2000 * number)
            latencies.issue.append(3000 * number)
        return latencies

    monkeypatch.setattr(calibrate, "calibrate", calibrated)
    monkeypatch.setattr(calibrate, "check_machine", lambda: NOISY)
    monkeypatch.setattr(calibrate, "_can_draw", lambda: False)
    calibrate.write_calibration(tmp_path / "latency.yaml", 70, "airsim")
    assert asked == [("airsim", 70, False)]
    model = read_latency(tmp_path / "latency.yaml")
    thousands = [1000 * share for share in QUANTILES]
    assert list(model.request_us["call"]) == pytest.approx(thousands)
    assert list(model.reply_us["move"]) == pytest.approx([2 * each for each in thousands])
    assert list(model.issue_us) == pytest.approx([3 * each for each in thousands])
    head = (tmp_path / "latency.yaml").read_text().splitlines()[:3]
    assert "profile airsim" in head[0]
    assert NOISY["verdict"] in head[0]
    assert head[2] == "# 1001 requests, 2002 replies, 1001 issues, 0 wall timers"
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert lines[1:4] == [
        "request call median 500.0 us, 99 % 990.0 us",
        "reply call median 250.0 us, 99 % 495.0 us",
        "reply move median 1000.0 us, 99 % 1980.0 us",
    ]


def test_a_check_of_a_model_shows_both_runs_of_the_machine_before_the_models(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Any] = []
    wall, again, far = (np.array(run) for run in ([1.0, 2.0, 3.0], [1.5, 2.0, 3.5], [1.0, 3.0, 3.0]))

    def agreed(*how: Any) -> Iterator[Agreement]:
        asked.append(how)
        yield Agreement("adsc", 50.0, 0.2, "gap s", wall, again, wall)
        yield Agreement("adsc", 50.0, 1.0, "gap s", wall, again, wall)
        yield Agreement("tcsc", 100.0, 1.0, "error m", wall, again, far)

    monkeypatch.setattr(calibrate, "check_agreement", agreed)
    monkeypatch.setattr(calibrate, "check_machine", lambda: QUIET)
    own = tmp_path / "latency.yaml"
    own.write_text("latency: {request_us: {call: " + str([7.0] * len(QUANTILES)) + "}}\n")
    for file, model in ((None, shipped_latency()), (own, read_latency(own))):
        calibrate.show_agreement(file, "native", 4)
        assert asked[-1] == (model, "native", 4)
        told = " ".join(capsys.readouterr().out.split())
        assert told.endswith("2 of 3 agree")
        assert "ADSC 50x 0.2 gap s 1 2 3 1.5 2 3.5 1 2 3 agrees" in told
        assert "TCSC 100x 1 error m 1 2 3 1.5 2 3.5 1 3 3" in told
        assert "50%" in told
