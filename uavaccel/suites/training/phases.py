"""The time of a training by phase, and its speed (the paper's Figure 9, section IV-D)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.draw.style import clock_label, command_name
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.host_time import over_all_starts, wall_s
from uavaccel.suites.old_report import listed
from uavaccel.suites.provenance import disturbed_words

CLOCKS = {True: "modelled", False: "measured, learning beside the flight"}  # by whether they are simulated
UNITS_S = {"hours": 3600.0, "minutes": 60.0, "seconds": 1.0}
LETTER_IN = 0.085  # width of a letter of a label


@dataclass(frozen=True)
class PhaseTimes:
    """The seconds of a training by phase, summed over its lanes, and its overall speed."""

    label: str
    phase_s: Mapping[str, float]
    simulated_s_per_wall_s: float


def plot_trainings(runs: Sequence[RunDirectory], path: Path) -> Picture:
    """Plot Figure 9 with a bar for each training."""
    source = _source(runs)
    figure = plot_phases(uniquely_labelled(runs), source)
    return style.picture(figure, path, "Figure 9. Time of the training by phase.", source)


def _source(runs: Sequence[RunDirectory]) -> str:
    games = listed(sorted({len(run.rows()) for run in runs}))
    seeds = listed(sorted({run.config()["seed"] for run in runs}))
    modelled = {run.config()["task"]["timing"] == "virtual" for run in runs}
    clocks = " and ".join(sorted(CLOCKS[each] for each in modelled))
    disturbed = disturbed_words([row for run in runs for row in run.rows()])
    return " · ".join([clocks, f"{games} games", f"seed {seeds}", *disturbed])


def uniquely_labelled(runs: Sequence[RunDirectory]) -> list[PhaseTimes]:
    """Return the times of the trainings; equal labels are followed by the run's folder."""
    trainings = [phase_times(run) for run in runs]
    named = Counter(training.label for training in trainings)
    return [
        replace(training, label=f"{training.label}\n{run.path}") if named[training.label] > 1 else training
        for training, run in zip(trainings, runs, strict=True)
    ]


def phase_times(run: RunDirectory) -> PhaseTimes:
    """Return the times of a training, on its simulated clock if it has one, else on the machine's."""
    config, rows = run.config(), run.rows()
    task = config["task"]
    flown_by = f"{command_name(task['command'])} {clock_label(task['clock_speed'])}"
    label = f"{flown_by}\n{task['timing']}, seed {config['seed']}"
    sim_time_s = sum(row["sim_time_s"] for row in rows)
    if task["timing"] == "virtual":
        phase_s = {phase: sum(row["phase_s"][phase] for row in rows) for phase in PHASES}
        return PhaseTimes(label, phase_s, sim_time_s / (sum(phase_s.values()) / config["environments"]))
    timings = run.timings()
    if not wall_s(run) or any(not {"learner_s", "host_phase_s"} <= entry.keys() for entry in timings):
        raise UserError(f"{run.path / 'timing.jsonl'}: has not the times of every game of a training")
    flown, learned = Counter[str](), over_all_starts([entry["learner_s"] for entry in timings])
    for entry in timings:
        flown.update(entry["host_phase_s"])
    return PhaseTimes(
        label, {phase: flown[phase] + learned[phase] for phase in PHASES}, sim_time_s / wall_s(run)
    )


def plot_phases(trainings: Sequence[PhaseTimes], source: str) -> Figure:
    """Plot a bar of stacked phases per training, and the speeds as points on an axis of their own."""
    with style.project_style():
        longest = max(len(line) for training in trainings for line in training.label.splitlines())
        bar_in = max(1.5, LETTER_IN * longest)  # labels are not to run into each other
        figure = style.new_figure(3.2 + bar_in * len(trainings), 4.2, "Time of training by phase", source)
        axes = figure.subplots()
        phase_s = [training.phase_s for training in trainings]
        unit = unit_of(phase_s)
        places = plot_stacked(axes, phase_s, unit)
        axes.set_xticks(places, [training.label for training in trainings])
        axes.set(ylabel=unit, xlim=(-0.6, len(trainings) - 0.4))
        speed = axes.twinx()
        speeds = [training.simulated_s_per_wall_s for training in trainings]
        speed.plot(places, speeds, "o", color=style.BLACK, label="speed (right)")
        speed.set(ylabel="simulated seconds per wall second", ylim=(0, 1.2 * max(speeds)))
        speed.grid(visible=False)
        figure.legend(loc="outside right upper")
        return figure


def unit_of(phase_s: Sequence[Mapping[str, float]]) -> str:
    """Return the largest unit in which the longest of several trainings is 1 or more."""
    longest_s = max(sum(spent.values()) for spent in phase_s)
    return next((unit for unit, unit_s in UNITS_S.items() if longest_s >= unit_s), "seconds")


def plot_stacked(axes: Axes, phase_s: Sequence[Mapping[str, float]], unit: str) -> NDArray[np.int64]:
    """Plot a bar of stacked phases for each training, and return the bars' places (n,)."""
    places, below = np.arange(len(phase_s)), np.zeros(len(phase_s))
    for phase, colour in zip(phase_s[0], style.CYCLE, strict=False):
        spent = np.array([each[phase] for each in phase_s]) / UNITS_S[unit]
        axes.bar(places, spent, 0.55, below, color=colour, label=phase.replace("_", " "))
        below += spent
    return places
