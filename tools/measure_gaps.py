"""Measures what ADSC's gap changes at each ClockSpeed, and what TCSC's gap of the same length does, as a CSV.

    python -m tools.measure_gaps > docs/tables/gap_parts.csv

Both fly commands of 1 s north with three pictures each: ADSC as in Table I, under the model of AirSim with an agent
that takes 38 ms, and 3.2 ms more for each picture; TCSC under the native profile without latency, flying on after each
command (task.mediation.gap_s). Numbers are means over the commands after the first ones:

    gap_s                   simulated time from a command's end to the next one's beginning
    start_speed_m_s         speed north at a command's beginning
    start_share             the same over the speed at the last command's end
    metres_per_command      north, from a command's beginning to the next one's
    seconds_per_command     the same in simulated time
    picture_age_s           of the last picture at the next command's beginning
    unseen_m                way north from the last picture to the next command's beginning
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tools.fit_agent import IMAGE_PROCESSING_S, T_MOVE_S, T_SAMPLE_S, T_TH_WALL_S, Asking
from uavaccel.commands import COMMANDS
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.recording import Recording
from uavaccel.units import NS_PER_S, seconds_to_ns
from uavaccel.wire.latency import ZERO_LATENCY, shipped_latency
from uavaccel.wire.session import open_session

INFERENCE_S = 0.038  # of Table I (experiments/rl.yaml)
CLOCK_SPEEDS = (1.0, 5.0, 10.0, 50.0, 100.0)
MORE_GAPS_S = (0.074, 0.386, 0.776, 1.2, 2.0)  # that experiments/mediation_flight.yaml flies
COMMANDS_FLOWN, FIRST = 25, 5
NORTH = VelocityGoal((1.0, 0.0, 0.0))


def parts_of(command: str, clock_speed: float, gap_s: float = 0.0) -> dict[str, Any]:
    """Fly, and return the row of a command and a ClockSpeed; `gap_s` is TCSC's."""
    adsc = command == "adsc"
    timing, profile, latency = (
        ("virtual", "airsim", shipped_latency("airsim")) if adsc else ("lockstep", "native", ZERO_LATENCY)
    )
    with open_session(timing, profile, "blocks", latency) as session:
        client: Any = Asking(session.start_game(clock_speed, np.random.SeedSequence(0)))
        client.trace(True)
        COMMANDS[command].begin(client)
        t_th_ns, seen_ns = PROFILES[profile].t_th_ns(T_TH_WALL_S, clock_speed, T_SAMPLE_S), []
        for _ in range(COMMANDS_FLOWN):
            if gap_s:
                client.continue_for(seconds_to_ns(gap_s))
            for sample in COMMANDS[command].fly(client, NORTH, T_MOVE_S, T_SAMPLE_S, t_th_ns):
                last_ns = sample.time_ns
                client.transport.clock.charge(round(IMAGE_PROCESSING_S * NS_PER_S * adsc))
            seen_ns.append(last_ns)
            client.transport.clock.charge(round(INFERENCE_S * NS_PER_S * adsc))
        flown, trace = client.recording(), client.trace(False)
    first_ns = next(simulated_ns for event, _, simulated_ns in trace if event == "accept")
    return {"command": command, "clock_speed": clock_speed} | averages(flown, (np.array(seen_ns) - first_ns) / NS_PER_S)


def averages(flown: Recording, seen_s: NDArray[np.float64]) -> dict[str, float]:
    """Return the numbers of a row from a recording and the times (c,) of the commands' last pictures."""
    flight = flown.arrays()
    begun_s, before = flight["command_start_s"][FIRST:], slice(FIRST - 1, -1)
    ended_s, seen_s = flight["command_end_s"][before], seen_s[before]

    def at(moments_s: NDArray[np.float64], name: str) -> NDArray[np.float64]:
        return np.interp(moments_s, flight["time_s"], flight[name][:, 0])

    speed_m_s = at(begun_s, "linear_velocity_m_s").mean()
    return {
        "gap_s": (begun_s - ended_s).mean(),
        "start_speed_m_s": speed_m_s,
        "start_share": speed_m_s / at(ended_s, "linear_velocity_m_s").mean(),
        "metres_per_command": np.diff(at(begun_s, "position_m")).mean(),
        "seconds_per_command": np.diff(begun_s).mean(),
        "picture_age_s": (begun_s - seen_s).mean(),
        "unseen_m": (at(begun_s, "position_m") - at(seen_s, "position_m")).mean(),
    }


if __name__ == "__main__":
    adsc = [parts_of("adsc", clock_speed) for clock_speed in CLOCK_SPEEDS]
    gaps_s = [0.0, *(round(each["gap_s"] / 0.002) * 0.002 for each in adsc), *MORE_GAPS_S]
    tcsc = [parts_of("tcsc", 1.0, gap_s) for gap_s in sorted(gaps_s)]
    pd.DataFrame(adsc + tcsc).round(4).to_csv(sys.stdout, index=False)
