"""Does the task do what it should? `python -m pytest` tells."""

import numpy as np
from task import DoorTask

from uavaccel.envs.flight_env import environment_of
from uavaccel.envs.kernel_batch import KernelBatch

Door = environment_of(DoorTask)


def test_a_random_episode_stays_within_the_spaces_and_ends():
    environment = Door(max_commands=20)
    environment.action_space.seed(0)
    seen, info = environment.reset(seed=0)
    over = False
    while not over:
        assert environment.observation_space.contains(seen)
        seen, reward, terminated, truncated, info = environment.step(environment.action_space.sample())
        assert np.isfinite(reward)
        over = terminated or truncated
    assert info["commands"] <= 20
    environment.close()


def test_the_kernels_fly_as_the_exact_simulator_does():
    exact, lanes = Door(), KernelBatch(Door, 2, autoreset_mode="Disabled")
    seen, _ = exact.reset(seed=3)
    both, _ = lanes.reset(seed=3)
    over = False
    while not over:
        np.testing.assert_allclose(both[0], seen, atol=1e-5)
        action = np.clip(np.array([0.5, seen[1]], np.float32), -1.0, 1.0)  # northwards, and towards the door
        seen, reward, terminated, truncated, _ = exact.step(action)
        both, rewards, ended, cut, _ = lanes.step(np.tile(action, (2, 1)))
        np.testing.assert_allclose(rewards[0], reward, atol=1e-9)
        assert (ended[0], cut[0]) == (terminated, truncated)
        over = terminated or truncated
    exact.close()
    lanes.close()


def test_flying_through_the_door_wins():
    environment = Door()
    seen, _ = environment.reset(seed=1)
    over = False
    while not over:
        action = np.clip([0.4, seen[1] - 0.5 * seen[4]], -1.0, 1.0).astype(np.float32)
        seen, _, terminated, truncated, info = environment.step(action)
        over = terminated or truncated
    assert info["is_success"]
    environment.close()
