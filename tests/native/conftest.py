"""Functions of one person, carried out for many by native code and by JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.native.lower import lower
from glucoloop.native.targets.llvm.kernel import compile_kernel


def shape(x):
    """Of one person's part of an array in which people trail."""
    x = np.asarray(x)
    return jax.ShapeDtypeStruct(x.shape[:-1], x.dtype)


class Native:
    """A function of arrays, compiled; it is called with arrays in which people trail."""

    def __init__(self, function, *examples, precision="float64", products="fused", as_written=False):
        def step(person, carry, own, shared, rng):
            del person, shared, rng
            return carry, function(*own)

        own = [shape(x) for x in examples]
        lowered = lower(step, (), (), own, (), precision=precision, as_written=as_written)
        self.kernel, self.results = compile_kernel(lowered, products=products), lowered.shapes.outputs

    def __call__(self, *arrays):
        kernel, n = self.kernel, np.shape(arrays[0])[-1]
        columns = kernel.padded(n)
        own = np.zeros((1, kernel.sizes["own"], columns), kernel.dtype)
        own[0, :, :n] = np.concatenate([np.asarray(x, kernel.dtype).reshape(-1, n) for x in arrays])
        written = np.empty((1, kernel.sizes["outputs"], columns), kernel.dtype)
        none = np.zeros((0, columns), kernel.dtype)
        kernel.run(none, none.copy(), kernel.by_vector(own), np.zeros((1, 0), kernel.dtype), written)
        leaves, tree = jax.tree.flatten(self.results)
        ends = np.cumsum([leaf.size for leaf in leaves])
        parts = [
            written[0, end - leaf.size : end, :n].reshape(*leaf.shape, n)
            for end, leaf in zip(ends, leaves, strict=True)
        ]
        return jax.tree.unflatten(tree, parts)


@pytest.fixture(scope="session")
def native():
    """Compile a function of arrays, by examples of them in which people trail."""
    return Native


@pytest.fixture(scope="session")
def by_jax():
    """The same by JAX."""
    return lambda function, *arrays: jax.jit(jax.vmap(function, in_axes=-1, out_axes=-1))(*map(jnp.asarray, arrays))
