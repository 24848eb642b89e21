"""The numbers that decide claims, out of the runs of the paper's experiments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from uavaccel.metrics.equivalence import Estimate, Interval, mean_estimate, ratio_estimate, success_estimate
from uavaccel.metrics.intervals import Proportion, bootstrap_interval
from uavaccel.records import RunDirectory
from uavaccel.suites.report import SummaryCell

FloatArray = NDArray[np.float64]
Trained = tuple[str, float]
"""Command and ClockSpeed of a training."""

LEAST_FLIGHTS = 6  # of a cell of DP1: the range of five holds their median with less than 95 %
LEAST_IMAGES = 100  # none of so many above a limit: fewer than 3 % of all are, with 95 %
LEAST_GAMES = 100  # of a training, and of its evaluation: as many as the paper's
SIMULATION = ("simulation", "rendering")  # the paper's "simulation": its images come out of it
THINKING = ("image_processing", "inference", "learning")


class NoEvidence(Exception):
    """The runs leave out the games that would decide a claim, or know nothing to compare them with."""


class Undecided(Exception):
    """The runs have the games, but those cannot decide the claim; the text says why."""


@dataclass(frozen=True)
class Finding:
    """What a run says of a claim: its number with its interval in words, and whether the claim holds in it.

    None: its interval leaves that open.
    """

    value: str
    holds: bool | None


@dataclass(frozen=True)
class Trajectories:
    """A run of DP1: its cells, and the STLC of each of their games.

    What it lacks raises NoEvidence; a cell of fewer than LEAST_FLIGHTS games raises Undecided.
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
        """The paths' rounds, the shortest first."""
        rounds = sorted({int(cell["rounds"]) for cell in self.cells})
        if not rounds:
            raise NoEvidence("nothing was flown")
        return rounds

    def stlc_by_cell(self, command: str, clock_speed: float, rounds: int | None = None) -> list[FloatArray]:
        """STLC of each cell's games (games,), of all rounds unless some are asked for."""
        cells = [np.asarray(cell["stlc"], float) for cell in _flown(self.games, command, clock_speed, rounds)]
        for stlc in cells:
            _enough(len(stlc), LEAST_FLIGHTS, f"games of {command} at {clock_speed:g}x in a cell")
        _known(np.concatenate(cells), "STLC")
        return cells

    def stlc(self, command: str, clock_speed: float, rounds: int | None = None) -> FloatArray:
        """STLC of the games, T_moves pooled, and rounds too unless one is asked for."""
        return np.concatenate(self.stlc_by_cell(command, clock_speed, rounds))

    def bootstrap(self, cells: Sequence[FloatArray], statistic: Callable[..., FloatArray]) -> Interval:
        """95 % interval of `statistic(*cells)`, each cell's games resampled among themselves: a resample keeps the
        T_moves and rounds in their shares.
        """
        return bootstrap_interval(cells, statistic, self.seed)

    def median(self, command: str, clock_speed: float) -> Estimate:
        """Pooled median STLC, as in the paper's Figure 5."""
        cells = self.stlc_by_cell(command, clock_speed)
        return Estimate(float(pooled_median(*cells)), *self.bootstrap(cells, pooled_median))

    def longest(self, command: str, clock_speed: float, t_move_s: float) -> Estimate:
        """Effective speed-up on the longest path."""
        for cell in _flown(self.cells, command, clock_speed, self.rounds[-1]):
            if cell["t_move_s"] == t_move_s and cell["effective_speedup_interval"] is not None:
                _enough(cell["games"], LEAST_FLIGHTS, f"games of {command} at {clock_speed:g}x in a cell")
                return Estimate(cell["effective_speedup"], *cell["effective_speedup_interval"])
        raise NoEvidence(f"no {command} at {clock_speed:g}x, T_move {t_move_s:g} s, with a speed-up")

    def speedups(self, command: str, clock_speed: float) -> list[Estimate]:
        """Effective speed-ups on the longest path, by T_move."""
        flown = _flown(self.cells, command, clock_speed, self.rounds[-1])
        return [self.longest(command, clock_speed, t) for t in sorted(cell["t_move_s"] for cell in flown)]

    def gap_s(self, command: str, clock_speed: float) -> float:
        """Median over cells of the median simulated time from a command's end to the next one's start."""
        flown = _flown(self.cells, command, clock_speed, None)
        for cell in flown:
            _enough(cell["games"], LEAST_FLIGHTS, f"games of {command} at {clock_speed:g}x in a cell")
        gaps = np.array([cell["command_gap_median_s"] for cell in flown], float)
        return float(np.median(_known(gaps, "the gap between commands")))


def pooled_median(*cells: FloatArray) -> FloatArray:
    """Median over the last axes of all cells together."""
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
    """TCSC's images at a ClockSpeed against those at 1x, a value an image (n,): the points of Figure 7."""

    position_error_m: FloatArray
    dvs_ed_percent: FloatArray


@dataclass(frozen=True)
class Images:
    """A run of DP2: TCSC's images by ClockSpeed, and its study of the guard, None where it has none."""

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
        """Raises NoEvidence where it was not flown or not at 1x, Undecided below LEAST_IMAGES images."""
        cloud = self.clouds.get(clock_speed)
        if cloud is None or not cloud.dvs_ed_percent.size:
            raise NoEvidence(f"no images at {clock_speed:g}x, compared with 1x")
        _enough(len(cloud.dvs_ed_percent), LEAST_IMAGES, f"images at {clock_speed:g}x")
        return cloud

    def handed_on_perturbed(self) -> tuple[Proportion, Proportion]:
        """Perturbed ones of the images handed on, without the guard and with it."""
        if self.guard is None:
            raise NoEvidence("the guard was not studied: no game without latency was flown")
        images = self.guard["images"] * self.guard["streams"]
        shares = self.guard["perturbed_share_handed_on"]
        without, guarded = (Proportion(round(shares[guard] * images), images) for guard in ("off", "on"))
        _enough(without.successes, LEAST_IMAGES, "perturbed images")
        return without, guarded


@dataclass(frozen=True)
class Policies:
    """A run of the suite `rl`: a cell for each training of a profile.

    What it lacks raises NoEvidence; trainings and evaluations of fewer than LEAST_GAMES games raise Undecided.
    """

    cells: Sequence[SummaryCell]
    interchange: Sequence[SummaryCell] = ()
    """Those that TCSC trained at 1x, flown with both commands, seeds pooled."""
    ended_m: Mapping[Trained, FloatArray] = field(default_factory=dict)
    """Metres north at which evaluation games ended before the goal, seeds pooled."""

    @classmethod
    def of(cls, run: RunDirectory, profile: str) -> Policies:
        """Of the profile's trainings on the virtual clock, those without a variant."""
        summary = run.read_json("summary.json")
        wanted = (profile, "virtual", "")
        cells, interchange = (
            [cell for cell in summary[part] if _kind(cell) == wanted] for part in ("cells", "interchange")
        )
        by_tcsc = [cell for cell in interchange if (cell["command"], cell["clock_speed"]) == ("tcsc", 1.0)]
        return cls(cells, by_tcsc, _ended(run, wanted))

    def trainings(self, command: str, clock_speed: float) -> list[Proportion]:
        """Evaluation games won, a proportion a training."""
        trained = [Proportion.of(cell) for cell in _flown(self.cells, command, clock_speed)]
        games = sum(each.games for each in trained)
        _enough(games, LEAST_GAMES, f"games of {command.upper()} at {clock_speed:g}x")
        return trained

    def success(self, command: str, clock_speed: float) -> Estimate:
        """Success of the policies trained so, over trainings where there are several."""
        return success_estimate(self.trainings(command, clock_speed))

    def command_s(self, command: str, clock_speed: float, phases: Sequence[str]) -> Estimate:
        """Modelled wall seconds of a command's share of some phases, over trainings."""
        cells = _flown(self.cells, command, clock_speed)
        trained = sum(cell["trained_games"] for cell in cells)
        _enough(trained, LEAST_GAMES, f"training games of {command.upper()} at {clock_speed:g}x")
        return mean_estimate(
            [sum(cell["phase_s"][phase] for phase in phases) / cell["commands"] for cell in cells]
        )

    def speedup(self, clock_speed: float, phases: Sequence[str] = SIMULATION) -> Estimate:
        """TCSC's over ADSC in real time, the paper's baseline (section III-C3), of a command's mean."""
        accelerated = self.command_s("tcsc", clock_speed, phases)
        return ratio_estimate(self.command_s("adsc", 1.0, phases), accelerated)

    def clocks(self, command: str) -> list[float]:
        """ClockSpeeds at which the command was trained; none where it was not."""
        return sorted({cell["clock_speed"] for cell in self.cells if cell["command"] == command})

    def interchanged(self) -> tuple[Proportion, Proportion]:
        """Games won by the policies that TCSC trained at 1x, flown with TCSC and with ADSC."""
        if not self.interchange:
            raise NoEvidence("no policy was flown with both commands")
        with_tcsc, with_adsc = (Proportion.of(flown) for flown in self.interchange[0]["flown_with"])
        _enough(with_tcsc.games, LEAST_GAMES, "games with either command")
        return with_tcsc, with_adsc


def _kind(cell: SummaryCell) -> tuple[str, str, str]:
    return cell["profile"], cell["timing"], cell["variant"]


def _ended(run: RunDirectory, wanted: tuple[str, str, str]) -> dict[Trained, FloatArray]:
    ended: dict[Trained, list[FloatArray]] = {}
    for row in run.rows():
        if _kind(row) == wanted and "training" in row:  # the others fly the same lanes in the exact simulator
            arrays, command = run.load_arrays(row), row["command"]
            lost = ~arrays[f"{command}_is_success"]
            ended.setdefault((command, row["clock_speed"]), []).append(arrays[f"{command}_distance_m"][lost])
    return {trained: np.concatenate(distances) for trained, distances in ended.items()}
