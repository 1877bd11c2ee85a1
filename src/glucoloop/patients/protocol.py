"""What the simulation asks of a virtual patient."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import jax
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree


@pytree
class Inputs:
    """What enters a patient at one moment."""

    insulin_mU_min: jax.Array
    """Insulin infusion rate."""
    meal_mg_min: jax.Array
    """Rate at which glucose from meals appears in the gut's blood."""


@runtime_checkable
class Patient(Protocol):
    """A virtual person: pure functions of a state vector, state axis first, people trailing.

    This is what every patient has. What else one may tell of itself is in `patients.capabilities`.
    """

    @property
    def basal_insulin_mU_min(self) -> jax.Array:
        """Infusion rate that holds the setpoint."""
        ...

    @property
    def setpoint_mg_dl(self) -> jax.Array:
        """Glucose at the basal rate."""
        ...

    def steady_state(self, insulin_mU_min: jax.Array | float) -> jax.Array:
        """State at rest under a constant infusion; raises where none is physiological."""
        ...

    def insulin_for(self, glucose_mg_dl: jax.Array | float) -> jax.Array:
        """Infusion in mU/min that holds a glucose; raises where none does."""
        ...

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Rate of change of the state, per minute."""
        ...

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose concentration that is to be controlled."""
        ...


@runtime_checkable
class SemilinearPatient(Patient, Protocol):
    """A patient in whom a driven block is linear, so that an exponential integrator can treat it exactly.

    The state is a slow block `y` and a driven block `z`::

        z' = A z + b u                   insulin: closed in itself and linear
        y' = T y + k(y, e(z), meal)      glucose: linear transport, and what is made and taken up

    where `e` are the effects of `z` on `y`, each a function of `z` alone, and glucose is linear in `y`.
    """

    def split(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        """State to `(y, z)`."""
        ...

    def join(self, y: jax.Array, z: jax.Array) -> jax.Array:
        """`(y, z)` back to the state."""
        ...

    def working_state(self) -> jax.Array:
        """State about which the slow block is linearised: amid those that a closed loop passes through."""
        ...

    def stiff_couplings(self) -> npt.NDArray[np.bool_]:
        """``(n, n)``: entries of the slow block's Jacobian that are fast; others may be left to the nonlinear part."""
        ...

    def driven_derivative(self, z: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """z', linear in both arguments."""
        ...

    def effects(self, z: jax.Array) -> jax.Array:
        """What the driven block does to the slow one."""
        ...

    def transport(self, y: jax.Array) -> jax.Array:
        """``T y``: what of y' is linear."""
        ...

    def kinetics(self, y: jax.Array, effects: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
        """``k(y, e, m)``: the rest of y', linear in the meal."""
        ...
