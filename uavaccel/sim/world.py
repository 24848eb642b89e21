"""One drone in one MuJoCo scene, stepped in whole ticks. No wall time, no commands, no threads."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Kinematics, Quaternion, Vector
from uavaccel.resources import asset
from uavaccel.sim import autopilot, hotloop
from uavaccel.sim.profile import Profile
from uavaccel.sim.quadrotor import FLIGHT_DTYPE, NEVER, Record, density_ratio, parameters
from uavaccel.units import ned_to_mujoco, quaternion_ned_to_mujoco

SAMPLE_CAPACITY = 1 << 16
START_M = (0.0, 0.0, -10.0)  # a game starts from a settled hover 10 m up
LEVEL = (1.0, 0.0, 0.0, 0.0)


class FlightError(RuntimeError):
    """MuJoCo warned of a state it could not integrate; the game is void."""


class World:
    """A scene of assets/mjcf with its quadrotor, flown by SimpleFlight's cascade.

    `freeze_on_collision` stops the vehicle where it first touches anything; otherwise MuJoCo's contacts act.
    """

    def __init__(self, scene: str | Path, profile: Profile, freeze_on_collision: bool = False) -> None:
        path = scene if isinstance(scene, Path) else asset(f"mjcf/{scene}.xml")
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.model.opt.timestep = profile.tick_s
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self.profile = profile
        self.freeze_on_collision = freeze_on_collision
        body = self.model.body("quadrotor").id
        mass, inertia = self.model.body_mass[body], self.model.body_inertia[body]
        self.parameters = parameters(profile.tick_s, profile.hover_after_ticks, mass, inertia)
        self.state: Record = np.zeros(1, FLIGHT_DTYPE)[0]
        self._recorder: Record = np.zeros(1, hotloop.RECORDER_DTYPE)[0]
        self._samples = np.empty((SAMPLE_CAPACITY, hotloop.SAMPLE_COLUMNS))
        self._mj_step = hotloop.mj_step_address()
        self.stop_recording()
        self.reset()

    @property
    def tick(self) -> int:
        return int(self.state["tick"])

    @property
    def collision_tick(self) -> int | None:
        """Tick of the first touch since the last reset."""
        tick = int(self.state["collision_tick"])
        return None if tick == NEVER else tick

    def reset(self, position_m: Vector = START_M, orientation_wxyz: Quaternion = LEVEL) -> None:
        """Tick 0, at rest in a settled position hold at `position_m`; the recorder stops."""
        self.stop_recording()
        wind = self.state["wind"].copy()
        self.state["tick"] = 0
        for name in FLIGHT_DTYPE.names or ():
            self.state[name] = 0
        self.state["wind"] = wind
        self.state["armed"] = 1
        self.state["hover_tick"] = self.state["collision_tick"] = NEVER
        self.place(position_m, orientation_wxyz)
        self._settle()

    def place(
        self, position_m: Vector, orientation_wxyz: Quaternion = LEVEL, velocity_m_s: Vector = (0.0, 0.0, 0.0)
    ) -> None:
        """Put the vehicle somewhere (NED, wxyz), not turning; its autopilot and rotors go on as they are."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:3] = ned_to_mujoco(position_m)
        self.data.qpos[3:7] = quaternion_ned_to_mujoco(orientation_wxyz)
        self.data.qvel[:3] = ned_to_mujoco(velocity_m_s)
        self.state["collision_tick"] = NEVER
        hotloop.read_pose(self.state, self.data.qpos)
        hotloop.kick(self.parameters, self.state, self.data.qvel, self.data.qfrc_applied)

    def _settle(self) -> None:
        """Give rotors, integrator and height goal the values that a long position hold arrives at."""
        state, gains = self.state, self.parameters
        weight = gains["mass_kg"] * gains["gravity_m_s2"]
        thrust = gains["max_thrust_n"] * density_ratio(gains, state["position"][2])
        hover = weight / (4 * thrust)
        for name in ("rotor_input", "rotor_lagged", "rotor_output"):
            state[name] = hover
        autopilot.hold_position(state)
        gathered = gains["tick_s"] * gains["z_integral_gain"] / (1.0 - gains["z_integral_keep"])
        error_m_s = (1.0 - 2.0 * hover) / (gains["velocity_gain"][2] + gathered)
        state["z_integral"] = gathered * error_m_s
        state["z_integral_mode"] = autopilot.POSITION
        state["goal"][2] += error_m_s / (gains["position_gain"][2] * gains["velocity_limit_m_s"])
        hotloop.kick(gains, state, self.data.qvel, self.data.qfrc_applied)

    def advance(self, ticks: int) -> int:
        """Fly up to `ticks` ticks; returns how many: fewer where something is touched for the first time.

        Raises FlightError if MuJoCo warns.
        """
        if self.freeze_on_collision and self.collision_tick is not None:
            return int(hotloop.stand_still(self.state, self._recorder, self._samples, ticks))
        flown = hotloop.fly(
            self._mj_step,
            self.model._address,
            self.data._address,
            self.data.qpos,
            self.data.qvel,
            self.data.qfrc_applied,
            self.data.sensordata,
            self.parameters,
            self.state,
            self._recorder,
            self._samples,
            ticks,
        )
        self._check_warnings()
        return int(flown)

    def _check_warnings(self) -> None:
        counts = self.data.warning.number
        if counts.any():
            kind = mujoco.mjtWarning(int(np.flatnonzero(counts)[0])).name
            raise FlightError(f"MuJoCo warned of {kind} at tick {self.tick}")

    def fly_velocity(self, goal: Vector, height_held: bool, yaw: float, yaw_is_rate: bool) -> None:
        """Set the autopilot's goal: NED m/s, the third a height in m if held; yaw in rad or rad/s."""
        state = self.state
        state["goal"][:3] = goal
        state["goal"][3] = yaw
        state["xy_mode"] = autopilot.VELOCITY
        state["z_mode"] = autopilot.POSITION if height_held else autopilot.VELOCITY
        state["yaw_mode"] = autopilot.RATE if yaw_is_rate else autopilot.ANGLE

    def hold_from(self, tick: int | None) -> None:
        """Position hold sets in at `tick`; None: not at all."""
        self.state["hover_tick"] = NEVER if tick is None else tick

    def kinematics(self, origin_ns: int = 0) -> Kinematics:
        """The state at the present tick, NED and FRD; `origin_ns` is the simulated time of tick 0."""
        state = self.state
        return Kinematics(
            origin_ns + self.tick * self.profile.tick_ns,
            tuple(state["position"].tolist()),
            tuple(state["quaternion"].tolist()),
            tuple(state["velocity"].tolist()),
            tuple(state["rate"].tolist()),
            tuple(state["acceleration"].tolist()),
            tuple(state["angular_acceleration"].tolist()),
        )

    @property
    def recording(self) -> bool:
        return int(self._recorder["next_tick"]) != NEVER

    def start_recording(self) -> None:
        """Sample the state at this tick and then on the profile's grid, into an emptied buffer."""
        recorder = self._recorder
        recorder["count"] = recorder["dropped"] = 0
        recorder["period"] = self.profile.recorder_ticks
        recorder["next_tick"] = self.tick
        hotloop.record(recorder, self._samples, self.state)

    def stop_recording(self) -> None:
        self._recorder["next_tick"] = NEVER

    def samples(self) -> NDArray[np.float64]:
        """Copy of the recorded rows (n, 14): tick, position, wxyz, velocity, body rate."""
        return self._samples[: int(self._recorder["count"])].copy()

    @property
    def samples_dropped(self) -> int:
        """Samples that found the buffer full."""
        return int(self._recorder["dropped"])
