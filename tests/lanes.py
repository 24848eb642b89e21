"""What batches must agree with: the obstacle lane in plain geometry, and environments that fly alone."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode

from uavaccel.envs.arrays import select
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.values import Info
from uavaccel.sim.lane import HULL_RADIUS_M, LENGTH_M, WIDTH_M, LaneLayout, object_name


def free_distance_m(layout: LaneLayout, y_m: float) -> float:
    """Metres that a drone flying straight north, `y_m` east of the centre line, covers before its hull touches."""
    if abs(y_m) + HULL_RADIUS_M >= WIDTH_M / 2:
        return 0.0
    flat = np.where(layout.round, 0.0, layout.half_width_m)
    reach = HULL_RADIUS_M + layout.half_width_m - flat
    beside = np.maximum(np.abs(layout.y_m - y_m) - flat, 0.0)
    hit = beside < reach
    touch = layout.x_m - flat - np.sqrt(np.maximum(reach**2 - beside**2, 0.0))
    return float(min(touch[hit].min(initial=LENGTH_M), LENGTH_M))


def collision_object(model: mujoco.MjModel, data: mujoco.MjData) -> str:
    """Name of what the drone touches most deeply, e.g. "obstacle_07", "wall_west" or "ground"; "" for nothing."""
    drone = model.body("quadrotor").id
    deepest, name = np.inf, ""
    for contact in data.contact[: data.ncon]:
        bodies = [int(model.geom_bodyid[geom]) for geom in contact.geom]
        if drone in bodies and contact.dist < deepest:
            deepest, name = contact.dist, object_name(model, int(contact.geom[1 - bodies.index(drone)]))
    return name


def mostly_ahead(lanes: int, commands: int) -> np.ndarray:
    """Actions (commands, lanes), so that some games are lost and others go far."""
    random = np.random.default_rng(lanes)
    return np.where(random.random((commands, lanes)) < 0.6, 2, random.integers(5, size=(commands, lanes)))


def assert_same(ours: Any, theirs: Any) -> None:
    """Observations, to the byte; also in mappings."""
    if isinstance(theirs, dict):
        assert ours.keys() == theirs.keys()
        for name, array in theirs.items():
            assert_same(ours[name], array)
    else:
        assert ours.dtype == theirs.dtype
        assert ours.tobytes() == theirs.tobytes()


def assert_close(ours: Any, theirs: Any) -> None:
    """Infos; of conditions, those that were not sampled are missing or NaN."""
    if isinstance(theirs, dict):
        assert set(theirs) <= set(ours), (ours, theirs)
        for name, value in ours.items():
            assert name in theirs or name == "conditions" or np.isnan(value), name
            if name in theirs:
                assert_close(value, theirs[name])
    else:
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)


class SideBySide:
    """A batch and the same environments alone, each of whose commands give the same to the last bit.

    `ends` are the infos of the games that ended, in their order; `same` compares observations.
    """

    def __init__(
        self, batch: Any, alone: Sequence[FlightEnv[Any]], same: Callable[[Any, Any], None] = assert_same
    ) -> None:
        self.batch, self.alone, self._same = batch, alone, same
        self._waits = batch.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        self._over = [False] * len(alone)
        self.ends: list[Info] = []
        self._lasts: list[tuple[Any, Any]] = []  # observations of ended games

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        """Begin games everywhere; the batch's observations."""
        seen, _ = self.batch.reset(seed=seed, options=options)
        assert self.batch.observation_space.contains(seen)
        for lane, environment in enumerate(self.alone):
            begun = environment.reset(seed=None if seed is None else seed + lane, options=options)
            self._same(select(seen, lane), begun[0])
        self._over = [False] * len(self.alone)
        return seen

    def reset_one(self, lane: int) -> None:
        """Begin a lane's game, while the others' go on."""
        seen, _ = self.batch.reset(options={"reset_mask": np.arange(self.batch.num_envs) == lane})
        for environment in self.alone[lane : lane + 1]:
            self._same(select(seen, lane), environment.reset()[0])
            self._over[lane] = False

    def charge(self, spent_s: float, phase: str = "inference") -> None:
        self.batch.call_each("charge", [(spent_s, phase)] * self.batch.num_envs)
        for environment in self.alone:
            environment.charge(spent_s, phase)

    def step(self, actions: Any, lanes: Sequence[int] | None = None) -> Any:
        """Fly a command in these lanes, by default all; what the batch says of it."""
        which = range(self.batch.num_envs) if lanes is None else lanes
        self.batch.step_async(actions[list(which)], lanes)
        flown = self.batch.step_wait(lanes)
        assert lanes is not None or self.batch.observation_space.contains(flown[0])
        for place, lane in enumerate(which):
            if lane < len(self.alone):
                self._compare(lane, actions[lane], select(flown[0], place), *(part[place] for part in flown[1:]))
        for seen, expected in self._lasts:  # those of earlier games stay as they were
            self._same(seen, expected)
        return flown

    def _compare(self, lane: int, action: Any, seen: Any, *told: Any) -> None:
        environment, ended = self.alone[lane], self._over[lane]
        if ended:  # and begins anew with this command
            begun = environment.reset()
            expected: Any = (begun[0], 0.0, False, False, begun[1])
        else:
            expected = environment.step(action)
        over, found = bool(expected[2] or expected[3]), told[3]
        self.ends += [expected[4]] * over
        assert told[:3] == expected[1:4]
        if over and not self._waits:
            self._lasts.append((found["final_obs"], expected[0]))
            assert found["final_info"] == expected[4]
            found = {name: value for name, value in found.items() if not name.startswith("final")}
            expected = environment.reset()
        self._same(seen, expected[0])
        assert found == expected[-1]
        self._over[lane] = over and self._waits

    def move(self, batch: Any, alone: Sequence[FlightEnv[Any]]) -> None:
        """Go on in another batch and other environments, from files of the running games."""
        for lane, state in enumerate(self.batch.call_each("get_state", [()] * batch.num_envs)):
            (seen,) = batch.call_each("set_state", [(stored(state),)], [lane])
            self._same(seen, select(self.batch.observations(), lane))
        for before, environment in zip(self.alone, alone, strict=True):
            environment.set_state(stored(before.get_state()))
        self.batch, self.alone = batch, alone


def stored(state: Any) -> Any:
    """A saved game, read from a file."""
    file = io.BytesIO()
    np.savez(file, **state)
    file.seek(0)
    return dict(np.load(file))
