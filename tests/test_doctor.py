"""The doctor's findings: each a line, also where a library is missing, hangs or crashes."""

import pytest

from uavaccel.cli import doctor


def test_a_probe_answers_in_json() -> None:
    assert doctor.probe("print('noise'); print('{\"a\": 1}')") == {"a": 1}


@pytest.mark.parametrize(("program", "text", "advised"), [
    ("import os; os.abort()", "it crashed (SIGABRT)", False),
    ("raise OSError('no libEGL')", "OSError: no libEGL", False),
    ("import sys; sys.exit(3)", "it ended with status 3", False),
    ("from uavaccel.errors import UserError; raise UserError('unset it')", "unset it", True),
])  # fmt: skip
def test_a_probe_that_fails_is_one_line(program: str, text: str, advised: bool) -> None:
    with pytest.raises(doctor.ProbeError) as caught:
        doctor.probe(program)
    assert (str(caught.value), caught.value.advised) == (text, advised)


def test_a_probe_that_hangs_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "TIMEOUT_S", 0.1)
    with pytest.raises(doctor.ProbeError, match="no answer within"):
        doctor.probe("while True: pass")


def test_a_machine_without_opengl_is_told_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "RENDERER", "raise ImportError('no libEGL.so.1')")
    finding = doctor.renderer()
    assert finding.problem
    assert finding.text == (
        "none: ImportError: no libEGL.so.1; install libegl1 libegl-mesa0 libgl1-mesa-dri (Debian)"
    )


def test_advice_is_not_given_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    program = "from uavaccel.errors import UserError; raise UserError('MUJOCO_GL=off: unset it')"
    monkeypatch.setattr(doctor, "RENDERER", program)
    assert doctor.renderer().text == "none: MUJOCO_GL=off: unset it"


@pytest.mark.parametrize(("software", "text"), [
    ("True", "egl: llvmpipe, software on the CPU, slow"),
    ("False", "egl: llvmpipe"),
])  # fmt: skip
def test_a_software_renderer_is_marked(monkeypatch: pytest.MonkeyPatch, software: str, text: str) -> None:
    answer = f"dict(backend='egl', name='llvmpipe', software={software})"
    monkeypatch.setattr(doctor, "RENDERER", f"import json; print(json.dumps({answer}))")
    finding = doctor.renderer()
    assert (finding.text, finding.problem) == (text, software == "True")


def test_the_hot_loop_is_ready() -> None:
    finding = doctor.hot_loop()
    assert not finding.problem
    assert "numba's cache" in finding.text


def test_a_simulator_that_does_not_run_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "HOT_LOOP", "import nothing_of_this_name")
    assert (
        doctor.hot_loop().text == "does not run: ModuleNotFoundError: No module named 'nothing_of_this_name'"
    )


def test_the_report_names_versions_cores_and_timers() -> None:
    assert {finding.name for finding in doctor.measuring()} == {"cores", "timers", "timing"}
    assert "uavaccel" in next(iter(doctor.findings())).text
