"""The message trellis: which arrows a trace has, and where they, the times and the running spans are drawn."""

from __future__ import annotations

from typing import Any

import pytest
from matplotlib.figure import Figure

from tests.drawing import points, texts
from uavaccel.calibration.traces import ClientEvent, _merge
from uavaccel.suites.trellis import messages, plot_trace, running_spans

CALLED = ["client call move", "server handle move"]
SLICE = [
    *("client call continue", "server handle continue", "server run"),
    *("server end continue", "server pause", "client return continue"),
]
RETURNED = "client return move"
ASKED = ["client call ask", "server handle ask", "client return ask"]


def trace_of(events: list[str]) -> list[dict[str, Any]]:
    """Events 0.1 ms apart; simulated time goes from 7 s to 8 s where a slice ends."""
    trace, sim_s = [], 7.0
    for i, event in enumerate(events):
        source, _, name = event.partition(" ")
        sim_s += name == "end continue"
        trace.append({"source": source, "event": name, "wall_s": 5.0 + i * 1e-4, "sim_s": sim_s})
    return trace


def recorded_trace() -> list[dict[str, Any]]:
    return trace_of([*CALLED, *SLICE, RETURNED])


def test_a_trace_is_both_ends_in_order_of_the_wall_clock() -> None:
    """A client knows no simulated time: its events have the server's last one."""
    client = [ClientEvent(event, "move", "move", ns) for event, ns in (("call", 100), ("issued", 110), ("return", 400))]
    found = _merge(client, [("run", 200, 7_000), ("end move", 300, 9_000)])
    assert [tuple(each.values()) for each in found] == [
        ("client", "call move", 1e-7, 7e-6),
        ("server", "run", 2e-7, 7e-6),
        ("server", "end move", 3e-7, 9e-6),
        ("client", "return move", 4e-7, 9e-6),
    ]


@pytest.mark.parametrize(
    ("events", "arrows", "spans"),
    [
        ([*CALLED, *SLICE, RETURNED], [(0, 1), (2, 3), (5, 7), (5, 8)], [(4, 6)]),
        (ASKED * 2, [(0, 1), (1, 2), (3, 4), (4, 5)], [(0, 5)]),
        (
            [*CALLED, *SLICE, *SLICE, RETURNED, *ASKED],
            [(0, 1), (2, 3), (5, 7), (8, 9), (11, 13), (11, 14), (15, 16), (16, 17)],
            [(4, 6), (10, 12)],
        ),
        (SLICE[3:], [], [(0, 1)]),
        ([*CALLED, *SLICE[:4]], [(0, 1), (2, 3)], [(4, 5)]),
    ],
)
def test_answers_leave_where_their_work_ended_and_time_runs_up_to_a_pause(
    events: list[str], arrows: list[Any], spans: list[Any]
) -> None:
    assert messages(trace_of(events)) == arrows
    assert list(running_spans(trace_of(events))) == spans


def test_arrows_times_and_spans_are_drawn_by_event() -> None:
    axes: Any = Figure().add_subplot()
    plot_trace(axes, recorded_trace())
    arrows = [text for text in axes.texts if not text.get_text()]
    assert [(arrow.xyann, arrow.xy) for arrow in arrows] == [
        ((0.0, 0), (1.0, 1)),
        ((0.0, 2), (1.0, 3)),
        ((1.0, 5), (0.0, 7)),
        ((1.0, 5), (0.0, 8)),
    ]
    calls, answers = ({arrow.arrow_patch.get_edgecolor() for arrow in some} for some in (arrows[:2], arrows[2:]))
    assert len(calls | answers) == 2
    assert points(max(axes.lines, key=lambda line: line.get_linewidth())) == [(1.0, 4), (1.0, 6)]
    assert [text for text in texts(axes) if text] == [
        *("client", "server", "move   0.00 ms", "0.000 s", "continue   0.20 ms", "0.000 s", "0.000 s   run"),
        *("1.000 s   end continue", "1.000 s   pause", "0.70 ms", "0.80 ms"),
    ]
    assert [text.get_position()[1] for text in axes.texts[-9:]] == list(range(9))
