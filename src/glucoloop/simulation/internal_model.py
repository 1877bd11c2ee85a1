"""Internal models of a patient for a controller: linear or nonlinear, about the operating point."""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp

from glucoloop._pytree import pytree, static
from glucoloop._representation import represented
from glucoloop.arguments import checked, on_host
from glucoloop.meals import fasting
from glucoloop.meals.moments import moments_of_steps
from glucoloop.models.sensor_lag import linear_behind_lag
from glucoloop.models.state_space import LinearModel, discretise, linearise
from glucoloop.patients.capabilities import rest_at
from glucoloop.patients.protocol import Patient, inputs_of
from glucoloop.refusal import Refusal
from glucoloop.simulation.explicit import Explicit
from glucoloop.simulation.exponential import Exponential, ExponentialPlant
from glucoloop.simulation.plant import Exogenous, Plant, SampleGrid
from glucoloop.simulation.user_objects import goes_fast


@functools.partial(jax.jit, static_argnames=("sample_time_min", "sensor_lag_min"))
def linear_model_at(
    patient: Patient, x: jax.Array, insulin_mU_min: jax.Array, sample_time_min: float, sensor_lag_min: float = 0.0
) -> LinearModel:
    """Linearisation at a state and a rate; JAX can trace it, and map it over people."""

    def derivative(x: jax.Array, u: jax.Array, meal: jax.Array) -> jax.Array:
        return patient.derivative(jnp.zeros(()), x, inputs_of(u, meal))

    model = linearise(derivative, patient.glucose_mg_dl, x, insulin_mU_min, jnp.zeros(()))
    return discretise(linear_behind_lag(model, sensor_lag_min) if sensor_lag_min else model, sample_time_min)


@checked
@on_host("the model is checked number by number")
def linear_model(
    patient: Patient,
    *,
    insulin_mU_min: float | None = None,
    sample_time_min: float = 5.0,
    setpoint_mg_dl: float | None = None,
    sensor_lag_min: float = 0.0,
) -> LinearModel:
    """Exact linearisation at a steady state, sampled with a zero-order hold; the disturbance is the meal, mg/min.

    Parameters
    ----------
    insulin_mU_min : float, optional
        Infusion of the operating point; the basal rate by default.
    setpoint_mg_dl : float, optional
        Glucose at which the model rests, in place of the infusion.
    sensor_lag_min : float
        First-order lag of the sensor, whose reading is one more state then; 0: it reads glucose.

    Raises
    ------
    ValueError
        If the patient has no steady state under the infusion, no infusion holds the setpoint, both are given, the
        sample time is not positive, or the lag is negative or not finite.
    """
    if insulin_mU_min is not None and setpoint_mg_dl is not None:
        raise Refusal("an infusion and a setpoint were given, of which each tells where the model rests; give one")
    if insulin_mU_min is None:
        insulin, state = _at_rest(patient, setpoint_mg_dl)
    else:
        insulin = jnp.asarray(insulin_mU_min, float)
        state = patient.steady_state(insulin)
    model: LinearModel = linear_model_at(patient, state, insulin, sample_time_min, sensor_lag_min)
    return model


def _at_rest(patient: Patient, setpoint_mg_dl: float | None) -> tuple[jax.Array, jax.Array]:
    """Rate and steady state: of the basal operating point, or where glucose is at a setpoint."""
    insulin = patient.basal_insulin_mU_min
    state = patient.steady_state(insulin)
    if setpoint_mg_dl is not None and setpoint_mg_dl != patient.glucose_mg_dl(state):
        insulin, state = rest_at(patient, jnp.asarray(setpoint_mg_dl, float))
        if not jnp.isfinite(insulin):
            raise Refusal(
                f"no infusion holds the patient at {setpoint_mg_dl:g} mg/dl, so that no model rests there; "
                "choose a setpoint nearer to the patient's own"
            )
    return insulin, state


@represented
@pytree
class InternalModel:
    """Internal model of a patient for a controller; implements `models.nonlinear.FedModel`."""

    plant: Plant
    state: jax.Array
    insulin_mU_min: jax.Array
    sample_time_min: float = static()
    steps: int = static(default=1)
    """Steps of the integrator in a sample."""

    def roughly(self) -> InternalModel:
        """The same model with rough steps where its integrator has them."""
        if not isinstance(self.plant, ExponentialPlant):
            return self
        return dataclasses.replace(self, plant=self.plant.roughly())

    def derivative(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """Rate of change of the patient's state without a meal."""
        none = jnp.zeros_like(insulin_mU_min)
        return self.plant.patient.derivative(none, x, inputs_of(insulin_mU_min, none))

    def advance(self, x: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        """State after one sample, without a meal."""
        return self.advance_fed(x, insulin_mU_min, jnp.zeros((3, *jnp.shape(insulin_mU_min))))

    def advance_fed(self, x: jax.Array, insulin_mU_min: jax.Array, appearance_mg_min: jax.Array) -> jax.Array:
        """State after one sample, with the appearance of a meal."""
        moments = moments_of_steps(appearance_mg_min[None], self.steps)
        return self.plant.advance(x, insulin_mU_min, Exogenous(t_min=jnp.zeros(()), moments=moments))[0]

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose of a state by the patient's equations."""
        return self.plant.patient.glucose_mg_dl(x)


@checked
@on_host("its integrator is made with SciPy")
def nonlinear_model(
    patient: Patient, *, sample_time_min: float = 5.0, setpoint_mg_dl: float | None = None
) -> InternalModel:
    """A patient as an internal model at steady state.

    Parameters
    ----------
    setpoint_mg_dl : float, optional
        Glucose at which the model rests; by default that of the basal operating point.

    Raises
    ------
    ValueError
        For a sample time that is not positive, or a setpoint that no infusion holds.
    """
    integrator = Exponential(substeps=1, near_rest=True) if goes_fast(patient) else Explicit()
    grid = SampleGrid(sample_time_min=sample_time_min, samples=1)
    plant, outside = integrator.prepare(patient, fasting(), grid)
    assert outside.moments is not None
    insulin, state = _at_rest(patient, setpoint_mg_dl)
    return InternalModel(
        plant=plant,
        state=state,
        insulin_mU_min=insulin,
        sample_time_min=sample_time_min,
        steps=outside.moments.shape[1],
    )
