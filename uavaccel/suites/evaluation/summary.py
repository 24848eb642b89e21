"""An evaluation in numbers: success with its interval, and how far the agent got; paired with another one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uavaccel.envs.simulators import EXACT, flown_by
from uavaccel.errors import UserError
from uavaccel.metrics.intervals import Proportion, mcnemar_exact
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.suites.disturbed import disturbed_games
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import EvaluateRow
from uavaccel.suites.report import Row, Values


def summarise(config: EvaluateConfig, rows: Sequence[EvaluateRow]) -> Values:
    """Success ratio with its 95 % Wilson interval, and how far the agent got."""
    task = config.task
    sim_time_s, wall_s = (sum(row[name] for row in rows) for name in ("sim_time_s", "wall_s"))
    disturbed = disturbed_games(rows)
    return {
        **({"disturbed_games": disturbed} if disturbed else {}),
        "suite": "evaluate",
        "agent": config.agent,
        "profile": task.profile,
        "command": task.command,
        "clock_speed": task.clock_speed,
        "timing": task.timing,
        "simulator": config.simulator,
        **({} if config.simulator == EXACT else {"device": config.device}),
        "seed": config.seed,
        **Proportion(sum(row["is_success"] for row in rows), len(rows)).as_summary(),
        "sim_time_s": sim_time_s,
        "wall_s": wall_s,
        "simulated_s_per_wall_s": sim_time_s / wall_s,
        "distance_m_median": float(np.median([row["distance_m"] for row in rows])),
    }


def how_flown(keys: Row) -> str:
    """Measured or modelled, and by which simulator, of a summary or of a configuration's keys with its timing."""
    by = flown_by(keys.get("simulator", EXACT), keys.get("device", ""))
    return ", ".join([timing_provenance(keys["timing"]), *filter(None, [by])])


def compare(rows: Sequence[EvaluateRow], other: RunDirectory) -> str:
    """McNemar's test on the lanes that both evaluations flew, in words. Raises UserError without such lanes."""
    theirs = {row["lane"]: row["is_success"] for row in other.rows() if row.get("suite") == "evaluate"}
    paired = [(row["is_success"], theirs[row["lane"]]) for row in rows if row["lane"] in theirs]
    if not paired:
        raise UserError(f"{other.path}: is no evaluation of the same lanes")
    first, second = np.array(paired).T
    test = mcnemar_exact(first, second)
    return (
        f"against {other.path} on the same {len(paired)} lanes: {int(first.sum())} v {int(second.sum())} successes, "
        f"exact McNemar p = {test.p_value:.3g}"
    )
