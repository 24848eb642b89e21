"""Starts a renderer and hands out what its cameras need, from the process that starts the simulations too."""

from __future__ import annotations

import json
import os
import select
import subprocess

from uavaccel.child import start_python
from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.sim.camera.gl import GlRenderer
from uavaccel.sim.lane.layout import PLAIN
from uavaccel.sim.rendering.camera import RendererGoneError
from uavaccel.sim.rendering.slots import anonymous_memory, slot_dtype
from uavaccel.sim.scene.model import load_scene
from uavaccel.standstill import FIRST_LOOKS, LOOK_S, Standstill
from uavaccel.units import NS_PER_S

STOP_S = 3.0
END_S = 2.0  # between the end of its pipes and of the process


class RenderService:
    """A renderer of a scene for `cameras` cameras, which draws up to `tiles` pictures at once.

    It starts while the caller goes on; `ready` waits for it. It ends when every process that got `descriptors` has
    ended and `close` was called here, or this process has ended.
    """

    def __init__(self, scene: str, cameras: int, tiles: int, scenery: str = PLAIN) -> None:
        model = load_scene(scene, scenery=scenery)
        self.cameras = cameras
        self._memory = anonymous_memory(slot_dtype(model).itemsize * cameras)
        requests, self._requests = os.pipe()
        pipes = [os.pipe() for _ in range(cameras)]
        self._replies = [read for read, _ in pipes]
        theirs = [self._memory, requests, *(write for _, write in pipes)]
        options = {
            "scene": scene,
            "scenery": scenery,
            "cameras": cameras,
            "tiles": tiles,
            "memory": self._memory,
        }
        options |= {"requests": requests, "replies": theirs[2:]}
        self.process = start_python(
            *("-m", "uavaccel.sim.rendering.process", json.dumps(options)),
            stdout=subprocess.PIPE,
            pass_fds=theirs,
        )
        for descriptor in theirs[1:]:  # else nobody would see the end of a pipe
            os.close(descriptor)

    def ready(self) -> GlRenderer:
        """Who draws. Raises UserError where OpenGL is missing, RendererGoneError where nobody gets to."""
        assert self.process.stdout is not None
        standstill = Standstill()
        while not select.select([self.process.stdout], [], [], LOOK_S)[0]:
            if standstill.look([self.process.pid], looks=FIRST_LOOKS):
                self.process.kill()
                raise RendererGoneError("the renderer stands still, and did not get to drawing")
        line = self.process.stdout.readline()
        if not line:
            raise RendererGoneError(
                f"the renderer ended with status {self.process.wait()} before it could draw"
            )
        answer = json.loads(line)
        if "error" in answer:
            raise UserError(answer["error"])
        return GlRenderer(**answer)

    def status(self) -> str:
        """What became of the renderer, for a camera that got no picture."""
        try:
            return f"ended with status {self.process.wait(END_S)}"
        except subprocess.TimeoutExpired:
            return "does not answer"

    def descriptors(self, number: int) -> dict[str, int]:
        """Keywords of RemoteCamera for camera `number`: file descriptors that its process has to inherit."""
        return {"memory": self._memory, "requests": self._requests, "replies": self._replies[number]}

    def handed_out(self) -> None:
        """The processes that draw with it have been started: from here on only they hold its pipes' other ends."""
        for descriptor in self._replies:
            os.close(descriptor)
        self._replies = []

    def close(self) -> None:
        """Let the renderer end, once its cameras' processes have; ends it by force if it does not."""
        if self._requests < 0:
            return
        self.handed_out()
        os.close(self._requests)
        os.close(self._memory)
        self._requests = -1
        stop(self.process)


def stop(*processes: subprocess.Popen[bytes]) -> None:
    """Wait for processes that are about to end; kill those that do not, after STOP_S for all together."""
    clock = MonotonicClock()
    end_ns = clock.now_ns() + round(STOP_S * NS_PER_S)
    for process in processes:
        try:
            process.wait(max(end_ns - clock.now_ns(), 0) / NS_PER_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()
