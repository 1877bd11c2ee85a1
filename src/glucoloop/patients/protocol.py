"""Protocol of a virtual patient in the simulation."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop._pytree import pytree


@pytree
class Inputs:
    """Inputs of a patient at one moment."""

    insulin_mU_min: jax.Array
    """Insulin infusion rate."""
    meal_mg_min: jax.Array
    """Rate at which glucose from meals appears in the gut's blood."""
    exercise_pct: jax.Array | npt.NDArray[np.float64] | float = 0.0
    """Oxygen uptake above that at rest, in percent of the largest; only a patient that `takes_exercise` reads it."""
    glucagon_ug_min: jax.Array | None = None
    """Glucagon infusion rate, or None without any; only a patient that `takes_glucagon` reads it."""


def inputs_of(
    insulin_mU_min: jax.Array,
    meal_mg_min: jax.Array,
    exercise_pct: jax.Array | None = None,
    glucagon_ug_min: jax.Array | None = None,
) -> Inputs:
    """Inputs of one person or of people, with exercise in the shape of insulin; without any it is a constant 0."""
    shape = jnp.shape(insulin_mU_min)
    exercise = np.zeros(shape) if exercise_pct is None else jnp.broadcast_to(exercise_pct, shape)
    return Inputs(
        insulin_mU_min=insulin_mU_min,
        meal_mg_min=meal_mg_min,
        exercise_pct=exercise,
        glucagon_ug_min=glucagon_ug_min,
    )


@runtime_checkable
class Patient(Protocol):
    """A virtual person: pure functions of a state vector, state axis first, people trailing.

    These members are required. Optional ones are in `patients.capabilities`.
    """

    @property
    def basal_insulin_mU_min(self) -> jax.Array:
        """Infusion rate that holds the setpoint."""

    @property
    def setpoint_mg_dl(self) -> jax.Array:
        """Glucose at steady state under the basal rate."""

    def steady_state(self, insulin_mU_min: jax.Array | float) -> jax.Array:
        """Steady state under a constant infusion; raises if none is physiological."""

    def insulin_for(self, glucose_mg_dl: jax.Array | float) -> jax.Array:
        """Infusion in mU/min that holds a glucose; raises if none does."""

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Rate of change of the state, per minute, at a time of day in minutes after the midnight before the start."""

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Concentration of the glucose that is to be controlled."""


@runtime_checkable
class SemilinearPatient(Patient, Protocol):
    """A patient in whom a driven block is linear, so that an exponential integrator can treat it exactly.

    The state is a slow block `y` and a driven block `z`::

        z' = A z + b u                   insulin: closed in itself and linear
        y' = T y + k(y, e(z), meal)      glucose: linear transport, and what is made and taken up

    where `e` are the effects of `z` on `y`, each a function of `z` alone, and glucose is linear in `y`.
    """

    def split(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Parts `(y, z)` of the state."""

    def join(self, y: jax.Array, z: jax.Array) -> jax.Array:
        """State from its parts `(y, z)`."""

    def working_state(self) -> jax.Array:
        """State about which the slow block is linearised, amid the states of a closed loop."""

    def stiff_couplings(self) -> npt.NDArray[np.bool_]:
        """Mask ``(n, n)`` of the fast entries of the slow block's Jacobian; others may go to the nonlinear part."""

    def driven_derivative(self, z: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Derivative z' of the driven block, linear in both arguments."""

    def effects(self, z: jax.Array) -> jax.Array:
        """Effects of the driven block on the slow one."""

    def transport(self, y: jax.Array) -> jax.Array:
        """Linear part ``T y`` of y'."""

    def kinetics(self, y: jax.Array, effects: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
        """Remaining part ``k(y, e, m)`` of y', linear in the meal."""
