"""Games for other programs: a file for each format; all say where their numbers come from."""

from __future__ import annotations

from uavaccel.files import Plain, file_sha256
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory


def provenance_of(run: RunDirectory, timing: str | None = None) -> dict[str, Plain]:
    """Suite, seed, hash of config.yaml, the version that flew; with the game's `timing`, or the run's, what that is.

    `numbers` is "measured" on the machine's clock or "modelled" on a simulated one.
    """
    config, versions = run.config(), run.manifest().get("versions") or {}
    timing = timing or str((config.get("task") or {}).get("timing") or config.get("timing"))
    return {
        "suite": config.get("suite"),
        "seed": config.get("seed", 0),
        "config_sha256": file_sha256(run.path / "config.yaml"),
        "timing": timing,
        "numbers": timing_provenance(timing),
        "uavaccel": versions.get("uavaccel"),
    }
