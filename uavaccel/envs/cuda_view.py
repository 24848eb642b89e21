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

    In all methods, `which` (L,) uint8 selects lanes. `pixels` is a kernels/events.Pixels of tensors; event cameras see
    pictures in `gray`, or at once what they would see there.
    """

    def __init__(self, task: Task, games: LaneGames, now: Any, tick_ns: int) -> None:
        maker, device = games.maker, games.device
        self.kind, self._count, self._device, self._tick_ns = kind_of(task), games.count, device, tick_ns
        self.kernels, self._games, self._now = kernels.compiled(maker.nominal), games.arrays, now
        parameters, size = task.dvs_parameters, task.picture_size[::-1]
        frame = blank_frame("dvs", task.picture_size).shape[1:]
        self._size, self._frame, self._side = size, frame, size[0] // frame[0]
        seen = games.count if self.kind == DVS else 0
        pixels = events.pixels_of(seen, parameters, size, frame)
        camera = events.camera_row(parameters, task.image_noise)
        self._plain = games.one_camera and events.is_plain(camera, pixels.filtered.size)
        rests = self.kind == DVS and parameters.refractory_s > 0
        if rests and games.one_camera:
            ticks = 1 if task.dvs_ticks or not passes_together(task) else int(slices_of(task).ticks.min())
            rests = can_suppress(make_sensor(parameters, size, task.dvs_seed), ticks * tick_ns * events.NS)
        self._most = th.ones(games.count if rests else 0, dtype=th.int32, device=device)
        self.pixels, self._pixels = kernels.on_device(pixels, device)
        self._gray = th.zeros((seen, *size), dtype=th.uint8, device=device)
        looks, self._looks = kernels.on_device(maker.looks, device)
        draws = events.sensor_of(sample_pixels(parameters, size, task.dvs_seed))
        sensor, self._sensor = kernels.on_device(draws, device)
        hull = th.tensor(maker.surroundings.hull, device=device)
        self.hull = kernels.shared(hull)
        self._memory = [looks, sensor, hull]  # keeps alive what numba arrays refer to
        self._allocate()

    @abstractmethod
    def _allocate(self) -> None:
        """Allocate what the cameras of a kind need."""

    def start(self, which: th.Tensor) -> None:
        """Initialise event cameras with their games' first images."""
        going = self._look(which, self._now)
        self._draw_gray(going, self._now)
        seeing = kernels.shared(self._gray), self._sensor, self._games, self._now, self._pixels
        self._in_tiles("start_events", self._size)(going, *seeing)

    def render(self, which: th.Tensor, frames: th.Tensor, take: bool = True, now: Any = None) -> None:
        """Observe `now`, by default the present, as `frames` (L, ...); event cameras sum events until `take`."""
        now = now or self._now
        going = self._look(which, now)
        if self.kind == DVS:
            self._see(going, kernels.shared(frames[:, 0]), take, now)
        else:
            self._show(going, kernels.shared(frames), now)

    def show(self, which: th.Tensor, frames: th.Tensor) -> None:
        """Render the present `frames` (L, ...), in colour or of depth."""
        self._show(self._look(which, self._now), kernels.shared(frames), self._now)

    @abstractmethod
    def add_levels(self, which: th.Tensor, sums: th.Tensor) -> None:
        """Write the sums (L, 3) int64 of red, green and blue over the latest images, or of grey, then -1 twice."""

    @abstractmethod
    def _look(self, which: th.Tensor, now: Any) -> Any:
        """Find what the cameras see of their scenes; return the selected lanes."""

    @abstractmethod
    def _draw_gray(self, going: Any, now: Any) -> None:
        """Write what they see to `_gray`."""

    @abstractmethod
    def _show(self, going: Any, frames: Any, now: Any) -> None:
        """Write what they see to frames, in colour or of depth."""

    def _see(self, going: Any, frames: Any, take: bool, now: Any) -> None:
        """Let event cameras see; with `take` move their sums to frames (L, rows, columns)."""
        self._draw_gray(going, now)
        seeing = kernels.shared(self._gray), self._sensor, self._games, now, self._pixels
        blocks = -(-self._size[0] * self._size[1] // BLOCK_SIDE)
        for rest in self._passes():
            self._kernel("see_gray", blocks)(going, self._tick_ns, *seeing, rest)
        self._finish(going, now)
        if take:
            self._in_tiles("take_frames", self._frame)(going, now, self._pixels, frames)

    def _passes(self) -> Sequence[tuple[Any, ...]]:
        """Return what each of a frame's passes over the pixels is told of their rest: the first may only count."""
        if not len(self._most):
            return [()]
        self._most.fill_(1)
        return [events.Rest(self._pixels.last_s, kernels.shared(self._most), counting) for counting in (1, 0)]

    def _finish(self, going: Any, now: Any) -> None:
        self._kernel("finish", 1, kernels.FLYING_THREADS)(going, self._tick_ns, now, self._pixels)

    def _kernel(self, name: str, threads: int, per_block: int = kernels.SEEING_THREADS) -> Any:
        """Return a kernel, to be launched with so many threads a lane."""
        return getattr(self.kernels, name)[kernels.grid(self._count * threads, per_block)]

    def _in_tiles(self, name: str, size: Sequence[int]) -> Any:
        """Return a kernel, to be launched with a thread for each pixel of a picture, a warp to a tile."""
        return self._kernel(name, -(-size[0] // 4) * -(-size[1] // 8) * kernels.WARP)


class SceneView(View):
    """Cameras in still scenes, by rays (kernels/casting), in pictures of any size."""

    def _allocate(self) -> None:
        sight = tiles.sight_of(self._count, self._games.scenes.shapes.shape[1])
        memory, self._sight = kernels.on_device(sight, self._device)
        self._memory.append(memory)

    def add_levels(self, which: th.Tensor, sums: th.Tensor) -> None:
        """Raise NotImplementedError: what the guard judges is refused before (envs/simulators)."""
        raise NotImplementedError

    def _look(self, which: th.Tensor, now: Any) -> Any:
        going = kernels.shared(which)
        seen = self._looks, self._games, now, self._sight
        self._kernel("look", kernels.DEALING_THREADS, kernels.DEALING_THREADS)(going, self._size, *seen)
        return going

    def _draw_gray(self, going: Any, now: Any) -> None:
        seen = self._looks, self._games, now, self._sight, kernels.shared(self._gray)
        self._in_tiles("cast_gray", self._size)(going, *seen)

    def _show(self, going: Any, frames: Any, now: Any) -> None:
        name, tick_ns = ("cast_depth", ()) if self.kind == DEPTH else ("cast_colour", (self._tick_ns,))
        seen = self._looks, self._games, now, self._sight, frames
        self._in_tiles(name, self._size)(going, *tick_ns, self._side, *seen)


class LaneView(View):
    """Cameras in the obstacle lane, in pictures of 256 x 144: projection of the scenes' faces."""

    def _allocate(self) -> None:
        rendered = self._count if self.kind != STATE else 1
        faces = th.zeros((rendered, kernels.SLOTS, FIELDS), device=self._device)
        shown = th.zeros((rendered, ROWS, COLUMNS), dtype=th.int16, device=self._device)
        self._memory += faces, shown
        self._faces, self._shown = kernels.shared(faces), kernels.shared(shown)  # and the face that each pixel shows

    def add_levels(self, which: th.Tensor, sums: th.Tensor) -> None:
        sums.zero_()
        going = kernels.shared(which)
        if self.kind == DVS:
            if self._plain:  # otherwise it has been drawn to be seen
                self._draw_gray(going, self._now)
            sums[:, 0], sums[:, 1:] = self._gray.sum((1, 2)), -1
            return
        seen = self._faces, self._shown, self._looks, kernels.shared(sums)
        self._kernel("add_colours", COLUMNS, kernels.COLUMN_THREADS)(going, *seen)

    def _look(self, which: th.Tensor, now: Any) -> Any:
        going = kernels.shared(which)
        seen = self.kind != DEPTH, self._looks, self._games, now, self._faces
        self._kernel("project", kernels.WARP)(going, *seen)
        self._kernel("find", COLUMNS, kernels.COLUMN_THREADS)(going, self._faces, self._shown)
        return going

    def _draw_gray(self, going: Any, now: Any) -> None:
        seen = self._faces, self._shown, self._looks, kernels.shared(self._gray)
        self._kernel("draw_gray", kernels.SEEING_THREADS_A_LANE)(going, *seen)

    def _see(self, going: Any, frames: Any, take: bool, now: Any) -> None:
        if not self._plain:
            super()._see(going, frames, take, now)
            return
        seen = self._faces, self._shown, self._looks, self._sensor, self._games, now, self._pixels, frames
        self._kernel("see", kernels.SEEING_THREADS_A_LANE)(going, int(take), *seen)
        self._finish(going, now)

    def _show(self, going: Any, frames: Any, now: Any) -> None:
        seen = self._faces, self._shown, self._looks, self._games, now, frames
        self._kernel("show", kernels.BLOCKS)(going, self.kind, self._tick_ns, *seen)


def view_of(task: Task, games: LaneGames, now: Any, tick_ns: int) -> SceneView | LaneView:
    """Return the cameras of a task's lanes."""
    return (SceneView if isinstance(games.maker.looks, Looks) else LaneView)(task, games, now, tick_ns)
