"""Comparison of the two forms of a semilinear patient: `derivative`, and the parts that the fast integrator takes.

Only `derivative` is told the time. A patient whose constants follow the clock would lose that without a word in the
fast integrator and in native code, and so would one of whose forms is wrong.
"""

from __future__ import annotations

import functools
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.arguments import at_once, is_traced
from glucoloop.patients.protocol import Inputs, Patient, SemilinearPatient
from glucoloop.refusal import Refusal
from glucoloop.simulation.parts import apart, compiled_by_class
from glucoloop.units import MIN_PER_DAY

_STATES: Final = 16
_ROUNDING: Final = 1e-6
"""Largest difference of two rates, as a share of the sizes of what they are made of."""


def refuse_two_patients(patient: SemilinearPatient) -> None:
    """Refuse a patient whose two forms differ at random states and times of a day."""
    found = _compared(patient)
    if found is None or not found[0]:
        return
    _, clock, message = found
    because = (
        "its derivative follows the time, of which transport, kinetics and driven_derivative are not told"
        if clock
        else "its derivative is not what transport, kinetics, effects and driven_derivative make"
    )
    raise Refusal(
        f"{type(patient).__name__} is another patient for the fast integrator and for native code than for the "
        f"adaptive one: {because}. {message}. Simulate one person with the adaptive integrator (--integrator adaptive, "
        "or integrator=Adaptive()), or make both forms the same"
    )


def follows_the_clock(patient: Patient) -> bool:
    """Whether the fast integrator would lose what a patient's derivative makes of the time."""
    found = _compared(patient) if isinstance(patient, SemilinearPatient) else None
    return found is not None and found[0] and found[1]


def _compared(patient: SemilinearPatient) -> tuple[bool, bool, str] | None:
    """Whether the forms differ, whether the derivative follows the time, and an example; None of a traced patient."""
    if is_traced(patient):
        return None
    return _of(_Content(patient))


class _Content:
    """A patient as the key of a cache, compared by its numbers."""

    def __init__(self, patient: SemilinearPatient) -> None:
        numbers, fixed = apart(patient)
        self.patient, self._key = patient, (fixed, *(np.asarray(number).tobytes() for number in numbers))

    def __hash__(self) -> int:
        return hash(self._key[1:])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Content) and self._key == other._key


@functools.lru_cache(maxsize=64)
def _of(content: _Content) -> tuple[bool, bool, str]:
    patient, rng = content.patient, np.random.default_rng(0)
    with at_once():
        work, basal = np.asarray(patient.working_state()), float(np.max(patient.basal_insulin_mU_min))
        x = work[None] * rng.uniform(0.7, 1.3, (_STATES, *work.shape))
        t_min = np.linspace(0.0, MIN_PER_DAY, _STATES, endpoint=False)
        insulin, meal = basal * rng.uniform(0.0, 3.0, _STATES), rng.uniform(0.0, 300.0, _STATES)
        told, split, size = (np.asarray(part) for part in _rates(patient, t_min, x, insulin, meal))
        at_midnight = np.asarray(_rates(patient, 0.0 * t_min, x, insulin, meal)[0])
    clock = bool(_differ(told, at_midnight, size).any())
    differ = _differ(told, split, size)
    if not differ.any():
        return False, clock, ""
    where, state = np.argwhere(differ)[0]
    return (
        True,
        clock,
        (
            f"At {t_min[where]:g} min after the start, the rate of state {state} of (slow, driven) is "
            f"{told[where, state]:.6g} per minute by the derivative and {split[where, state]:.6g} by the others"
        ),
    )


def _differ(a: npt.NDArray[Any], b: npt.NDArray[Any], size: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    found: npt.NDArray[np.bool_] = np.abs(a - b) > _ROUNDING * size
    return found


@compiled_by_class
@functools.partial(jax.vmap, in_axes=(None, 0, 0, 0, 0))
def _rates(
    patient: SemilinearPatient, t_min: jax.Array, x: jax.Array, insulin: jax.Array, meal: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Rates of slow and driven block by the derivative and by the parts, and the sizes of what they are made of."""
    derivative = patient.derivative(t_min, x, Inputs(insulin_mU_min=insulin, meal_mg_min=meal))
    _, told = jax.jvp(patient.split, (x,), (derivative,))
    y, z = patient.split(x)
    parts = patient.transport(y), patient.kinetics(y, patient.effects(z), meal)
    driven = patient.driven_derivative(z, insulin)
    size = jnp.concatenate([sum(map(jnp.abs, parts), start=jnp.abs(y) * 1e-3), jnp.abs(driven) + jnp.abs(z) * 1e-3])
    return jnp.concatenate(told), jnp.concatenate([parts[0] + parts[1], driven]), size
