"""Set up, run and check glucoloop with nothing but Python.

    python3 dev run [ARGS]          run ``glucoloop run ARGS``
    python3 dev test                the quick checks: format, lint, types, layers, and tests that take seconds
    python3 dev test PYTEST_ARGS    only pytest, with these arguments (paths from the repository root)
    python3 dev long                what the first leaves out: the tests that are marked long, documentation
    python3 dev try [--newest]      the first commands and tests/native on the newest other Python; where
                                       there is none, or with --newest, with the newest release of every package
    python3 dev setup               only create or refresh the environment, with the tools of developers
    python3 dev lock                renew the two locks (needs uv)
    python3 dev release TAG [--ran LOG]
                                       the wheel and the source distribution of a tag, in dist, once .ci/run was
                                       green on it; LOG is what an earlier call wrote of that

The first call creates .venv beside this file and installs what requirements.lock names; ``test`` and
``setup`` add what requirements-dev.lock names. Later calls reuse the environment until a lock,
pyproject.toml or the Python version changes.

``--python 3.13`` (or a path) before or after run, test, long or setup takes another Python, in an environment
of its own like .venv-3.13; ``test`` then runs only the tests.
"""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from environment import (
    DEV_LOCK,
    LOCK,
    NEWEST_PYTHON,
    OLDEST_PYTHON,
    PROJECT,
    ROOT,
    Environment,
    Python,
    check_python,
    create_venv,
    environment,
    other_pythons,
    pip_install,
    say,
    setup,
    stop,
    take_python,
    this_python,
)
from release import release, release_arguments

QUICK = "not long"


def check(env: Environment, heading: str, command: Sequence[str]) -> None:
    say(f"\n=== {heading} ===")
    judge(heading, command, env.call(command, cwd=ROOT))


@contextlib.contextmanager
def check_beside(env: Environment, heading: str, command: Sequence[str]) -> Iterator[None]:
    """A check that runs while others do, one of which may stop it, and is reported after them."""
    with (
        tempfile.TemporaryFile() as said,
        subprocess.Popen(command, cwd=ROOT, env=env.variables(), stdout=said, stderr=subprocess.STDOUT) as running,
    ):
        try:
            yield
            say(f"\n=== {heading} ===")
            running.wait()
        finally:
            running.kill()
        said.seek(0)
        print(said.read().decode(errors="replace"), end="", flush=True)
    judge(heading, command, running.returncode)


def judge(heading: str, command: Sequence[str], code: int) -> None:
    """Stop if a check failed."""
    if code == 0:
        return
    if Path(command[0]).stem == "pytest" and code == 5:
        stop("pytest found no tests.", code)
    stop(f"'{heading}' failed (exit status {code}).", code if code > 0 else 1)


def tests(env: Environment, which: str, workers: int) -> None:
    """The tests that a mark chooses."""
    if not any((ROOT / "tests").rglob("test_*.py")):
        stop("pytest found no tests.", 5)
    slow = ("--durations", "40", "--durations-min", "5")  # which of them take how many seconds is said at the end
    command = [env.program("pytest"), "-n", str(workers), "--dist", "worksteal", *slow, "-m", which]
    check(env, f"pytest -m '{which}'", command)


def quick_checks(env: Environment) -> None:
    check(env, "ruff format --check", [env.program("ruff"), "format", "--check"])
    check(env, "ruff check", [env.program("ruff"), "check"])
    with check_beside(env, "mypy", [env.program("mypy")]):  # which has one processor for half a minute
        check(env, "lint-imports", [env.program("lint-imports"), "--no-logo"])
        tests(env, QUICK, workers=2)
    say("\nAll quick checks passed.")


def long_checks(env: Environment) -> None:
    docs = ROOT / "docs"
    sphinx = [env.program("sphinx-build"), "-W", "-q", "-b", "html", str(docs), str(docs / "_build/html")]
    with check_beside(env, "documentation", sphinx):  # most of which is computed by one processor
        tests(env, "long", workers=3)  # some of them wait: for a disk, an interrupt, an emulator
    say("\nAll long checks passed.")


def first_commands(env: Environment) -> None:
    """What a newcomer does first: a run, a trial and a stress test."""
    glucoloop = env.program("glucoloop")
    with tempfile.TemporaryDirectory(prefix="glucoloop-") as folder:
        stress = ("stress", "--people", "4", "--controller", "mpc", "--fault", "stuck, start_min=60, duration_min=90")
        for name, *options in (("run",), ("trial", "--people", "50"), stress):
            out = ["--out", str(Path(folder) / name)]
            check(env, f"{env.folder.name}: glucoloop {name}", [glucoloop, name, *options, *out])


def native_tests(env: Environment, *options: str) -> None:
    check(env, f"{env.folder.name}: tests/native", [env.program("pytest"), "-q", "-n", "2", "tests/native", *options])


def try_elsewhere(*, newest: bool) -> None:
    """What must hold on other machines: another Python with the locked packages.

    Where there is none, or where it is asked for, the newest release of every package instead: what they bring is not
    locked, so it must not decide about a change that has nothing to do with it.
    """
    others = [python for python in other_pythons() if python.version <= NEWEST_PYTHON]
    if others:
        env = environment(others[0])
        say(f"Python {env.python.name} ({env.python.path}) with the packages of the lock")
        setup(env, dev=False)
        first_commands(env)
        setup(env, dev=True)
        native_tests(env)
    else:
        oldest, newest_one = (".".join(map(str, version)) for version in (OLDEST_PYTHON, NEWEST_PYTHON))
        say(f"No other Python from {oldest} to {newest_one} was found on PATH or among pyenv's versions.")
    if newest or not others:
        try_newest(others[0] if others else this_python())


def try_newest(python: Python) -> None:
    """The same with the newest release of every package."""
    newest = Environment(ROOT / ".venv-newest", python)
    say(f"\nPython {newest.python.name} ({newest.python.path}) with the newest release of every package")
    create_venv(newest)
    pip_install(newest, "glucoloop as its users do", f"{ROOT}[query]", "pytest", "pytest-xdist", "hypothesis")
    newest.call([newest.program("python"), "-m", "pip", "freeze", "--disable-pip-version-check"])
    first_commands(newest)
    native_tests(newest, "-W", "default")  # what another package is about to drop is no error here


def renew_locks() -> None:
    """Resolve both locks together: one set of versions for all Pythons, and the second adds to the first."""
    uv = shutil.which("uv")
    if uv is None:
        stop("lock needs uv, which is not installed; install it with: python3 -m pip install uv")
    oldest = ".".join(map(str, OLDEST_PYTHON))
    options = f"--universal --fork-strategy fewest --python-version {oldest} --generate-hashes --no-emit-index-url "
    options += "--no-emit-find-links --quiet --extra query"
    header = ["--custom-compile-command", "python3 dev lock"]
    for lock, own in (
        (DEV_LOCK, "--group dev --extra dask --extra gym --extra search --extra store --extra xlsx"),
        (LOCK, f"--group build --constraints {DEV_LOCK.name}"),
    ):
        command = [uv, "pip", "compile", PROJECT.name, *options.split(), *own.split(), *header, "-o", lock.name]
        code = subprocess.run(command, cwd=ROOT, check=False).returncode
        if code != 0:
            stop(f"uv could not renew {lock.name}.", code)
        say(f"Renewed {lock.name}")


def main(arguments: list[str]) -> int:
    check_python()
    env, arguments, chosen = take_python(arguments)
    verb, rest = (arguments[0], arguments[1:]) if arguments else ("", [])
    if verb in ("-h", "--help", "help"):
        say((__doc__ or "").strip())
        return 0
    if verb not in ("run", "test", "long", "try", "setup", "lock", "release"):
        stop(f"{'unknown command ' + repr(verb) if verb else 'a command is missing'}.\n\n{(__doc__ or '').strip()}", 2)
    if verb == "try":
        try_elsewhere(newest=rest == ["--newest"])
        return 0
    if verb == "lock":
        renew_locks()
        return 0
    if verb == "release":
        tag, ran = release_arguments(rest)
        setup(env, dev=False)
        release(tag, env.program("python"), ran)
        return 0
    setup(env, dev=verb != "run")
    if verb == "run":
        return env.call([env.program("glucoloop"), "run", *rest])
    if verb == "setup":
        say(f"Ready: {env.folder}")
    elif verb == "long":
        long_checks(env)
    elif rest:
        check(env, "pytest", [env.program("pytest"), *rest])
    elif chosen:
        tests(env, QUICK, workers=2)
    else:
        quick_checks(env)
    return 0
