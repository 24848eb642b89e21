"""Fits what the paper's agent costs the wall clock beside the simulation, and prints it as keys of a training.

    python tools/fit_agent.py

The paper says nothing of Figure 9's phases in numbers, but how much faster the simulation alone was and the whole
training: 4x and 3.6x at ClockSpeed 5, 6.4x and 5.2x at 10. What does not get faster is a share of a command's time in
the simulation at 1x (paper_results.THINKING_SHARE), which takes what the modelled AirSim says, pictures included.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from uavaccel.commands import COMMANDS, SQUARE
from uavaccel.config import dump_yaml
from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.sim.profile import PROFILES
from uavaccel.suites import paper_results
from uavaccel.wire.latency import LatencyConfig, shipped_latency
from uavaccel.wire.session import Client, open_session

IMAGE_PROCESSING_S = 0.0032  # v2e of a 256 x 144 picture on one thread, measured; the paper's DVS is v2e
PICTURES, T_MOVE_S, T_SAMPLE_S = 3, 1.0, 0.33  # of a command (section III-C1)
T_TH_WALL_S = 0.001


class Asking:
    """A client that asks for a picture with every sample and does not look at it: what counts is when it is there."""

    def __init__(self, client: Client) -> None:
        self._client = client

    def __getattr__(self, name: str) -> Any:
        return getattr(self._client, name)

    def read_sample(self, state: Kinematics) -> Kinematics:
        transport = self._client.transport
        transport.wait(transport.send("uavaccelImage", ("none",), blocking=True))
        return state


def command_wall_s(command: str, clock_speed: float, latency: LatencyConfig, commands: int = 300) -> float:
    """Wall seconds of a command with its pictures: simulation and rendering alone."""
    with open_session("virtual", "airsim", "blocks", latency) as session:
        client: Any = Asking(session.start_game(clock_speed, np.random.SeedSequence(0)))
        COMMANDS[command].begin(client)
        start_ns = client.now_ns()
        t_th_ns = PROFILES["airsim"].t_th_ns(T_TH_WALL_S, clock_speed, T_SAMPLE_S)
        for index in range(commands):
            goal = VelocityGoal(SQUARE[index % len(SQUARE)])
            list(COMMANDS[command].fly(client, goal, T_MOVE_S, T_SAMPLE_S, t_th_ns))
        return float(client.now_ns() - start_ns) / 1e9 / commands


def agent_costs(latency: LatencyConfig) -> dict[str, float]:
    """Seconds by key of a training; in all a share of a command of ADSC at 1x.

    Only the sum is fitted. Of it the pictures take what v2e was measured to take, and the decision all the rest: Figure
    9 has no other phase, and a cost per gradient step would come out differently with every rhythm of learning.
    """
    thinking_s = paper_results.THINKING_SHARE * command_wall_s("adsc", 1.0, latency)
    inference_s = round(thinking_s - PICTURES * IMAGE_PROCESSING_S, 3)
    return {"task.image_processing_s": IMAGE_PROCESSING_S, "inference_s": inference_s, "learning_s": 0.0}


if __name__ == "__main__":
    print(dump_yaml(agent_costs(shipped_latency("airsim"))), end="")
