"""Subcutaneous glucagon of the model of Wilinska et al. (2010), as the McGill Diabetes Lab has it.

Glucagon passes two depots with one time constant; plasma glucagon N follows from its clearance, and adds production by
the liver at once, whatever insulin does there::

    Z1' = u_N - Z1 / tau_N,   Z2' = (Z1 - Z2) / tau_N                   ug
    N = 1000 Z2 / (tau_N MCR_N W)                                       plasma glucagon, pg/ml
    EGP = EGP_0 (exp(-x3) + exp(-1 / (S_N N)))

The person's own glucagon is no part of it. Where the liver has no glycogen left, a person would respond less; the model
has an unlimited store.

References
----------
McGill Diabetes Lab, "Artificial Pancreas Simulator", 2020: the class HovorkaPatient, and its patientOriginal for the
constants.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.patients.component import Constant
from glucoloop.patients.hovorka.equations import GLUCOSE, INSULIN
from glucoloop.patients.hovorka.equations import derivative as of_insulin
from glucoloop.patients.hovorka.wilinska import CONSTANTS as OF_INSULIN
from glucoloop.patients.hovorka.wilinska import WilinskaParameters
from glucoloop.patients.protocol import Inputs
from glucoloop.units import PG_ML_PER_UG_L


@pytree
class GlucagonParameters(WilinskaParameters):
    """The constants of Wilinska et al. (2010) and those of glucagon."""

    tau_N: jax.Array | float
    """Time constant of each depot, min."""
    MCR_N: jax.Array | float
    """Clearance of glucagon, l/kg/min."""
    S_N: jax.Array | float
    """Sensitivity of production to glucagon, ml/pg."""


def plasma_pg_ml(p: GlucagonParameters, depots: jax.Array) -> jax.Array:
    """Plasma glucagon N of the depots Z1 and Z2 ``(2, ...)`` [ug]."""
    return PG_ML_PER_UG_L * depots[1] / (p.tau_N * p.MCR_N * p.weight_kg)


def production(p: GlucagonParameters, depots: jax.Array) -> jax.Array:
    """Production by the liver that glucagon adds, mmol/min."""
    action = p.S_N * plasma_pg_ml(p, depots)
    some = action > 0.0  # below, and in the derivative of the exponential, there is nothing to divide by
    return p.production_without_insulin * jnp.where(some, jnp.exp(-1.0 / jnp.where(some, action, 1.0)), 0.0)


def balances(p: GlucagonParameters, depots: jax.Array, glucagon_ug_min: jax.Array | None) -> jax.Array:
    """Rates of change of Z1 and Z2 ``(2, ...)`` per minute."""
    Z1, Z2 = depots
    leaving = Z1 / p.tau_N
    entering = -leaving if glucagon_ug_min is None else glucagon_ug_min - leaving
    return jnp.stack([entering, leaving - Z2 / p.tau_N])


def with_production(rates: jax.Array, production: jax.Array) -> jax.Array:
    """Rates of change of glucose ``(3, ...)`` with further production [mmol/min]."""
    return jnp.concatenate([(rates[0] + production)[None], rates[1:]])


def derivative(p: GlucagonParameters, x: jax.Array, inputs: Inputs) -> jax.Array:
    """Right-hand side, per minute, for a state ``(11, ...)``: that without glucagon, and Z1 and Z2."""
    state, depots = x[: INSULIN.stop], x[INSULIN.stop :]
    rates = of_insulin(p, state, inputs)
    glucose = with_production(rates[GLUCOSE], production(p, depots))
    return jnp.concatenate([glucose, rates[INSULIN], balances(p, depots, inputs.glucagon_ug_min)])


def without(x: jax.Array) -> jax.Array:
    """State ``(11, ...)`` from one without depots ``(9, ...)``, which are empty."""
    return jnp.concatenate([x, jnp.zeros_like(x[:2])])


MCGILL: Final = "McGill Diabetes Lab 2020, Artificial Pancreas Simulator, patientOriginal"

CONSTANTS: Final = (
    *OF_INSULIN,
    Constant("tau_N", 19.0, "min", "time to the maximum of glucagon absorption", MCGILL),
    Constant("MCR_N", 0.012, "l/kg/min", "clearance of glucagon", MCGILL),
    Constant("S_N", 0.0012, "ml/pg", "sensitivity of glucose production to glucagon", MCGILL),
)

MCGILL_2020: Final = GlucagonParameters(**{constant.name: constant.value for constant in CONSTANTS})
