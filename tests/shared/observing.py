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
