"""What doctor, calibrate and advise find and print: of probes, messages and flights that are given here."""

from __future__ import annotations

import re
import sys
from collections import Counter
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.golden import assert_as_recorded
from tests.running import configured, typed
from tools.check_numbers import ROOT
from tools.fit_gap_law import PREDICTED, fit, judged
from uavaccel.calibration import calibrate, doctor
from uavaccel.calibration import calibrate as advice
from uavaccel.calibration.calibrate import (
    Agreement,
    ClientEvent,
    Latencies,
    SquareGame,
    advise,
    fly_square,
    policy_sentence,
    quantiles_us,
    record_trace,
    sentence,
)
from uavaccel.commands import COMMANDS
from uavaccel.errors import UserError
from uavaccel.metrics.trajectory import trajectory
from uavaccel.wire.latency import QUANTILES, ZERO_LATENCY, LatencyConfig, read_latency, shipped_latency
from uavaccel.wire.session import VirtualSession


def latency_of(folder: Path) -> Path:
    """A file of latencies: 7 us of each call's request."""
    file = folder / "latency.yaml"
    file.write_text(f"latency: {{request_us: {{call: {[7.0] * len(QUANTILES)}}}}}\n")
    return file


# --- the machine, and the doctor --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cores", "load", "late_us", "doubts"),
    [
        (4, 2.0, 200.0, []),
        (4, 2.1, 200.0, ["load 2.10 on 4 cores"]),
        (4, 0.0, 200.1, ["sleeps end 200 us late (90th percentile)"]),
        (1, 0.6, 300.0, ["one core for client and server together", "load 0.60 on 1 cores", "sleeps end 300 us"]),
    ],
)  # fmt: skip
def test_a_machine_is_quiet_by_its_cores_its_load_and_its_sleeps(
    monkeypatch: pytest.MonkeyPatch, cores: int, load: float, late_us: float, doubts: list[str]
) -> None:
    """Of 50 sleeps, sorted, the median is the 26th and the 90th percentile the 46th."""
    monkeypatch.setattr(doctor, "usable_cores", lambda: cores)
    monkeypatch.setattr(doctor, "timer_grain_ns", lambda: [round(1000 * late_us * n / 45) for n in range(50)])
    monkeypatch.setattr("os.getloadavg", lambda: (load, 99.0, 99.0))
    found = doctor.check_machine()
    assert found["verdict"].startswith(f"noisy: {', '.join(doubts)}" if doubts else "quiet")
    late: Any = [found["timer_late_median_us"], found["timer_late_p90_us"]]
    assert (found["cores"], found["load_1min"]) == (cores, load)
    assert late == pytest.approx([late_us * 25 / 45, late_us], abs=0.001)


QUIET: dict[str, Any] = {
    "verdict": "quiet", "cores": 3, "load_1min": 0.25, "timer_late_median_us": 11.0, "timer_late_p90_us": 22.0,
}  # fmt: skip
NOISY = {**QUIET, "verdict": "noisy: load 9.00 on 3 cores; measured latencies are pessimistic"}


def test_the_doctor_marks_and_counts_what_is_to_be_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine in order, one that compiles first, and one that lacks and doubts all."""
    draws, said, host = {"backend": "egl", "name": "a card"}, [], {"platform": "Linux", "cpu_model": "a processor"}
    for found, versions, loop, software in (
        (QUIET, {"uavaccel": "1.0", "numpy": "2.0"}, {"cached": True, "seconds": 0.25}, False),
        (QUIET, {"numpy": "2.0", "ray": None}, {"cached": False, "seconds": 30.0}, False),
        (NOISY, {"numpy": None}, None, True),
    ):

        def probe(program: str, loop: Any = loop, software: bool = software) -> Any:
            if program != doctor.RENDERER and loop is None:
                raise doctor.ProbeError("it crashed")
            return {**draws, "software": software} if program == doctor.RENDERER else loop

        run = {"versions": versions, "host": host}
        for name, result in (("describe_run", run), ("check_machine", found)):
            monkeypatch.setattr(doctor, name, lambda *_, result=result: result)
        monkeypatch.setattr(doctor, "probe", probe)
        said.append(typed("doctor"))
    assert_as_recorded("doctor", "\n".join(said))


@pytest.mark.parametrize(("program", "text", "advised"), [
    ("import os; os.abort()", "it crashed (SIGABRT)", False),
    ("raise OSError('no libEGL')", "OSError: no libEGL", False),
    ("import sys; sys.exit(3)", "it ended with status 3", False),
    ("from uavaccel.errors import UserError; raise UserError('unset it')", "unset it", True),
])  # fmt: skip
def test_a_probe_that_fails_is_one_line_with_advice_once(
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
    assert (finding.problem, "numba's cache" in finding.text) == (False, True)
    monkeypatch.setattr(doctor, "TIMEOUT_S", 0.1)
    with pytest.raises(doctor.ProbeError, match="no answer within"):
        doctor.probe("while True: pass")


# --- calibrate --------------------------------------------------------------------------------------------------------


def test_a_calibration_is_a_latency_model_with_its_medians_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Of 0, 1, ... 1000 us the quantiles are 1000 times their shares."""
    latencies = Latencies()
    for number in range(1001):
        latencies.add(latencies.request, "call", None, 1000 * number)
        latencies.add(latencies.reply, "call", None, 500 * number)
        latencies.add(latencies.reply, "move", 10_000_000, 2000 * number)
        latencies.issue.append(3000 * number)

    def measure(*how: Any) -> Latencies:
        assert how == ("airsim", 70, False)
        return latencies

    def draws_nothing() -> None:
        raise UserError("no card")

    monkeypatch.setattr(calibrate, "measure", measure)
    monkeypatch.setattr(doctor, "check_machine", lambda: NOISY)
    monkeypatch.setattr("uavaccel.sim.camera.gl.describe_renderer", draws_nothing)
    said = typed(f"timing calibrate --out {(file := tmp_path / 'latency.yaml')} --commands 70 --profile airsim")
    key = said.split()[-1].strip("`")  # which train and evaluate know
    assert key == f"task.latency={file}"
    airsims = configured("train", "task.timing=virtual", "task.profile=airsim", key).task.latency
    assert (airsims, airsims.platform) == (read_latency(file), shipped_latency("airsim").platform)
    head, _, *model = file.read_text().splitlines()
    assert "profile airsim, on 20" in head
    assert head.endswith(NOISY["verdict"])
    assert read_latency(file).request_us["call"] == pytest.approx([1000 * share for share in QUANTILES])
    assert_as_recorded("calibrate", said.replace(str(tmp_path), "FOLDER") + "\n".join(["", *model, ""]))


def test_as_many_commands_and_images_are_timed_as_were_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """In whole batches of 24, three at each of two ClockSpeeds and four T_move; the first image of all loads OpenGL."""
    batches: list[Any] = []
    image = SimpleNamespace(image=lambda kind: batches.append(f"first {kind}"))
    lane = nullcontext(SimpleNamespace(start_game=lambda *_, lane: image))
    asking: Any = SimpleNamespace(call=batches.append, image=batches.append)
    made: Any = {"blocks": partial(VirtualSession, "blocks", "airsim"), "lane": lambda: lane}
    monkeypatch.setattr(calibrate, "WallSession", lambda scene, profile: {"airsim": made[scene]}[profile]())
    timed = lambda _, __, send: batches.append(send.args[0]) if isinstance(send, partial) else send(asking)  # noqa: E731
    monkeypatch.setattr(calibrate, "time_batch", timed)
    calibrate.measure("airsim", 3 * 8 * calibrate.BATCH, images=False)
    assert Counter(batches) == {"ping": 48, COMMANDS["adsc"]: 24, COMMANDS["tcsc"]: 24}
    for images, count in ((1, 1), (47, 1), (72, 3)):
        batches.clear()
        calibrate.measure("airsim", images, images=True)
        assert batches[16 * 2 :] == ["first gray", *["gray"] * count]


def gathered(client: str, server: str) -> Latencies:
    """The latencies of messages: a line each of ns, kind, method and channel, + if coalesced; of ns and event."""
    events, latencies = [], Latencies()
    for line in client.strip().splitlines():
        ns, kind, method, channel, *coalesced = line.split()
        events.append(ClientEvent(kind, method, channel, int(ns), bool(coalesced)))
    told = (line.split(maxsplit=1) for line in server.strip().splitlines())
    latencies.gather(events, [(event, int(ns), 5) for ns, event in told])
    return latencies


def test_a_coalesced_command_has_no_latency_of_its_own() -> None:
    """What travels with the next message is neither a request nor an issue; the next one's request has both in it."""
    latencies = gathered(
        """
        0 call uavaccelState state
        50 return uavaccelState state
        51 call moveByVelocity move +
        53 issued moveByVelocity move +
        54 call uavaccelContinueFor continue_for
        12000200 return uavaccelContinueFor continue_for
        12000250 call simPause pause
        12000900 return simPause pause
        12000910 call uavaccelState state
        12000930 issued uavaccelState state""",
        """
        20 handle uavaccelState
        100 handle moveByVelocity
        110 handle uavaccelContinueFor
        12000000 timer
        12000040 pause
        12000400 handle simPause
        12000400 pause
        12001000 handle uavaccelState""",  # no timer was set for the second pause
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
def test_a_wait_lasts_until_the_answer_not_until_it_has_arrived(
    method: str, channel: str, ended: str, answered_ns: int, wait: str
) -> None:
    """What follows it is counted as after a wait of that length: 7.07 ms are between 5 and 10."""
    latencies = gathered(
        f"0 call {method} {channel}\n7300000 return {method} {channel}\n7300100 call simPause pause\n"
        "7301000 return simPause pause",
        f"200 handle {method}\n{200 + answered_ns} {ended}\n7300400 handle simPause",
    )
    took_ns = 7_300_000 - 200 - answered_ns
    of_both = {channel: [took_ns], f"{channel}@{wait}": [took_ns], "pause": [600], f"pause@{wait}": [600]}
    assert latencies.reply == of_both
    assert latencies.request == {"pause": [400], f"pause@{wait}": [400]}
    assert (latencies.issue, latencies.timer) == ([], [])


def test_a_trace_is_of_the_second_command_alone_in_order() -> None:
    """A command of 0.5 s at 50x in lockstep takes 10 ms; the first one has moved the drone by half a second."""
    with VirtualSession("blocks", "native") as session:
        events = record_trace(session, "tcsc", 50.0, 0.5)
    names = [event["event"] for event in events]
    assert names.count("call moveByVelocity") == names.count("handle moveByVelocity") == 1
    assert not any("Trace" in name or "State" in name for name in names), "what the client knows is not asked for"
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
    runs = (np.array(each) for each in ([10.0, 20.0, 30.0], again, virtual))
    assert (Agreement("adsc", 50.0, 1.0, "gap s", *runs).verdict == "agrees") is agrees


def flown(offset_m: float, wall_s: float, gap_s: np.ndarray) -> SquareGame:
    """A flight of two places, each so far off the ideal one."""
    places = np.array([[0.0, offset_m, 0.0], [100.0, offset_m, 0.0]])
    return SquareGame(trajectory([0.0, 1.0], places), gap_s, wall_s)


def test_agreements_are_told_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes seconds."""
    before: list[int] = []

    def agreements(*_: Any) -> Any:
        for _again in range(2):
            output: Any = sys.stdout
            output.flush()
            before.append(output.buffer.getvalue().count(b"TCSC"))
            runs = np.array([1.2, 12.3, 100.0])
            yield Agreement("tcsc", 100.0, 0.33, "error, m", runs, runs, runs)

    monkeypatch.setattr(calibrate, "check_agreement", agreements)
    table = typed("timing calibrate --check").splitlines()[1:]
    assert max(map(len, table)) <= 80
    assert before == [0, 1]


def test_each_game_is_flown_measured_modelled_and_measured_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As if the model were twice as slow as the first run, and the second one three times; within 80 columns."""
    models: list[LatencyConfig] = []
    asked: list[str] = []

    def virtual(scene: str, profile: str, *latency: LatencyConfig) -> Any:
        models.extend(latency)
        return nullcontext("model" if latency else "ideal")

    def fly(session: str, command: str, speed: float, t_move_s: float, rounds: int, seed: int) -> SquareGame:
        asked.append(session)
        run = {"wall": 1.0, "model": 2.0, "ideal": 0.0}[session]
        run = 3.0 if asked[-2:] == ["model", "wall"] else run
        off = run if command == "adsc" else min(run, 2.0)  # of TCSC both other runs are alike
        return flown(off * (seed + 1) / 10, 0.0, run * np.arange(11.0) / 1000)

    monkeypatch.setattr(calibrate, "WallSession", lambda *_: nullcontext("wall"))
    monkeypatch.setattr(calibrate, "VirtualSession", virtual)
    monkeypatch.setattr(doctor, "check_machine", lambda: QUIET)
    monkeypatch.setattr(calibrate, "fly_square", fly)
    said = typed(f"timing calibrate --check --games 2 --latency {latency_of(tmp_path)}")
    assert models == [read_latency(tmp_path / "latency.yaml")]
    assert asked == ["wall", "model", "wall", "wall", "model", "wall", "ideal"] * 8
    assert max(map(len, said.splitlines()[1:])) <= 80
    assert_as_recorded("calibrate_check", said.replace(str(tmp_path), "FOLDER"))


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
    """ADSC is slower at ClockSpeed 20 than at 10."""
    rows = [(1.0, 0.0, 0.9, 0.0, 1.0), (10.0, 0.05, 9.0, 0.0, 10.0), (20.0, 0.05, 8.0, 0.0, 18.0)]
    found = advised(*rows, (50.0, 0.2, 45.0, 0.01, 50.0))
    adsc = "ADSC is fastest within 0.1 m at ClockSpeed 10, 9.0x real time; TCSC at 50, 50.0x"
    assert sentence(found, 0.1, 1.0) == f"With commands of 1 s {adsc}. Modelled."
    assert "ADSC leaves 0.1 m at any ClockSpeed" in sentence(advised((1.0, 0.2, 0.9, 0.0, 1.0)), 0.1, 1.0)


def test_a_policy_is_advised_a_clock_speed_with_its_interval() -> None:
    middle = 100.0 * advice.T_MOVES
    low, high = middle / advice.ERROR**1.96, middle * advice.ERROR**1.96
    told = [
        float(each)
        for each in re.findall(r"ClockSpeed ([\d.]+) \(95 %: ([\d.]+) to ([\d.]+)\)", policy_sentence(1.0, 0.01))[0]
    ]
    assert told == pytest.approx([middle, low, high], rel=0.05)
    assert policy_sentence(0.2, 0.02) == policy_sentence(0.1, 0.01).replace("0.01 s", "0.02 s")


def test_the_advice_rests_on_the_published_rows() -> None:
    table = judged(pd.read_csv(ROOT / "docs/tables/gap_law.csv"))
    assert round(fit(table, ()).factor, 2) == advice.T_MOVES
    others = tuple(set(table.task) - set(PREDICTED))
    assert round(max(fit(table, half).error for half in (PREDICTED, others)), 1) == advice.ERROR


def test_without_latency_both_fly_alike_and_with_it_adsc_is_off() -> None:
    """A seed chooses the latencies where they differ; each flown row is told."""
    told = list[int]()
    ideal = advise(ZERO_LATENCY, "native", 0.2, 1, told=lambda: told.append(len(told)))
    assert len(told) == len(ideal)
    assert set(ideal.error_m) == {0.0}
    assert of(ideal, "tcsc", "speedup") == pytest.approx(of(ideal, "tcsc", "clock_speed"))
    uneven = LatencyConfig(reply_us={"call": tuple(float(1_000 * n) for n in range(12))})
    late, again = (advise(uneven, "native", 0.2, 1, seed) for seed in (0, 1))
    errors_m = of(late, "adsc", "error_m")
    assert errors_m[-1] > errors_m[2] > max(of(late, "tcsc", "error_m")) == 0.0
    assert of(late, "adsc", "speedup")[-1] < of(late, "tcsc", "speedup")[-1] < late.clock_speed.max()
    assert of(again, "adsc", "error_m") != errors_m


def test_commands_are_held_against_ideal_flight_and_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
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
            assert of(found, command, name) == pytest.approx([value] * len(advice.ADVISED_SPEEDS))
        assert of(found, command, "speedup") == pytest.approx([gain * speed for speed in advice.ADVISED_SPEEDS])
        assert of(found, command, "clock_speed") == list(advice.ADVISED_SPEEDS)
    assert found.command.tolist() == ["adsc", "tcsc"] * len(advice.ADVISED_SPEEDS)  # as the table's header has them
    assert {seed for command, speed, seed, _ in asked[1:]} == {15, 16, 17, 18, 19}  # none of them another seed's
    latest_ns = {speed: t_th_ns for _, speed, _, t_th_ns in asked}
    assert (latest_ns[1.0], latest_ns[50.0], latest_ns[200.0]) == (3_000_000, 50_000_000, 100_000_000)


def test_advice_is_of_the_profiles_latencies_or_ones_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[Any] = []

    def answer(*how: Any, told: Any) -> pd.DataFrame:
        asked.append(how)
        return advised((1.0, 0.01, 0.98, 0.001, 0.999), (50.0, 0.75, 30.0, 0.05, 45.0))

    monkeypatch.setattr(advice, "advise", answer)
    own = latency_of(tmp_path)
    for option, profile, model in (
        ("", "airsim", shipped_latency("airsim")),
        ("", "native", shipped_latency("native")),
        (f"--latency {own}", "native", read_latency(own)),
    ):
        said = typed(f"timing advise --t-move 0.5 --error 0.1 --rounds 3 --profile {profile} {option}")
        assert asked[-1] == (model, profile, 0.5, 3)
        assert_as_recorded("advise", said)


@pytest.mark.parametrize(("t_th_ns", "command_s"), [(0, 0.0103), (999_999, 0.0103), (1_000_000, 0.01)])
def test_a_square_is_flown_without_the_rests_that_it_may_leave(t_th_ns: int, command_s: float) -> None:
    """0.1 s at 10x are 33 of AirSim's ticks of 3 ms and a rest of 1 ms, for which another tick would be flown."""
    with VirtualSession("blocks", "airsim") as session:
        game = fly_square(session, "tcsc", 10.0, 0.1, 2, 0, t_th_ns)
    assert game.wall_s == pytest.approx(2 * 4 * command_s)
    assert game.gap_s == pytest.approx([0.0] * 7)
