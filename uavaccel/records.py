"""The run directory, which runs write and reports read.

    config.yaml    the resolved configuration       manifest.json  versions, host, command line
    rows.jsonl     one line per finished case       arrays/        its raw samples, one .npz per case
    timing.jsonl   times of the host                summary.json, report.md, figures/  made from all these

A case's arrays are in place before its row is: after a crash the cases with a whole row are finished, and the others
can be flown again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from uavaccel.config import Config, dotted_keys, load_yaml, to_yaml, validate
from uavaccel.errors import UserError, naming
from uavaccel.files import (
    UNFINISHED,
    FolderLock,
    Plain,
    append_lines,
    drop_cut_line,
    file_sha256,
    inside,
    is_file_name,
    lock_of,
    read_arrays,
    read_json,
    read_lines,
    replacing,
    to_json,
    write_arrays,
)
from uavaccel.forms import HostTimes, Manifest, RowForm, check, check_all
from uavaccel.own_code import as_noted


class RunDirectory:
    """The run directory at `path`. Raises UserError if there is none.

    Rows are read when they are asked for; with a `form`, that of its suite, they and arrays are checked against it.
    """

    form: RowForm | None = None

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._lock: FolderLock | None = None
        self._waiting: dict[str, list[str]] = {"rows.jsonl": [], "timing.jsonl": []}
        if not (self.path / "config.yaml").is_file():
            raise UserError(f"{self.path}: not a run directory: no config.yaml in it")
        self._done: set[str] | None = None  # until rows are read

    @classmethod
    def create(
        cls,
        path: str | Path,
        config: Config,
        manifest: Mapping[str, object],
        resume: bool = False,
        may_grow: Mapping[str, str] | None = None,
    ) -> RunDirectory:
        """Start a run at `path`, or with `resume` continue the one that is there, if any.

        To continue, a truncated line is dropped, and `manifest` is added to the run's. As long as the result exists, no
        other process can continue the run. The keys `may_grow` may be more than the run's, unless with a text why
        not: a larger number, a list with more in it, or an empty one, which is all there is. Raises UserError if the
        folder exists and `resume` is False, if the run has another configuration, or another process is flying it.
        """
        path = Path(path)
        if path.exists() and not resume:
            raise UserError(f"{path}: exists; take another --out, or --resume to go on with it")
        if (path / "config.yaml").is_file():
            lock = lock_of(path)
            grown = refuse_other_config(path, config, may_grow or {})
            for leftover in path.rglob(f"*{UNFINISHED}"):  # of a crash
                leftover.unlink()
            for name in ("rows.jsonl", "timing.jsonl"):
                drop_cut_line(path / name)
            if grown:
                _write_config(path, config)
        else:
            lock = _start(path, config)
        run = cls(path)
        run._lock = lock
        run.done_cases()  # rows that are wrong are refused before anything is written
        if (path / "manifest.json").exists():
            first = run.manifest()
            manifest = {**first, "resumed": [*first.get("resumed", []), manifest]}
        run.write_json("manifest.json", manifest)
        return run

    def append_row(self, row: Mapping[str, object], on_disk: bool = True) -> None:
        """Append the whole row of a finished case; `row["case"]` is the case's id.

        With `on_disk` it is on disk on return, with all rows before it; without, it waits for the next that is, or for
        `write_waiting`. Keys are sorted, floats read back equal, and one that is not finite is null. Raises ValueError
        if the case has a row already, UserError if the run's folder no longer exists.
        """
        done = self._cases()
        if row["case"] in done:
            raise ValueError(f"case {row['case']} has a row already")
        self._append("rows.jsonl", row, on_disk)
        done.add(str(row["case"]))

    def append_timing(self, entry: Mapping[str, object], on_disk: bool = True) -> None:
        """Append an entry to timing.jsonl: host times, loads, retries."""
        self._append("timing.jsonl", entry, on_disk)

    def _append(self, name: str, entry: Mapping[str, object], on_disk: bool) -> None:
        self._waiting[name].append(to_json(entry))
        if on_disk:
            self.write_waiting()

    def write_waiting(self) -> None:
        """Put rows and timings that wait on disk."""
        for name, lines in self._waiting.items():
            if lines:
                self._refuse_gone()
                self._waiting[name] = []
                append_lines(self.path / name, lines)

    def is_new(self) -> bool:
        """Return whether the run's folder holds nothing but what every run begins with."""
        return {entry.name for entry in self.path.iterdir()} <= {"config.yaml", "manifest.json"}

    def rows(self) -> list[Plain]:
        """Return every whole row, in the order in which they were appended.

        Raises UserError, naming line, game and key, for one that has no case, or another row's, or not the form of its
        suite's rows.
        """
        file = self.path / "rows.jsonl"
        rows = read_lines(file)
        found = _cases_of(rows, file)
        self._done = found if self._done is None else self._done  # which also knows rows that wait
        if self.form is not None:
            self.form.check_rows(rows, file)
        return rows

    def done_cases(self) -> set[str]:
        """Return the ids of the cases that have a row."""
        return set(self._cases())

    def _cases(self) -> set[str]:
        if self._done is None:
            self.rows()
        assert self._done is not None
        return self._done

    def timings(self) -> list[dict[str, Plain]]:
        """Return every whole entry of timing.jsonl. Raises UserError for times that are no numbers."""
        entries = read_lines(self.path / "timing.jsonl")
        check_all(HostTimes, entries, self.path / "timing.jsonl")
        return entries

    def truncate_to(self, count: int) -> None:
        """Drop all rows but the first `count`, and their entries in timing.jsonl."""
        for name, entries in (("rows.jsonl", self.rows()), ("timing.jsonl", self.timings())):
            self.write_text(name, "".join(to_json(entry) + "\n" for entry in entries[:count]))
        self._done = None

    def save_arrays(self, case: str, arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
        """Write a case's arrays, replacing those of an attempt without a row.

        Returns the keys of its row: `arrays`, their path in the run, and `arrays_sha256`, that file's hash.
        """
        name = f"arrays/{case}.npz"
        write_arrays(self.file(name), arrays)
        return {"arrays": name, "arrays_sha256": file_sha256(self.path / name)}

    def load_arrays(self, row: Mapping[str, object]) -> dict[str, np.ndarray]:
        """Return the arrays of a row.

        Raises UserError if the file is missing, damaged, another case's or of another hash than the row's, which older
        versions do not have, or if the arrays have not the form of their suite's.
        """
        name, wanted = str(row.get("arrays")), row.get("arrays_sha256")
        if name != f"arrays/{row['case']}.npz":
            raise UserError(f"{self.path / 'rows.jsonl'}: {row['case']}: has the arrays of another case, {name}")
        file = self.path / name
        try:
            arrays = read_arrays(file)
        except UserError as error:
            raise UserError(f"{error}; delete the row's line and --resume the run") from None
        if wanted is not None and file_sha256(file) != wanted:
            raise UserError(
                f"{file}: is not the file of its row: another hash; delete the row's line and --resume the run"
            )
        if self.form is not None:
            self.form.check_arrays(arrays, row, f"{file}: {row['case']}")
        return arrays

    def file(self, name: str) -> Path:
        """Return the path of a file of the run, e.g. "figures/figure5.png", in a folder that exists.

        Raises UserError if the run's own folder no longer exists, and if the file would be outside of it.
        """
        self._refuse_gone()
        path = inside(self.path, name)
        with naming(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def write_text(self, name: str, text: str) -> Path:
        """Write a text file of the run atomically, and return its path."""
        return self.write_bytes(name, text.encode())

    def write_bytes(self, name: str, content: bytes) -> Path:
        """Write a file of the run atomically, and return its path."""
        path = self.file(name)
        with replacing(path) as file:
            file.write(content)
        return path

    def write_json(self, name: str, value: object) -> Path:
        """Write plain data and numpy's as JSON by the rules of `append_row`, and return the file's path."""
        return self.write_text(name, to_json(value, indent=2) + "\n")

    def read_json(self, name: str) -> Plain:
        """Return the value in a JSON file of the run. Raises UserError if it is missing or damaged."""
        return read_json(self.path / name)

    @property
    def summary(self) -> dict[str, Plain]:
        """The contents of summary.json. Raises UserError where there is none yet, or it is damaged."""
        return dict(self.read_json("summary.json"))

    def config(self) -> dict[str, Plain]:
        """Return the mapping in config.yaml; names of code mean that with which the run was started."""
        mapping, folder = load_yaml(self.path / "config.yaml"), None
        with suppress(UserError):  # whoever needs the manifest reads it
            folder = self.manifest().get("own_code")
        return as_noted(mapping, folder)

    def manifest(self) -> dict[str, Plain]:
        """Return the manifest with which the run was started; "resumed" lists those with which it was continued.

        Raises UserError if it is missing or damaged.
        """
        manifest: dict[str, Plain] = self.read_json("manifest.json")
        check(Manifest, manifest, str(self.path / "manifest.json"))
        return manifest

    def _refuse_gone(self) -> None:
        if not (self.path / "config.yaml").is_file():
            raise UserError(f"{self.path}: the run's folder, or its config.yaml, was deleted while it was flown")


def _cases_of(rows: Sequence[Plain], file: Path) -> set[str]:
    done: set[str] = set()
    for number, row in enumerate(rows, start=1):
        case, where = row.get("case"), f"{file}: line {number}"
        if not isinstance(case, str):
            raise UserError(f"{where}: has no name of a game under 'case'; delete the line and --resume the run")
        if not is_file_name(case):
            raise UserError(f"{where}: no game can be called {case!r}: its name is that of a file")
        if case in done:
            raise UserError(f"{where}: {case} has a row already; delete the line that does not belong here")
        done.add(case)
    return done


def _start(path: Path, config: Config) -> FolderLock:
    try:
        path.mkdir(parents=True, exist_ok=True)
        lock = lock_of(path)
        strangers = [entry.name for entry in path.iterdir() if not entry.name.endswith(UNFINISHED)]
        if strangers:
            raise UserError(f"{path}: not a run directory, but holds {min(strangers)}; take another --out")
        _write_config(path, config)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from error
    return lock


def _write_config(path: Path, config: Config) -> None:
    with replacing(path / "config.yaml") as file:
        file.write(to_yaml(config).encode())


def refuse_other_config(path: Path, config: Config, may_grow: Mapping[str, str]) -> list[str]:
    """Return the keys that have grown. Raises UserError for other differences."""
    mapping = RunDirectory(path).config()
    with suppress(UserError):  # one that is no longer valid is compared as it is, others with later keys' defaults
        mapping = validate(type(config), mapping, "config.yaml").model_dump(mode="json")
    there, here = (
        {key: json.dumps(value) for key, value in dotted_keys(plain).items()}
        for plain in (mapping, config.model_dump(mode="json"))
    )
    if there.get("suite") != here.get("suite"):
        raise UserError(
            f"{path}: is a run of another suite, {there.get('suite')}, not of {here['suite']}; "
            "name no experiment to go on with it, or take another --out"
        )
    other = [key for key in sorted(there.keys() | here.keys()) if there.get(key) != here.get(key)]
    both = [key for key in other if key in may_grow and key in there and _counts(there[key]) == _counts(here[key])]
    grown = [key for key in both if _is_more(json.loads(there[key]), json.loads(here[key]))]
    if shrunk := [key for key in both if key not in grown]:
        said = [f"{key} = {here[key]}: {there[key]} were asked for before" for key in shrunk]
        raise UserError(f"{path}: {', '.join(said)}, and a run that goes on can only have more; leave it out to go on")
    if left := [key for key in other if key not in grown]:
        said = [f"{key} ({there.get(key, 'unset')} there, {here.get(key, 'unset')} here)" for key in left]
        own = "name no experiment and no key to go on with its own, or take another --out"
        raise UserError(f"{path}: has another configuration: {', '.join(said)}; {own}")
    if kept := [key for key in grown if may_grow[key]]:
        said = [f"{key} = {here[key]}: {there[key]} were asked for before, and {may_grow[key]}" for key in kept]
        raise UserError(f"{path}: {', '.join(said)}; leave it out, or take another --out to begin anew")
    return grown


def _counts(written: str) -> str:
    """Say whether a value is a number or a list of names, of which there may be more; others are each of their own."""
    value = json.loads(written)
    if isinstance(value, list) and all(isinstance(each, str) for each in value):
        return "names"
    return "number" if isinstance(value, int) else written


def _is_more(there: Plain, here: Plain) -> bool:
    """Return whether a number is larger, or a list has all of the other one and more; an empty one stands for all."""
    if isinstance(there, list) and isinstance(here, list):
        return bool(there) and (not here or set(there) < set(here))
    return int(there) < int(here)


def timing_provenance(timing: str) -> str:
    """Return "measured" for the machine's own clock, "modelled" for a simulated one (virtual, lockstep)."""
    return "measured" if timing == "wall" else "modelled"


def provenance_of(run: RunDirectory, timing: str | None = None) -> dict[str, Plain]:
    """Suite, seed, hash of config.yaml, the version that flew; with the game's `timing`, or the run's, what that is."""
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
