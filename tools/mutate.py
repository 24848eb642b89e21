"""Which wrong changes do the tests hear? Makes them one at a time, in a copy of the tree, and runs tests on each.

    python -m tools.mutate --diff main                            all changes of the lines that differ from main
    python -m tools.mutate --sample 60 --seed 1 uavaccel/envs      60 changes, of all kinds alike
    python -m tools.mutate uavaccel/clock.py -- -m "not slow"      all of a file, with pytest's options or tests

A change is tried on the test files that import its module, directly or through one more, the nearest first, until one
fails; test files after `--` replace them. Results go to --out, from which the same command goes on where it was
stopped. Exit status: 0 if every change was heard, 1 if some were not or tests fail unchanged, 2 for wrong usage.
"""

from __future__ import annotations

import argparse
import ast
import copy
import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
NOT_COPIED = shutil.ignore_patterns(".git", ".venv", "runs", "build", "dist", ".hypothesis", ".mypy_cache")
LOGIC = {ast.Lt: ast.LtE, ast.Gt: ast.GtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn, ast.And: ast.Or}
PAIRS: dict[Any, Any] = {**LOGIC, ast.Add: ast.Sub, ast.Mult: ast.Div}
SWAPS = PAIRS | {other: one for one, other in PAIRS.items()} | {ast.FloorDiv: ast.Div, ast.Mod: ast.Mult}
SAME = {"min", "max", "minimum", "maximum", "strict", "dtype"}  # functions and options with which nothing would change
PYTEST = "-m pytest -n0 -x -q -rfE --tb=no -p no:cacheprovider --hypothesis-seed=0"
LIMIT_S = 1800.0  # after which the tests that still run have heard the change
NEAR, FAR = 2, 5  # imports from a test file to what it tests: all that are as near, and the nearest as far as this


class Mutant(NamedTuple):
    """A wrong change of a module: what the bytes from `start` to `end` become."""

    path: str  # from the tree's root
    line: int
    kind: str
    start: int
    end: int
    after: str

    def of(self, data: bytes) -> bytes:
        return data[: self.start] + self.after.encode() + data[self.end :]

    def told(self) -> str:
        texts = ((ROOT / self.path).read_bytes()[self.start : self.end].decode(), self.after)
        return f"{self.path}:{self.line}: " + " -> ".join(" ".join(text.split()) for text in texts)


def mutants(path: str, source: bytes, lines: set[int] | None = None) -> Iterator[Mutant]:
    """Yield the wrong changes of a module, or of these lines of it; some do not compile."""
    starts = [0]
    for each in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(each))
    for node in changeable(ast.parse(source)):
        if lines is None or lines & {*range(node.lineno, node.end_lineno + 1)}:
            start, end = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
            for kind, after in changes(node):
                yield Mutant(path, node.lineno, kind, start, end, after)


def changeable(node: ast.AST) -> Iterator[Any]:
    """Yield the expressions and statements below a node that do something: no types, decorators, texts."""
    for name, field in ast.iter_fields(node):
        for child in field if isinstance(field, list) else [field]:
            left_out = name in ("annotation", "returns", "decorator_list") or isinstance(child, ast.JoinedStr)
            if isinstance(child, ast.AST) and not left_out:
                if isinstance(child, (ast.expr, ast.stmt)):
                    yield child
                yield from changeable(child)


def changes(node: Any) -> Iterator[tuple[str, str]]:
    """Yield the kind and the text of each change of an expression or statement."""
    match node:
        case ast.Compare(ops=[op, *others]):
            yield "comparison", _with(node, ops=[SWAPS[type(op)](), *others])
        case ast.BoolOp(op=op) | ast.BinOp(op=op) if type(op) in SWAPS:
            yield type(node).__name__.removesuffix("Op"), _with(node, op=SWAPS[type(op)]())
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield "sign", f"({ast.unparse(node.operand)})"
        case ast.Constant(value=bool(value) | int(value) | float(value)):
            yield "constant", repr(not value if isinstance(value, bool) else value + 1)
        case ast.IfExp(body=one, orelse=other):
            yield "branches", _with(node, body=other, orelse=one)
        case ast.Slice(upper=ast.expr() as upper):
            yield "slice", f"{ast.unparse(node.lower) if node.lower else ''}:{ast.unparse(upper)} + 1"
        case ast.Call() if ast.unparse(node.func).rpartition(".")[2] not in SAME:
            yield from _other_calls(node)
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]) | ast.Expr(value=ast.Call()) | ast.AugAssign():
            yield "statement", "pass"
        case ast.Raise() | ast.Continue() | ast.Break():
            yield "statement", "pass"


def _other_calls(node: ast.Call) -> Iterator[tuple[str, str]]:
    if len(node.args) > 1:
        yield "arguments", _with(node, args=[node.args[1], node.args[0], *node.args[2:]])
    for keyword in node.keywords:
        if keyword.arg and keyword.arg not in SAME:
            yield "option", _with(node, keywords=[each for each in node.keywords if each is not keyword])


def _with(node: Any, **fields: Any) -> str:
    changed = copy.copy(node)
    vars(changed).update(fields)
    return f"({ast.unparse(ast.fix_missing_locations(changed))})"


def in_turns(found: list[Mutant], seed: int) -> Iterator[Mutant]:
    """Shuffle changes, and take the kinds in turns, as there are more of numbers than of all else."""
    random.Random(seed).shuffle(found)
    kinds = [[each for each in found if each.kind == kind] for kind in sorted({each.kind for each in found})]
    for mutant in (each for turn in zip_longest(*kinds) for each in turn if each):
        try:
            compile(mutant.of((ROOT / mutant.path).read_bytes()), mutant.path, "exec", dont_inherit=True)
            yield mutant
        except SyntaxError:
            continue


def changed_lines(reference: str) -> dict[str, set[int]]:
    """Return the lines of the tree that differ from a commit's, by path."""
    command = ["git", "diff", "--unified=0", "--no-color", "--no-ext-diff", "--relative", reference, "--"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"--diff {reference}: {done.stderr.strip().splitlines()[0]}")
    found: dict[str, set[int]] = {}
    for line in done.stdout.splitlines():
        if line.startswith("+++ "):
            lines = found.setdefault(line.removeprefix("+++ b/"), set())
        elif hunk := re.match(r"@@ .*\+(\d+)(?:,(\d+))? @@", line):
            lines.update(range(int(hunk[1]), int(hunk[1]) + int(hunk[2] or 1)))
    return found


@cache
def imported(path: Path) -> list[tuple[int, str]]:
    """Return line and absolute dotted name of everything that a module imports, also inside functions."""
    package, found = path.relative_to(ROOT).parent.parts, []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = [*package[: len(package) - node.level + 1] * (node.level > 0), *filter(None, [node.module])]
            found += [(node.lineno, ".".join([*base, alias.name])) for alias in node.names]
    return found


@cache
def _files(path: Path) -> set[Path]:
    """Return the files of the tree that a file imports."""
    names = {name for _, found in imported(path) for name in (found, found.rpartition(".")[0])}
    stems = [ROOT / name.replace(".", "/") for name in names if name]
    return {file for stem in stems for file in (Path(f"{stem}.py"), stem / "__init__.py") if file.is_file()}


@cache
def nearest_tests(path: str) -> list[str]:
    """Return the test files that import a module, or what imports it, the nearest first; tests' helpers are no step."""
    far = {}
    for test in sorted((ROOT / "tests").glob("test_*.py")):
        reached = {test}
        while more := {file for each in reached for file in _files(each) if file.parent == test.parent} - reached:
            reached |= more
        for steps in range(FAR):
            if ROOT / path in reached:
                far[test.relative_to(ROOT).as_posix()] = steps
                break
            reached = reached.union(*map(_files, reached))
    limit = max(NEAR, min(far.values(), default=0))
    return sorted((test for test, steps in far.items() if steps <= limit), key=lambda test: (far[test], test))


class Runs:
    """A copy of the tree in which tests run on changes, and the file that keeps which test failed."""

    def __init__(self, folder: Path, kept: Path, options: list[str]) -> None:
        self._tree, self._kept, self._options = folder / "tree", kept, options
        shutil.copytree(ROOT, self._tree, ignore=NOT_COPIED)
        lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
        self._known = {each["key"]: each for each in map(json.loads, lines)}
        self._state = hashlib.sha256(repr(options).encode())
        for file in sorted(file for room in ("uavaccel", "tests") for file in (ROOT / room).rglob("*.py")):
            self._state.update(file.read_bytes())

    def failed(self, mutant: Mutant, tests: list[str]) -> str:
        """Return the test that failed, "" where none did."""
        key = hashlib.sha256(repr((mutant, tests, self._state.hexdigest())).encode()).hexdigest()
        if key not in self._known:
            self._known[key] = {"key": key, **mutant._asdict(), "failed": self._try(mutant, tests)}
            with self._kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(self._known[key]) + "\n")
        return str(self._known[key]["failed"])

    def _try(self, mutant: Mutant, tests: list[str]) -> str:
        """Afterwards the file has its time back, so that cached machine code is still its own."""
        file = self._tree / mutant.path
        before, moment = file.read_bytes(), file.stat()
        env = {**os.environ, "PYTHONPATH": str(self._tree), "PYTHONDONTWRITEBYTECODE": "1"}
        where: dict[str, Any] = {"cwd": self._tree, "env": env, "timeout": LIMIT_S}
        shutil.rmtree(self._tree / ".hypothesis", ignore_errors=True)
        command = [sys.executable, *PYTEST.split(), *self._options, *tests]
        try:
            file.write_bytes(mutant.of(before))
            done = subprocess.run(command, **where, capture_output=True, text=True, check=False)
        except subprocess.TimeoutExpired:
            return "no end"
        finally:
            file.write_bytes(before)
            os.utime(file, ns=(moment.st_atime_ns, moment.st_mtime_ns))
        said = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - |$)", done.stdout, re.MULTILINE)
        return said[1] if said else "" if done.returncode == 0 else f"pytest's status {done.returncode}"


def chosen(given: argparse.Namespace) -> list[Mutant]:
    """Return the changes that the command line asks for, in their order."""
    differ = changed_lines(given.diff) if given.diff else None
    found: list[Mutant] = []
    for file in (file for path in given.paths for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])):
        path = file.resolve().relative_to(ROOT).as_posix()
        found += mutants(path, file.read_bytes(), None if differ is None else differ.get(path, set()))
    return list(islice(in_turns(found, given.seed), given.sample))


def main(arguments: list[str]) -> int:
    end = [*arguments, "--"].index("--")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path, default=[ROOT / "uavaccel"], help="files and folders to change")
    parser.add_argument("--diff", metavar="COMMIT", help="change only lines that differ from it")
    parser.add_argument("--sample", type=int, metavar="N", help="make N of the changes")
    parser.add_argument("--seed", type=int, default=0, help="of their order")
    parser.add_argument("--list", action="store_true", help="only print the changes, and the tests nearest to them")
    parser.add_argument("--out", type=Path, default=ROOT / "build/mutants.jsonl", help="file that keeps the results")
    given, options = parser.parse_args(arguments[:end]), arguments[end + 1 :]
    if missing := [str(path) for path in given.paths if not path.exists()]:
        parser.error(f"{missing[0]}: no such file or folder")
    named = any(option.partition("::")[0].endswith(".py") for option in options)
    plan = [(mutant, [] if named else nearest_tests(mutant.path)) for mutant in chosen(given)]
    if given.list:
        print(*(f"{mutant.told()}  {' '.join(tests)}" for mutant, tests in plan), sep="\n")
        return 0
    given.out.parent.mkdir(parents=True, exist_ok=True)
    heard: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        runs = Runs(Path(folder), given.out, options)
        every = sorted({test for _, tests in plan for test in tests})
        if failed := runs.failed(Mutant("uavaccel/__init__.py", 0, "", 0, 0, ""), every):
            print(f"fails without a change: {failed}")
            return 1
        for mutant, tests in plan:
            failed = runs.failed(mutant, tests) if named or tests else ""
            heard[mutant.kind] += bool(failed)
            print(f"heard    {mutant.told()}  [{failed}]" if failed else f"UNHEARD  {mutant.told()}", flush=True)
    kinds = Counter(mutant.kind for mutant, _ in plan)
    print("; ".join(f"{kind} {heard[kind]} of {count}" for kind, count in sorted(kinds.items())))
    print(f"{heard.total()} of {len(plan)} changes heard")
    return int(heard.total() < len(plan))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
