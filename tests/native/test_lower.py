"""The seam between a traced function and its targets: a lowered function means what its operations say, and no more."""

import dataclasses
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.native.interpreter import interpret
from glucoloop.native.lower import lower
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets import FUSED, STRICT
from glucoloop.native.targets.llvm.emit import _fused_products
from glucoloop.native.targets.llvm.kernel import compile_kernel

PEOPLE = 13


def step(person, carry, own, shared, rng):
    """Something of every operation."""
    rate, matrix = person
    x, alarm, count = carry
    noise = jax.random.normal(rng, (3,))
    pushed = jnp.where(alarm, -0.5, 0.5) * shared["push"] + own + 0.1 * noise
    x = jnp.tanh(matrix @ x) / (1.0 + rate * rate) + jnp.maximum(pushed * jnp.exp(-rate / 3.0), -jnp.sqrt(rate))
    low = ~jnp.isfinite(jnp.log(x[0])) & (jnp.sign(x[1]) != 1.0) | (jnp.floor(x[2]) <= -1.0)
    risk = jnp.log(1.5 + jnp.abs(x)) ** 1.084 - jnp.expm1(-rate)
    turned = jnp.sin(x) + jnp.cos(3.0 * own) * jnp.cbrt(own) + jnp.arctan2(own, x) - 1e-3 * jnp.sinh(own)
    coarse = jnp.round(7.0 * own[0]) + jax.lax.round(own[1]) + jnp.mod(own[2], 0.3) - jnp.ceil(own[0])
    place = (jnp.floor(own[1] * 2.0).astype(int) % 5) // 2
    x = x + jax.lax.cond(low, lambda: turned, lambda: coarse + jnp.asarray([0.5, 1.5, 4.0])[place] * turned)
    x = x + jnp.interp(own[0], jnp.asarray([-2.0, -0.5, 0.5, 2.0]), jnp.asarray([0.0, 1.0, -1.0, 3.0]))
    return (x, low ^ alarm, count + low), {"x": x, "risk": risk, "count": count, "least": jnp.minimum(rate, x.min())}


GIVEN = (
    (jnp.zeros(()), jnp.zeros((3, 3))),
    (jnp.zeros(3), jnp.asarray(False), jnp.asarray(0)),
    jnp.zeros(3),
    {"push": jnp.zeros(())},
)


@pytest.fixture(scope="module", params=["float64", "float32"])
def lowered(request):
    return lower(step, *GIVEN, jax.random.key(0), precision=request.param)


@pytest.fixture(scope="module")
def groups(lowered):
    """Numbers for each group of inputs; people trail."""
    rng = np.random.default_rng(5)
    sizes = lowered.layout.sizes
    drawn = {name: rng.normal(size=(sizes[name], PEOPLE)) for name in ("person", "carry", "own", "shared")}
    drawn["person"][0] = np.abs(drawn["person"][0]) + 0.1
    drawn["carry"][3:] = rng.integers(0, 2, (2, PEOPLE))
    drawn["shared"][:] = drawn["shared"][:, :1]
    return {name: rows.astype(lowered.precision) for name, rows in drawn.items()}


def by_llvm(lowered, groups, products):
    kernel = compile_kernel(lowered, products=products)
    columns = kernel.padded(PEOPLE)

    def wide(rows):
        return np.concatenate([rows, np.repeat(rows[:, :1], columns - PEOPLE, axis=1)], axis=1)

    carry, outputs = wide(groups["carry"]), np.empty((1, kernel.sizes["outputs"], columns), kernel.dtype)
    shared = np.ascontiguousarray(groups["shared"][None, :, 0])
    own = kernel.by_vector(wide(groups["own"])[None])
    kernel.run(wide(groups["person"]), carry, own, shared, outputs)
    return [carry[:, :PEOPLE], outputs[0, :, :PEOPLE]]


def test_strict_code_is_the_operations_to_the_bit(lowered, groups):
    for found, expected in zip(by_llvm(lowered, groups, STRICT), interpret(lowered, **groups), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_fused_code_differs_from_it_by_rounding_alone(lowered, groups):
    program, layout = lowered.program, lowered.layout
    assert _fused_products(program, program.needed(layout.results), layout.results)
    eps = float(np.finfo(lowered.precision).eps)
    differs = False
    for found, expected in zip(by_llvm(lowered, groups, FUSED), interpret(lowered, **groups), strict=True):
        np.testing.assert_allclose(found, expected, rtol=300 * eps, atol=300 * eps)
        differs |= not np.array_equal(found, expected)
    assert differs


def test_a_way_of_rounding_that_does_not_exist_is_refused(lowered):
    with pytest.raises(ValueError, match="'loose'; the known ones are: fused, strict"):
        compile_kernel(lowered, products="loose")


def test_the_program_and_its_layout_can_be_sent_elsewhere(lowered, groups):
    program, layout = pickle.loads(pickle.dumps((lowered.program, lowered.layout)))
    there = dataclasses.replace(lowered, program=program, layout=layout)
    for found, expected in zip(interpret(there, **groups), interpret(lowered, **groups), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_no_quotient_is_left_for_a_target_to_share(lowered):
    assert "ratio" not in {operation for operation, _ in lowered.program.operations}


def test_the_shapes_are_those_of_the_function(lowered):
    carry, outputs = jax.eval_shape(step, *GIVEN, jax.random.key(0))
    assert (lowered.shapes.carry, lowered.shapes.outputs) == (carry, outputs)
    sizes = {"person": 10, "carry": 5, "own": 3 + 3, "shared": 1, "outputs": 8}
    assert lowered.layout.sizes == sizes
    assert len(lowered.layout.next_carry) == 5


def test_a_state_that_changes_its_shape_is_refused():
    with pytest.raises(TypeError, match=r"shapes \[\(3,\)\] before a sample, but \[\(\)\] after it"):
        lower(lambda person, carry, own, shared, rng: (carry.sum(), ()), (), jnp.zeros(3), (), ())


def test_what_no_target_could_carry_out_is_refused_before_any():
    with pytest.raises(UnsupportedError, match="sort"):
        lower(lambda person, carry, own, shared, rng: (jnp.sort(carry), ()), (), jnp.zeros(3), (), ())
