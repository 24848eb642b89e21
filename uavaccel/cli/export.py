"""`uavaccel export`: a policy as ONNX; a run as tables, as logs of its games, as a dataset to learn from."""

from __future__ import annotations

from pathlib import Path

from uavaccel.cli.progress import LINES
from uavaccel.cli.terminal import console
from uavaccel.errors import UsageError
from uavaccel.suites.registry import open_run


def export(
    source: str,
    onnx: Path | None = None,
    csv: Path | None = None,
    parquet: Path | None = None,
    mcap: Path | None = None,
    minari: Path | None = None,
    case: str | None = None,
) -> None:
    """Write what was asked for. Raises UserError with one clear line."""
    if onnx is csv is parquet is mcap is minari is None:
        raise UsageError(
            "export: say what to write: --onnx FILE of a policy; --csv, --parquet, --mcap or --minari FOLDER of a run"
        )
    if case is not None and mcap is None:
        raise UsageError("--case: goes with --mcap; the other formats take all games of a run")
    if onnx is not None:
        from uavaccel.rl.agents import policy_folder
        from uavaccel.rl.onnx_file import write_onnx
        from uavaccel.rl.policy import load_policy

        about = write_onnx(load_policy(policy_folder(source)), onnx)
        console.print(f"{onnx}: seen: {about['seen']}; actions: headings of {about['headings_deg']} degrees")
    for folder, kind in ((csv, "csv"), (parquet, "parquet")):
        if folder is not None:
            from uavaccel.suites.tables import write_tables

            for path in write_tables(open_run(source), folder, kind):
                console.print(str(path))
    if mcap is not None:
        from uavaccel.export.mcap_file import write_mcap

        for path in write_mcap(open_run(source), mcap, case):
            console.print(str(path))
    if minari is not None:
        _export_dataset(source, minari)


def _export_dataset(source: str, folder: Path) -> None:
    from uavaccel.export.minari_dataset import write_minari

    for done, games in write_minari(open_run(source), folder):
        if done * LINES // games > (done - 1) * LINES // games:
            console.print(f"{done}/{games} games")
    console.print(str(folder))
