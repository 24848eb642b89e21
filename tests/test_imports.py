"""Imports point one way, time has one owner, and importing the package is cheap."""

import os
import re
import subprocess
import sys
from pathlib import Path

from tools.mutate import imported

PACKAGE = Path(__file__).parents[1] / "uavaccel"

GROUND = {
    *("units", "errors", "files", "config", "machine", "records", "forms", "own_code"),
    *("processes", "kinematics", "resources"),
}
# A room is a top-level module or package; beside itself it may import these rooms.
ROOMS: dict[str, set[str]] = {
    **dict.fromkeys(GROUND, GROUND),
    "__init__": set(),
    "clock": GROUND,
    "sim": GROUND | {"clock"},
    "wire": GROUND | {"clock", "sim"},
    "commands": {"units", "kinematics", "errors", "clock"},  # these could drive a real AirSim
    "vision": GROUND | {"sim"},
    "metrics": GROUND,
    "airsim": {"units", "errors", "clock", "wire"},
    "kernels": GROUND | {"clock", "sim", "vision"},
    "realtime": GROUND | {"clock", "metrics"},
}
ROOMS["envs"] = set(ROOMS) - {"__init__", "airsim", "realtime"}
ROOMS["rl"] = ROOMS["envs"] | {"envs", "realtime"}
ROOMS["draw"] = GROUND | {"sim", "vision", "metrics"}  # arrays in, files out
ROOMS["calibration"] = GROUND | {"clock", "sim", "wire", "commands", "metrics"}
ROOMS["suites"] = ROOMS["rl"] | {"rl", "draw", "calibration", "realtime"}
ROOMS["fly"] = GROUND | {"clock", "sim", "wire", "airsim", "draw"}
ROOMS["api"] = ROOMS["suites"] | {"suites"}  # the package's face in Python, as cli is in the shell
ROOMS["__init__"] = ROOMS["suites"]
ROOMS["export"] = ROOMS["suites"] | {"suites"}
ROOMS["watch"] = ROOMS["suites"] | {"suites", "fly"}
ROOMS["cli"] = ROOMS["watch"] | {"watch", "export", "fly", "__init__"}
ROOMS["__main__"] = {"cli"}
HEAVY = {
    *("cv2", "gymnasium", "joblib", "matplotlib", "mujoco", "numba", "scipy", "stable_baselines3", "sympy"),
    *("tensorboard", "torch"),
}
MODULES = sorted(PACKAGE.rglob("*.py"))
CLOCK = PACKAGE / "clock.py"


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def test_imports_point_downwards_and_only_the_clock_knows_time() -> None:
    faults = []
    for path in MODULES:
        allowed = ROOMS[room_of(path)] | {room_of(path)}  # a new room needs its place in ROOMS
        for line, name in imported(path):
            top, other, *_ = [*name.split("."), ""]
            if (top == "uavaccel" and other in ROOMS.keys() - allowed) or (top == "time" and path != CLOCK):
                faults.append(f"{name_of(path)}:{line}: must not import {name}")
    assert faults == []


def test_only_the_clock_looks_at_a_clock_or_sleeps() -> None:
    looks = r"\b(?:datetime|date)\.(?:now|utcnow|today)\b|\.sleep\("
    assert [name_of(path) for path in MODULES if path != CLOCK and re.search(looks, path.read_text("utf-8"))] == []


def test_what_is_imported_for_itself_brings_nothing_heavy() -> None:
    """One after the other. The two commands could drive a real AirSim: no simulation and no wire come with them."""
    left_out = {
        "uavaccel.cli.main, uavaccel.errors": HEAVY | {"numpy", "pydantic"},
        "uavaccel.commands": HEAVY | {"pydantic", "msgpack", "uavaccel.sim", "uavaccel.wire", "uavaccel.envs"},
        "uavaccel.airsim": HEAVY | {"pydantic"},
    }
    program = "import sys\n" + "".join(f"import {modules}; print(*sys.modules)\n" for modules in left_out)
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    for (modules, absent), loaded in zip(left_out.items(), done.stdout.splitlines(), strict=True):
        assert not absent & set(loaded.split()), modules


COMMANDS = {
    "--help": set(),
    "doctor": set(),
    "fly print.py": set(),
    "run dp1 --dry-run": {"mujoco"},
    "train --dry-run": {"gymnasium", "mujoco"},
    "evaluate --dry-run": {"gymnasium", "mujoco", "numba", "scipy"},
}
"""What each needs, and what those before it do."""
ONE_AFTER_ANOTHER = """
import sys
from uavaccel.cli.main import main
program = sys.executable
for line in sys.argv[1:]:
    sys.argv[1:] = line.split()
    sys.executable = "false" if line == "doctor" else program  # in whose place it tries the simulator
    try:
        main()
    except SystemExit:
        pass
    print("loaded:", *sys.modules)
"""


def test_a_command_loads_what_it_needs(tmp_path: Path) -> None:
    """The doctor tries the simulator in other processes; configurations need the profiles, which are MuJoCo's."""
    (tmp_path / "print.py").write_text("print(1)")
    command = [sys.executable, "-c", ONE_AFTER_ANOTHER, *COMMANDS]
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    loaded = [HEAVY & set(line.split()) for line in done.stdout.splitlines() if line.startswith("loaded: ")]
    assert loaded == [*COMMANDS.values()], done.stderr


TRAINED = """
import sys
from uavaccel.rl.agents import first_policy
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.network import Adam
optimizer = Adam(first_policy(LearnerConfig(channels=(1,), hidden=())).q_net.parameters(), 1e-3)
optimizer.zero_grad()
optimizer.step()
optimizer.load_state_dict(optimizer.state_dict())
print(*sys.modules)
from tests.learning import fly_here, side_by_side, tiny_config
from uavaccel.config import validate
from uavaccel.rl.learner import make_learner
from uavaccel.rl.policy import make_policy
from uavaccel.suites.train import TrainConfig
import uavaccel.suites.trainer, uavaccel.suites.evaluate_lanes, uavaccel.suites.evaluate_again, uavaccel.rl.onnx_file
import uavaccel.rl.adapters, uavaccel.rl.learner
fly_here()
hover = {"env_id": "uavaccel/Hover-v0", "algorithm": "ppo", "hidden": [8], "options": {"rollout": 8, "minibatches": 2}}
for config in (tiny_config({"observation": "state"}, mirror=False), validate(TrainConfig, hover, "test")):
    learner = make_learner(config, side_by_side(config))
    for _ in range(3):
        learner.advance()
    make_policy(config)
print(*sys.modules)
"""


def test_a_learner_loads_neither_pytorchs_compiler_nor_other_learners() -> None:
    command = [sys.executable, "-c", TRAINED]
    done = subprocess.run(command, cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    learned, trained = (set(line.split()) for line in done.stdout.splitlines()[-2:])
    assert not {"torch._dynamo", "sympy", "numba", "scipy"} & learned
    assert "uavaccel.rl.double_dqn" in trained
    assert "stable_baselines3" not in trained


def test_the_process_of_a_measured_environment_loads_nothing_that_learns() -> None:
    program = "import sys; from uavaccel.suites.realtime_agents import make; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    assert HEAVY & set(done.stdout.split()) == {"gymnasium", "mujoco"}


def test_modules_of_the_world_do_not_import_in_circles() -> None:
    """Imports for types alone count too."""
    files = {name_of(path).removesuffix(".py"): path for path in MODULES if room_of(path) == "sim"}
    left = {
        name: {other for _, found in imported(path) for other in candidates(found) if other in files} - {name}
        for name, path in files.items()
    }
    while free := [name for name, needs in left.items() if not needs & left.keys()]:
        for name in free:
            del left[name]
    assert not left, "each of these needs another of them"


def candidates(name: str) -> tuple[str, str]:
    """The modules that an import may be of: itself, or what it is taken from; as `name_of` without the ending."""
    path = name.removeprefix("uavaccel.").replace(".", "/")
    return path, path.rpartition("/")[0]
