"""Starts a rendering process, and provides the file descriptors of its cameras to the simulations' processes."""

from __future__ import annotations

import json
import os
import select
import subprocess

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.processes.forks import Fork
from uavaccel.processes.lifetime import Process, start_python
from uavaccel.processes.stalls import FIRST_POLLS, POLL_S, StallDetector, is_stopped
from uavaccel.sim.camera.gl import GlRenderer
from uavaccel.sim.lane.layout import PLAIN
from uavaccel.sim.rendering.camera import RendererGoneError
from uavaccel.sim.rendering.slots import anonymous_memory, slot_dtype
from uavaccel.sim.scene.model import load_scene
from uavaccel.units import NS_PER_S

STOP_S = 3.0
END_S = 2.0  # from the end of its pipes to that of the process


class RenderService:
    """A rendering process of a scene for `cameras` cameras, which renders up to `tiles` pictures at once.

    It starts in the background; `ready` waits for it. It ends when every process with `descriptors` has ended and
    either `close` was called here or this process has ended.
    """

    def __init__(self, scene: str, cameras: int, tiles: int, scenery: str = PLAIN) -> None:
        model = load_scene(scene, scenery=scenery)
        self.cameras = cameras
        self._memory = anonymous_memory(slot_dtype(model).itemsize * cameras)
        requests, self._requests = os.pipe()
        pipes = [os.pipe() for _ in range(cameras)]
        self._replies = [read for read, _ in pipes]
        theirs = [self._memory, requests, *(write for _, write in pipes)]
        options = {"scene": scene, "scenery": scenery, "cameras": cameras, "tiles": tiles}
        options |= {"memory": self._memory, "requests": requests, "replies": theirs[2:]}
        self.process = start_python(
            *("-m", "uavaccel.sim.rendering.process", json.dumps(options)), stdout=subprocess.PIPE, pass_fds=theirs
        )
        for descriptor in theirs[1:]:  # otherwise the end of a pipe would not be noticed
            os.close(descriptor)

    def ready(self) -> GlRenderer:
        """Wait for the start and return the renderer. Raises UserError without OpenGL, RendererGoneError on failure."""
        assert self.process.stdout is not None
        stalls = StallDetector()
        while not select.select([self.process.stdout], [], [], POLL_S)[0]:
            if stalls.poll([self.process.pid], polls=FIRST_POLLS):
                self.process.kill()
                raise RendererGoneError("the renderer hangs, and never drew")
        line = self.process.stdout.readline()
        if not line:
            raise RendererGoneError(f"the renderer ended with status {self.process.wait()} before it could draw")
        answer = json.loads(line)
        if "error" in answer:
            raise UserError(answer["error"])
        return GlRenderer(**answer)

    def status(self) -> str:
        """Describe the state of the process, for a camera that got no picture."""
        try:
            return f"ended with status {self.process.wait(END_S)}"
        except subprocess.TimeoutExpired:
            return "does not answer"

    def descriptors(self, number: int) -> dict[str, int]:
        """Return RemoteCamera's keywords for camera `number`: file descriptors that its process must inherit."""
        return {"memory": self._memory, "requests": self._requests, "replies": self._replies[number]}

    def handed_out(self) -> None:
        """Close the cameras' descriptors here, after the processes that inherit them were started."""
        for descriptor in self._replies:
            os.close(descriptor)
        self._replies = []

    def close(self) -> None:
        """End the process after those of its cameras, by force if it does not end."""
        if self._requests < 0:
            return
        self.handed_out()
        os.close(self._requests)
        os.close(self._memory)
        self._requests = -1
        stop(self.process)


def stop(*processes: Process | Fork) -> None:
    """Wait for processes that are about to end; kill those that are stopped, and those left after STOP_S in total."""
    clock = MonotonicClock()
    end_ns = clock.now_ns() + round(STOP_S * NS_PER_S)
    for process in processes:
        if is_stopped(process.pid):
            process.kill()
        try:
            process.wait(max(end_ns - clock.now_ns(), 0) / NS_PER_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()
