"""Runs of the RL experiment on several machines, or of several parts of it, merged into one run directory."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from typing import Any

from uavaccel.config import validate
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.rl.config import RlConfig

FOLDER = "merged"
MAY_DIFFER = ("cells", "command", "clock_speed", "profile", "timing", "seed", "seeds")


def merge_runs(runs: Sequence[RunDirectory]) -> RunDirectory:
    """The finished cells of all runs, in the first one's folder `merged`, made anew: `paper --with` takes it too.

    Raises UserError where two runs hold the same cell, or were not trained and evaluated alike.
    """
    first = runs[0]
    _refuse_strangers(runs)
    place = first.path / FOLDER
    shutil.rmtree(place, ignore_errors=True)
    config = validate(RlConfig, _of_all(runs), str(first.path / "config.yaml"))
    made_of = {str(run.path): run.manifest() for run in runs}
    merged = RunDirectory.create(place, config, {**first.manifest(), "merged_from": made_of})
    for run in runs:
        host = {entry["case"]: entry for entry in run.timings()}
        for row in run.rows():
            merged.append_row(row | merged.save_arrays(row["case"], run.load_arrays(row)))
            if row["case"] in host:
                merged.append_timing(host[row["case"]])
    return merged


def _of_all(runs: Sequence[RunDirectory]) -> dict[str, Any]:
    """The first configuration with the cells of all, none of them left out."""
    blocks: list[Mapping[str, Any]] = []
    for run in runs:
        blocks += [block for block in run.config()["cells"] if block not in blocks]
    whole = {key: value for key, value in runs[0].config().items() if key not in MAY_DIFFER}
    first = min(run.config()["seed"] for run in runs)
    last = max(run.config()["seed"] + run.config()["seeds"] for run in runs)
    return {**whole, "cells": blocks, "seed": first, "seeds": last - first}


def _refuse_strangers(runs: Sequence[RunDirectory]) -> None:
    alike = {key: value for key, value in runs[0].config().items() if key not in MAY_DIFFER}
    owner: dict[str, RunDirectory] = {}
    for run in runs:
        for key, value in alike.items():
            if run.config().get(key) != value:
                raise UserError(
                    f"{run.path}: {key} differs from that of {runs[0].path}: they make no one table"
                )
        for row in run.rows():
            if row["case"] in owner:
                raise UserError(f"{run.path}: has {row['case']}, which {owner[row['case']].path} has too")
            owner[row["case"]] = run
