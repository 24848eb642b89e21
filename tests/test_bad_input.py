"""What cannot be meant is refused before anything is flown or written: one line, which names the key or option.

`{...}` in a command line is a file of that text, whose name stands there.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, cast

import pytest
import typer.main

from tests.golden import assert_as_recorded
from uavaccel.cli import main as cli

LAUGHS = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{name}: &{name} [{','.join(['*' + before] * 10)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)  # fmt: skip

# What belongs together and does not fit.
COMBINATIONS = """
run ablation --set variants=[{name: a, changes: {latency.platform.tik_us: 1.0}}]
run ablation --set variants=[{name: a}, {name: a}]
run ablation --set variants=[]
run ablation --set base.rounds=[0]
run sweep --set sweep={wind: [99]}
run sweep --set sweep={wind: [1, 1.0]}
run sweep --set sweep={wind: []}
run sweep --set sweep={nothing: [1]}
run sweep --set sweep={task.nothing: [1]}
run sweep --set sweep={command: [fly]}
run robustness --set latency_scale=[-1]
run robustness --set latency_scale=[1, 1]
run robustness --set evaluation.keys={task.histry: 1}
run robustness --set evaluation.experiment=dp1
run dp2 --set dvs_rate_hz=100 --set reference_timing=wall
run dp2 --set lane=nowhere.yaml
run robustness --set agent="a\\0b"
run robustness --set agent=nowhere
train --set task.timing=wall --set environments=2
train --set algorithm=sb3_ppo --set start_from=default
train --set algorithm=sb3_dqn --set mirror=false --set mirrored_decisions=true
train --set task.observation=state
train --set task.headings_deg=[0.0, 30.0]
train --set gamess=3
evaluate straight --set simulator=kernels --set task.timing=wall
evaluate straight --set simulator=kernels --set task.timing=lockstep --set environments=2
evaluate straight --set device=cuda
evaluate straight --set simulator=airsim
evaluate straight --set environments=2 --set task.timing=wall
evaluate straight --set first_lane=999_999 --set games=2
"""

# By command: a key and the values that it refuses, whose complaint has the key's last word.
CONFIGURATIONS = {
    "run dp1 --set": """
games = 0 | -1 | 1.5 | 10000000000000000000000000000000 | 1e9 | yes | many | [3] | null
reference_games = 0 | -3 | 1000000000000 | {}; rounds = [0] | [-1] | [1000000000000] | [1,1] | [] | [1.5] | 4 | [four]
clock_speed = [0] | [-1] | [1e308] | [1e-9] | [.nan] | [.inf] | [] | [1,1] | fast | [true]
t_move_s = [0] | [-1] | [1e308] | [1e-9] | [0.0033] | [] | [.nan] | [1e9] | long
t_sample_s = 0 | -0.1 | 1e-9 | 0.0033 | .inf | [1]; speed_m_s = 0 | -1 | 1e308 | 1e6 | .nan | [1]
height_m = 1e308 | -1e9 | .inf | up | 1000 | 0 | -9000
path = [] | circle | [[1,2]] | [[1e308,0,0]] | [[1,2,.nan]] | 3; t_th_wall_s = -1 | 1e308 | .nan | 1e9
seed = -1 | 1.5 | zero | true; command = [adsx] | [] | [adsc,adsc] | adsc; timing = real | 3 | [wall]
profile = unreal | [native]; reference_timing = never; latency = nowhere.yaml | 3 | [1] | {request_us: 3}
latency.scale = -1 | 1e308 | .nan | 1e12; latency.request_us.cal = [0,0,0,0,0,0,0,0,0,0,0,0]
latency.reply_us.call = [0,1] | [0,0,0,0,0,0,0,0,0,0,0,1e300] | slow | [1,0,0,0,0,0,0,0,0,0,0,0]
latency.reply_us.move = -1 | 1e308 | .nan | true | 1e300; latency.reply_us.mvoe = 2
latency.request_us.pause = [1]; latency.issue_us = [0,0,0,0,0,0,0,0,0,0,0,1e300] | [-1,0,0,0,0,0,0,0,0,0,0,0]
latency.platform.tick_us = -1 | 1e308 | 1e30; latency.platform.stall_us = 1e300
latency.platform.frames.hz = -1 | 1e300 | 1e-300; latency.platform.goal_timeout_s = 0 | 1e300
latency.platform.faults.late_us = 1e300; latency.platform.faults.dropped = 2 | -0.1
latency.platform.faults = {dropped: .9, stalled: .9} | {dropped: .5, stalled: .3, late: .3}; gamess = 3
suite = dp9 | [dp1] | {} | 3 | no_such_module:Suite | os:path | null
""",
    "run dp2 --set": """
lane = -1 | [1] | {seed: -1} | {seed: 1, obstacles: []} | {obstacles: 3} | 1.5; lane.seed = 3
path = [] | [[1]] | [[1e308,0]] | straight
height_m = 0 | 3 | -1e9 | -1e308 | .nan; t_move_s = 0 | 1e-9 | 1e308 | 0.0033; t_sample_s = 0 | -1 | 0.0033 | 1e308
dvs_rate_hz = 0 | 333.7 | 1e9 | -1; dvs_preset = loud; sensor_seed = -1; guard.max_retries = -1 | 1000000000000
guard.max_change = -0.1 | .nan; guard.min_bright = 3; perturbation.share = 1.1 | -1; perturbation.kinds = [] | [burnt]
perturbation.half_excess = 0
""",
    "train --set": """
games = 0 | 1000000000000000000000000000000 | 2.5; environments = 0 | -1 | 1000000000 | two
turns = 0 | 9 | 1000000000; torch_threads = 0 | 1000000000 | -1; checkpoint_games = 0 | -250
channels = [] | [0] | [-3] | [16,32,64,64,64,64] | [1000000000] | 16 | [wide] | [65536,65536,65536,65536] | [1025]
task.headings_deg = [0,0] | [] | [.nan] | [1e308,-1e308] | north
task.randomise = {share: 0.5} | {widen_over_games: 3} | {wind_m_s: [3, 0]}; task.randomise.wind_m_s = [0, 1e9]
task.dvs_rate_hz = 1e-9 | 1 | 0.5 | 0 | 333.7 | 1e9
hidden = [8193] | [1,1,1,1,1,1,1,1,1] | [0] | [-1] | [1000000000000] | [256,wide]
algorithm = alphazero | sac | 3 | os; device = tpu | '' | 3 | meta; inference_s = -1 | 1e308 | 1e12
learning_s = -1 | 1e308; final_learning_rate_share = -0.1 | 1.5; commands_per_gradient_step = 0 | 0.5
options.buffer_size = 0 | 10000000000000 | lots; options.batch_size = 0 | 10000000000000
options.learning_rate = 0 | -1 | 1e308; options.learning_starts = -1; options.n_steps = 0 | 1000000000000
options.gamma = 1.1 | -1; options.exploration_fraction = 2 | -0.1; options.learning_tempo = 1; options = 3 | [1]
mirror = maybe; task.speed_m_s = 0 | -1 | 1e308 | 1e6 | .nan; task.altitude_m = 0 | -2 | 1e308 | 1e6
task.max_commands = 0 | -1 | 1000000000000; task.clock_speed = 0 | 1e308 | 1e-9 | [1]
task.t_move_s = 0 | 1e-9 | 1e308; task.t_sample_s = 0 | 0.0033; task.t_th_wall_s = -1 | 1e308; task.history = 0 | 9
task.observation = lidar | 3; task.knows = [wind] | [last_action,last_action]
task.progress_reward = .nan | 1e308 | much; task.image_processing_s = -1 | 1e308; task.split = test
task.lane = [1] | 7; task.difficulty.obstacles_per_row = 5 | -1; task.difficulty.row_spacing_m = 0 | 1e308
task.difficulty.first_row_m = 0.5 | 1e308; task.difficulty.wind_m_s = 21 | -1; task.difficulty.half_width_m = 0 | 3
task.difficulty.light = [0] | [1,2] | [1,0.5] | dark; task.difficulty.min_gap_m = 0.1 | 1e308
task.difficulty.texture = 1; task.difficulty.texture_variation = 1.1 | -0.1; task.difficulty.mass_ratio = 0.4 | 1.6
task.difficulty.thrust_ratio = 0.6 | 1.6
""",
    "train --set algorithm=sb3_ppo --set": "options.buffer_size = 100",
    "train --set algorithm=sb3_ppo --set mirror=false --set": "options.n_steps = 0 | many | 10000000000000",
    "train --set algorithm=sb3_dqn --set mirror=false --set": "options.buffer_size = 10000000000000",
    "train --set algorithm=sb3_a2c --set mirror=false --set": "options.learning_tempo = 1",
    "train --set mirror=false --set": "task = 3 | [] | lanes",
    "evaluate straight --set": """
games = 0 | 1000001 | 1000000000000000000000000000000; first_lane = -1 | 1000000 | 999999
environments = 0 | 1000000000; inference_s = -1 | 1e308; agent = 3 | [straight]
""",
    "evaluate default --set": """
task.observation = colour | state; task.history = 1; task.headings_deg = [0]
""",
    "run robustness --set": "latency_scale = [-1] | [1e308] | [] | [0,0]; games = 0 | 1000000000000",
    "run rl --set": """
seeds = 0 | 1000000000000; games = 0 | 1000000000000000000000000000000; evaluation_clock_speed = 0 | 1e308
command = [none]; training.task.latency.scale = 2
""",
    "run ablation --set": "variants = [] | 3; base = 3 | {gamess: 3}",
    "run paper --set": "parts = {} | {dp9-native: {experiment: dp1}}; claims = nowhere.yaml",
}
OTHERS = [
    "train --set task.lane={obstacles: [], wind_m_s: [1e9, 0, 0]}",
    "train --set task.lane={obstacles: [], wind_m_s: [0, 0]}",
    "train --set task.lane={obstacles: [{x_m: 0.1, y_m: 0, radius_m: 1}]}",
    "run dp2 --set lane={obstacles: [{x_m: 0.1, y_m: 0, radius_m: 1}]}",
    "run dp2 --set lane={obstacles: [], wind_m_s: [1e9, 0, 0]}",
    "train --set options={batch_size: 100, buffer_size: 99}",
    f"train --set task.headings_deg={[*range(-180, 181)]}",
    *("train --set task.lane=nowhere.yaml", "run dp2 --set lane=nowhere.yaml", "run robustness --set agent=nowhere"),
    *(f"evaluate straight --set agent={name}" for name in ("x", "offset:inf", "offset:left", "offset:11")),
    "run paper --set with_run=nowhere",
    *(f"{command} --set task={name}" for command in ("train", "evaluate") for name in ("'so'", 3)),
    *(f"run dp1 --out {'x' * 300}", f"run dp1 --games 1{'0' * 400}"),
    *("run nowhere.yaml", "run nowhere", "train nowhere.yaml"),
]

# What the file of an experiment holds.
FILES = [
    *("suite: [dp1]", "suite: evaluate\ntask: 3", "suite: train\ntask: 3", "suite: train\nmirror: false\ntask: [1, 2]"),
    "suite: train\nenv_id: uavaccel/Gates-v0\ntask: hover",
    *("games: 3", "", "3", "- dp1", "suite: dp1\nsuite: dp2", "suite: 'dp1", "\x00", "? [a]\n: b"),
    *("suite: !!python/object/apply:os.system ['true']", LAUGHS + "suite: dp1\nclock_speed: *i"),
    *("suite: " + "[" * 100_000, "suite: dp1\ngames: " + "9" * 5000, "suite: dp1\n1: 2", "suite: ':'"),
    *("suite: ':Suite'", "suite: 'json:'", "suite: '..json:loads'", "suite: 'json:loads'"),
    *("suite: 'uavaccel.suites.suite:Suite'", "suite: 'uavaccel.units:.x'", "suite: dp1\n\tgames: 2"),
    *(f"suite: dp1\n{line}" for line in ("seed: !!timestamp 2020-01-01", "path: !!set {a, b}", "games: !!binary aGk=")),
    *(f"suite: dp1\npath: !!{kind} [a: 1]" for kind in ("omap", "pairs")),
    "suite: dp1\n---\nsuite: dp2",
]

# Command lines.
OPTIONS = """
run; run dp1 --jobs 0; run dp1 --jobs -1; run dp1 --jobs 1000000000; run dp1 --jobs 1000 --timing virtual
evaluate straight --jobs 1000; run dp1 --jobs 2 --timing wall; run train --jobs 2; run dp1 --jobs two
run dp1 --clock fast; run dp1 --clock 0; run dp1 --clock nan; run dp1 --clock inf; run dp1 --rounds 0
run dp1 --t-move 0; run dp1 --games -1; run dp1 --command tcsc --command fly; run dp1 --seeds 2; run dp1 --with x
run dp2 --rounds 2; run train --clock 1 --clock 2; run dp1 --set games; run dp1 --set =3; run dp1 --set .games=3
run dp1 --set games.=3; run dp1 --set games.more=3; run dp1 --set clock_speed.5=3; run dp1 --set games=[
run dp1 --set games={a:&a,b:*a}; run dp1 --speed 3; run dp1 dp2; run dp1 --out .; run dp1 --out there.txt
run dp1 --out there.txt/run; run dp1 --resume --out there.txt; watch --host nowhere.invalid; watch --host=
serve --host=; serve --recordings there.txt; run --resume; run dp1 --resume; train --resume
run --resume --out nowhere; run --out nowhere; train --resume --out nowhere; train --games 0; train --clock -1
train --profile unreal; train --timing soon; evaluate nowhere; evaluate offset:nan; evaluate offset:1e308
evaluate straight --against nowhere; evaluate straight --jobs 0; evaluate straight --seed -1
evaluate --resume --out nowhere; run --report nowhere; run --report; run --report nowhere --games 3; watch nowhere
watch nowhere --film f.mp4; watch default --film f.mp4 --case lane; watch default --case lane-000007 --game 3
watch default --seed 0; watch default --film f.mp4 --port 9; watch default --film f.mp4 --case lane-9999999
watch default --film f.png; watch --film f.mp4; report nowhere; view; advise; schema train; calibrate; init
timing calibrate --commands 0; timing calibrate --commands -5; timing calibrate --commands 1000000000000
timing calibrate --profile unreal; timing calibrate --out nowhere/latency.yaml; timing calibrate --out there.txt
timing calibrate --check --games 0; timing calibrate --check --profile unreal
timing calibrate --check --latency nowhere.yaml; timing advise --t-move 0; timing advise --t-move 0.333
timing advise --t-move nan; timing advise --profile airsim --t-move 0.003; timing advise --t-move 1e308
timing advise --t-move 86400 --thinking 86400; timing advise --error inf
timing advise --error 0; timing advise --error nan; timing advise --rounds 0; timing advise --rounds 1001
timing advise --profile unreal; timing advise --latency nowhere.yaml; timing advise --thinking 0
timing advise --thinking nan; bench nothing; bench --soak-s -1; bench --soak-s nan; bench batch --lanes 0
bench hot-loop --out nowhere/bench.json; serve --clock 0; serve --clock nan; serve --port 99999; serve --port -1
serve --speed 3; serve --clock fast; serve --host nowhere.invalid; serve --profile unreal; serve --scene moon
serve --settings nowhere.json; serve --settings there.txt; doctor --all; fly; fly --seed -1 there.txt
fly --seed 4294967296 there.txt; fly --think inf there.txt; fly --think nan there.txt; fly --think -1 there.txt
fly --until nan there.txt; fly --until inf there.txt; fly --clock 1e9 there.txt; fly --clock 1,inf there.txt
fly --clock nan there.txt; fly --clock 1,0 there.txt; fly --timing wall --think 0 there.txt
fly --timing wall --film there.txt; fly --check --timing wall there.txt; fly --check --clock 1,2 there.txt
fly --clock 1,1 there.txt; fly --clock 1,1.0000001 there.txt; export default --csv=
export default --mcap= --csv there; run dp1 --out=; train dp1; train dp2 --dry-run; train rl
evaluate straight --sweep wind=0 --sweep wind=3; evaluate straight --sweep wind=0 --against x; watch --case a --game 1
watch run --clock 5; watch run --think 1; watch run --seed 1; watch run --film f.mp4 --host ::1
watch run --film f.mp4 --port 9; watch --case a; watch --game 0; watch run --film f.avi; watch . --film f.mp4
watch flown --film f.mp4; watch filmed --film f.mp4; export flown --csv f
export .; export . --csv f --case a; export . --csv f; export nowhere --onnx f.onnx; timing advise --thinking 90000
timing advise --t-move 0.001; timing certify p.onnx CartPole-v1 --latency a --latency b
timing certify p.onnx CartPole-v1 --latency a --latency 1; timing certify p.onnx CartPole-v1 --factor 2
timing certify p.onnx CartPole-v1 --delay 2 --latency 0.1; timing certify p.onnx CartPole-v1 --latency nan
timing certify p.onnx CartPole-v1 --latency p.json --factor nan; timing certify p.onnx CartPole-v1 --delay 3601
timing certify p.onnx CartPole-v1 --set env=2; timing certify p.onnx CartPole-v1 --set chnk=2
timing certify default CartPole-v1 --delay 1; timing certify there.py:act none.such:CartPole-v1 --delay 1
timing measure there.py:act CartPole-v1 --out there.py; timing calibrate --out there.py; timing nothing; init .
init --schema nothing; run --report .; run --report runs/a --jobs 1 --set a=1; run --resume --out .
run train --clock 5 --clock 10 --dry-run; run dp1 --clock 5 --clock x; run dp1 --with .; run dp1 --seeds 3
run dp1 --set clock_speed.0=5; run dp1 --set clock_sped=5; evaluate --watch --set simulator=kernels; evaluate --resume
evaluate given.yaml --sweep wind=1; evaluate straight --sweep wind=1 --against .; evaluate straight --sweep wind
evaluate straight --sweep wind=1 --sweep wind=2; evaluate straight --against .; evaluate straight --command both
evaluate train --dry-run --set suite=train; train --seeds 0; train --seed 1.5; train --set games
train --set task.clock_sped=2; train --set task.t_move_s=1.001
train --set task.history=2 --clock 2 --set task.t_move_s=1.001; train --out=; report .; view .; schema dp1; flow
"""


def beyond(option: Any) -> list[str]:
    """What an option refuses: numbers next to its bounds, and a word that it does not know."""
    ends = [(option.min, -1), (option.max, 1)] if hasattr(option, "min") else []
    numbers = [str(end + step) for end, step in ends if end is not None]
    kind = option.type_descriptor.annotation
    return [*numbers, *["x"] * (kind in (int, float) or "|" in (option.metavar or ""))]


def of_each_option() -> Iterator[list[str]]:
    """Yield a command's lines with one of its options."""
    top = cast(Any, cli.app).commands
    for name, command in {**top, **{f"timing {name}": each for name, each in top["timing"].commands.items()}}.items():
        given = " ".join("x" for each in command.params if each.param_type_name == "argument" and each.required)
        options = [each for each in command.params if each.param_type_name == "option" and not each.is_flag]
        yield [f"{name} {each.opts[0]} {value} {given}" for each in options for value in beyond(each)]


def table() -> Iterator[list[str]]:
    """Yield command lines, a few at a time."""
    for command, text in CONFIGURATIONS.items():
        entries = [entry.partition(" = ") for entry in text.strip().replace("\n", "; ").split("; ")]
        yield [f"{command} {key}={value}" for key, _, values in entries for value in values.split(" | ")]
    yield from of_each_option()
    yield from (
        [*lines] for _, lines in groupby(OPTIONS.strip().replace("\n", "; ").split("; "), lambda line: line[:5])
    )
    yield from (COMBINATIONS.strip().splitlines(), OTHERS, [f"run {{{text}}}" for text in FILES])


class Flown(Exception):
    """Something would have been flown, measured, served or written."""


@pytest.fixture(scope="module", autouse=True)
def _nothing_flies() -> Iterator[None]:
    """What every command does after its checks."""
    patch = pytest.MonkeyPatch()
    patch.setattr(cli, "app", typer.main.get_command(cli.app))  # made once, and not at each call

    def flown(*arguments: object, **keywords: object) -> None:
        raise Flown

    for place in (
        "uavaccel.suites.session.manifest_of",
        "uavaccel.fly.command.fly",
        "uavaccel.calibration.calibrate.measure",
        "uavaccel.calibration.doctor.check_machine",
        "uavaccel.calibration.calibrate.check_agreement",
        "uavaccel.calibration.calibrate.advise",
        "uavaccel.suites.evaluate_again.flight_of_agent",
        "benchmarks.__main__.check_machine",
        "uavaccel.wire.server.Server.serve",
    ):
        patch.setattr(place, flown)
    yield
    patch.undo()


OF_THE_MACHINE = re.compile(
    r"\d+ on this machine's \d+ cores|(?<=nowhere\.invalid:\d{4}: )[^;]+|(?<=invalid:41451: )[^;]+"
)


def words(line: str, folder: Path) -> list[str]:
    """Of a command line; the text in braces after `run` becomes a file, the last `--set` takes the rest of the line."""
    if line.startswith("run {"):
        (folder / "given.yaml").write_text(line[5:-1])
        return ["run", "given.yaml"]
    head, setting, value = line.rpartition("--set ")
    return [*head.split(), "--set", value] if setting and " --" not in value else line.split()


def test_bad_input_is_one_line_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The lines are recorded with the exit status of each."""
    monkeypatch.chdir(tmp_path)
    for name in ("flown", "filmed"):
        (tmp_path / name).mkdir()
    flights = ("flown/trajectory.npz", "filmed/trajectory.npz", "filmed/film.mp4")
    for name in ("there.txt", "there.py", "given.yaml", *flights):
        (tmp_path / name).write_text("def act(seen): ...")
    before = sorted(tmp_path.rglob("*"))

    def told(line: str) -> str:
        monkeypatch.setattr(sys, "argv", ["uavaccel", *words(line, tmp_path)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        complaint = capsys.readouterr().err
        assert complaint.startswith("uavaccel: error: "), line
        assert (complaint.count("\n"), len(complaint) < 1000) == (1, True), line
        assert sorted(tmp_path.rglob("*")) == before, line
        assert ended.value.code in (1, 2), line
        return f"{ended.value.code} {OF_THE_MACHINE.sub('OURS', complaint[17:-1]).replace(str(tmp_path), 'HERE')}"

    assert_as_recorded("complaints", "".join(" | ".join(map(told, lines)) + "\n" for lines in table()))


@pytest.mark.parametrize("number", ["-1", "0"])
def test_threads_that_numba_cannot_have_are_one_line(
    number: str, said: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", number)
    assert said("doctor").startswith(f"NUMBA_NUM_THREADS={number}: must be at least 1;")
