"""DP1's trellis of the messages between client and server, from recorded traces (the paper's Figure 4)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

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
    """An event of a trace, which is in time order."""

    source: Literal["client", "server"]
    event: str
    """A client's "call METHOD" or "return METHOD", a server's "handle METHOD", "accept", "end", "run" or "pause"."""
    wall_s: Number
    sim_s: Number


MOST_EVENTS = 44  # a longer trace is cut: the trellis shows one command, not a flight
CALL: style.LineStyle = {"color": style.BLUE, "linewidth": 1.1}
ANSWER: style.LineStyle = {"color": style.GREEN, "linewidth": 1.1, "linestyle": (0, (4, 2))}
RUNNING: style.LineStyle = {"color": style.ORANGE, "linewidth": 6, "solid_capstyle": "butt"}


def trellis_figure(report: Report) -> Picture:
    """Draw Figure 4 from the traces that the run recorded, if any: TCSC first, as in the paper.

    Time runs downwards by events, not to scale. Raises UserError for a damaged trace.
    """
    traces: dict[str, Trace] = {}
    for name in ("tcsc", "adsc"):
        path = report.run.path / f"traces/{name}.json"
        if path.is_file():
            traces[name] = report.run.read_json(f"traces/{name}.json")
            check(list[TraceEvent], traces[name], str(path))
            if not traces[name]:
                raise UserError(f"{path}: holds no event")
            traces[name] = traces[name][:MOST_EVENTS]
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
    caption = (
        "Figure 4. Messages of one command between client and server, from a recorded trace; not to scale. Thick: "
        "simulated time runs. Left of the client's line wall time, right of the server's simulated time, both since "
        "the first event."
    )
    return report.figure("figure4_trellis", figure, caption, source)


def messages(trace: Trace) -> list[tuple[int, int]]:
    """Return the arrows of a trace by the places of their events: from each call to its handling, and of its reply.

    Calls of one method are handled, and return, in order. A deferred reply leaves at the last "end" between handling
    and return, any other at its handling.
    """
    events, arrows = [event["event"] for event in trace], list[tuple[int, int]]()
    for method in {event.removeprefix("call ") for event in events if event.startswith("call ")}:
        called, handled, returned = (
            [place for place, event in enumerate(events) if event == f"{kind} {method}"]
            for kind in ("call", "handle", "return")
        )
        arrows += zip(called, handled, strict=False)
        for first, last in zip(handled, returned, strict=False):
            ended = (place for place in range(first, last) if events[place].split()[0] == "end")
            arrows.append((max(ended, default=first), last))
    return sorted(arrows)


def running_spans(trace: Trace) -> Iterator[tuple[int, int]]:
    """Yield the places between which simulated time runs: from a "run" or the first event to a "pause" or the last.

    Without any "run" or "pause" simulated time runs throughout.
    """
    switches = [(place, event["event"]) for place, event in enumerate(trace) if event["event"] in ("run", "pause")]
    start = 0 if not switches or switches[0][1] == "pause" else None
    for place, event in [*switches, (len(trace) - 1, "pause")]:
        if event == "run" and start is None:
            start = place
        elif event == "pause" and start is not None:
            yield start, place
            start = None


def plot_trace(axes: Axes, trace: Trace) -> None:
    """Plot the arrows of a trace, its times, and the spans in which simulated time runs, an event a line."""
    axes.set_axis_off()
    axes.set_xlim(-1.85, 2.0)
    places = {"client": 0.0, "server": 1.0}
    for name, x in places.items():
        axes.plot([x, x], [-0.7, len(trace) - 0.5], color=style.GREY, linewidth=1.0)
        axes.text(x, -1.0, name, ha="center", va="bottom", fontweight="bold")
    for span in running_spans(trace):
        axes.plot([places["server"]] * 2, span, **RUNNING, zorder=1)
    for arrow in messages(trace):
        start, end = ((places[trace[place]["source"]], place) for place in arrow)
        line = CALL if start[0] == places["client"] else ANSWER
        axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 3, **line})
    for row, event in enumerate(trace):  # where an arrow ends, the time alone is enough
        kind, _, method = event["event"].partition(" ")
        if event["source"] == "client":
            name = f"{method}   " if kind == "call" else ""
            text = f"{name}{(event['wall_s'] - trace[0]['wall_s']) * 1e3:.2f} ms"
            axes.text(-0.06, row, text, ha="right", va="center", fontsize=7.5)
        else:
            name = "" if kind == "handle" else f"   {event['event']}"
            text = f"{event['sim_s'] - trace[0]['sim_s']:.3f} s{name}"
            axes.text(1.08, row, text, ha="left", va="center", fontsize=7.5)
