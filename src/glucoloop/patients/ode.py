"""A patient given by nothing but its equations: constants, a derivative, its glucose, and roughly a steady state.

Where it rests is found by Newton's method on the derivative. Equations that stop at zero (an amount that cannot become
negative) have spurious steady states beyond it; a state that is positive at the rough state is kept positive.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jit, jnp
from glucoloop.patients.component import PatientComponent
from glucoloop.patients.protocol import inputs_of
from glucoloop.patients.resting import Constants, Rest, shape_of_people

_MAX_STEPS: Final = 100
_STILL: Final = 1e-14
"""Relative change of a step after which a person is at steady state."""
_STEADY: Final = 1e-9
"""Largest last change of a steady state, as a share of the state's size."""
_KEPT: Final = 0.1
"""Minimum share of a positive state that a step leaves."""
_VANISHED: Final = 1e-6
"""Share of the glucose near rest below which it has gone to zero: without glucose most equations rest too."""


class OdePatient(PatientComponent):
    """Base of a patient of somebody's own.

    A subclass is a frozen record that JAX can trace, and declares

    - ``nominal``, the constants by name, which ``derivative`` finds in ``self.parameters``: numbers, or arrays
      ``(people,)`` of those that vary;
    - ``near_rest``, a state near the one at steady state ``(states,)``, and ``near_basal_mU_min``, the rate that
      goes with it;
    - ``derivative(t_min, x, inputs)``, the rate of change of the state ``(states, ...)`` per minute at a time of day;
    - ``glucose_mg_dl(x)``, the glucose that is controlled;

    and what is optional of any patient, such as ``insulin_route``, ``sites`` or ``meal_model``. With
    ``operating_points``, each at a glucose, and ``pulse_mU_min`` it joins every command; with ``populations`` and
    ``variations`` it has people of its own. Equations of the clock
    rest with the clock at midnight. With ``takes_exercise = True`` the derivative may read ``inputs.exercise_pct``,
    which is 0 at steady state, and with ``takes_glucagon = True`` ``inputs.glucagon_ug_min``, which is None where none
    is given. Rhythms change the constants that ``insulin_sensitivity`` names, a tuple of those that
    are proportional to sensitivity, and ``glucose_production``, a mapping of constants to what 1 mg/kg/min adds to
    each.

    Examples
    --------
    Bergman's minimal model, intravenous insulin:

    >>> import glucoloop as gl
    >>> import jax.numpy as jnp
    >>> class Bergman(gl.patients.OdePatient):
    ...     nominal = {"p_1": 0.02, "p_2": 0.025, "p_3": 1.3e-5, "n": 0.09, "basal_glucose": 150.0}
    ...     near_rest = (90.0, 0.015, 25.0)
    ...     near_basal_mU_min = 27.0
    ...
    ...     def derivative(self, t_min, x, inputs):
    ...         c, (glucose, effect, insulin) = self.parameters, x
    ...         return jnp.stack([
    ...             c["p_1"] * (c["basal_glucose"] - glucose) - effect * glucose + inputs.meal_mg_min / 120.0,
    ...             -c["p_2"] * effect + c["p_3"] * insulin,
    ...             inputs.insulin_mU_min / 12.0 - c["n"] * insulin,
    ...         ])
    ...
    ...     def glucose_mg_dl(self, x):
    ...         return x[0]
    >>> person = Bergman.resting_at(90.0)
    >>> round(float(person.basal_insulin_mU_min), 3)
    27.692
    """

    near_rest: ClassVar[tuple[float, ...]]
    near_basal_mU_min: ClassVar[float]

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.rest = Rest(
            under=functools.partial(_under, cls),
            holding=lambda p, glucose_mg_dl: _holding(cls, p, glucose_mg_dl)[0],
            glucose_mg_dl=lambda p, x: cls._with(p).glucose_mg_dl(x),
            largest_mU_min=lambda p: _holding(cls, p, jnp.asarray(_LOWEST_MG_DL))[0],
            highest_mg_dl=lambda p: cls._with(p).glucose_mg_dl(_under(cls, p, jnp.asarray(0.0))),
            beyond="the equations have no steady state there",
        )

    @classmethod
    def _with(cls, parameters: Constants) -> Any:
        return cls._rebuilt({"parameters": parameters, "basal_insulin_mU_min": jnp.nan, "setpoint_mg_dl": jnp.nan})

    def rest_at(self, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Rate that holds a glucose, and the state there; NaN where no rate of 0 or more does."""
        result: tuple[jax.Array, jax.Array] = _holding(type(self), self.parameters, glucose_mg_dl)
        return result


_LOWEST_MG_DL: Final = 1.0


@jit(static_argnums=0)
def _under(kind: type[OdePatient], p: Constants, insulin_mU_min: jax.Array) -> jax.Array:
    """Steady state under a rate; NaN where none was found."""
    shape = shape_of_people(p, insulin_mU_min)
    insulin = jnp.broadcast_to(insulin_mU_min, shape)
    near, patient = _spread(kind.near_rest, shape), kind._with(p)
    x = _root(lambda x: _rates(kind, p, x, insulin), near)
    return jnp.where(patient.glucose_mg_dl(x) > _VANISHED * patient.glucose_mg_dl(near), x, jnp.nan)


@jit(static_argnums=0)
def _holding(kind: type[OdePatient], p: Constants, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Rate of 0 or more that holds a glucose, and the state there; NaN where there is none."""
    shape, patient = shape_of_people(p, glucose_mg_dl), kind._with(p)

    def residual(y: jax.Array) -> jax.Array:
        missed = patient.glucose_mg_dl(y[:-1]) - glucose_mg_dl
        return jnp.concatenate([_rates(kind, p, y[:-1], y[-1]), jnp.broadcast_to(missed, shape)[None]])

    result = _root(residual, _spread((*kind.near_rest, kind.near_basal_mU_min), shape), free=1)
    result = jnp.where(result[-1] >= -_STEADY * kind.near_basal_mU_min, result, jnp.nan)
    return jnp.maximum(result[-1], 0.0), result[:-1]


def _rates(kind: type[OdePatient], p: Constants, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
    inputs = inputs_of(insulin_mU_min, jnp.zeros_like(insulin_mU_min))
    return kind._with(p).derivative(jnp.zeros(()), x, inputs)  # type: ignore[no-any-return]


def _spread(values: tuple[float, ...], people: tuple[int, ...]) -> jax.Array:
    return jnp.broadcast_to(jnp.asarray(values, float).reshape(-1, *[1] * len(people)), (len(values), *people))


def _root(residual: Callable[[jax.Array], jax.Array], near: jax.Array, free: int = 0) -> jax.Array:
    """Zero of a function of ``(n, ...)`` numbers by Newton's method, from near it; NaN where it was not found.

    What is positive there stays positive, but for the last `free` numbers.
    """
    positive = (near > 0.0) & (jnp.arange(near.shape[0]) < near.shape[0] - free).reshape(-1, *[1] * (near.ndim - 1))
    units = jnp.eye(near.shape[0])

    def columns(linear: Callable[[jax.Array], jax.Array]) -> jax.Array:
        """Matrix of a linear function of what has the shape of `near`."""

        def column(unit: jax.Array) -> jax.Array:
            return linear(jnp.broadcast_to(unit.reshape(-1, *[1] * (near.ndim - 1)), near.shape))

        return jax.vmap(column, out_axes=1)(units)

    def jacobian(y: jax.Array) -> jax.Array:
        return columns(lambda tangent: jax.jvp(residual, (y,), (tangent,))[1])

    def solve_linear(linear: Callable[[jax.Array], jax.Array], b: jax.Array) -> jax.Array:
        A = columns(linear)
        inverse = columns(lambda unit: _solved(A, unit))
        return jnp.sum(inverse * b, axis=1)

    def one(carry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        y, before, number = carry
        on = before > _STILL  # who is there stays, however many steps others need
        change = -_solved(jacobian(y), residual(y))
        new = jnp.where(positive, jnp.maximum(y + change, _KEPT * y), y + change)
        size = jnp.abs(new) + jnp.abs(near)
        moved = jnp.abs(change) / jnp.where(size > 0.0, size, 1.0)  # the whole change: a kept state hides a miss
        return jnp.where(on, new, y), jnp.where(on, jnp.max(moved, axis=0), before), number + 1

    def goes_on(carry: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        _, moved, number = carry
        return jnp.any(moved > _STILL) & (number < _MAX_STEPS)

    def solve(_: Any, near: jax.Array) -> tuple[jax.Array, jax.Array]:
        y, moved, _ = jax.lax.while_loop(goes_on, one, (near, jnp.full(near.shape[1:], jnp.inf), jnp.asarray(0)))
        return y, moved

    # Derivatives, in either mode, are those of the zero and not of the steps towards it.
    y, moved = jax.lax.custom_root(residual, near, solve, solve_linear, has_aux=True)
    return jnp.where(moved <= _STEADY, y, jnp.nan)


def _solved(A: jax.Array, b: jax.Array) -> jax.Array:
    """Solution of ``A x = b``, ``(n, n, ...)`` and ``(n, ...)``, by elimination with pivots, for all people at once.

    Not LAPACK, whose batches in several threads wait for one another.
    """
    n = b.shape[0]
    table = jnp.concatenate([A, b[:, None]], axis=1)
    rows = jnp.arange(n).reshape(-1, *[1] * (b.ndim - 1))
    for k in range(n):
        pivot = jnp.argmax(jnp.where(rows >= k, jnp.abs(table[:, k]), -1.0), axis=0)
        chosen = jnp.take_along_axis(table, pivot[None, None], axis=0)[0]
        table = jnp.where((rows == pivot)[:, None], table[k][None], table)
        chosen = chosen / chosen[k]
        table = table - table[:, k][:, None] * chosen[None]
        table = table.at[k].set(chosen)
    return table[:, n]
