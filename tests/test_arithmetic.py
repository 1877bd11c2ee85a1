"""The settings that bits depend on are glucoloop's own, whatever the environment says; other users keep theirs."""

import json
import os
import subprocess
import sys

import pytest

from glucoloop import arithmetic

WHAT = (
    "import json, os, sys\n"
    "told = {name: str(getattr(jax.config, name)) for name in "
    "('jax_enable_x64', 'jax_default_prng_impl', 'jax_threefry_partitionable', 'jax_default_matmul_precision')}\n"
    "print(json.dumps([told, os.environ.get('JAX_ENABLE_X64')]))\n"
)


def process(code, **environment):
    """What a new process says; returns its settings, its variable, and what it wrote to standard error."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    done = subprocess.run(
        [sys.executable, "-c", code + WHAT], env={**clean, **environment}, capture_output=True, text=True, check=True
    )
    told, variable = json.loads(done.stdout)
    return told, variable, done.stderr


HOSTILE = {
    "JAX_ENABLE_X64": "0",
    "JAX_DEFAULT_PRNG_IMPL": "rbg",
    "JAX_THREEFRY_PARTITIONABLE": "0",
    "JAX_DEFAULT_MATMUL_PRECISION": "bfloat16",
}
PINNED = {
    "jax_enable_x64": "True",
    "jax_default_prng_impl": "threefry2x32",
    "jax_threefry_partitionable": "True",
    "jax_default_matmul_precision": "None",
}


@pytest.mark.long
def test_importing_changes_nothing_but_float64():
    others = {name: value for name, value in HOSTILE.items() if name != "JAX_ENABLE_X64"}
    told, variable, err = process("import glucoloop, jax\n", **others)
    assert told == {
        "jax_enable_x64": "True",
        "jax_default_prng_impl": "rbg",
        "jax_threefry_partitionable": "False",
        "jax_default_matmul_precision": "bfloat16",
    }
    assert variable is None  # child processes of others are not changed
    assert err == ""


@pytest.mark.long
@pytest.mark.parametrize("order", ["import glucoloop, jax\n", "import jax, glucoloop\n"])
def test_importing_switches_to_float64_and_says_so_where_something_else_was_asked_for(order):
    told, _, err = process(order, JAX_ENABLE_X64="0")
    assert told["jax_enable_x64"] == "True"
    assert "JAX_ENABLE_X64=0 is not heeded" in err


@pytest.mark.long
@pytest.mark.parametrize("order", ["", "import jax\n"])
def test_the_command_line_fixes_all_settings_and_says_what_it_does_not_heed(order):
    code = f"{order}from glucoloop.arithmetic import pin\nimport sys\nprint(*pin(), file=sys.stderr)\nimport jax\n"
    told, _, err = process(code, **HOSTILE)
    assert told == PINNED
    for variable, value in HOSTILE.items():
        assert f"{variable}={value} is not heeded; glucoloop computes with" in err
    assert "glucoloop computes with JAX_ENABLE_X64=1." in err
    assert "glucoloop computes without it." in err


def test_what_is_as_glucoloop_computes_is_not_mentioned(monkeypatch):
    for name, value in {"JAX_ENABLE_X64": "true", "JAX_DEFAULT_PRNG_IMPL": "threefry2x32"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("XLA_FLAGS", "--xla_force_host_platform_device_count=2")
    assert arithmetic.pin() == []


def test_flags_that_let_results_differ_are_mentioned(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true --xla_dump_to=/tmp")
    assert arithmetic.pin() == [
        "XLA_FLAGS has --xla_cpu_enable_fast_math=true; results may differ from those without it."
    ]


def test_identity_tells_what_bits_depend_on(monkeypatch):
    here = arithmetic.identity()
    assert {*arithmetic.LIBRARIES, *arithmetic.SETTINGS, "processor", "platform", "XLA_FLAGS"} <= here.keys()
    assert arithmetic.difference(here, arithmetic.identity()) is None
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true")
    there = arithmetic.identity()
    assert arithmetic.digest(here) != arithmetic.digest(there)
    assert arithmetic.difference(here, there)[0] == "XLA_FLAGS"
    assert arithmetic.difference({}, {"numpy": "2"}) == ("numpy", "not given", "2")
