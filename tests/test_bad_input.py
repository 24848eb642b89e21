"""What cannot be meant is refused before anything is flown or written: one line, which names the key or option.

The table is of command lines; `{...}` is a file of that text, whose name stands in the command line.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import typer

from uavaccel.cli import main as cli

LAUGHS = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{name}: &{name} [{','.join(['*' + before] * 10)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)  # fmt: skip

# What belongs together and does not fit: a line of the command, and what is said of it.
COMBINATIONS = """
run ablation --set variants=[{name: a, changes: {latency.platform.tik_us: 1.0}}] -> 'tick_us'
run ablation --set variants=[{name: a}, {name: a}] -> has a twice
run ablation --set variants=[] -> variants
run ablation --set base.rounds=[0] -> base: rounds
run sweep --set sweep={wind: [99]} -> task.difficulty.wind_m_s = 99
run sweep --set sweep={wind: [1, 1.0]} -> each once
run sweep --set sweep={wind: []} -> needs values
run sweep --set sweep={nothing: [1]} -> is unknown
run sweep --set sweep={task.nothing: [1]} -> --sweep task.nothing: uavaccel/ObstacleLane-v0 has no task.nothing; known:
run sweep --set sweep={command: [fly]} -> task.command
run robustness --set latency_scale=[-1] -> latency_scale.0 = -1: should be greater than or equal to 0
run robustness --set latency_scale=[1, 1] -> has 1 twice
run robustness --set evaluation.keys={task.histry: 1} -> unknown key 'task.histry'
run robustness --set evaluation.experiment=dp1 -> dp1
run dp2 --set dvs_rate_hz=100 --set reference_timing=wall -> dvs_rate_hz needs timing and reference_timing virtual
run dp2 --set lane=nowhere.yaml -> --set: lane: nowhere.yaml: No such file
run robustness --set agent="a\\0b" -> the name of a file has a null byte in it
run robustness --set agent=nowhere -> nowhere: holds no policy
train --set task.timing=wall --set environments=2 -> environments must be 1 with timing wall
train --set algorithm=sb3_ppo --set start_from=default -> start_from needs algorithm double_dqn, not sb3_ppo
train --set algorithm=sb3_dqn --set mirror=false --set mirrored_decisions=true -> needs algorithm double_dqn
train --set task.observation=state -> mirror must be false
train --set task.headings_deg=[0.0, 30.0] -> mirror must be false
train --set gamess=3 -> unknown key 'gamess'; did you mean 'games'?
evaluate straight --set simulator=kernels --set task.timing=wall -> timing wall needs a server of its own
evaluate straight --set simulator=kernels --set task.timing=lockstep --set environments=2 -> needs simulator mujoco
evaluate straight --set device=cuda -> device = cuda: simulator = mujoco flies on the CPU
evaluate straight --set simulator=airsim -> simulator
evaluate straight --set environments=2 --set task.timing=wall -> environments must be 1 with timing wall
evaluate straight --set first_lane=999_999 --set games=2 -> first_lane = 999999 and games = 2: lanes are 0 to 999999
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
latency.issue_us = [0,0,0,0,0,0,0,0,0,0,0,1e300] | [-1,0,0,0,0,0,0,0,0,0,0,0]
latency.platform.tick_us = -1 | 1e308 | 1e30; latency.platform.stall_us = 1e300
latency.platform.frames.hz = -1 | 1e300 | 1e-300; latency.platform.goal_timeout_s = 0 | 1e300
latency.platform.faults.late_us = 1e300; latency.platform.faults.dropped = 2 | -0.1
latency.platform.faults = {dropped: .9, stalled: .9} | {dropped: .5, stalled: .3, late: .3}; gamess = 3
suite = dp9 | [dp1] | {} | 3 | no_such_module:Suite | os:path | null
""",
    "run dp2 --set": """
lane = -1 | [1] | {seed: -1} | {obstacles: 3} | 1.5; lane.seed = 3; path = [] | [[1]] | [[1e308,0]] | straight
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
task.difficulty.first_row_m = 0.5 | 1e308; task.difficulty.wind_m_s = 21 | -1
task.difficulty.light = [0] | [1,2] | [1,0.5] | dark; task.difficulty.min_gap_m = 0.1 | 1e308
task.difficulty.texture = 1
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
command = [none]
""",
    "run ablation --set": "variants = [] | 3; base = 3 | {gamess: 3}",
    "run paper --set": "parts = {} | {dp9-native: {experiment: dp1}}; claims = nowhere.yaml",
}
OTHERS = [
    ("train --set task.lane={obstacles: [], wind_m_s: [1e9, 0, 0]}", "wind"),
    ("train --set task.lane={obstacles: [], wind_m_s: [0, 0]}", "wind"),
    ("train --set task.lane={obstacles: [{x_m: 0.1, y_m: 0, radius_m: 1}]}", "obstacle"),
    ("run dp2 --set lane={obstacles: [{x_m: 0.1, y_m: 0, radius_m: 1}]}", "obstacle"),
    ("run dp2 --set lane={obstacles: [], wind_m_s: [1e9, 0, 0]}", "wind"),
    ("train --set options={batch_size: 100, buffer_size: 99}", "batch_size"),
    (f"train --set task.headings_deg={[*range(-180, 181)]}", "headings_deg"),
    ("train --set task.lane=nowhere.yaml", "nowhere.yaml"),
    ("run dp2 --set lane=nowhere.yaml", "nowhere.yaml"),
    *[(f"evaluate straight --set agent={name}", name) for name in ("x", "offset:inf", "offset:left", "offset:11")],
    ("run robustness --set agent=nowhere", "nowhere"),
    ("run paper --set with_run=nowhere", "--with nowhere"),
    *[(f"{command} --set task={name}", f"task = {name}") for command in ("train", "evaluate") for name in ("'so'", 3)],
    (f"run dp1 --out {'x' * 300}", "--out"),
    (f"run dp1 --games 1{'0' * 400}", "games"),
]  # fmt: skip

FILES = [
    ("run {suite: [dp1]}", "suite"),
    ("run {suite: evaluate\ntask: 3}", "task"),
    ("run {suite: train\ntask: 3}", "task"),
    ("run {suite: train\nmirror: false\ntask: [1, 2]}", "task"),
    ("run {games: 3}", "suite"),
    ("run {}", "nothing"),
    ("run {3}", "mapping"),
    ("run {- dp1}", "mapping"),
    ("run {suite: dp1\nsuite: dp2}", "suite"),
    ("run {suite: 'dp1}", "line"),
    ("run {\x00}", "YAML"),
    ("run {? [a]\n: b}", "key"),
    ("run {suite: !!python/object/apply:os.system ['true']}", "line"),
    ("run {" + LAUGHS + "suite: dp1\nclock_speed: *i}", "alias"),
    ("run {suite: " + "[" * 100_000 + "}", "nest"),
    ("run {suite: dp1\ngames: " + "9" * 5000 + "}", "digits"),
    ("run {suite: dp1\n1: 2}", "1"),
    ("run {suite: ':'}", "suite"),
    ("run {suite: ':Suite'}", "suite"),
    ("run {suite: 'json:'}", "suite"),
    ("run {suite: '..json:loads'}", "suite"),
    ("run {suite: 'json:loads'}", "suite"),
    ("run {suite: 'uavaccel.suites.suite:Suite'}", "suite"),
    ("run {suite: 'uavaccel.units:.x'}", "suite"),
    ("run {suite: dp1\n\tgames: 2}", "line 2"),
    ("run {suite: dp1\n---\nsuite: dp2}", "document"),
    ("run {suite: dp1\nseed: !!timestamp 2020-01-01}", "line 2"),
    ("run {suite: dp1\npath: !!set {a, b}}", "line 2"),
    ("run {suite: dp1\ngames: !!binary aGk=}", "line 2"),
    ("run nowhere.yaml", "nowhere.yaml"),
    ("run nowhere", "nowhere"),
    ("train nowhere.yaml", "nowhere.yaml"),
]

# Command lines, and the word that the complaint has.
OPTIONS = """
run -> experiment; run dp1 --jobs 0 -> --jobs; run dp1 --jobs -1 -> --jobs; run dp1 --jobs 1000000000 -> --jobs
run dp1 --jobs 1000 --timing virtual -> --jobs; evaluate straight --jobs 1000 -> --jobs
run dp1 --jobs 2 --timing wall -> --jobs; run train --jobs 2 -> --jobs; run dp1 --jobs two -> --jobs
run dp1 --clock fast -> --clock; run dp1 --clock 0 -> clock_speed; run dp1 --clock nan -> clock_speed
run dp1 --clock inf -> clock_speed; run dp1 --rounds 0 -> rounds; run dp1 --t-move 0 -> t_move_s
run dp1 --games -1 -> games; run dp1 --command tcsc --command fly -> fly: must be adsc or tcsc
run dp1 --seeds 2 -> --seeds
run dp1 --with x -> --with; run dp2 --rounds 2 -> --rounds; run train --clock 1 --clock 2 -> --clock
run dp1 --set games -> --set; run dp1 --set =3 -> --set; run dp1 --set .games=3 -> --set
run dp1 --set games.=3 -> --set; run dp1 --set games.more=3 -> games; run dp1 --set clock_speed.9=3 -> clock_speed
run dp1 --set games=[ -> --set; run dp1 --set games={a:&a,b:*a} -> games; run dp1 --speed 3 -> --speed
run dp1 dp2 -> dp2; run dp1 --out . -> exists; run dp1 --out there.txt -> exists; run dp1 --out there.txt/run -> --out
run dp1 --resume --out there.txt -> no folder; watch --host nowhere.invalid -> nowhere.invalid
watch --host= -> --host; serve --host= -> --host; serve --recordings there.txt -> --recordings; run --resume -> --out
run dp1 --resume -> --out FOLDER; train --resume -> --out; run --resume --out nowhere -> nowhere
run --out nowhere -> experiment; train --resume --out nowhere -> nowhere; train --games 0 -> games
train --clock -1 -> clock_speed; train --profile unreal -> profile; train --timing soon -> timing
evaluate nowhere -> nowhere; evaluate offset:nan -> offset:nan; evaluate offset:1e308 -> offset:1e308
evaluate straight --against nowhere -> nowhere; evaluate straight --jobs 0 -> --jobs
evaluate straight --seed -1 -> seed; evaluate --resume --out nowhere -> nowhere; run --report nowhere -> nowhere
run --report -> run directory; run --report nowhere --games 3 -> --report; watch nowhere -> nowhere
watch nowhere --film f.mp4 -> nowhere; watch default --film f.mp4 --case lane -> --case
watch default --case lane-000007 --game 3 -> --case, --game: each names the flight
watch default --seed 0 -> --seed: is of the square; watch default --film f.mp4 --port 9 -> --port: is of the page
watch default --film f.mp4 --case lane-9999999 -> lane; watch default --film f.png -> .mp4; watch --film f.mp4 -> --film
report nowhere -> uavaccel run --report RUN_DIR; view -> uavaccel watch RUN --film FILE; advise -> timing advise
schema train -> uavaccel init --schema SUITE; calibrate -> uavaccel timing calibrate; init -> folder
timing calibrate --commands 0 -> --commands; timing calibrate --commands -5 -> --commands
timing calibrate --commands 1000000000000 -> --commands; timing calibrate --profile unreal -> --profile
timing calibrate --out nowhere/latency.yaml -> --out; timing calibrate --out there.txt -> exists
timing calibrate --check --games 0 -> --games; timing calibrate --check --profile unreal -> --profile
timing calibrate --check --latency nowhere.yaml -> nowhere.yaml; timing advise --t-move 0 -> --t-move
timing advise --t-move 0.333 -> --t-move: 0.333 s is not a positive multiple; timing advise --t-move nan -> --t-move
timing advise --profile airsim --t-move 0.003 -> --t-move: 0.003 s is too short for the airsim profile
timing advise --t-move 1e308 -> --t-move; timing advise --error 0 -> --error
timing advise --error nan -> --error; timing advise --rounds 0 -> --rounds; timing advise --rounds 1001 -> --rounds
timing advise --profile unreal -> --profile; timing advise --latency nowhere.yaml -> nowhere.yaml
timing advise --thinking 0 -> --thinking; timing advise --thinking nan -> --thinking
bench nothing -> nothing; bench --soak-s -1 -> --soak-s; bench --soak-s nan -> --soak-s
bench batch --lanes 0 -> --lanes
bench hot-loop --out nowhere/bench.json -> --out; serve --clock 0 -> clock
serve --clock nan -> clock; serve --port 99999 -> port; serve --port -1 -> port
serve --speed 3 -> --speed; serve --clock fast -> --clock
serve --host nowhere.invalid -> nowhere.invalid; serve --profile unreal -> profile; serve --scene moon -> moon
serve --settings nowhere.json -> nowhere.json; serve --settings there.txt -> there.txt; doctor --all -> --all
fly -> script; fly --seed -1 there.txt -> --seed; fly --seed 4294967296 there.txt -> --seed
fly --think inf there.txt -> --think; fly --think nan there.txt -> --think; fly --think -1 there.txt -> --think
fly --until nan there.txt -> --until; fly --until inf there.txt -> --until; fly --clock 1e9 there.txt -> --clock
fly --clock 1,inf there.txt -> --clock; fly --clock nan there.txt -> --clock; fly --clock 1,0 there.txt -> --clock
fly --timing wall --think 0 there.txt -> --think; fly --timing wall --film there.txt -> --film
fly --check --timing wall there.txt -> --check; fly --check --clock 1,2 there.txt -> --check
fly --clock 1,1 there.txt -> --clock; fly --clock 1,1.0000001 there.txt -> --clock; export default --csv= -> --csv
export default --mcap= --csv there -> --mcap; run dp1 --out= -> --out; watch --host= -> --host; train dp1 -> dp1
train dp2 --dry-run -> dp2; train rl -> rl
evaluate straight --sweep wind=0 --sweep wind=3 -> --sweep; evaluate straight --sweep wind=0 --against x -> --against
"""


def table() -> Iterator[tuple[str, str]]:
    """Yield command lines, and the word that the complaint about each has to have."""
    for command, text in CONFIGURATIONS.items():
        for entry in text.strip().replace("\n", "; ").split("; "):
            key, _, values = entry.partition(" = ")
            for value in values.split(" | "):
                yield f"{command} {key}={value}", key.split(".")[-1]
    for entry in OPTIONS.strip().replace("\n", "; ").split("; "):
        line, _, word = entry.partition(" -> ")
        yield line, word
    for entry in COMBINATIONS.strip().splitlines():
        line, _, said = entry.partition(" -> ")
        yield line, said
    yield from (*OTHERS, *FILES)


TABLE = [*table()]


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


def words(line: str, folder: Path) -> list[str]:
    """Of a command line; the text in braces after `run` becomes a file, the last `--set` takes the rest of the line."""
    if line.startswith("run {"):
        (folder / "given.yaml").write_text(line[5:-1])
        return ["run", "given.yaml"]
    head, setting, value = line.rpartition("--set ")
    return [*head.split(), "--set", value] if setting and " --" not in value else line.split()


@pytest.mark.parametrize(("line", "key"), TABLE, ids=[line[:60] for line, _ in TABLE])
def test_bad_input_is_one_line_and_nothing_is_written(
    line: str, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.txt").write_text("mine")
    monkeypatch.setattr(sys, "argv", ["uavaccel", *words(line, tmp_path)])
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SystemExit) as ended:
        cli.main()
    complaint = capsys.readouterr().err
    assert ended.value.code in (1, 2)
    assert complaint.startswith("uavaccel: error: ")
    assert complaint.count("\n") == 1
    assert key.lower() in complaint.lower()
    assert len(complaint) < 1000
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("number", ["-1", "0"])
def test_threads_that_numba_cannot_have_are_one_line(
    number: str, said: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", number)
    assert said("doctor").startswith(f"NUMBA_NUM_THREADS={number}: must be at least 1;")
