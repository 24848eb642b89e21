"""PPO of stable-baselines3 on the tasks with continuous actions.

Writes, for each task, how many of the last 100 games were won, step by step, and draws it; prints how many of 100 games
on fresh seeds the trained policy wins, and what it cost. One process, one thread.
"""

import argparse
import json
import os
from pathlib import Path
from typing import Any

import gymnasium
import matplotlib
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

from uavaccel.clock import MonotonicClock

matplotlib.use("agg")
from matplotlib import pyplot as plt

GAMES, FIRST_FRESH_SEED = 100, 1_000_000
OPTIONS: dict[str, Any] = {"n_steps": 128, "batch_size": 256, "gamma": 0.98, "learning_rate": 1e-3, "device": "cpu"}


class Curve(BaseCallback):
    """After each rollout: steps so far, share of the last games won, CPU seconds of this process."""

    def __init__(self) -> None:
        super().__init__()
        self.won: list[bool] = []
        self.points: list[tuple[int, float, float]] = []

    def _on_step(self) -> bool:
        over = zip(self.locals["dones"], self.locals["infos"], strict=True)
        self.won += [info["is_success"] for done, info in over if done]
        return True

    def _on_rollout_end(self) -> None:
        recent = float(np.mean(self.won[-GAMES:])) if self.won else 0.0
        self.points.append((self.num_timesteps, recent, cpu_s()))


def cpu_s() -> float:
    used = os.times()
    return used.user + used.system


def evaluate(model: PPO, name: str, games: int) -> int:
    """Games that the policy without noise wins, on seeds that no training has seen."""
    environment, won = gymnasium.make(f"uavaccel.envs:uavaccel/{name}-v0"), 0
    for game in range(games):
        (observation, info), over = environment.reset(seed=FIRST_FRESH_SEED + game), False
        while not over:
            action = model.predict(observation, deterministic=True)[0]
            observation, _, terminated, truncated, info = environment.step(action)
            over = terminated or truncated
        won += info["is_success"]
    environment.close()
    return won


def train(name: str, steps: int, games: int, seed: int) -> dict[str, object]:
    clock = MonotonicClock()
    start_ns, start_cpu_s, curve = clock.now_ns(), cpu_s(), Curve()
    environment = make_vec_env(f"uavaccel.envs:uavaccel/{name}-v0", n_envs=8, seed=seed)
    model = PPO("MlpPolicy", environment, seed=seed, **OPTIONS).learn(steps, callback=curve)
    wall_s, trained_cpu_s = (clock.now_ns() - start_ns) / 1e9, cpu_s() - start_cpu_s
    environment.close()
    cost = {"wall_s": round(wall_s, 1), "cpu_s": round(trained_cpu_s, 1)}
    points = [(count, share, round(used_s - start_cpu_s, 2)) for count, share, used_s in curve.points]
    won = evaluate(model, name, games)
    return {"task": name, "seed": seed, "steps": steps, **cost, "games": games, "won": won, "curve": points}


def draw(trainings: list[dict[str, object]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
    for training in trainings:
        steps, share, _ = np.array(training["curve"]).T
        axes.plot(steps, share, label=f"{training['task']}: {training['won']} of {training['games']} fresh games")
    axes.set(xlabel="commands flown", ylabel=f"share of the last {GAMES} games won", ylim=(0, 1.02))
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=["Hover=20000", "Gates=60000"])
    parser.add_argument("--out", type=Path, default=Path("runs/tasks"))
    parser.add_argument("--games", type=int, default=GAMES)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    torch.set_num_threads(1)
    given.out.mkdir(parents=True, exist_ok=True)
    trainings = []
    for name, _, steps in (task.partition("=") for task in given.tasks):
        trainings.append(train(name, int(steps), given.games, given.seed))
        print({key: value for key, value in trainings[-1].items() if key != "curve"}, flush=True)
        (given.out / f"{name}.json").write_text(json.dumps(trainings[-1]))
    draw(trainings, given.out / "tasks.png")
