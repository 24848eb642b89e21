"""Real time on the machine's own clock: the environment runs in a process of its own, whatever its agent does."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import traceback
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from multiprocessing.util import Finalize
from typing import Any

import gymnasium

from uavaccel.clock import MonotonicClock, Pacer, WallClock
from uavaccel.errors import UserError
from uavaccel.processes.lifetime import POLL_S, Patience, describe_end, work_for_parent
from uavaccel.processes.stalls import is_stopped
from uavaccel.realtime.control_loop import Command, ControlLoop, Extras, LoopOptions
from uavaccel.realtime.plant import Passed, plant_of
from uavaccel.realtime.thinking import Measured
from uavaccel.units import NS_PER_S

END_S = 1.0  # for which a process that shall end is waited for
MakeEnv = Callable[[], "gymnasium.Env[Any, Any]"]


class RealTimeProcess(gymnasium.Env[Any, Any]):
    """What `RealTime` models, measured: an environment in a second process, paced by the machine's clock.

    `make_env` makes the environment there and has to be picklable, such as functools.partial(gymnasium.make, ID); a
    script that calls this needs `if __name__ == "__main__"`. The other arguments are `RealTime`'s; what the agent
    really takes to think is in `thinking`, whose `save` writes the calibration file that `RealTime` replays. Infos
    have `late_s` too: how much later than its clock the environment was, by which a machine too slow for the
    ClockSpeed is known. Raises UserError for arguments that do not fit, and where the process has ended or stays
    stopped; what the environment raises is raised here, with its traceback there as a note.
    """

    keeps_real_time = True

    def __init__(self, make_env: MakeEnv, command: Command = "adsc", clock_speed: float = 1.0, **keys: Any) -> None:
        options = LoopOptions(command, clock_speed, **keys)
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        arguments = theirs, make_env, options, os.getpid()
        self._process = context.Process(target=_serve, args=arguments, daemon=True, name="uavaccel-realtime")
        self._process.start()
        theirs.close()
        # before multiprocessing waits at this program's end, for a stopped one for ever
        self._end = Finalize(self, _end, (self._connection, self._process), exitpriority=0)
        self.observation_space, single, self.metadata, self._tick_ns = self._answer()
        self.action_space = options.action_space(single)
        self.thinking = Measured()

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; under "adsc" its time runs from here on."""
        super().reset(seed=seed)
        result: tuple[Any, dict[str, Any]] = self._ask("reset", seed, options)
        return result

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Send an action, and wait for the observation after it."""
        passed, thinking_ns, waited, late_ns = self._ask("step", action)
        self.thinking.taken_ns.append(thinking_ns)
        info = {**passed.info, "thinking_s": thinking_ns / NS_PER_S, "late_s": late_ns / NS_PER_S}
        info["meanwhile_s"] = waited * self._tick_ns / NS_PER_S
        return passed.observation, passed.reward, passed.terminated, passed.truncated, info

    def close(self) -> None:
        self._end()

    def _ask(self, *question: Any) -> Any:
        with suppress(OSError):  # where it has ended, its last answer may say why
            self._connection.send(question)
        return self._answer()

    def _answer(self) -> Any:
        patience = Patience(self._process)  # type: ignore[arg-type]  # its id is all that is asked for
        try:
            while not self._connection.poll(POLL_S):
                if patience.is_over():
                    self._end()
                    raise UserError("the process of the environment was stopped")
            answer = self._connection.recv()
        except (EOFError, OSError):
            self._end()
            assert self._process.exitcode is not None
            raise UserError(f"the process of the environment {describe_end(self._process.exitcode)}") from None
        if isinstance(answer, Exception):
            raise answer
        return answer


def _end(connection: Connection, process: SpawnProcess) -> None:
    """End the environment's process, which may be stopped or work on."""
    connection.close()
    if process.pid is not None and not is_stopped(process.pid):
        process.join(END_S)
    process.kill()
    process.join()


class EnvironmentServer:
    """The side of the environment, which steps when a tick is due."""

    def __init__(
        self, connection: Connection, loop: ControlLoop, env: gymnasium.Env[Any, Any], clock: WallClock | None = None
    ) -> None:
        self._connection, self._loop, self._env = connection, loop, env
        self.extras = Extras(env.observation_space, env.action_space, loop.options)
        self._clock = clock or MonotonicClock()
        self._pacer = Pacer(loop.options.speed, loop.plant.tick_ns)
        self._thinks = False  # the agent, about an observation that it has
        self._meanwhile: Passed | None = None
        self._thought = self._since_ns = self._arrived_ns = 0

    def reset(self, seed: int | None, options: Mapping[str, Any] | None) -> tuple[Any, dict[str, Any]]:
        observation, info = self._env.reset(seed=seed, options=None if options is None else dict(options))
        self._loop.begin()
        self.extras.begin()
        observation = self.extras.told(observation, info, 0.0, self._loop)
        self._hand_over(self._clock.now_ns())
        self._thinks = True
        return observation, info

    def step(self, action: Any) -> tuple[Passed, int, int, int]:
        """Return the result, the thinking time in ns, the ticks up to the action, and the lateness in ns."""
        loop, thinking_ns = self._loop, self._arrived_ns - self._since_ns
        if not loop.goes_on:
            self._pacer.anchor(self._arrived_ns, 0)
        self.extras.note(action)
        passed = loop.act(action, self._thought, self._meanwhile)
        age_s = loop.waited * loop.plant.tick_ns / NS_PER_S
        passed = passed._replace(observation=self.extras.told(passed.observation, passed.info, age_s, loop))
        due_ns = self._pacer.wall_due(passed.ticks)
        late_ns = max(self._clock.now_ns() - due_ns, 0)
        self._clock.sleep_until(due_ns)
        self._hand_over(due_ns + late_ns)
        self._thinks = not passed.over
        return passed, thinking_ns, loop.waited, late_ns

    def wait(self) -> tuple[Any, ...]:
        """Return the agent's next message; the environment goes on until it comes."""
        while self._goes_on():
            left_ns = self._pacer.wall_due(self._thought + 1) - self._clock.now_ns()
            if self._connection.poll(max(left_ns, 0) / NS_PER_S):
                break
            due = self._pacer.ticks_due(self._clock.now_ns()) - self._thought
            if due > 0:
                self._go_on(due)
        message: tuple[Any, ...] = self._connection.recv()
        self._arrived_ns = self._clock.now_ns()
        if message[0] == "step" and self._goes_on():
            whole = self._loop.ticks_within(self._arrived_ns - self._since_ns)
            if whole > self._thought:
                self._go_on(whole - self._thought)
        return message

    def _hand_over(self, wall_ns: int) -> None:
        """Begin to count the thinking time, as the agent has its observation."""
        self._since_ns = self._arrived_ns = wall_ns
        self._pacer.anchor(wall_ns, 0)
        self._thought, self._meanwhile = 0, None

    def _goes_on(self) -> bool:
        over = self._meanwhile is not None and self._meanwhile.over
        return self._thinks and self._loop.goes_on and not over

    def _go_on(self, ticks: int) -> None:
        self._meanwhile = self._loop.advance(ticks, self._meanwhile)
        self._thought = self._meanwhile.ticks


def _serve(connection: Connection, make_env: MakeEnv, options: LoopOptions, parent: int) -> None:
    """Run the environment's process until the agent's end of the connection is closed."""
    work_for_parent(parent)
    try:
        with closing(make_env()) as env:
            loop = ControlLoop(plant_of(env, options.period_s), options, env.action_space)
            server = EnvironmentServer(connection, loop, env)
            connection.send((server.extras.space, env.action_space, env.metadata, loop.plant.tick_ns))
            while True:
                name, *arguments = server.wait()
                connection.send(getattr(server, name)(*arguments))
    except EOFError:
        return
    except Exception as error:  # whatever an environment of anybody's raises
        with suppress(OSError):  # nobody listens any more
            connection.send(portable(error))


def portable(error: Exception) -> Exception:
    """Return an exception as it is, or one with its type and message where it cannot be sent to another process."""
    if not isinstance(error, UserError):
        error.add_note("".join(traceback.format_exception(error)))
    try:
        if type(pickle.loads(pickle.dumps(error))) is type(error):
            return error
    except Exception:
        pass
    return RuntimeError(f"{type(error).__name__}: {error}")
