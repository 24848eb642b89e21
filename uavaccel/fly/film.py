"""A flight as the front camera saw it, with time, place and speed below: MP4."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from uavaccel.draw.film import movie
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S

FILE_NAME = "film.mp4"
FRAMES_PER_S = 12  # of simulated time, and of film
WIDTH, HEIGHT, BAND = 640, 360, 24
WHITE = (255, 255, 255)


@contextmanager
def filming(simulation: Simulation, world: World, folder: Path) -> Iterator[None]:
    """Film what is flown in the `with` block, at its own pace. Raises UserError without OpenGL."""
    every = NS_PER_S // FRAMES_PER_S // simulation.profile.tick_ns
    with movie(folder / FILE_NAME, (WIDTH, HEIGHT + BAND), FRAMES_PER_S) as add:
        end = world.watch(every, lambda _: add(_frame(simulation)))
        try:
            yield
        finally:
            end()


def _frame(simulation: Simulation) -> np.ndarray:
    picture = simulation.world.camera(WIDTH, HEIGHT).colour(simulation.world.data)
    frame = np.zeros((HEIGHT + BAND, WIDTH, 3), np.uint8)
    frame[:HEIGHT] = picture[..., ::-1]
    state = simulation.kinematics()
    north, east, down = state.position_m
    speed = float(np.linalg.norm(state.linear_velocity_m_s))
    text = f"{state.time_ns / NS_PER_S:7.2f} s   {north:.1f} {east:.1f} {down:.1f} m NED   {speed:.1f} m/s"
    cv2.putText(frame, text, (8, HEIGHT + 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, WHITE, 1, cv2.LINE_AA)
    return frame
