"""The latency model: which quantiles a message is drawn from, and what a configuration may say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.simulating import always
from uavaccel.config import Config, dump_yaml, load_yaml, schema, to_yaml, validate
from uavaccel.errors import UserError
from uavaccel.resources import experiment
from uavaccel.suites.dp1 import Dp1Config
from uavaccel.wire.latency import (
    WAITS_MS,
    ZERO_LATENCY,
    Latency,
    LatencyConfig,
    LatencyModel,
    PlatformConfig,
    after_wait,
    read_latency,
    shipped_latency,
)
from uavaccel.wire.transport import PendingCall

MS = 1_000_000
RISING_US = (0.0, 1.0, 5.0, 20.0, 60.0, 150.0, 400.0, 2e3, 1e4, 5e4, 2e5, 1e6)
CHANNELS = ("call", "move", "pause", "continue", "continue_for", "state", "image")


def latency_of(config: LatencyConfig, seed: int = 0, *key: int) -> Latency:
    return Latency(config, np.random.SeedSequence(seed, spawn_key=key))


# --- what is drawn ------------------------------------------------------------------------------------------


def test_each_kind_is_drawn_from_its_own_quantiles() -> None:
    config = LatencyConfig(
        request_us={"call": always(1.0), "move": always(2.0)},
        reply_us={"call": always(3.0), "move": always(4.5)},
        issue_us=always(5.0),
        timer_us=always(6.0),
    )
    latency = latency_of(config)
    assert [latency.request_ns("call"), latency.request_ns("move")] == [1_000, 2_000]
    assert [latency.reply_ns("call"), latency.reply_ns("move")] == [3_000, 4_500]
    assert [latency.request_ns("pause"), latency.reply_ns("pause")] == [1_000, 3_000], "the rest is a call"
    assert [latency.issue_ns(), latency.timer_ns()] == [5_000, 6_000]
    none = latency_of(ZERO_LATENCY)
    assert [none.request_ns("move"), none.reply_ns("move"), none.issue_ns(), none.timer_ns()] == [0] * 4


def test_a_wait_chooses_the_quantiles_after_it() -> None:
    """Those of the wait, if there are any, else the channel's, else the rest's."""
    config = LatencyConfig(
        request_us={"call": always(1.0), "pause": always(2.0), "pause@5ms": always(3.0), "call@5ms": always(9.0)},
        reply_us={"call": always(4.0), "pause@5ms": always(5.0)},
    )
    latency = latency_of(config)
    assert latency.request_ns("pause") == 2_000, "nothing has been waited for"
    latency.waited(5 * MS)
    assert [latency.request_ns("pause"), latency.reply_ns("pause")] == [3_000, 5_000]
    assert [latency.request_ns("call"), latency.request_ns("state")] == [9_000, 1_000]
    latency.waited(20 * MS)
    assert [latency.request_ns("pause"), latency.reply_ns("pause")] == [2_000, 4_000]


@given(st.integers(0, 10**9))
def test_a_wait_belongs_to_the_nearest_by_ratio(wait_ns: int) -> None:
    nearest = WAITS_MS[int(np.argmin(np.abs(np.log(np.array(WAITS_MS)) - np.log(max(wait_ns, 1) / MS))))]
    assert after_wait("pause", wait_ns) == f"pause@{nearest}ms"


def test_latencies_follow_their_quantiles() -> None:
    """Independent draws, uniform between two neighbouring quantiles."""
    config = LatencyConfig(
        quantiles=(0.0, 0.2, 1.0),
        request_us={"call": (10.0, 20.0, 100.0)},
        reply_us={"call": (0.0, 0.0, 0.0)},
        issue_us=(0.0, 0.0, 0.0),
        timer_us=(0.0, 0.0, 0.0),
    )
    latency = latency_of(config, 3)
    sample_us = np.array([latency.request_ns("call") for _ in range(20_000)]) / 1e3
    assert 10.0 <= sample_us.min() < 10.1
    assert 99.5 < sample_us.max() <= 100.0
    assert np.mean(sample_us < 20.0) == pytest.approx(0.2, abs=0.01)
    assert np.mean(sample_us < 60.0) == pytest.approx(0.6, abs=0.015)
    assert abs(np.corrcoef(sample_us[1:], sample_us[:-1])[0, 1]) < 0.03
    assert len(set(sample_us)) > 10_000, "nothing comes round again"


def test_seeds_and_their_children_draw_other_numbers() -> None:
    requests_us = {"call": RISING_US, "move": RISING_US}
    config = LatencyConfig(request_us=requests_us, reply_us={"call": RISING_US}, issue_us=RISING_US)
    seeds: list[tuple[int, ...]] = [(0,), (1,), (0, 1), (0, 2), (0, 1, 2)]
    games = {latency_of(config, *seed).request_ns("call") for seed in seeds}
    assert len(games) == 5
    latency = latency_of(config)
    kinds = {latency.request_ns("call"), latency.request_ns("move"), latency.reply_ns("call"), latency.issue_ns()}
    assert len(kinds) == 4


@given(st.lists(st.sampled_from(CHANNELS), max_size=60), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_channels_are_independent(others: list[str], seed: int) -> None:
    """What is drawn on other channels, for replies, timers and issues, leaves a channel's own draws as they are."""
    tables = dict.fromkeys(CHANNELS, RISING_US)
    config = LatencyConfig(request_us=tables, reply_us=tables, issue_us=RISING_US, timer_us=RISING_US)
    undisturbed, among = latency_of(config, seed), latency_of(config, seed)
    expected = [undisturbed.request_ns("move") for _ in range(20)]
    found = []
    for index in range(20):
        for other in others[3 * index : 3 * index + 3]:
            among.reply_ns(other)
            among.timer_ns()
            among.issue_ns()
            if other != "move":
                among.request_ns(other)
        found.append(among.request_ns("move"))
    assert found == expected


LIKELY = {"platform": {"faults": {"dropped": 0.2, "stalled": 0.3, "late": 0.4}}}


def test_a_fault_delays_a_message_by_its_own_time() -> None:
    for fault, late_ms in (("dropped", 200), ("stalled", 40), ("late", 10)):
        latency = latency_of(validate(LatencyConfig, {"scale": 3.0, "platform": {"faults": {fault: 1.0}}}, "test"))
        assert [latency.request_ns("call"), latency.reply_ns("call")] == [late_ms * MS] * 2


def test_faults_of_requests_are_independent_of_replies() -> None:
    config = validate(LatencyConfig, LIKELY, "test")
    silent, answered = latency_of(config), latency_of(config)
    requests = [silent.request_ns("call") for _ in range(50)]
    pairs = [(answered.request_ns("call"), answered.reply_ns("call")) for _ in range(50)]
    assert [request for request, _ in pairs] == requests
    assert [reply for _, reply in pairs] != requests


def test_calls_have_channels() -> None:
    channels: dict[str, list[tuple[str, list[Any]]]] = {
        "pause": [("simPause", [True])], "continue": [("simPause", [False])], "state": [("uavaccelState", [])],
        "move": [("moveByVelocity", []), ("moveByVelocityZ", [])], "continue_for": [("uavaccelContinueFor", [5])],
        "image": [("uavaccelImage", ["gray"]), ("simGetImages", [[]]), ("simGetImage", ["0", 0])],
        "call": [("ping", []), ("uavaccelCollision", [])],
    }  # fmt: skip
    for channel, calls in channels.items():
        assert {PendingCall(*call).channel for call in calls} == {channel}


# --- what a configuration may say ---------------------------------------------------------------------------


class Task(Config):
    latency: LatencyModel


BLOCK = {
    "quantiles": [0, 1],
    "request_us": {"call": [1, 2], "pause@20ms": [3, 4]},
    "reply_us": {"call": [5, 6]},
    "issue_us": [7, 8],
    "timer_us": [9, 9.5],
}


def write(folder: Path, block: Any) -> Path:
    path = folder / "mine.yaml"
    path.write_text(dump_yaml({"latency": block}))
    return path


def test_a_block_a_file_of_it_and_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In every configuration alike; where nothing is given, the model that ships."""
    written = validate(Task, {"latency": BLOCK}, "task").latency
    assert written.request_us == {"call": (1.0, 2.0), "pause@20ms": (3.0, 4.0)}
    assert (written.quantiles, written.reply_us["call"]) == ((0.0, 1.0), (5.0, 6.0))
    assert (written.issue_us, written.timer_us) == ((7.0, 8.0), (9.0, 9.5))
    path = write(tmp_path, BLOCK)
    assert validate(Task, {"latency": str(path)}, "task").latency == written == read_latency(path)
    monkeypatch.chdir(tmp_path)
    assert Task.model_validate({"latency": "mine.yaml"}).latency == written, "from the working directory"
    shipped = load_yaml(experiment("latency.yaml"))["latency"]
    assert validate(Task, {}, "task").latency == validate(LatencyConfig, shipped, "shipped")


def read(profile: str, latency: Any = None) -> LatencyConfig:
    """Of a configuration with such a block, or without one."""
    keys = {"suite": "dp1", "clock_speed": [5], "profile": profile}
    return validate(Dp1Config, keys if latency is None else {**keys, "latency": latency}, "dp1").latency


def test_a_block_without_quantiles_changes_the_model_that_ships() -> None:
    changed, shipped = (
        read("airsim", {"platform": {"tick_us": 70.0, "frames": {"hz": 30.0}}}),
        shipped_latency("airsim"),
    )
    assert changed.reply_us == shipped.reply_us
    assert (changed.platform.tick_us, changed.platform.frames.hz) == (70.0, 30.0)
    assert changed.platform.frames.stale_pose is shipped.platform.frames.stale_pose is True
    own = read("native", {"reply_us": {"call": [1.0] * 12}})
    assert own == LatencyConfig(reply_us={"call": (1.0,) * 12}), "quantiles of one's own: all of it"


def test_quantiles_of_ones_own_lose_no_platform_in_silence(tmp_path: Path) -> None:
    for own in (BLOCK, str(write(tmp_path, BLOCK))):
        with pytest.raises(UserError, match=r"own replace airsim's whole model: add its `platform`, or another$"):
            read("airsim", own)
    for platform in ({}, {"tick_us": 70.0}):
        found = read("airsim", {**BLOCK, "platform": platform})
        assert found.platform == PlatformConfig.model_validate(platform)


def test_a_factor_varies_one_channel_of_the_model_that_ships() -> None:
    """After any wait; what has no row of its own gets one of what it was drawn from."""
    shipped = shipped_latency("airsim")
    slow = read("airsim", {"reply_us": {"move": 4}})
    assert slow.reply_us["move"] == pytest.approx([4 * each for each in shipped.reply_us["move"]])
    assert slow.model_dump() == {
        **shipped.model_dump(),
        "reply_us": {**shipped.reply_us, "move": slow.reply_us["move"]},
    }
    both = read("airsim", {"reply_us": {"pause": 2}, "request_us": {"call": 0.5}, "scale": 3})
    assert both.reply_us == {**shipped.reply_us, "pause": tuple(2 * x for x in shipped.reply_us["call"])}
    assert both.request_us["call"] == tuple(0.5 * each for each in shipped.request_us["call"])
    assert both.scale == 3
    once, thrice = (Latency(each, np.random.SeedSequence(0)) for each in (both.model_copy(update={"scale": 1.0}), both))
    assert thrice.request_ns("call") == 3 * once.request_ns("call") > 0
    assert thrice.reply_ns("pause") == 3 * once.reply_ns("pause") > 0
    assert read("airsim", {"reply_us": {"pause": 1}}) == shipped
    measured = shipped_latency("native").reply_us
    assert read("airsim", {"reply_us": {"move@5ms": 4}}).reply_us["move@5ms"] == slow.reply_us["move"]
    waited = read("native", {"reply_us": {"move": 2, "pause@5ms": 3}}).reply_us
    assert waited["pause@5ms"] == tuple(3 * x for x in measured["pause@5ms"])
    for channel in {name.partition("@")[0] for name in measured}:
        rows = {name: tuple(2 * x for x in row) for name, row in measured.items() if name.split("@")[0] == channel}
        assert read("native", {"reply_us": {channel: 2}}).reply_us == {**measured, **rows}


@pytest.mark.parametrize(
    ("latency", "text"),
    [
        ({"reply_us": {"mvoe": 4}}, "reply_us.mvoe is an unknown channel; did you mean 'move'"),
        ({"reply_us": {"move": -1}}, "reply_us.move must be 0 to 1000, a factor, not -1"),
        ({"reply_us": {"move": 1000}}, "reply_us = .* must be at most"),
        ({"reply_us": {"move": 4, "call": [1.0] * 12}}, "latency.reply_us.move = 4: a factor needs the model"),
        ({"reply_us": {"move": "slow"}}, "latency.reply_us.move = 'slow': "),
    ],
)
def test_a_factor_that_cannot_be_is_one_line(latency: dict[str, Any], text: str) -> None:
    with pytest.raises(UserError, match=text) as refused:
        read("airsim", latency)
    assert "\n" not in str(refused.value)


def test_each_profile_has_a_model_that_ships() -> None:
    """AirSim's where a configuration says `airsim` and nothing of latency."""
    for profile, file in (("native", "latency.yaml"), ("airsim", "latency_airsim.yaml")):
        assert read(profile) == read_latency(experiment(file))
    assert read_latency(experiment("latency_airsim.yaml")).platform.tick_us > 0
    assert Dp1Config(suite="dp1", clock_speed=(5,), profile="airsim", latency=ZERO_LATENCY).latency == ZERO_LATENCY


def test_a_resolved_configuration_holds_the_block(tmp_path: Path) -> None:
    task = validate(Task, {"latency": str(write(tmp_path, BLOCK))}, "task")
    again = tmp_path / "config.yaml"
    again.write_text(to_yaml(task))
    assert validate(Task, load_yaml(again), "config") == task
    kinds = schema(Task)["properties"]["latency"]["anyOf"]
    assert {"type": "string"} in kinds
    assert len(kinds) == 2


@pytest.mark.parametrize(("change", "text"), [
    ({"request_us": {"call": [0, 0], "contnue": [0, 0]}},
     "latency.request_us = .*: has an unknown channel 'contnue'; did you mean 'continue'?"),
    ({"reply_us": {"call": [0, 0], "pause@3ms": [0, 0]}}, "unknown channel 'pause@3ms'; did you mean 'pause@"),
    ({"reply_us": {"call": [0, 0], "": [0, 0]}}, "unknown channel ''; known: call, pause, continue, move"),
    ({"request_us": {"move": [0, 0]}}, 'latency.request_us = .*: needs quantiles under "call"'),
    ({"quantiles": [0, 0.5]}, "latency.quantiles = .*: must begin with 0 and end with 1"),
    ({"quantiles": [0.1, 1]}, "must begin with 0 and end with 1"),
    ({"quantiles": [0, 0.5, 0.5, 1]}, "latency.quantiles = .*: must rise"),
    ({"issue_us": [1]}, "latency.issue_us = .*: needs 2 values, one for each of the quantiles, not 1"),
    ({"timer_us": [2, 1]}, "latency.timer_us = .*: quantiles must be 0 or more and must not fall"),
    ({"reply_us": {"call": [-1, 1]}}, "latency.reply_us = .*: quantiles must be 0 or more"),
    ({"request_us": {"call": [0, "1"]}}, "latency.request_us.call.1 = '1': should be a valid number"),
    ({"isue_us": [0, 1]}, "unknown key 'latency.isue_us'; did you mean 'latency.issue_us'?"),
])  # fmt: skip
def test_what_is_wrong_is_one_line_in_a_block_and_in_a_file(tmp_path: Path, change: dict[str, Any], text: str) -> None:
    text = re.sub(r"\?$", r"\\?", text)
    with pytest.raises(UserError, match=f"^task: .*{text}"):
        validate(Task, {"latency": {**BLOCK, **change}}, "task")
    path = write(tmp_path, {**BLOCK, **change})
    with pytest.raises(UserError, match=f"^task: latency: {re.escape(str(path))}: .*{text}") as caught:
        validate(Task, {"latency": str(path)}, "task")
    assert "\n" not in str(caught.value)


def test_what_is_no_model_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"^task: latency = 5: should be a mapping$"):
        validate(Task, {"latency": 5}, "task")
    with pytest.raises(UserError, match=r"^task: latency: none\.yaml: No such file or directory$"):
        validate(Task, {"latency": "none.yaml"}, "task")
    (tmp_path / "dp1.yaml").write_text("suite: dp1\n")
    with pytest.raises(UserError, match=r"dp1\.yaml: has no key 'latency'; `uavaccel timing calibrate --out .*`"):
        validate(Task, {"latency": str(tmp_path / "dp1.yaml")}, "task")
