"""Several drones in one world of the exact simulator, an agent each: PettingZoo's parallel interface.

They start on a ring and cross it to its other side, so that they meet in the middle; they touch, and see, one another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from uavaccel.config import Count, Speed
from uavaccel.envs.arrays import copied
from uavaccel.envs.checks import check_reward, make_task, refuse_copy, seed_of, within
from uavaccel.envs.judging import autopilot_goal
from uavaccel.envs.sensors import Sensor
from uavaccel.envs.task import Mediation, Positive, Task, distance, position_option, told_of
from uavaccel.envs.values import AT_REST, Action, AnyMoment, Course, Info, Moment, Number, Observation
from uavaccel.errors import UserError
from uavaccel.kinematics import Kinematics
from uavaccel.resources import require
from uavaccel.sim.camera import gl
from uavaccel.sim.camera.camera import FRONT_CENTER, Lens
from uavaccel.sim.camera.view import vehicle_pose
from uavaccel.sim.flight import velocity
from uavaccel.sim.poses import FARTHEST_M, HERE, LEVEL, check_apart
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.vehicle.vehicle import AddedVehicle, Start, Vehicle
from uavaccel.sim.world import World

require("pettingzoo", "several drones", "swarm")

from pettingzoo import ParallelEnv  # type: ignore[import-untyped] # noqa: E402

ALONE_WITH = {
    "command": "tcsc",
    "profile": "native",
    "history": 1,
    "dvs_rate_hz": None,
    **dict.fromkeys(("blank_images", "list_events", "report_host_times"), False),
    **dict.fromkeys(("image_noise", "dvs_shot_noise_hz", "dvs_leak_hz"), 0.0),
}
"""Keys of other tasks that several drones do not follow, and what they have to be."""
UNEVEN_M, LOWEST_M = 0.2, 0.3  # starts and goals are up to so much above or below the altitude; its least
AWAY_M = FARTHEST_M  # north: where drones are whose games are over, at the edge of where one may be placed


class SwarmTask(Task):
    """Observations of "state": the vector to the own goal, attitude, velocity and body rate, 13 numbers, and for each
    other drone in turn its position and velocity less the own ones, 6 numbers, zeros once it is gone; m, m/s, rad/s.
    """

    flat_state: ClassVar[bool] = True
    reset_options: ClassVar[tuple[str, ...]] = ("starts_m", "goals_m")
    drones: Annotated[int, Field(ge=2, le=8)] = 4
    """Drones in the world."""
    ring_m: Annotated[float, Field(ge=2.0, le=100.0)] = 5.0
    """Radius, in metres, of the ring on which they start."""
    speed_m_s: Speed = 2.0
    """Speed of a velocity at full deflection, m/s."""
    radius_m: Positive = 0.5
    """Distance from its goal, in metres, at which a drone has won."""
    max_commands: Count = 100
    """Commands after which all games are truncated."""
    timing: Literal["lockstep"] = "lockstep"
    """They fly without latencies."""

    @model_validator(mode="after")
    def _flies_together(self) -> Self:
        for key, only in ALONE_WITH.items():
            if getattr(self, key) != only:
                raise ValueError(f"{key} = {getattr(self, key)!r}: several drones fly with {only!r} alone")
        if self.mediation != Mediation() or self.frames_per_command != 1:
            raise ValueError("several drones fly without mediation, and with t_sample_s equal to t_move_s")
        if self.altitude_m < LOWEST_M:
            raise ValueError(
                f"altitude_m = {self.altitude_m:g}: needs {LOWEST_M:g}, as some start {UNEVEN_M:g} m lower"
            )
        return self

    def sample(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        """Sample starts and goals: evenly around the ring, turned anyhow, each goal opposite its start."""
        turn = random.uniform(0.0, 2.0 * math.pi) + 2.0 * math.pi * np.arange(self.drones) / self.drones
        heights = -self.altitude_m + random.uniform(-UNEVEN_M, UNEVEN_M, (2, self.drones))
        ring = self.ring_m * np.stack([np.cos(turn), np.sin(turn)])
        starts, goals = (np.vstack([side, height]).T for side, height in ((ring, heights[0]), (-ring, heights[1])))
        return {
            "starts_m": self._places(options, "starts_m", starts),
            "goals_m": self._places(options, "goals_m", goals),
        }

    def _places(self, options: Mapping[str, object], name: str, drawn: NDArray[np.float64]) -> list[list[float]]:
        places: list[list[float]] = position_option(options, name, drawn)
        if len(places) != self.drones:
            raise UserError(f"reset: option {name} must be {self.drones} places [north, east, down] in metres")
        return places

    def course_of(self, drone: int, course: Course) -> Course:
        """Return a drone's own course: its goal, and the others, who are told by `fields`."""
        return {"goal_m": course["goals_m"][drone], "others": [[0.0] * 6] * (self.drones - 1)}

    def _blank_features(self) -> NDArray[np.float32]:
        features = self.features(AT_REST, self.course_of(0, self.sample(np.random.default_rng(0), {})))
        return np.zeros_like(features)

    def fields(self, state: Kinematics, course: Course) -> Sequence[Number]:
        way_m = [there - here for there, here in zip(course["goal_m"], state.position_m, strict=True)]
        own = [*way_m, *super().fields(state, course)[3:]]
        return [*own, *(number for other in course["others"] for number in other)]

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        """Return 1 per metre nearer, plus 10 for success and minus 10 for a collision."""
        return distance_m(before) - distance_m(now) + 10.0 * self.success(now) - 10.0 * self.failure(now)

    def success(self, now: AnyMoment) -> Number:
        return now.free & (distance_m(now) <= self.radius_m)

    def info(self, now: AnyMoment) -> Info:
        return {"distance_m": distance_m(now), "goal_m": now.course["goal_m"]}


def distance_m(now: AnyMoment) -> Number:
    """Return the distance from a drone's goal, metres."""
    return distance(now.course["goal_m"], now.position_m)


class Swarm(ParallelEnv):  # type: ignore[misc]
    """Drones that cross a ring, `drone_0` and so on; the keywords are the task's keys.

    `reset` takes `options={"starts_m": ..., "goals_m": ...}`, places (drones, 3), NED in metres; it ignores others,
    which PettingZoo's own test passes. A drone that has reached its goal, or touched something, leaves the world, and
    `agents`. Its last info has `is_success`, `position_m` and `collision`, what it touched: "ground" or another drone's
    name. Raises UserError for keywords that do not fit, for actions outside the space and for a step before the first
    reset.
    """

    metadata: ClassVar[Info] = {"name": "uavaccel_swarm_v0", "render_modes": [], "is_parallelizable": True}
    task_class: type[SwarmTask] = SwarmTask
    render_mode = None

    def __init__(self, **keys: Any) -> None:
        self.task = task = make_task(self.task_class, keys, type(self).__name__)
        self.possible_agents = [f"drone_{number}" for number in range(task.drones)]
        self.agents: list[str] = []
        self.observation_spaces = {agent: task.observation_space() for agent in self.possible_agents}
        self.action_spaces = {agent: task.action_space() for agent in self.possible_agents}
        self._ticks = round(task.t_move_s / PROFILES[task.profile].tick_s)
        self._random = np.random.default_rng()
        self._world: World | None = None
        self._sensors: dict[str, Sensor] = {agent: task.sensor() for agent in self.possible_agents}
        self._moments: dict[str, Moment] = {}

    def __getstate__(self) -> object:
        return super().__getstate__() if self._world is None else refuse_copy(self)

    def observation_space(self, agent: str) -> Any:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, object] | None = None
    ) -> tuple[dict[str, Observation], dict[str, Info]]:
        """Begin a game in which all drones hover; a seed makes it and those that follow repeatable."""
        if (seed := seed_of(seed)) is not None:
            self._random = np.random.default_rng(seed)
        if not isinstance(options or {}, Mapping):
            raise UserError(f"reset: options = {options!r}: must be a mapping, of {', '.join(self.task.reset_options)}")
        course = self.task.sample(self._random, options or {})
        self._place(course["starts_m"])
        self.agents = list(self.possible_agents)
        self._moments = {}
        for number, agent in enumerate(self.agents):
            state = self._vehicle(agent).kinematics(in_world=True)
            self._moments[agent] = Moment(state, state.position_m, None, 0, self.task.course_of(number, course))
        self._tell_of_others()
        return {agent: self._observed(agent, begins=True) for agent in self.agents}, self._infos()

    def step(
        self, actions: Mapping[str, Action]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]]:
        """Fly one command of each drone at the same time; `actions` has one for each of `agents`."""
        if self._world is None:
            raise UserError("reset the drones before their first step")
        if missing := [agent for agent in self.agents if agent not in actions]:
            raise UserError(f"step: {missing[0]} has no action")
        for agent in self.agents:
            action = within(self.action_spaces[agent], actions[agent]).astype(np.float64)
            self._vehicle(agent).set_goal(autopilot_goal(self.task.goal(action)))
        if self.agents:
            self._world.advance(self._ticks)
        before, flown = dict(self._moments), list(self.agents)
        for agent in flown:
            self._moments[agent] = self._reached(agent)
        self._tell_of_others()
        now, task = self._moments, self.task
        rewards = {agent: task.reward(before[agent], now[agent]) for agent in flown}
        for reward in rewards.values():
            check_reward(task, reward)
        terminated = {agent: bool(task.success(now[agent]) or task.failure(now[agent])) for agent in flown}
        truncated = {agent: not terminated[agent] and now[agent].commands >= task.max_commands for agent in flown}
        told = {agent: self._observed(agent) for agent in flown}, rewards, terminated, truncated, self._infos()
        for agent in flown:
            if terminated[agent] or truncated[agent]:
                self.agents.remove(agent)
                self._send_away(agent)
        return told

    def close(self) -> None:
        if self._world is not None:
            self._world.close()
        self._world, self.agents = None, []

    # --- the world --------------------------------------------------------------------------------

    def _place(self, starts_m: Sequence[Sequence[float]]) -> None:
        starts = [Start((north, east, down)) for north, east, down in starts_m]
        if self._world is None:
            if self.task.observation != "state":
                gl.check_process()
            world = World(self.task.scene, PROFILES[self.task.profile])
            world.lead.name = self.possible_agents[0]
            world.add_vehicles([*map(AddedVehicle, self.possible_agents[1:], starts[1:])])
            self._world = world
        for agent in self.possible_agents:
            self._send_away(agent)  # so that places are checked without them
        for number, start in enumerate(starts):
            self._world.check_place(start.position_m, start.orientation_wxyz)
            before = dict(zip(self.possible_agents, (each.position_m for each in starts[:number]), strict=False))
            check_apart(self.possible_agents[number], start.position_m, before)
        for vehicle, start in zip(self._world.vehicles, starts, strict=True):
            vehicle.start = start
        self._world.reset()

    def _vehicle(self, agent: str) -> Vehicle:
        assert self._world is not None, "reset first"
        return self._world.vehicles[self.possible_agents.index(agent)]

    def _reached(self, agent: str) -> Moment:
        """Return where a drone is after a command; after a collision, where it first touched something."""
        vehicle, was = self._vehicle(agent), self._moments[agent]
        state, touch = vehicle.kinematics(in_world=True), vehicle.contact_log.first
        now = Moment(state, state.position_m, None, was.commands + 1, was.course)
        if touch is None:
            return now
        return now._replace(position_m=touch.position_m, collision=touch.object)

    def _send_away(self, agent: str) -> None:
        assert self._world is not None
        number, vehicle = self.possible_agents.index(agent), self._vehicle(agent)
        self._world.teleport(vehicle, (AWAY_M, 10.0 * number, -self.task.altitude_m), LEVEL, HERE)
        vehicle.set_goal(velocity(HERE))

    # --- what is told -----------------------------------------------------------------------------

    def _tell_of_others(self) -> None:
        """Put the others' places and velocities, less its own, into each drone's course."""
        for agent, now in self._moments.items():
            others = [
                beside(self._moments[other].state, now.state) if other in self.agents else [0.0] * 6
                for other in self.possible_agents
                if other != agent
            ]
            self._moments[agent] = now._replace(course={**now.course, "others": others})

    def _observed(self, agent: str, begins: bool = False) -> Observation:
        now, sensor, image = self._moments[agent], self._sensors[agent], None
        if sensor.picture and self._world is not None:  # of the front camera, the others included
            camera, data = self._world.mounted_camera(*self.task.picture_size), self._world.data
            pose = vehicle_pose(data, self.possible_agents.index(agent))
            camera.point(pose.of(FRONT_CENTER), Lens(*self.task.picture_size))
            image = getattr(camera, sensor.picture)(data)
        see = sensor.reset if begins else sensor.frame
        frame = see(now.state, sensor.blank if image is None else image, now.course)
        if not self.task.also_state:
            return frame
        return {"image": frame, "state": self.task.features(now.state, now.course).ravel()}

    def _infos(self) -> dict[str, Info]:
        flying = {agent: now for agent, now in self._moments.items() if agent in self.agents}
        return {agent: {**told_of(self.task, now), **copied(self.task.info(now))} for agent, now in flying.items()}


def beside(there: Kinematics, here: Kinematics) -> list[float]:
    """Return the place and the velocity of one drone as another has it, in 6 numbers, NED."""
    places = zip(there.position_m, here.position_m, strict=True)
    speeds = zip(there.linear_velocity_m_s, here.linear_velocity_m_s, strict=True)
    return [other - own for pairs in (places, speeds) for other, own in pairs]


parallel_env = Swarm  # as PettingZoo's own modules name what they make
