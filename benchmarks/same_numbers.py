#!/usr/bin/env python3
"""Tell whether two checkouts compute the same numbers, by the small commands of `same_numbers_commands.py`.

    python benchmarks/same_numbers.py keep first --src one/src
    python benchmarks/same_numbers.py keep second --src other/src
    python benchmarks/same_numbers.py compare first second

`keep` carries out the commands and keeps what they wrote and printed as plain numbers, in Parquet and JSON; a checkout
that reads the other grammar of the command line is kept with ``--grammar``. `compare` says of each command whether all
numbers are equal to the bit, or where they differ most; its exit code is 0 if all are equal. Both checkouts have to be
kept on the same computer, with the same packages.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from same_numbers_commands import COMMANDS, Command

ROOT = Path(__file__).resolve().parent.parent
LEFT_OUT = {"config", "files", "format_version", "libraries", "seconds", "settings", "used", "version"}
"""Keys of JSON that are no result: what was asked for, with what it was computed, and how long that took."""
Values = dict[str, pl.Series]

# Carries out command lines in one process, since the packages and most of what is compiled are the same for all.
WORKER = """
import json, os, runpy, sys, traceback

asking, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
for line in asking:
    asked = json.loads(line)
    os.chdir(asked["folder"])
    for name, stream in (("stdout", 1), ("stderr", 2)):
        file = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, stream)
        os.close(file)
    sys.argv = ["glucoloop", *asked["arguments"]]
    try:
        runpy.run_module("glucoloop", run_name="__main__", alter_sys=True)
        code = 0
    except SystemExit as left:
        code = left.code or 0
    except BaseException:
        traceback.print_exc()
        code = -1
    sys.stdout.flush()
    sys.stderr.flush()
    print(json.dumps(code), file=answers, flush=True)
"""


class Worker:
    """A process of an interpreter that carries out command lines of a checkout; another one once it has ended."""

    def __init__(self, python: str, source: Path) -> None:
        self.start = [python, "-c", WORKER]
        self.variables = {**os.environ, "PYTHONPATH": str(source), "COLUMNS": "100"}
        self.process: subprocess.Popen[str] | None = None

    def run(self, arguments: list[str], folder: Path) -> object:
        """Exit code of a command line, or why it has none; `stdout` and `stderr` in the folder have what it printed."""
        if self.process is None:
            self.process = subprocess.Popen(
                self.start, env=self.variables, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps({"folder": str(folder), "arguments": arguments}) + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if answer:
            return json.loads(answer)
        self.close()
        return "the process ended"

    def close(self) -> None:
        if self.process is not None:
            self.process.communicate()
        self.process = None


def keep(folder: Path, names: list[str], worker: Worker, grammar: str) -> int:
    """Carry out the commands and keep their numbers; the number of commands that failed."""
    failed = 0
    for name in names:
        with tempfile.TemporaryDirectory() as made:
            start = time.perf_counter()
            code = carried_out(COMMANDS[name], Path(made), worker, grammar)
            kept(Path(made), folder / name, code)
            seconds = time.perf_counter() - start
            told = "" if code == 0 else f"  failed ({code}): {_told(Path(made))}"
        print(f"{name:28}{seconds:8.1f} s{told}", flush=True)
        failed += code != 0
    return failed


def carried_out(command: Command, folder: Path, worker: Worker, grammar: str) -> object:
    """Exit code of a command; its files are then in `out` in the folder, and what its last line printed in `stdout`."""
    for name, text in command.files.items():
        (folder / name).write_text(text, encoding="utf-8")
    *before, last = map(shlex.split, command.lines(grammar))
    for arguments in before:
        code = worker.run(arguments, folder)
        if code != 0:
            return code
    files = [] if last[0] == "verify" else ["--out", "out"]
    return worker.run([*last, *files, "--json"], folder)


def _told(folder: Path) -> str:
    """Last line that a command printed as an error."""
    return (folder / "stderr").read_text(encoding="utf-8").strip().rpartition("\n")[2]


# numbers as files


def kept(made: Path, folder: Path, code: object) -> None:
    """Write the numbers of what a command made: each table as Parquet, and the numbers of all JSON in one file."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    numbers: dict[str, Any] = {"exit code": code}
    printed = (made / "stdout").read_text(encoding="utf-8")
    if printed.startswith("{"):
        numbers.update(leaves(json.loads(printed), "printed"))
    for file in sorted(path for path in made.glob("out/**/*") if path.is_file()):
        name = " ".join(file.relative_to(made / "out").parts)
        table = table_of(file)
        if table is not None:
            table.write_parquet(folder / f"{name.removesuffix('.parquet')}.parquet")
        elif file.suffix == ".json":
            numbers.update(leaves(json.loads(file.read_text(encoding="utf-8")), name))
    (folder / "numbers.json").write_text(json.dumps(numbers, indent=1), encoding="utf-8")


def table_of(file: Path) -> pl.DataFrame | None:
    """Table in a file; of recorded samples in C the bits, which are whole numbers; None for another file."""
    if file.suffix == ".parquet":
        return pl.read_parquet(file)
    if file.suffix == ".csv":
        return pl.read_csv(file, infer_schema_length=None)
    if file.name == "samples.h":
        bits = re.findall(r"\b(?:0x[0-9A-Fa-f]+|\d+)U", file.read_text(encoding="utf-8"))
        return pl.DataFrame({"bits": pl.Series([int(each[:-1], 0) for each in bits], dtype=pl.UInt64)})
    return None


def leaves(tree: object, name: str) -> Iterator[tuple[str, Any]]:
    """Numbers and lists of numbers of a JSON tree, each with its path; texts are left out."""
    if isinstance(tree, Mapping):
        for key, value in tree.items():
            if key not in LEFT_OUT:
                yield from leaves(value, f"{name} {key}")
    elif isinstance(tree, list) and any(isinstance(value, Mapping | list | str) for value in tree):
        for place, value in enumerate(tree):
            yield from leaves(value, f"{name} {place}")
    elif not isinstance(tree, str):
        yield name, tree


def read(folder: Path) -> Values:
    """Kept numbers of a command by the name of file and column."""
    numbers = json.loads((folder / "numbers.json").read_text(encoding="utf-8"))
    values = {
        name: plain(pl.Series(value if isinstance(value, list) else [value], strict=False))
        for name, value in numbers.items()
    }
    for file in sorted(folder.glob("*.parquet")):
        values.update({f"{file.stem} {column.name}": plain(column) for column in pl.read_parquet(file)})
    return values


def plain(column: pl.Series) -> pl.Series:
    """A column of numbers or texts: truth is 0 or 1, and a list is its text."""
    if column.dtype.is_numeric() or column.dtype == pl.String:
        return column
    if column.dtype in (pl.Boolean, pl.Null):
        return column.cast(pl.Float64)
    return pl.Series([str(value) for value in column.to_list()], dtype=pl.String)


# comparison


def compare(first: Path, second: Path, names: list[str], *, every: bool) -> bool:
    """Print for each command how far its numbers differ; whether all are equal to the bit."""
    equal = 0
    for name in names:
        absent = [str(folder) for folder in (first, second) if not (folder / name).is_dir()]
        if absent:
            print(f"{name:28}not kept in {' and '.join(absent)}")
            continue
        one, other = read(first / name), read(second / name)
        result = differences(one, other)
        equal += not result
        lines = result or [f"equal to the bit, {sum(map(len, one.values()))} values"]
        if len(lines) > 1 and not every:
            lines[1:] = [f"and {len(lines) - 1} more, which --all shows"]
        for place, line in enumerate(lines):
            print(f"{name if place == 0 else '':28}{line}")
    print(f"\n{equal} of {len(names)} commands: equal to the bit")
    return equal == len(names)


def differences(one: Values, other: Values) -> list[str]:
    """Sentences on what differs, the largest difference in proportion to its column first."""
    apart = [(*difference(one[name], other[name]), name) for name in one if name in other]
    result = [f"{name}: {told}" for size, told, name in sorted(apart, key=lambda each: -each[0]) if told]
    result += [f"{name}: only in the first" for name in one if name not in other]
    return [*result, *(f"{name}: only in the second" for name in other if name not in one)]


def difference(one: pl.Series, other: pl.Series) -> tuple[float, str]:
    """Largest difference of two columns in proportion to the largest number, and a sentence; none if they are equal."""
    if one.len() != other.len():
        return math.inf, f"{one.len()} and {other.len()} values"
    if pl.String in (one.dtype, other.dtype):
        one, other = one.cast(pl.String), other.cast(pl.String)
        unequal = one.ne_missing(other)
        size = 1.0
    else:
        first, second = (column.cast(pl.Float64).to_numpy() for column in (one, other))
        signs = (np.signbit(first) != np.signbit(second)) & ~np.isnan(first)  # zeros that are equal but for the sign
        unequal = one.ne_missing(other) | pl.Series(signs)
        with np.errstate(invalid="ignore"):
            apart = np.nan_to_num(np.abs(first - second), nan=math.inf)[unequal.to_numpy()]
        largest = float(apart.max(initial=0.0))
        scale = float(np.abs(first, where=np.isfinite(first), out=np.zeros_like(first)).max(initial=0.0))
        size = largest / scale if scale > 0.0 else math.inf
    many = unequal.sum()
    if not many:
        return 0.0, ""
    if one.len() == 1 or pl.String in (one.dtype, other.dtype):
        place = int(unequal.to_numpy().argmax())
        return size, f"{one[place]!r} and {other[place]!r}" + (f", in {many} of {one.len()} values" if many > 1 else "")
    return size, f"largest difference {largest:.3g} of {scale:.3g}, in {many} of {one.len()} values"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    commands = parser.add_subparsers(dest="command", required=True)
    keeping = commands.add_parser("keep", help="carry out the commands with a checkout and keep their numbers")
    keeping.add_argument("folder", type=Path)
    keeping.add_argument(
        "--src", type=Path, default=ROOT / "src", help="folder src of the checkout (default this one's)"
    )
    keeping.add_argument(
        "--python", default=sys.executable, help="interpreter with the packages that the checkout needs"
    )
    keeping.add_argument("--grammar", choices=("old", "new"), default="new", help="command line of the checkout")
    comparing = commands.add_parser("compare", help="compare the numbers that were kept of two checkouts")
    comparing.add_argument("first", type=Path)
    comparing.add_argument("second", type=Path)
    comparing.add_argument("--all", action="store_true", help="show every column that differs")
    for command in (keeping, comparing):
        command.add_argument("--only", nargs="+", metavar="NAME", choices=COMMANDS, help="only these commands")
    asked = parser.parse_args()
    names = asked.only or list(COMMANDS)
    if asked.command == "compare":
        sys.exit(0 if compare(asked.first, asked.second, names, every=asked.all) else 1)
    if not (asked.src / "glucoloop").is_dir():
        parser.error(f"{asked.src} holds no glucoloop; give the folder src of a checkout")
    worker = Worker(asked.python, asked.src.resolve())
    failed = keep(asked.folder, names, worker, asked.grammar)
    worker.close()
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
