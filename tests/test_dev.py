"""The script that sets up and checks: how it finds a Python, what it installs again, and that its locks agree."""

import importlib
import re
import stat
import sys
from pathlib import Path

import jax
import pytest

ROOT = Path(__file__).resolve().parents[1]
HERE = ".".join(map(str, sys.version_info[:2]))

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="interpreters are written as shell scripts")


@pytest.fixture(scope="module")
def dev():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "dev")
        yield importlib.import_module("commands")


@pytest.fixture(scope="module")
def environments(dev):
    """The module of Pythons and environments, whose parts `dev` uses."""
    return sys.modules["environment"]


def interpreter(path, answer, code=0):
    """A program that answers as an interpreter would."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\nprintf '{answer}'\nexit {code}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine with four interpreters: one on PATH, a shim that fails, one that is too old, one within pyenv."""
    on_path, pyenv = tmp_path / "bin", tmp_path / "pyenv"
    interpreter(on_path / "python3.80", r"/opt/80/python\n3 80\n")
    interpreter(on_path / "python3.90", "pyenv: python3.90: command not found", 127)
    interpreter(on_path / "python3.9", r"/opt/9/python\n3 9\n")
    interpreter(on_path / "python3-config", r"/opt/no/python\n3 99\n")
    interpreter(pyenv / "versions" / "3.85.1" / "bin" / "python", r"/opt/85/python\n3 85\n")
    monkeypatch.setenv("PATH", str(on_path))
    monkeypatch.setenv("PYENV_ROOT", str(pyenv))
    return tmp_path


def test_other_pythons_are_those_that_work_the_newest_first(dev, machine):
    assert [(python.name, python.path) for python in dev.other_pythons()] == [
        ("3.85", "/opt/85/python"),
        ("3.80", "/opt/80/python"),
    ]


def test_a_folder_on_path_that_is_not_there_is_passed_over(dev, machine, monkeypatch):
    monkeypatch.setenv("PATH", f"{machine / 'nowhere'}:{machine / 'bin'}")
    assert [python.name for python in dev.other_pythons()] == ["3.85", "3.80"]


def test_elsewhere_is_this_python_with_the_newest_packages_if_no_other_is_supported(dev, machine, monkeypatch, capsys):
    done = []
    for name in ("create_venv", "pip_install", "first_commands", "native_tests"):
        monkeypatch.setattr(
            dev, name, lambda env, *rest, name=name: done.append((name, env.folder.name, env.python.name))
        )
    monkeypatch.setattr(dev.Environment, "program", lambda env, name: name)
    monkeypatch.setattr(dev.Environment, "call", lambda env, command: 0)
    dev.try_elsewhere(newest=False)
    steps = ("create_venv", "pip_install", "first_commands", "native_tests")
    assert done == [(step, ".venv-newest", HERE) for step in steps]
    assert "No other Python from 3.11 to 3.14 was found" in capsys.readouterr().out
    done.clear()
    monkeypatch.setattr(dev, "NEWEST_PYTHON", (3, 80))
    monkeypatch.setattr(dev, "setup", lambda env, dev: done.append(("tools" if dev else "users", env.folder.name)))
    locked = [
        ("users", ".venv-3.80"),
        ("first_commands", ".venv-3.80"),
        ("tools", ".venv-3.80"),
        ("native_tests", ".venv-3.80"),
    ]
    dev.try_elsewhere(newest=False)
    assert [step[:2] for step in done] == locked
    done.clear()
    dev.try_elsewhere(newest=True)
    assert [step[:2] for step in done] == [*locked, *((step, ".venv-newest") for step in steps)]


def test_this_python_is_no_other_one(dev, tmp_path, monkeypatch):
    major, minor = sys.version_info[:2]
    interpreter(tmp_path / "python3", rf"/opt/python\n{major} {minor}\n")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path))
    assert dev.other_pythons() == []


@pytest.mark.parametrize("words", [("--python", "3.85"), ("--python=3.85",)], ids=["apart", "joined"])
def test_a_version_is_found_anywhere_among_the_arguments(dev, machine, words):
    env, rest, chosen = dev.take_python(["test", *words, "-k", "name"])
    assert (env.folder.name, env.python.path) == (".venv-3.85", "/opt/85/python")
    assert rest == ["test", "-k", "name"]
    assert chosen


def test_a_path_is_taken_as_it_is(dev, machine):
    path = interpreter(machine / "own" / "interpreter", r"/opt/81/python\n3 81\n")
    env, rest, _ = dev.take_python(["setup", "--python", str(path)])
    assert (env.folder.name, env.python.path, rest) == (".venv-3.81", "/opt/81/python", ["setup"])


def test_without_the_option_it_is_this_python(dev):
    env, rest, chosen = dev.take_python(["run", "--out", "x"])
    assert (env.folder, env.python.name, rest, chosen) == (ROOT / ".venv", HERE, ["run", "--out", "x"], False)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--python"], "--python needs a version like 3.13, or the path of an interpreter."),
        (["--python", "3.90"], rf"no such Python was found .*\(found: {re.escape(HERE)}, 3.80, 3.85\)"),
        (["--python", "nowhere"], "'nowhere', which is no Python 3.11 or newer with the module venv"),
        (["--python", "BIN/python3.9"], "which is no Python 3.11 or newer with the module venv"),
    ],
    ids=["nothing", "a shim", "no program", "too old"],
)
def test_a_python_that_is_not_there_is_told(dev, machine, capsys, words, told):
    with pytest.raises(SystemExit) as left:
        dev.take_python(["test", *(word.replace("BIN", str(machine / "bin")) for word in words)])
    assert left.value.code == 2
    assert re.search(told, capsys.readouterr().err)


@pytest.fixture
def installs(environments, tmp_path, monkeypatch):
    """An environment, and the list of what is done to it."""
    env = environments.Environment(tmp_path / ".venv", environments.Python("/opt/python", (3, 11)))
    done = []

    def create(env):
        done.append("create")
        env.programs.mkdir(parents=True, exist_ok=True)
        env.path("python").touch()

    def install(env, what, *_):
        done.append(what.removeprefix("packages from "))

    for name in ("LOCK", "DEV_LOCK", "PROJECT"):
        path = tmp_path / name
        path.write_text(name)
        monkeypatch.setattr(environments, name, path)
    monkeypatch.setattr(environments, "create_venv", create)
    monkeypatch.setattr(environments, "uv_install", lambda env, lock: False)
    monkeypatch.setattr(
        environments, "pip_install", lambda env, what, *_: done.append(what.removeprefix("packages from "))
    )

    def setup(*, tools):
        done.clear()
        environments.setup(env, dev=tools)
        return list(done)

    return setup


def test_the_tools_of_developers_are_added_to_what_users_have(installs):
    assert installs(tools=False) == ["create", "LOCK", "glucoloop"]
    assert installs(tools=False) == []
    assert installs(tools=True) == ["DEV_LOCK", "glucoloop"]
    assert installs(tools=False) == []
    assert installs(tools=True) == []


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ("LOCK", ["create", "DEV_LOCK", "glucoloop"]),
        ("DEV_LOCK", ["create", "DEV_LOCK", "glucoloop"]),
        ("PROJECT", ["glucoloop"]),
    ],
)
def test_what_changed_is_installed_again(environments, installs, changed, expected):
    installs(tools=True)
    getattr(environments, changed).write_text("other")
    assert installs(tools=True) == expected
    assert installs(tools=True) == []


@pytest.mark.parametrize("code", [0, 2])
def test_uv_installs_a_lock_where_it_can(environments, tmp_path, monkeypatch, capsys, code):
    env = environments.Environment(tmp_path / ".venv", environments.Python("/opt/python", (3, 11)))
    uv = interpreter(tmp_path / "bin" / "uv", "", code)
    uv.write_text(uv.read_text().replace("exit", f'printf "%s " "$@" > {tmp_path}/asked\nexit'))
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:/usr/bin:/bin")
    assert environments.uv_install(env, tmp_path / "a.lock") == (code == 0)
    asked = f"pip install --quiet --python {env.path('python')} --require-hashes -r {tmp_path / 'a.lock'} "
    assert (tmp_path / "asked").read_text() == asked
    assert ("pip takes over" in capsys.readouterr().out) == (code != 0)


def test_without_uv_a_lock_is_left_to_pip(environments, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    env = environments.Environment(tmp_path / ".venv", environments.Python("/opt/python", (3, 11)))
    assert not environments.uv_install(env, tmp_path / "a.lock")
    assert capsys.readouterr().out == ""


def test_an_installation_that_broke_off_is_taken_up(environments, installs, monkeypatch):
    whole = environments.pip_install

    def broken(env, what, *rest):
        if what == "glucoloop":
            raise OSError("the disk is full")
        whole(env, what, *rest)

    with monkeypatch.context() as broken_off:
        broken_off.setattr(environments, "pip_install", broken)
        with pytest.raises(OSError, match="disk is full"):
            installs(tools=False)
    assert installs(tools=False) == ["glucoloop"]


def pins(lock):
    text = (ROOT / lock).read_text(encoding="utf-8")
    return re.findall(r"^([a-z0-9][a-z0-9._-]*)==([^ ;\\]+)(?: ; ([^\\\n]*\S))?", text, re.M)


def beside(dev, code, others=lambda: None):
    env = dev.Environment(Path(sys.prefix), dev.this_python())
    with dev.check_beside(env, "slow", [sys.executable, "-c", code]):
        others()


def test_a_check_beside_others_is_told_after_them(dev, capfd):
    beside(dev, "print('done')", lambda: print("meanwhile"))
    assert capfd.readouterr().out == "meanwhile\n\n=== slow ===\ndone\n"


def test_a_check_beside_others_fails_as_they_do(dev, capfd):
    with pytest.raises(SystemExit) as left:
        beside(dev, "print('why'); raise SystemExit(3)")
    assert left.value.code == 3
    told = capfd.readouterr()
    assert "why" in told.out
    assert "'slow' failed (exit status 3)." in told.err


def test_a_check_beside_others_ends_with_the_first_that_fails(dev):
    with pytest.raises(SystemExit, match="2"):
        beside(dev, "import time; time.sleep(600)", lambda: sys.exit(2))


def test_the_lock_of_developers_holds_that_of_users():
    assert set(pins("requirements.lock")) < set(pins("requirements-dev.lock"))


@pytest.mark.parametrize("lock", ["requirements.lock", "requirements-dev.lock"])
def test_a_lock_has_one_version_of_each_package(lock):
    names = [name for name, *_ in pins(lock)]
    assert len(names) > 30
    assert len(names) == len(set(names))


def test_users_get_no_tools_of_developers():
    assert not {"pytest", "mypy", "ruff", "sphinx", "hypothesis"} & {name for name, *_ in pins("requirements.lock")}


def context_of_a_program():
    return jax.jit(lambda x: x + 1.0).lower(1.0).compiler_ir().context


def test_programs_of_tests_share_contexts():
    assert len({context_of_a_program() for _ in range(3)}) < 3  # two where a context has had its programs in between


def test_a_program_that_is_compiled_while_another_is_written_has_a_context_of_its_own():
    with context_of_a_program() as current:
        assert context_of_a_program() is not current
