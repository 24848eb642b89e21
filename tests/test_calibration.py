"""What doctor, calibrate and advise find and print: of probes, messages and flights that are given here."""

from __future__ import annotations

from collections import Counter
from contextlib import nullcontext
from functools import partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from uavaccel.calibration import advise as advice
from uavaccel.calibration import calibrate, doctor
from uavaccel.calibration.advise import SquareGame, advise, fly_square, sentence
from uavaccel.calibration.calibrate import Agreement, ClientEvent, Latencies, quantiles_us, record_trace
from uavaccel.cli import machine
from uavaccel.cli.main import app
from uavaccel.commands import COMMANDS
from uavaccel.errors import UserError
from uavaccel.metrics.trajectory import command_gaps_s, trajectory
from uavaccel.wire.latency import QUANTILES, ZERO_LATENCY, LatencyConfig, read_latency, shipped_latency
from uavaccel.wire.session import VirtualSession


def printed(line: str) -> list[list[str]]:
    """The words of each line that a command prints."""
    done = CliRunner().invoke(app, line.split(), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return [splitline.split() for splitline in done.output.splitlines()]


# --- the machine, and the doctor --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cores", "load", "late_us", "doubts"),
    [
        (4, 2.0, 200.0, []),
        (4, 2.1, 200.0, ["load 2.10 on 4 cores"]),
        (4, 0.0, 200.1, ["sleeps end 200 us late (90th percentile)"]),
        (1, 0.6, 300.0, [
            "one core for client and server together", "load 0.60 on 1 cores",
            "sleeps end 300 us late (90th percentile)",
        ]),
    ],
)  # fmt: skip
def test_a_machine_is_quiet_by_its_cores_its_load_on_each_and_its_sleeps(
    monkeypatch: pytest.MonkeyPatch, cores: int, load: float, late_us: float, doubts: list[str]
) -> None:
    """Of 50 sleeps, sorted, the median is the 26th and the 90th percentile the 46th."""
    monkeypatch.setattr(doctor, "usable_cores", lambda: cores)
    monkeypatch.setattr(doctor, "timer_grain_ns", lambda: [round(1000 * late_us * n / 45) for n in range(50)])
    monkeypatch.setattr("os.getloadavg", lambda: (load, 99.0, 99.0))
    found = doctor.check_machine()
    noisy = f"noisy: {', '.join(doubts)}; measured latencies are pessimistic"
    assert found["verdict"] == (noisy if doubts else "quiet")
    assert (found["cores"], found["load_1min"]) == (cores, load)
    late = [found["timer_late_median_us"], found["timer_late_p90_us"]]
    assert late == pytest.approx([late_us * 25 / 45, late_us], abs=0.001)


QUIET: dict[str, Any] = {
    "verdict": "quiet", "cores": 3, "load_1min": 0.25, "timer_late_median_us": 11.0, "timer_late_p90_us": 22.0,
}  # fmt: skip
NOISY = {**QUIET, "verdict": "noisy: load 9.00 on 3 cores; measured latencies are pessimistic"}
DRAWS = {"backend": "egl", "name": "a card", "software": False}


@pytest.mark.parametrize(
    ("found", "versions", "loop", "draws", "problems"),
    [
        (QUIET, {"uavaccel": "1.0", "numpy": "2.0"}, {"cached": True, "seconds": 0.25}, DRAWS, []),
        (QUIET, {"numpy": "2.0", "ray": None}, {"cached": False, "seconds": 30.0}, DRAWS, ["versions"]),
        (NOISY, {"numpy": None}, None, {**DRAWS, "software": True}, ["versions", "timing", "hot"]),
    ],
)
def test_the_doctor_marks_and_counts_what_is_to_be_looked_at(
    monkeypatch: pytest.MonkeyPatch,
    found: dict[str, Any],
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
    monkeypatch.setattr(doctor, "check_machine", lambda: found)
    monkeypatch.setattr(doctor, "probe", probe)
    lines = [line for line in printed("doctor") if line]
    assert [line[0] for line in lines if "!" in line[:3]] == problems
    said = " ".join(word for line in lines for word in line)
    assert " ".join(lines[-1]) == (f"{len(problems)} to look at, marked with !" if problems else "nothing to mend")
    for words in (
        "host Linux, a processor", "cores 3, load 0.25", f"wall: {found['verdict'].partition(';')[0]}",
        "a sleep ends 11 us late (median), 22 us (90th percentile)",
        ", ".join(f"{name} {at or 'missing'}" for name, at in versions.items()),
        "egl: a card" + (", software on the CPU, slow" if draws["software"] else ""),
        "does not run: it crashed" if loop is None
        else "ready in 0.2 s, from numba's cache" if loop["cached"] else "compiled in 30.0 s; numba's cache has it",
    ):  # fmt: skip
        assert words in said


@pytest.mark.parametrize(("program", "text", "advised"), [
    ("import os; os.abort()", "it crashed (SIGABRT)", False),
    ("raise OSError('no libEGL')", "OSError: no libEGL", False),
    ("import sys; sys.exit(3)", "it ended with status 3", False),
    ("from uavaccel.errors import UserError; raise UserError('unset it')", "unset it", True),
])  # fmt: skip
def test_a_probe_that_fails_is_one_line_and_advice_is_not_given_twice(
    monkeypatch: pytest.MonkeyPatch, program: str, text: str, advised: bool
) -> None:
    monkeypatch.setattr(doctor, "RENDERER", program)
    monkeypatch.setattr(doctor, "HOT_LOOP", program)
    packages = "" if advised else "; install libegl1 libegl-mesa0 libgl1-mesa-dri (Debian)"
    assert doctor.renderer() == ("images", f"none: {text}{packages}", True)
    assert doctor.hot_loop() == ("hot loop", f"does not run: {text}", True)


def test_a_probe_answers_in_json_within_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor.probe("print('noise'); print('{\"a\": 1}')") == {"a": 1}
    finding = doctor.hot_loop()
    assert not finding.problem
    assert "numba's cache" in finding.text
    monkeypatch.setattr(doctor, "TIMEOUT_S", 0.1)
    with pytest.raises(doctor.ProbeError, match="no answer within"):
        doctor.probe("while True: pass")


# --- calibrate --------------------------------------------------------------------------------------------------------


def test_a_calibration_is_a_latency_model_and_its_medians_are_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Of 0, 1, ... 1000 us the quantiles are 1000 times their shares."""
    measured: list[Any] = []

    def measure(*how: Any) -> Latencies:
        measured.append(how)
        latencies = Latencies()
        for number in range(1001):
            latencies.add(latencies.request, "call", None, 1000 * number)
            latencies.add(latencies.reply, "call", None, 500 * number)
            latencies.add(latencies.reply, "move", 10_000_000, 2000 * number)
            latencies.issue.append(3000 * number)
        return latencies

    def draws_nothing() -> None:
        raise UserError("no card")

    monkeypatch.setattr(calibrate, "measure", measure)
    monkeypatch.setattr(doctor, "check_machine", lambda: NOISY)
    monkeypatch.setattr("uavaccel.sim.camera.gl.describe_renderer", draws_nothing)
    file = tmp_path / "latency.yaml"
    lines = printed(f"timing calibrate --out {file} --commands 70 --profile airsim")
    assert measured == [("airsim", 70, False)]
    model = read_latency(file)
    thousands = [1000 * share for share in QUANTILES]
    assert list(model.request_us["call"]) == pytest.approx(thousands)
    assert list(model.reply_us["move"]) == pytest.approx([2 * thousand for thousand in thousands])
    assert list(model.issue_us) == pytest.approx([3 * thousand for thousand in thousands])
    assert [" ".join(line) for line in lines[-2:]] == [
        f"{file}: use it with `uavaccel run dp1 --set latency={file}`,",
        f"with train and evaluate as `--timing virtual --set task.latency={file}`",
    ]
    head = file.read_text().splitlines()[:3]
    assert "profile airsim, on 20" in head[0]
    assert NOISY["verdict"] in head[0]
    assert head[2] == "# 1001 requests, 2002 replies, 1001 issues, 0 wall timers"
    assert [" ".join(line) for line in lines[2:5]] == [
        "request call median 500.0 us, 99 % 990.0 us", "reply call median 250.0 us, 99 % 495.0 us",
        "reply move median 1000.0 us, 99 % 1980.0 us",
    ]  # fmt: skip


def test_as_many_commands_and_images_are_timed_as_were_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """In whole batches of 24, three at each of two ClockSpeeds and four T_move; the first image of all loads OpenGL."""
    batches: list[tuple[str, Any]] = []
    image = SimpleNamespace(image=lambda kind: batches.append(("first", kind)))

    def session(scene: str, profile: str) -> Any:
        if scene == "blocks":
            return VirtualSession(scene, profile)
        return nullcontext(SimpleNamespace(start_game=lambda *_, lane: image))

    monkeypatch.setattr(calibrate, "WallSession", session)

    def ask(what: str) -> None:
        batches.append(("ask", what))

    def time_batch(client: Any, latencies: Any, send: Any) -> None:
        if isinstance(send, partial):  # of a command
            batches.append(("fly", send.args[0]))
        else:
            send(SimpleNamespace(call=ask, image=ask))

    monkeypatch.setattr(calibrate, "time_batch", time_batch)
    calibrate.measure("native", 3 * 8 * calibrate.BATCH, images=False)
    counts = Counter(batches)
    assert counts == {("ask", "ping"): 48, ("fly", COMMANDS["adsc"]): 24, ("fly", COMMANDS["tcsc"]): 24}
    for images, count in ((1, 1), (47, 1), (72, 3)):
        batches.clear()
        calibrate.measure("native", images, images=True)
        assert batches[16 * 2 :] == [("first", "gray"), *[("ask", "gray")] * count]


def gathered(events: tuple[ClientEvent, ...], server: list[tuple[str, int, int]]) -> Latencies:
    latencies = Latencies()
    latencies.gather(events, server)
    return latencies


def test_a_coalesced_command_has_no_latency_of_its_own() -> None:
    """What travels with the next message is neither a request nor an issue; the next one's request has both in it."""
    latencies = gathered(
        (
            ClientEvent("call", "uavaccelState", "state", 0),
            ClientEvent("return", "uavaccelState", "state", 50),
            ClientEvent("call", "moveByVelocity", "move", 51, True),
            ClientEvent("issued", "moveByVelocity", "move", 53, True),
            ClientEvent("call", "uavaccelContinueFor", "continue_for", 54),
            ClientEvent("return", "uavaccelContinueFor", "continue_for", 12_000_200),
            ClientEvent("call", "simPause", "pause", 12_000_250),
            ClientEvent("return", "simPause", "pause", 12_000_900),
            ClientEvent("call", "uavaccelState", "state", 12_000_910),
            ClientEvent("issued", "uavaccelState", "state", 12_000_930),
        ),
        [
            ("handle uavaccelState", 20, 0),
            ("handle moveByVelocity", 100, 0),
            ("handle uavaccelContinueFor", 110, 0),
            ("timer", 12_000_000, 5),
            ("pause", 12_000_040, 5),
            ("handle simPause", 12_000_400, 5),
            ("pause", 12_000_400, 5),  # for which no timer was set
            ("handle uavaccelState", 12_001_000, 5),
        ],
    )
    request, reply = latencies.request, latencies.reply
    assert (request["move"], request["continue_for"], reply["continue_for"]) == ([], [110 - 53], [200 - 40])
    assert request["pause"] == request["pause@10ms"] == [200]  # after a wait of 12 ms
    assert (reply["pause"], latencies.timer, latencies.issue) == ([500], [40], [30])
    assert latencies.counts() == "3 requests, 3 replies, 1 issues, 1 wall timers"
    assert quantiles_us([40_000]) == [40.0] * len(QUANTILES)


@pytest.mark.parametrize(("answered_ns", "wait"), [(7_000_000, "5ms"), (7_100_000, "10ms")])
@pytest.mark.parametrize(
    ("method", "channel", "ended"),
    [("moveByVelocity", "move", "end"), ("uavaccelContinueFor", "continue_for", "pause")],
)
def test_a_wait_lasts_until_the_answer_and_not_until_it_has_arrived(
    method: str, channel: str, ended: str, answered_ns: int, wait: str
) -> None:
    """What follows it is counted as after a wait of that length: 7.07 ms are between 5 and 10."""
    latencies = gathered(
        (
            ClientEvent("call", method, channel, 0),
            ClientEvent("return", method, channel, 7_300_000),
            ClientEvent("call", "simPause", "pause", 7_300_100),
            ClientEvent("return", "simPause", "pause", 7_301_000),
        ),
        [(f"handle {method}", 200, 0), (ended, 200 + answered_ns, 5), ("handle simPause", 7_300_400, 5)],
    )
    took_ns = 7_300_000 - 200 - answered_ns
    of_both = {channel: [took_ns], f"{channel}@{wait}": [took_ns], "pause": [600], f"pause@{wait}": [600]}
    assert latencies.reply == of_both
    assert latencies.request == {"pause": [400], f"pause@{wait}": [400]}
    assert (latencies.issue, latencies.timer) == ([], [])


def test_a_trace_is_of_the_second_command_alone_in_the_order_of_its_times() -> None:
    """A command of 0.5 s at 50x in lockstep takes 10 ms; the first one has moved the drone by half a second."""
    with VirtualSession("blocks", "native") as session:
        events = record_trace(session, "tcsc", 50.0, 0.5)
    names = [event["event"] for event in events]
    assert names.count("call moveByVelocity") == names.count("handle moveByVelocity") == 1
    assert not any("Trace" in name for name in names)
    for column, whole_s in (("wall_s", 0.01), ("sim_s", 0.5)):
        times = [event[column] for event in events]
        assert times == sorted(times)
        assert times[-1] - times[0] == pytest.approx(whole_s)


# --- the agreement of clocks ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("virtual", "again", "agrees"),
    [
        ([10.0, 20.0, 30.0], [10.0, 20.0, 30.0], True),
        ([10.0, 24.1, 30.0], [10.0, 20.0, 30.0], False),  # the median by more than a fifth
        ([10.0, 20.0, 36.5], [10.0, 20.0, 30.0], False),  # the tail, where the machine agrees with itself
        ([10.0, 20.0, 41.9], [10.0, 20.0, 36.0], True),  # and where it does not
        ([10.0, 20.0, 42.1], [10.0, 20.0, 36.0], False),
        ([5.0, 20.0, 30.0], [10.0, 20.0, 30.0], False),
    ],
)
def test_a_model_agrees_as_two_runs_of_the_machine_do(virtual: list[float], again: list[float], agrees: bool) -> None:
    wall = np.array([10.0, 20.0, 30.0])
    assert (
        Agreement("adsc", 50.0, 1.0, "gap s", wall, np.array(again), np.array(virtual)).verdict == "agrees"
    ) is agrees


def flown(offset_m: float, wall_s: float, gap_s: np.ndarray) -> SquareGame:
    """A flight of two places, each so far off the ideal one."""
    places = np.array([[0.0, offset_m, 0.0], [100.0, offset_m, 0.0]])
    return SquareGame(trajectory([0.0, 1.0], places), gap_s, wall_s)


def test_each_game_is_flown_on_the_machines_clock_on_the_model_and_on_the_machines_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As if the model were twice as slow as the first run, and the second one three times."""
    models: list[LatencyConfig] = []
    own = tmp_path / "latency.yaml"
    own.write_text("latency: {request_us: {call: " + str([7.0] * len(QUANTILES)) + "}}\n")

    def virtual(scene: str, profile: str, *latency: LatencyConfig) -> Any:
        models.extend(latency)
        return nullcontext("model" if latency else "ideal")

    monkeypatch.setattr(calibrate, "WallSession", lambda *_: nullcontext("wall"))
    monkeypatch.setattr(calibrate, "VirtualSession", virtual)
    monkeypatch.setattr(doctor, "check_machine", lambda: QUIET)
    asked: list[str] = []

    def fly(session: str, command: str, speed: float, t_move_s: float, rounds: int, seed: int) -> SquareGame:
        asked.append(session)
        run = {"wall": 1.0, "model": 2.0, "ideal": 0.0}[session]
        run = 3.0 if asked[-2:] == ["model", "wall"] else run
        return flown(run * (seed + 1) / 10, 0.0, run * np.arange(11.0) / 1000)

    monkeypatch.setattr(calibrate, "fly_square", fly)
    lines = printed(f"timing calibrate --check --games 2 --latency {own}")
    assert models == [read_latency(own)]
    assert asked == ["wall", "model", "wall", "wall", "model", "wall", "ideal"] * 8
    pauses = ["1", "5", "9", "3", "15", "27", "2", "10", "18", "agrees"]
    assert ["ADSC", "50x", "0.2", "s", "pause", "ms", *pauses] in lines
    errors = ["11", "15", "19", "33", "45", "57", "22", "30", "38", "agrees"]
    assert ["TCSC", "100x", "1", "s", "error", "cm", *errors] in lines
    assert lines[-1] == ["16", "of", "16", "agree"]


def test_a_check_of_a_model_is_told_cell_by_cell_within_80_columns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[str] = []

    def check_agreement(*_: Any) -> Any:
        for command, clock in product(("adsc", "tcsc"), (50.0, 100.0)):
            said.append(capsys.readouterr().out)
            runs = (np.array([0.0123456, run, 123.456]) for run in (12.3456, 12.3456, 27.6543))
            yield Agreement(command, clock, 0.2, "error cm", *runs)

    monkeypatch.setattr(calibrate, "check_agreement", check_agreement)
    monkeypatch.setattr(doctor, "check_machine", lambda: QUIET)
    machine.calibrate(check=True)
    assert [len(text.splitlines()) for text in said] == [4, 1, 1, 1]  # the head, and then a row at a time
    rows = "".join([*said[1:], capsys.readouterr().out]).splitlines()
    assert rows[0] == "ADSC   50x 0.2 s  error cm 0.012 12.3 123 0.012 12.3 123 0.012 27.7 123 124% off"
    assert all(len(line) <= 80 for line in [*said[0].splitlines()[1:], *rows])
    assert rows[-1] == "0 of 4 agree"


# --- advise -----------------------------------------------------------------------------------------------------------


def advised(*rows: tuple[float, ...]) -> pd.DataFrame:
    """Advice by ClockSpeed, and error and speed-up of ADSC and of TCSC."""
    return pd.DataFrame(
        {"clock_speed": clock_speed, "command": command, "error_m": error_m, "stlc": stlc, "speedup": speedup}
        for clock_speed, adsc_m, adsc, tcsc_m, tcsc in rows
        for command, error_m, stlc, speedup in (("adsc", adsc_m, 1.5, adsc), ("tcsc", tcsc_m, 2.0, tcsc))
    )


def of(table: pd.DataFrame, command: str, name: str) -> list[float]:
    return table.loc[table.command == command, name].tolist()


def test_the_sentence_names_the_fastest_within_the_error() -> None:
    rows = [
        (1.0, 0.0, 0.9, 0.0, 1.0),
        (10.0, 0.05, 9.0, 0.0, 10.0),
        (20.0, 0.05, 8.0, 0.0, 18.0),  # ADSC is slower there than at ClockSpeed 10
        (50.0, 0.2, 45.0, 0.01, 50.0),
    ]
    assert sentence(advised(*rows), 0.1, 1.0) == (
        "With commands of 1 s ADSC stays within 0.1 m up to ClockSpeed 10, 9.0x real time; TCSC up to 50, 50.0x. "
        "Modelled."
    )
    assert "ADSC leaves 0.1 m at any ClockSpeed" in sentence(advised((1.0, 0.2, 0.9, 0.0, 1.0)), 0.1, 1.0)


def test_without_latency_both_fly_alike_and_with_it_adsc_alone_is_off() -> None:
    ideal = advise(ZERO_LATENCY, "native", 0.2, 1)
    assert set(ideal.error_m) == {0.0}
    assert of(ideal, "tcsc", "speedup") == pytest.approx(of(ideal, "tcsc", "clock_speed"))
    slow = LatencyConfig(reply_us={"call": (5_000.0,) * 12})
    late = advise(slow, "native", 0.2, 1)
    assert set(of(late, "tcsc", "error_m")) == {0.0}
    errors_m = of(late, "adsc", "error_m")
    assert errors_m[-1] > errors_m[2] > 0.0
    assert of(late, "adsc", "speedup")[-1] < of(late, "tcsc", "speedup")[-1] < late.clock_speed.max()


def test_commands_are_compared_with_the_ideal_flight_and_with_adsc_in_real_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Five games of each, off by squares: their median, and their mean wall time, are in the middle of nothing else."""
    asked = []

    def fly(session: Any, command: str, speed: float, t_move_s: float, rounds: int, *seed_and_t_th: int) -> Any:
        asked.append((command, speed, *seed_and_t_th))
        if session is None:
            return flown(0.0, 1.0, np.empty(0))
        number = (seed_and_t_th[0] % 5 + 1) ** 2
        unit_m, unit_s = (0.1, 2.0) if command == "adsc" else (0.01, 1.0)
        return flown(unit_m * number, unit_s * number / speed, np.empty(0))

    monkeypatch.setattr(advice, "VirtualSession", lambda *told: nullcontext(told[2] if told[2:] else None))
    monkeypatch.setattr(advice, "fly_square", fly)
    squares = np.arange(1, 6) ** 2
    found = advise(ZERO_LATENCY, "airsim", 1.0, 2, seed=3)
    for command, unit_m, gain in (("adsc", 0.1, 1.0), ("tcsc", 0.01, 2.0)):
        apart_m = abs(unit_m * squares[:, None] - 0.1 * squares)
        expected = {"error_m": 9 * unit_m, "stlc": np.median((1 + np.exp(-apart_m)).mean(axis=1))}
        for name, value in expected.items():
            assert of(found, command, name) == pytest.approx([value] * len(advice.CLOCK_SPEEDS))
        assert of(found, command, "speedup") == pytest.approx([gain * speed for speed in advice.CLOCK_SPEEDS])
        assert of(found, command, "clock_speed") == list(advice.CLOCK_SPEEDS)
    assert {seed for command, speed, seed, _ in asked[1:]} == {15, 16, 17, 18, 19}  # none of them another seed's
    latest_ns = {speed: t_th_ns for _, speed, _, t_th_ns in asked}
    assert (latest_ns[1.0], latest_ns[50.0], latest_ns[200.0]) == (3_000_000, 50_000_000, 100_000_000)


def test_advice_is_of_what_was_asked_for_by_the_profiles_model_or_ones_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[Any] = []

    def answer(*how: Any) -> pd.DataFrame:
        asked.append(how)
        return advised((1.0, 0.01, 0.98, 0.001, 0.999), (50.0, 0.75, 30.0, 0.05, 45.0))

    monkeypatch.setattr(advice, "advise", answer)
    own = tmp_path / "latency.yaml"
    own.write_text("latency: {request_us: {call: " + str([7.0] * len(QUANTILES)) + "}}\n")
    for option, profile, model in (
        ("", "airsim", shipped_latency("airsim")),
        ("", "native", shipped_latency("native")),
        (f"--latency {own}", "native", read_latency(own)),
    ):
        lines = printed(f"timing advise --t-move 0.5 --error 0.1 --rounds 3 --profile {profile} {option}")
        assert asked[-1] == (model, profile, 0.5, 3)
        assert lines[1] == ["1x", "0.01", "1.5", "0.98", "0.001", "2", "0.999"]
        assert lines[2] == ["50x", "0.75", "1.5", "30", "0.05", "2", "45"]
        assert lines[3][:9] == ["With", "commands", "of", "0.5", "s", "ADSC", "stays", "within", "0.1"]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("timing advise --t-move 0.333", "--t-move: 0.333 s is not a positive multiple"),
        ("timing advise --error 0", "--error 0: must be above 0"),
    ],
)
def test_what_cannot_be_advised_or_measured_is_one_line(line: str, said: str) -> None:
    with pytest.raises(UserError, match=said):
        printed(line)


@pytest.mark.parametrize(
    ("t_th_ns", "command_s"), [(0, 0.0103), (999_999, 0.0103), (1_000_000, 0.01), (2_000_000, 0.01)]
)
def test_a_square_is_flown_without_the_rests_that_it_is_told_to_leave(t_th_ns: int, command_s: float) -> None:
    """0.1 s at 10x are 33 of AirSim's ticks of 3 ms and a rest of 1 ms, for which another tick would be flown."""
    with VirtualSession("blocks", "airsim") as session:
        game = fly_square(session, "tcsc", 10.0, 0.1, 2, 0, t_th_ns)
    assert game.wall_s == pytest.approx(2 * 4 * command_s)
    assert game.gap_s == pytest.approx([0.0] * 7)
    assert command_gaps_s([0.0, 1.25, 2.75], [1.0, 2.5, 4.0]) == pytest.approx([0.25, 0.25])


def test_a_seed_chooses_the_latencies() -> None:
    uneven = LatencyConfig(reply_us={"call": tuple(float(1_000 * n) for n in range(12))})
    told = {seed: advise(uneven, "native", 0.2, 1, seed) for seed in (0, 1)}
    assert of(told[0], "adsc", "error_m") != of(told[1], "adsc", "error_m")
    pd.testing.assert_frame_equal(advise(uneven, "native", 0.2, 1), told[0], check_exact=True)
