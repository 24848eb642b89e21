"""A task of one's own: fly to a waypoint, then back to the start. `python task.py` trains a policy for it with PPO.

What a game is about, what is seen and what is rewarded are functions of HoverTask; those replaced here make it another
task. uavaccel.envs.task says what else there is.
"""

import argparse

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.hover import HoverTask


class ThereAndBackTask(HoverTask):
    """Its keys are HoverTask's and these; they are the keywords of `gymnasium.make`."""

    radius_m: float = 0.7  # of a waypoint
    speed_m_s: float = 2.0  # of a command whose share is 1
    bonus: float = 5.0  # for each waypoint

    def advance(self, before, now):
        """What became of the game: the waypoint reached, the next one is the start."""
        course = dict(now.course)
        if np.linalg.norm(np.subtract(course["waypoint_m"], now.position_m)) < self.radius_m:
            course |= {"waypoint_m": [0.0, 0.0, -self.altitude_m], "legs": course.get("legs", 0) + 1}
        return course

    def reward(self, before, now):
        """A point for each metre nearer to the waypoint that was next, a bonus for each reached."""
        waypoint = np.array(before.course["waypoint_m"])
        nearer_m = np.linalg.norm(waypoint - before.position_m) - np.linalg.norm(waypoint - now.position_m)
        reached = now.course.get("legs", 0) - before.course.get("legs", 0)
        return float(nearer_m) + self.bonus * reached - self.failure(now)

    def success(self, now):
        return now.course.get("legs", 0) == 2


class ThereAndBack(FlightEnv[ThereAndBackTask]):
    task_class = ThereAndBackTask


gymnasium.register("ThereAndBack-v0", entry_point=ThereAndBack)


def won(model: PPO, games: int) -> int:
    """Games on fresh seeds that the policy wins."""
    environment, wins = gymnasium.make("ThereAndBack-v0"), 0
    for game in range(games):
        (observation, info), over = environment.reset(seed=1_000_000 + game), False
        while not over:
            action, _ = model.predict(observation, deterministic=True)
            observation, _, terminated, truncated, info = environment.step(action)
            over = terminated or truncated
        wins += info["is_success"]
    environment.close()
    return wins


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--commands", type=int, default=30_000)
    parser.add_argument("--games", type=int, default=50, help="flown afterwards, on fresh seeds")
    asked = parser.parse_args()
    lanes = make_vec_env("ThereAndBack-v0", n_envs=8, seed=0)
    model = PPO("MlpPolicy", lanes, n_steps=128, batch_size=256, gamma=0.98, learning_rate=1e-3, seed=0, device="cpu")
    print(f"before: {won(model, asked.games)} of {asked.games} games")
    model.learn(asked.commands)
    print(f"after {asked.commands} commands: {won(model, asked.games)} of {asked.games} games")
    model.save("there_and_back")
    lanes.close()


if __name__ == "__main__":
    main()
