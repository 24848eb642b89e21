"""`uavaccel export`: a policy as ONNX, a run as tables."""

from __future__ import annotations

from pathlib import Path

from uavaccel.cli.run import console
from uavaccel.errors import UsageError


def export(source: str, onnx: Path | None, csv: Path | None, parquet: Path | None) -> None:
    """Write what was asked for. Raises UserError with one clear line."""
    if onnx is None and csv is None and parquet is None:
        raise UsageError(
            "export: say what to write: --onnx FILE of a policy, --csv or --parquet FOLDER of a run"
        )
    if onnx is not None:
        _export_policy(source, onnx)
    for folder, kind in ((csv, "csv"), (parquet, "parquet")):
        if folder is not None:
            _export_run(source, folder, kind)


def _export_policy(source: str, path: Path) -> None:
    from uavaccel.rl.agents import policy_folder
    from uavaccel.rl.onnx_file import write_onnx
    from uavaccel.rl.policy import load_policy

    about = write_onnx(load_policy(policy_folder(source)), path)
    console.print(
        f"{path}: seen: {about['seen']}; actions: headings of {about['headings_deg']} degrees", markup=False
    )


def _export_run(source: str, folder: Path, kind: str) -> None:
    from uavaccel.records import RunDirectory
    from uavaccel.suites.tables import write_tables

    for path in write_tables(RunDirectory(source), folder, kind):
        console.print(str(path), markup=False)
