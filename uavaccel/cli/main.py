"""The command line: thin shells over plain functions, which are imported when a command runs.

Exit status: 0 done; 1 one clear line on standard error; 2 wrong usage; 130 interrupted.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from uavaccel.errors import mistake_of

app = typer.Typer(
    name="uavaccel",
    help="Fast, time-controlled quadrotor simulation, and what the acceleration costs.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Clock = Annotated[list[float] | None, typer.Option("--clock", help="ClockSpeed; repeat for several.")]
Commands = Annotated[list[str] | None, typer.Option("--command", help="adsc or tcsc; repeat for both.")]
Timing = Annotated[
    str | None, typer.Option(help="wall (measured), virtual (modelled) or lockstep (no latency).")
]
Profile = Annotated[str | None, typer.Option(help="native or airsim.")]
Seed = Annotated[int | None, typer.Option(help="Seed of every drawn number.")]
Out = Annotated[Path | None, typer.Option(help="Run directory to make; by default one in runs/.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on with the run in --out, by its own configuration.")
]
OneClock = Annotated[float | None, typer.Option("--clock", help="ClockSpeed.")]
OneCommand = Annotated[str | None, typer.Option("--command", help="adsc or tcsc.")]
Jobs = Annotated[int, typer.Option(help="Processes; above 1 not with wall.")]
Engine = Annotated[str, typer.Option(help="What flies --jobs at once: loky, ray or dask; never wall games.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Say what would be flown, and fly nothing.")]
Overrides = Annotated[list[str] | None, typer.Option("--set", help="dotted.key=value of the configuration.")]


@app.command()
def run(
    experiment: Annotated[
        str | None,
        typer.Argument(
            help="dp1, dp2, train, evaluate, rl, paper, or an experiment's YAML file; --resume needs none."
        ),
    ] = None,
    clock: Clock = None,
    command: Commands = None,
    t_move: Annotated[
        list[float] | None, typer.Option("--t-move", help="Seconds; repeat for several.")
    ] = None,
    rounds: Annotated[list[int] | None, typer.Option(help="Rounds of the path; repeat for several.")] = None,
    games: Annotated[int | None, typer.Option(help="Games per cell.")] = None,
    timing: Timing = None,
    profile: Profile = None,
    seed: Seed = None,
    seeds: Annotated[int | None, typer.Option(help="Of rl: trainings of each cell.")] = None,
    with_run: Annotated[
        str | None, typer.Option("--with", help="Of paper: a run of rl, which decides what needs training.")
    ] = None,
    jobs: Jobs = 1,
    engine: Engine = "loky",
    out: Out = None,
    resume: Resume = False,
    dry_run: DryRun = False,
    overrides: Overrides = None,
) -> None:
    """Fly an experiment, measure it and draw its figures."""
    from uavaccel.cli.run import RunRequest, run_experiment

    options = {
        "clock_speed": clock,
        "command": command,
        "t_move_s": t_move,
        "rounds": rounds,
        "games": games,
        "timing": timing,
        "profile": profile,
        "seed": seed,
        "seeds": seeds,
        "with_run": with_run,
    }
    request = RunRequest(experiment, options, overrides or [], jobs, out, resume, dry_run, engine=engine)
    run_experiment(request)


@app.command()
def report(
    run_dirs: Annotated[list[Path], typer.Argument(help="Run directories.")],
) -> None:
    """Compute the metrics and draw the figures of finished runs again.

    Several trainings are also drawn side by side, in the first one's folder; so are several evaluations.
    """
    from uavaccel.cli.report import report_runs

    report_runs(run_dirs)


@app.command()
def view(
    source: Annotated[
        str, typer.Argument(help="Run directory of dp2, evaluate or train; a policy's folder.")
    ] = "default",
    case: Annotated[
        str | None, typer.Option(help="Which game, as rows.jsonl names it; by default the fastest, or best.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder; by default view/ in the run directory.")] = None,
    events: Annotated[
        Path | None,
        typer.Option(help="Instead, a file of the game's events: .h5 in DSEC's layout, or .npz."),
    ] = None,
    events_rate_hz: Annotated[
        float, typer.Option(min=0.1, help="Frames per simulated second of the camera that sees them.")
    ] = 100.0,
) -> None:
    """Show a game: an MP4 of camera, DVS, map, the view from behind and a policy's decisions, and a contact sheet."""
    from uavaccel.cli.view import view_events, view_game

    if events is not None:
        view_events(source, case, events, events_rate_hz)
    else:
        view_game(source, case, out)


@app.command()
def calibrate(
    out: Annotated[Path, typer.Option(help="YAML file to write.")] = Path("latency.yaml"),
    commands: Annotated[int, typer.Option(help="Commands of each kind to fly, about.")] = 1500,
    profile: Annotated[str, typer.Option(help="native or airsim.")] = "native",
    check: Annotated[
        bool, typer.Option("--check", help="Fly the same games on both clocks, and compare; writes nothing.")
    ] = False,
    latency: Annotated[Path | None, typer.Option(help="Of --check: the model; else the shipped one.")] = None,
    games: Annotated[int, typer.Option(help="Of --check: games of each kind.")] = 20,
) -> None:
    """Measure this machine's message latencies for the virtual timing to draw from, or check a model of them."""
    from uavaccel.cli.calibrate import show_agreement, write_calibration

    if check:
        show_agreement(latency, profile, games)
    else:
        write_calibration(out, commands, profile)


@app.command()
def advise(
    t_move: Annotated[float, typer.Option("--t-move", help="Seconds of a command.")] = 1.0,
    error: Annotated[float, typer.Option(help="Metres that a trajectory may be off.")] = 0.1,
    rounds: Annotated[int, typer.Option(help="Rounds of the square path.")] = 4,
    latency: Annotated[
        Path | None, typer.Option(help="Latency model; `calibrate` writes one. Without it the shipped one.")
    ] = None,
    profile: Annotated[str, typer.Option(help="native or airsim.")] = "native",
) -> None:
    """Say how fast ADSC may fly within an error, and what TCSC would gain."""
    from uavaccel.cli.advise import AdviceRequest, show_advice

    show_advice(AdviceRequest(t_move, error, rounds, latency, profile))


@app.command()
def train(
    experiment: Annotated[
        str | None, typer.Argument(help="An experiment's YAML file; --resume needs none.")
    ] = None,
    clock: OneClock = None,
    command: OneCommand = None,
    timing: Timing = None,
    profile: Profile = None,
    games: Annotated[int | None, typer.Option(help="Games to learn from.")] = None,
    seed: Seed = None,
    out: Out = None,
    resume: Resume = False,
    dry_run: DryRun = False,
    overrides: Overrides = None,
) -> None:
    """Train a policy in the obstacle lane: `run` on a training's YAML file."""
    from uavaccel.cli.run import RunRequest, run_experiment

    options = _task_options(clock, command, timing, profile) | {"games": games, "seed": seed}
    named = experiment or (None if resume else "train")
    run_experiment(RunRequest(named, options, overrides or [], 1, out, resume, dry_run, "train"))


@app.command()
def evaluate(
    agent: Annotated[
        str | None,
        typer.Argument(
            help="A training's run directory, a policy's folder, straight or offset:METRES; else the policy that ships."
        ),
    ] = None,
    games: Annotated[int | None, typer.Option(help="Evaluation lanes; 300 without it.")] = None,
    clock: OneClock = None,
    command: OneCommand = None,
    timing: Timing = None,
    profile: Profile = None,
    seed: Seed = None,
    jobs: Jobs = 1,
    engine: Engine = "loky",
    against: Annotated[
        Path | None, typer.Option(help="Another evaluation, compared on the same lanes.")
    ] = None,
    films: Annotated[bool, typer.Option(help="Film the best and the worst game.")] = True,
    sweep: Annotated[
        list[str] | None,
        typer.Option(help="NAME=VALUE,VALUE,... flown one at a time, as in wind=0,3,6; repeatable."),
    ] = None,
    out: Out = None,
    resume: Resume = False,
    dry_run: DryRun = False,
    overrides: Overrides = None,
) -> None:
    """Fly an agent on lanes that no training has seen, `run evaluate`: success ratio, Figure 8, films."""
    from uavaccel.cli.evaluate import evaluate_agent, sweep_agent
    from uavaccel.cli.run import RunRequest

    options = _task_options(clock, command, timing, profile) | {"games": games, "seed": seed, "agent": agent}
    named = None if agent is None and resume else "evaluate"
    request = RunRequest(named, options, overrides or [], jobs, out, resume, dry_run, "evaluate", engine)
    if sweep:
        sweep_agent(request, sweep, against)
    else:
        evaluate_agent(request, against, films)


def _task_options(
    clock: float | None, command: str | None, timing: str | None, profile: str | None
) -> dict[str, object]:
    return {"clock_speed": clock, "command": command, "timing": timing, "profile": profile}


@app.command()
def export(
    source: Annotated[
        str, typer.Argument(help="A policy's folder or default, for --onnx; a run directory for tables.")
    ],
    onnx: Annotated[
        Path | None, typer.Option(help="ONNX file of the policy with its pre-processing.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Folder for the run's rows and samples as CSV.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="Folder for the same as Parquet.")] = None,
) -> None:
    """Write a policy as ONNX, or a run as tables."""
    from uavaccel.cli.export import export as export_source

    export_source(source, onnx, csv, parquet)


@app.command()
def bench(
    names: Annotated[list[str] | None, typer.Argument(help="Which; all if none is named.")] = None,
    soak_s: Annotated[float, typer.Option("--soak-s", help="Also load a server for so many seconds.")] = 0.0,
    out: Annotated[Path | None, typer.Option(help="JSON file to keep the measurements in.")] = None,
    lanes: Annotated[
        list[int] | None, typer.Option(min=1, help="Of `batch`: so many lanes, 8 otherwise; repeatable.")
    ] = None,
    processes: Annotated[
        int | None, typer.Option(min=1, help="Of `batch`: over so many processes; otherwise the cores.")
    ] = None,
    tiles: Annotated[
        int | None, typer.Option(min=1, help="Of `batch`: pictures drawn at once; otherwise the lanes.")
    ] = None,
    renderer: Annotated[str, typer.Option(help="Of `batch`: shared, own or auto.")] = "shared",
) -> None:
    """Measure this machine: hot loop, round trips, TCSC, rendering."""
    from uavaccel.bench.batch import BatchSize
    from uavaccel.cli.bench import run_benches

    run_benches(names or [], soak_s, out, BatchSize(tuple(lanes or [8]), processes, tiles, renderer))


@app.command()
def serve(
    settings: Annotated[Path | None, typer.Option(help="AirSim's settings.json.")] = None,
    clock: Annotated[float | None, typer.Option(help="ClockSpeed; otherwise the settings', or 1.")] = None,
    port: Annotated[
        int | None, typer.Option(help="Otherwise the settings', or 41451; 0: any free one.")
    ] = None,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on; without it never beyond this machine.")
    ] = None,
    profile: Annotated[str, typer.Option(help="native or airsim.")] = "native",
    scene: Annotated[str, typer.Option(help="A scene of assets/mjcf.")] = "blocks",
    recordings: Annotated[
        Path | None,
        typer.Option(
            help="Folder for what startRecording records; otherwise the settings', or ~/Documents/AirSim."
        ),
    ] = None,
) -> None:
    """Serve AirSim's clients: a free-running quadrotor, until Ctrl-C."""
    from uavaccel.cli.serve import ServeOptions
    from uavaccel.cli.serve import serve as serve_clients

    serve_clients(ServeOptions(settings, clock, port, host, profile, scene, recordings))


@app.command(context_settings={"allow_interspersed_args": False})
def fly(
    script: Annotated[Path, typer.Argument(help="An AirSim script in Python.")],
    arguments: Annotated[list[str] | None, typer.Argument(help="The script's own arguments.")] = None,
    clock: Annotated[
        str | None,
        typer.Option(help="ClockSpeed, or several with commas: 1,10,100; otherwise the settings'."),
    ] = None,
    timing: Annotated[
        str, typer.Option(help="wall (measured), virtual (modelled) or lockstep (no latency).")
    ] = "virtual",
    check: Annotated[
        bool, typer.Option("--check", help="Fly twice, and compare messages and trajectory to the byte.")
    ] = False,
    until: Annotated[
        float | None,
        typer.Option(min=0.0, help="Stop the script after so many simulated seconds, pauses included."),
    ] = None,
    think: Annotated[
        float, typer.Option(min=0.0, help="Wall seconds that the script takes before each call.")
    ] = 0.0,
    seed: Annotated[int | None, typer.Option(help="Of Python's and NumPy's global generators.")] = None,
    settings: Annotated[Path | None, typer.Option(help="AirSim's settings.json.")] = None,
    profile: Annotated[str, typer.Option(help="native or airsim.")] = "native",
    scene: Annotated[str, typer.Option(help="A scene of assets/mjcf.")] = "blocks",
    out: Annotated[Path | None, typer.Option(help="Folder to make for trajectory and messages.")] = None,
    film: Annotated[bool, typer.Option("--film", help="Film the front camera's view, into --out.")] = False,
) -> None:
    """Fly an unmodified AirSim script, on a simulated clock: fast, headless, and the same every time.

    Options come before the script, its own arguments after it.
    """
    from uavaccel.cli.fly import FlyRequest, fly_script, parse_clocks
    from uavaccel.fly.options import FlightOptions

    flight = FlightOptions(
        script,
        tuple(arguments or ()),
        folder=Path(),
        timing=timing,
        profile=profile,
        scene=scene,
        settings=settings,
        think_s=think,
        seed=seed,
        until_s=until,
        film=film,
    )
    fly_script(FlyRequest(flight, parse_clocks(clock), check, out))


@app.command()
def init(folder: Annotated[Path, typer.Argument(help="A new or an empty one.")]) -> None:
    """Write a commented training and a task of one's own to begin with."""
    from uavaccel.cli.starter import init as write_starter

    write_starter(folder)


@app.command()
def schema(
    suite: Annotated[str, typer.Argument(help="As the key `suite` of a YAML file names it.")],
) -> None:
    """Print the JSON schema of a suite's YAML files, for editors."""
    from uavaccel.cli.starter import schema_text

    print(schema_text(suite), end="")


@app.command()
def doctor() -> None:
    """Look at this machine: versions, timers, hot loop, who draws the images."""
    from uavaccel.cli.doctor import examine

    examine()


def main() -> None:
    """Entry point: a user's mistake is one line, never a traceback."""
    _open_closed_streams()
    try:
        status = app(sys.argv[1:] or ["--help"], prog_name="uavaccel", standalone_mode=False)
        sys.stdout.flush()
    except (KeyboardInterrupt, typer.Abort):
        status = _complain("interrupted", 130)
    except typer.Exit as error:
        status = error.exit_code
    except SystemExit:  # how the command line's own library ends where nobody reads what is printed
        status = _complain("standard output was closed", 1)
    except Exception as error:
        status = _status_of(error)
    _leave_unread_output()
    sys.exit(status if isinstance(status, int) else 0)


def _status_of(error: Exception) -> int:
    """Print the one line of a mistake; its exit status. Raises the error where it is none of the user's."""
    if hasattr(error, "format_message"):  # one of the command line's own
        return _complain(error.format_message(), 2)
    mistake = mistake_of(error)
    if mistake is None:
        raise error
    return _complain(str(mistake), mistake.exit_status)


def _complain(message: str, status: int) -> int:
    line = " ".join(message.split("\n"))
    with contextlib.suppress(OSError):
        print(f"uavaccel: error: {line}" if status != 130 else f"uavaccel: {line}", file=sys.stderr)
    return status


def _open_closed_streams() -> None:
    """A stream that was closed before we began leaves its number to the next file: into which all would be printed."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)
            if descriptor != number:
                os.dup2(descriptor, number)
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w"))


def _leave_unread_output() -> None:
    """What cannot be printed is dropped here, else the interpreter would complain of it at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
