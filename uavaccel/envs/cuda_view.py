"""The cameras of lanes on one GPU: projection of their scenes, then events, colour or depth."""

from __future__ import annotations

from typing import Any

import torch as th

from uavaccel.envs.flyable import kind_of
from uavaccel.envs.kernel_games import GameMaker
from uavaccel.envs.task import Task
from uavaccel.kernels import cuda as kernels
from uavaccel.kernels import events
from uavaccel.kernels.fields import COLUMNS, DEPTH, DVS, FIELDS, NO_APPEARANCE, ROWS, STATE
from uavaccel.vision.dvs_sensor import sample_pixels


class LaneView:
    """The cameras of `count` lanes; `games` and `now` are kernels/lanes.Games and Flights of numba arrays.

    In all methods, `which` (L,) uint8 selects lanes. `pixels` is a kernels/events.Pixels of tensors.
    """

    def __init__(
        self, task: Task, maker: GameMaker, count: int, device: th.device, games: Any, now: Any, tick_ns: int
    ) -> None:
        self.kind, self._count, self._tick_ns = kind_of(task), count, tick_ns
        self._kernels, self._games, self._now = kernels.compiled(maker.nominal), games, now
        parameters = task.dvs_parameters
        self.pixels, self._pixels = kernels.on_device(
            events.pixels_of(count if self.kind == DVS else 0, parameters), device
        )
        appearance, appearance_arrays = kernels.on_device(maker.appearance or NO_APPEARANCE, device)
        sensor, sensor_arrays = kernels.on_device(
            events.sensor_of(sample_pixels(parameters, (ROWS, COLUMNS), task.dvs_seed)), device
        )
        hull = th.tensor(maker.surroundings.hull, device=device)
        self.plan = kernels.Plan(
            kernels.shared(hull), appearance_arrays.texels, appearance_arrays.textures, appearance_arrays, sensor_arrays
        )
        self._memory = appearance, sensor, hull  # keeps alive what the plan's numba arrays refer to
        rendered = count if self.kind != STATE else 1
        self._faces = th.zeros((rendered, kernels.SLOTS, FIELDS), device=device)
        self._shown = th.zeros((rendered, ROWS, COLUMNS), dtype=th.int16, device=device)

    def start(self, which: th.Tensor) -> None:
        """Initialise event cameras with their games' first images."""
        self._project(which, self._now)
        self._launch_quads("start")(*self._looked_at(which), self.plan, self._games, self._now, self._pixels)

    def render(self, which: th.Tensor, frames: th.Tensor, take: bool = True, now: Any = None) -> None:
        """Observe `now`, by default the present, as `frames` (L, ...); event cameras sum events until `take`."""
        now = now or self._now
        self._project(which, now)
        if self.kind != DVS:
            self._show(which, frames, now)
            return
        going, faces, shown = self._looked_at(which)
        seen = (faces, shown, self.plan, self._games, now, self._pixels, kernels.shared(frames[:, 0]))
        self._launch_quads("see")(going, int(take), *seen)
        self._launch_quads("see_noise")(going, self._tick_ns, int(take), *seen)
        per_lane = kernels.grid(self._count, kernels.FLYING_THREADS)
        self._kernels.finish[per_lane](going, self._tick_ns, now, self._pixels)

    def show(self, which: th.Tensor, frames: th.Tensor) -> None:
        """Render the present `frames` (L, ...), in colour or of depth."""
        self._project(which, self._now)
        self._show(which, frames, self._now)

    def add_levels(self, which: th.Tensor, sums: th.Tensor) -> None:
        """Write the sums (L, 3) int64 of red, green and blue over the latest images, or of grey, then -1 twice."""
        sums.zero_()
        pictures = (*self._looked_at(which), self.plan, kernels.shared(sums))
        if self.kind == DVS:
            sums[:, 1:] = -1
            self._launch_quads("add_grey")(*pictures)
            return
        grid = kernels.grid(self._count * COLUMNS, kernels.COLUMN_THREADS)
        self._kernels.add_colours[grid](*pictures)

    def _show(self, which: th.Tensor, frames: th.Tensor, now: Any) -> None:
        going, faces, shown = self._looked_at(which)
        grid = kernels.grid(self._count * kernels.BLOCKS, kernels.SEEING_THREADS)
        picture = (faces, shown, self.plan, self._games, now, kernels.shared(frames))
        self._kernels.show[grid](going, self.kind, self._tick_ns, *picture)

    def _project(self, which: th.Tensor, now: Any) -> None:
        grid = kernels.grid(self._count * kernels.WARP, kernels.SEEING_THREADS)
        going, faces, shown = self._looked_at(which)
        self._kernels.project[grid](going, self.kind != DEPTH, self.plan.appearance, self._games, now, faces)
        grid = kernels.grid(self._count * COLUMNS, kernels.COLUMN_THREADS)
        self._kernels.find[grid](going, faces, shown)

    def _launch_quads(self, name: str) -> Any:
        grid = kernels.grid(self._count * kernels.SEEING_THREADS_A_LANE, kernels.SEEING_THREADS)
        return getattr(self._kernels, name)[grid]

    def _looked_at(self, which: th.Tensor) -> tuple[Any, Any, Any]:
        """Return the selected lanes, their faces, and the face that each pixel shows, as numba arrays."""
        return kernels.shared(which), kernels.shared(self._faces), kernels.shared(self._shown)
