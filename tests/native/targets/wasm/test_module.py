"""Kernels in WebAssembly, run by node, have the bits of strict code for this processor and of the interpreter."""

import json
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.native.interpreter import interpret
from glucoloop.native.lower import lower
from glucoloop.native.targets import STRICT, wasm
from glucoloop.native.targets.llvm.kernel import compile_kernel

NODE = shutil.which("node")
PEOPLE, SAMPLES = 7, 5
RUN = __file__.replace("test_module.py", "run.mjs")

needs_wasm = pytest.mark.skipif(
    NODE is None or wasm._linker_path() is None, reason="needs node and wasm-ld (Debian: apt install nodejs lld)"
)


def nonlinear(person, carry, own, shared, rng):
    """A step with every operation of a program, and one with so many quotients that they share divisions."""
    del rng
    rate, matrix = person
    x, alarm = carry
    pushed = jnp.where(alarm, -0.5, 0.5) * shared + own
    x = jnp.tanh(matrix @ x) / (1.0 + rate * rate) + jnp.maximum(pushed * jnp.exp(-rate / 3.0), -jnp.sqrt(rate))
    low = ~jnp.isfinite(jnp.log(x[0])) & (jnp.sign(x[1]) != 1.0) | (jnp.floor(x[2]) <= -1.0)
    risk = jnp.log(1.5 + jnp.abs(x)) ** 1.084 - jnp.expm1(-rate)
    return (x, low ^ alarm), (risk, jnp.minimum(rate, x.min()))


def turning(person, carry, own, shared, rng):
    """A linear step whose products all go into sums, so that fused code gives other bits."""
    del shared, rng
    return person @ carry + own, carry.sum()


def looping(person, carry, own, shared, rng):
    """A loop of many rounds with a matrix of the person, and one until something is small."""
    del shared, rng

    def one(x, row):
        x = 0.9 * jnp.sin(person @ x) + row
        return x, x[0]

    x, firsts = jax.lax.scan(one, carry, jnp.linspace(0.0, 1.0, 70) * own[0])
    half, count = jax.lax.while_loop(lambda c: c[0] > 1e-2, lambda c: (c[0] * 0.5, c[1] + 1), (jnp.abs(own[1]), 0))
    return x, (firsts.sum() + half, count)


GIVEN = {
    "looping": (looping, jnp.zeros((4, 4)), jnp.zeros(4), jnp.zeros(4), ()),
    "nonlinear": (nonlinear, (jnp.zeros(()), jnp.zeros((3, 3))), (jnp.zeros(3), jnp.asarray(False)), jnp.zeros(3), 0.0),
    "turning": (turning, jnp.zeros((4, 4)), jnp.zeros(4), jnp.zeros(4), ()),
}


@pytest.fixture(scope="module", params=["float64", "float32"])
def lowered(request):
    return {name: lower(*given, precision=request.param) for name, given in GIVEN.items()}


@pytest.fixture(scope="module")
def module(lowered, tmp_path_factory):
    place = tmp_path_factory.mktemp("module") / "both.wasm"
    place.write_bytes(wasm.wasm_module(lowered))
    return place


def drawn(lowered):
    """Numbers for all inputs of a run, people trailing."""
    rng, sizes = np.random.default_rng(3), lowered.layout.sizes
    groups = {
        "person": rng.normal(size=(sizes["person"], PEOPLE)),
        "carry": rng.normal(size=(sizes["carry"], PEOPLE)),
        "own": rng.normal(size=(SAMPLES, sizes["own"], PEOPLE)),
        "shared": rng.normal(size=(SAMPLES, sizes["shared"])),
    }
    groups["person"][0] = np.abs(groups["person"][0]) + 0.1
    groups["carry"][3] = rng.integers(0, 2, PEOPLE)
    return {name: rows.astype(lowered.precision) for name, rows in groups.items()}


def interpreted(lowered, groups):
    carry, outputs = groups["carry"], []
    for own, shared in zip(groups["own"], groups["shared"], strict=True):
        shared = np.repeat(shared[:, None], PEOPLE, axis=1)
        carry, of_sample = interpret(lowered, person=groups["person"], carry=carry, own=own, shared=shared)
        outputs.append(of_sample)
    return carry, np.array(outputs)


def by_this_processor(lowered, groups):
    kernel = compile_kernel(lowered, products=STRICT)
    columns = kernel.padded(PEOPLE)

    def wide(rows):
        return np.concatenate([rows, np.repeat(rows[..., -1:], columns - PEOPLE, axis=-1)], axis=-1)

    carry, outputs = wide(groups["carry"]), np.empty((SAMPLES, kernel.sizes["outputs"], columns), kernel.dtype)
    own = kernel.by_vector(wide(groups["own"]))
    kernel.run(wide(groups["person"]), carry, own, groups["shared"], outputs)
    return carry[:, :PEOPLE], outputs[..., :PEOPLE]


def by_node(name, lowered, groups, module, folder):
    for group, rows in groups.items():
        rows.tofile(folder / f"{group}.bin")
    request = {
        "name": name,
        "precision": lowered.precision,
        "sizes": {**lowered.layout.sizes, "per_person": wasm.numbers_per_person(lowered)},
        "samples": SAMPLES,
        "people": PEOPLE,
        "folder": str(folder),
    }
    (folder / "request.json").write_text(json.dumps(request))
    subprocess.run([NODE, RUN, wasm._HOST, module, folder / "request.json"], check=True, timeout=120)
    carry, outputs = (np.fromfile(folder / f"{group}.bin", lowered.precision) for group in ("carry", "outputs"))
    return carry.reshape(-1, PEOPLE), outputs.reshape(SAMPLES, -1, PEOPLE)


@pytest.mark.parametrize("name", list(GIVEN))
@needs_wasm
def test_node_and_this_processor_compute_the_bits_of_the_interpreter(name, lowered, module, tmp_path):
    groups = drawn(lowered[name])
    expected = interpreted(lowered[name], groups)
    for found in (
        by_this_processor(lowered[name], groups),
        by_node(name, lowered[name], groups, module, tmp_path),
    ):
        for part, of_interpreter in zip(found, expected, strict=True):
            np.testing.assert_array_equal(part, of_interpreter)


@needs_wasm
def test_a_module_is_the_same_when_it_is_made_again(lowered, module):
    assert wasm.wasm_module(lowered) == module.read_bytes()


def test_object_code_needs_no_linker(lowered, monkeypatch):
    monkeypatch.setattr(wasm.shutil, "which", lambda name: None)
    assert wasm._object_of_program("turning", lowered["turning"]).startswith(b"\0asm")
    with pytest.raises(ValueError, match="wasm-ld is not installed, and WebAssembly needs it; on Debian: apt install"):
        wasm.wasm_module(lowered)


@pytest.mark.parametrize("name", ["two words", "é", ""])
def test_a_name_that_no_function_can_have_is_refused(name, lowered):
    with pytest.raises(ValueError, match="cannot be the name of a function"):
        wasm.wasm_module({name: lowered["turning"]})


@needs_wasm
def test_an_array_of_another_size_is_refused(lowered, module, tmp_path):
    groups = drawn(lowered["turning"])
    groups["carry"] = groups["carry"][:3]
    with pytest.raises(subprocess.CalledProcessError):
        by_node("turning", lowered["turning"], groups, module, tmp_path)


def test_jax_agrees(lowered):
    """The interpreter, from which all of them start, computes the function."""
    of = lowered["turning"]
    groups = drawn(of)
    step = jax.vmap(lambda p, c, o: turning(p, c, o, (), ()), in_axes=-1, out_axes=-1)
    expected, _ = step(groups["person"].reshape(4, 4, PEOPLE), groups["carry"], groups["own"][0])
    found, _ = interpret(of, person=groups["person"], carry=groups["carry"], own=groups["own"][0])
    np.testing.assert_allclose(found, expected, rtol=1e-5 if of.precision == "float32" else 1e-13, atol=1e-6)
