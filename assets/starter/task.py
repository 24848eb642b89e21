"""The task: fly through the door between two posts, wherever it stands. Change anything; `uavaccel train` learns it.

Each function is called for one drone by the exact simulator, and for thousands at once, over arrays, by the kernels. So
compute with plain arithmetic: `&` for and, `|` for or, a factor such as `(x > 1)` for if.
"""

import numpy as np
from gymnasium.spaces import Box

from uavaccel.envs.task import Task, distance
from uavaccel.kinematics import VelocityGoal


class DoorTask(Task):
    scene = "lane"  # a long street, into which `layout` puts obstacles
    flat_state = True  # an observation is a vector, (6,)

    # Keys: your YAML file sets them under `task:`, and --set task.door_m=2.
    altitude_m: float = 1.5  # height at which it starts and stays, metres
    speed_m_s: float = 2.0  # at full deflection
    door_m: float = 1.6  # width of the door
    max_commands: int = 60  # after which the episode is over; each takes t_move_s, 0.2 s

    def sample(self, random, options):
        """What differs from episode to episode: plain numbers and lists. NED: north, east, down."""
        return {"door_m": [8.0, float(random.uniform(-3.0, 3.0)), -self.altitude_m]}

    def layout(self, course):
        """Where the obstacles of an episode stand: a post on either side of the door."""
        north, east, _ = course["door_m"]
        post = {"x_m": north, "half_side_m": 0.3}
        return {"obstacles": [{**post, "y_m": east + side * (self.door_m / 2 + 0.3)} for side in (-1, 1)]}

    def action_space(self):
        return Box(-1.0, 1.0, (2,), np.float32)

    def goal(self, action):
        """What an action asks the autopilot for: here a velocity, at constant height."""
        north, east = action
        return VelocityGoal((north * self.speed_m_s, east * self.speed_m_s, 0.0), -self.altitude_m)

    def fields(self, state, course):
        """What the policy sees: the way to the door, and how fast it flies."""
        north, east, down = course["door_m"]
        x_m, y_m, z_m = state.position_m
        return [north - x_m, east - y_m, down - z_m, *state.linear_velocity_m_s]

    def reward(self, before, now):
        """Metres nearer to the door, and something for the end."""
        nearer_m = distance(before.course["door_m"], before.position_m) - distance(now.course["door_m"], now.position_m)
        return nearer_m + 10.0 * self.success(now) - 10.0 * self.failure(now)

    def beside_m(self, now):
        return abs(now.position_m[1] - now.course["door_m"][1])

    def success(self, now):
        return now.free & (now.position_m[0] > now.course["door_m"][0]) & (self.beside_m(now) < self.door_m / 2)

    def failure(self, now):  # it touched something, or flew past the door
        return now.touched | (now.position_m[0] > now.course["door_m"][0]) & (self.beside_m(now) >= self.door_m / 2)
