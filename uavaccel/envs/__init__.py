"""Gymnasium environments; importing this package registers them.

`gymnasium.make("uavaccel.envs:uavaccel/ObstacleLane-v0")` imports it first, in whatever process.
"""

from gymnasium.envs.registration import register

register("uavaccel/ObstacleLane-v0", entry_point="uavaccel.envs.obstacle_lane:ObstacleLane")
register("uavaccel/Hover-v0", entry_point="uavaccel.envs.hover:Hover")
register("uavaccel/Gates-v0", entry_point="uavaccel.envs.gates:Gates")
