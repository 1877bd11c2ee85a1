"""Observations as a test gives them to a controller."""

import jax.numpy as jnp

from glucoloop.control import Observation


def observing(setpoint, delivered=None):
    """Function that makes an observation of glucose, delivered insulin, setpoint and validity, with these defaults."""
    usual_setpoint, usual_delivered = setpoint, delivered

    def observe(glucose, delivered=usual_delivered, setpoint=usual_setpoint, valid=True):
        return Observation(
            glucose_mg_dl=jnp.asarray(glucose, float),
            valid=jnp.asarray(valid),
            setpoint_mg_dl=jnp.asarray(setpoint, float),
            delivered_mU_min=jnp.asarray(delivered, float),
            announced_carbs_g=jnp.asarray(0.0),
        )

    return observe


def observing_meals(setpoint, basal):
    """Function that makes an observation with a meal and a delivered bolus beside glucose and the delivered rate."""

    def observe(glucose=120.0, *, carbs_g=0.0, delivered=basal, bolus_mU=0.0, valid=None):
        numbers = (glucose, setpoint, delivered, carbs_g, bolus_mU)
        glucose, at, delivered, carbs, bolus = (jnp.asarray(number, float) for number in numbers)
        return Observation(
            glucose_mg_dl=glucose,
            valid=jnp.isfinite(glucose) if valid is None else jnp.asarray(valid),
            setpoint_mg_dl=at,
            delivered_mU_min=delivered,
            announced_carbs_g=carbs,
            delivered_bolus_mU=bolus,
        )

    return observe
