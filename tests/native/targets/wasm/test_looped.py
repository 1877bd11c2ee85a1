"""Functions that keep their loops, in WebAssembly: node has the bits of the definition of the compact form."""

import json
import shutil
import subprocess
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.native.targets import wasm
from glucoloop.native.targets.c.compact.arithmetic import Evaluation
from glucoloop.native.targets.c.source import trace, write_source

NODE = shutil.which("node")
PEOPLE, SAMPLES = 5, 4
RUN = Path(__file__).with_name("run.mjs")
TOOLS = (NODE, wasm._linker_path(), wasm._clang_path())

needs_tools = pytest.mark.skipif(
    None in TOOLS, reason="needs node, wasm-ld and clang (Debian: apt install nodejs lld clang)"
)


def init(seen):
    return {"x": seen["person"]["matrix"] @ seen["own"]["x"], "seen": seen["own"]["valid"]}


def step(state, seen):
    """A loop of a fixed number of rounds, and one that ends by itself; a truth and a whole number beside them."""
    person, own = seen["person"], seen["own"]

    def turn(x, weight):
        x = jnp.tanh(person["matrix"] @ x) + weight * own["x"] / (1.0 + person["rate"] ** 2)
        return x, jnp.sum(jnp.exp(-jnp.abs(x)))

    x, sums = jax.lax.scan(turn, state["x"], jnp.arange(6.0))
    x = jnp.where(own["valid"], x, state["x"])
    return {"x": x, "seen": own["valid"] ^ state["seen"]}, {"a": sums.max(), "number": jnp.argmax(jnp.abs(x))}


@pytest.fixture(scope="module")
def traced():
    seen = {
        "own": {"valid": np.asarray(True), "x": np.zeros(3)},
        "person": {"matrix": np.zeros((3, 3)), "rate": np.zeros(())},
    }
    return trace(init, step, seen, "float64")


def at(groups, sample, person):
    """Leaves of the observation of a person at a sample."""
    valid, *x = groups["own"][sample, :, person]
    *matrix, rate = groups["person"][:, person]
    return [np.asarray(bool(valid)), np.array(x), np.reshape(matrix, (3, 3)), np.asarray(rate)]


def by_node(name, sizes, groups, module, folder):
    for group, rows in groups.items():
        rows.tofile(folder / f"{group}.bin")
    request = {"name": name, "precision": "float64", "samples": SAMPLES, "people": PEOPLE, "folder": str(folder)}
    (folder / "request.json").write_text(json.dumps({**request, "sizes": {**sizes, "per_person": 0}}))
    subprocess.run([NODE, RUN, wasm._HOST, module, folder / "request.json"], check=True, timeout=120)
    carry, outputs = (np.fromfile(folder / f"{group}.bin") for group in ("carry", "outputs"))
    return carry.reshape(-1, PEOPLE), outputs.reshape(SAMPLES, -1, PEOPLE)


@needs_tools
def test_node_has_the_bits_of_the_definition(traced, tmp_path):
    source = write_source(traced, ["test"], "compact")
    module = tmp_path / "module.wasm"
    functions = {f"loop_{what}": wasm.CFunction(source, is_init=what == "start") for what in ("start", "step")}
    module.write_bytes(wasm.wasm_module(functions))
    rng = np.random.default_rng(5)
    groups = {
        "person": rng.normal(size=(10, PEOPLE)),
        "carry": np.zeros((0, PEOPLE)),
        "own": rng.normal(size=(SAMPLES, 4, PEOPLE)),
        "shared": np.zeros((SAMPLES, 0)),
    }
    groups["own"][:, 0] = rng.integers(0, 2, (SAMPLES, PEOPLE))
    # The second person of a vector who is shown the same is not computed again.
    groups["person"][:, 3], groups["own"][:2, :, 3] = groups["person"][:, 2], groups["own"][:2, :, 2]
    sizes = {"person": 10, "own": 4, "shared": 0}
    _, woken = by_node("loop_start", {**sizes, "carry": 0, "outputs": 4}, groups, module, tmp_path)
    wake, go_on = Evaluation(traced.init, "float64"), Evaluation(traced.step, "float64")
    flat = {**groups, "carry": woken[0]}
    carry, outputs = by_node("loop_step", {**sizes, "carry": 4, "outputs": 2}, flat, module, tmp_path)
    for person in range(PEOPLE):
        state = wake(at(groups, 0, person))
        np.testing.assert_array_equal(np.concatenate([np.ravel(leaf) for leaf in state]), woken[0, :, person])
        for sample in range(SAMPLES):
            *state, a, number = go_on([*state, *at(groups, sample, person)])
            assert [float(a), float(number)] == outputs[sample, :, person].tolist()
        np.testing.assert_array_equal(np.concatenate([np.ravel(leaf) for leaf in state]), carry[:, person])


@needs_tools
def test_a_module_with_a_loop_is_the_same_when_it_is_made_again(traced):
    functions = {"loop": wasm.CFunction(write_source(traced, ["test"], "compact"), is_init=False)}
    assert wasm.wasm_module(functions) == wasm.wasm_module(functions)


def test_without_clang_a_sentence_says_what_is_missing(traced, monkeypatch, tmp_path):
    monkeypatch.setattr(wasm.shutil, "which", lambda name: None)
    function = wasm.CFunction(write_source(traced, ["test"], "compact"), is_init=False)
    with pytest.raises(ValueError, match="clang is not installed, and functions with loops need it; on Debian: apt"):
        wasm._object_of_c("loop", function, 2, tmp_path)
