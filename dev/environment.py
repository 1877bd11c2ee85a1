"""The Pythons of this machine, and the virtual environments that ``python3 dev`` makes of them."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

OLDEST_PYTHON = (3, 11)
NEWEST_PYTHON = (3, 14)  # for which the packages of the lock are offered
ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
DEV_LOCK = ROOT / "requirements-dev.lock"
PROJECT = ROOT / "pyproject.toml"
WINDOWS = os.name == "nt"
ON_PATH = re.compile(r"python3?(\.\d+)?(\.exe)?")


@dataclass(frozen=True)
class Python:
    """An interpreter that works."""

    path: str
    version: tuple[int, int]

    @property
    def name(self) -> str:
        return ".".join(map(str, self.version))


@dataclass(frozen=True)
class Environment:
    """A virtual environment: its folder, and the Python that it is made of."""

    folder: Path
    python: Python

    @property
    def stamp(self) -> Path:
        return self.folder / "glucoloop-stamp.json"

    @property
    def programs(self) -> Path:
        return self.folder / ("Scripts" if WINDOWS else "bin")

    def path(self, name: str) -> Path:
        return self.programs / (f"{name}.exe" if WINDOWS else name)

    def program(self, name: str) -> str:
        if not self.path(name).exists():
            stop(f"{self.path(name)} is missing. Delete {self.folder} and run this again.")
        return str(self.path(name))

    def variables(self) -> dict[str, str]:
        """Variables as an activated environment would have them, without outside import paths.

        Bytecode is kept, whatever the shell says: without it every process of the tests compiles them all again.
        """
        outside = ("PYTHONHOME", "PYTHONPATH", "PYTHONDONTWRITEBYTECODE")
        variables = {k: v for k, v in os.environ.items() if k not in outside}
        variables["VIRTUAL_ENV"] = str(self.folder)
        variables["PATH"] = os.pathsep.join([str(self.programs), variables.get("PATH", os.defpath)])
        return variables

    def call(self, command: Sequence[str], cwd: Path | None = None) -> int:
        return subprocess.run(command, cwd=cwd, env=self.variables(), check=False).returncode


def stop(message: str, code: int = 1) -> NoReturn:
    """Leave with a sentence instead of a traceback."""
    print(f"dev: {message}", file=sys.stderr)
    raise SystemExit(code)


def say(message: str) -> None:
    print(message, flush=True)


def probe(path: str | Path) -> Python | None:
    """The interpreter at a path, if there is one that works and can make environments.

    It is asked, not believed: a name like python3.13 on PATH may be a shim of a version that is not activated.
    """
    script = (
        "import ensurepip, sys, venv; print(getattr(sys, '_base_executable', None) or sys.executable); "
        "print(*sys.version_info[:2])"
    )
    try:
        said = subprocess.run(
            [str(path), "-c", script], capture_output=True, text=True, timeout=60, check=False, stdin=subprocess.DEVNULL
        )
        executable, version = said.stdout.splitlines()
        major, minor = map(int, version.split())
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return None
    return Python(executable, (major, minor)) if said.returncode == 0 and (major, minor) >= OLDEST_PYTHON else None


def this_python() -> Python:
    # Started from inside another virtual environment, build on the Python beneath it.
    return Python(getattr(sys, "_base_executable", None) or sys.executable, sys.version_info[:2])


def candidates() -> Iterator[Path]:
    """Where interpreters may lie: on PATH, and in the folder of pyenv, whether activated there or not."""
    for folder in os.environ.get("PATH", os.defpath).split(os.pathsep):
        yield from (path for path in entries(Path(folder)) if ON_PATH.fullmatch(path.name))
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    yield from (folder / "bin" / "python" for folder in entries(pyenv / "versions"))


def entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:  # PATH may name what is not there or may not be read
        return []


def other_pythons() -> list[Python]:
    """One interpreter of each version that this is not, the newest first."""
    found: dict[tuple[int, int], Python] = {}
    for path in candidates():
        python = probe(path)
        if python is not None and python.version != sys.version_info[:2]:
            found.setdefault(python.version, python)
    return [found[version] for version in sorted(found, reverse=True)]


def find_python(name: str) -> Python:
    """The interpreter that ``--python`` asks for, by version or by path."""
    if not re.fullmatch(r"\d+(\.\d+)*", name):
        python = probe(shutil.which(name) or Path(name).expanduser())
        if python is None:
            oldest = ".".join(map(str, OLDEST_PYTHON))
            stop(f"--python is {name!r}, which is no Python {oldest} or newer with the module venv.", 2)
        return python
    known = [this_python(), *other_pythons()]
    for python in known:
        if python.name == name:
            return python
    names = ", ".join(sorted((python.name for python in known), key=lambda name: int(name.split(".")[1])))
    stop(
        f"--python is {name!r}, and no such Python was found on PATH or among pyenv's versions (found: {names}). "
        "Give one of these, or the path of an interpreter.",
        2,
    )


def check_python() -> None:
    if sys.version_info[:2] >= OLDEST_PYTHON:
        return
    oldest = ".".join(map(str, OLDEST_PYTHON))
    message = f"glucoloop needs Python {oldest} or newer; this is {sys.version.split()[0]}."
    newer = other_pythons()
    if not newer:
        stop(f"{message} Install a newer Python, then run this again with it.")
    stop(f"{message} This machine has a newer one: {newer[0].path} dev {' '.join(sys.argv[1:])}")


def digest(path: Path) -> str:
    if not path.is_file():
        stop(f"{path} is missing; restore it with: git checkout {path.name}")
    return hashlib.sha256(path.read_bytes()).hexdigest()


def wanted_stamp(env: Environment, *, dev: bool) -> dict[str, str]:
    return {
        "lock": digest(LOCK),
        "dev": digest(DEV_LOCK) if dev else "",
        "project": digest(PROJECT),
        "python": env.python.name,
        "root": str(ROOT),  # a virtual environment holds absolute paths, so a moved repository needs a new one
    }


def found_stamp(env: Environment) -> dict[str, str]:
    """Return the stamp of the last complete installation; empty when there is none that can be trusted."""
    try:
        stamp = json.loads(env.stamp.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return stamp if isinstance(stamp, dict) and env.path("python").exists() else {}


def write_stamp(env: Environment, stamp: dict[str, str]) -> None:
    part = env.stamp.with_suffix(".part")
    part.write_text(json.dumps(stamp), encoding="utf-8")
    part.replace(env.stamp)


def create_venv(env: Environment) -> None:
    folder = env.folder
    say(f"Renewing {folder}" if folder.exists() else f"Creating {folder}")
    try:
        if env.stamp.exists():  # first, so that a removal cut short is not taken for a complete environment
            env.stamp.unlink()
        if folder.is_symlink():
            folder.unlink()
        elif folder.exists():
            shutil.rmtree(folder)
    except OSError as error:
        stop(f"the old environment {folder} cannot be removed ({error.strerror}). Remove it by hand and try again.")
    made = subprocess.run([env.python.path, "-m", "venv", str(folder)], capture_output=True, text=True, check=False)
    if made.returncode == 0:
        return
    shutil.rmtree(folder, ignore_errors=True)
    said = f"{made.stdout}\n{made.stderr}".strip()
    if "No module named venv" in said or "ensurepip" in said:
        stop(
            f"this Python lacks the venv module. On Debian and Ubuntu: sudo apt install python{env.python.name}-venv "
            "(elsewhere: a Python that includes venv and ensurepip), then try again."
        )
    stop(f"the environment {folder} could not be created:\n{said}")


def pip_trouble(output: str) -> str:
    """Say in one sentence what most likely went wrong."""
    signs = {
        "DO NOT MATCH THE HASHES": "a downloaded package is not the one that the lock names; "
        "if it happens again, clear pip's cache (python3 -m pip cache purge).",
        "No space left": "the disk is full.",
        "Temporary failure in name resolution": "the package index cannot be reached. Is there a network connection?",
        "NewConnectionError": "the package index cannot be reached. Is there a network connection?",
        "Connection": "the connection to the package index failed. Is there a network connection, or a proxy to set?",
        "SSLError": "the package index's certificate was refused. Is there a proxy that pip must be told about?",
        "Read timed out": "the package index answers too slowly. Try again.",
        "No matching distribution": "a package of the lock is not offered for this Python and system, "
        "or the package index cannot be reached.",
    }
    return next((text for sign, text in signs.items() if sign in output), "pip failed.")


def pip_install(env: Environment, what: str, *arguments: str) -> None:
    """Run pip behind one line of progress; show its output only when it fails."""
    # Most modules are never imported, and an import compiles the others: that saves two fifths of the time.
    pip_command = ("-m", "pip", "install", "--disable-pip-version-check", "--no-input", "--no-compile")
    command = [env.program("python"), *pip_command, *arguments]
    live = sys.stdout.isatty()
    started, seen, lines = time.monotonic(), 0, []
    print(f"Installing {what} ...", end="", flush=True)
    with subprocess.Popen(
        command,
        cwd=ROOT,
        env=env.variables(),
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


def uv_install(env: Environment, lock: Path) -> bool:
    """Install what a lock names by uv, which takes a fraction of pip's time, where there is one and it succeeds.

    It does not read the configuration of pip, such as another index, so what it cannot do is left to pip.
    """
    uv = shutil.which("uv")
    if uv is None:
        return False
    print(f"Installing packages from {lock.name} with uv ...", end="", flush=True)
    started = time.monotonic()
    command = [
        uv,
        "pip",
        "install",
        "--quiet",
        "--python",
        str(env.path("python")),
        "--require-hashes",
        "-r",
        str(lock),
    ]
    done = subprocess.run(command, cwd=ROOT, env=env.variables(), capture_output=True, check=False)
    say(f" done in {time.monotonic() - started:.0f} s" if done.returncode == 0 else " failed; pip takes over")
    return done.returncode == 0


def setup(env: Environment, *, dev: bool) -> None:
    """Bring an environment to what the locks and the project file ask for; each step is stamped when it is complete."""
    found = found_stamp(env)
    # The tools of developers stay where they are up to date, though nobody asks for them.
    wanted = wanted_stamp(env, dev=dev or found.get("dev") == digest(DEV_LOCK))
    if found == wanted:
        return
    fresh = any(found.get(key) != wanted[key] for key in ("lock", "python", "root"))
    if fresh or found.get("dev") not in ("", wanted["dev"]):
        create_venv(env)
        found = {}
    if found.get("dev") != wanted["dev"]:
        lock = DEV_LOCK if wanted["dev"] else LOCK
        if not uv_install(env, lock):
            pip_install(env, f"packages from {lock.name}", "--require-hashes", "-r", str(lock))
        write_stamp(env, {**wanted, "project": ""})
    pip_install(env, "glucoloop", "--no-deps", "--no-build-isolation", "--no-index", "--editable", str(ROOT))
    write_stamp(env, wanted)


def environment(python: Python | None = None) -> Environment:
    """The environment of this Python, or that of another."""
    if python is None:
        return Environment(ROOT / ".venv", this_python())
    return Environment(ROOT / f".venv-{python.name}", python)


def take_python(arguments: list[str]) -> tuple[Environment, list[str], bool]:
    """Take ``--python`` out of the arguments: the environment, the other arguments, whether it was there."""
    for place, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name != "--python":
            continue
        rest = arguments[place + 1 :]
        if not equals:
            if not rest:
                stop("--python needs a version like 3.13, or the path of an interpreter.", 2)
            value, *rest = rest
        return environment(find_python(value)), arguments[:place] + rest, True
    return environment(), arguments, False
