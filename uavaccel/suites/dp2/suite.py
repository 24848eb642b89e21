"""DP2 as a suite: a path through the lane flown on a session with a camera, images compared with the real-time ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

from uavaccel.draw.film import Film
from uavaccel.records import RunDirectory
from uavaccel.suites.dp2 import film
from uavaccel.suites.dp2.cases import Case, cases
from uavaccel.suites.dp2.config import Dp2Config
from uavaccel.suites.dp2.flights import SCENE, fly_game
from uavaccel.suites.dp2.report import Dp2Report
from uavaccel.suites.suite import Cost, GameResult, Suite, flying_s
from uavaccel.wire.session import Session, open_session

IMAGE_S = 5e-3  # wall time of an image: drawn in software, sent, deflated and looked at, about
IMAGE_BYTES = 9_000  # of a deflated one, about


class Dp2(Suite[Dp2Config, Case]):
    """`uavaccel run dp2`."""

    name = "dp2"
    config = Dp2Config
    report_class = Dp2Report
    quick: ClassVar[Mapping[str, object]] = {}

    def cases(self, config: Dp2Config) -> Iterator[Case]:
        return cases(config)

    def open(self, config: Dp2Config, timing: str, run: RunDirectory) -> Session:
        return open_session(timing, config.profile, SCENE, config.latency)

    def fly(self, config: Dp2Config, case: Case, opened: Session) -> GameResult:
        row, arrays = fly_game(config, case, opened)
        return GameResult(row, arrays)

    def renders(self, config: Dp2Config) -> bool:
        return True

    def cost(self, config: Dp2Config, case: Case) -> Cost:
        images = case.simulated_s() / config.t_sample_s
        return Cost(flying_s(case, case.clock_speed) + images * IMAGE_S, images * IMAGE_BYTES)

    def film(self, run: RunDirectory, case: str | None) -> tuple[str, Film]:
        return film.film_game(run, case)
