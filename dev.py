#!/usr/bin/env python3
"""Set up, run and check glucoloop with nothing but Python.

    python3 dev.py run [ARGS]          run ``glucoloop run ARGS``
    python3 dev.py test                all checks: format, lint, types, layers, tests, documentation
    python3 dev.py test PYTEST_ARGS    only pytest, with these arguments (paths from the repository root)
    python3 dev.py test -m long        the tests that are left out above because they take long
    python3 dev.py setup               only create or refresh the environment

The first call creates .venv beside this file and installs what requirements.lock names; later calls
reuse it until requirements.lock, pyproject.toml or the Python version changes.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import NoReturn

OLDEST_PYTHON = (3, 11)
ROOT = Path(__file__).resolve().parent
LOCK = ROOT / "requirements.lock"
PROJECT = ROOT / "pyproject.toml"
VENV = ROOT / ".venv"
STAMP = VENV / "glucoloop-stamp.json"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
VENV_PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")


def stop(message: str, code: int = 1) -> NoReturn:
    """Leave with a sentence instead of a traceback."""
    print(f"dev.py: {message}", file=sys.stderr)
    raise SystemExit(code)


def say(message: str) -> None:
    print(message, flush=True)


def check_python() -> None:
    if sys.version_info[:2] >= OLDEST_PYTHON:
        return
    oldest = ".".join(map(str, OLDEST_PYTHON))
    message = f"glucoloop needs Python {oldest} or newer; this is {sys.version.split()[0]}."
    newer = next((f"python3.{minor}" for minor in range(20, 10, -1) if shutil.which(f"python3.{minor}")), None)
    if newer is None:
        stop(f"{message} Install a newer Python, then run this again with it.")
    stop(f"{message} This machine has a newer one: {newer} dev.py {' '.join(sys.argv[1:])}")


def environment() -> dict[str, str]:
    """Environment variables as an activated .venv would have them, without outside import paths."""
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONHOME", "PYTHONPATH")}
    variables["VIRTUAL_ENV"] = str(VENV)
    variables["PATH"] = os.pathsep.join([str(BIN), variables.get("PATH", os.defpath)])
    return variables


def digest(path: Path) -> str:
    if not path.is_file():
        stop(f"{path} is missing; restore it with: git checkout {path.name}")
    return hashlib.sha256(path.read_bytes()).hexdigest()


def wanted_stamp() -> dict[str, str]:
    # A virtual environment holds absolute paths, so a moved repository needs a new one.
    python = ".".join(map(str, sys.version_info[:2]))
    return {"lock": digest(LOCK), "project": digest(PROJECT), "python": python, "root": str(ROOT)}


def found_stamp() -> dict[str, str]:
    """Return the stamp of the last complete installation; empty when there is none that can be trusted."""
    try:
        stamp = json.loads(STAMP.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) and VENV_PYTHON.exists() else {}


def write_stamp(stamp: dict[str, str]) -> None:
    part = STAMP.with_suffix(".part")
    part.write_text(json.dumps(stamp), encoding="utf-8")
    part.replace(STAMP)


def create_venv() -> None:
    try:
        if STAMP.exists():  # first, so that a removal cut short is not taken for a complete environment
            STAMP.unlink()
        if VENV.is_symlink():
            VENV.unlink()
        elif VENV.exists():
            shutil.rmtree(VENV)
    except OSError as error:
        stop(f"the old environment {VENV} cannot be removed ({error.strerror}). Remove it by hand and try again.")
    # Started from inside another virtual environment, build on the Python beneath it.
    python = getattr(sys, "_base_executable", None) or sys.executable
    made = subprocess.run([python, "-m", "venv", str(VENV)], capture_output=True, text=True, check=False)
    if made.returncode == 0:
        return
    shutil.rmtree(VENV, ignore_errors=True)
    said = f"{made.stdout}\n{made.stderr}".strip()
    if "No module named venv" in said or "ensurepip" in said:
        minor = ".".join(map(str, sys.version_info[:2]))
        stop(
            f"this Python lacks the venv module. On Debian and Ubuntu: sudo apt install python{minor}-venv "
            "(elsewhere: a Python that includes venv and ensurepip), then try again."
        )
    stop(f"the environment {VENV} could not be created:\n{said}")


def pip_trouble(output: str) -> str:
    """Say in one sentence what most likely went wrong."""
    signs = {
        "DO NOT MATCH THE HASHES": "a downloaded package is not the one that requirements.lock names; "
        "if it happens again, clear pip's cache (python3 -m pip cache purge).",
        "No space left": "the disk is full.",
        "Temporary failure in name resolution": "the package index cannot be reached. Is there a network connection?",
        "NewConnectionError": "the package index cannot be reached. Is there a network connection?",
        "Connection": "the connection to the package index failed. Is there a network connection, or a proxy to set?",
        "SSLError": "the package index's certificate was refused. Is there a proxy that pip must be told about?",
        "Read timed out": "the package index answers too slowly. Try again.",
        "No matching distribution": "a package in requirements.lock is not offered for this Python and system, "
        "or the package index cannot be reached.",
    }
    return next((text for sign, text in signs.items() if sign in output), "pip failed.")


def pip_install(what: str, *arguments: str) -> None:
    """Run pip behind one line of progress; show its output only when it fails."""
    command = [str(VENV_PYTHON), "-m", "pip", "install", "--disable-pip-version-check", "--no-input", *arguments]
    live = sys.stdout.isatty()
    started, seen, lines = time.monotonic(), 0, []
    print(f"Installing {what} ...", end="", flush=True)
    with subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="utf-8",
        errors="replace",
    ) as pip:
        for line in pip.stdout or ():
            lines.append(line)
            if line.startswith("Collecting "):
                seen += 1
                if live:
                    print(f"\rInstalling {what} ... {seen} packages", end="", flush=True)
    if pip.returncode == 0:
        say(f" done in {time.monotonic() - started:.0f} s")
        return
    say(" failed")
    output = "".join(lines)
    print("".join(lines[-15:]), file=sys.stderr)
    stop(f"{pip_trouble(output)}")


def setup() -> None:
    """Bring .venv to what the lock and the project file ask for; each step is stamped when it is complete."""
    wanted, found = wanted_stamp(), found_stamp()
    if found == wanted:
        return
    if any(found.get(key) != wanted[key] for key in ("lock", "python", "root")):
        say(f"Creating {VENV}" if not VENV.exists() else f"Renewing {VENV}")
        create_venv()
        pip_install("packages from requirements.lock", "--require-hashes", "-r", str(LOCK))
        write_stamp({**wanted, "project": ""})
    pip_install("glucoloop", "--no-deps", "--no-build-isolation", "--no-index", "--editable", str(ROOT))
    write_stamp(wanted)


def tool(name: str) -> str:
    path = BIN / (f"{name}.exe" if os.name == "nt" else name)
    if not path.exists():
        stop(f"{path} is missing. Delete {VENV} and run: python3 dev.py setup")
    return str(path)


def call(command: list[str], cwd: Path | None = None) -> int:
    return subprocess.run(command, cwd=cwd, env=environment(), check=False).returncode


def check(heading: str, command: list[str]) -> None:
    say(f"\n=== {heading} ===")
    code = call(command, cwd=ROOT)
    if code == 0:
        return
    if Path(command[0]).stem == "pytest" and code == 5:
        stop("pytest found no tests.", code)
    stop(f"'{heading}' failed (exit status {code}).", code if code > 0 else 1)


def test(pytest_arguments: list[str]) -> None:
    if pytest_arguments:
        check("pytest", [tool("pytest"), *pytest_arguments])
        return
    check("ruff format --check", [tool("ruff"), "format", "--check"])
    check("ruff check", [tool("ruff"), "check"])
    check("mypy", [tool("mypy")])
    check("lint-imports", [tool("lint-imports"), "--no-logo"])
    if not any((ROOT / "tests").rglob("test_*.py")):
        stop("pytest found no tests.", 5)
    check("pytest", [tool("pytest"), "-n", "2", "--dist", "worksteal", "-m", "not long"])
    docs = ROOT / "docs"
    if (docs / "conf.py").is_file():
        check("documentation", [tool("sphinx-build"), "-W", "-q", "-b", "html", str(docs), str(docs / "_build/html")])
    say("\nAll checks passed.")


def main(arguments: list[str]) -> int:
    check_python()
    verb, rest = (arguments[0], arguments[1:]) if arguments else ("", [])
    if verb in ("-h", "--help", "help"):
        say((__doc__ or "").strip())
        return 0
    if verb not in ("run", "test", "setup"):
        stop(f"{'unknown command ' + repr(verb) if verb else 'a command is missing'}.\n\n{(__doc__ or '').strip()}", 2)
    setup()
    if verb == "run":
        return call([tool("glucoloop"), "run", *rest])
    if verb == "test":
        test(rest)
    else:
        say(f"Ready: {VENV}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        print(file=sys.stderr)
        stop("interrupted.", 130)
    except OSError as error:
        stop(f"{error}.")
