"""Advice on ClockSpeeds, and the check of a latency model against the machine."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uavaccel.bench import advice, agreement, calibration
from uavaccel.bench.advice import Advice, advise, sentence
from uavaccel.bench.agreement import Agreement
from uavaccel.bench.calibration import Latencies, _gather
from uavaccel.bench.square import SquareGame, fly_square
from uavaccel.bench.traces import ClientEvent
from uavaccel.cli.advise import show_advice
from uavaccel.errors import UserError
from uavaccel.metrics.trajectory import trajectory
from uavaccel.wire.latency import QUANTILES, ZERO_LATENCY, LatencyConfig, shipped_latency
from uavaccel.wire.session import VirtualSession


def row(clock_speed: float, adsc_m: float, tcsc_m: float) -> Advice:
    return Advice(clock_speed, adsc_m, 1.9, 0.9 * clock_speed, tcsc_m, 2.0, clock_speed)


def test_the_sentence_names_the_fastest_within_the_error() -> None:
    saturated = Advice(20, 0.05, 1.9, 8.0, 0.0, 2.0, 18.0)  # ADSC is slower there than at ClockSpeed 10
    told = [row(1, 0.0, 0.0), row(10, 0.05, 0.0), saturated, row(50, 0.2, 0.01)]
    said = sentence(told, 0.1, 1.0)
    assert said.startswith(
        "With commands of 1 s ADSC stays within 0.1 m up to ClockSpeed 10, 9.0x real time;"
    )
    assert "TCSC up to 50, 50.0x" in said
    assert "ADSC leaves 0.1 m at any ClockSpeed" in sentence([row(1, 0.2, 0.0)], 0.1, 1.0)


def test_without_latency_both_fly_alike_and_with_it_adsc_alone_is_off() -> None:
    ideal = list(advise(ZERO_LATENCY, "native", 0.2, 1))
    assert {(each.adsc_error_m, each.tcsc_error_m) for each in ideal} == {(0.0, 0.0)}
    assert [each.tcsc_speedup for each in ideal] == pytest.approx([each.clock_speed for each in ideal])
    with VirtualSession("blocks", "native") as lockstep:
        assert fly_square(lockstep, "tcsc", 10.0, 0.2, 1, 0).wall_s == pytest.approx(4 * 0.2 / 10)
    slow = LatencyConfig(reply_us={"call": (5_000.0,) * 12})
    late = list(advise(slow, "native", 0.2, 1))
    assert {each.tcsc_error_m for each in late} == {0.0}
    assert late[-1].adsc_error_m > late[2].adsc_error_m > 0.0
    assert late[-1].adsc_speedup < late[-1].tcsc_speedup < late[-1].clock_speed


def flown(offset_m: float, wall_s: float, gap_s: np.ndarray) -> SquareGame:
    """A flight of two places, each so far off the ideal one."""
    places = np.array([[0.0, offset_m, 0.0], [100.0, offset_m, 0.0]])
    return SquareGame(trajectory([0.0, 1.0], places), gap_s, wall_s)


def test_commands_are_compared_with_the_ideal_flight_and_with_adsc_in_real_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Five games of each, off by squares: their median, and their mean wall time, are in the middle of nothing else."""
    asked = []

    def fly(
        session: Any, command: str, speed: float, t_move_s: float, rounds: int, *seed_and_t_th: int
    ) -> Any:
        asked.append((command, speed, *seed_and_t_th))
        if session is None:
            return flown(0.0, 1.0, np.empty(0))
        number = (seed_and_t_th[0] % 5 + 1) ** 2
        unit_m, unit_s = (0.1, 2.0) if command == "adsc" else (0.01, 1.0)
        return flown(unit_m * number, unit_s * number / speed, np.empty(0))

    monkeypatch.setattr(advice, "VirtualSession", lambda *told: nullcontext(told[2] if told[2:] else None))
    monkeypatch.setattr(advice, "fly_square", fly)
    found = list(advise(ZERO_LATENCY, "airsim", 1.0, 2, seed=3))
    squares = np.arange(1, 6) ** 2
    for each in found:
        apart_m = abs(0.01 * squares[:, None] - 0.1 * squares).T
        assert each[1:] == pytest.approx((
            0.9,
            np.median((1 + np.exp(-abs(0.1 * squares[:, None] - 0.1 * squares))).mean(axis=1)),
            each.clock_speed,
            0.09,
            np.median((1 + np.exp(-apart_m)).mean(axis=0)),
            2 * each.clock_speed,
        ))  # fmt: skip
    assert [each.clock_speed for each in found] == list(advice.CLOCK_SPEEDS)
    seeds = {seed for command, speed, seed, _ in asked[1:]}
    assert seeds == {15, 16, 17, 18, 19}  # none of them another seed's
    latest_ns = {speed: t_th_ns for _, speed, _, t_th_ns in asked}
    assert (latest_ns[1.0], latest_ns[50.0], latest_ns[200.0]) == (3_000_000, 50_000_000, 100_000_000)


def test_its_seed_chooses_the_latencies() -> None:
    """Of every game: another seed has other games, and the first seed's are those that the command line shows."""
    uneven = LatencyConfig(reply_us={"call": tuple(float(1_000 * n) for n in range(12))})
    told = {seed: list(advise(uneven, "native", 0.2, 1, seed))[3] for seed in (0, 1)}
    assert told[0].adsc_error_m != told[1].adsc_error_m
    assert list(advise(uneven, "native", 0.2, 1))[3] == told[0]


def test_airsim_is_advised_with_its_own_model(capsys: pytest.CaptureFixture[str]) -> None:
    show_advice(1.0, 0.1, 1, None, "airsim")
    said = capsys.readouterr().out.splitlines()[-1]
    assert "ADSC" in said
    assert "TCSC up to" in said
    assert shipped_latency("airsim") != shipped_latency("native")


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ((0.333, 0.1, 1, None, "native"), "--t-move: 0.333 s is not a positive multiple"),
        ((1.0, 0.0, 1, None, "native"), "--error 0: must be above 0"),
        ((1.0, 0.1, 0, None, "native"), "--rounds 0: must be 1 to"),
        ((1.0, 0.1, 1, None, "px4"), "--profile px4: must be native or airsim"),
    ],
)
def test_what_cannot_be_advised_is_one_line(request_: tuple[Any, ...], said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        show_advice(*request_)
    assert "\n" not in str(caught.value)


def agreement_of(virtual: list[float], again: list[float]) -> Agreement:
    wall = np.array([10.0, 20.0, 30.0])
    return Agreement("adsc", 50.0, 1.0, "gap s", wall, np.array(again), np.array(virtual))


@pytest.mark.parametrize(
    ("virtual", "again", "agrees"),
    [
        ([10.0, 20.0, 30.0], [10.0, 20.0, 30.0], True),
        ([10.0, 24.1, 30.0], [10.0, 20.0, 30.0], False),  # the median by more than a fifth
        ([10.0, 20.0, 36.5], [10.0, 20.0, 30.0], False),  # the tail, where the machine agrees with itself
        ([10.0, 20.0, 36.5], [10.0, 20.0, 36.0], True),  # and where it does not
        ([5.0, 20.0, 30.0], [10.0, 20.0, 30.0], False),
    ],
)
def test_a_model_agrees_as_two_runs_of_the_machine_do(
    virtual: list[float], again: list[float], agrees: bool
) -> None:
    assert agreement_of(virtual, again).agrees is agrees


def test_each_game_is_flown_on_the_machines_clock_on_the_model_and_on_the_machines_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("WallSession", "VirtualSession"):
        marks = {2: "wall" if name == "WallSession" else "ideal", 3: "model"}
        monkeypatch.setattr(agreement, name, lambda *told, marks=marks: nullcontext(marks[len(told)]))
    asked = []

    def fly(session: str, command: str, speed: float, t_move_s: float, rounds: int, seed: int) -> SquareGame:
        asked.append(session)
        run = {"wall": 1.0, "model": 2.0, "ideal": 0.0}[session]
        run = 3.0 if asked[-2:] == ["model", "wall"] else run
        return flown(run * (seed + 1), 0.0, run * np.arange(11.0))

    monkeypatch.setattr(agreement, "fly_square", fly)
    found = list(agreement.check_agreement(ZERO_LATENCY, "native", 2))
    assert asked == ["wall", "model", "wall", "wall", "model", "wall", "ideal"] * 8
    assert len({each[:3] for each in found}) == 8
    for each in found:
        once = np.array([1.1, 1.5, 1.9]) if each.quantity == "error m" else np.array([1.0, 5.0, 9.0])
        np.testing.assert_allclose([each.wall, each.virtual, each.wall_again], [once, 2 * once, 3 * once])
        assert each.median_off == pytest.approx(0.0)


def test_as_many_commands_of_each_kind_are_timed_as_were_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    batches: list[tuple[str, str]] = []
    monkeypatch.setattr(calibration, "WallSession", VirtualSession)
    monkeypatch.setattr(calibration, "_fly_batch", lambda client, name, *_: batches.append(("fly", name)))
    monkeypatch.setattr(calibration, "_request", lambda client, what, _: batches.append(("ask", what)))
    commands = 3 * 8 * calibration.BATCH  # three batches at each of two ClockSpeeds and four T_move
    calibration.calibrate("native", commands, images=False)
    assert sorted(batches) == [("ask", "ping")] * 48 + [("fly", "adsc")] * 24 + [("fly", "tcsc")] * 24


@pytest.mark.parametrize(("images", "batches"), [(1, 1), (24, 1), (47, 1), (72, 3)])
def test_as_many_images_are_timed_as_were_asked_for_after_one_that_is_not(
    images: int, batches: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In whole batches of 24; the first image of all is the one that loads OpenGL."""
    asked: list[str] = []
    game = SimpleNamespace(start_game=lambda *_, lane: SimpleNamespace(image=asked.append))
    monkeypatch.setattr(calibration, "WallSession", lambda scene, profile: nullcontext(game))
    monkeypatch.setattr(calibration, "_request", lambda client, what, _: asked.append(f"24 of {what}"))
    calibration._take_images("native", images, Latencies())
    assert asked == ["gray", *["24 of image"] * batches]


def test_a_coalesced_command_has_no_latency_of_its_own() -> None:
    """What travels with the next message is neither a request nor an issue; the next one's request has both in it."""

    class Traced:
        events = (
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
        )

    server = [
        ("handle uavaccelState", 20, 0),
        ("handle moveByVelocity", 100, 0),
        ("handle uavaccelContinueFor", 110, 0),
        ("timer", 12_000_000, 5),
        ("pause", 12_000_040, 5),
        ("handle simPause", 12_000_400, 5),
        ("pause", 12_000_400, 5),  # for which no timer was set
        ("handle uavaccelState", 12_001_000, 5),
    ]
    latencies = Latencies()
    _gather(Traced(), server, latencies)  # type: ignore[arg-type]
    assert latencies.request["move"] == []
    assert latencies.request["continue_for"] == [110 - 53]
    assert latencies.reply["continue_for"] == [200 - 40]
    assert latencies.timer == [40]
    assert latencies.request["pause"] == latencies.request["pause@10ms"] == [200]  # after a wait of 12 ms
    assert latencies.reply["pause"] == [500]
    assert latencies.issue == [30]
    assert latencies.counts() == "3 requests, 3 replies, 1 issues, 1 wall timers"
    assert calibration.quantiles_us([40_000]) == [40.0] * len(QUANTILES)


@pytest.mark.parametrize(("answered_ns", "wait"), [(7_000_000, "5ms"), (7_100_000, "10ms")])
@pytest.mark.parametrize(
    ("method", "channel", "ended"),
    [("moveByVelocity", "move", "end"), ("uavaccelContinueFor", "continue_for", "pause")],
)
def test_a_wait_lasts_until_the_answer_and_not_until_it_has_arrived(
    method: str, channel: str, ended: str, answered_ns: int, wait: str
) -> None:
    """What follows it is counted as after a wait of that length: 7.07 ms are between 5 and 10."""

    class Traced:
        events = (
            ClientEvent("call", method, channel, 0),
            ClientEvent("return", method, channel, 7_300_000),
            ClientEvent("call", "simPause", "pause", 7_300_100),
            ClientEvent("return", "simPause", "pause", 7_301_000),
        )

    server = [
        (f"handle {method}", 200, 0),
        (ended, 200 + answered_ns, 5),
        ("handle simPause", 7_300_400, 5),
    ]
    latencies = Latencies()
    _gather(Traced(), server, latencies)  # type: ignore[arg-type]
    took_ns = 7_300_000 - 200 - answered_ns
    of_both = {channel: [took_ns], f"{channel}@{wait}": [took_ns], "pause": [600], f"pause@{wait}": [600]}
    assert latencies.reply == of_both
    assert latencies.request == {"pause": [400], f"pause@{wait}": [400]}
    assert (latencies.issue, latencies.timer) == ([], [])


@pytest.mark.parametrize(
    ("t_th_ns", "command_s"), [(0, 0.0103), (999_999, 0.0103), (1_000_000, 0.01), (2_000_000, 0.01)]
)
def test_a_square_is_flown_without_the_rests_that_it_is_told_to_leave(t_th_ns: int, command_s: float) -> None:
    """0.1 s at 10x are 33 of AirSim's ticks of 3 ms and a rest of 1 ms, for which another tick would be flown."""
    with VirtualSession("blocks", "airsim") as session:
        game = fly_square(session, "tcsc", 10.0, 0.1, 2, 0, t_th_ns)
    assert game.wall_s == pytest.approx(2 * 4 * command_s)
    assert game.gap_s == pytest.approx([0.0] * 7)
