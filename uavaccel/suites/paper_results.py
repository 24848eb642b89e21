"""What the paper gives for its own trainings (Table I, section IV-D), and what numbers of its size can tell."""

from __future__ import annotations

GAMES = 100  # evaluated for each number of Table I
CLOCKS = (1.0, 5.0, 10.0, 50.0, 100.0)
SUCCESSES = {
    "adsc": dict(zip(CLOCKS, (23, 1, 0, 0, 0), strict=True)),
    "tcsc": dict(zip(CLOCKS, (21, 30, 23, 14, 13), strict=True)),
}
SIMULATION_SPEEDUP = {5.0: 4.0, 10.0: 6.4, 50.0: 14.8, 100.0: 15.4}  # of TCSC, rendering on
TRAINING_SPEEDUP = {5.0: 3.6, 10.0: 5.2}  # with all phases
REAL_TIME_S = 182 * 3600.0  # of its training in real time: 7 days and 14 hours
TRAINING_GAMES = 5000


def successes(profile: str, variant: str, command: str, clock_speed: float) -> int | None:
    """Of 100 games, where the paper has a number for the cell; its simulator was AirSim."""
    if profile != "airsim" or variant:
        return None
    return SUCCESSES[command].get(clock_speed)


def speedups(
    profile: str, variant: str, command: str, clock_speed: float
) -> tuple[float | None, float | None]:
    """Of simulation alone, and of the whole training."""
    if profile != "airsim" or variant or command != "tcsc":
        return None, None
    return SIMULATION_SPEEDUP.get(clock_speed), TRAINING_SPEEDUP.get(clock_speed)
