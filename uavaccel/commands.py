"""The paper's two synchronous commands, ADSC and TCSC, which depend only on a client's interface, and their paths.

ADSC is the AirSim Default Synchronous Command (section II-B), TCSC the Time-Controlled Simulation Command (section
III-B and Figure 4): it pauses the simulation whenever no command flies, so that latencies do not affect the trajectory.
With `AirSimAdapter` both fly a real AirSim.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.kinematics import FlightGoal, Kinematics, Quaternion, Vector, airsim_command
from uavaccel.kinematics import VelocityGoal as VelocityGoal
from uavaccel.units import NS_PER_S, seconds_to_ns

FutureT = TypeVar("FutureT")
SampleT = TypeVar("SampleT", covariant=True)


class Pausable(Protocol):
    """A client that pauses and resumes the simulation."""

    def pause(self) -> None: ...

    def run(self) -> None: ...


class MissionClient(Pausable, Protocol[FutureT, SampleT]):
    """The mission computer's side of the Client API (paper, section II-B)."""

    @property
    def clock_speed(self) -> float:
        """Simulated seconds per wall second."""
        ...

    def now_ns(self) -> int:
        """Return the time on the client's wall clock."""
        ...

    def move_async(self, goal: FlightGoal, t_move_s: float) -> FutureT:
        """Issue a velocity command and return its future without waiting."""
        ...

    def join(self, future: FutureT, deadline_ns: int | None = None) -> bool:
        """Wait for the command's end and return True, or False if the wall deadline comes first."""
        ...

    def continue_for(self, duration_ns: int) -> Kinematics:
        """Run for a simulated time, pause, and return the state."""
        ...

    def kinematics(self) -> Kinematics:
        """Return the present state."""
        ...

    def read_sample(self, state: Kinematics) -> SampleT:
        """Gather a sample while the simulation is paused: the state, with or without images."""
        ...


# Shortest last slice, as a share of T_sample: 1 s in steps of .33 s is three samples, as the paper counts them.
TAIL = 0.05


def slice_of(t_move_ns: int, t_sample_ns: int) -> int:
    """Return T_wakeup = min(T_move, T_sample), with a rest shorter than TAIL included. Raises UserError for none."""
    if t_sample_ns <= 0:
        raise UserError("t_sample_s: must be 1e-9 s or more")
    return t_move_ns if t_move_ns - t_sample_ns < TAIL * t_sample_ns else t_sample_ns


def samples_due(t_move_s: float, t_sample_s: float) -> list[int]:
    """Return the simulated nanoseconds from a command's start to each sample; the last one is its end."""
    due, left, t_sample = [0], seconds_to_ns(t_move_s), seconds_to_ns(t_sample_s)
    while left > 0:
        t_wakeup = slice_of(left, t_sample)
        due.append(due[-1] + t_wakeup)
        left -= t_wakeup
    return due[1:]


def check_times(t_move_s: float, t_sample_s: float, check_duration: Callable[[float, str], None]) -> None:
    """Call `check_duration(seconds, name)`, which may raise, for a command's duration and those of its slices."""
    check_duration(t_move_s, "t_move_s")
    check_duration(min(t_sample_s, t_move_s), "t_sample_s")
    due_ns = [0, *samples_due(t_move_s, t_sample_s)]
    for slice_ns in {later - earlier for earlier, later in pairwise(due_ns)}:
        check_duration(slice_ns / NS_PER_S, "t_sample_s")


def tcsc(
    client: MissionClient[FutureT, SampleT],
    goal: FlightGoal,
    t_move_s: float,
    t_sample_s: float,
    t_th_ns: int = 0,
    late_ns: int = 0,
) -> Iterator[SampleT]:
    """TCSC: fly `goal` for T_move and yield the state every T_sample, the simulation paused before and after.

    `t_th_ns`: simulated time below which a slice that ended early counts as complete; the client's latency times
    ClockSpeed where continue-for is a wall timer, 0 where it is exact. The paper never advances T_start; here
    deadlines are absolute, so neither an early nor a late end adds up. `late_ns`, less than T_move: simulated time for
    which the last command's goal acts on before this one does, to study what the age of its images costs.
    """
    state = client.kinematics()  # 1  measure the start, issue the command
    t_start = state.time_ns
    t_issue: int | None = t_start + late_ns
    t_move, t_sample = seconds_to_ns(t_move_s), seconds_to_ns(t_sample_s)
    while t_move > 0:
        t_wakeup = slice_of(t_move, t_sample)
        if t_issue is not None and t_issue < t_start + t_wakeup:
            if t_issue > state.time_ns:
                state = client.continue_for(t_issue - state.time_ns)
            client.move_async(goal, t_move_s)
            t_issue = None
        while (t_left := t_start + t_wakeup - state.time_ns) > t_th_ns:
            state = client.continue_for(t_left)  # 2  run, then pause; 3  woke early: run the difference
        yield client.read_sample(state)  # 4  gather, the clock stopped
        t_start, t_move = t_start + t_wakeup, t_move - t_wakeup


def adsc(
    client: MissionClient[FutureT, SampleT],
    goal: FlightGoal,
    t_move_s: float,
    t_sample_s: float,
    t_th_ns: int = 0,
    late_ns: int = 0,
) -> Iterator[SampleT]:
    """ADSC: fly `goal` for T_move, join, and yield a sample every T_sample; TCSC's last two arguments are ignored.

    The simulation goes on while the client waits for the command's end and computes, which TCSC avoids. One thread: it
    waits for the future or the next sample, whichever is due first. Every sample is taken by pause, gather, continue,
    the last one after the join.
    """
    t_issue = client.now_ns()
    future = client.move_async(goal, t_move_s)
    paused_ns = 0
    for t_due in samples_due(t_move_s, t_sample_s)[:-1]:
        if client.join(future, t_issue + paused_ns + round(t_due / client.clock_speed)):
            break
        t_pause = client.now_ns()
        sample = read_sample(client)
        paused_ns += client.now_ns() - t_pause
        yield sample
    client.join(future)
    yield read_sample(client)


def read_sample(client: MissionClient[FutureT, SampleT]) -> SampleT:
    """Gather one sample while the simulation is paused."""
    client.pause()
    sample = client.read_sample(client.kinematics())
    client.run()
    return sample


class Fly(Protocol):
    """The function of a command: it flies, and yields what the client gathers every T_sample."""

    def __call__(
        self,
        client: MissionClient[FutureT, SampleT],
        goal: FlightGoal,
        t_move_s: float,
        t_sample_s: float,
        t_th_ns: int = 0,
        late_ns: int = 0,
    ) -> Iterator[SampleT]: ...


class SynchronousCommand(NamedTuple):
    """A command, and what a game has to do before its first one."""

    begin: Callable[[Pausable], None]
    fly: Fly


COMMANDS = {  # for ADSC the clock runs from the game's beginning, for TCSC it stands between commands
    "adsc": SynchronousCommand(lambda client: client.run(), adsc),
    "tcsc": SynchronousCommand(lambda client: client.pause(), tcsc),
}


# the deterministic paths of the experiments, as lists of velocities (paper, sections III-A and III-C2)
SQUARE: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
TWO_FORWARD_ONE_BACK: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))

PATHS: dict[str, tuple[Vector, ...]] = {"square": SQUARE, "two_forward_one_back": TWO_FORWARD_ONE_BACK}


def velocities(path: str | Sequence[Vector], rounds: int, speed_m_s: float = 1.0) -> list[Vector]:
    """Return one velocity per command, NED m/s: a named path at `speed_m_s`, or the caller's own velocities."""
    if isinstance(path, str):
        once: Sequence[Vector] = [(x * speed_m_s, y * speed_m_s, z * speed_m_s) for x, y, z in PATHS[path]]
    else:
        once = path
    return list(once) * rounds


OfAirSim: TypeAlias = Any  # an object of AirSim's client, which has no types


class AirSimAdapter:
    """A `MissionClient` around an airsim.MultirotorClient, or what has its methods, with API control.

        import airsim
        client = AirSimAdapter(airsim.MultirotorClient(), clock_speed=10)
        for state in tcsc(client, VelocityGoal((1.0, 0.0, 0.0)), t_move_s=1.0, t_sample_s=0.33, t_th_ns=...):

    `clock_speed` is the simulator's ClockSpeed: AirSim's simContinueForTime takes wall seconds. There it ends by the
    scheduler's grain early or late, so TCSC wants a `t_th_ns` of the client's latency times ClockSpeed.
    """

    def __init__(self, client: OfAirSim, clock_speed: float, vehicle_name: str = "") -> None:
        self.client = client
        self.clock_speed = float(clock_speed)
        self.vehicle_name = vehicle_name
        self._clock = MonotonicClock()

    def now_ns(self) -> int:
        """See `MissionClient`."""
        return self._clock.now_ns()

    def move_async(self, goal: FlightGoal, t_move_s: float) -> OfAirSim:
        """Issue AirSim's command for the goal, and return its msgpack-rpc future."""
        name, arguments = airsim_command(goal, t_move_s)
        return getattr(self.client, f"{name}Async")(*arguments, self.vehicle_name)

    def join(self, future: OfAirSim, deadline_ns: int | None = None) -> bool:
        """Wait for the command's end; with a deadline, for that alone.

        AirSim's client cannot wait for both. ADSC's samples fall before the command's end, so it asks for no more.
        Raises msgpack-rpc's RPCError with the server's text, which AirSim's own join() keeps to itself.
        """
        if deadline_ns is not None:
            self._clock.sleep_until(deadline_ns)
            return False
        future.get()
        return True

    def pause(self) -> None:
        self.client.simPause(True)

    def run(self) -> None:
        self.client.simPause(False)

    def continue_for(self, duration_ns: int) -> Kinematics:
        self.client.simContinueForTime(duration_ns / NS_PER_S / self.clock_speed)
        return self.kinematics()

    def kinematics(self) -> Kinematics:
        state = self.client.getMultirotorState(self.vehicle_name)
        truth = state.kinematics_estimated  # SimpleFlight estimates by looking at the truth
        return Kinematics(
            int(state.timestamp),
            _vector(truth.position),
            _quaternion(truth.orientation),
            _vector(truth.linear_velocity),
            _vector(truth.angular_velocity),
            _vector(truth.linear_acceleration),
            _vector(truth.angular_acceleration),
        )

    def read_sample(self, state: Kinematics) -> Kinematics:
        return state


def _vector(vector: OfAirSim) -> Vector:
    return vector.x_val, vector.y_val, vector.z_val


def _quaternion(quaternion: OfAirSim) -> Quaternion:
    return quaternion.w_val, quaternion.x_val, quaternion.y_val, quaternion.z_val
