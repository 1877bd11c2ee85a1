"""Linear equations of one person or, under `jax.vmap`, of many: on a processor of one person after another.

LAPACK's routines for many matrices at once can stop a program for ever: JAX 0.10 shares large batches out among the
threads of XLA, and the thread that did so waits for the others. Where as many independent batches begin as there are
threads, as in the doublings of `steady_state`, all wait and none computes. On two threads this happens with two batches
of 100 triangular systems of 19 equations and 38 right sides each. A call for a single matrix is never shared out. Other
devices solve for all people at once.
"""

from __future__ import annotations

import jax
from jax import Array


def solved(matrix: Array, right: Array) -> Array:
    """Solution ``(n, m)`` of ``matrix x = right``, with a matrix ``(n, n)`` of full rank, by elimination.

    It can be differentiated in both directions, and mapped over any number of people.
    """
    solution: Array = jax.lax.custom_linear_solve(
        lambda x: matrix @ x,
        right,
        solve=lambda _, given: _eliminated(matrix, given),
        transpose_solve=lambda _, given: _eliminated(matrix.T, given),
    )
    return solution


def _with_rows_exchanged(matrix: Array, right: Array) -> Array:
    """Solution with the rows exchanged directly: `jnp.linalg.solve` transposes them twice."""
    factors, _, order = jax.lax.linalg.lu(matrix)
    below = jax.lax.linalg.triangular_solve(factors, right[order], left_side=True, lower=True, unit_diagonal=True)
    return jax.lax.linalg.triangular_solve(factors, below, left_side=True)


_eliminated = jax.custom_batching.custom_vmap(_with_rows_exchanged)


@_eliminated.def_vmap
def _of_people(size: int, mapped: list[bool], matrix: Array, right: Array) -> tuple[Array, bool]:
    of_matrix, of_right = mapped

    def one_after_another(matrix: Array, right: Array) -> Array:
        solutions: Array
        if not of_right:
            solutions = jax.lax.map(lambda own: _eliminated(own, right), matrix)
        elif not of_matrix:
            solutions = jax.lax.map(lambda own: _eliminated(matrix, own), right)
        else:
            solutions = jax.lax.map(lambda own: _eliminated(*own), (matrix, right))
        return solutions

    def at_once(matrix: Array, right: Array) -> Array:
        axes = tuple(0 if own else None for own in mapped)
        solutions: Array = jax.vmap(_with_rows_exchanged, in_axes=axes)(matrix, right)
        return solutions

    return jax.lax.platform_dependent(matrix, right, cpu=one_after_another, default=at_once), True
