"""The evidence for claims: numbers with their intervals, from runs of the paper's experiments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from uavaccel.metrics.equivalence import Estimate, Interval, mean_estimate, ratio_estimate, success_estimate
from uavaccel.metrics.intervals import Proportion, bootstrap_interval
from uavaccel.records import RunDirectory
from uavaccel.suites.old_report import SummaryCell
from uavaccel.suites.rows import Row, grouped

FloatArray = NDArray[np.float64]
Trained = tuple[str, float]
"""The command and ClockSpeed of a training."""

LEAST_FLIGHTS = 6  # in a cell of DP1: the range of five contains the median with less than 95 %
LEAST_IMAGES = 100  # if none of so many exceeds a limit, fewer than 3 % of all do, with 95 %
LEAST_GAMES = 100  # of a training, and of its evaluation, as in the paper
SIMULATION = ("simulation", "rendering")  # the paper's "simulation" renders the images
BESIDE_SIMULATION = ("image_processing", "inference", "learning")


class NoEvidence(Exception):
    """The runs lack the games that would decide a claim, or those to compare them with."""


class Undecided(Exception):
    """The runs have the games, but these cannot decide the claim, for the reason given."""


@dataclass(frozen=True)
class Finding:
    """What a run tells of a claim: the deciding number in words, and whether the claim holds.

    `holds` is None where the interval leaves that open.
    """

    value: str
    holds: bool | None


@dataclass(frozen=True)
class Trajectories:
    """Evidence from a run of DP1: its cells, and the STLC of each of their games.

    Methods raise NoEvidence for what the run lacks, and Undecided for a cell of fewer than LEAST_FLIGHTS games.
    """

    cells: Sequence[SummaryCell]
    games: Sequence[SummaryCell]
    seed: int

    @classmethod
    def of(cls, run: RunDirectory) -> Trajectories:
        summary = run.read_json("summary.json")
        return cls(summary["cells"], run.read_json("scores.json"), summary["seed"])

    @property
    def clocks(self) -> list[float]:
        """The ClockSpeeds above 1."""
        clocks = sorted({cell["clock_speed"] for cell in self.cells if cell["clock_speed"] > 1})
        if not clocks:
            raise NoEvidence("no ClockSpeed above 1 was flown")
        return clocks

    @property
    def rounds(self) -> list[int]:
        """The paths' numbers of rounds, the smallest first."""
        rounds = sorted({int(cell["rounds"]) for cell in self.cells})
        if not rounds:
            raise NoEvidence("nothing was flown")
        return rounds

    def stlc_by_cell(self, command: str, clock_speed: float, rounds: int | None = None) -> list[FloatArray]:
        """Return the STLC (games,) of each cell, of all numbers of rounds unless one is given."""
        cells = [np.asarray(cell["stlc"], float) for cell in _flown(self.games, command, clock_speed, rounds)]
        for stlc in cells:
            _enough(len(stlc), LEAST_FLIGHTS, f"games of {command} at {clock_speed:g}x in a cell")
        _known(np.concatenate(cells), "STLC")
        return cells

    def stlc(self, command: str, clock_speed: float, rounds: int | None = None) -> FloatArray:
        """Return the STLC of all games, T_moves pooled, and rounds too unless one number of them is given."""
        return np.concatenate(self.stlc_by_cell(command, clock_speed, rounds))

    def bootstrap(self, cells: Sequence[FloatArray], statistic: Callable[..., FloatArray]) -> Interval:
        """Return the 95 % bootstrap interval of `statistic(*cells)`.

        Games are resampled within their cell, so that each resample has the same share of T_moves and rounds.
        """
        return bootstrap_interval(cells, statistic, self.seed)

    def median(self, command: str, clock_speed: float) -> Estimate:
        """Return the pooled median of the STLC, as in the paper's Figure 5."""
        cells = self.stlc_by_cell(command, clock_speed)
        return Estimate(float(pooled_median(*cells)), *self.bootstrap(cells, pooled_median))

    def longest(self, command: str, clock_speed: float, t_move_s: float) -> Estimate:
        """Return the effective speed-up on the longest path with a T_move."""
        for cell in _flown(self.cells, command, clock_speed, self.rounds[-1]):
            if cell["t_move_s"] == t_move_s and cell["effective_speedup_interval"] is not None:
                _enough(cell["games"], LEAST_FLIGHTS, f"games of {command} at {clock_speed:g}x in a cell")
                return Estimate(cell["effective_speedup"], *cell["effective_speedup_interval"])
        raise NoEvidence(f"no {command} at {clock_speed:g}x, T_move {t_move_s:g} s, with a speed-up")

    def speedups(self, command: str, clock_speed: float) -> list[Estimate]:
        """Return the effective speed-ups on the longest path, by T_move."""
        flown = _flown(self.cells, command, clock_speed, self.rounds[-1])
        return [self.longest(command, clock_speed, t) for t in sorted(cell["t_move_s"] for cell in flown)]

    def gap_s(self, command: str, clock_speed: float) -> float:
        """Return the median over cells of the median simulated time between two commands."""
        flown = _flown(self.cells, command, clock_speed, None)
        for cell in flown:
            _enough(cell["games"], LEAST_FLIGHTS, f"games of {command} at {clock_speed:g}x in a cell")
        gaps = np.array([cell["command_gap_median_s"] for cell in flown], float)
        return float(np.median(_known(gaps, "the gap between commands")))


def pooled_median(*cells: FloatArray) -> FloatArray:
    """Return the median over the last axis of all cells together."""
    return np.asarray(np.median(np.concatenate(cells, axis=-1), axis=-1))


def _flown(
    cells: Sequence[SummaryCell], command: str, clock_speed: float, rounds: int | None = None
) -> list[SummaryCell]:
    chosen = [cell for cell in cells if (cell["command"], cell["clock_speed"]) == (command, clock_speed)]
    if rounds is not None:
        chosen = [cell for cell in chosen if cell["rounds"] == rounds]
    if not chosen:
        raise NoEvidence(f"{command} at {clock_speed:g}x was not flown")
    return chosen


def _known(values: FloatArray, name: str) -> FloatArray:
    if not values.size or np.isnan(values).any():
        raise NoEvidence(f"{name} is not known: there is nothing to compare with")
    return values


def _enough(count: int, least: int, what: str) -> None:
    if count < least:
        raise Undecided(f"{count} {what}, at least {least} are needed")


@dataclass(frozen=True)
class Cloud:
    """Errors (n,) of TCSC's images at a ClockSpeed, compared with those at 1x: the points of Figure 7."""

    position_error_m: FloatArray
    dvs_ed_percent: FloatArray


@dataclass(frozen=True)
class Images:
    """Evidence from a run of DP2: TCSC's images by ClockSpeed, and the study of the guard, if it has one."""

    clouds: Mapping[float, Cloud]
    guard: SummaryCell | None = None

    @classmethod
    def of(cls, run: RunDirectory) -> Images:
        clouds = {
            cell["clock_speed"]: Cloud(
                np.asarray(cell["position_error_m"], float), np.asarray(cell["dvs_ed_percent"], float)
            )
            for cell in run.read_json("scores.json")
            if cell["command"] == "tcsc"
        }
        return cls(clouds, run.read_json("summary.json")["guard_study"])

    def cloud(self, clock_speed: float) -> Cloud:
        """Return the images at a ClockSpeed.

        Raises NoEvidence without games there or at 1x, Undecided for fewer than LEAST_IMAGES images.
        """
        cloud = self.clouds.get(clock_speed)
        if cloud is None or not cloud.dvs_ed_percent.size:
            raise NoEvidence(f"no images at {clock_speed:g}x, compared with 1x")
        _enough(len(cloud.dvs_ed_percent), LEAST_IMAGES, f"images at {clock_speed:g}x")
        return cloud

    def handed_on_perturbed(self) -> tuple[Proportion, Proportion]:
        """Return the perturbed share of the accepted images, without the guard and with it."""
        if self.guard is None:
            raise NoEvidence("the guard was not studied: no game without latency was flown")
        images = self.guard["images"] * self.guard["streams"]
        shares = self.guard["perturbed_share_handed_on"]
        without, guarded = (Proportion(round(shares[guard] * images), images) for guard in ("off", "on"))
        _enough(without.successes, LEAST_IMAGES, "perturbed images")
        return without, guarded


@dataclass(frozen=True)
class Policies:
    """Evidence from a run of the suite `rl`: a cell for each training of a profile.

    Methods raise NoEvidence for what the run lacks, and Undecided for fewer than LEAST_GAMES games of a training or of
    its evaluation.
    """

    cells: Sequence[SummaryCell]
    interchange: Sequence[SummaryCell] = ()
    """Policies trained with TCSC at 1x and flown with both commands, seeds pooled."""
    ended_m: Mapping[Trained, FloatArray] = field(default_factory=dict)
    """Distances north at which evaluation games ended before the goal, seeds pooled."""

    @classmethod
    def of(cls, run: RunDirectory, profile: str) -> Policies:
        """Read the evidence of a profile's trainings on the virtual clock that have no variant."""
        summary = run.read_json("summary.json")
        wanted = (profile, "virtual", "")
        cells, interchange = (
            [cell for cell in summary[part] if _kind(cell) == wanted] for part in ("cells", "interchange")
        )
        by_tcsc = [cell for cell in interchange if (cell["command"], cell["clock_speed"]) == ("tcsc", 1.0)]
        return cls(cells, by_tcsc, _ended(run, wanted))

    def trainings(self, command: str, clock_speed: float) -> list[Proportion]:
        """Return the evaluation games won by each training."""
        trained = [Proportion.of(cell) for cell in _flown(self.cells, command, clock_speed)]
        games = sum(each.games for each in trained)
        _enough(games, LEAST_GAMES, f"games of {command.upper()} at {clock_speed:g}x")
        return trained

    def success(self, command: str, clock_speed: float) -> Estimate:
        """Return the success of the policies of these trainings."""
        return success_estimate(self.trainings(command, clock_speed))

    def command_s(self, command: str, clock_speed: float, phases: Sequence[str]) -> Estimate:
        """Return the modelled wall seconds that some phases take per command, over trainings."""
        cells = _flown(self.cells, command, clock_speed)
        trained = sum(cell["trained_games"] for cell in cells)
        _enough(trained, LEAST_GAMES, f"training games of {command.upper()} at {clock_speed:g}x")
        return mean_estimate(
            [sum(cell["phase_s"][phase] for phase in phases) / cell["commands"] for cell in cells]
        )

    def speedup(self, clock_speed: float, phases: Sequence[str] = SIMULATION) -> Estimate:
        """Return the speed-up of TCSC over ADSC in real time, the paper's baseline (section III-C3), per command."""
        accelerated = self.command_s("tcsc", clock_speed, phases)
        return ratio_estimate(self.command_s("adsc", 1.0, phases), accelerated)

    def clocks(self, command: str) -> list[float]:
        """Return the ClockSpeeds at which a command was trained."""
        return sorted({cell["clock_speed"] for cell in self.cells if cell["command"] == command})

    def interchanged(self) -> tuple[Proportion, Proportion]:
        """Return the games won with TCSC and with ADSC by the policies trained with TCSC at 1x."""
        if not self.interchange:
            raise NoEvidence("no policy was flown with both commands")
        with_tcsc, with_adsc = (Proportion.of(flown) for flown in self.interchange[0]["flown_with"])
        _enough(with_tcsc.games, LEAST_GAMES, "games with either command")
        return with_tcsc, with_adsc


def _kind(cell: SummaryCell) -> tuple[str, str, str]:
    return cell["profile"], cell["timing"], cell["variant"]


def _ended(run: RunDirectory, wanted: tuple[str, str, str]) -> dict[Trained, FloatArray]:
    def ended_m(row: Row) -> FloatArray:
        arrays, command = run.load_arrays(row), row["command"]
        return np.asarray(arrays[f"{command}_distance_m"][~arrays[f"{command}_is_success"]])

    # the other rows fly the same lanes in the exact simulator
    trained = [row for row in run.rows() if _kind(row) == wanted and "training" in row]
    by_training = grouped(trained, itemgetter("command", "clock_speed"))
    return {key: np.concatenate([ended_m(row) for row in rows]) for key, rows in by_training.items()}
