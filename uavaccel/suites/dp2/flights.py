"""One game of DP2: the path flown with a camera, and what it saw."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavaccel.commands import COMMANDS
from uavaccel.commands.slices import samples_due
from uavaccel.envs.camera_client import CameraClient, Sample
from uavaccel.kinematics import VelocityGoal
from uavaccel.suites.disturbed import note_stalls
from uavaccel.suites.dp2.cases import Case, Dp2Collision, Dp2Row, velocities
from uavaccel.suites.dp2.config import Dp2Config, Velocity
from uavaccel.suites.dp2.event_client import Arrays, EventClient
from uavaccel.suites.experiment import t_th_ns
from uavaccel.units import NS_PER_S
from uavaccel.vision.dvs import luma
from uavaccel.vision.perturb import AutoExposure, PerturbationSettings, share_at
from uavaccel.wire.game_api import Collision
from uavaccel.wire.session import Session

SCENE = "lane"


class Flight(NamedTuple):
    """Samples with their indices: 0 is the start, then the place in the path, the same in every game."""

    samples: list[Sample]
    indices: list[int]
    commands: int
    wall_s: float
    collision: Collision | None


def fly_game(config: Dp2Config, case: Case, session: Session) -> tuple[Dp2Row, dict[str, np.ndarray]]:
    """Fly one game: its row, without the arrays' path, and its arrays (see `arrays_of`)."""
    seed = case.seed(config.seed)
    client = session.start_game(case.clock_speed, seed, config.wire_lane(), config.height_m)
    asked = (
        client,
        _picture(config, case),
        config.guard.settings(),
        _perturbation(config, case),
        AutoExposure() if config.auto_exposure else None,
    )
    counts: Arrays = {}
    if config.dvs_rate_hz is None:
        flight = fly_path(config, case, CameraClient(*asked))
    else:
        with EventClient(*asked, config=config, session=session) as camera:
            flight = fly_path(config, case, camera)
            counts = camera.arrays(len(flight.samples))
    speed, recording = client.speed(), client.recording()
    start = flight.samples[0].state
    row: Dp2Row = {
        "suite": "dp2",
        "case": case.id,
        "role": case.role,
        "command": case.command,
        "clock_speed": case.clock_speed,
        "t_move_s": config.t_move_s,
        "t_sample_s": config.t_sample_s,
        "timing": case.timing,
        "profile": config.profile,
        "seed": config.seed,
        "commands": flight.commands,
        "planned_commands": len(velocities(config)),
        "samples": len(flight.samples),
        "distance_m": _north_m(flight) - start.position_m[0],
        "collision": _collision(flight),
        "guard_retries": sum(sample.retries for sample in flight.samples),
        "wall_s": flight.wall_s,
        "sim_time_s": speed["simulated_ns"] / NS_PER_S,
        "duration_s": round(int(recording.commands[-1, 1]) * recording.tick_ns / NS_PER_S, 9),
        "real_time_factor": speed["real_time_factor"],
        "lost_wall_s": speed["lost_wall_ns"] / NS_PER_S,
        "error": speed["failure"],
    }
    note_stalls(row, client.transport.stalled_ns)
    return row, arrays_of(flight, velocities(config)[: flight.commands]) | counts


def fly_path(config: Dp2Config, case: Case, camera: CameraClient) -> Flight:
    """Fly the path to its end or to a collision, and keep what was sampled up to there."""
    command, slots = COMMANDS[case.command], len(samples_due(config.t_move_s, config.t_sample_s))
    t_th = t_th_ns(config, case.clock_speed, config.t_sample_s)
    samples, indices, commands = [camera.gather(camera.kinematics())], [0], 0
    command.begin(camera)
    start_ns = camera.now_ns()
    for velocity in velocities(config):
        goal = VelocityGoal((*velocity, 0.0), config.height_m)
        flown = list(command.fly(camera, goal, config.t_move_s, config.t_sample_s, t_th))
        first, commands = 1 + commands * slots, commands + 1
        # The last sample is always that of the command's end; ADSC may come too late for one before it.
        indices += [*range(first, first + len(flown) - 1), first + slots - 1]
        samples += flown
        if _stands_still(samples) and camera.client.collision():
            break
    wall_s = (camera.now_ns() - start_ns) / NS_PER_S
    collision = camera.client.collision()
    kept = _before(collision, samples)
    return Flight(samples[:kept], indices[:kept], commands, wall_s, collision)


def _stands_still(samples: list[Sample]) -> bool:
    """Whether nothing has moved between the last two samples: a collision freezes the vehicle where it is."""
    return samples[-1].state.position_m == samples[-2].state.position_m


def _before(collision: Collision | None, samples: list[Sample]) -> int:
    """How many samples were taken before the collision; the others show a vehicle that stands frozen."""
    if not collision:
        return len(samples)
    return sum(sample.state.time_ns <= collision["time_ns"] for sample in samples)


def _picture(config: Dp2Config, case: Case) -> str:
    """Colour where colours can go wrong, and once per run, to study the guard with; else what the DVS needs."""
    return "colour" if case.role == "lockstep" or _perturbation(config, case) else "gray"


def _perturbation(config: Dp2Config, case: Case) -> PerturbationSettings | None:
    if case.role != "game" or config.perturbation.share == 0:
        return None
    seed, model = int(case.seed(config.seed).generate_state(1)[0]), config.perturbation
    share = share_at(case.clock_speed, model.share, model.half_excess)
    return PerturbationSettings(share, model.kinds, seed)


def _north_m(flight: Flight) -> float:
    collision = flight.collision
    return float(collision["position_m"][0] if collision else flight.samples[-1].state.position_m[0])


def _collision(flight: Flight) -> Dp2Collision | None:
    if not flight.collision:
        return None
    since_start_ns = flight.collision["time_ns"] - flight.samples[0].state.time_ns
    return {
        "object": flight.collision["object"],
        "time_s": since_start_ns / NS_PER_S,
        "position_m": list(flight.collision["position_m"]),
    }


def arrays_of(flight: Flight, flown: tuple[Velocity, ...]) -> dict[str, np.ndarray]:
    """Arrays of a game, n samples: `sample_index`, `time_s` since the start, `position_m` (n, 3) NED,
    `orientation_wxyz` (n, 4), `image` (n, 144, 256) gray, `retries`; `command_velocity_m_s` (commands, 2);
    and, where the camera took it, `colour` (n, 144, 256, 3).
    """
    states = [sample.state for sample in flight.samples]
    images = np.stack([sample.image for sample in flight.samples])
    arrays = {
        "sample_index": np.array(flight.indices, np.int32),
        "time_s": np.array([(state.time_ns - states[0].time_ns) / NS_PER_S for state in states]),
        "position_m": np.array([state.position_m for state in states]),
        "orientation_wxyz": np.array([state.orientation_wxyz for state in states]),
        "retries": np.array([sample.retries for sample in flight.samples], np.int32),
        "command_velocity_m_s": np.array(flown),
    }
    if images.ndim == 3:
        return arrays | {"image": images}
    return arrays | {"image": np.stack([luma(image) for image in images]), "colour": images}
