"""Who flies a film's game, and in what: an agent and an environment that keep what happened."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.decisions import Decisions
from uavaccel.envs.flight_client import FlightClient, FlightSample
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.task import Moment
from uavaccel.kinematics import Quaternion, Vector
from uavaccel.rl.agents import Agent, PolicyAgent
from uavaccel.wire.session import VirtualSession


class Seen(NamedTuple):
    """The front camera's gray picture, when and where it was taken, and during which of the game's commands."""

    time_ns: int
    image: NDArray[np.uint8]
    position_m: Vector
    orientation_wxyz: Quaternion
    command: int


class FilmedLane(ObstacleLane):
    """An `ObstacleLane` that remembers the samples of the running game, and the moment of impact.

    What the agent is not shown is looked at without a message, which only `virtual` and `lockstep` can do.
    """

    def __init__(self, **task: Any) -> None:
        super().__init__(**task)
        self.samples: list[Seen] = []

    def _see(self, sample: FlightSample) -> NDArray[Any]:
        state = sample.state
        image = sample.image if self.task.observation == "dvs" else self._picture()
        self.samples.append(
            Seen(state.time_ns, image, state.position_m, state.orientation_wxyz, self._now.commands)
        )
        return super()._see(sample)

    def _fly(self, client: FlightClient, action: Any) -> Moment:
        flown = super()._fly(client, action)
        if flown.collision is not None:
            time_ns, attitude = client.client.collision()["time_ns"], flown.state.orientation_wxyz
            image = (
                self._picture() if isinstance(self._session, VirtualSession) else client.client.image("gray")
            )
            self.samples.append(Seen(time_ns, image, flown.position_m, attitude, self._now.commands))
        return flown

    def _picture(self) -> NDArray[np.uint8]:
        assert isinstance(self._session, VirtualSession)
        return self._session.picture()


class FilmedAgent:
    """An agent that remembers what it was given, how it rated its actions, and which it took."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._rated_as = ""
        self._given: list[NDArray[Any]] = []
        self._ratings: list[NDArray[np.float64]] = []
        self._taken: list[int] = []

    def act(self, observation: NDArray[Any], info: dict[str, Any]) -> int:
        action = self._agent.act(observation, info)
        if isinstance(self._agent, PolicyAgent):
            self._rated_as, ratings = self._agent.policy.rate(observation[None])
            self._given.append(observation.copy())
            self._ratings.append(ratings[0])
            self._taken.append(action)
        return action

    def decisions(self, headings_deg: tuple[float, ...], of_sample: list[int]) -> Decisions | None:
        """What was decided in the game, whose samples belong to those commands; None of a baseline."""
        if not self._taken:
            return None
        given = np.stack(self._given)
        pictures = given if given.ndim == 4 else None
        ratings, taken = np.stack(self._ratings), np.array(self._taken)
        return Decisions(ratings, taken, headings_deg, np.array(of_sample), self._rated_as, pictures)
