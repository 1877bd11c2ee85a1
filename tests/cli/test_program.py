"""The program as a whole, as the shell sees it."""

import json
import os
import subprocess
import sys
import time

import pytest

import glucoloop

HEAVY = ("jax", "numpy", "scipy", "polars", "matplotlib", "glucoloop.build")


def shell(*arguments, folder, cache):
    environment = {**os.environ, "GLUCOLOOP_CACHE_DIR": str(cache), "COLUMNS": "200"}
    environment.pop("JAX_COMPILATION_CACHE_DIR")  # which would go before
    return subprocess.run(
        [sys.executable, "-m", "glucoloop", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def test_help_imports_nothing_heavy():
    code = (
        "import sys\n"
        "from glucoloop.cli import main\n"
        "try: main(['run', '--help'])\n"
        f"except SystemExit: print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize("command", ["run", "identify", "compare"])
def test_help_of_each_command(glucoloop, command):
    answer = glucoloop(command, "--help")
    assert answer.code == 0
    assert "Usage: glucoloop" in answer.out


def test_help_lists_controllers_and_symbols(glucoloop, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert "mpc                Linear model predictive control" in glucoloop("list").out
    out = glucoloop("list", "mpc").out
    for part in ("Γ_y", "Γ_u", "prediction_horizon = 8, with noise 10"):
        assert part in out


@pytest.mark.parametrize("columns", ["60", "80"])
def test_help_cuts_no_name_off(glucoloop, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    out = glucoloop("run", "--help").out
    assert "…" not in out


def test_version(glucoloop):
    assert glucoloop("--version").out == f"glucoloop {__import__('glucoloop').__version__}\n"


def test_without_arguments_it_helps(glucoloop):
    answer = glucoloop()
    assert answer.code == 2
    assert "Usage: glucoloop" in answer.out + answer.err


@pytest.mark.long
def test_one_json_object_and_exit_codes(tmp_path):
    cache = tmp_path / "cache"
    done = shell("run", "--json", "--controller", "pid", "--duration", "100", folder=tmp_path, cache=cache)
    assert done.returncode == 0
    assert json.loads(done.stdout)["version"] == glucoloop.__version__
    assert any(cache.iterdir())
    assert shell("run", "--noise", "x", folder=tmp_path, cache="off").returncode == 2


@pytest.mark.long
@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize("delay_s", [0.1, 2.0])
def test_interrupt_from_the_keyboard(tmp_path, delay_s):
    import signal

    environment = {**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "false"}  # so that it is at work for long
    arguments = [sys.executable, "-m", "glucoloop", "run", "--integrator", "adaptive", "--duration", "14400"]
    with subprocess.Popen(
        [*arguments, "--out", "out"], cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True
    ) as running:
        while not any(tmp_path.iterdir()) and running.poll() is None:  # the folder in the making
            time.sleep(0.05)
        time.sleep(delay_s)
        running.send_signal(signal.SIGINT)
        _, told = running.communicate(timeout=120)
    assert running.returncode == 130
    assert told == "glucoloop: interrupted, nothing was written.\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
@pytest.mark.parametrize("place", ["off", "/proc/none"])
def test_cache_is_off_silently(glucoloop, monkeypatch, place):
    monkeypatch.setenv("GLUCOLOOP_CACHE_DIR", place)
    answer = glucoloop("run", "--duration", 100, "--json")
    assert answer.code == 0
    assert answer.err.startswith("Model: ")


def test_interrupt_that_a_library_swallows_is_heeded(glucoloop, tmp_path, monkeypatch):
    def swallow(*_):
        try:
            os.kill(os.getpid(), __import__("signal").SIGINT)
            time.sleep(1.0)
        except KeyboardInterrupt:
            pass

    monkeypatch.setattr("glucoloop.studies.run.study.close_the_loop", swallow)
    assert glucoloop("run", "--out", "out").code == 130
    assert list(tmp_path.iterdir()) == []
