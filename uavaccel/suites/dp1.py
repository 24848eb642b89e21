"""DP1: a square path flown with ADSC and TCSC, compared with real time (paper, sections III-C2a and IV-B)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Sized
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, Field, field_validator, model_validator

from uavaccel.commands import COMMANDS
from uavaccel.commands.paths import PATHS, velocities
from uavaccel.commands.slices import check_times
from uavaccel.draw import style
from uavaccel.draw.labels import clock_label, command_at_clock, rounds_label
from uavaccel.draw.page import Block, Heading, Picture, Table, fill, unknown
from uavaccel.files import Plain
from uavaccel.forms import ArrayForm, Count, Positive
from uavaccel.kinematics import Vector, VelocityGoal
from uavaccel.limits import MOST_GAMES, MOST_HEIGHT_M, MOST_ROUNDS, MOST_SECONDS, Speed, Velocity
from uavaccel.metrics.intervals import median_interval
from uavaccel.metrics.speedup import combined_provenance, speedup_interval, timing_provenance
from uavaccel.metrics.trajectory import Trajectory, command_gaps_s, distinct, mean_position_rmse, trajectory
from uavaccel.records import RunDirectory
from uavaccel.sim.profile import PROFILES
from uavaccel.suites import plots
from uavaccel.suites.experiment import FlightExperiment, Timing, t_th_ns, within
from uavaccel.suites.flight import Commands, Flight
from uavaccel.suites.report import Report, Summary, disturbed_games, finished, source_line, warnings
from uavaccel.suites.rows import FlightCase, FlightRow, flight_row, named_seed
from uavaccel.suites.suite import GameResult, Suite
from uavaccel.suites.trellis import trellis_figure
from uavaccel.units import NS_PER_S, to_ns

if TYPE_CHECKING:  # they load the simulation, and what draws
    from uavaccel.wire.client import Client
    from uavaccel.wire.session import Session

CELL = ["command", "clock_speed", "t_move_s", "rounds", "timing"]
"""What the games of a cell have in common. They are compared with all ADSC games at 1x of the same PATH."""
PATH = ["t_move_s", "rounds"]
SIMILAR_STLC = 1.8  # above it trajectories look alike (paper, section III-C2a)
FIGURE3_ROUNDS = 4  # enough laps to drift, few enough to tell them apart
PARALLEL_FROM_GAMES, MOST_JOBS = 400, 8  # below, starting worker processes takes longer than scoring

Named = Literal["square", "two_forward_one_back"]
FlownPath = Named | tuple[tuple[Velocity, Velocity, Velocity], ...]
Rounds = Annotated[tuple[int, ...], AfterValidator(lambda rounds: within(rounds, 1, MOST_ROUNDS))]
Duration = Annotated[float, AfterValidator(lambda time_s: within((time_s,), 0.0, MOST_SECONDS)[0])]
Durations = Annotated[tuple[float, ...], AfterValidator(lambda times_s: within(times_s, 0.0, MOST_SECONDS))]
GamesOfCell = Annotated[int, AfterValidator(lambda games: within((games,), 1, MOST_GAMES)[0])]


class Dp1Config(FlightExperiment):
    """`suite: dp1`."""

    suite: Literal["dp1"]
    path: FlownPath = "square"
    """A named path, or a list of velocities, one command each, NED in m/s."""
    speed_m_s: Speed = 1.0
    """Speed on a named path."""
    height_m: Annotated[float, Field(lt=0.0, ge=-MOST_HEIGHT_M)] | None = None
    """NED z to hold, as moveByVelocityZ does; without it plain moveByVelocity is called, as in the paper."""
    rounds: Rounds = (1, 2, 4, 8, 16, 24)
    """How often the square path is flown in a game; each value is flown."""
    t_move_s: Durations = (0.1, 0.2, 0.5, 1.0)
    """Simulated seconds of a command; each value is flown."""
    t_sample_s: Duration | None = None
    """How often the client itself gathers the state; without it once per command, beside the server's recorder."""
    games: GamesOfCell = 20
    """Games of each cell, that is of each command, ClockSpeed, T_move and number of rounds."""
    reference_games: GamesOfCell = 20
    """Real-time ADSC games of each T_move and number of rounds, unless the run flies that cell anyway."""
    reference_timing: Timing = "virtual"
    """The timing of the reference flights, with ADSC at ClockSpeed 1."""

    @field_validator("path")
    @classmethod
    def _not_empty(cls, path: Sized) -> Sized:
        if not path:
            raise ValueError(f"needs at least one velocity, or one of {', '.join(PATHS)}")
        return path

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

    @property
    def velocities_m_s(self) -> Sequence[Vector]:
        """The commands of the path, flown at 1 m/s if it has a name."""
        return velocities(self.path, self.rounds)

    def simulated_s(self) -> float:
        """Return the simulated time of the commands, without gaps between them."""
        return self.t_move_s * len(self.velocities_m_s)

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
        return Game(*flown, row["t_move_s"], row["rounds"], row["game"], ()).id

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        return ("games",)

    def open(self, config: Dp1Config, timing: str, run: RunDirectory) -> AbstractContextManager[Session]:
        from uavaccel.wire.session import open_session

        return open_session(timing, config.profile, "blocks", config.latency)

    def fly(self, config: Dp1Config, case: Game, opened: Session) -> GameResult:
        client = opened.start_game(case.clock_speed, case.seed(config.seed))
        wall_s = fly_path(config, case, client)
        row, recording = flight_row(case, config, client, wall_s)
        row |= {"t_move_s": case.t_move_s, "rounds": case.rounds, "game": case.game}
        row |= {"commands": len(recording.commands), "samples_dropped": recording.dropped}
        return GameResult(row, recording.arrays())

    def finish(self, config: Dp1Config, run: RunDirectory) -> None:
        """Record the messages of one command of each kind, for Figure 4."""
        with self.open(config, config.timing, run) as session:
            for command in config.command:
                from uavaccel.calibration.traces import record_trace

                trace = record_trace(session, command, max(config.clock_speed), max(config.t_move_s))
                run.write_json(f"traces/{command}.json", trace)

    def flight(
        self, report: Report, game: Mapping[str, Any], pictures: bool = True, event_rate_hz: float | None = None
    ) -> Flight:
        config, arrays = report.config, report.arrays(game)
        path = "two_forward_one_back" if game["role"] == "figure2" else config.path
        starts, ends = to_ns(arrays["command_start_s"]), to_ns(arrays["command_end_s"])
        flown = np.array(velocities(path, game["rounds"], config.speed_m_s), float)[: len(starts)]
        return Flight(
            command_at_clock(game),
            game["clock_speed"],
            to_ns(arrays["time_s"]),
            arrays["position_m"],
            arrays["orientation_wxyz"],
            Commands(starts, ends, flown),
            arrays["linear_velocity_m_s"],
        )

    def score(self, report: Report) -> pd.DataFrame:
        """Add each game's likeness to real time, its error against the flight without latency, and its gaps."""
        games = report.games
        flown = games[games.role.isin(["game", "reference"])].sort_values([*CELL, "game"], kind="stable")
        scored = partial(score_cell, report.run, finished(games))
        cells = [cell for _, cell in finished(flown).groupby(CELL)]
        if len(games) >= PARALLEL_FROM_GAMES:
            from joblib import Parallel, cpu_count, delayed

            parallel = Parallel(n_jobs=min(cpu_count(), MOST_JOBS), batch_size=1)
            found = parallel(delayed(scored)(cell) for cell in sorted(cells, key=lambda cell: -cell.duration_s.sum()))
        else:
            found = [scored(cell) for cell in cells]
        return flown.join(pd.concat(found) if found else pd.DataFrame(columns=SCORES))

    def summary(self, report: Report) -> Summary:
        """Return a cell for each command, ClockSpeed, T_move, number of rounds and timing.

        Accuracies are medians over games of each game's mean over the references; a reference is not compared with
        itself. Durations and wall times are compared with the references' means. Intervals are 95 % bootstrap intervals
        over games. Numbers that cannot be known (no reference in the run, a lone reference) are None.
        """
        scores, seed = report.scores, report.config.seed
        cells = summary_cells(scores, seed)
        return {"suite": "dp1", "profile": report.config.profile, "seed": seed, "cells": cells}

    def title(self, report: Report) -> str:
        return f"DP1, {report.config.profile} profile, seed {report.config.seed}"

    def headline(self, report: Report) -> str:
        """Return each command's likeness to real time, error and speed-up; lockstep only where all is."""
        cells = cells_of(report)
        cells = cells if (cells.timing == "lockstep").all() else cells[cells.timing != "lockstep"]
        fast = cells[(cells.clock_speed > 1) & cells.stlc_median.notna()]
        if fast.empty:
            return f"{cells.games.sum()} games, none of them accelerated and comparable with real time"
        said = "; ".join(_likeness(own) for _, own in fast.groupby("command"))
        return f"{said} ({' and '.join(sorted(set(fast.provenance)))})"

    def overview(self, report: Report) -> Table:
        groups = cells_of(report).groupby(["command", "clock_speed", "timing", "provenance"])
        worst = groups.agg(
            games=("games", "sum"),
            disturbed_games=("disturbed_games", "sum"),
            stlc_median=("stlc_median", "min"),
            position_rmse_m=("position_rmse_m", "max"),
            position_rmse_vs_lockstep_m=("position_rmse_vs_lockstep_m", "max"),
            speedup=("effective_speedup", plots.span),
            mixed=("mixed", "first"),
            real_time_factor=("real_time_factor", plots.span),
        )
        return Table.of(
            worst.reset_index(),
            {
                "command": "{command!u}",
                "ClockSpeed": "{clock_speed:g}x",
                "games": "{games}{disturbed_games!d}",
                "lowest STLC median": "{stlc_median:.4f}",
                "largest RMSE v. reference, m": "{position_rmse_m!m}",
                "largest RMSE v. lockstep, m": "{position_rmse_vs_lockstep_m!m}",
                "effective speed-up": "{speedup}{mixed}",
                "real-time factor": "{real_time_factor}",
                "source": "{provenance}",
            },
        )

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
        yield Table.of(cells, ALL_CELLS, folded=f"{len(cells)} cells")


def fly_path(config: Dp1Config, case: Game, client: Client) -> float:
    """Fly the case's path, and return the seconds of wall time from the first issue to the last return."""
    command, t_sample_s = COMMANDS[case.command], config.t_sample_s or case.t_move_s
    t_th = t_th_ns(config, case.clock_speed, t_sample_s)
    command.begin(client)
    start_ns = client.now_ns()
    for velocity in velocities(case.path, case.rounds, config.speed_m_s):
        goal = VelocityGoal(velocity, config.height_m)
        for _ in command.fly(client, goal, case.t_move_s, t_sample_s, t_th):
            pass
    return (client.now_ns() - start_ns) / NS_PER_S


SCORES = ["stlc", "position_rmse_m", "position_rmse_vs_lockstep_m", "gap_s", "distinct_games"]


def score_cell(run: RunDirectory, games: pd.DataFrame, cell: pd.DataFrame) -> pd.DataFrame:
    """Return the SCORES of a cell's games, NaN where there is nothing to compare with; `gap_s` are lists."""
    from uavaccel.metrics.stlc import mean_stlc  # loads scipy

    def loaded(games: pd.DataFrame) -> list[dict[str, Any]]:
        return [run.load_arrays(game) for _, game in games.iterrows()]

    def flights(arrays: list[dict[str, Any]]) -> list[Trajectory]:
        return [trajectory(array["time_s"], array["position_m"]) for array in arrays]

    arrays, same, itself = loaded(cell), same_path(games, cell), bool((cell.role == "reference").all())
    own = flights(arrays)
    real = own if itself else flights(loaded(same[same.role == "reference"]))
    lockstep = same[same.role == "lockstep"].sort_values("command", key=lambda each: each != cell.command.iloc[0])
    ideal = flights(loaded(lockstep.head(1)))
    found = {
        "stlc": mean_stlc(own, real, itself) if real else np.nan,
        "position_rmse_m": mean_position_rmse(own, real, itself) if real else np.nan,
        "position_rmse_vs_lockstep_m": mean_position_rmse(own, ideal) if ideal else np.nan,
        "gap_s": [command_gaps_s(array["command_start_s"], array["command_end_s"]).tolist() for array in arrays],
        "distinct_games": len(distinct(own)[0]),
    }
    return pd.DataFrame(found, index=cell.index)


def same_path(games: pd.DataFrame, cell: pd.DataFrame) -> pd.DataFrame:
    """Return the games with the T_move and the number of rounds of a cell."""
    return games[(games[PATH] == cell[PATH].iloc[0]).all(axis=1)]


def cells_in(scores: pd.DataFrame) -> list[tuple[dict[str, Any], pd.DataFrame]]:
    """Return the key and the games of each cell, in canonical order."""
    return [(dict(zip(CELL, key, strict=True)), cell) for key, cell in scores.groupby(CELL)]


def summary_cells(scores: pd.DataFrame, seed: int) -> list[dict[str, Any]]:
    """Return the cells of the summary from the scored games."""
    real = finished(scores[scores.role == "reference"])
    return [key | summary_of_cell(key, cell, same_path(real, cell), seed) for key, cell in cells_in(scores)]


def summary_of_cell(key: dict[str, Any], cell: pd.DataFrame, real: pd.DataFrame, seed: int) -> dict[str, Any]:
    """Return the numbers of a cell from its scored games and those of ADSC in real time on the same path."""
    own, itself = finished(cell), bool((cell.role == "reference").all())
    provenance, compared, disturbed = timing_provenance(key["timing"]), len(own) and len(real), disturbed_games(own)
    reference = None
    if len(real):
        reference = real.iloc[0][["command", "timing", "clock_speed"]].to_dict() | {
            "provenance": timing_provenance(real.timing.iloc[0]),
            "games": len(real),
            "is_this_cell": itself,
        }
    gaps_s = pd.Series([gap for each in own.gap_s for gap in each], dtype=float)
    interval = list(speedup_interval(real.wall_s, own.wall_s, seed)) if compared and not itself else None
    mixed = combined_provenance(provenance, reference["provenance"]) if compared and reference else None
    return {
        "games": len(own),
        "failed_games": len(cell) - len(own),
        "distinct_games": int(own.distinct_games.iloc[0]) if len(own) else 0,
        "provenance": provenance,
        "seed": seed,
        "reference": reference,
        **({"disturbed_games": disturbed} if disturbed else {}),
        "stlc_median": _quantile(own.stlc, 0.5),
        "stlc_q25": _quantile(own.stlc, 0.25),
        "stlc_q75": _quantile(own.stlc, 0.75),
        "stlc_median_interval": _interval(own.stlc, seed),
        "position_rmse_m": _quantile(own.position_rmse_m, 0.5),
        "position_rmse_interval_m": _interval(own.position_rmse_m, seed),
        "position_rmse_vs_lockstep_m": _quantile(own.position_rmse_vs_lockstep_m, 0.5),
        "duration_error_s": float((own.duration_s - real.duration_s.mean()).median()) if compared else None,
        "command_gap_median_s": _quantile(gaps_s, 0.5),
        "command_gap_q95_s": _quantile(gaps_s, 0.95),
        "effective_speedup": float(real.wall_s.mean() / own.wall_s.mean()) if compared else None,
        "effective_speedup_interval": interval,  # the baseline over itself is 1 by definition
        "effective_speedup_provenance": mixed,
        "real_time_factor": float(own.real_time_factor.mean()) if len(own) else None,
        "lost_wall_s": float(own.lost_wall_s.sum()) if len(own) else None,
    }


def _known(values: pd.Series) -> bool:
    return len(values) > 0 and bool(values.notna().all())


def _quantile(values: pd.Series, share: float) -> float | None:
    return float(np.quantile(values.to_numpy(float), share)) if _known(values) else None


def _interval(values: pd.Series, seed: int) -> list[float] | None:
    return list(median_interval(values, seed)) if _known(values) else None


ALL_CELLS = {
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


def cells_of(report: Report) -> pd.DataFrame:
    """Return the summary's cells as a table; `mixed` marks a speed-up of a measured wall time over a modelled one."""
    cells = pd.DataFrame([{"disturbed_games": 0, **cell} for cell in report.summary["cells"]])
    return cells.assign(mixed=np.where(cells.effective_speedup_provenance == "mixed", " (mixed)", ""))


def _likeness(cells: pd.DataFrame) -> str:
    """Return up to which ClockSpeed a command flies as in real time, and its error and speed-up at the highest."""
    alike = cells.groupby("clock_speed").stlc_median.min() > SIMILAR_STLC
    up_to, highest = alike.index[alike.cummin()], alike.index[-1]
    flies = (
        f"flies as in real time up to {up_to[-1]:g}x"
        if len(up_to)
        else f"no longer flies as in real time at {alike.index[0]:g}x"
    )
    fastest = cells[cells.clock_speed == highest]
    error, speedup = fill("{m!m}", {"m": fastest.position_rmse_m.max()}), plots.span(fastest.effective_speedup)
    return (
        f"{fastest.command.iloc[0].upper()} {flies} (STLC above {SIMILAR_STLC:g}); at {highest:g}x it is up to {error} "
        f"m off (RMSE) and {speedup} times as fast"
    )


def velocity_figure(report: Report) -> Picture:
    """Draw Figure 2: two steps forward and one back, slowest ClockSpeed on top."""
    games = finished(report.games[report.games.role == "figure2"]).sort_values("clock_speed", kind="stable")
    flights = [(game, report.arrays(game)) for _, game in games.iterrows()]
    source = source_line(games)
    figure, grid = plots.panels(
        len(games), 1, "Two steps forward, one back", source, (6.4, 2.1), sharex=True, sharey=True
    )
    fastest = np.max([np.abs(flown["linear_velocity_m_s"]).max(axis=0) for _, flown in flights] or [[0.0] * 3], axis=0)
    for axes, (game, flown) in zip(grid[:, 0], flights, strict=False):
        starts, ends = flown["command_start_s"], flown["command_end_s"]
        gap_ms = float(np.mean(command_gaps_s(starts, ends))) * 1e3
        for end, start in zip(ends[:-1], starts[1:], strict=True):
            axes.axvspan(end, start, **NO_COMMAND)
        for end in ends:
            axes.axvline(end, **COMMAND_ENDS)
        for axis in [axis for axis in range(3) if fastest[axis] > VISIBLE_M_S] or [0]:
            velocity = flown["linear_velocity_m_s"][:, axis]
            axes.plot(flown["time_s"], velocity, label=("north", "east", "down")[axis], color=style.CYCLE[axis])
        axes.set(ylabel="velocity, m/s", title=f"{command_at_clock(game)}: {gap_ms:.1f} ms between commands")
    grid[-1, 0].set_xlabel("simulated time, s")
    if games.empty:
        style.note(grid[0, 0], "no flight recorded")
    else:
        style.key(figure, grid[0, 0], {"command ends": COMMAND_ENDS, "no command runs": NO_COMMAND})
    return report.figure("figure2_velocity", figure, FIGURE2, source)


def trajectory_figure(report: Report) -> Picture:
    """Draw Figure 3: best and worst replica by STLC of the fastest ADSC cell of the longest T_move, and one of TCSC."""
    flown = finished(report.scores)
    shown = _fastest_cell(flown)
    picked = _compared(flown, shown)
    if len(shown) and shown.command.iloc[0] == "adsc":
        same = same_path(flown, shown)
        picked += _compared(flown, _fastest_cell(same[same.command == "tcsc"]))[-1:]
    source = source_line(pd.DataFrame([game for game, _ in picked], columns=flown.columns))
    title = "Trajectories"
    if len(shown):
        title += f", {rounds_label(shown['rounds'].iloc[0])}, T_move {shown.t_move_s.iloc[0]:g} s"
    figure = style.new_figure(7.2, 6.0, title, source)
    axes: style.Axes3D = figure.add_subplot(projection="3d")
    lines = [(report.arrays(game)["position_m"], label) for game, label in picked]
    for (position_m, label), line in zip(lines, FLIGHTS, strict=False):
        north, east, down = position_m.T
        axes.plot(north, east, -down, **line, label=label, linewidth=1.2)
    style.space(axes, [position_m for position_m, _ in lines])
    return report.figure("figure3_trajectories", figure, FIGURE3, source)


def _fastest_cell(flown: pd.DataFrame) -> pd.DataFrame:
    """Return the fastest cell, ADSC before TCSC, of the longest T_move and about FIGURE3_ROUNDS rounds."""
    if flown.empty:
        return flown
    adsc, fast, far = flown.command == "adsc", flown.clock_speed > 1, (flown["rounds"] - FIGURE3_ROUNDS).abs()
    ranks = pd.DataFrame({"fast": fast, "adsc": adsc, "clock": flown.clock_speed, "t": flown.t_move_s, "near": -far})
    best = ranks.sort_values(list(ranks), ascending=False, kind="stable").index[0]
    return flown[(flown[CELL] == flown.loc[best, CELL]).all(axis=1)]


def _compared(flown: pd.DataFrame, cell: pd.DataFrame) -> list[tuple[pd.Series, str]]:
    """Return a reference of a cell, then its replicas of highest and lowest STLC, each with its label."""
    if cell.empty:
        return []
    real = same_path(flown, cell).query("role == 'reference'")
    picked = [(game, f"{command_at_clock(game)}: reference") for _, game in real.head(1).iterrows()]
    if (cell.role == "game").all():
        order = cell.iloc[np.argsort(-cell.stlc.fillna(0.0).to_numpy(), kind="stable")]
        named = {"best": order.iloc[0], "worst": order.iloc[-1]}
        if cell.distinct_games.iloc[0] == 1:
            named = {f"all {len(cell)} identical" if len(cell) > 1 else "one game": cell.iloc[0]}
        for rank, game in named.items():
            stlc = "unknown" if unknown(game.stlc) else f"{game.stlc:.3f}"
            picked.append((game, f"{command_at_clock(game)}, {rank}: STLC {stlc}"))
    return picked


def accuracy_figure(report: Report) -> Picture:
    """Draw Figure 5 from all games, T_moves pooled: a row of panels per command and a column per ClockSpeed."""
    games = finished(report.scores)
    known = games[games.stlc.notna()]
    commands, clocks, rounds = (sorted(games[name].unique()) for name in ("command", "clock_speed", "rounds"))
    source = source_line(games)
    title, size_in = "Accuracy of the trajectories: STLC", (1.9, 2.3)
    figure, grid = plots.panels(len(commands), len(clocks), title, source, size_in, sharex=True, sharey=True)
    for (row, command), (column, clock) in product(enumerate(commands), enumerate(clocks)):
        cell = known[(known.command == command) & (known.clock_speed == clock)]
        stlc = {n: cell[cell["rounds"] == n].stlc.tolist() for n in rounds}
        grid[row, column].axhline(SIMILAR_STLC, color="#C00000", linewidth=1.0, zorder=1)
        plots.boxes(grid[row, column], stlc, style.COMMAND_COLOUR.get(command, style.GREEN), NO_GAMES)
        grid[0, column].set_title(clock_label(clock), loc="center")
        grid[row, 0].set(ylabel=f"{command.upper()}\nSTLC", ylim=(min(1.7, known.stlc.min() - 0.05), 2.04))
        grid[-1, column].set_xlabel("rounds")
    if games.empty:
        style.note(grid[0, 0], NO_GAMES)
    return report.figure("figure5_accuracy", figure, FIGURE5, source)


def speedup_figure(report: Report) -> Picture:
    """Draw Figure 6 from the cells with the most rounds: a panel per command, a line per T_move, the ideal dashed."""
    cells, scores = pd.DataFrame(report.summary["cells"]), finished(report.scores)
    rounds = int(cells["rounds"].max())
    source = source_line(scores[scores["rounds"] == rounds])
    known = cells[(cells["rounds"] == rounds) & cells.effective_speedup.notna()]
    commands, t_moves, clocks = (sorted(known[name].unique()) for name in ("command", "t_move_s", "clock_speed"))
    title = f"Effective speed-up over ADSC at 1x, {rounds_label(rounds)}"
    figure, grid = plots.panels(1, len(commands), title, source, (3.6, 3.0), sharex=True, sharey=True)
    for axes, command in zip(grid[0], commands, strict=False):
        axes.plot(clocks, color=style.BLACK, linestyle="--", linewidth=1.1, label="ideal")
        for number, t_move_s in enumerate(t_moves):
            own = known[(known.command == command) & (known.t_move_s == t_move_s)].sort_values("clock_speed")
            places = np.searchsorted(clocks, own.clock_speed)
            line = style.series(number) | {"label": f"T_move {t_move_s:g} s"}
            plots.points(axes, places, own.effective_speedup.tolist(), own.effective_speedup_interval.tolist(), **line)
        axes.set_title(command.upper())
        plots.clock_axis(axes, clocks)
    if known.empty:
        style.note(grid[0, 0], "no speed-up without ADSC games at 1x")
    else:
        plots.factor_axis(grid[0, 0])
        grid[0, 0].set_ylabel("effective speed-up")
        grid[0, 0].legend(loc="upper left")
    return report.figure("figure6_speedup", figure, FIGURE6.format(rounds_label(rounds)), source)


COMMAND_ENDS: style.LineStyle = {"color": style.BLACK, "linestyle": (0, (4, 3)), "linewidth": 0.9}
NO_COMMAND: style.LineStyle = {"color": "#D0D0D0", "linewidth": 0}
VISIBLE_M_S = 0.05  # a component that never gets faster is left out
FLIGHTS: tuple[style.LineStyle, ...] = (
    {"color": style.BLUE},
    {"color": style.GREEN},
    {"color": style.VERMILION},
    {"color": style.BLACK, "linestyle": (0, (2, 4))},  # where TCSC flies as the reference does, both are seen
)
NO_GAMES = "no games to compare"
FIGURE2 = (
    "Figure 2. Velocity over simulated time, two steps forward and one back, in real time and at the run's highest "
    "ClockSpeed. Dashed: a command ends. Grey: no command runs, the drone flies on while the client reacts."
)
FIGURE3 = (
    "Figure 3. A real-time trajectory, and the best and the worst replica of the fastest cell by STLC, and the "
    "least accurate of TCSC's fastest cell, dotted. Height is up, −z of the NED frame."
)
FIGURE5 = (
    "Figure 5. STLC against the real-time ADSC games; one value a game, its mean over the references, T_moves "
    "pooled; line: 1.8. Replicas whose flights are identical make a box of zero width, drawn as it is."
)
FIGURE6 = (
    "Figure 6. Effective speed-up of games of {}: mean wall time of ADSC at 1x over the cell's, with 95 % bootstrap "
    "intervals over games. Dashed: the ideal."
)
READING = (
    "STLC (lambda 0.5, metres, seconds) is 2 for identical flights; above 1.8 they look alike. It matches "
    "places and times independently and cannot see a lap too few or too late, so the position error at equal "
    "times (RMSE, m) stands beside it. A game's accuracy is its mean over all reference games, ADSC at 1x of "
    "the same T_move and rounds; a reference is not compared with itself. Medians, quartiles and 95 % "
    "bootstrap intervals are over games. Effective speed-up is the ratio of mean wall times for the same "
    "commands. Measured: the machine's clock. Modelled: a simulated clock. Mixed: a measured game over a "
    "modelled baseline. The real-time factor is the simulated time of a game over its wall time: it stays at the "
    "ClockSpeed as long as the simulation keeps up, since with ADSC the drone flies on while the client reacts, and "
    "that time counts too. The effective speed-up compares wall times for the same commands: at T_move 0.1 s and a "
    "ClockSpeed of 50 a command lasts 2 ms of wall time, to which its messages add what no ClockSpeed shortens. The "
    "shorter the T_move, the further the speed-up falls short of the real-time factor. Native TCSC games of one cell "
    "are identical by construction, and ADSC games at 1x nearly so."
)
