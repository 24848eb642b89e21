"""Gymnasium environments; importing this package registers them.

`gymnasium.make("uavaccel.envs:uavaccel/ObstacleLane-v0")` imports it first, in whatever process. `make_vec` flies many
of one kind in a batch, in the exact simulator or with `simulator="kernels"` over arrays; with `vectorization_mode`
"sync" or "async", in Gymnasium's own vectors.
"""

from gymnasium.envs.registration import register

for _name, _one, _many in (
    ("ObstacleLane", "obstacle_lane:ObstacleLane", "obstacle_lanes"),
    ("Hover", "hover:Hover", "hovers"),
    ("Gates", "gates:Gates", "gates"),
    ("Navigate", "navigate:Navigate", "navigations"),
):
    register(
        f"uavaccel/{_name}-v0",
        entry_point=f"uavaccel.envs.{_one}",
        vector_entry_point=f"uavaccel.envs.simulators:{_many}",
    )
