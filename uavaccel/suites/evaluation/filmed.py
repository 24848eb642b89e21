"""What a film shows of a game: its samples, and what the agent was given and decided."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.decisions import Decisions
from uavaccel.envs.flight_client import FlightSample
from uavaccel.envs.observer import Game, Observer
from uavaccel.envs.values import Frame, Info
from uavaccel.kinematics import Quaternion, Vector
from uavaccel.rl.agents import Agent, PolicyAgent


class Seen(NamedTuple):
    """The front camera's gray picture, when and where it was taken, and during which of the game's commands."""

    time_ns: int
    image: NDArray[np.uint8]
    position_m: Vector
    orientation_wxyz: Quaternion
    command: int


class SamplesSeen(Observer):
    """The samples of the running game, the last of them at the moment of impact.

    What the agent is not shown is looked at without a message, which only `virtual` and `lockstep` can do.
    """

    def __init__(self) -> None:
        self.samples: list[Seen] = []

    def game_begun(self, game: Game) -> None:
        self._game = game
        self.samples = []

    def sample_taken(self, sample: FlightSample, command: int) -> None:
        state, hit = sample.state, sample.collision
        time_ns = hit["time_ns"] if hit else state.time_ns
        north, east, down = hit["position_m"] if hit else state.position_m
        shown = self._game.task.observation == "dvs" and not hit
        image = sample.image if shown else self._game.session.picture()
        self.samples.append(Seen(time_ns, image, (north, east, down), state.orientation_wxyz, command))


class FilmedAgent:
    """An agent that remembers what it was given, how it rated its actions, and which it took."""

    def __init__(self, agent: Agent) -> None:
        self._agent = agent
        self._rated_as = ""
        self._given: list[Frame] = []
        self._ratings: list[NDArray[np.float64]] = []
        self._taken: list[int] = []

    def act(self, observation: Frame, info: Info) -> int:
        if not isinstance(self._agent, PolicyAgent):
            return self._agent.act(observation, info)
        self._rated_as, ratings = self._agent.policy.rate(observation[None])
        action = int(ratings[0].argmax())  # what it would do; asked, it would rate the observation once more
        self._given.append(observation.copy())
        self._ratings.append(ratings[0])
        self._taken.append(action)
        return action

    def decisions(self, headings_deg: tuple[float, ...], of_sample: list[int]) -> Decisions | None:
        """What was decided in the game, whose samples belong to those commands; None of a baseline."""
        if not self._taken:
            return None
        given = np.stack(self._given)
        pictures = np.asarray(given, np.uint8) if given.ndim == 4 else None
        ratings, taken = np.stack(self._ratings), np.array(self._taken)
        return Decisions(ratings, taken, headings_deg, np.array(of_sample), self._rated_as, pictures)
