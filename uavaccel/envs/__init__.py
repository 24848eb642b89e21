"""Gymnasium environments; importing this package registers them, and so does Gymnasium when it is imported.

`gymnasium.make("uavaccel.envs:uavaccel/ObstacleLane-v0")` imports it first, in whatever process. `make_vec` flies many
of one kind in a batch, in the exact simulator or, with `simulator="kernels"`, over arrays; with `vectorization_mode`
"sync" or "async", in Gymnasium's own vectors.
"""

from gymnasium.envs.registration import register, registry

# id: module and class, and what makes a batch
ENVIRONMENTS = {
    "uavaccel/ObstacleLane-v0": ("obstacle_lane:ObstacleLane", "simulators:obstacle_lanes"),
    "uavaccel/Hover-v0": ("hover:Hover", "simulators:hovers"),
    "uavaccel/Gates-v0": ("gates:Gates", "simulators:gates"),
}


def register_environments() -> None:
    """Let Gymnasium know them: its entry point, `gymnasium.envs`, calls this where the package is installed."""
    for name, (one, many) in ENVIRONMENTS.items():
        if name not in registry:
            register(name, entry_point=f"uavaccel.envs.{one}", vector_entry_point=f"uavaccel.envs.{many}")


register_environments()
