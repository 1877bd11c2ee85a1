"""Type the commands of the pages for people, and of the exercises, and write into each page what appears.

    python docs/typed.py                   # all pages
    python docs/typed.py student teacher   # some of them

They are the pages of ``docs/for`` and ``docs/exercises``, and each is typed in an empty folder. A page stays what it
is but for its blocks ```` ```text output ````, which follow the block of commands that they show, and its last line,
which says when and with which version that was. ``output last 3`` keeps the last three lines, and ``output 4 from
WORDS`` four lines from the first one that has these words. A block of Python whose first line is a comment with the
name of a file is written to that file, any other is run, and an included file is copied. ``export.csv``, for which a
reader has a file of a monitor, is one that the tests make.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from made import made

DOCS = Path(__file__).resolve().parent
sys.path.append(str(DOCS.parent / "tests/shared"))

from device_files import clarity  # noqa: E402

PAGES = sorted([*(DOCS / "for").glob("*.md"), *(DOCS / "exercises").glob("*.md")])
BLOCK = re.compile(r"^```(?P<told>[^`\n]*)\n(?P<body>.*?)^```$", re.M | re.S)
OUTPUT = re.compile(r"text output(?: last (?P<last>\d+)| (?P<lines>\d+) from (?P<words>.+))?")
LAST_LINE = re.compile(r"^\*What appears was .*\*$", re.M)
PROGRAMS = {"glucoloop": "-m glucoloop", "python": ""}


def typed(body: str) -> bool:
    """Whether a block is commands."""
    return body.startswith(tuple(f"{name} " for name in PROGRAMS))


def kept(told: re.Match, printed: str) -> str:
    """The lines of what was printed that an output block asks for."""
    lines = [line.rstrip() for line in printed.strip("\n").splitlines()]
    while lines and not lines[0]:
        del lines[0]
    if told["last"]:
        lines = lines[-int(told["last"]) :]
    elif told["words"]:
        [first, *_] = [number for number, line in enumerate(lines) if told["words"] in line]
        lines = lines[first : first + int(told["lines"])]
    return "\n".join(lines) + "\n"


def shell(commands: str, folder: Path, programs: Path) -> str:
    """What commands print in a folder, without progress, which goes to standard error."""
    path = f"{programs}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-ec", commands], cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{commands}leaves with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def write_programs(folder: Path) -> None:
    """The programs that pages name, as those of this Python."""
    for name, arguments in PROGRAMS.items():
        (folder / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {arguments} "$@"\n', encoding="utf-8")
        (folder / name).chmod(0o755)


def with_outputs(page: Path, folder: Path, programs: Path) -> str:
    """Text of a page with what its commands print now."""
    printed = ""

    def block(result: re.Match) -> str:
        nonlocal printed
        told, body = result["told"], result["body"]
        if output := OUTPUT.fullmatch(told):
            return f"```{told}\n{kept(output, printed)}```"
        if included := re.fullmatch(r"\{literalinclude\} (\S+)", told):
            shutil.copy(page.parent / included[1], folder)
        elif told in ("python", "{code-block} python") and (named := re.match(r"# (\w+\.py)\n", body)):
            (folder / named[1]).write_text(body, encoding="utf-8")
        elif told == "python":
            printed = shell(f"python - <<'END'\n{body}END\n", folder, programs)
        elif told == "text" and typed(body):
            printed = shell(body, folder, programs)
        return result[0]

    text = BLOCK.sub(block, page.read_text(encoding="utf-8"))
    return LAST_LINE.sub(f"*What appears was {made()}, from these commands in an empty folder.*", text)


def main(names: list[str]) -> None:
    unknown = set(names) - {page.stem for page in PAGES}
    if unknown:
        raise SystemExit(f"no such page: {', '.join(sorted(unknown))}; there are {[p.stem for p in PAGES]}")
    for page in PAGES:
        if names and page.stem not in names:
            continue
        with tempfile.TemporaryDirectory() as programs, tempfile.TemporaryDirectory() as folder:
            write_programs(Path(programs))
            (Path(folder) / "export.csv").write_text(clarity(), encoding="utf-8")
            page.write_text(with_outputs(page, Path(folder), Path(programs)), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
