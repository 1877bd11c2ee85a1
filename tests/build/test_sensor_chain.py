"""A sensor without another one inside is the innermost of a chain; an ideal part before it only names the site."""

from dataclasses import dataclass

import jax.numpy as jnp
import pytest

from glucoloop.build.surroundings import sensor_of
from glucoloop.sensors import IdealSensor, Lag, Reading, SensorComponent, WhiteNoise
from glucoloop.situations.situation import Situation


@dataclass(frozen=True)
class Alone:
    site: str | None

    def init(self, glucose_mg_dl, key):
        return ()

    def read(self, state, glucose_mg_dl, key):
        return state, Reading(glucose_mg_dl=glucose_mg_dl, valid=jnp.isfinite(glucose_mg_dl))


class AlonePart(SensorComponent, name="alone"):
    """A sensor that has no other inside."""

    def made(self, *, site=None, **known):
        return Alone(site)


def test_it_is_put_at_the_site_that_an_ideal_part_names():
    chain = IdealSensor(site="interstitial"), AlonePart(), Lag(lag_min=8.0)
    sensor = sensor_of(Situation(sensor=chain))
    assert sensor.inner == Alone("interstitial")


def test_it_is_refused_around_another():
    with pytest.raises(ValueError, match="the sensor alone has no other one inside; give it first"):
        sensor_of(Situation(sensor=(WhiteNoise(), AlonePart())))
