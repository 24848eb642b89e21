"""Trainings with `simulator: kernels`, and what of them needs OpenGL."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.running import configured, fly_into
from uavaccel.errors import UserError
from uavaccel.sim.camera import gl
from uavaccel.suites.train import REAL_TIME, Training

STATE = "task.observation=state"
TINY = (
    *(STATE, "task.max_commands=6", "hidden=[16]", "mirror=false", "environments=3"),
    *("options.learning_starts=6", "options.batch_size=8", "options.buffer_size=200"),
)


@pytest.mark.slow
def test_the_kernels_learn_from_pictures_without_opengl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their modelled time in real time has none either; evaluations on the way are of the exact simulator."""

    def refuse() -> str:
        raise UserError("there is no OpenGL")

    monkeypatch.setattr(gl, "choose_backend", refuse)
    pictures = [key for key in TINY if key != STATE] + ["channels=[4, 4]", "simulator=kernels"]
    run = fly_into(tmp_path / "run", Training(), configured("train", *pictures, games=3))
    assert 1.0 < run.read_json(REAL_TIME)["command_s"] < 1.1


@pytest.mark.parametrize(
    ("overrides", "needed"),
    [
        ((), True),
        ((STATE, "mirror=false"), False),
        (("simulator=kernels",), False),
        (("simulator=kernels", "evaluate_every_games=5"), True),
        (("simulator=kernels", "evaluate_every_games=5", STATE, "mirror=false"), False),
    ],
)
def test_opengl_is_asked_for_where_pictures_need_it(overrides: tuple[str, ...], needed: bool) -> None:
    assert Training().renders(configured("train", *overrides)) == needed
