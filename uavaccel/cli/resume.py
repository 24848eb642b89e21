"""Going on with a run by its folder alone: its own configuration, and what has changed since."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from uavaccel.errors import UsageError, UserError
from uavaccel.files import Plain
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.registry import suite_of
from uavaccel.suites.suite import AnySuite


def folders_own(out: Path | None, resume: bool, suite_name: str | None) -> tuple[AnySuite, dict[str, Plain]]:
    """Suite and YAML of the run in `out`, of the suite of that name if one is given.

    Raises UsageError where nothing says what to fly, UserError where the folder holds no such run: none is begun.
    """
    if not resume or out is None:
        raise UsageError(
            "name an experiment, as in `uavaccel run dp1`, or a run's folder: --out FOLDER --resume"
        )
    if not (out / "config.yaml").is_file():
        raise UserError(
            f"--out {out}: no run to go on with: no config.yaml in it; name an experiment to begin one"
        )
    run = RunDirectory(out)
    suite = suite_of(run)
    if suite_name not in (None, suite.name):
        raise UserError(
            f"--out {out}: is a run of {suite.name}, not of {suite_name}; go on with `uavaccel run`"
        )
    return suite, run.config()


def going_on(run: RunDirectory, config: Experiment, games: int, now: Mapping[str, Plain]) -> Iterator[str]:
    """Lines about a run that is gone on with: from where, and what has changed since it was begun."""
    yield f"going on with {run.path}: {len(run.rows())} of {games} games are flown"
    manifest = run.manifest()
    before = [manifest, *manifest.get("resumed", [])[:-1]][-1].get("versions", {})
    changed = [
        f"{name} {before[name]} then, {version} now"
        for name, version in now.get("versions", {}).items()
        if name in before and before[name] != version
    ]
    if changed:
        yield f"warning: flown so far with other versions: {'; '.join(changed)}"
    first, commit = (each.get("git") or {} for each in (manifest, now))
    if first.get("commit") and commit.get("commit") and first["commit"] != commit["commit"]:
        yield f"warning: begun with another commit of uavaccel: {first['commit'][:12]}, now {commit['commit'][:12]}"
