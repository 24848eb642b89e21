"""Every block of code in the README runs, and every package that it names is there."""

import re
import signal
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests import airsim_client
from tests.serving import running_server

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)
PYTHON = [code for language, code in BLOCKS if language == "python"]
SHELL = [line for language, code in BLOCKS if language == "sh" for line in code.splitlines()]


def test_there_are_blocks_of_two_kinds() -> None:
    assert {language for language, _ in BLOCKS} == {"python", "sh"}
    assert README.count("```") == 2 * len(BLOCKS)


@pytest.mark.wall_clock
@pytest.mark.parametrize("code", [code for code in PYTHON if "import airsim" not in code])
def test_programs_run(code: str) -> None:
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


@pytest.mark.wall_clock
@pytest.mark.parametrize("code", [code for code in PYTHON if "import airsim" in code])
def test_airsim_scripts_fly(code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a client with AirSim's names, on a port that is free."""
    airsim = ModuleType("airsim")
    monkeypatch.setitem(sys.modules, "airsim", airsim)
    with (
        running_server(clock_speed=10.0, profile="airsim") as server,
        airsim_client.MultirotorClient(port=server.address[1]) as client,
    ):
        airsim.MultirotorClient = lambda: client  # type: ignore[attr-defined]
        exec(compile(code, "README.md", "exec"), {})


@pytest.mark.wall_clock
@pytest.mark.parametrize("line", SHELL)
def test_commands_run(line: str, tmp_path: Path) -> None:
    program, command, *options = line.split()
    assert program == "uavaccel"
    arguments = [sys.executable, "-m", program, command, *options]
    [airsim_script] = [code for code in PYTHON if "import airsim" in code]
    (tmp_path / "script.py").write_text(airsim_script)
    if command == "serve":
        serve_and_stop([*arguments, "--port", "0"])
    else:
        subprocess.run(arguments, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, check=True)


def serve_and_stop(arguments: list[str]) -> None:
    with subprocess.Popen(arguments, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("listening on 127.0.0.1:")
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    assert process.returncode == 0


@pytest.mark.parametrize("target", re.findall(r"`make (\w+)`", README))
def test_make_has_its_targets(target: str) -> None:
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(uavaccel\.[\w.]+)`", README))))
def test_packages_are_there(name: str) -> None:
    path = ROOT / name.replace(".", "/")
    assert path.is_dir() or path.with_suffix(".py").is_file()
