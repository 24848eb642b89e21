"""Advice on ClockSpeeds, and the check of a latency model against the machine."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from uavaccel.bench.advice import Advice, advise, sentence
from uavaccel.bench.agreement import Agreement
from uavaccel.bench.calibration import Latencies, _gather
from uavaccel.bench.traces import ClientEvent
from uavaccel.cli.advise import show_advice
from uavaccel.errors import UserError
from uavaccel.wire.latency import ZERO_LATENCY, LatencyConfig, shipped_latency


def row(clock_speed: float, adsc_m: float, tcsc_m: float) -> Advice:
    return Advice(clock_speed, adsc_m, 1.9, 0.9 * clock_speed, tcsc_m, 2.0, clock_speed)


def test_the_sentence_names_the_fastest_within_the_error() -> None:
    advice = [row(1, 0.0, 0.0), row(10, 0.05, 0.0), row(50, 0.2, 0.01)]
    said = sentence(advice, 0.1, 1.0)
    assert said.startswith(
        "With commands of 1 s ADSC stays within 0.1 m up to ClockSpeed 10, 9.0x real time;"
    )
    assert "TCSC up to 50, 50.0x" in said
    assert "ADSC leaves 0.1 m at any ClockSpeed" in sentence([row(1, 0.2, 0.0)], 0.1, 1.0)


def test_without_latency_both_fly_alike_and_with_it_adsc_alone_is_off() -> None:
    ideal = list(advise(ZERO_LATENCY, "native", 0.2, 1))
    assert {(each.adsc_error_m, each.tcsc_error_m) for each in ideal} == {(0.0, 0.0)}
    assert [each.tcsc_speedup for each in ideal] == pytest.approx([each.clock_speed for each in ideal])
    slow = LatencyConfig(reply_us={"call": (5_000.0,) * 12})
    late = list(advise(slow, "native", 0.2, 1))
    assert {each.tcsc_error_m for each in late} == {0.0}
    assert late[-1].adsc_error_m > late[2].adsc_error_m > 0.0
    assert late[-1].adsc_speedup < late[-1].tcsc_speedup < late[-1].clock_speed


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


def agreement(virtual: list[float], again: list[float]) -> Agreement:
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
    assert agreement(virtual, again).agrees is agrees


def test_a_coalesced_command_has_no_latency_of_its_own() -> None:
    """What travels with the next message is neither a request nor an issue; the next one's request has both in it."""

    class Traced:
        events = (
            ClientEvent("call", "uavaccelState", "state", 0),
            ClientEvent("return", "uavaccelState", "state", 50),
            ClientEvent("call", "moveByVelocity", "move", 51, True),
            ClientEvent("issued", "moveByVelocity", "move", 53, True),
            ClientEvent("call", "uavaccelContinueFor", "continue_for", 54),
            ClientEvent("return", "uavaccelContinueFor", "continue_for", 1_200),
        )

    server = [
        ("handle uavaccelState", 20, 0),
        ("handle moveByVelocity", 100, 0),
        ("handle uavaccelContinueFor", 110, 0),
        ("timer", 1_000, 5),
        ("pause", 1_040, 5),
    ]
    latencies = Latencies()
    _gather(Traced(), server, latencies)  # type: ignore[arg-type]
    assert latencies.request["move"] == []
    assert latencies.issue == []
    assert latencies.request["continue_for"] == [110 - 53]
    assert latencies.reply["continue_for"] == [1_200 - 1_040]
    assert latencies.timer == [40]
