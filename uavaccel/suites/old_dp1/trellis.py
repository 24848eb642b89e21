"""DP1's trellis of the messages between client and server, from recorded traces (the paper's Figure 4).

A trace is a list of events in time order, each with the keys "source" ("client" or "server"), "event" (str),
"wall_s" and "sim_s" (float). Client events are "call <method>" and "return <method>", server events
"handle <method>", "end <what>", "pause" and "run".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from typing_extensions import TypedDict

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.errors import UserError
from uavaccel.files import Plain, parse_json, read_bounded
from uavaccel.forms import Number, check
from uavaccel.suites.old_dp1.flights import Dp1Row
from uavaccel.suites.provenance import clock_words, profiles_and_seeds


class TraceEvent(TypedDict):
    """An event of a trace as it is recorded."""

    source: Literal["client", "server"]
    event: str
    wall_s: Number
    sim_s: Number


Event = Mapping[str, Plain]
Trace = Sequence[Event]

MOST_EVENTS = 44  # a longer trace is cut: the trellis shows one command, not a flight
_CLIENT_X, _SERVER_X = 0.0, 1.0
_CALL: style.LineStyle = {"color": style.BLUE, "linewidth": 1.1}
_ANSWER: style.LineStyle = {"color": style.GREEN, "linewidth": 1.1, "linestyle": (0, (4, 2))}
_RUNNING: style.LineStyle = {"color": style.ORANGE, "linewidth": 6, "solid_capstyle": "butt"}
_LEGEND = {"call": _CALL, "answer": _ANSWER, "simulated time runs": _RUNNING}


class Message(NamedTuple):
    """An arrow of the trellis: the indices of the events at which it starts and ends."""

    sent: int
    received: int


def trellis_figure(run_dir: Path, rows: Sequence[Dp1Row], path: Path) -> Picture:
    """Draw Figure 4 from the traces that the run recorded, if any."""
    traces = _read_traces(run_dir)
    timings = sorted({row["timing"] for row in rows if row["role"] == "game"})
    clocks = [clock_words(timing) for timing in timings]
    source = " · ".join(["one recorded command each", *clocks, *profiles_and_seeds(rows)])
    caption = (
        "Figure 4. Messages of one command between client and server, from a recorded trace; not to scale. Thick: "
        "simulated time runs. Left of the client's line wall time, right of the server's simulated time, both since "
        "the first event."
    )
    return style.picture(plot_trellis(traces, source), path, caption, source)


def _read_traces(run_dir: Path) -> dict[str, Trace]:
    """Read the recorded traces, by the title of their panel: TCSC first, as in the paper."""
    found: dict[str, Trace] = {}
    for command in ("tcsc", "adsc"):
        path = run_dir / "traces" / f"{command}.json"
        if not path.is_file():
            continue
        try:
            trace = parse_json(read_bounded(path).decode("utf-8"))
        except ValueError as error:
            raise UserError(f"{path}: not JSON: {error}") from error
        check(list[TraceEvent], trace, str(path))
        if not trace:
            raise UserError(f"{path}: holds no event")
        found[style.command_name(command)] = trace
    return found


def plot_trellis(traces: Mapping[str, Trace], source: str) -> Figure:
    """Plot a trellis per trace, side by side, with the mapping's keys as titles.

    Time runs downwards by events, not to scale: wall milliseconds are given at the client, simulated seconds at the
    server. The server's line is thick while simulated time runs.
    """
    longest = max((min(len(trace), MOST_EVENTS) for trace in traces.values()), default=1)
    with style.project_style():
        size_in = (5.0 * max(len(traces), 1), 2.0 + 0.2 * longest)
        figure = style.new_figure(*size_in, "Messages of one command", source)
        panels = figure.subplots(1, max(len(traces), 1), sharey=True, squeeze=False)[0]
        if not traces:
            style.note(panels[0], "no trace recorded")
        for axes, (name, trace) in zip(panels, traces.items(), strict=False):
            _plot_trace(axes, trace[:MOST_EVENTS])
            axes.set_title(name)
        panels[0].set_ylim(longest - 0.3, -1.9)  # shared: the longer trace decides
        if traces:
            lines = [Line2D([], [], label=label, **line_style) for label, line_style in _LEGEND.items()]
            figure.legend(handles=lines, loc="outside upper right", ncols=len(lines))
        return figure


def messages(trace: Trace) -> list[Message]:
    """Return the arrows of a trace, from each call to its handling and from each reply to its return.

    Calls of one method are handled, and return, in order. A deferred reply starts at the last "end" between handling
    and return, any other at its handling.
    """
    arrows: list[Message] = []
    methods = {str(e["event"]).removeprefix("call ") for e in trace if e["event"].startswith("call ")}
    for method in sorted(methods):
        handled = _indices(trace, "server", f"handle {method}")
        called = _indices(trace, "client", f"call {method}")
        returned = _indices(trace, "client", f"return {method}")
        arrows += [Message(a, b) for a, b in zip(called, handled, strict=False)]
        arrows += [Message(_answer(trace, a, b), b) for a, b in zip(handled, returned, strict=False)]
    return sorted(arrows)


def running_spans(trace: Trace) -> list[tuple[int, int]]:
    """Return the index ranges in which simulated time runs, from a "run" to the next "pause".

    The trace's ends count too: without any "run" or "pause" simulated time runs throughout.
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


def _indices(trace: Trace, source: str, event: str) -> list[int]:
    return [i for i, e in enumerate(trace) if e["source"] == source and e["event"] == event]


def _answer(trace: Trace, handled: int, returned: int) -> int:
    events = list(enumerate(trace))[handled:returned]
    ends = [i for i, e in events if e["source"] == "server" and "end" in e["event"].split()]
    return ends[-1] if ends else handled


def _plot_trace(axes: Axes, trace: Trace) -> None:
    axes.set_axis_off()
    axes.set_xlim(-1.85, 2.0)
    for x, name in ((_CLIENT_X, "client"), (_SERVER_X, "server")):
        axes.plot([x, x], [-0.7, len(trace) - 0.5], color=style.GREY, linewidth=1.0)
        axes.text(x, -1.0, name, ha="center", va="bottom", fontweight="bold")
    for span in running_spans(trace):
        axes.plot([_SERVER_X] * 2, span, **_RUNNING, zorder=1)
    places = {"client": _CLIENT_X, "server": _SERVER_X}
    for arrow in messages(trace):
        start, end = ((places[trace[i]["source"]], i) for i in arrow)
        line = _CALL if trace[arrow.sent]["source"] == "client" else _ANSWER
        arrowprops = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 3, **line}
        axes.annotate("", xy=end, xytext=start, arrowprops=arrowprops)
    for row, event in enumerate(trace):
        _plot_event(axes, row, event, float(trace[0]["wall_s"]), float(trace[0]["sim_s"]))


def _plot_event(axes: Axes, row: int, event: Event, wall0_s: float, sim0_s: float) -> None:
    """A call is labelled with its method at the client; where an arrow ends, the time alone is enough."""
    kind, _, method = str(event["event"]).partition(" ")
    if event["source"] == "client":
        name = f"{method}   " if kind == "call" else ""
        time = f"{(event['wall_s'] - wall0_s) * 1e3:.2f} ms"
        axes.text(_CLIENT_X - 0.06, row, name + time, ha="right", va="center", fontsize=7.5)
    else:
        name = "" if kind == "handle" else f"   {event['event']}"
        time = f"{event['sim_s'] - sim0_s:.3f} s"
        axes.text(_SERVER_X + 0.08, row, time + name, ha="left", va="center", fontsize=7.5)
