"""Games of lanes over arrays: sampled in the order in which `FlightEnv` samples, and written as rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.checks import known_options
from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.flyable import clutter_of, kind_of, profile_of
from uavaccel.envs.sensors import PICTURE_SIZE
from uavaccel.envs.task import AnyLayout, Task
from uavaccel.envs.values import Course
from uavaccel.kernels.appearance import fill_scenes, read_appearance, read_looks
from uavaccel.kernels.bodies import Surroundings, read_scene, read_surroundings
from uavaccel.kernels.clutter_games import clutter_worlds
from uavaccel.kernels.events import camera_row
from uavaccel.kernels.fields import NO_APPEARANCE, NO_LOOKS, STATE, Appearance, Looks
from uavaccel.kernels.lanes import Games, game_rows
from uavaccel.kernels.scene import empty_scene
from uavaccel.sim.lane.layout import PLAIN, LaneLayout
from uavaccel.sim.world import World
from uavaccel.vision.noise import noise_seed


class Drawn(NamedTuple):
    """A sampled game before it begins."""

    course: Course
    task: Task
    """The task under the game's conditions."""
    layout: AnyLayout | None
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
        self.sees = kind_of(task) != STATE
        self.in_lane = task.scene == "lane" and task.picture_size == PICTURE_SIZE
        self.looks = self._read_looks()
        self.nominal = self._world.lead.parameters.copy()
        self._start = lru_cache(maxsize=64)(self._settled)

    def _read_looks(self) -> Appearance | Looks:
        """Return what images are rendered from; without images something of the same type."""
        if self.sees and self.in_lane:
            return read_appearance(self._world.model)
        if self.sees:
            return read_looks(self._world.model, self.task.picture_size, self.task.observation == "depth")
        return NO_LOOKS if clutter_of(self.task) else NO_APPEARANCE

    def sample(self, random: np.random.Generator, games: int, options: Mapping[str, object] | None = None) -> Drawn:
        """Sample the next game of an environment that has had `games` before. Raises UserError for wrong options."""
        course = self.task.sample(random, known_options(options, self.task.reset_options))
        latencies = np.random.SeedSequence(int(random.integers(2**63)))
        conditions = self.task.sample_conditions(random, games)
        task = self.task.with_conditions(conditions)
        layout = task.lane_layout(course)
        return Drawn({**course, CONDITIONS: conditions} if conditions else course, task, layout, latencies)

    def rows(self, count: int) -> Games:
        """Allocate rows for `count` games."""
        scene, clutter = self.surroundings.scene, clutter_of(self.task)
        seen = read_scene(self._world.model, seen=True) if self.sees and not self.in_lane and not clutter else None
        if scene is not None and clutter:
            scene, seen = clutter_worlds(clutter, scene, count)
            if not self.sees:
                seen = empty_scene(0, 0, 0, 0, seen=True)
        return game_rows(count, self.surroundings.most if scene is None else scene, seen)

    def write(self, drawn: Drawn, games: Games, row: int) -> None:
        """Fill a game's row, except for the accelerations at its start (kernels/lanes.refresh)."""
        task, layout = drawn.task, drawn.layout if isinstance(drawn.layout, LaneLayout) else None
        ratios = (1.0, 1.0) if layout is None else (layout.mass_ratio, layout.thrust_ratio)
        parameters, start, body = self._start(task.altitude_m, *ratios)
        games.parameters[row], games.start[row], games.body[row] = parameters, start, body
        games.start["wind"][row] = 0.0 if layout is None else layout.wind_m_s
        games.counts[row] = self.surroundings.put(drawn.layout, games, row)
        if isinstance(self.looks, Appearance) and self.sees and layout is not None:
            fill_scenes(
                self.looks, games.scenes, [row], [replace(layout, scenery=PLAIN)]
            )  # whose depths are all sceneries'
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
