"""Machine code and results are kept where JAX keeps its own: found again, and not used when damaged or of others."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop import _disk_cache as kept
from glucoloop._disk_cache import SUFFIX
from glucoloop.native.lower import lower
from glucoloop.native.targets.llvm import kernel
from glucoloop.patients.sorensen.parameters.parker1999 import PARKER_1999
from glucoloop.patients.sorensen.rest import infusion_for


@pytest.fixture
def folder(tmp_path):
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)


@pytest.fixture
def computed():
    """Output of ``tanh(3 x)`` for 1, as by a new process; each call makes it again."""

    def by(factor=3.0):
        kernel._compiled.cache_clear()
        one, none = jnp.zeros(()), ()
        step = lower(lambda person, carry, own, shared, rng: (carry, jnp.tanh(factor * own)), none, none, one, none)
        made = kernel.compile_kernel(step)
        rows = [np.zeros((0, made.lanes)), np.zeros((0, made.lanes)), np.ones((1, 1, 1, made.lanes)), np.zeros((1, 0))]
        outputs = np.zeros((1, 1, made.lanes))
        made.run(*rows, outputs)
        return outputs.ravel()

    return by


@pytest.fixture
def compiled(monkeypatch):
    """Modules that LLVM compiles, one entry each."""
    from llvmlite import binding

    made = []
    emit = binding.TargetMachine.emit_object
    monkeypatch.setattr(binding.TargetMachine, "emit_object", lambda self, module: made.append(1) or emit(self, module))
    return made


def test_it_is_found_again_and_gives_the_same_bits(folder, computed, compiled):
    first = computed()
    assert len(compiled) == 1
    assert np.array_equal(computed(), first)
    assert len(compiled) == 1
    np.testing.assert_allclose(first, np.tanh(3.0), rtol=1e-14)
    assert not np.array_equal(computed(2.0), first)
    assert len(compiled) == len(list(folder.glob(f"*{SUFFIX}"))) == 2


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-1] + bytes([data[-1] ^ 1]), lambda data: data[:40], lambda _: b""]
)
def test_what_is_damaged_is_compiled_again(folder, computed, compiled, damage):
    first = computed()
    [place] = folder.glob(f"*{SUFFIX}")
    whole = place.read_bytes()
    place.write_bytes(damage(whole))
    assert np.array_equal(computed(), first)
    assert len(compiled) == 2
    assert place.read_bytes() == whole


def test_code_of_another_module_is_not_run(folder, computed, compiled):
    first, other = computed(), computed(2.0)
    one, two = folder.glob(f"*{SUFFIX}")
    data = one.read_bytes(), two.read_bytes()
    one.write_bytes(data[1])
    two.write_bytes(data[0])
    assert np.array_equal(computed(), first)
    assert np.array_equal(computed(2.0), other)
    assert len(compiled) == 4


def test_another_processor_has_code_of_its_own(folder, computed, monkeypatch):
    computed()
    name, features, bits = kernel._processor()
    monkeypatch.setattr(kernel, "_processor", lambda: (name, features + ",+nopl", bits))
    computed()
    assert len(list(folder.glob(f"*{SUFFIX}"))) == 2


@pytest.mark.parametrize("place", [None, "gs://bucket/programs", "/proc/none"])
def test_nothing_is_kept_without_a_folder(folder, computed, compiled, place):
    jax.config.update("jax_compilation_cache_dir", place)
    assert np.array_equal(computed(), computed())
    assert len(compiled) == 2
    assert not list(folder.glob(f"*{SUFFIX}"))


@pytest.fixture
def keeping(folder, monkeypatch):
    monkeypatch.setattr(kept, "_left", 2)
    return lambda: len(list(folder.glob(f"*{SUFFIX}")))


def test_result_is_found_again_to_the_bit(keeping):
    computed = infusion_for(PARKER_1999, jnp.asarray(81.1))
    for _ in range(2):
        found = kept.kept_result(infusion_for, PARKER_1999, jnp.asarray(81.1))
        assert (type(found), found.dtype, found.weak_type) == (type(computed), computed.dtype, computed.weak_type)
        assert np.array_equal(found, computed)
    assert keeping() == 1
    assert kept.kept_result(infusion_for, PARKER_1999, jnp.asarray(90.0)) < computed
    assert keeping() == 2
    kept.kept_result(infusion_for, PARKER_1999, jnp.asarray(91.0))
    assert keeping() == 2  # as many as a process adds


@dataclasses.dataclass(frozen=True)
class Mine:
    p: object = PARKER_1999


jax.tree_util.register_dataclass(Mine)


@pytest.mark.parametrize(
    ("function", "given"),
    [
        (lambda p, _: p, (PARKER_1999, 81.1)),
        (np.hypot, (3.0, 4.0)),
        (infusion_for, (PARKER_1999, jnp.full(10_001, 81.1))),
        (repr, (Mine(),)),
    ],
)
def test_what_has_no_name_of_its_own_is_not_kept(keeping, function, given):
    kept.kept_result(function, *given)
    assert keeping() == 0


def test_results_are_kept_only_where_it_is_asked_for(folder):
    kept.kept_result(infusion_for, PARKER_1999, jnp.asarray(81.1))
    assert not list(folder.glob(f"*{SUFFIX}"))


def test_traced_arguments_are_computed(keeping):
    jax.jit(lambda glucose: kept.kept_result(infusion_for, PARKER_1999, glucose))(81.1)
    assert keeping() == 0
