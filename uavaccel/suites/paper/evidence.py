"""The numbers that decide claims, out of the runs of the paper's experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaccel.metrics.intervals import Proportion, median_interval
from uavaccel.records import RunDirectory
from uavaccel.suites.report import SummaryCell

FloatArray = NDArray[np.float64]


class NoEvidence(Exception):
    """The runs leave out the games that would decide a claim, or know nothing to compare them with."""


@dataclass(frozen=True)
class Finding:
    """What a run says of a claim: its number with its interval in words, and whether the claim holds in it."""

    value: str
    holds: bool


@dataclass(frozen=True)
class Trajectories:
    """A run of DP1: its cells, and the STLC of each of their games. What it lacks raises NoEvidence."""

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

    def stlc(self, command: str, clock_speed: float, rounds: int | None = None) -> FloatArray:
        """STLC of the games, T_moves pooled, and rounds too unless one is asked for."""
        chosen = _flown(self.games, command, clock_speed, rounds)
        return _known(np.concatenate([np.asarray(cell["stlc"], float) for cell in chosen]), "STLC")

    def median(self, command: str, clock_speed: float) -> float:
        """Pooled median STLC, as in the paper's Figure 5."""
        return float(np.median(self.stlc(command, clock_speed)))

    def interval(self, command: str, clock_speed: float) -> str:
        """The median with its 95 % bootstrap interval over games."""
        low, high = median_interval(self.stlc(command, clock_speed), self.seed)
        return f"{self.median(command, clock_speed):.3f} [{low:.3f}, {high:.3f}]"

    @property
    def most_rounds(self) -> int:
        """The longest path's rounds."""
        return max(int(cell["rounds"]) for cell in self.cells)

    def longest(self, command: str, clock_speed: float, t_move_s: float) -> SummaryCell:
        """The cell of the longest path, whose speed-up is known."""
        for cell in _flown(self.cells, command, clock_speed, self.most_rounds):
            if cell["t_move_s"] == t_move_s and cell["effective_speedup_interval"] is not None:
                return cell
        raise NoEvidence(f"no {command} at {clock_speed:g}x, T_move {t_move_s:g} s, with a speed-up")

    def column(self, key: str, command: str, clock_speed: float, rounds: int | None = None) -> FloatArray:
        """A key of the cells of a command and ClockSpeed, by T_move."""
        chosen = _flown(self.cells, command, clock_speed, rounds)
        in_order = sorted(chosen, key=lambda cell: float(cell["t_move_s"]))
        return _known(np.array([cell[key] for cell in in_order], float), key)


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


@dataclass(frozen=True)
class Images:
    """A run of DP2: its cells of TCSC by ClockSpeed."""

    cells: Mapping[float, SummaryCell]

    @classmethod
    def of(cls, run: RunDirectory) -> Images:
        cells = run.read_json("summary.json")["cells"]
        return cls({cell["clock_speed"]: cell for cell in cells if cell["command"] == "tcsc"})

    def cell(self, clock_speed: float) -> SummaryCell:
        """Raises NoEvidence where it was not flown, or has no run at 1x to compare with."""
        cell = self.cells.get(clock_speed)
        if cell is None or cell["position_error_m_max"] is None:
            raise NoEvidence(f"no images at {clock_speed:g}x, compared with 1x")
        return cell


@dataclass(frozen=True)
class Policies:
    """A run of the suite `rl`: evaluation games won by command and ClockSpeed of the training, seeds pooled.

    What it lacks raises NoEvidence.
    """

    cells: Sequence[SummaryCell]
    interchange: Sequence[SummaryCell] = ()
    """Policies flown with both commands, seeds pooled."""

    @classmethod
    def of(cls, run: RunDirectory, profile: str) -> Policies:
        """Of the profile's trainings on the virtual clock, those without a variant."""
        summary = run.read_json("summary.json")
        wanted = (profile, "virtual", "")
        return cls(
            *([cell for cell in summary[part] if _kind(cell) == wanted] for part in ("cells", "interchange"))
        )

    def success(self, command: str, clock_speed: float) -> Proportion:
        """Games won, seeds pooled."""
        chosen = _flown(self.cells, command, clock_speed)
        return Proportion(sum(cell["successes"] for cell in chosen), sum(cell["games"] for cell in chosen))

    def speedup(self, clock_speed: float, key: str = "training_speedup") -> float:
        """Mean speed-up of TCSC's trainings on their modelled clock, of simulation alone."""
        values = np.array([cell[key] for cell in _flown(self.cells, "tcsc", clock_speed)], float)
        return float(np.mean(_known(values, key)))

    def clocks(self, command: str) -> list[float]:
        """ClockSpeeds at which the command was trained; none where it was not."""
        return sorted({cell["clock_speed"] for cell in self.cells if cell["command"] == command})

    def interchanged(self) -> SummaryCell:
        """The policy that was flown with both commands."""
        if not self.interchange:
            raise NoEvidence("no policy was flown with both commands")
        return self.interchange[0]


def _kind(cell: SummaryCell) -> tuple[str, str, str]:
    return cell["profile"], cell["timing"], cell["variant"]
