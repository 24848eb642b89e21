"""Figure 9 in numbers: the hours of a training by phase, beside the paper's own."""

from __future__ import annotations

from collections.abc import Sequence

from uavaccel.draw.document import Table, or_dash
from uavaccel.draw.style import clock_label
from uavaccel.suites import paper_results
from uavaccel.suites.paper.evidence import SIMULATION, THINKING, NoEvidence, Policies, Undecided
from uavaccel.suites.report import SummaryCell


def phases(rl: Policies) -> list[dict[str, float]]:
    """TCSC's trainings by ClockSpeed, each phase in hours of a training that takes ADSC the paper's 182 at 1x, and what
    the paper has in simulation and beside it; empty where the trainings cannot be compared with ADSC at 1x.
    """
    try:
        hour_s = rl.command_s("adsc", 1.0, (*SIMULATION, *THINKING)).value * 3600 / paper_results.REAL_TIME_S
        return [_of(rl, k, hour_s) for k in rl.clocks("tcsc") if k in paper_results.CLOCKS]
    except (NoEvidence, Undecided):
        return []


def _of(rl: Policies, clock_speed: float, hour_s: float) -> dict[str, float]:
    """`hour_s`: what a command takes in a training of an hour."""
    simulation, beside = paper_results.phase_hours(clock_speed)
    return {
        "clock_speed": clock_speed,
        "simulation_h": rl.command_s("tcsc", clock_speed, SIMULATION).value / hour_s,
        **{f"{each}_h": rl.command_s("tcsc", clock_speed, (each,)).value / hour_s for each in THINKING},
        "paper_simulation_h": simulation,
        "paper_beside_h": beside,
    }


def table(rows: Sequence[SummaryCell]) -> Table:
    """A line a ClockSpeed, the paper's beside ours; its whole training where it names it."""
    return Table.of(
        rows,
        ("ClockSpeed", lambda row: clock_label(row["clock_speed"])),
        ("simulation, h", lambda row: f"{row['simulation_h']:.1f}"),
        ("simulation, the paper's", lambda row: f"{row['paper_simulation_h']:.1f}"),
        ("image processing, h", lambda row: f"{row['image_processing_h']:.1f}"),
        ("inference, h", lambda row: f"{row['inference_h']:.1f}"),
        ("learning, h", lambda row: f"{row['learning_h']:.1f}"),
        ("all three, the paper's", lambda row: f"{row['paper_beside_h']:.1f}"),
        ("whole, h", lambda row: f"{row['simulation_h'] + sum(row[f'{each}_h'] for each in THINKING):.1f}"),
        ("whole, the paper's", lambda row: or_dash(_paper_whole_h(row["clock_speed"]), "{:.1f}".format)),
    )


def _paper_whole_h(clock_speed: float) -> float | None:
    """182 hours over the speed-up that the paper gives for the whole training."""
    speedup = 1.0 if clock_speed == 1.0 else paper_results.TRAINING_SPEEDUP.get(clock_speed)
    return None if speedup is None else paper_results.REAL_TIME_S / 3600 / speedup


SAID = (
    "Hours of TCSC's training, were it as long as one that takes ADSC the paper's 182 hours at 1x. The paper draws its "
    "phases and gives none in numbers: its columns follow from its speed-ups, of which what it takes beside the "
    "simulation was fitted to the difference between 4x and 3.6x, and 6.4x and 5.2x. Ours takes these costs where the "
    "configuration of the training has them as fitted; what the simulation takes is a prediction, under the choice of "
    "60 frames a second, which no source gives: at 100x it makes 9.1x with 30 frames a second, 12.1x with 45, 14.6x "
    "with 60, 18.7x with 90 and 21.8x with 120, where the paper has 15.4x."
)
