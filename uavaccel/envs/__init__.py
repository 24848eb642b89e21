"""Gymnasium environments; importing this package registers them.

`gymnasium.make("uavaccel.envs:uavaccel/ObstacleLane-v0")` imports it first, in whatever process. `make_vec` flies many
of one kind in a batch; with `vectorization_mode` "sync" or "async", in Gymnasium's own vectors.
"""

from gymnasium.envs.registration import register

register(
    "uavaccel/ObstacleLane-v0",
    entry_point="uavaccel.envs.obstacle_lane:ObstacleLane",
    vector_entry_point="uavaccel.envs.batch:obstacle_lanes",
)
register(
    "uavaccel/Hover-v0",
    entry_point="uavaccel.envs.hover:Hover",
    vector_entry_point="uavaccel.envs.batch:hovers",
)
register(
    "uavaccel/Gates-v0",
    entry_point="uavaccel.envs.gates:Gates",
    vector_entry_point="uavaccel.envs.batch:gates",
)
