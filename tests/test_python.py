"""The package from Python: environments by name or class, runs without the command line, and its types."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import uavaccel
import uavaccel.envs
from tests.learning import OPTIONS
from tests.own_tasks import Post, PostTask
from tests.test_docs import blocks_of
from uavaccel.envs.hover import Hover, HoverTask
from uavaccel.errors import UserError
from uavaccel.sim.lane import Difficulty

pytestmark = pytest.mark.usefixtures("whole_messages")

ROOT = Path(__file__).parents[1]
IDS = [name for name in gymnasium.registry if name.startswith("uavaccel/")]
TINY: dict[str, Any] = {
    "games": 2, "environments": 1, "turns": 1, "mirror": False, "options": OPTIONS, "channels": [4], "hidden": [8],
    "task": {"observation": "state", "max_commands": 8},
}  # fmt: skip


def test_the_package_offers_its_names_and_no_others() -> None:
    assert set(uavaccel.__all__) <= set(dir(uavaccel))
    for name in uavaccel.__all__:
        assert getattr(uavaccel, name).__name__ == name
    with pytest.raises(AttributeError, match="module 'uavaccel' has no attribute 'nothing'"):
        getattr(uavaccel, "nothing")  # noqa: B009


@pytest.mark.parametrize("name", [*IDS, "lane", "hover", "gates", "navigate"])
def test_an_environment_is_made_by_its_id_or_its_short_name(name: str) -> None:
    """Each of which type checkers know, too."""
    make: Callable[..., Any] = uavaccel.make
    environment = make(name, observation="state") if name != "navigate" else make(name)
    names = [name, f"uavaccel/{type(environment).__name__}-v0"]
    assert names[1] in IDS
    assert all(f'"{each}"' in (ROOT / "uavaccel/keywords.pyi").read_text() for each in names)
    environment.close()


def test_an_environment_is_made_of_a_class_with_the_tasks_keys() -> None:
    of_task, of_environment = uavaccel.make(PostTask, climb_m_s=2.0), uavaccel.make(Post, climb_m_s=2.0)
    assert of_task.task == of_environment.task == PostTask(climb_m_s=2.0)
    assert uavaccel.make(PostTask, climb_m_s=np.float32(2.0), max_commands=np.int64(3)).task.max_commands == 3
    lane = uavaccel.make("lane", difficulty=Difficulty(wind_m_s=3.0), render_mode="rgb_array")
    assert uavaccel.make("lane", headings_deg=np.array([-9.0, 9.0])).task.headings_deg == (-9.0, 9.0)
    assert (lane.task.difficulty.wind_m_s, lane.render_mode) == (3.0, "rgb_array")


def test_a_batch_flies_exactly_or_as_arrays() -> None:
    exact = uavaccel.make_vec(HoverTask, 2, reach_m=2.0)
    arrays = uavaccel.make_vec("hover", 2, simulator="kernels", reach_m=2.0, processes=None, render_mode=None)
    seen = [batch.reset(seed=3)[0] for batch in (exact, arrays)]
    assert (seen[0] == seen[1]).all()
    exact.close()
    arrays.close()


@pytest.mark.parametrize(
    ("task", "keys", "said"),
    [
        ("hoover", {}, r"^task 'hoover': is unknown; did you mean 'hover'\?$"),
        (int, {}, r"^task <class 'int'>: is unknown; known: lane, .*, a class of Task or FlightEnv$"),
        (HoverTask(), {}, r"^task HoverTask.*: is unknown; known: lane, .*, a class of Task or FlightEnv$"),
        ("hover", {"reach_n": 2.0}, "^Hover: unknown key 'reach_n'; did you mean 'reach_m'"),
        ("hover", {"reach_m": 2j}, "^Hover: not made of text, numbers, lists and mappings: 2j is none of these$"),
        (Hover, {"reach_m": "2"}, "^Hover: reach_m = '2': should be a valid number"),
    ],
)
def test_what_cannot_be_made_is_one_clear_line(task: Any, keys: dict[str, Any], said: str) -> None:
    make: Callable[..., Any] = uavaccel.make
    with pytest.raises(UserError, match=said):
        make(task, **keys)


def test_a_class_without_a_file_of_its_own_is_not_trained() -> None:
    with pytest.raises(UserError, match=r"^Hover: is not in a file of your own: write it into one, or name a training"):
        uavaccel.train(Hover, games=1)


def test_what_is_neither_a_name_nor_a_class_is_one_line() -> None:
    train: Callable[..., Any] = uavaccel.train
    with pytest.raises(UserError, match=r"^an object of HoverTask: must be a name, a path, or the class of a task$"):
        train(HoverTask())
    evaluate: Callable[..., Any] = uavaccel.evaluate
    with pytest.raises(UserError, match=r"^an object of function: must be a name, a path, or a run; a function as 'my"):
        evaluate(lambda seen: 0)


def test_a_class_that_other_processes_cannot_import_is_one_line() -> None:
    class Local(PostTask):
        pass

    with pytest.raises(
        UserError, match=r"\.Local: is in no file, or in a function, and so unknown in other processes: "
    ):
        uavaccel.make_vec(Local, 2)
    with pytest.raises(UserError, match=r"^Local: is not in a file of your own: "):
        uavaccel.train(Local)


@pytest.mark.slow
def test_a_batch_flies_a_task_of_the_program_itself(tmp_path: Path) -> None:
    own = "class Own(Hover):\n    near_m: float = 1.0\n\n"
    begin = "import uavaccel\nfrom uavaccel.envs.hover import HoverTask as Hover\n"
    fly = "print(uavaccel.make_vec(Own, 1).reset(seed=0)[0].shape)\n"
    for guard, said in (
        ("if __name__ == '__main__':\n    ", "(1, 13)"),
        ("", "must not fly then: put what flies below"),
    ):
        (tmp_path / "program.py").write_text(begin + own + guard + fly)
        flown = subprocess.run(
            [sys.executable, "program.py"], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert said in flown.stdout + flown.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("trainings_here")
def test_trainings_and_evaluations_are_flown_from_python(tmp_path: Path) -> None:
    """Mappings are merged into the YAML's; a run goes on, here with more games."""
    run = uavaccel.train(out=tmp_path / "run", checkpoint_games=1, **TINY)
    assert (run.path, run.summary["games"]) == (tmp_path / "run", 2)
    assert (run.config()["task"]["max_commands"], run.config()["task"]["profile"]) == (8, "native")
    assert uavaccel.train(out=run.path, resume=True, games=3).summary["games"] == 3
    with pytest.raises(UserError, match=r"run: has another configuration: .*simulator"):
        uavaccel.train("train_kernels", out=run.path, resume=True, games=3)
    evaluated = uavaccel.evaluate(run, games=2, out=str(tmp_path / "evaluated"))
    assert (evaluated.summary["games"], len(evaluated.rows())) == (2, 2)
    with pytest.raises(UserError, match=r"exists; take another out, or resume"):
        uavaccel.evaluate(run, games=2, out=evaluated.path)
    mistaken: dict[str, Any] = {"gamess": 3}
    with pytest.raises(UserError, match="unknown key 'gamess'; did you mean 'games'"):
        uavaccel.train(out=tmp_path / "wrong", **mistaken)


@pytest.mark.slow
def test_processes_fly_a_folder_s_next_run_by_its_own_keys(tmp_path: Path) -> None:
    """They stay for the next run of the program, and have opened the environment of the one before."""
    flown = []
    for speed in (1.0, 2.0):
        task = {"speed_m_s": speed, "max_commands": 3, "observation": "state"}
        flown.append(uavaccel.evaluate("straight", out=tmp_path / "run", jobs=2, games=2, task=task).rows())
        shutil.rmtree(tmp_path / "run")
    slow, fast = ([row["distance_m"] for row in rows] for rows in flown)
    assert slow[0] == slow[1] < 3.0 < fast[0] == fast[1]


# --- types ------------------------------------------------------------------------------------------------------------

MISTAKES = """
uavaccel.make("hover", reach_n=2.0)
uavaccel.make("hover", reach_m="2")
uavaccel.make("hoover")
uavaccel.make(Slalom, reach_n=2.0)
uavaccel.make_vec("lane", 4, device="gpu")
uavaccel.make_vec("lane", goal_m=4)
uavaccel.train(Slalom, gamess=3)
uavaccel.evaluate("runs/slalom", games="3")
uavaccel.flim("runs/slalom")
""".strip().splitlines()
RIGHT = """
env: Hover = uavaccel.make("hover", radius_m=0.3, render_mode="rgb_array")
own: uavaccel.FlightEnv[Slalom] = uavaccel.make(Slalom, reach_m=0.5)
uavaccel.make("lane", lane="lane.yaml", difficulty={"wind_m_s": 3.0})
uavaccel.make_vec(Slalom, 4096, device="cuda", reach_m=0.5)
uavaccel.make_vec("navigate", num_envs=8, simulator="kernels")
uavaccel.train("hover_ppo", seeds=3, games=200, task={"reach_m": 2.0}, options={"rollout": 16}).summary["seeds"]
"""


@pytest.mark.slow
def test_a_strict_type_checker_passes_the_tutorial(tmp_path: Path) -> None:
    """As a stranger's project has it: its own settings, without the plugin of pydantic."""
    for block in blocks_of(ROOT / "docs/tutorial.md"):
        if block.title:
            (tmp_path / block.title).write_text(block.code)
    start = "import uavaccel\nfrom slalom import Slalom\nfrom uavaccel.envs.hover import Hover\n"
    (tmp_path / "right.py").write_text(start + RIGHT)
    (tmp_path / "wrong.py").write_text("\n".join([*start.splitlines(), *MISTAKES, "print(Hover)"]))
    settings = "[mypy]\n[mypy-mujoco.*,numba.*,cv2.*,msgpack.*,h5py.*,pandas.*]\nignore_missing_imports = true\n"
    settings += "[mypy-torch.*,matplotlib.*,viser.*,gymnasium.wrappers.*,numba.*,rich.*,cv2.*,av.*,PIL.*]\n"
    settings += "follow_imports = skip\nfollow_imports_for_stubs = true\n"  # a minute to read them
    (tmp_path / "mypy.ini").write_text(settings)
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(ROOT / ".mypy_cache/stranger")]
    files = ["slalom.py", "fly.py", "right.py", "wrong.py"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([*command, *files], cwd=tmp_path, capture_output=True, text=True, env=environment)
    errors = [line for line in done.stdout.splitlines() if ": error: " in line]
    lines = {tuple(line.split(":")[:2]) for line in errors}
    first = len(start.splitlines()) + 1
    assert lines == {("wrong.py", str(first + number)) for number in range(len(MISTAKES))}, errors
