"""Machine code, programs and results are found again by another process, and not used when damaged or of others."""

import dataclasses
import os
import pickle
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop import _disk_cache as kept
from glucoloop._disk_cache import SUFFIX
from glucoloop._kept_programs import kept_jit
from glucoloop.metrics import RunningMetrics
from glucoloop.native.lower import lower
from glucoloop.native.targets.llvm import kernel
from glucoloop.patients.sorensen.parker1999 import PARKER_1999
from glucoloop.patients.sorensen.rest import infusion_for
from glucoloop.simulation import engines
from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials.trial import Trial


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


def test_code_for_speed_is_used_at_once_where_it_is_kept(folder, computed, compiled, monkeypatch):
    first = computed()
    [quick] = folder.glob(f"*{SUFFIX}")
    with monkeypatch.context() as patched:
        patched.setattr(kernel, "MANY_ROUNDS", 0)
        assert np.array_equal(computed(), first)
    assert len(compiled) == 2
    quick.unlink()
    assert np.array_equal(computed(), first)
    assert len(compiled) == 2


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
def test_nothing_is_kept_without_a_folder(folder, computed, compiled, place, monkeypatch):
    monkeypatch.setenv(kept.VARIABLE, "off")
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
        (
            repr,
            (RunningMetrics(setpoint_mg_dl=81.0, inside_min=(5.0,), further=("mine",)),),
        ),  # a text that names what somebody adds
    ],
)
def test_what_has_no_name_of_its_own_is_not_kept(keeping, function, given):
    kept.kept_result(function, *given)
    assert keeping() == 0


def test_what_is_drawn_by_jax_is_of_its_process():
    def draws(key, index):
        return (), jax.random.normal(jax.random.fold_in(key, index))

    lowered = lower(lambda *groups: draws(*groups[-1]), (), (), (), (), (jax.random.key(0), jnp.zeros((), int)))
    with pytest.raises(kept.NoNameError):
        pickle.dumps(lowered.drawing)


def test_native_code_of_people_is_found_again_with_the_same_bits(keeping, monkeypatch):
    trial = configured(Trial, {"people": 2, "controller": ["pid"]})

    def glucose():
        prepared = engine._prepare(trial)
        return engine.run_people(prepared, "pid", [0, 1], traces=True).glucose_mg_dl

    monkeypatch.setattr(kept, "_left", 99)
    first, number = glucose(), keeping()
    assert number > 0
    monkeypatch.setattr(engines, "lower", None)  # nothing is lowered again
    assert np.array_equal(glucose(), first)
    assert keeping() == number


def test_nothing_is_kept_where_a_function_of_the_package_was_replaced(keeping, monkeypatch):
    assert not kept.is_changed()
    monkeypatch.setattr("glucoloop.patients.sorensen.rest.rest_at", lambda p, glucose_mg_dl: (1.0, None))
    assert kept.is_changed()
    kept.kept_result(infusion_for, PARKER_1999, jnp.asarray(81.1))
    assert keeping() == 0


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The folder of a process for which JAX keeps nothing."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.setenv(kept.VARIABLE, str(tmp_path / "kept"))
    yield tmp_path / "kept"
    jax.config.update("jax_compilation_cache_dir", before)


def tripled(x, times):
    return jnp.tanh(3.0 * x) * times


tripled.__module__ = "glucoloop.tripled"


def called(x, times=2):
    """The result of a program, as in a new process."""
    return np.asarray(kept_jit(static_argnums=1)(tripled)(x, times))


def entries(folder):
    return sorted(folder.glob(f"*{SUFFIX}"))


def test_programs_are_found_again_with_the_same_bits_and_made_again_when_damaged(own):
    x = jnp.asarray([0.1, 0.2])
    expected = np.asarray(jax.jit(tripled, static_argnums=1)(x, 2))
    assert np.array_equal(called(x), expected)
    [place] = entries(own)
    whole, written = place.read_bytes(), place.stat().st_mtime_ns
    assert np.array_equal(called(x), expected)
    assert place.stat().st_mtime_ns == written
    for damaged in (whole[:-1] + bytes([whole[-1] ^ 1]), whole[: len(whole) // 2], b""):
        place.write_bytes(damaged)
        assert np.array_equal(called(x), expected)
        assert place.stat().st_size == len(whole)
    place.write_bytes(kept._sealed(place.stem, b"of another version"))
    assert np.array_equal(called(x), expected)


def test_a_program_is_of_its_static_arguments_and_shapes_and_none_is_kept_of_what_is_traced(own):
    x = jnp.asarray([0.1, 0.2])
    expected = called(x)
    np.testing.assert_allclose(called(x, 3), 1.5 * expected, rtol=1e-14)
    np.testing.assert_allclose(called(x[:1]), expected[:1], rtol=1e-14)
    assert len(entries(own)) == 3
    jax.vmap(called_traced)(x)
    assert len(entries(own)) == 3


def called_traced(x):
    return kept_jit(static_argnums=1)(tripled)(x, 2)


def test_after_many_calls_jax_compiles_for_itself_with_the_same_bits(own, monkeypatch):
    monkeypatch.setattr("glucoloop._kept_programs._MANY", 1)
    program, x = kept_jit(static_argnums=1)(tripled), jnp.asarray([0.1])
    assert np.array_equal(program(x, 2), program(x, 2))


def test_a_program_that_cannot_be_written_runs(own, monkeypatch):
    monkeypatch.setattr("jax.experimental.serialize_executable.serialize", lambda compiled: 1 / 0)
    x = jnp.asarray([0.1])
    assert np.array_equal(called(x), jax.jit(tripled, static_argnums=1)(x, 2))
    assert not entries(own)


def test_a_program_that_calls_python_is_not_kept(own):
    def calling(x):
        return jax.pure_callback(lambda x: np.asarray(x) + 1.0, x, x)

    calling.__module__, calling.__qualname__ = "glucoloop.calling", "calling"
    assert kept_jit(calling)(jnp.asarray(1.0)) == 2.0
    assert not entries(own)


PROGRAM = """
import sys
import jax
import glucoloop as gl
from glucoloop.identification.laguerre import laguerre_functions
before = dict(jax.config.values)
functions = laguerre_functions(0.8, 3, 40)
assert {name for name, value in jax.config.values.items() if before[name] != value} == set()
sys.stdout.write(bytes(functions).hex())
"""


def test_another_process_finds_what_one_kept_with_the_same_bits_and_the_settings_of_jax_stay(tmp_path):
    def bits(place):
        others = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
        told = {"env": {**others, kept.VARIABLE: str(place)}, "capture_output": True, "text": True, "check": True}
        return subprocess.run([sys.executable, "-c", PROGRAM], **told).stdout

    first = bits(tmp_path / "kept")
    [place] = entries(tmp_path / "kept")
    written = place.stat().st_mtime_ns
    assert bits(tmp_path / "kept") == bits("off") == first
    assert place.stat().st_mtime_ns == written


@pytest.mark.skipif(os.name == "nt", reason="modes of files")
class TestFolder:
    def test_it_is_private(self, own):
        assert kept.own_folder() == own
        assert own.stat().st_mode & 0o777 == 0o700
        own.chmod(0o755)
        kept.private_folder(own)
        assert own.stat().st_mode & 0o777 == 0o700

    @pytest.mark.parametrize("others", [0o770, 0o707, 0o777, 0o1777])
    def test_one_that_others_can_write_to_is_refused(self, own, others):
        own.mkdir()
        own.chmod(others)
        with pytest.raises(ValueError, match="others can write to"):
            kept.private_folder(own)
        assert kept.own_folder() is None

    def test_one_that_others_can_replace_is_refused(self, own):
        kept.private_folder(own / "a")
        own.chmod(0o777)
        with pytest.raises(ValueError, match="another folder in the place of"):
            kept.private_folder(own / "a")
        own.chmod(0o1777)  # as /tmp
        kept.private_folder(own / "a")

    def test_one_of_somebody_else_is_refused(self, own, monkeypatch):
        kept.private_folder(own)
        monkeypatch.setattr(os, "getuid", lambda: os.stat(own).st_uid + 1)
        with pytest.raises(ValueError, match="belongs to another user"):
            kept.private_folder(own)

    def test_a_link_or_a_file_in_its_place_is_refused(self, own, tmp_path):
        own.symlink_to(tmp_path)
        with pytest.raises(ValueError, match="is a symbolic link, not a folder"):
            kept.private_folder(own)
        own.unlink()
        own.write_text("mine")
        with pytest.raises(ValueError, match="is a file, not a folder"):
            kept.private_folder(own)


def test_the_oldest_entries_beyond_a_size_are_removed(tmp_path):
    for age, name in enumerate((f"a{SUFFIX}", "b-cache", f"c{SUFFIX}", "other")):
        (tmp_path / name).write_bytes(bytes(100))
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    kept.remove_oldest(tmp_path, 250)
    assert sorted(place.name for place in tmp_path.iterdir()) == [f"a{SUFFIX}", "b-cache", "other"]


def test_traced_arguments_are_computed(keeping):
    jax.jit(lambda glucose: kept.kept_result(infusion_for, PARKER_1999, glucose))(81.1)
    assert keeping() == 0
