"""`uavaccel/ObstacleLane-v0`: fly 150 m down a lane of obstacles, seen through a DVS (paper, section III-C1).

One step is one synchronous command. Task, actions and reward are this project's own choice: see `LaneTask`.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.commands.slices import samples_due
from uavaccel.config import validate
from uavaccel.envs.lane_client import LaneClient, LaneSample
from uavaccel.envs.senses import make_sense, observation_space
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.envs.task import LaneTask
from uavaccel.errors import UserError
from uavaccel.sim.lane.layout import EVALUATION_SEEDS, LENGTH_M
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import ZERO_LATENCY
from uavaccel.wire.session import Session, open_session

Observation = NDArray[Any]
Info = dict[str, Any]


class ObstacleLane(gymnasium.Env[Observation, np.int64]):
    """An environment made of a `LaneTask`, whose keys are the keywords of `gymnasium.make`.

    `reset` draws a lane, or takes `options={"lane": index}` of the task's split. Infos have `is_success`, `distance_m`
    (how far north it got), `position_m` (NED), `collision` (what it touched, or None), `lane`, `commands`, `wall_s`,
    seconds of the game's own wall clock, and `phase_s`, those by phase. Raises UserError for keywords that do not fit.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - Gymnasium's own

    def __init__(self, render_mode: str | None = None, **task: Any) -> None:
        self.task = validate(LaneTask, task, "ObstacleLane-v0")
        self.render_mode = render_mode
        self._sense = make_sense(self.task)
        self._frames_per_command = len(samples_due(self.task.t_move_s, self.task.t_sample_s))
        self.observation_space = observation_space(self._sense, self._frames_per_command * self.task.history)
        self.action_space = spaces.Discrete(len(self.task.headings_deg))
        self._command = COMMANDS[self.task.command]
        self._frames: deque[NDArray[Any]] = deque(maxlen=self._frames_per_command * self.task.history)
        self._session: Session | None = None
        self._client: LaneClient | None = None
        self._journal: dict[str, Any] = {}

    # --- Gymnasium --------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """A settled hover at the start of a lane; the first observation is of no events."""
        super().reset(seed=seed)
        self._journal = {
            "generator": self.np_random.bit_generator.state,
            "options": options,
            "steps": [],
            "charged_s": {},
        }
        drawn = int(self.np_random.integers(EVALUATION_SEEDS))
        self._lane = (options or {}).get("lane", drawn)
        self._start_game(np.random.SeedSequence(int(self.np_random.integers(2**63))))
        self._commands = 0
        self._collision: str | None = None
        self._frames.extend([self._sense.blank] * (self._frames.maxlen or 0))
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, Info]:
        """Fly one command in the direction of an action. Raises UserError before the first `reset`."""
        if self._client is None:
            raise UserError("reset the environment before its first step")
        before_m = self._distance_m
        self._journal["steps"].append((int(action), self._journal["charged_s"]))
        self._journal["charged_s"] = {}
        self._switch("simulation")
        self._fly(int(action))
        self._switch(None)
        self._commands += 1
        success = self._collision is None and self._distance_m >= LENGTH_M
        terminated = success or self._collision is not None
        truncated = not terminated and self._commands >= self.task.max_commands
        reward = self.task.progress_reward * (self._distance_m - before_m)
        reward += self.task.goal_reward * success + self.task.collision_reward * (self._collision is not None)
        return self._observation(), reward, terminated, truncated, self._info()

    def render(self) -> Any:
        """What the front camera sees: (144, 256, 3) uint8."""
        if self._client is None or self.render_mode is None:
            return None
        return self._client.image("colour")

    def close(self) -> None:
        if self._session is not None:
            self._session.close()
        self._session = self._client = None

    # --- time, and going on after a stop ----------------------------------------------------------

    def charge(self, duration_s: float, phase: str = "inference") -> None:
        """Work of the agent's since the last command: in `virtual` ADSC flies on meanwhile. Nothing elsewhere."""
        if self.task.timing != "virtual" or self._client is None:
            return
        charged = self._journal["charged_s"]
        charged[phase] = charged.get(phase, 0.0) + duration_s
        self._client.transport.clock.charge(round(duration_s * NS_PER_S))
        self._stopwatches[0].add(phase, duration_s)

    def journal(self) -> dict[str, Any]:
        """All that happened in the running game: with it, `replay` brings another environment to the same point."""
        return {**self._journal, "steps": list(self._journal["steps"])}

    def replay(self, journal: dict[str, Any]) -> Observation:
        """Fly a journal's game again to where it ended; exact in `virtual` and `lockstep`. The last observation."""
        self.np_random.bit_generator.state = journal["generator"]
        observation, _ = self.reset(options=journal["options"])
        for action, charged_s in [*journal["steps"], (None, journal["charged_s"])]:
            for phase, duration_s in charged_s.items():
                self.charge(duration_s, phase)
            if action is not None:
                observation = self.step(action)[0]
        return observation

    # --- inside -----------------------------------------------------------------------------------

    def _start_game(self, latencies: np.random.SeedSequence) -> None:
        task = self.task
        if self._session is None:
            latency = task.latency_model() if task.timing == "virtual" else ZERO_LATENCY
            self._session = open_session(task.timing, task.profile, "lane", latency)
        lane = task.wire_lane(self._lane)
        inner = self._session.start_game(task.clock_speed, latencies, lane=lane, height_m=-task.altitude_m)
        self._start_ns = inner.now_ns()
        self._stopwatches = [Stopwatch(inner.transport.clock)]
        if task.report_host_times:
            self._stopwatches.append(Stopwatch(MonotonicClock()))
        self._client = LaneClient(inner, self._sense.kind, self._stopwatches)
        first: LaneSample = self._client.gather(self._client.kinematics())
        self._switch(None)
        self._position_m = first.state.position_m
        self._sense.begin(first.state, first.image)
        self._command.begin(self._client)

    def _fly(self, action: int) -> None:
        """One command; it stops at the first sample after a collision, and the frames still missing are blank."""
        assert self._client is not None
        task, heading = self.task, math.radians(self.task.headings_deg[action])
        velocity = (task.speed_m_s * math.cos(heading), task.speed_m_s * math.sin(heading), 0.0)
        goal = VelocityGoal(velocity, -task.altitude_m)
        missing = self._frames_per_command
        for sample in self._command.fly(self._client, goal, task.t_move_s, task.t_sample_s, task.t_th_ns):
            self._position_m = sample.state.position_m
            if sample.collision:
                self._collision = str(sample.collision["object"])
                self._position_m = tuple(sample.collision["position_m"])
                break
            self._frames.append(self._see(sample))
            missing -= 1
        self._frames.extend([self._sense.blank] * missing)

    def _see(self, sample: LaneSample) -> NDArray[Any]:
        self._switch("image_processing")
        frame = self._sense.blank if self.task.blank_images else self._sense.frame(sample.state, sample.image)
        if self.task.timing == "virtual" and self._client is not None:
            self._client.transport.clock.charge(round(self.task.image_processing_s * NS_PER_S))
        self._switch("simulation")
        return frame

    @property
    def _distance_m(self) -> float:
        return float(self._position_m[0])

    def _switch(self, phase: str | None) -> None:
        for stopwatch in self._stopwatches:
            stopwatch.switch(phase)

    def _observation(self) -> Observation:
        return np.concatenate(self._frames)

    def _info(self) -> Info:
        info = {
            "is_success": self._collision is None and self._distance_m >= LENGTH_M,
            "distance_m": self._distance_m,
            "position_m": [float(each) for each in self._position_m],
            "collision": self._collision,
            "lane": self._lane,
            "commands": self._commands,
            "wall_s": (self._client.now_ns() - self._start_ns) / NS_PER_S if self._client else 0.0,
            "phase_s": self._stopwatches[0].spent_s(),
        }
        if self.task.report_host_times:
            info["host_phase_s"] = self._stopwatches[1].spent_s()
        return info
