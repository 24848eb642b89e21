"""The paper's own results of its trainings (Table I, section IV-D)."""

from __future__ import annotations

GAMES = 100  # evaluation games for each number of Table I
CLOCKS = (1.0, 5.0, 10.0, 50.0, 100.0)
SUCCESSES = {
    "adsc": dict(zip(CLOCKS, (23, 1, 0, 0, 0), strict=True)),
    "tcsc": dict(zip(CLOCKS, (21, 30, 23, 14, 13), strict=True)),
}
SIMULATION_SPEEDUP = {5.0: 4.0, 10.0: 6.4, 50.0: 14.8, 100.0: 15.4}  # TCSC, rendering on
TRAINING_SPEEDUP = {5.0: 3.6, 10.0: 5.2}  # TCSC, all phases
REAL_TIME_S = 182 * 3600.0  # training with ADSC in real time: 7 days and 14 hours
TRAINING_GAMES = 5000


THINKING_SHARE = 0.04372827213850535
"""The time of a command beside its simulation, over that of its simulation in real time.

It is the least-squares fit to the speed-ups of the simulation alone and of the whole training, as the paper gives no
numbers for Figure 9. Where the simulation becomes s times faster and the rest, a share o of it, stays, the whole
becomes (1 + o) / (1 / s + o) times faster. Either pair of speed-ups alone gives .038 and .045.
"""


def phase_hours(clock_speed: float) -> tuple[float, float]:
    """Return the hours of the paper's training in simulation and beside it. Raises KeyError without its speed-up."""
    real_time_h, share = REAL_TIME_S / 3600, THINKING_SHARE
    speedup = 1.0 if clock_speed == 1.0 else SIMULATION_SPEEDUP[clock_speed]
    return real_time_h / (1 + share) / speedup, real_time_h * share / (1 + share)


def of_training(profile: str, variant: str, command: str, clock_speed: float) -> dict[str, float | None]:
    """Return successes in 100 games, and speed-ups of simulation and whole training; None where the paper has none."""
    flown = profile == "airsim" and not variant
    tcsc = flown and command == "tcsc"
    return {
        "paper_successes": SUCCESSES[command].get(clock_speed) if flown else None,
        "paper_training_speedup": SIMULATION_SPEEDUP.get(clock_speed) if tcsc else None,
        "paper_whole_training_speedup": TRAINING_SPEEDUP.get(clock_speed) if tcsc else None,
    }
