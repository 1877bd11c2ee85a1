"""What other systems lack is done without: nothing is locked, names are not exchanged, no C compiler is found."""

import os
import subprocess
import sys

import pytest

from glucoloop.storage import disk

BARE = """
import ctypes, os, sys

for name in ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"):
    sys.modules[name] = None  # an import fails, as on Windows
for name in ("O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK", "sched_getaffinity", "sched_setaffinity"):
    delattr(os, name)
library = ctypes.CDLL

class Library(library):
    def __getattr__(self, name):
        if name == "renameat2":  # only Linux has it
            raise AttributeError(name)
        return super().__getattr__(name)

ctypes.CDLL = Library

from glucoloop.cli import program
from glucoloop.native.targets.c import host
from glucoloop.storage import disk

assert disk.fcntl is None and host.compiler() is None
sys.exit(program())
"""
"""Carries out a command on what is left of this system."""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="takes away what Linux has")
def test_runs_and_trials_need_nothing_of_one_system(tmp_path):
    variables = {**os.environ, "PATH": "", "PYTHONWARNINGS": "ignore"}

    def carried_out(*words):
        command = [sys.executable, "-c", BARE, *words]
        done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    carried_out("run", "--out", "a-run")
    assert (tmp_path / "a-run" / "figure.png").is_file()
    carried_out("trial", "--people", "4", "--duration", "2h", "--out", "a-trial")
    assert not [path for path in tmp_path.rglob("*") if path.name.endswith((disk.PART, ".lock"))]


def test_a_folder_is_replaced_where_no_system_call_exchanges_names(tmp_path, monkeypatch):
    class Without:
        def __init__(self, *_, **__):
            pass

    place = tmp_path / "folder"
    disk.put_folder(place, {"first": b"1"})
    monkeypatch.setattr(disk.ctypes, "CDLL", Without)
    disk.put_folder(place, {"second": b"2"})
    assert sorted(os.listdir(place)) == sorted([disk.SUMS, "second"])
    assert os.listdir(tmp_path) == ["folder"]


def test_nothing_is_locked_where_the_system_locks_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(disk, "fcntl", None)
    with disk.locked(tmp_path / "lock", tmp_path), disk.locked(tmp_path / "lock", tmp_path):
        assert os.listdir(tmp_path) == []
