"""The message trellis of commands, drawn from recorded traces (the paper's Figure 4).

A trace is a list of events in time order, each with the keys "source" ("client" or "server"), "event" (str),
"wall_s" and "sim_s" (float). Client events are "call <method>" and "return <method>", server events
"handle <method>", "end <what>", "pause" and "run".
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.suites.dp1.cases import Dp1Row
from uavaccel.suites.source_line import clock_words, conditions

Event = Mapping[str, Plain]
Trace = Sequence[Event]

MOST_EVENTS = 44  # a longer trace is cut: the trellis shows one command, not a flight
_CLIENT_X, _SERVER_X = 0.0, 1.0
_CALL: style.LineStyle = {"color": style.BLUE, "linewidth": 1.1}
_ANSWER: style.LineStyle = {"color": style.GREEN, "linewidth": 1.1, "linestyle": (0, (4, 2))}
_RUNNING: style.LineStyle = {"color": style.ORANGE, "linewidth": 6, "solid_capstyle": "butt"}
_LEGEND = {"call": _CALL, "answer": _ANSWER, "simulated time runs": _RUNNING}


@dataclass(frozen=True)
class Message:
    """One arrow: indices of the event it leaves and the event it arrives at."""

    sent: int
    received: int


def trellis_figure(run_dir: Path, rows: Sequence[Dp1Row], path: Path) -> Picture:
    """Figure 4 from the traces that the run recorded, if it did."""
    traces = _traces(run_dir)
    timings = sorted({row["timing"] for row in rows if row["role"] == "game"})
    clocks = [clock_words(timing) for timing in timings]
    source = " · ".join(["one recorded command each", *clocks, *conditions(rows)])
    style.save(plot_trellis(traces, source), path)
    return Picture(
        path,
        "Figure 4. Messages of one command between client and server, from a recorded trace; not to scale. "
        "Thick: simulated time runs. Left of the client's line wall time, right of the server's simulated "
        f"time, both since the first event. Source: {source}.",
    )


def _traces(run_dir: Path) -> dict[str, Trace]:
    """The recorded traces, by what stands above them: TCSC first, as in the paper."""
    found: dict[str, Trace] = {}
    for command in ("tcsc", "adsc"):
        path = run_dir / "traces" / f"{command}.json"
        if not path.is_file():
            continue
        try:
            found[style.command_name(command)] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise UserError(f"{path}: not JSON: {error}") from error
    return found


def plot_trellis(traces: Mapping[str, Trace], source: str) -> Figure:
    """One trellis per trace, side by side, named by the mapping's keys.

    Time runs downwards by events, not to scale: wall milliseconds stand at the client, simulated seconds at
    the server. The server's line is thick while simulated time runs.
    """
    longest = max((min(len(trace), MOST_EVENTS) for trace in traces.values()), default=1)
    with style.project_style():
        size_in = (5.0 * max(len(traces), 1), 2.0 + 0.2 * longest)
        figure = style.new_figure(*size_in, "Messages of one command", source)
        panels = figure.subplots(1, max(len(traces), 1), sharey=True, squeeze=False)[0]
        if not traces:
            style.note(panels[0], "no trace recorded")
        for axes, (name, trace) in zip(panels, traces.items(), strict=False):
            _draw_trace(axes, trace[:MOST_EVENTS])
            axes.set_title(name)
        if traces:
            _legend(figure)
        return figure


def messages(trace: Trace) -> list[Message]:
    """The arrows of a trace: each call to its handling, and each answer back to its return.

    Calls of one method are handled, and return, in order. A deferred answer leaves at the last "end" between
    handling and return, any other at its handling.
    """
    arrows: list[Message] = []
    for method in _methods(trace):
        handled = _indices(trace, "server", f"handle {method}")
        called = _indices(trace, "client", f"call {method}")
        returned = _indices(trace, "client", f"return {method}")
        arrows += [Message(a, b) for a, b in zip(called, handled, strict=False)]
        arrows += [Message(_answer(trace, a, b), b) for a, b in zip(handled, returned, strict=False)]
    return sorted(arrows, key=lambda arrow: (arrow.sent, arrow.received))


def running_spans(trace: Trace) -> list[tuple[int, int]]:
    """Index ranges in which simulated time runs: from a "run" to the next "pause".

    The trace's ends count too: without any "run" or "pause" the server runs free all the time.
    """
    switches = [(i, e["event"]) for i, e in enumerate(trace) if e["event"] in ("run", "pause")]
    start = 0 if not switches or switches[0][1] == "pause" else None
    spans: list[tuple[int, int]] = []
    for i, event in switches:
        if event == "run" and start is None:
            start = i
        elif event == "pause" and start is not None:
            spans.append((start, i))
            start = None
    return spans if start is None else [*spans, (start, len(trace) - 1)]


def _methods(trace: Trace) -> list[str]:
    return sorted({str(e["event"]).removeprefix("call ") for e in trace if e["event"].startswith("call ")})


def _indices(trace: Trace, source: str, event: str) -> list[int]:
    return [i for i, e in enumerate(trace) if e["source"] == source and e["event"] == event]


def _answer(trace: Trace, handled: int, returned: int) -> int:
    ends = [
        i
        for i in range(handled, returned)
        if trace[i]["source"] == "server" and "end" in trace[i]["event"].split()
    ]
    return ends[-1] if ends else handled


def _draw_trace(axes: Axes, trace: Trace) -> None:
    axes.set_axis_off()
    axes.set_xlim(-1.85, 2.0)
    axes.set_ylim(len(trace) - 0.3, -1.9)
    for x, name in ((_CLIENT_X, "client"), (_SERVER_X, "server")):
        axes.plot([x, x], [-0.7, len(trace) - 0.5], color=style.GREY, linewidth=1.0)
        axes.text(x, -1.0, name, ha="center", va="bottom", fontweight="bold")
    for start, end in running_spans(trace):
        axes.plot([_SERVER_X] * 2, [start, end], **_RUNNING, zorder=1)
    for arrow in messages(trace):
        _draw_arrow(axes, trace, arrow)
    for row, event in enumerate(trace):
        _draw_event(axes, row, event, float(trace[0]["wall_s"]), float(trace[0]["sim_s"]))


def _draw_arrow(axes: Axes, trace: Trace, arrow: Message) -> None:
    x = {"client": _CLIENT_X, "server": _SERVER_X}
    ends = [(x[trace[i]["source"]], i) for i in (arrow.received, arrow.sent)]
    line = _CALL if trace[arrow.sent]["source"] == "client" else _ANSWER
    axes.annotate(
        "", xy=ends[0], xytext=ends[1], arrowprops={"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 3, **line}
    )


def _draw_event(axes: Axes, row: int, event: Event, wall0_s: float, sim0_s: float) -> None:
    """A call has its method's name at the client; where an arrow arrives, the time alone says enough."""
    kind, _, method = str(event["event"]).partition(" ")
    if event["source"] == "client":
        name = f"{method}   " if kind == "call" else ""
        time = f"{(event['wall_s'] - wall0_s) * 1e3:.2f} ms"
        axes.text(_CLIENT_X - 0.06, row, name + time, ha="right", va="center", fontsize=7.5)
    else:
        name = "" if kind == "handle" else f"   {event['event']}"
        time = f"{event['sim_s'] - sim0_s:.3f} s"
        axes.text(_SERVER_X + 0.08, row, time + name, ha="left", va="center", fontsize=7.5)


def _legend(figure: Figure) -> None:
    lines = [Line2D([], [], label=label, **line_style) for label, line_style in _LEGEND.items()]
    figure.legend(handles=lines, loc="outside upper right", ncols=len(lines))
