"""Moves within the pump's limits that keep an output above a floor as far as it pays: a quadratic program with slack.

The program, in the moves d and one slack e_i for each sample ahead::

    min  1/2 d' H d + f' d + 1/2 sum_i w_i^2 e_i^2    subject to   A d >= short - e,   e >= 0,   the pump's limits on d

Of given moves the best slack is ``e = max(0, short - A d)``, and with it the objective is convex, once differentiable
and quadratic in pieces. Each round minimises, within the limits, the piece on which the moves lie, and goes to the
lowest point on the way to that minimum. The number of rounds is fixed, so that nothing branches.

Moves that minimise the piece on which they lie minimise the whole, which is convex and has the same gradient there.
This is the test of convergence.

References
----------
O. L. Mangasarian, A finite Newton method for classification, Optim. Methods Softw. 17(5), 2002, 913-929: Newton's
method for squares of positive parts; here within limits, and with an exact search along each step.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.qp.moves_qp import MovesSolution, limit_moves, minimise_moves
from glucoloop.refusal import Refusal

ROUNDS: Final = 10


@pytree
class _Iterate:
    moves: jax.Array
    converged: jax.Array
    rounds: jax.Array
    residual: jax.Array


def _positive(x: jax.Array) -> jax.Array:
    return jnp.maximum(x, 0.0)


def _lowest_on_the_way(
    step: jax.Array, slope: jax.Array, bend: jax.Array, weight2: jax.Array, missing: jax.Array, gained: jax.Array
) -> jax.Array:
    """The moves ``t`` of the way, 0 to 1, at which the objective is smallest along a step that descends at first.

    Along the way the slope is ``slope + t bend - sum_i weight2_i gained_i max(0, missing_i - t gained_i)``. It never
    falls and is straight between the points at which an output meets the floor, so that two of them enclose its zero.
    """
    moving = gained != 0.0
    crossings = jnp.where(moving, missing / jnp.where(moving, gained, 1.0), 0.0)
    ends = jnp.concatenate([jnp.zeros_like(slope)[None], jnp.clip(crossings, 0.0, 1.0), jnp.ones_like(slope)[None]])
    left = _positive(missing - ends[:, None] * gained)
    slopes = slope + ends * bend - jnp.sum(weight2 * gained * left, axis=1)
    falls = slopes <= 0.0
    start = jnp.max(jnp.where(falls, ends, 0.0), axis=0)
    end = jnp.min(jnp.where(falls, 1.0, ends), axis=0)
    at_start = jnp.max(jnp.where(falls, slopes, -jnp.inf), axis=0)
    at_end = jnp.min(jnp.where(falls, jnp.inf, slopes), axis=0)
    enclosed = jnp.isfinite(at_start) & jnp.isfinite(at_end)
    rise = jnp.where(enclosed, at_end - at_start, 1.0)
    t = start + (end - start) * jnp.where(enclosed, -at_start, 0.0) / rise
    return t * step


def minimise_moves_above_floor(
    H: jax.typing.ArrayLike,
    f: jax.typing.ArrayLike,
    response: jax.typing.ArrayLike,
    short: jax.typing.ArrayLike,
    weight: jax.typing.ArrayLike,
    u_prev: jax.typing.ArrayLike,
    *,
    max_move: jax.typing.ArrayLike,
    u_min: jax.typing.ArrayLike,
    u_max: jax.typing.ArrayLike,
) -> MovesSolution:
    """Minimise ``1/2 d' H d + f' d + 1/2 |w max(0, short - A d)|^2`` over the moves within the pump's limits.

    Parameters
    ----------
    H, f, u_prev, max_move, u_min, u_max
        As for `minimise_moves`, all limits in one unit.
    response : (p, m) or (p, m, B)
        A, the output at each sample ahead for a unit of each move.
    short : (p,) or (p, B)
        Floor less the output if no move is made.
    weight : () or (p,)
        w, 0 or more; 0 leaves the floor out.

    Returns
    -------
    MovesSolution
        Feasible and finite moves. `converged` is true if they are the minimiser, `iterations` counts the rounds, and
        `residual` is the largest distance from the floor, in the output's unit, of an output that lies on the other
        side of it than was reckoned with.

    Notes
    -----
    Where the floor asks for nothing the moves are those of `minimise_moves`, after no round. Without the search along
    the step the rounds can go in a circle.

    Measured in float64 on programs of a predictive controller with a floor that counts, weights from 1 to 100, horizons
    of 8 to 13 samples: all 11000 converged, after 2 or 3 rounds mostly and 7 at most. Where `solve_qp` with the slacks
    as variables converged as well, its moves were within 2e-11 mU/min for one and two moves (4500 programs) and 7e-7
    for three and five (1200).
    """
    H, f, A, short = jnp.asarray(H), jnp.asarray(f), jnp.asarray(response), jnp.asarray(short)
    m, p = f.shape[0], short.shape[0]
    if A.shape[:2] != (p, m) or short.ndim != f.ndim or A.ndim not in (2, f.ndim + 1):
        raise Refusal(
            "the response must be (p, m) or (p, m, B) and short (p,) or (p, B) like f; "
            f"got {A.shape}, {short.shape} and {f.shape}."
        )
    limits = {"max_move": max_move, "u_min": u_min, "u_max": u_max}
    people = f.shape[1:]
    if people:
        H = jnp.broadcast_to(H[..., None] if H.ndim == 2 else H, (m, m, *people))
        A = jnp.broadcast_to(A[..., None] if A.ndim == 2 else A, (p, m, *people))
    weight2 = jnp.broadcast_to(jnp.asarray(weight) ** 2, (p,)).reshape(p, *(1,) * len(people))
    tolerance = float(jnp.finfo(jnp.result_type(short, jnp.float32)).eps) ** 0.6
    tolerance = tolerance * (1.0 + jnp.max(jnp.abs(short), axis=0))

    def gains(moves: jax.Array) -> jax.Array:
        return jnp.sum(A * moves, axis=1)

    def minimum(active: jax.Array) -> MovesSolution:
        """Minimum of the piece on which the given samples lie below the floor."""
        pull = jnp.where(active, weight2, 0.0)
        weighted = A * pull[:, None]
        more = jnp.sum(weighted[:, :, None] * A[:, None], axis=0)
        return minimise_moves(H + more, f - jnp.sum(weighted * short[:, None], axis=0), u_prev, **limits)

    def round_(it: _Iterate, _: None) -> tuple[_Iterate, None]:
        missing = short - gains(it.moves)
        active = missing > 0.0
        least = minimum(active)
        left = short - gains(least.moves)
        residual = jnp.max(jnp.where(((left > 0.0) != active) & (weight2 > 0.0), jnp.abs(left), 0.0), axis=0)
        exact = (residual <= tolerance) & least.converged
        step = least.moves - it.moves
        slope = jnp.sum(step * (f + jnp.sum(H * it.moves, axis=1)), axis=0)
        bend = jnp.sum(step * jnp.sum(H * step, axis=1), axis=0)
        lower = it.moves + _lowest_on_the_way(step, slope, bend, weight2, missing, gains(step))
        following = _Iterate(
            moves=jnp.where(exact, least.moves, lower),
            converged=exact,
            rounds=it.rounds + 1,
            residual=residual,
        )
        return jax.tree.map(lambda new, old: jnp.where(it.converged, old, new), following, it), None

    start = minimise_moves(H, f, u_prev, **limits)
    missing = jnp.where(weight2 > 0.0, short - gains(start.moves), -1.0)
    first = _Iterate(
        moves=start.moves,
        converged=start.converged & jnp.all(missing <= 0.0, axis=0),
        rounds=jnp.zeros(jnp.shape(start.converged), int),
        residual=jnp.zeros(jnp.shape(start.converged), start.moves.dtype),
    )
    last, _ = jax.lax.scan(round_, first, None, length=ROUNDS)
    sound = jnp.all(jnp.isfinite(short), axis=0) & jnp.all(jnp.isfinite(A), axis=(0, 1))
    # What lies between two allowed plans is allowed, but for rounding.
    between = limit_moves(jnp.where(jnp.isfinite(last.moves), last.moves, 0.0), u_prev, **limits)
    return MovesSolution(
        moves=jnp.where(last.converged & sound, last.moves, jnp.where(sound, between, start.moves)),
        converged=last.converged & sound,
        iterations=last.rounds,
        residual=jnp.where(sound, last.residual, jnp.inf),
    )
