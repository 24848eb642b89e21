"""Policies as they are deployed: functions, PyTorch's modules, files; what is trusted, and what is refused."""

from __future__ import annotations

import warnings
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import stable_baselines3 as sb3
import torch as th
from gymnasium import spaces

from tests.onnx_here import onnx, write  # noqa: F401 - a fixture
from uavaccel.errors import UserError
from uavaccel.realtime import load_policy

pytestmark = pytest.mark.usefixtures("here", "whole_messages")
Env = gymnasium.Env[Any, Any]


class Space:
    """What a policy is loaded for: no more than two spaces."""

    def __init__(self, seen: spaces.Space[Any], actions: spaces.Space[Any]) -> None:
        self.observation_space, self.action_space = seen, actions


REACH = Space(spaces.Box(-1.0, 1.0, (4,), np.float64), spaces.Box(-0.5, 0.5, (2,), np.float32))
PICK = Space(spaces.Box(-1.0, 1.0, (2, 2), np.float64), spaces.Discrete(3, start=2))
FLAT, FLATS = (Space(REACH.observation_space, spaces.Discrete(count, start=2)) for count in (3, 4))
PARTS = Space(spaces.Dict({"at": spaces.Box(-1.0, 1.0, (4,)), "to": spaces.Box(-1.0, 1.0, (2,))}), REACH.action_space)


class Sum(th.nn.Module):
    def forward(self, seen: dict[str, th.Tensor]) -> th.Tensor:
        return seen["at"][:, :2] + seen["to"]


class SumOfTwo(th.nn.Module):
    def forward(self, to: th.Tensor, at: th.Tensor) -> th.Tensor:
        return at[:, :2] + to


def scripted(module: th.nn.Module) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        th.jit.save(th.jit.script(module), "policy.pt")


# --- what acts as it does at home -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("algorithm", "env_id"), [("A2C", "CartPole-v1"), ("SAC", "Pendulum-v1")])
def test_a_model_of_stable_baselines3_acts_in_any_environment(algorithm: str, env_id: str) -> None:
    env = gymnasium.make(env_id)
    model = getattr(sb3, algorithm)("MlpPolicy", env, policy_kwargs={"net_arch": [8]}, device="cpu")
    model.save("model.zip")
    policy, (seen, _) = load_policy("model.zip", env), env.reset(seed=0)
    for _ in range(5):
        action = policy(seen)
        np.testing.assert_array_equal(action, model.predict(seen, deterministic=True)[0])
        seen, *_ = env.step(action)


PICTURE = spaces.Box(0, 255, (40, 40, 3), np.uint8)


@pytest.mark.parametrize(
    ("kind", "seen"),
    [("Cnn", PICTURE), ("MultiInput", spaces.Dict({"picture": PICTURE, "at": REACH.observation_space}))],
)
def test_a_model_has_pictures_as_stable_baselines3_turns_them(kind: str, seen: spaces.Space[Any]) -> None:
    """Its channels come first there, the environment's last; its actions are several bits."""
    env = gymnasium.Env[Any, Any]()
    env.observation_space, env.action_space = seen, spaces.MultiBinary(3)
    model = sb3.PPO(f"{kind}Policy", env, n_steps=2, batch_size=2, policy_kwargs={"net_arch": [8]}, device="cpu")
    model.save("model.zip")
    policy = load_policy("model.zip", env)
    for _ in range(5):
        sample = seen.sample()
        np.testing.assert_array_equal(policy(sample), model.predict(sample, deterministic=True)[0])


@pytest.mark.usefixtures("onnx")
@pytest.mark.parametrize("kind", ["module", "policy.pt", "policy.onnx"])
@pytest.mark.parametrize("env", [REACH, PICK, PARTS], ids=["vector", "discrete", "dictionary"])
def test_a_module_of_pytorch_acts_on_batches_of_one(env: Space, kind: str) -> None:
    """Nothing is dropped out, vectors are clipped, of ratings the best is taken; so it is as a file."""
    th.manual_seed(0)
    layer = th.nn.Linear(4, 3 if env is PICK else 2)
    module = Sum() if env is PARTS else th.nn.Sequential(th.nn.Dropout(0.9), th.nn.Flatten(), layer)
    if kind == "policy.pt":
        scripted(module)
    elif env is PARTS:
        write("policy.onnx", SumOfTwo(), th.zeros(1, 2), th.zeros(1, 4))
    else:
        write("policy.onnx", module, th.zeros(np.shape([env.observation_space.sample()])))
    policy = load_policy(module.train() if kind == "module" else kind, env, trust=True)
    env.observation_space.seed(1)
    for _ in range(5):
        seen = env.observation_space.sample()
        parts = seen if isinstance(seen, dict) else {"": seen}
        tensors = {name: th.as_tensor(part[None], dtype=th.float32) for name, part in parts.items()}
        action = policy(seen)
        module.eval()
        with th.no_grad():
            answer = module(tensors.get("", tensors))[0].numpy()
        expected = 2 + answer.argmax() if env is PICK else np.clip(answer, -0.5, 0.5)
        np.testing.assert_allclose(action, expected, atol=1e-6)  # onnxruntime adds in another order
        assert env.action_space.contains(policy(seen))


@pytest.mark.parametrize("kind", [list, tuple])
def test_of_several_answers_of_a_module_the_first_is_the_action(kind: type[Any]) -> None:
    class Two(th.nn.Module):
        def forward(self, seen: th.Tensor) -> Any:
            return kind([seen[:, :3], seen[:, 1:]])

    assert load_policy(Two(), PICK)(np.array([0.1, 0.9, 0.3, 1.0])) == 2 + 1


@pytest.mark.parametrize("number", range(7))
def test_numbers_of_a_network_are_those_of_the_actions(number: int) -> None:
    class Constant(th.nn.Module):
        def forward(self, seen: th.Tensor) -> th.Tensor:
            return th.full((len(seen), 1), number)

    policy, seen = load_policy(Constant(), PICK), np.zeros(4)
    if 2 <= number <= 4:
        assert policy(seen) == number
    else:
        with pytest.raises(UserError, match=rf"gives \[{number}\] for 1 actions"):
            policy(seen)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (th.tensor([[2.7]]), r"\[2\.7.*\] for 1 actions, each one of 2 to 4"),
        (th.tensor([[2.0, 3.0]]), r"\(1, 2\) numbers for 1 actions, each one of 2 to 4"),
        (th.full((1, 5), 2), r"\(1, 5\) numbers for 1 actions, each one of 2 to 4"),
        ({"action": 2}, r"\[{'action': 2}\], where numbers are needed"),
    ],
    ids=["between", "too few", "too many", "no numbers"],
)
def test_an_answer_for_other_actions_is_one_line(answer: Any, said: str) -> None:
    """A chance between two actions is not the first of them, nor is a rating of too few or too many its first one."""

    class Constant(th.nn.Module):
        def forward(self, seen: th.Tensor) -> Any:
            return answer

    with pytest.raises(UserError, match=f"gives {said}$"):
        load_policy(Constant(), PICK)(np.zeros(4))


@pytest.mark.usefixtures("onnx")
def test_an_onnx_file_of_other_spaces_is_one_line() -> None:
    write("policy.onnx", th.nn.Linear(4, 3), th.zeros(1, 4))
    with pytest.raises(UserError, match=r"^\./policy\.onnx: gives numbers that are NaN or infinite$"):
        load_policy("./policy.onnx", FLAT)(np.full(4, np.nan))
    with pytest.raises(UserError, match=r"^policy\.onnx: its observations are \(4,\), the environment's \(1,\)$"):
        load_policy("policy.onnx", Space(spaces.Box(0, 1, (1,)), FLAT.action_space))
    forms = (REACH, r"\(3,\), the environment's \(2,\)"), (FLATS, "one of 2 to 4, the environment's one of 2 to 5")
    for env, form in forms:
        with pytest.raises(UserError, match=rf"^policy\.onnx: its actions are {form}$"):
            load_policy("policy.onnx", env)
    write("policy.onnx", SumOfTwo(), th.zeros(1, 2), th.zeros(1, 4))
    with pytest.raises(UserError, match=r"^policy\.onnx: its observations are at \(4,\), to \(2,\), the environment's"):
        load_policy("policy.onnx", REACH)


def test_weights_have_a_hash_and_so_has_the_file_of_a_function() -> None:
    first, second = th.nn.Linear(4, 2), th.nn.Linear(4, 2)
    again = th.nn.Linear(4, 2)
    again.load_state_dict(first.state_dict())
    hashes = [load_policy(each, REACH).sha256 for each in (first, second, again)]
    assert hashes[0] == hashes[2] != hashes[1]
    Path("pilot.py").write_text("def act(seen):\n    return seen[:2]\n")
    policy = load_policy("pilot.py:act", REACH, trust=True)
    assert (policy.name, len(policy.sha256 or "")) == ("pilot.py:act", 64)
    np.testing.assert_array_equal(policy(np.arange(4.0)), [0.0, 1.0])


def test_an_episode_begins_with_the_policys_reset_and_its_seed() -> None:
    begun: list[Any] = []

    class Seeded:
        def __call__(self, seen: Any) -> Any:
            return seen[:2]

        def reset(self, seed: int | None) -> None:
            begun.append(seed)

    class Bare(Seeded):
        def reset(self) -> None:  # type: ignore[override]
            begun.append("bare")

    for policy in (Seeded(), Bare(), lambda seen: seen[:2]):
        load_policy(policy, REACH).reset(7)
    assert begun == [7, "bare"]


class Memory(th.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.seen = th.zeros(1, 2)

    def forward(self, seen: th.Tensor) -> th.Tensor:
        self.seen = self.seen + seen[:, :2]
        return self.seen

    @th.jit.export
    def reset(self) -> None:
        self.seen = th.zeros(1, 2)


@pytest.mark.parametrize("kind", ["module", "policy.pt"])
def test_a_module_that_remembers_begins_anew_with_its_reset(kind: str) -> None:
    scripted(Memory())
    policy = load_policy(Memory() if kind == "module" else kind, REACH, trust=True)
    for _ in range(2):
        policy.reset(7)
        policy(np.full(4, 0.125))
        np.testing.assert_array_equal(policy(np.full(4, 0.125)), [0.25, 0.25])


# --- what is refused, in one line -------------------------------------------------------------------------------------


def test_what_a_file_raises_is_one_line_that_names_it() -> None:
    Path("pilot.py").write_text("def act(seen):\n    return 1 / 0\ndef reset():\n    seed\nact.reset = reset\n")
    policy = load_policy("pilot.py:act", REACH, trust=True)
    with pytest.raises(UserError, match=r"^pilot\.py:act: .*pilot\.py:2: act: ZeroDivisionError: division by zero$"):
        policy(np.zeros(4))
    with pytest.raises(
        UserError, match=r"^pilot\.py:act: .*pilot\.py:4: reset: NameError: name 'seed' is not defined$"
    ):
        policy.reset(7)


def test_only_what_is_trusted_runs() -> None:
    """A function, and a TorchScript file, which PyTorch tells to take for a program."""
    scripted(th.nn.Linear(4, 2))
    Path("pilot.py").write_text(
        "from pathlib import Path\nPath('sprung').touch()\ndef act(seen):\n    return seen[:2]\n"
    )
    for name in ("policy.pt", "pilot.py:act", "pilot:act"):
        with pytest.raises(UserError, match=r"add --trust, once$"):
            load_policy(name, REACH)
    assert not Path("sprung").exists()
    for name in ("policy.pt", "pilot.py:act"):
        load_policy(name, REACH, trust=True)
        load_policy(name, REACH)  # as remembered


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        ("policy", r"policy 'policy': is none that is known: name a file \(\.zip, \.onnx, \.pt\), file\.py:function, "),
        ("none.zip", "none.zip: no such file"),
        ("none.pt", "none.pt: no such file"),
        ("text.pt", "text.pt: is no TorchScript file: "),
        ("text.zip", "text.zip: is no model that stable-baselines3 has saved: "),
        ("plain.zip", "plain.zip: its policy cannot be made for this task: "),
        ("none.py:act", "policy 'none.py:act': no module 'none' in "),
        ("two.py:act", "policy 'two.py:act': must take an observation alone$"),
        ("tcp://here", "policy 'tcp://here': must be tcp://host:port, as in "),
        ("tcp://127.0.0.1:99999", "policy 'tcp://127.0.0.1:99999': must be tcp://host:port, as in "),
        (7, "policy: must be a function of an observation, a file or tcp://host:port, not 7"),
    ],
)
def test_what_is_no_policy_is_one_line(policy: Any, said: str) -> None:
    for name in ("text.pt", "text.zip"):
        Path(name).write_text("{}")
    Path("two.py").write_text("def act(seen, info):\n    return seen[:2]\n")
    with zipfile.ZipFile("plain.zip", "w") as archive:
        archive.writestr("data", '{"observation_space": "n", "action_space": "n", "policy_class": "n"}')
    with pytest.raises(UserError, match=f"^{said}") as caught:
        load_policy(policy, REACH, trust=True)
    assert "\n" not in str(caught.value)


def test_a_model_of_other_spaces_is_one_line() -> None:
    sb3.PPO("MlpPolicy", gymnasium.make("CartPole-v1"), policy_kwargs={"net_arch": [8]}, device="cpu").save("model.zip")
    with pytest.raises(UserError, match=r"^model\.zip: its observations are \(4,\), the environment's \(3,\)$"):
        load_policy("model.zip", gymnasium.make("Pendulum-v1"))
    with pytest.raises(UserError, match=r"^SumOfTwo: cannot be run on these observations: TypeError: .*missing 1"):
        load_policy(SumOfTwo(), REACH)(np.zeros(4))
    with pytest.raises(UserError, match=r"^Linear: cannot be run on these observations: mat1 and mat2 shapes"):
        load_policy(th.nn.Linear(9, 2), REACH)(np.zeros(4))
    with pytest.raises(UserError, match=r"^Linear: gives \(1, 9\) numbers for 1 actions, each \(2,\)$"):
        load_policy(th.nn.Linear(4, 9), REACH)(np.zeros(4))
    with pytest.raises(UserError, match=r"^Linear: gives numbers that are NaN or infinite$"):  # and no best rated one
        load_policy(th.nn.Linear(4, 2), gymnasium.make("CartPole-v1"))(np.full(4, np.nan))


def test_an_action_stays_what_it_is() -> None:
    single = Space(REACH.observation_space, spaces.Box(-1.0, 1.0, ()))
    assert load_policy(lambda seen: 0.5, single)(np.zeros(4)) == 0.5
    assert load_policy(lambda seen: np.int8(3), PICK)(np.zeros(4)) == 3
    for given in ([0.5, 0.25], np.full(2, 0.1), [0, 0]):  # as an environment asks that looks whether it is in its space
        assert load_policy(lambda seen, given=given: given, REACH)(np.zeros(4)).dtype == np.float32
    several = Space(REACH.observation_space, spaces.MultiDiscrete([2, 3]))
    assert load_policy(lambda seen: [1, 2], several)(np.zeros(4)) == [1, 2]
    with pytest.raises(UserError, match=r"returned \[2, 2\], where an action is one of MultiDiscrete\(\[2 3\]\)$"):
        load_policy(lambda seen: [2, 2], several)(np.zeros(4))


@pytest.mark.parametrize(
    ("env", "given", "said"),
    [
        (REACH, [0.1], r"float64 \(1,\), where an action is \(2,\)"),
        (REACH, 0.1, r"0.1, where an action is \(2,\)"),
        (REACH, [0.1, float("nan")], r"float64 \(2,\) with NaN or infinity, where an action is \(2,\)"),
        (REACH, [1e300, 0.0], r"float32 \(2,\) with NaN or infinity, where an action is \(2,\)"),
        (REACH, ["a", "b"], r"<U1 \(2,\), where an action is \(2,\)"),
        (REACH, [[0.1], [0.1, 0.2]], r"\[\[0.1\], \[0.1, 0.2\]\], where an action is \(2,\)"),
        (REACH, None, r"None, where an action is \(2,\)"),
        (PICK, 1, "1, where an action is one of 2 to 4"),
        (PICK, 2.0, "2.0, where an action is one of 2 to 4"),
        (PICK, [2], r"int64 \(1,\), where an action is one of 2 to 4"),
        (REACH, th.ones(2, requires_grad=True), r"tensor\(\[1.*\): Can't call numpy\(\) .*"),
    ],
)
def test_an_answer_that_is_no_action_is_one_line(env: Space, given: Any, said: str) -> None:
    policy = load_policy(lambda seen: given, env)
    with pytest.raises(UserError, match=f"<lambda>: returned {said}$") as caught:
        policy(np.zeros(4))
    assert "\n" not in str(caught.value)
