"""The cameras of lanes on one GPU: projection of their scenes, then events, colour or depth."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import torch as th

from uavaccel.envs.cuda_games import LaneGames
from uavaccel.envs.kernel_games import slices_of
from uavaccel.envs.sensors import blank_frame
from uavaccel.envs.simulators import kind_of, passes_together
from uavaccel.envs.task import Task
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import events, tiles
from uavaccel.kernels.fields import COLUMNS, DEPTH, DVS, FIELDS, ROWS, STATE, Looks
from uavaccel.vision.dvs import can_suppress
from uavaccel.vision.dvs_sensor import BLOCK_SIDE, make_sensor, sample_pixels


class View(ABC):
    """The cameras of lanes that fly `games`; `now` is a kernels/lanes.Flights of numba arrays.

    In all methods, `which` (L,) uint8 selects lanes. `pixels` is a kernels/events.Pixels of tensors.
    """

    def __init__(self, task: Task, games: LaneGames, now: Any, tick_ns: int) -> None:
        maker, device = games.maker, games.device
        self.kind, self._count, self._device, self._tick_ns = kind_of(task), games.count, device, tick_ns
        self.kernels, self._games, self._now = kernels.compiled(maker.nominal), games.arrays, now
        parameters, size = task.dvs_parameters, task.picture_size[::-1]
        frame = blank_frame("dvs", task.picture_size).shape[1:]
        self._size, self._frame, self._side = size, frame, size[0] // frame[0]
        pixels = events.pixels_of(games.count if self.kind == DVS else 0, parameters, size, frame)
        camera = events.camera_row(parameters, task.image_noise)
        self._noisy = not games.one_camera or not events.is_plain(camera, pixels.filtered.size)
        rests = self.kind == DVS and parameters.refractory_s > 0
        if rests and games.one_camera:
            ticks = 1 if task.dvs_ticks or not passes_together(task) else int(slices_of(task).ticks.min())
            rests = can_suppress(make_sensor(parameters, size, task.dvs_seed), ticks * tick_ns * events.NS)
        self._most = th.ones(games.count if rests else 0, dtype=th.int32, device=device)
        self.pixels, self._pixels = kernels.on_device(pixels, device)
        looks, looks_arrays = kernels.on_device(maker.looks, device)
        draws = events.sensor_of(sample_pixels(parameters, size, task.dvs_seed))
        sensor, sensor_arrays = kernels.on_device(draws, device)
        hull = th.tensor(maker.surroundings.hull, device=device)
        self.plan = kernels.Plan(
            kernels.shared(hull), looks_arrays.texels, looks_arrays.textures, looks_arrays, sensor_arrays
        )
        self._memory = [looks, sensor, hull]  # keeps alive what numba arrays refer to
        self._allocate()

    @abstractmethod
    def _allocate(self) -> None:
        """Allocate what the cameras of a kind need."""

    @abstractmethod
    def start(self, which: th.Tensor) -> None:
        """Initialise event cameras with their games' first images."""

    @abstractmethod
    def render(self, which: th.Tensor, frames: th.Tensor, take: bool = True, now: Any = None) -> None:
        """Observe `now`, by default the present, as `frames` (L, ...); event cameras sum events until `take`."""

    @abstractmethod
    def show(self, which: th.Tensor, frames: th.Tensor) -> None:
        """Render the present `frames` (L, ...), in colour or of depth."""

    @abstractmethod
    def add_levels(self, which: th.Tensor, sums: th.Tensor) -> None:
        """Write the sums (L, 3) int64 of red, green and blue over the latest images, or of grey, then -1 twice."""

    def _kernel(self, name: str, threads: int, per_block: int = kernels.SEEING_THREADS) -> Any:
        """Return a kernel, to be launched with so many threads a lane."""
        return getattr(self.kernels, name)[kernels.grid(self._count * threads, per_block)]

    def _passes(self) -> Sequence[tuple[Any, ...]]:
        """Return what each of a frame's passes over the pixels is told of their rest: the first may only count."""
        if not len(self._most):
            return [()]
        self._most.fill_(1)
        return [events.Rest(self._pixels.last_s, kernels.shared(self._most), counting) for counting in (1, 0)]

    def _finish(self, which: Any, now: Any) -> None:
        self._kernel("finish", 1, kernels.FLYING_THREADS)(which, self._tick_ns, now, self._pixels)


class SceneView(View):
    """Cameras in still scenes, by rays (kernels/casting), in pictures of any size."""

    def _allocate(self) -> None:
        sight = tiles.sight_of(self._count, self._games.scenes.shapes.shape[1])
        memory, self._sight = kernels.on_device(sight, self._device)
        self._memory.append(memory)
        seen = self._count if self.kind == DVS else 0
        self._gray = th.zeros((seen, *self._size), dtype=th.uint8, device=self._device)

    def start(self, which: th.Tensor) -> None:
        going, gray = self._look(which, self._now), kernels.shared(self._gray)
        self._launch("start_cast", self._size)(going, gray, self.plan.sensor, self._games, self._now, self._pixels)

    def render(self, which: th.Tensor, frames: th.Tensor, take: bool = True, now: Any = None) -> None:
        now = now or self._now
        going = self._look(which, now)
        if self.kind != DVS:
            name, tick_ns = ("cast_depth", ()) if self.kind == DEPTH else ("cast_colour", (self._tick_ns,))
            seen = self.plan.appearance, self._games, now, self._sight, kernels.shared(frames)
            self._launch(name, self._size)(going, *tick_ns, self._side, *seen)
            return
        seeing = kernels.shared(self._gray), self.plan.sensor, self._games, now, self._pixels
        blocks = -(-self._size[0] * self._size[1] // BLOCK_SIDE)
        for rest in self._passes():
            self._kernel("cast_events", blocks)(going, self._tick_ns, *seeing, rest)
        self._finish(going, now)
        if take:
            self._launch("take_frames", self._frame)(going, now, self._pixels, kernels.shared(frames[:, 0]))

    def _look(self, which: th.Tensor, now: Any) -> Any:
        """Find what the cameras may see, and for event cameras what they see in grey; return the selected lanes."""
        going, seen = kernels.shared(which), (self.plan.appearance, self._games, now, self._sight)
        self._kernel("look", kernels.DEALING_THREADS, kernels.DEALING_THREADS)(going, self._size, *seen)
        if self.kind == DVS:
            self._launch("cast_gray", self._size)(going, *seen, kernels.shared(self._gray))
        return going

    def show(self, which: th.Tensor, frames: th.Tensor) -> None:
        self.render(which, frames)

    def add_levels(self, which: th.Tensor, sums: th.Tensor) -> None:
        """Raise NotImplementedError: what the guard judges is refused before (envs/simulators)."""
        raise NotImplementedError

    def _launch(self, name: str, size: Sequence[int]) -> Any:
        return self._kernel(name, -(-size[0] // 4) * -(-size[1] // 8) * kernels.WARP)


class LaneView(View):
    """Cameras in the obstacle lane, in pictures of 256 x 144: projection of the scenes' faces."""

    def _allocate(self) -> None:
        rendered = self._count if self.kind != STATE else 1
        self._faces = th.zeros((rendered, kernels.SLOTS, FIELDS), device=self._device)
        self._shown = th.zeros((rendered, ROWS, COLUMNS), dtype=th.int16, device=self._device)

    def start(self, which: th.Tensor) -> None:
        self._project(which, self._now)
        seen = self.plan, self._games, self._now, self._pixels
        self._kernel("start", kernels.SEEING_THREADS_A_LANE)(*self._looked_at(which), *seen)

    def render(self, which: th.Tensor, frames: th.Tensor, take: bool = True, now: Any = None) -> None:
        now = now or self._now
        self._project(which, now)
        if self.kind != DVS:
            self._show(which, frames, now)
            return
        going, faces, shown = self._looked_at(which)
        seen = (faces, shown, self.plan, self._games, now, self._pixels, kernels.shared(frames[:, 0]))
        self._kernel("see", kernels.SEEING_THREADS_A_LANE)(going, int(take), *seen)
        passes = self._passes() if self._noisy else []
        for rest in passes:
            taken = int(take and rest is passes[-1])
            self._kernel("see_noise", kernels.SEEING_THREADS_A_LANE)(going, self._tick_ns, taken, *seen, rest)
        self._finish(going, now)

    def show(self, which: th.Tensor, frames: th.Tensor) -> None:
        self._project(which, self._now)
        self._show(which, frames, self._now)

    def add_levels(self, which: th.Tensor, sums: th.Tensor) -> None:
        sums.zero_()
        pictures = (*self._looked_at(which), self.plan, kernels.shared(sums))
        if self.kind == DVS:
            sums[:, 1:] = -1
            self._kernel("add_grey", kernels.SEEING_THREADS_A_LANE)(*pictures)
            return
        self._kernel("add_colours", COLUMNS, kernels.COLUMN_THREADS)(*pictures)

    def _show(self, which: th.Tensor, frames: th.Tensor, now: Any) -> None:
        going, faces, shown = self._looked_at(which)
        picture = (faces, shown, self.plan, self._games, now, kernels.shared(frames))
        self._kernel("show", kernels.BLOCKS)(going, self.kind, self._tick_ns, *picture)

    def _project(self, which: th.Tensor, now: Any) -> None:
        going, faces, shown = self._looked_at(which)
        seen = self.kind != DEPTH, self.plan.appearance, self._games, now, faces
        self._kernel("project", kernels.WARP)(going, *seen)
        self._kernel("find", COLUMNS, kernels.COLUMN_THREADS)(going, faces, shown)

    def _looked_at(self, which: th.Tensor) -> tuple[Any, Any, Any]:
        """Return the selected lanes, their faces, and the face that each pixel shows, as numba arrays."""
        return kernels.shared(which), kernels.shared(self._faces), kernels.shared(self._shown)


def view_of(task: Task, games: LaneGames, now: Any, tick_ns: int) -> SceneView | LaneView:
    """Return the cameras of a task's lanes."""
    return (SceneView if isinstance(games.maker.looks, Looks) else LaneView)(task, games, now, tick_ns)
