"""The message trellis: which arrows a trace has, and where they, the times and the running spans are drawn."""

from __future__ import annotations

from typing import Any

import pytest

from tests.drawing import headline, legend_texts, points, texts
from uavaccel.bench.traces import ClientEvent, _merge
from uavaccel.suites.old_dp1.trellis import MOST_EVENTS, Message, messages, plot_trellis, running_spans

Trace = list[dict[str, Any]]


def recorded_trace() -> Trace:
    steps = [
        ("client", "call move", 5.0, 7.0),
        ("server", "handle move", 5.0 + 1e-4, 7.0),
        ("client", "call continue", 5.0 + 2e-4, 7.0),
        ("server", "handle continue", 5.0 + 3e-4, 7.0),
        ("server", "run", 5.0 + 3e-4, 7.0),
        ("server", "end continue", 5.0 + 1.03e-2, 8.0),
        ("server", "pause", 5.0 + 1.03e-2, 8.0),
        ("client", "return continue", 5.0 + 1.05e-2, 8.0),
        ("client", "return move", 5.0 + 1.06e-2, 8.0),
    ]
    return [{"source": s, "event": e, "wall_s": w, "sim_s": t} for s, e, w, t in steps]


def test_a_trace_is_both_ends_in_order_of_the_wall_clock() -> None:
    """A client knows no simulated time: its events have the server's last one."""
    client = [
        ClientEvent("call", "move", "move", 100),
        ClientEvent("issued", "move", "move", 110),
        ClientEvent("return", "move", "move", 400),
    ]
    found = _merge(client, [("run", 200, 7_000), ("end move", 300, 9_000)])
    assert [tuple(each.values()) for each in found] == [
        ("client", "call move", 1e-7, 7e-6),
        ("server", "run", 2e-7, 7e-6),
        ("server", "end move", 3e-7, 9e-6),
        ("client", "return move", 4e-7, 9e-6),
    ]


def test_answers_leave_where_their_work_ended() -> None:
    assert messages(recorded_trace()) == [Message(0, 1), Message(2, 3), Message(5, 7), Message(5, 8)]


def test_an_answer_without_work_leaves_where_its_call_was_handled() -> None:
    events = [("client", "call ask"), ("server", "handle ask"), ("client", "return ask")] * 2
    trace = [{"source": s, "event": e, "wall_s": 0.0, "sim_s": 0.0} for s, e in events]
    assert messages(trace) == [Message(0, 1), Message(1, 2), Message(3, 4), Message(4, 5)]


def test_an_answer_leaves_from_the_last_work_before_it_returns() -> None:
    """A command in two slices, each waited for; then a question that nothing is done for."""
    slice_of_a_command = [
        *(("client", "call continue"), ("server", "handle continue"), ("server", "run")),
        *(("server", "end continue"), ("server", "pause"), ("client", "return continue")),
    ]
    events = [
        *(("client", "call move"), ("server", "handle move")),
        *slice_of_a_command,  # from 2 on
        *slice_of_a_command,  # from 8 on
        ("client", "return move"),
        *(("client", "call ask"), ("server", "handle ask"), ("client", "return ask")),
    ]
    trace = [{"source": s, "event": e, "wall_s": 0.0, "sim_s": 0.0} for s, e in events]
    assert messages(trace) == [
        *(Message(0, 1), Message(2, 3), Message(5, 7), Message(8, 9), Message(11, 13), Message(11, 14)),
        *(Message(15, 16), Message(16, 17)),
    ]
    assert running_spans(trace) == [(4, 6), (10, 12)]


def test_simulated_time_runs_between_run_and_pause() -> None:
    trace = recorded_trace()
    assert running_spans(trace) == [(4, 6)]
    assert running_spans(trace[:4]) == [(0, 3)]
    assert running_spans(trace[5:]) == [(0, 1)]
    assert running_spans(trace[:6]) == [(4, 5)]


def test_arrows_times_and_spans_are_drawn_by_event() -> None:
    drawn: Any = plot_trellis({"TCSC": recorded_trace(), "ADSC": recorded_trace()[:4]}, "where from")
    assert headline(drawn) == ("Messages of one command", "where from")
    tcsc, adsc = drawn.axes
    assert (tcsc.get_title("left"), adsc.get_title("left")) == ("TCSC", "ADSC")
    assert adsc.get_ylim()[0] >= len(recorded_trace()) - 1, "the longer trace is cut"
    arrows: list[Any] = [text for text in tcsc.texts if not text.get_text()]
    assert [(arrow.xyann, arrow.xy) for arrow in arrows] == [
        ((0.0, 0), (1.0, 1)),
        ((0.0, 2), (1.0, 3)),
        ((1.0, 5), (0.0, 7)),
        ((1.0, 5), (0.0, 8)),
    ]
    calls, answers = (
        {arrow.arrow_patch.get_edgecolor() for arrow in some} for some in (arrows[:2], arrows[2:])
    )
    assert len(calls) == len(answers) == 1
    assert calls != answers
    running = max(tcsc.lines, key=lambda line: line.get_linewidth())
    assert points(running) == [(1.0, 4), (1.0, 6)]
    assert {line.get_xdata()[0] for line in tcsc.lines} == {0.0, 1.0}
    assert [text for text in texts(tcsc) if text] == [
        "client",
        "server",
        "move   0.00 ms",
        "0.000 s",
        "continue   0.20 ms",
        "0.000 s",
        "0.000 s   run",
        "1.000 s   end continue",
        "1.000 s   pause",
        "10.50 ms",
        "10.60 ms",
    ]
    assert [text.get_position()[1] for text in tcsc.texts[-9:]] == list(range(9))
    assert tcsc.get_ylim()[0] > tcsc.get_ylim()[1]  # time runs downwards
    (legend,) = drawn.legends
    assert legend_texts(legend) == ["call", "answer", "simulated time runs"]


@pytest.mark.parametrize("events", [MOST_EVENTS, MOST_EVENTS + 20])
def test_a_long_trace_is_cut(events: int) -> None:
    trace = [{"source": "server", "event": "run", "wall_s": 0.0, "sim_s": float(i)} for i in range(events)]
    (axes,) = plot_trellis({"long": trace}, "").axes
    assert texts(axes)[-1] == f"{MOST_EVENTS - 1}.000 s   run"


def test_no_trace_is_said_to_be_none() -> None:
    drawn: Any = plot_trellis({}, "")
    assert (texts(drawn.axes[0]), drawn.legends) == (["no trace recorded"], [])
