"""A loop as native code: what is handed on, who stands in which lane, how the work is cut, and by how many threads."""

import gc

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.native.lower import lower
from glucoloop.native.targets.llvm import emit, kernel
from glucoloop.native.targets.llvm import kernel as llvm
from glucoloop.native.targets.llvm.kernel import compile_kernel, lanes, vectors_at_once
from glucoloop.patients import Inputs
from glucoloop.patients.sorensen import equations as sorensen

PRECISIONS = ["float64", "float32"]
SAMPLES, PEOPLE = 7, 61
EPS = {p: float(np.finfo(p).eps) for p in PRECISIONS}


def step(person, carry, own, shared, rng):
    """Numbers, truths and counts handed on; constants of a person; what reaches him and everybody."""
    del rng
    rate, matrix = person
    x, alarm, count = carry
    pushed = jnp.where(alarm, -0.5, 0.5) * shared["push"] + own
    x = jnp.tanh(matrix @ x) / (1.0 + rate * rate) + pushed * jnp.exp(-rate / 3.0)
    low = jnp.any(x < -0.6)
    count = count + jnp.where(low, 1, 0)
    risk = jnp.log(1.5 + jnp.abs(x)) ** 1.084
    return (x, low ^ alarm, count), {"x": x, "low": low, "risk": risk.sum(), "rate": rate, "count": count, "one": 1.0}


EXAMPLE = ((jnp.zeros(()), jnp.zeros((3, 3))), (jnp.zeros(3), jnp.asarray(False), jnp.asarray(0)))
REACHING, TOLD = jnp.zeros(3), {"push": jnp.zeros(())}


@pytest.fixture(scope="module")
def numbers():
    """Of people and samples, as (person, carry, own, shared) in which people trail."""
    rng = np.random.default_rng(0)
    person = rng.uniform(0.1, 2.0, PEOPLE), rng.normal(size=(3, 3, PEOPLE))
    carry = rng.normal(size=(3, PEOPLE)), rng.uniform(size=PEOPLE) > 0.5, np.zeros(PEOPLE, int)
    return person, carry, 0.3 * rng.normal(size=(SAMPLES, 3, PEOPLE)), {"push": rng.normal(size=SAMPLES)}


@pytest.fixture(scope="module")
def lowered():
    return {p: lower(step, *EXAMPLE, REACHING, TOLD, precision=p) for p in PRECISIONS}


@pytest.fixture(scope="module")
def compiled(lowered):
    return {p: compile_kernel(lowered[p]) for p in PRECISIONS}


def rows(k, tree):
    """A tree of people's numbers as the rows that a kernel takes."""
    flat = [np.asarray(leaf, k.dtype) for leaf in jax.tree.leaves(tree)]
    return np.concatenate([leaf.reshape(-1, leaf.shape[-1]) for leaf in flat])


def padded(k, array, fill=0.0):
    wide = np.full((*array.shape[:-1], k.padded(array.shape[-1])), fill, k.dtype)
    wide[..., : array.shape[-1]] = array
    return wide


def run(k, numbers, people=slice(None), fill=0.0, threads=1):
    """Carry at the end and outputs of some people; lanes without anybody hold the fill."""
    person, carry, own, shared = numbers
    person, carry = (padded(k, rows(k, part)[:, people], fill) for part in (person, carry))
    own = padded(k, own[..., people].astype(k.dtype), fill)
    written = np.empty((SAMPLES, k.sizes["outputs"], own.shape[-1]), k.dtype)
    k.run(person, carry, k.by_vector(own), shared["push"][:, None].astype(k.dtype), written, threads=threads)
    n = np.arange(PEOPLE)[people].size
    return carry[:, :n], written[..., :n]


@pytest.fixture(scope="module")
def scanned(numbers):
    """The same by JAX: carry and outputs as rows."""
    person, carry, own, shared = jax.tree.map(jnp.asarray, numbers)

    def one(person, carry, own):
        return jax.lax.scan(lambda c, entry: step(person, c, *entry, ()), carry, (own, shared))

    last, outputs = jax.jit(jax.vmap(one, in_axes=-1, out_axes=-1))(person, carry, own)
    outputs = [np.asarray(leaf, float).reshape(SAMPLES, -1, PEOPLE) for leaf in jax.tree.leaves(outputs)]
    return np.concatenate([np.asarray(x, float).reshape(-1, PEOPLE) for x in jax.tree.leaves(last)]), np.concatenate(
        outputs, axis=1
    )


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_loop_is_the_scan_of_its_step(compiled, numbers, scanned, precision):
    found = run(compiled[precision], numbers)
    for a, b in zip(found, scanned, strict=True):
        np.testing.assert_allclose(a, b, rtol=300 * EPS[precision], atol=300 * EPS[precision])


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_person_is_the_same_in_any_lane_beside_anybody(compiled, numbers, precision):
    k = compiled[precision]
    everybody = run(k, numbers)
    order = np.random.default_rng(1).permutation(PEOPLE)
    for people, fill in ((order, 0.0), (order[:5], np.nan), (order[:1], np.inf), (np.array([7, 7, 7]), -1e30)):
        for a, b in zip(run(k, numbers, people, fill), everybody, strict=True):
            np.testing.assert_array_equal(a, b[..., people])


@pytest.mark.parametrize("threads", [2, 3, 20])
def test_threads_make_no_difference(compiled, numbers, threads):
    for a, b in zip(run(compiled["float64"], numbers, threads=threads), run(compiled["float64"], numbers), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.long
@pytest.mark.parametrize("size", [1, 2, 7, 40])
def test_how_the_work_is_cut_makes_no_difference(lowered, compiled, numbers, monkeypatch, size):
    monkeypatch.setattr(emit, "OPERATIONS_A_CHUNK", (size, size))
    cut = compile_kernel(lowered["float64"])
    assert cut.text.count("chunk") > compiled["float64"].text.count("chunk")
    for a, b in zip(run(cut, numbers), run(compiled["float64"], numbers), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("vectors", [1, 3])
def test_nor_how_many_vectors_go_together(lowered, compiled, numbers, monkeypatch, vectors):
    monkeypatch.setattr(emit, "_VECTORS_A_BLOCK", vectors)
    monkeypatch.setattr(emit, "FITS_THE_CACHE", 0)
    other = compile_kernel(lowered["float64"])
    for a, b in zip(run(other, numbers), run(compiled["float64"], numbers), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("vectors", [2, 4])
def test_nor_how_many_are_carried_out_at_once(lowered, compiled, numbers, vectors):
    other = compile_kernel(lowered["float32"], vectors=vectors)
    assert other.lanes == vectors * lanes("float32")
    for a, b in zip(run(other, numbers), run(compiled["float32"], numbers), strict=True):
        np.testing.assert_array_equal(a, b)


def test_more_vectors_are_carried_out_at_once_where_operations_wait():
    def program(operation):
        def of(person, carry, own, shared, rng):
            del person, shared, rng
            return carry, operation(own)

        return lower(of, (), jnp.zeros(()), jnp.zeros(40), ())

    def chain(x):
        for _ in range(200):
            x = x * x + 0.1
        return x

    assert vectors_at_once(program(lambda x: jnp.tanh(x))) == 1
    assert vectors_at_once(program(lambda x: chain(x[0]))) == 4
    assert vectors_at_once(program(lambda x: chain(x[:4]))) == 2


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("bits", [128, 256, 512])
def test_nor_how_wide_a_vector_is(lowered, compiled, numbers, monkeypatch, bits, precision):
    cpu, features, _ = kernel._processor()
    monkeypatch.setattr(kernel, "_processor", lambda: (cpu, features, bits))
    other = compile_kernel(lowered[precision])
    assert other.lanes == bits // (64 if precision == "float64" else 32)
    monkeypatch.undo()
    for a, b in zip(run(other, numbers), run(compiled[precision], numbers), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_sharing_divisions_loses_a_few_units_in_the_last_place(compiled, numbers, monkeypatch, precision):
    monkeypatch.setattr("glucoloop.native.lower._QUOTIENTS_A_DIVISION", 1)
    apart = compile_kernel(lower(step, *EXAMPLE, REACHING, TOLD, precision=precision))
    divided = [k.text.count("fdiv") for k in (apart, compiled[precision])]
    assert divided[0] > divided[1]
    for a, b in zip(run(apart, numbers), run(compiled[precision], numbers), strict=True):
        np.testing.assert_allclose(a, b, rtol=200 * EPS[precision], atol=200 * EPS[precision])


def test_somebody_who_is_no_number_stays_alone(compiled, numbers):
    k = compiled["float64"]
    person, carry, own, shared = numbers
    spoilt = own.copy()
    spoilt[3, 1, 10] = np.nan
    last, written = run(k, (person, carry, spoilt, shared))
    sound, expected = run(k, numbers)
    assert np.isnan(last[:3, 10]).any()
    others = np.arange(PEOPLE) != 10
    np.testing.assert_array_equal(last[:, others], sound[:, others])
    np.testing.assert_array_equal(written[..., others], expected[..., others])
    np.testing.assert_array_equal(written[:3, :, 10], expected[:3, :, 10])


def test_what_a_person_is_is_computed_once(compiled):
    text = compiled["float64"].text
    before, within = text.split("sample:")[0], text.split("sample:")[1]
    assert "fdiv" in before  # 1 / (1 + rate^2), for all samples
    assert before.count("@llvm.fma") > 10  # exp(-rate / 3)
    assert within.count("fdiv") == 3  # of three tanh, three logarithms, and the three within the powers of these


def test_no_samples_hand_back_what_came(compiled, numbers):
    k = compiled["float64"]
    person, carry, own, _ = numbers
    person, carry, own = padded(k, rows(k, person)), padded(k, rows(k, carry)), padded(k, own[:0])
    before = carry.copy()
    k.run(person, carry, k.by_vector(own), np.zeros((0, 1)), np.zeros((0, k.sizes["outputs"], carry.shape[1])))
    np.testing.assert_array_equal(carry, before)


def test_arrays_of_another_precision_or_order_are_refused(compiled, numbers):
    k = compiled["float64"]
    person, carry, own, shared = numbers
    given = {
        "person": padded(k, rows(k, person)),
        "carry": padded(k, rows(k, carry)),
        "own": k.by_vector(padded(k, own)),
        "shared": shared["push"][:, None],
        "outputs": np.zeros((SAMPLES, k.sizes["outputs"], k.padded(PEOPLE))),
    }
    with pytest.raises(TypeError, match="an array of float32"):
        k.run(**given | {"own": given["own"].astype(np.float32)})
    with pytest.raises(TypeError, match="not contiguous"):
        k.run(**given | {"own": given["own"].swapaxes(1, 2).copy().swapaxes(1, 2)})


@pytest.mark.long
def test_kernels_come_and_go(compiled, numbers, native):
    """Each owns what it was compiled with, so that the end of one is not the end of others."""
    for factor in range(3):
        x = np.arange(3.0)
        np.testing.assert_array_equal(native(lambda x, factor=factor: x * factor + 1.0, x)(x), x * factor + 1.0)
        gc.collect()
    run(compiled["float64"], numbers)


def test_equal_code_is_compiled_once(lowered, compiled, numbers):
    once, again, other = (compile_kernel(lowered[p]) for p in ("float64", "float64", "float32"))
    results = [run(kernel, numbers) for kernel in (once, again, other)]
    assert once._engine is again._engine is not other._engine
    for a, b in zip(results[1], run(compiled["float64"], numbers), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_kernel_that_runs_for_long_is_compiled_for_speed_with_the_same_bits(lowered, numbers, monkeypatch, precision):
    monkeypatch.setattr(llvm, "is_kept", lambda made_from: False)  # by an earlier run of the tests
    kernel = compile_kernel(lowered[precision])
    quick = run(kernel, numbers)
    code = kernel._engine
    monkeypatch.setattr(llvm, "MANY_ROUNDS", kernel._rounds)
    fast = run(kernel, numbers)
    assert kernel._engine is not code
    code = kernel._engine
    run(kernel, numbers)
    assert kernel._engine is code
    for a, b in zip(quick, fast, strict=True):
        np.testing.assert_array_equal(a, b)


def test_columns_fill_whole_vectors(compiled):
    for precision in PRECISIONS:
        k = compiled[precision]
        assert k.lanes == lanes(precision)
        assert [k.padded(n) for n in (1, k.lanes, k.lanes + 1)] == [k.lanes, k.lanes, 2 * k.lanes]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_patients_balances_are_those_that_jax_computes(native, by_jax, precision, patient_81):
    def balances(x, insulin, meal, F_LC):
        p = patient_81.parameters.__class__(**{**vars(patient_81.parameters), "F_LC": F_LC})
        return sorensen.derivative(p, x, Inputs(insulin_mU_min=insulin, meal_mg_min=meal))

    rng = np.random.default_rng(2)
    rest = np.asarray(patient_81.steady_state(patient_81.basal_insulin_mU_min))[:, None]
    x = rest * rng.uniform(0.5, 2.0, (19, 50))
    given = x, rng.uniform(0.0, 66.9, 50), rng.uniform(0.0, 400.0, 50), rng.uniform(0.24, 0.56, 50)
    scale = 50 * EPS[precision] * np.abs(x).max()
    np.testing.assert_allclose(
        native(balances, *given, precision=precision)(*given), by_jax(balances, *given), atol=scale
    )
