"""Games of lanes over arrays: sampled in the order in which `FlightEnv` samples, and written as rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.checks import known_options
from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.flyable import profile_of
from uavaccel.envs.task import Task
from uavaccel.envs.values import Course
from uavaccel.kernels.appearance import fill_scene, read_appearance
from uavaccel.kernels.bodies import Surroundings, read_surroundings
from uavaccel.kernels.events import camera_row
from uavaccel.kernels.fields import Appearance
from uavaccel.kernels.lanes import Games
from uavaccel.sim.lane.layout import LaneLayout
from uavaccel.sim.world import World
from uavaccel.vision.image_noise import noise_seed


class Drawn(NamedTuple):
    """A sampled game before it begins."""

    course: Course
    task: Task
    """The task under the game's conditions."""
    layout: LaneLayout | None
    latencies: np.random.SeedSequence

    @property
    def own_course(self) -> Course:
        """The course without the conditions, which are no numbers of all games."""
        return {name: each for name, each in self.course.items() if name != CONDITIONS}


class GameMaker:
    """Samples a task's games and writes them into rows of `Games`."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self._world = World(task.scene, profile_of(task))
        self.surroundings: Surroundings = read_surroundings(self._world.model)
        self.appearance: Appearance | None = None if task.observation == "state" else read_appearance(self._world.model)
        self.nominal = self._world.lead.parameters.copy()
        self._start = lru_cache(maxsize=64)(self._settled)

    def sample(self, random: np.random.Generator, games: int, options: Mapping[str, object] | None = None) -> Drawn:
        """Sample the next game of an environment that has had `games` before. Raises UserError for wrong options."""
        course = self.task.sample(random, known_options(options, self.task.reset_options))
        latencies = np.random.SeedSequence(int(random.integers(2**63)))
        conditions = self.task.sample_conditions(random, games)
        task = self.task.with_conditions(conditions)
        layout = task.lane_layout(course)
        return Drawn({**course, CONDITIONS: conditions} if conditions else course, task, layout, latencies)

    def write(self, drawn: Drawn, games: Games, row: int) -> None:
        """Fill a game's row, except for the accelerations at its start (kernels/lanes.refresh)."""
        task, layout = drawn.task, drawn.layout
        ratios = (1.0, 1.0) if layout is None else (layout.mass_ratio, layout.thrust_ratio)
        parameters, start, body = self._start(task.altitude_m, *ratios)
        games.parameters[row], games.start[row], games.body[row] = parameters, start, body
        games.start["wind"][row] = 0.0 if layout is None else layout.wind_m_s
        games.counts[row] = self.surroundings.put(layout, games.solids, row)
        if self.appearance is not None and layout is not None:
            fill_scene(self.appearance, games.scenes, row, layout)
        games.cameras[row] = camera_row(task.dvs_parameters, task.image_noise)
        seed = noise_seed(drawn.latencies)
        games.seeds[row] = seed, task.events_seed(seed)

    def _settled(
        self, altitude_m: float, mass_ratio: float, thrust_ratio: float
    ) -> tuple[np.void, np.void, NDArray[np.float64]]:
        """Return parameters, state and body (BODY_FIELDS,) of a settled hover. Raises UserError if none is possible."""
        world = self._world
        world.lead.set_airframe(mass_ratio, thrust_ratio)
        world.reset((0.0, 0.0, -altitude_m))
        data = world.data
        body = np.concatenate([data.qpos, data.qvel, data.qfrc_applied, np.zeros(6)])
        return world.lead.parameters.copy(), world.lead.state.copy(), body


def keys_of(task: Task, games: Sequence[Drawn]) -> dict[str, NDArray[np.float64]]:
    """Return the task's numbers under the conditions of n games, arrays (n,), for `Task.goal`; {} if it has none."""
    if type(task).with_conditions is Task.with_conditions:
        return {}
    names = [name for name in type(task).model_fields if isinstance(getattr(task, name), float)]
    return {name: np.array([getattr(game.task, name) for game in games]) for name in names}
