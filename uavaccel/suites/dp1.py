"""DP1: a square path flown with ADSC and TCSC, compared with real time (paper, sections III-C2a and IV-B)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, Field, model_validator

from uavaccel.commands import COMMANDS
from uavaccel.commands.paths import velocities
from uavaccel.commands.slices import check_times
from uavaccel.draw import style
from uavaccel.draw.labels import clock_label, command_at_clock, metres, rounds_label
from uavaccel.draw.page import Block, Heading, Picture, Table, unknown
from uavaccel.files import Plain
from uavaccel.forms import ArrayForm, Count, Positive
from uavaccel.kinematics import VelocityGoal
from uavaccel.limits import MOST_HEIGHT_M, MOST_ROUNDS, Games, Seconds, Speed, Velocity
from uavaccel.metrics.intervals import median_interval
from uavaccel.metrics.speedup import combined_provenance, speedup_interval, timing_provenance
from uavaccel.metrics.trajectory import Trajectory, command_gaps_s, distinct, mean_position_rmse
from uavaccel.records import RunDirectory
from uavaccel.sim.profile import PROFILES
from uavaccel.suites import experiment, plots
from uavaccel.suites.experiment import FlightExperiment, Timing, t_th_ns
from uavaccel.suites.flight import Flight
from uavaccel.suites.report import Report, Summary, disturbed_games, finished, source_line, warnings
from uavaccel.suites.rows import FlightCase, FlightRow, flight_row, named_seed, subset
from uavaccel.suites.suite import GameResult, Suite
from uavaccel.suites.trellis import trellis_figure
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:  # it loads the simulation
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


ARRAYS = {
    "time_s": ArrayForm("f8", ("samples",), ascends=True),
    "position_m": ArrayForm("f8", ("samples", 3)),
    "orientation_wxyz": ArrayForm("f8", ("samples", 4)),
    "linear_velocity_m_s": ArrayForm("f8", ("samples", 3)),
    "angular_velocity_rad_s": ArrayForm("f8", ("samples", 3)),
    "command_start_s": ArrayForm("f8", ("commands",), ascends=True),
    "command_end_s": ArrayForm("f8", ("commands",), ascends=True),
}
"""What a flight records, as `Recording.arrays` makes it."""


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


class Dp1(Suite[Dp1Config, Game]):
    """`uavaccel run dp1`."""

    name = "dp1"
    config = Dp1Config
    row = Dp1Row
    arrays = ARRAYS
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

    def case_of(self, row: Plain) -> str:
        flown = row["role"], row["command"], row["clock_speed"], row["timing"]
        return Game(*flown, row["t_move_s"], row["rounds"], row["game"], "square").id

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        return ("games",)

    def open(self, config: Dp1Config, timing: str, run: RunDirectory) -> AbstractContextManager[Session]:
        from uavaccel.wire.session import open_session

        return open_session(timing, config.profile, "blocks", config.latency)

    def fly(self, config: Dp1Config, case: Game, opened: Session) -> GameResult:
        """Fly the case's path; its wall time is from the first command's issue to the last one's return."""
        client = opened.start_game(case.clock_speed, case.seed(config.seed))
        command, t_sample_s = COMMANDS[case.command], config.t_sample_s or case.t_move_s
        t_th = t_th_ns(config, case.clock_speed, t_sample_s)
        command.begin(client)
        start_ns = client.now_ns()
        for velocity in velocities(case.path, case.rounds, config.speed_m_s):
            goal = VelocityGoal(velocity, config.height_m)
            for _ in command.fly(client, goal, case.t_move_s, t_sample_s, t_th):
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
        """Add each game's likeness to real time, its error against the flight without latency, and its gaps."""
        from joblib import Parallel, cpu_count, delayed

        games = report.games
        flown = games[games.role.isin(["game", "reference"])].sort_values([*CELL, "game"], kind="stable")
        paths = [path for _, path in finished(games[games.role != "figure2"]).groupby(PATH)]
        paths.sort(key=lambda path: -path.duration_s.sum())
        jobs = min(cpu_count(), MOST_JOBS) if len(games) >= PARALLEL_FROM_GAMES else 1
        found = Parallel(jobs, batch_size=1)(delayed(score_path)(report.run, path) for path in paths)
        return flown.join(pd.concat(found) if found else pd.DataFrame(columns=SCORES, dtype=float))

    def summary(self, report: Report) -> Summary:
        """Return a cell for each command, ClockSpeed, T_move, number of rounds and timing.

        Accuracies are medians over games of each game's mean over the references, itself left out; durations and wall
        times are compared with the references' means; intervals are 95 % bootstrap intervals over games. Numbers that
        cannot be known (no reference in the run, a lone reference) are None.
        """
        keys = subset(vars(report.config), "suite", "profile", "seed")
        return {**keys, "cells": summary_cells(report.scores, report.config.seed)}

    def title(self, report: Report) -> str:
        return f"DP1, {report.config.profile} profile, seed {report.config.seed}"

    def headline(self, report: Report) -> str:
        """Return each command's likeness to real time, error and speed-up; lockstep only where all is."""
        cells, said = cells_of(report), []
        cells = cells if (cells.timing == "lockstep").all() else cells[cells.timing != "lockstep"]
        fast = cells[(cells.clock_speed > 1) & cells.stlc_median.notna()]
        for command, own in fast.groupby("command"):
            alike = own.groupby("clock_speed").stlc_median.min() > SIMILAR_STLC
            up_to, highest = alike.index[alike.cummin()], alike.index[-1]
            flies = f"flies as in real time up to {up_to[-1]:g}x" if len(up_to) else ""
            flies = flies or f"no longer flies as in real time at {alike.index[0]:g}x"
            fastest = own[own.clock_speed == highest]
            error, speedup = metres(fastest.position_rmse_m.max()), plots.span(fastest.effective_speedup)
            said.append(
                f"{command.upper()} {flies} (STLC above {SIMILAR_STLC:g}); at {highest:g}x it is up to {error} m off "
                f"(RMSE) and {speedup} times as fast"
            )
        if not said:
            return f"{cells.games.sum()} games, none of them accelerated and comparable with real time"
        return f"{'; '.join(said)} ({' and '.join(sorted(set(fast.provenance)))})"

    def overview(self, report: Report) -> Table:
        """Return the worst accuracies and the range of speeds of each command and ClockSpeed."""
        groups = cells_of(report).groupby(["command", "clock_speed", "timing", "provenance"])
        worst: dict[str, Any] = {"games": "sum", "disturbed_games": "sum", "stlc_median": "min", "mixed": "first"}
        worst |= {"position_rmse_m": "max", "position_rmse_vs_lockstep_m": "max"}
        worst |= {"effective_speedup": plots.span, "real_time_factor": plots.span}
        columns = {
            "command": "{command!u}",
            "ClockSpeed": "{clock_speed:g}x",
            "games": "{games}{disturbed_games!d}",
            "lowest STLC median": "{stlc_median:.4f}",
            "largest RMSE v. reference, m": "{position_rmse_m!m}",
            "largest RMSE v. lockstep, m": "{position_rmse_vs_lockstep_m!m}",
            "effective speed-up": "{effective_speedup}{mixed}",
            "real-time factor": "{real_time_factor}",
            "source": "{provenance}",
        }
        return Table.of(groups.agg(worst).reset_index(), columns)

    def page(self, report: Report) -> Iterator[Block | str]:
        cells = cells_of(report)
        yield f"Games: {source_line(report.games)}."
        yield from warnings(report.scores)
        if cells.reference.isna().any():
            yield "Warning: some cells have no real-time ADSC games to compare with."
        yield Heading("Overview: worst cell, range of speeds")
        yield self.overview(report)
        yield READING
        yield Heading("Figures")
        yield velocity_figure(report)
        yield trajectory_figure(report)
        yield trellis_figure(report)
        yield accuracy_figure(report)
        yield speedup_figure(report)
        yield Heading("All cells")
        columns = {
            "command": "{command!u}",
            "clock": "{clock_speed:g}x",
            "T_move s": "{t_move_s:g}",
            "rounds": "{rounds}",
            "games": "{games}{failed_games!f}{disturbed_games!d}",
            "STLC median [q25, q75]": "{stlc_median:.3f} [{stlc_q25:.3f}, {stlc_q75:.3f}]",
            "RMSE m": "{position_rmse_m!m}",
            "v. lockstep": "{position_rmse_vs_lockstep_m!m}",
            "duration s": "{duration_error_s:+z.3f}",
            "speed-up": "{effective_speedup:.2f}{mixed}",
            "achieved": "{real_time_factor:.2f}",
            "source": "{provenance}",
        }
        yield Table.of(cells, columns, folded=f"{len(cells)} cells")


SCORES = ["stlc", "position_rmse_m", "position_rmse_vs_lockstep_m", "gap_s", "distinct_games"]


def score_path(run: RunDirectory, games: pd.DataFrame) -> pd.DataFrame:
    """Return the SCORES of games of one PATH, NaN where there is nothing to compare with; `gap_s` are lists."""
    from uavaccel.metrics.stlc import mean_stlc  # loads scipy

    games = games.sort_values([*CELL, "game"], kind="stable")
    arrays = {case: run.load_arrays(game) for case, game in zip(games.case, games.to_dict("records"), strict=True)}

    def flights(games: pd.DataFrame) -> list[Trajectory]:
        return [Trajectory(arrays[case]["time_s"], arrays[case]["position_m"]) for case in games.case]

    real, lockstep, found = games[games.role == "reference"], games[games.role == "lockstep"], list[pd.DataFrame]()
    for key, cell in games[games.role != "lockstep"].groupby(CELL):
        own, references, itself = flights(cell), flights(real), bool((cell.role == "reference").all())
        ideal = flights(lockstep.sort_values("command", key=lambda command: command != key[0]).head(1))
        gaps_s = [command_gaps_s(arrays[case]["command_start_s"], arrays[case]["command_end_s"]) for case in cell.case]
        scores = {
            "stlc": mean_stlc(own, references, itself) if references else np.nan,
            "position_rmse_m": mean_position_rmse(own, references, itself) if references else np.nan,
            "position_rmse_vs_lockstep_m": mean_position_rmse(own, ideal) if ideal else np.nan,
            "gap_s": [gap_s.tolist() for gap_s in gaps_s],
            "distinct_games": len(distinct(own)[0]),
        }
        found.append(pd.DataFrame(scores, index=cell.index))
    return pd.concat(found) if found else pd.DataFrame(columns=SCORES, dtype=float)


def same_path(games: pd.DataFrame, cell: pd.DataFrame) -> pd.DataFrame:
    """Return the games with the T_move and the number of rounds of a cell."""
    return games[(games[PATH] == cell[PATH].iloc[0]).all(axis=1)]


def summary_cells(scores: pd.DataFrame, seed: int) -> list[dict[str, Any]]:
    """Return the cells of the summary from the scored games, in canonical order."""
    cells: list[dict[str, Any]] = []
    for key, cell in scores.groupby(CELL):
        own, real, itself = finished(cell), finished(same_path(scores, cell)), bool((cell.role == "reference").all())
        real, disturbed, provenance = real[real.role == "reference"], disturbed_games(own), timing_provenance(key[-1])
        reference, interval, mixed = None, None, None
        if len(real):
            reference = subset(real.iloc[0], "command", "timing", "clock_speed")
            reference |= {"provenance": timing_provenance(reference["timing"])}
            reference |= {"games": len(real), "is_this_cell": itself}
        if reference and len(own):
            mixed = combined_provenance(provenance, reference["provenance"])
            interval = None if itself else list(speedup_interval(real.wall_s, own.wall_s, seed))  # 1 by definition
        stlc, rmse_m = own.stlc, own.position_rmse_m
        gaps_s = pd.Series([gap_s for gaps_s in own.gap_s for gap_s in gaps_s], dtype=float)
        found = {
            **dict(zip(CELL, key, strict=True)),
            "games": len(own),
            "failed_games": len(cell) - len(own),
            "distinct_games": int(own.distinct_games.iloc[0]) if len(own) else 0,
            "provenance": provenance,
            "seed": seed,
            "reference": reference,
            **({"disturbed_games": disturbed} if disturbed else {}),
            "stlc_median": stlc.median(),
            "stlc_q25": stlc.quantile(0.25),
            "stlc_q75": stlc.quantile(0.75),
            "stlc_median_interval": list(median_interval(stlc, seed)) if stlc.count() else None,
            "position_rmse_m": rmse_m.median(),
            "position_rmse_interval_m": list(median_interval(rmse_m, seed)) if rmse_m.count() else None,
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
        cells.append({name: None if unknown(value) else value for name, value in found.items()})
    return cells


def cells_of(report: Report) -> pd.DataFrame:
    """Return the summary's cells as a table; `mixed` marks a speed-up of a measured wall time over a modelled one."""
    cells = pd.DataFrame([{"disturbed_games": 0, **cell} for cell in report.summary["cells"]])
    return cells.assign(mixed=np.where(cells.effective_speedup_provenance == "mixed", " (mixed)", ""))


COMMAND_ENDS: style.LineStyle = {"color": style.BLACK, "linestyle": (0, (4, 3)), "linewidth": 0.9}
NO_COMMAND: style.LineStyle = {"color": "#D0D0D0", "linewidth": 0}


def velocity_figure(report: Report) -> Picture:
    """Draw Figure 2: two steps forward and one back, slowest ClockSpeed on top."""
    games = finished(report.games[report.games.role == "figure2"]).sort_values("clock_speed", kind="stable")
    flights = [(game, report.arrays(game)) for game in games.to_dict("records")]
    source, title, shared = source_line(games), "Two steps forward, one back", {"sharex": True, "sharey": True}
    figure, grid = plots.panels(len(games), 1, title, source, (6.4, 2.1), **shared)
    fastest = [np.abs(arrays["linear_velocity_m_s"]).max(axis=0) for _, arrays in flights]
    moving = np.flatnonzero(np.max(fastest or [[0.0] * 3], axis=0) > 0.05)  # slower components are left out
    for axes, (game, arrays) in zip(grid[:, 0], flights, strict=False):
        starts, ends = arrays["command_start_s"], arrays["command_end_s"]
        for end, start in zip(ends[:-1], starts[1:], strict=True):
            axes.axvspan(end, start, **NO_COMMAND)
        for end in ends:
            axes.axvline(end, **COMMAND_ENDS)
        for axis in moving if len(moving) else [0]:
            line = {"label": ("north", "east", "down")[axis], "color": style.CYCLE[axis]}
            axes.plot(arrays["time_s"], arrays["linear_velocity_m_s"][:, axis], **line)
        gap_ms = 1e3 * np.mean(command_gaps_s(starts, ends))
        axes.set(ylabel="velocity, m/s", title=f"{command_at_clock(game)}: {gap_ms:.1f} ms between commands")
    grid[-1, 0].set_xlabel("simulated time, s")
    if flights:
        style.key(figure, grid[0, 0], {"command ends": COMMAND_ENDS, "no command runs": NO_COMMAND})
    else:
        style.note(grid[0, 0], "no flight recorded")
    caption = (
        "Figure 2. Velocity over simulated time, two steps forward and one back, in real time and at the run's highest "
        "ClockSpeed. Dashed: a command ends. Grey: no command runs, the drone flies on while the client reacts."
    )
    return report.figure("figure2_velocity", figure, caption, source)


def trajectory_figure(report: Report) -> Picture:
    """Draw Figure 3: best and worst replica by STLC of the fastest ADSC cell of the longest T_move, and one of TCSC.

    A cell of about four rounds is taken: enough laps to drift, few enough to tell them apart.
    """
    flown, picked, title = finished(report.scores), list[dict[str, Any]](), "Trajectories"
    ranks = {"fast": flown.clock_speed > 1, "adsc": flown.command == "adsc", "near": -(flown["rounds"] - 4).abs()}
    order = ["fast", "adsc", "clock_speed", "t_move_s", "near"]
    flown = flown.assign(**ranks).sort_values(order, ascending=False, kind="stable")
    if len(flown):
        flown = same_path(flown, flown)
        title += f", {rounds_label(flown['rounds'].iloc[0])}, T_move {flown.t_move_s.iloc[0]:g} s"
        picked += flown[flown.role == "reference"].head(1).assign(name=": reference").to_dict("records")
    for games, shown in (flown, {"best": 0, "worst": -1}), (flown[flown.command == "tcsc"], {"worst": -1}):
        cell = games.merge(games.head(1)[CELL])
        cell = cell[cell.role == "game"].sort_values("stlc", ascending=False, kind="stable")
        if cell.distinct_games.eq(1).any():
            shown = {f"all {len(cell)} identical" if len(cell) > 1 else "one game": 0}
        for name, place in shown.items() if len(cell) else ():
            stlc = cell.stlc.iloc[place]
            name += f": STLC {'unknown' if np.isnan(stlc) else f'{stlc:.3f}'}"
            picked.append({**cell.iloc[place], "name": f", {name}"})
    lines = pd.DataFrame(picked, columns=[*flown, "name"]).drop_duplicates("case")  # ADSC may not be flown
    source, figure = source_line(lines), style.new_figure(7.2, 6.0, title, source_line(lines))
    axes: style.Axes3D = figure.add_subplot(projection="3d")
    places_m = [report.arrays(game)["position_m"] for game in lines.to_dict("records")]
    colours, dotted = (style.BLUE, style.GREEN, style.VERMILION, style.BLACK), (0, (2, 4))
    for place, (position_m, game) in enumerate(zip(places_m, lines.to_dict("records"), strict=True)):
        look = {"color": colours[place], "linestyle": dotted if place == 3 else "-"}  # so that what it hides is seen
        north, east, down = position_m.T
        axes.plot(north, east, -down, **look, label=f"{command_at_clock(game)}{game['name']}", linewidth=1.2)
    style.space(axes, places_m)
    caption = (
        "Figure 3. A real-time trajectory, and the best and the worst replica of the fastest cell by STLC, and the "
        "least accurate of TCSC's fastest cell, dotted. Height is up, −z of the NED frame."
    )
    return report.figure("figure3_trajectories", figure, caption, source)


def accuracy_figure(report: Report) -> Picture:
    """Draw Figure 5 from all games, T_moves pooled: a row of panels per command and a column per ClockSpeed."""
    games, nothing = finished(report.scores), "no games to compare"
    known, source, title = games[games.stlc.notna()], source_line(games), "Accuracy of the trajectories: STLC"
    commands, clocks, rounds = (sorted(games[name].unique()) for name in ("command", "clock_speed", "rounds"))
    figure, grid = plots.panels(len(commands), len(clocks), title, source, (1.9, 2.3), sharex=True, sharey=True)
    for (row, command), (column, clock) in product(enumerate(commands), enumerate(clocks)):
        axes, cell = grid[row, column], known[(known.command == command) & (known.clock_speed == clock)]
        stlc = {number: cell[cell["rounds"] == number].stlc.tolist() for number in rounds}
        axes.axhline(SIMILAR_STLC, color="#C00000", linewidth=1.0, zorder=1)
        plots.boxes(axes, stlc, style.COMMAND_COLOUR.get(command, style.GREEN), nothing)
        grid[0, column].set_title(clock_label(clock), loc="center")
        grid[row, 0].set(ylabel=f"{command.upper()}\nSTLC", ylim=(min(1.7, known.stlc.min() - 0.05), 2.04))
        grid[-1, column].set_xlabel("rounds")
    if games.empty:
        style.note(grid[0, 0], nothing)
    caption = (
        "Figure 5. STLC against the real-time ADSC games; one value a game, its mean over the references, T_moves "
        "pooled; line: 1.8. Replicas whose flights are identical make a box of zero width, drawn as it is."
    )
    return report.figure("figure5_accuracy", figure, caption, source)


def speedup_figure(report: Report) -> Picture:
    """Draw Figure 6 from the cells with the most rounds: a panel per command, a line per T_move, the ideal dashed."""
    cells, scores = cells_of(report), finished(report.scores)
    rounds = cells["rounds"].max()
    source, label = source_line(scores[scores["rounds"] == rounds]), rounds_label(rounds)
    known = cells[(cells["rounds"] == rounds) & cells.effective_speedup.notna()]
    commands, clocks = sorted(known.command.unique()), sorted(known.clock_speed.unique())
    title, shared = f"Effective speed-up over ADSC at 1x, {label}", {"sharex": True, "sharey": True}
    figure, grid = plots.panels(1, len(commands), title, source, (3.6, 3.0), **shared)
    for axes, command in zip(grid[0], commands, strict=False):
        axes.plot(clocks, color=style.BLACK, linestyle="--", linewidth=1.1, label="ideal")
        for number, t_move_s in enumerate(sorted(known.t_move_s.unique())):
            own = known[(known.command == command) & (known.t_move_s == t_move_s)].sort_values("clock_speed")
            line = style.series(number) | {"label": f"T_move {t_move_s:g} s"}
            values = own.effective_speedup.tolist(), own.effective_speedup_interval.tolist()
            plots.points(axes, np.searchsorted(clocks, own.clock_speed), *values, **line)
        axes.set_title(command.upper())
        plots.clock_axis(axes, clocks)
    if commands:
        plots.factor_axis(grid[0, 0])
        grid[0, 0].set_ylabel("effective speed-up")
        grid[0, 0].legend(loc="upper left")
    else:
        style.note(grid[0, 0], "no speed-up without ADSC games at 1x")
    caption = (
        f"Figure 6. Effective speed-up of games of {label}: mean wall time of ADSC at 1x over the cell's, with 95 % "
        "bootstrap intervals over games. Dashed: the ideal."
    )
    return report.figure("figure6_speedup", figure, caption, source)


READING = (
    "STLC (lambda 0.5, metres, seconds) is 2 for identical flights; above 1.8 they look alike. It matches places and "
    "times independently and cannot see a lap too few or too late, so the position error at equal times (RMSE, m) "
    "stands beside it. A game's accuracy is its mean over all reference games, ADSC at 1x of the same T_move and "
    "rounds; a reference is not compared with itself. Medians, quartiles and 95 % bootstrap intervals are over games. "
    "Effective speed-up is the ratio of mean wall times for the same commands. Measured: the machine's clock. "
    "Modelled: a simulated clock. Mixed: a measured game over a modelled baseline. The real-time factor is the "
    "simulated time of a game over its wall time: it stays at the ClockSpeed as long as the simulation keeps up, since "
    "with ADSC the drone flies on while the client reacts. The speed-up falls short of it, the more the shorter the "
    "T_move: at 0.1 s and a ClockSpeed of 50 a command lasts 2 ms of wall time, to which its messages add what no "
    "ClockSpeed shortens. Native TCSC games of one cell are identical by construction, and ADSC games at 1x nearly so."
)
