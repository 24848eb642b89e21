"""Fly AirSim's own example scripts, unmodified, and write down which of them pass.

    python -m tools.airsim_scripts AIRSIM/PythonClient --client-python VENV/bin/python --page PAGE.md
    python -m tools.airsim_scripts AIRSIM/PythonClient --from-ground

Each script is flown twice: under `uavaccel fly` in virtual time, and by AirSim's own client over TCP against
`uavaccel serve`, with a Python in whose environment `airsim` 1.8.1 is installed. A script passes if it ends well, or
flies on until it is stopped where it has no end; if no call of it was refused; and if what it is for has happened: the
vehicle has flown, or images have come. The scripts are AirSim's (MIT) and not part of this project.
"""

from __future__ import annotations

import argparse
import json
import os
import pty
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from uavaccel.fly.log import MESSAGES, TRAJECTORY
from uavaccel.fly.options import THINK_S, FlightOptions
from uavaccel.fly.wall import recorded, serving
from uavaccel.machine import describe_run
from uavaccel.wire.settings import Settings, read_settings

LEAST_BYTES = 500  # of an image: responses without one are shorter
FLOWN_M = 0.5  # shorter paths are no flight
WIRE_CLOCK = 10.0
WIRE_LIMIT_S, WIRE_LEAST_S = 60.0, 10.0
FLY_LIMIT_S = 300.0
COMMAND = "python -m tools.airsim_scripts AIRSIM/PythonClient --client-python VENV/bin/python --page PAGE.md"

HEADER = f"""# AirSim's example scripts

The scripts of AirSim's PythonClient, unmodified and headless: under `uavaccel fly` in virtual time, thinking
{1000 * THINK_S["virtual"]:g} ms before each call, and by the `airsim` 1.8.1 client over TCP against `uavaccel serve`
at ClockSpeed 10. A script passes if it ends well, or flies on until it is stopped where it has no end; if no call was
refused; and if the vehicle has flown, or images have come, where it is for that.
"""

NO_WINDOWS = """
try:
    import cv2
except ImportError:
    pass
else:
    for name in ("destroyAllWindows", "imshow", "namedWindow"):
        setattr(cv2, name, lambda *arguments, **options: None)
    cv2.waitKey = lambda delay=0: -1
"""

LIDARS = {
    f"LidarSensor{number}": {
        "SensorType": 6,
        "Enabled": True,
        "NumberOfChannels": 1,
        "PointsPerSecond": 8000,
        "Range": 12,
        "Z": -1,
        "Pitch": 90,
        "Roll": roll,
        "DataFrame": "SensorLocalFrame",
    }
    for number, roll in ((1, 0), (2, 90))
}


def vehicles(**settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: {"VehicleType": "SimpleFlight", **given} for name, given in settings.items()}


def camera(image_type: int, width: int, height: int) -> dict[str, Any]:
    capture = {"ImageType": image_type, "Width": width, "Height": height}
    return {"CaptureSettings": [capture], "X": 0.5, "Y": 0.0, "Z": 0.1}


@dataclass(frozen=True)
class Plan:
    """How a script is flown, and what has to happen: the vehicle flies, or images come; `endless` ones are stopped."""

    script: str
    flies: bool = False
    images: bool = False
    arguments: tuple[str, ...] = ()
    until_s: float = FLY_LIMIT_S
    endless: bool = False
    lands: bool = False  # it does nothing on the ground
    wire_s: float = WIRE_LIMIT_S  # wall time, in which scripts sleep over the wire whatever the ClockSpeed
    settings: Mapping[str, Any] = field(default_factory=dict)
    unfit: str = ""
    not_by_wire: str = ""


PLANS = (
    Plan("multirotor/add_drone.py", images=True),
    Plan("multirotor/arm.py"),
    Plan("multirotor/box.py", flies=True),
    Plan("multirotor/clock_speed.py", flies=True, until_s=60, endless=True),
    Plan("multirotor/disarm.py"),
    Plan(
        "multirotor/drone_lidar.py",
        flies=True,
        settings={"Vehicles": vehicles(Drone={"Sensors": {"Lidar1": {"SensorType": 6, "Enabled": True}}})},
    ),
    Plan("multirotor/drone_stress_test.py", until_s=120, endless=True),
    Plan("multirotor/external_physics_engine.py", flies=True),
    Plan("multirotor/gimbal.py", flies=True),
    Plan("multirotor/hello_drone.py", flies=True, images=True),
    Plan(
        "multirotor/high_res_camera.py",
        images=True,
        settings={
            "Vehicles": vehicles(
                Drone1={"Cameras": {"high_res": camera(0, 4320, 2160), "low_res": camera(0, 256, 144)}}
            )
        },
    ),
    Plan("multirotor/kinect_publisher.py", unfit="needs ROS 1"),
    Plan("multirotor/land.py", flies=True, lands=True),
    Plan("multirotor/line_of_sight.py"),
    Plan("multirotor/manual_mode_demo.py"),
    Plan(
        "multirotor/multi_agent_drone.py",
        flies=True,
        images=True,
        settings={"Vehicles": vehicles(Drone1={"X": 4, "Y": 0, "Z": -2}, Drone2={"X": 8, "Y": 0, "Z": -2})},
    ),
    Plan("multirotor/navigate.py", flies=True, images=True, until_s=30, endless=True),
    Plan("multirotor/opencv_show.py", images=True, until_s=5, endless=True),
    Plan("multirotor/orbit.py", flies=True, arguments=("--radius", "10", "--speed", "3", "--iterations", "1")),
    Plan("multirotor/path.py", flies=True, until_s=600),
    Plan("multirotor/pause_continue_drone.py", flies=True, wire_s=280),
    Plan("multirotor/point_cloud.py", images=True),
    Plan("multirotor/reset_test_drone.py"),
    Plan(
        "multirotor/sensorframe_lidar_pointcloud.py",
        until_s=5,
        endless=True,
        settings={"Vehicles": vehicles(Drone1={"Sensors": LIDARS})},
    ),
    Plan(  # it takes off if the vehicle stands on the ground, where AirSim starts it, and hovers otherwise
        "multirotor/set_fog.py", flies=True, settings={"Vehicles": vehicles(Drone={"X": 0, "Y": 0, "Z": 0})}
    ),
    Plan("multirotor/set_trace_line.py", flies=True),
    Plan("multirotor/set_wind.py", flies=True),
    Plan("multirotor/stability_test.py", flies=True, until_s=2000, not_by_wire="sleeps for 20 minutes"),
    Plan("multirotor/state.py"),
    Plan("multirotor/survey.py", flies=True, arguments=("--size", "20", "--altitude", "15"), until_s=600),
    Plan("multirotor/takeoff.py", flies=True, arguments=("12",)),
    Plan("multirotor/teleport.py", settings={"Vehicles": vehicles(PX4={})}),
    Plan(
        "multirotor/vehicleframe_lidar_pointcloud.py",
        until_s=5,
        endless=True,
        settings={"Vehicles": vehicles(Drone1={"Sensors": LIDARS})},
    ),
    Plan("computer_vision/capture_ir_segmentation.py", unfit="needs the African environment's animals"),
    Plan("computer_vision/create_ir_segmentation_map.py", unfit="needs the African environment's animals"),
    Plan("computer_vision/cv_capture.py", images=True),
    Plan("computer_vision/cv_mode.py", images=True),
    Plan("computer_vision/cv_navigate.py", images=True, until_s=60, endless=True, not_by_wire="needs SciPy 1.1"),
    Plan(
        "computer_vision/external_camera.py",
        images=True,
        settings={"ExternalCameras": {"fixed1": {"X": 0, "Y": 0, "Z": -5, "Pitch": -90}}},
    ),
    Plan("computer_vision/fov_change.py", images=True),
    Plan("computer_vision/getpos.py"),
    Plan("computer_vision/ground_truth.py", until_s=10, endless=True),
    Plan("computer_vision/image_benchmarker.py", images=True, arguments=("--time", "3")),
    Plan("computer_vision/objects.py"),
    Plan("computer_vision/seg_palette.py"),
    Plan("computer_vision/segmentation.py", images=True),
    Plan("environment/change_texture_example.py"),
    Plan("environment/create_objects.py"),
    Plan("environment/light_control.py", unfit="needs PointLightBP, a blueprint of Unreal's"),
    Plan("environment/plot_markers.py"),
    Plan("environment/unreal_console_commands.py"),
    Plan("environment/weather.py"),
    Plan(
        "eventcamera_sim/test_event_sim.py",
        images=True,
        until_s=2,
        endless=True,
        not_by_wire="numba and pandas in that environment",
    ),
    Plan(
        "reinforcement_learning/dqn_drone.py",
        flies=True,
        images=True,
        until_s=120,
        endless=True,
        not_by_wire="gym 0.21 and stable-baselines3 1",
    ),
    Plan("reinforcement_learning/dqn_car.py", unfit="drives a car"),
)


@dataclass(frozen=True)
class Result:
    """Whether a script passed, and what shows it, or why not."""

    passed: bool
    text: str


# --- under fly -------------------------------------------------------------------------------------------------


def under_fly(plan: Plan, folder: Path, scratch: Path, timing: str, profile: str) -> Result:
    """Fly a script by `uavaccel fly`, and judge the flight by what it left."""
    out = scratch / "out"
    command = [sys.executable, "-m", "uavaccel", "fly", "--out", str(out), "--until", str(plan.until_s)]
    command += ["--timing", timing, "--profile", profile, *settings_option(plan, scratch), "--seed", "0"]
    work = copied(folder, plan, scratch)
    done = run([*command, Path(plan.script).name, "--", *plan.arguments], work, FLY_LIMIT_S)
    summary_file = out / "flight.json"
    if not summary_file.exists():
        return Result(False, last_line(done[1]))
    summary = json.loads(summary_file.read_text())
    if summary["status"] != 0:
        return Result(False, last_line(done[1]))
    if summary["position_m"] is None:
        return Result(not (plan.flies or plan.images), "it calls nothing")
    path_m = path_length_m(np.load(out / TRAJECTORY)["position_m"])
    images = images_in(out / MESSAGES)
    end = "" if summary["finished"] else f"stopped after {plan.until_s:g} s"
    return judged(plan, summary["refused"], path_m, images, end)


def images_in(path: Path) -> int:
    """How many calls for images were answered with some."""
    asked, answered = set(), 0
    with path.open(encoding="utf-8") as file:
        for row in map(json.loads, file):
            if row.get("method") in ("simGetImages", "simGetImage"):
                asked.add(row["call"])
            elif row.get("answer") in asked:
                result = row.get("result")
                answered += isinstance(result, dict) and result.get("bytes", 0) > LEAST_BYTES
    return answered


# --- over the wire ---------------------------------------------------------------------------------------------


def over_the_wire(plan: Plan, folder: Path, scratch: Path, python: Path, profile: str) -> Result:
    """Fly a script by AirSim's client against a server, and judge the flight by the server's recording and words."""
    from uavaccel.airsim import VehicleClient

    settings = settings_option(plan, scratch)
    options = FlightOptions(Path(plan.script), (), scratch, profile=profile)
    file = Path(settings[1]) if settings else None
    work, log = copied(folder, plan, scratch), scratch / "server.txt"
    limit_s = max(WIRE_LEAST_S, plan.until_s / WIRE_CLOCK) if plan.endless else plan.wire_s
    with said_to(log), serving(options, WIRE_CLOCK, file, port=41451) as (port, _):
        VehicleClient(port=port).startRecording()
        command = [str(python), Path(plan.script).name, *plan.arguments]
        status, output = run(command, work, limit_s, without_windows(scratch))
    told = [line.partition("warning: ")[2] for line in log.read_text().splitlines()]
    refused = [line for line in told if "is not known" in line or "was refused" in line]
    if status not in (0, None):
        return Result(False, last_line(output))
    _, poses = recorded(scratch, (read_settings(file) if file else Settings()).vehicle)
    if not len(poses):
        return judged(plan, refused, 0.0, -1, "")
    end = f"stopped after {limit_s:g} s at {WIRE_CLOCK:g}x" if status is None else ""
    return judged(plan, refused, path_length_m(poses[:, :3]), -1, end)


@contextmanager
def said_to(log: Path) -> Iterator[None]:
    """Let what the server's teller writes on standard error go to a file."""
    before = os.dup(2)
    with log.open("w") as file:
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(before, 2)


# --- both ------------------------------------------------------------------------------------------------------


def judged(plan: Plan, refused: Sequence[str], path_m: float, images: int, end: str) -> Result:
    """`images` -1: not counted."""
    if refused:
        return Result(False, "; ".join(line.partition(": ")[0] for line in refused))
    shown = [end] if end else []
    if plan.flies:
        shown.append(f"flew {path_m:.1f} m")
    if images >= 0 and plan.images:
        shown.append(f"{images} image {'call' if images == 1 else 'calls'}")
    if end and not plan.endless:
        return Result(False, ", ".join(["did not end", *shown]))
    happened = (not plan.flies or path_m >= FLOWN_M) and (not plan.images or images != 0)
    return Result(happened, ", ".join(shown))


def without_windows(scratch: Path) -> Path:
    """A folder for PYTHONPATH that lets OpenCV show its windows nowhere: there is no display."""
    (scratch / "sitecustomize.py").write_text(NO_WINDOWS, encoding="utf-8")
    return scratch


def run(
    command: Sequence[str], folder: Path, limit_s: float, python_path: Path | None = None
) -> tuple[int | None, str]:
    """Status (None: stopped at the limit) and output of a command that somebody presses Enter for."""
    master, slave = pty.openpty()
    os.write(master, b"\n" * 200)
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    if python_path is not None:
        environment["PYTHONPATH"] = str(python_path)
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(
            command, cwd=folder, stdin=slave, stdout=output, stderr=subprocess.STDOUT, env=environment
        )
        try:
            status: int | None = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            status = None
        for end in (master, slave):
            os.close(end)
        output.seek(0)
        return status, output.read()


def copied(folder: Path, plan: Plan, scratch: Path) -> Path:
    """A copy of the script's folder: scripts write beside themselves."""
    work = scratch / "work"
    shutil.copytree(folder / Path(plan.script).parent, work / Path(plan.script).parent)
    return work / Path(plan.script).parent


def on_the_ground(plan: Plan) -> Plan:
    """The plan with every vehicle where AirSim's stands by the time that somebody has pressed a key."""
    own = plan.settings.get("Vehicles") or vehicles(SimpleFlight={})
    placed = {name: {"X": 0, "Y": 0} | given | {"Z": 0} for name, given in own.items()}
    settings = {**plan.settings, "Vehicles": placed}
    return replace(plan, settings=settings, flies=plan.flies and not plan.lands)


def settings_option(plan: Plan, scratch: Path) -> list[str]:
    if not plan.settings:
        return []
    path = scratch / "settings.json"
    path.write_text(json.dumps({"SettingsVersion": 1.2, "SimMode": "Multirotor", **plan.settings}))
    return ["--settings", str(path)]


def path_length_m(position_m: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(position_m, axis=0), axis=1).sum())


def last_line(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    wrong = [line for line in lines if "Error" in line or "error" in line]
    return (wrong or lines or ["no output"])[-1][:80]


def page(rows: Sequence[tuple[Plan, Result | None, Result | None]]) -> str:
    """The table in Markdown."""
    lines = [HEADER, "| script | `uavaccel fly` | AirSim's client over TCP |", "|---|---|---|"]
    for plan, fly, wire in rows:
        cells = [plan.unfit or cell(fly), plan.unfit or plan.not_by_wire or cell(wire)]
        lines.append("| " + " | ".join([plan.script, *(text.replace("|", "/") for text in cells)]) + " |")
    for name, results in (("fly", [row[1] for row in rows]), ("over TCP", [row[2] for row in rows])):
        tried = [result for result in results if result is not None]
        passed = sum(result.passed for result in tried)
        lines.append(f"\n{name}: {passed} of {len(tried)} pass.")
    lines.append(f"\n{made()}")
    return "\n".join(lines) + "\n"


def made() -> str:
    """What made the table: the command, the version and its commit, and the day."""
    run: Any = describe_run([], 0, "")
    commit = run["git"]["commit"][:10] + (" with changes" if run["git"]["dirty"] else "") if run["git"] else "unknown"
    what = f"uavaccel {run['versions']['uavaccel']}, commit {commit}, {date.today():%Y-%m-%d}"
    return f"Made by `{COMMAND}`:\n{what}."


def cell(result: Result | None) -> str:
    if result is None:
        return "not tried"
    return ("passes" if result.passed else "**fails**") + (f": {result.text}" if result.text else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="AirSim's PythonClient")
    parser.add_argument("--client-python", type=Path, help="a Python with airsim 1.8.1; without it no wire")
    parser.add_argument("--only", default="", help="scripts whose path contains this")
    parser.add_argument("--from-ground", action="store_true", help="begin where AirSim does, not in a hover")
    parser.add_argument("--timing", default="virtual")
    parser.add_argument("--profile", default="native")
    parser.add_argument("--page", type=Path, help="where to write the table; else to standard output")
    options = parser.parse_args()
    rows = []
    for plan in map(on_the_ground, PLANS) if options.from_ground else PLANS:
        if options.only not in plan.script:
            continue
        fly = wire = None
        if not plan.unfit:
            with tempfile.TemporaryDirectory() as scratch:
                fly = under_fly(plan, options.folder, Path(scratch), options.timing, options.profile)
            if options.client_python and not plan.not_by_wire:
                with tempfile.TemporaryDirectory() as scratch:
                    wire = over_the_wire(plan, options.folder, Path(scratch), options.client_python, options.profile)
        rows.append((plan, fly, wire))
        print(f"{plan.script}\n  fly:  {cell(fly)}\n  wire: {cell(wire)}", flush=True)
    text = page(rows)
    if options.page:
        options.page.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
