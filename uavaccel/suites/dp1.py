"""DP1: a square path flown with ADSC and TCSC, compared with real time (paper, sections III-C2a and IV-B)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, Field, model_validator
from typing_extensions import TypedDict

from uavaccel.commands import check_times, velocities
from uavaccel.config import MOST_HEIGHT_M, MOST_ROUNDS, Games, Seconds, Speed, Velocity
from uavaccel.draw import style
from uavaccel.draw.page import (
    Block,
    Heading,
    Picture,
    Table,
    clock_label,
    command_at_clock,
    command_name,
    counted,
    metres,
    unknown,
)
from uavaccel.errors import UserError
from uavaccel.forms import Count, Number, Positive, check
from uavaccel.metrics.intervals import median_interval, speedup_interval
from uavaccel.metrics.trajectory import Trajectory, command_gaps_s, distinct, mean_position_rmse
from uavaccel.processes.workers import on_this_machine
from uavaccel.records import RunDirectory, timing_provenance
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.recording import RECORDED
from uavaccel.suites import experiment, plots
from uavaccel.suites.experiment import FlightExperiment, Timing, named_seed, subset
from uavaccel.suites.flight import Flight
from uavaccel.suites.path_suite import FlightCase, FlightRow, PathSuite, flight_row, fly_path, reference_of
from uavaccel.suites.report import Report, Summary, disturbed_games, finished, method_note, warnings
from uavaccel.suites.suite import GameResult
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:  # they load what draws, and the simulation
    from matplotlib.axes import Axes

    from uavaccel.wire.session import Session

PATH = ["t_move_s", "rounds"]
CELL = ["command", "clock_speed", *PATH, "timing"]
"""What the games of a cell have in common. They are compared with all ADSC games at 1x of the same PATH."""
SIMILAR_STLC = 1.8  # above it trajectories look alike (paper, section III-C2a)
PARALLEL_FROM_GAMES, MOST_JOBS = 400, 8  # below, starting worker processes takes longer than scoring

OwnPath = Annotated[tuple[tuple[Velocity, Velocity, Velocity], ...], Field(min_length=1)]
FlownPath = Literal["square", "two_forward_one_back"] | OwnPath
Distinct = AfterValidator(experiment.distinct)


class Dp1Config(FlightExperiment):
    """`suite: dp1`."""

    suite: Literal["dp1"]
    path: FlownPath = "square"
    """A named path, or a list of velocities, one command each, NED in m/s."""
    speed_m_s: Speed = 1.0
    """Speed on a named path."""
    height_m: Annotated[float, Field(lt=0.0, ge=-MOST_HEIGHT_M)] | None = None
    """NED z to hold, as moveByVelocityZ does; without it plain moveByVelocity is called, as in the paper."""
    rounds: Annotated[tuple[Annotated[int, Field(ge=1, le=MOST_ROUNDS)], ...], Distinct] = (1, 2, 4, 8, 16, 24)
    """How often the square path is flown in a game; each value is flown."""
    t_move_s: Annotated[tuple[Seconds, ...], Distinct] = (0.1, 0.2, 0.5, 1.0)
    """Simulated seconds of a command; each value is flown."""
    t_sample_s: Seconds | None = None
    """How often the client itself gathers the state; without it once per command, beside the server's recorder."""
    games: Games = 20
    """Games of each cell, that is of each command, ClockSpeed, T_move and number of rounds."""
    reference_games: Games = 20
    """Real-time ADSC games of each T_move and number of rounds, unless the run flies that cell anyway."""
    reference_timing: Timing = "virtual"
    """The timing of the reference flights, with ADSC at ClockSpeed 1."""

    @model_validator(mode="after")
    def _times_fit(self) -> Dp1Config:
        for t_move_s in self.t_move_s:
            check_times(t_move_s, self.t_sample_s or t_move_s, PROFILES[self.profile].check_duration)
        return self


class Dp1Row(FlightRow):
    """The row of a game of DP1."""

    t_move_s: Positive
    rounds: Count
    game: Count
    commands: Count
    samples_dropped: Count


@dataclass(frozen=True)
class Game(FlightCase):
    """One game; beside "reference" (ADSC at 1x), "lockstep" and "game" its role may be "figure2"."""

    t_move_s: float
    rounds: int
    game: int
    path: FlownPath

    @property
    def id(self) -> str:
        return f"{super().id}-t{self.t_move_s:g}-r{self.rounds}-g{self.game:02d}"

    def simulated_s(self) -> float:
        """Return the simulated time of the commands, without gaps between them."""
        return self.t_move_s * len(velocities(self.path, self.rounds))

    def seed(self, run_seed: int) -> np.random.SeedSequence:
        """Return the game's own seed, which references and games of one cell have in common."""
        name = f"{self.command} {self.clock_speed:g} {self.t_move_s:g} {self.rounds} {self.game} {self.path}"
        return named_seed(run_seed, name)


class Dp1(PathSuite[Dp1Config, Game]):
    """`uavaccel run dp1`."""

    name, scene = "dp1", "blocks"
    config, case, row, arrays = Dp1Config, Game, Dp1Row, RECORDED
    grows = ("games",)
    quick: ClassVar[Mapping[str, object]] = {"games": 3, "reference_games": 3}

    def cases(self, config: Dp1Config) -> Iterator[Game]:
        """Yield references, the flights without latency, the grid, and those of Figure 2."""
        baseline = ("adsc", 1.0, config.reference_timing)
        grid = list(product(config.command, config.clock_speed, [config.timing]))
        paths = list(product(config.t_move_s, config.rounds))
        if baseline not in grid:
            for path, game in product(paths, range(config.reference_games)):
                yield Game("reference", "adsc", 1.0, config.reference_timing, *path, game, config.path)
        for path in paths:
            yield Game("lockstep", "tcsc", 1.0, "lockstep", *path, 0, config.path)
        for cell, path, game in product(grid, paths, range(config.games)):
            yield Game("reference" if cell == baseline else "game", *cell, *path, game, config.path)
        for game, clock in enumerate([(1.0, config.reference_timing), (max(config.clock_speed), config.timing)]):
            yield Game("figure2", "adsc", *clock, max(config.t_move_s), 1, game, "two_forward_one_back")

    def fly(self, config: Dp1Config, case: Game, opened: Session) -> GameResult:
        """Fly the case's path; its wall time is from the first command's issue to the last one's return."""
        client = opened.start_game(case.clock_speed, case.seed(config.seed))
        path = velocities(case.path, case.rounds, config.speed_m_s)
        start_ns, flown = fly_path(case, config, client, path, case.t_move_s, config.t_sample_s or case.t_move_s)
        for _ in flown:
            pass
        row, recording = flight_row(case, config, client, (client.now_ns() - start_ns) / NS_PER_S)
        row |= subset(vars(case), "t_move_s", "rounds", "game")
        row |= {"commands": len(recording.commands), "samples_dropped": recording.dropped}
        return GameResult(row, recording.arrays())

    def finish(self, config: Dp1Config, run: RunDirectory) -> None:
        """Record the messages of one command of each kind, for Figure 4."""
        from uavaccel.calibration.calibrate import record_trace

        with self.open(config, config.timing, run) as session:
            for command in config.command:
                trace = record_trace(session, command, max(config.clock_speed), max(config.t_move_s))
                run.write_json(f"traces/{command}.json", trace)

    def flight(
        self, report: Report, game: Mapping[str, Any], pictures: bool = True, event_rate_hz: float | None = None
    ) -> Flight:
        config, arrays = report.config, report.arrays(game)
        path = "two_forward_one_back" if game["role"] == "figure2" else config.path
        flown = velocities(path, game["rounds"], config.speed_m_s)[: game["commands"]]
        return Flight.of(command_at_clock(game), game["clock_speed"], arrays, flown)

    def score(self, report: Report) -> pd.DataFrame:
        """Add each game's SCORES. Raises UserError for a run that has flown nothing but Figure 2 yet."""
        from joblib import cpu_count, delayed

        games = report.games[report.games.role != "figure2"].sort_values([*CELL, "game"], kind="stable")
        if not len(games):
            raise UserError(f"{report.run.path}: has no games but those of Figure 2 yet; go on with --resume")
        paths = sorted((path for _, path in finished(games).groupby(PATH)), key=lambda path: -path.duration_s.sum())
        jobs = min(cpu_count(), MOST_JOBS) if len(games) >= PARALLEL_FROM_GAMES else 1
        scored = on_this_machine(jobs, 1, (delayed(score_path)(report.run, path) for path in paths))
        cells = [cell for of_path in scored for cell in of_path]
        found = pd.concat(cells) if cells else pd.DataFrame(columns=SCORES, dtype=float)
        return games[games.role != "lockstep"].join(found)

    def summary(self, report: Report) -> Summary:
        """Return a cell for each CELL: medians over games of each game's mean over the references, itself left out.

        Durations and wall times are compared with the references' means; intervals are 95 % bootstrap intervals over
        games. Numbers that cannot be known (no reference in the run, a lone reference) are None.
        """
        keys = subset(vars(report.config), "suite", "profile", "seed")
        return {**keys, "cells": summary_cells(report.scores, report.config.seed)}

    def headline(self, report: Report) -> str:
        """Return how far each command's fastest games are from real time and how fast; lockstep only if all are."""
        cells, said, speeds = cells_of(report), list[str](), list[str]()
        compared = cells[(cells.clock_speed > 1) & cells.stlc_median.notna()]
        compared = compared if (compared.timing == "lockstep").all() else compared[compared.timing != "lockstep"]
        for command, own in compared.groupby("command"):
            name, clock = command_name(command), own.clock_speed.max()
            own, same = own[own.clock_speed == clock], bool(said) and clock == compared.clock_speed.max()
            off_m, stlc = metres(own.position_rmse_m.max()), f"median STLC {own.stlc_median.median():.2f}"
            strays = f"strays up to {off_m} m (RMSE; {stlc}, above {SIMILAR_STLC:g} counts as alike)"
            strays = strays if own.position_rmse_m.any() else "is identical to real time"
            said.append(f"{name} {strays}" if same else f"At {clock:g}x {name} {strays}")
            speeds.append(f"{name} {plots.span(own.effective_speedup, '{:.3g}')}")
        if not said:
            return f"{counted(cells.games.sum(), 'game')}, none of them accelerated and comparable with real time"
        return f"{'. '.join(said)}. Speed-up over real time: {', '.join(speeds)}"

    def overview(self, report: Report) -> Table:
        return plots.span_table(cells_of(report), ["command", "clock_speed", "timing"], COLUMNS)

    def page(self, report: Report) -> Iterator[Block | str]:
        cells = cells_of(report)
        yield from warnings(report.scores)
        if cells.reference.isna().any():
            yield "Warning: some cells have no real-time ADSC games to compare with."
        if len(known := cells.reference.dropna()):
            games = plots.span((reference["games"] for reference in known), "{:d}")
            yield f"Real-time ADSC games that a cell is compared with, of the same T_move and rounds: {games}."
        yield Heading("Overview: from the least to the greatest of the cells")
        yield self.overview(report)
        yield Heading("Figures")
        for figure in (velocity_figure, trajectory_figure, trellis_figure, accuracy_figure, speedup_figure):
            yield figure(report)
        yield Heading("All cells")
        yield plots.span_table(cells, CELL, COLUMNS, folded=counted(len(cells), "cell"))
        yield method_note(READING)


COLUMNS: Mapping[str, plots.Span] = {
    "command": ("command", str.upper),
    "ClockSpeed": ("clock_speed", "{:g}x"),
    "source": ("provenance", "{}"),
    "T_move, s": ("t_move_s", "{:g}"),
    "rounds": ("rounds", "{}"),
    "games": ("games", "{}"),
    "failed": ("failed_games", "{}"),
    "disturbed": ("disturbed_games", "{}"),
    "STLC median": ("stlc_median", "{:.3f}"),
    "RMSE, m": ("position_rmse_m", metres),
    "v. lockstep": ("position_rmse_vs_lockstep_m", metres),
    "speed-up": ("effective_speedup", "{:.2f}"),
    "real-time factor": ("real_time_factor", "{:.2f}"),
    "speed-up's source": ("effective_speedup_provenance", "{}"),
}
SCORES = ["stlc", "position_rmse_m", "position_rmse_vs_lockstep_m", "gap_s", "distinct_games"]


def score_path(run: RunDirectory, games: pd.DataFrame) -> list[pd.DataFrame]:
    """Return the SCORES of each cell of a PATH, NaN where there is nothing to compare with; `gap_s` are lists."""
    from uavaccel.metrics.stlc import mean_stlc  # loads numba

    arrays = {game["case"]: run.load_arrays(game) for game in games.to_dict("records")}

    def flights(games: pd.DataFrame) -> list[Trajectory]:
        return [Trajectory(arrays[case]["time_s"], arrays[case]["position_m"]) for case in games.case]

    real, calm, scored = flights(games[games.role == "reference"]), flights(games[games.role == "lockstep"]), []
    for _, cell in games[games.role != "lockstep"].groupby(CELL):
        own, itself = flights(cell), bool((cell.role == "reference").all())
        gaps_s = [command_gaps_s(arrays[case]["command_start_s"], arrays[case]["command_end_s"]) for case in cell.case]
        scores = {
            "stlc": mean_stlc(own, real, itself) if real else np.nan,
            "position_rmse_m": mean_position_rmse(own, real, itself) if real else np.nan,
            "position_rmse_vs_lockstep_m": mean_position_rmse(own, calm) if calm else np.nan,
            "gap_s": [gap_s.tolist() for gap_s in gaps_s],
            "distinct_games": len(distinct(own)[0]),
        }
        scored.append(pd.DataFrame(scores, cell.index))
    return scored


def summary_cells(scores: pd.DataFrame, seed: int) -> list[dict[str, Any]]:
    """Return the cells of the summary from the scored games, in canonical order."""
    references = dict(iter(finished(scores[scores.role == "reference"]).groupby(PATH)))
    cells = []
    for key, cell in scores.groupby(CELL):
        keys, own, itself = dict(zip(CELL, key, strict=True)), finished(cell), bool((cell.role == "reference").all())
        real = references.get(tuple(keys[name] for name in PATH), own.head(0))
        provenance, reference, interval, mixed = timing_provenance(keys["timing"]), None, None, None
        if len(real):
            game = real.iloc[0]
            reference = reference_of(game, itself, command=game.command, games=len(real))
        if reference and len(own):
            mixed = provenance if provenance == reference["provenance"] else "mixed"
            interval = None if itself else speedup_interval(real.wall_s, own.wall_s, seed)  # 1 by definition
        stlc, rmse_m, gaps_s = own.stlc, own.position_rmse_m, own.gap_s.explode().astype(float)
        found = {
            **keys,
            "games": len(own),
            "failed_games": len(cell) - len(own),
            "distinct_games": int(own.distinct_games.iloc[0]) if len(own) else 0,
            "provenance": provenance,
            "seed": seed,
            "reference": reference,
            **disturbed_games(own),
            "stlc_median": stlc.median(),
            "stlc_q25": stlc.quantile(0.25),
            "stlc_q75": stlc.quantile(0.75),
            "stlc_median_interval": median_interval(stlc, seed) if stlc.count() else None,
            "position_rmse_m": rmse_m.median(),
            "position_rmse_interval_m": median_interval(rmse_m, seed) if rmse_m.count() else None,
            "position_rmse_vs_lockstep_m": own.position_rmse_vs_lockstep_m.median(),
            "duration_error_s": (own.duration_s - real.duration_s.mean()).median(),
            "command_gap_median_s": gaps_s.median(),
            "command_gap_q95_s": gaps_s.quantile(0.95),
            "effective_speedup": real.wall_s.mean() / own.wall_s.mean(),
            "effective_speedup_interval": interval,
            "effective_speedup_provenance": mixed,
            "real_time_factor": own.real_time_factor.mean(),
            "lost_wall_s": own.lost_wall_s.sum(min_count=1),
        }
        first = {name: value[0] if isinstance(value, tuple) else value for name, value in found.items()}
        cells.append({name: None if unknown(first[name]) else value for name, value in found.items()})
    return cells


def cells_of(report: Report) -> pd.DataFrame:
    """Return the summary's cells as a table."""
    return pd.DataFrame([{"disturbed_games": 0, **cell} for cell in report.summary["cells"]])


NO_COMMAND: style.LineStyle = {"color": "#D0D0D0", "linewidth": 0}


def velocity_figure(report: Report) -> Picture:
    """Draw Figure 2: two steps forward and one back, slowest ClockSpeed on top."""
    games, gaps = finished(report.games[report.games.role == "figure2"]).sort_values("game"), []
    title = "Two steps forward, one back"
    figure, panels = plots.facets(games, "game", title, across=1, empty="no flight recorded")
    for axes, _, own in panels:
        game = own.iloc[0]
        arrays = report.arrays(game)
        starts, ends = arrays["command_start_s"], arrays["command_end_s"]
        for end, start in zip(ends, starts[1:], strict=False):
            axes.axvspan(end, start, **NO_COMMAND)
        for end in ends:
            axes.axvline(end, **style.LIMIT)
        for number, (axis, name) in enumerate([(0, "north"), (2, "down")]):
            colour, velocity_m_s = style.colour(number), arrays["linear_velocity_m_s"][:, axis]
            axes.plot(arrays["time_s"], velocity_m_s, color=colour)
            end = arrays["time_s"][-1], velocity_m_s[-1]
            axes.annotate(name, end, (4, 0), textcoords="offset points", color=colour, va="center", fontsize=9)
        gaps.append(f"{command_at_clock(game)}: {1e3 * np.mean(command_gaps_s(starts, ends)):.1f} ms between commands")
        axes.set(ylabel="velocity, m/s", title=gaps[-1])
    figure.axes[-1].set_xlabel("simulated time, s")
    style.legend(figure, {"command ends": style.LIMIT, "no command runs": NO_COMMAND})
    caption = (
        "Figure 2. Velocity in real time and at the run's highest ClockSpeed. Dashed: a command ends. Grey: no command "
        "runs, the drone flies on while the client reacts."
    )
    alt = f"Curves of the velocity north and down over simulated time. {'; '.join(gaps)}."
    return report.figure("figure2_velocity", figure, caption, alt, games)


def trajectory_figure(report: Report) -> Picture:
    """Draw Figure 3: a reference, the best and the worst replica of ADSC's fastest cell by STLC, and TCSC's worst.

    Their path is of the longest T_move and about four rounds: enough laps to drift, few enough to tell them apart.
    """
    flown, title = finished(report.scores), "Trajectories"
    flown = flown.assign(near=-(flown["rounds"] - 4).abs()).sort_values(["t_move_s", "near"], ascending=False)
    flown = flown.merge(flown.head(1)[PATH]).sort_values("stlc", ascending=False, kind="stable")
    if len(flown):
        title += f", {counted(flown['rounds'].iloc[0], 'round')}, T_move {flown.t_move_s.iloc[0]:g} s"
    lines = [(game, "reference", REAL) for game in flown[flown.role == "reference"].head(1).to_dict("records")]
    for command, replicas in ("adsc", {"best": 0, "worst": -1}), ("tcsc", {"worst": -1}):
        games = flown[(flown.role == "game") & (flown.command == command)]
        cell = games[games.clock_speed == games.clock_speed.max()].to_dict("records")
        for name, place in replicas.items() if cell else ():
            stlc = plots.span([cell[place]["stlc"]], "{:.3f}")
            lines.append((cell[place], f"{name} of {len(cell)}: STLC {stlc}", REPLICAS[command, name]))
    figure = style.new_figure(6.0, title)
    axes: style.Axes3D = figure.add_subplot(projection="3d")
    places_m = [report.arrays(game)["position_m"] for game, _, _ in lines]
    labels = [f"{command_at_clock(game)}, {name}" for game, name, _ in lines]
    for label, (_, _, look), (north, east, down) in zip(labels, lines, (each.T for each in places_m), strict=True):
        axes.plot(north, east, -down, **look, label=label)
    style.space(axes, places_m)
    style.legend(figure)
    caption = (
        "Figure 3. A real-time trajectory, the best and the worst replica of ADSC's fastest cell by STLC, and the "
        "worst of TCSC's, dotted. Height is up, −z of the NED frame."
    )
    alt = f"Trajectories in space: {'; '.join(labels)}."
    return report.figure("figure3_trajectories", figure, caption, alt, pd.DataFrame([game for game, *_ in lines]))


REAL: style.LineStyle = {"color": style.BLACK, "linewidth": 1.0}
REPLICAS: dict[tuple[str, str], style.LineStyle] = {
    ("adsc", "best"): {"color": style.COMMAND_COLOUR["adsc"], "linewidth": 1.2, "alpha": 0.5},
    ("adsc", "worst"): {"color": style.COMMAND_COLOUR["adsc"], "linewidth": 1.4},
    # dotted, so that what it hides is seen
    ("tcsc", "worst"): {"color": style.COMMAND_COLOUR["tcsc"], "linewidth": 1.6, "linestyle": (0, (2, 4))},
}


class TraceEvent(TypedDict):
    """An event of a trace, which is in time order."""

    source: Literal["client", "server"]
    event: str
    """A client's "call METHOD" or "return METHOD", a server's "handle METHOD", "accept", "end", "run" or "pause"."""
    wall_s: Number
    sim_s: Number


MOST_EVENTS = 44  # a longer trace is cut: the trellis shows one command, not a flight
CALL: style.LineStyle = {"color": style.BLACK, "linewidth": 1.1}
ANSWER: style.LineStyle = {"color": style.PURPLE, "linewidth": 1.1, "linestyle": (0, (4, 2))}
RUNNING: style.LineStyle = {"color": style.GREEN, "linewidth": 6, "solid_capstyle": "butt"}


def trellis_figure(report: Report) -> Picture:
    """Draw Figure 4 from the recorded traces, by events, not to scale. Raises UserError for a damaged trace."""
    traces: dict[str, Any] = {}
    for command in ("tcsc", "adsc"):
        name = f"traces/{command}.json"
        if (report.run.path / name).is_file():
            trace = report.run.read_json(name)
            check(Annotated[list[TraceEvent], Field(min_length=1)], trace, str(report.run.path / name))
            traces[command] = trace[:MOST_EVENTS]
    lengths = {command_name(command): len(trace) for command, trace in traces.items()}
    shape: dict[str, Any] = {"across": 1, "height_ratios": [length + 3 for length in lengths.values()] or None}
    height_in = 0.5 + 0.2 * sum(lengths.values()) / max(len(lengths), 1)
    figure, grid = plots.panels(len(traces), "Messages of one command", height_in, empty="no trace recorded", **shape)
    for axes, (command, trace) in zip(grid, traces.items(), strict=True):
        axes.set_axis_off()
        axes.set(xlim=(-1.35, 2.0), ylim=(len(trace) - 0.3, -1.9), title=command_name(command))
        plot_trace(axes, trace)
    style.legend(figure, {"call": CALL, "answer": ANSWER, "simulated time runs": RUNNING})
    caption = (
        "Figure 4. Messages of one recorded command, not to scale. Thick: simulated time runs. Left wall time, right "
        "simulated time, both since the first event."
    )
    counts = " and ".join(f"{length} events of {command}" for command, length in lengths.items())
    alt = f"Arrows between client and server, downwards in time: {counts or 'none'}."
    own = report.games[report.games.timing == report.config.timing]
    return report.figure("figure4_trellis", figure, caption, alt, own)


def messages(events: Sequence[str]) -> Iterator[tuple[int, int]]:
    """Yield the arrows between events by their places: from each call to its handling, and from there to its return.

    Those of one method come in order. A deferred reply leaves at the last "end" between handling and return.
    """
    places = pd.Series(range(len(events)), events).groupby(level=0).agg(list)
    for method in [event.removeprefix("call ") for event in places.index if event.startswith("call ")]:
        called, handled, returned = (places.get(f"{kind} {method}", []) for kind in ("call", "handle", "return"))
        yield from zip(called, handled, strict=False)
        for first, last in zip(handled, returned, strict=False):
            yield max((end for end in places.get("end", []) if first < end < last), default=first), last


def plot_trace(axes: Axes, trace: Sequence[Mapping[str, Any]]) -> None:
    """Plot the arrows of a trace, its times, and the spans in which simulated time runs, an event a line."""
    events, x = [event["event"] for event in trace], {"client": 0.0, "server": 1.0}
    for name, at in x.items():
        axes.plot([at, at], [-0.7, len(trace) - 0.5], color=style.GREY, linewidth=1.0)
        axes.text(at, -1.0, name, ha="center", va="bottom", fontweight="bold")
    switched = pd.Series(events).map({"run": 1.0, "pause": 0.0})
    runs = switched.ffill().fillna(1 - switched.bfill()).fillna(1.0)  # before the first switch it does the contrary
    for start, end in np.flatnonzero(np.diff(runs, prepend=0, append=0)).reshape(-1, 2):
        axes.plot([x["server"]] * 2, [start, min(end, len(trace) - 1)], **RUNNING, zorder=1)
    for start, end in messages(events):
        source, target = ((x[trace[place]["source"]], place) for place in (start, end))
        arrow = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 3, **(ANSWER if source[0] else CALL)}
        axes.annotate("", xy=target, xytext=source, arrowprops=arrow)
    for place, event in enumerate(trace):  # where an arrow ends, the time alone is enough
        kind, _, method = event["event"].partition(" ")
        if event["source"] == "client":
            text = f"{method if kind == 'call' else ''}   {(event['wall_s'] - trace[0]['wall_s']) * 1e3:.2f} ms"
            axes.text(-0.06, place, text, ha="right", va="center", fontsize=8.5)
        else:
            text = f"{event['sim_s'] - trace[0]['sim_s']:.3f} s   {'' if kind == 'handle' else event['event']}"
            axes.text(1.08, place, text, ha="left", va="center", fontsize=8.5)


def accuracy_figure(report: Report) -> Picture:
    """Draw Figure 5 from all games, T_moves pooled: a panel a ClockSpeed, the commands' boxes beside each other."""
    scored = finished(report.scores)
    games, medians = scored[scored.stlc.notna()].sort_values("clock_speed"), []
    every, title = sorted(games["rounds"].unique()), "Accuracy of the trajectories: STLC"
    figure, panels = plots.facets(games, "clock_speed", title, empty="no games to compare")
    for axes, clock, own in panels:
        axes.axhline(SIMILAR_STLC, **style.LIMIT)
        commands = sorted(own.command.unique())
        for number, command in enumerate(commands):
            flown = own[own.command == command]
            stlc = {rounds: flown.stlc[flown["rounds"] == rounds] for rounds in every}
            place = plots.beside(number, len(commands), 0.4)
            plots.boxes(axes, stlc, style.COMMAND_COLOUR[command], command_name(command), place)
            medians.append(f"{flown.stlc.median():.3f} of {command_name(command)} at {clock_label(clock)}")
        axes.set(ylim=(min(1.7, games.stlc.min() - 0.05), 2.04), title=clock_label(clock))
        axes.set(xlabel="rounds", ylabel="STLC")
    plots.label_outer([axes for axes, *_ in panels])
    style.legend(figure, {f"alike above {SIMILAR_STLC:g}": style.LIMIT})
    caption = (
        "Figure 5. STLC against the real-time ADSC games; one value a game, its mean over the references, T_moves "
        "pooled. Replicas whose flights are identical make a box of no height."
    )
    alt = f"Boxes of STLC by number of rounds and ClockSpeed. Medians: {', '.join(medians) or 'none'}."
    return report.figure("figure5_accuracy", figure, caption, alt, scored)


def speedup_figure(report: Report) -> Picture:
    """Draw Figure 6 from the cells with the most rounds: a panel per command, a line per T_move, the ideal dashed."""
    cells, scores = cells_of(report), finished(report.scores)
    rounds = cells["rounds"].max()
    label, flown = counted(rounds, "round"), scores[scores["rounds"] == rounds]
    known = cells[(cells["rounds"] == rounds) & cells.effective_speedup.notna()].sort_values(["command", "clock_speed"])
    clocks, t_moves_s = (sorted(known[name].unique()) for name in ("clock_speed", "t_move_s"))
    title, nothing = f"Effective speed-up over ADSC at 1x, {label}", "no speed-up without ADSC games at 1x"
    figure, panels = plots.facets(known, "command", title, height_in=2.8, empty=nothing)
    for axes, command, own in panels:
        for place, clock in enumerate(clocks):  # a line, or a stroke where a place stands alone
            axes.plot([place - 0.3, place + 0.3], [clock, clock], **style.LIMIT)
        for number, t_move_s in enumerate(t_moves_s):
            of = own[own.t_move_s == t_move_s]
            ends = np.array([ends or (np.nan, np.nan) for ends in of.effective_speedup_interval]).reshape(-1, 2).T
            places = np.searchsorted(clocks, of.clock_speed) + plots.beside(number, len(t_moves_s), 0.14)
            look = {"color": style.shade(number, len(t_moves_s)), "marker": style.marker(number)}
            name = f"T_move {t_move_s:g} s"
            plots.line(axes, places, of.effective_speedup, (ends[0], ends[1]), **look, label=name, linestyle="none")
        plots.clock_axis(axes, clocks)
        plots.log_axis(axes, "y", "{:g}x")
        axes.set(title=command_name(command), ylabel="effective speed-up")
    plots.label_outer([axes for axes, *_ in panels])
    style.legend(figure, {"ideal": style.LIMIT})
    caption = (
        f"Figure 6. Effective speed-up of games of {label}: mean wall time of ADSC at 1x over the cell's, with 95 % "
        "bootstrap intervals over games. Dashed: the ideal."
    )
    fastest = known[known.clock_speed == known.clock_speed.max()].groupby("command").effective_speedup
    reached = [f"{command_name(command)} {plots.span(speeds, '{:.3g}')}" for command, speeds in fastest]
    alt = f"Points of speed-up by ClockSpeed and T_move; at the highest ClockSpeed {', '.join(reached) or 'none'}."
    return report.figure("figure6_speedup", figure, caption, alt, flown)


READING = (
    "STLC (lambda 0.5, metres, seconds) is 2 for identical flights; above 1.8 they look alike. It matches places and "
    "times independently and cannot see a lap too few or too late: the error of positions at equal times (RMSE) stands "
    "beside it. A game's accuracy is its mean over the reference games, ADSC at 1x of the same T_move and rounds, "
    "itself left out. Medians and 95 % bootstrap intervals are over games. The speed-up is the ratio of mean wall "
    "times for the same commands; the real-time factor is a game's simulated time over its wall time, and stays at the "
    "ClockSpeed as long as the simulation keeps up. The speed-up falls short of it, the more the shorter the T_move, "
    "since messages take as much wall time at any ClockSpeed. Measured: the machine's clock. Modelled: a simulated "
    "clock. Mixed: a measured game over a modelled baseline. Native TCSC games of a cell are identical by construction."
)
