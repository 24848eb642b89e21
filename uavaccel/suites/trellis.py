"""DP1's trellis of the messages between client and server, from recorded traces (the paper's Figure 4).

A trace is a list of events in time order, each with the keys "source" ("client" or "server"), "event" (str),
"wall_s" and "sim_s" (float). Client events are "call <method>" and "return <method>", server events
"handle <method>", "end <what>", "pause" and "run".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

from typing_extensions import TypedDict

from uavaccel.draw import style
from uavaccel.draw.page import Picture
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.forms import Number, check
from uavaccel.suites import plots
from uavaccel.suites.report import Report, clock_words, known, profiles_and_seeds

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Trace = Sequence[Mapping[str, Plain]]


class TraceEvent(TypedDict):
    """An event of a trace as it is recorded."""

    source: Literal["client", "server"]
    event: str
    wall_s: Number
    sim_s: Number


MOST_EVENTS = 44  # a longer trace is cut: the trellis shows one command, not a flight
CLIENT_X, SERVER_X = 0.0, 1.0
CALL: style.LineStyle = {"color": style.BLUE, "linewidth": 1.1}
ANSWER: style.LineStyle = {"color": style.GREEN, "linewidth": 1.1, "linestyle": (0, (4, 2))}
RUNNING: style.LineStyle = {"color": style.ORANGE, "linewidth": 6, "solid_capstyle": "butt"}


def trellis_figure(report: Report) -> Picture:
    """Draw Figure 4 from the traces that the run recorded, if any: TCSC first, as in the paper.

    Time runs downwards by events, not to scale: wall milliseconds are given at the client, simulated seconds at the
    server. The server's line is thick while simulated time runs.
    """
    names = [name for name in ("tcsc", "adsc") if (report.run.path / "traces" / f"{name}.json").is_file()]
    traces: dict[str, Trace] = {name: _read(report, f"traces/{name}.json") for name in names}
    games = report.games
    clocks = [clock_words(timing) for timing in known(games[games.role == "game"], "timing")]
    source = " · ".join(["one recorded command each", *clocks, *profiles_and_seeds(games)])
    longest = max((len(trace) for trace in traces.values()), default=1)
    size_in = 5.0, 0.8 + 0.2 * longest
    figure, grid = plots.panels(1, len(traces), "Messages of one command", source, size_in, sharey=True)
    for axes, (name, trace) in zip(grid[0], traces.items(), strict=False):
        plot_trace(axes, trace)
        axes.set_title(name.upper())
    grid[0, 0].set_ylim(longest - 0.3, -1.9)  # shared: the longer trace decides
    if traces:
        style.key(figure, grid[0, 0], {"call": CALL, "answer": ANSWER, "simulated time runs": RUNNING})
    else:
        style.note(grid[0, 0], "no trace recorded")
    return report.figure("figure4_trellis", figure, CAPTION, source)


def _read(report: Report, name: str) -> Trace:
    trace, path = report.run.read_json(name), str(report.run.path / name)
    check(list[TraceEvent], trace, path)
    if not trace:
        raise UserError(f"{path}: holds no event")
    return trace[:MOST_EVENTS]


class Message(NamedTuple):
    """An arrow of the trellis: the indices of the events at which it starts and ends."""

    sent: int
    received: int


def messages(trace: Trace) -> list[Message]:
    """Return the arrows of a trace, from each call to its handling and from each reply to its return.

    Calls of one method are handled, and return, in order. A deferred reply starts at the last "end" between handling
    and return, any other at its handling.
    """
    arrows: list[Message] = []
    for method in sorted({e["event"].removeprefix("call ") for e in trace if e["event"].startswith("call ")}):
        kinds = ("call", "handle", "return")
        called, handled, returned = (
            [i for i, event in enumerate(trace) if event["event"] == f"{kind} {method}"] for kind in kinds
        )
        arrows += [Message(a, b) for a, b in zip(called, handled, strict=False)]
        arrows += [Message(_answer(trace, a, b), b) for a, b in zip(handled, returned, strict=False)]
    return sorted(arrows)


def _answer(trace: Trace, handled: int, returned: int) -> int:
    between = range(handled, returned)
    ends = [i for i in between if trace[i]["source"] == "server" and "end" in trace[i]["event"].split()]
    return ends[-1] if ends else handled


def running_spans(trace: Trace) -> Iterator[tuple[int, int]]:
    """Yield the index ranges in which simulated time runs, from a "run" to the next "pause".

    The trace's ends count too: without any "run" or "pause" simulated time runs throughout.
    """
    switches = [(i, event["event"]) for i, event in enumerate(trace) if event["event"] in ("run", "pause")]
    start = 0 if not switches or switches[0][1] == "pause" else None
    for i, event in [*switches, (len(trace) - 1, "pause")]:
        if event == "run" and start is None:
            start = i
        elif event == "pause" and start is not None:
            yield start, i
            start = None


def plot_trace(axes: Axes, trace: Trace) -> None:
    """Plot the arrows of a trace, its times, and the spans in which simulated time runs, an event a line."""
    axes.set_axis_off()
    axes.set_xlim(-1.85, 2.0)
    places = {"client": CLIENT_X, "server": SERVER_X}
    for name, x in places.items():
        axes.plot([x, x], [-0.7, len(trace) - 0.5], color=style.GREY, linewidth=1.0)
        axes.text(x, -1.0, name, ha="center", va="bottom", fontweight="bold")
    for span in running_spans(trace):
        axes.plot([SERVER_X] * 2, span, **RUNNING, zorder=1)
    for arrow in messages(trace):
        start, end = ((places[trace[i]["source"]], i) for i in arrow)
        line = CALL if trace[arrow.sent]["source"] == "client" else ANSWER
        axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 3, **line})
    for row, event in enumerate(trace):  # where an arrow ends, the time alone is enough
        kind, _, method = event["event"].partition(" ")
        if event["source"] == "client":
            name = f"{method}   " if kind == "call" else ""
            text = f"{name}{(event['wall_s'] - trace[0]['wall_s']) * 1e3:.2f} ms"
            axes.text(CLIENT_X - 0.06, row, text, ha="right", va="center", fontsize=7.5)
        else:
            name = "" if kind == "handle" else f"   {event['event']}"
            text = f"{event['sim_s'] - trace[0]['sim_s']:.3f} s{name}"
            axes.text(SERVER_X + 0.08, row, text, ha="left", va="center", fontsize=7.5)


CAPTION = (
    "Figure 4. Messages of one command between client and server, from a recorded trace; not to scale. Thick: "
    "simulated time runs. Left of the client's line wall time, right of the server's simulated time, both since "
    "the first event."
)
