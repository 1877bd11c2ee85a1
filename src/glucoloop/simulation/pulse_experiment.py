"""Pulse experiment of the paper on many people at once: records for the identification of individual models."""

from __future__ import annotations

from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.patients.capabilities import seen_mg_dl
from glucoloop.patients.protocol import Patient
from glucoloop.sensors import Sensor
from glucoloop.sensors.protocol import site_of
from glucoloop.simulation.engines import make_engine
from glucoloop.simulation.integrators import plants_of_people
from glucoloop.simulation.per_person_leaves import chosen, replaced
from glucoloop.simulation.plant import Exogenous, SampleGrid

Floats = npt.NDArray[np.float64]

SUBSTEPS: Final = 8
"""Number of substeps of a sample, as in `excite`, since pulses change insulin by much."""


class PulseExperiment:
    """Readings of fasting people under a sequence of infusion rates from steady state on; patients as for `Cohort`."""

    def __init__(self, nominal: Patient, varied: Patient, sensor: Sensor, *, sample_time_min: float) -> None:
        grid = SampleGrid(sample_time_min=sample_time_min, samples=1)
        self._plants, self._sensor = plants_of_people(nominal, varied, grid, SUBSTEPS), sensor
        self._sample_time_min = sample_time_min
        self._fasting = jnp.zeros((self._plants.substeps, 3))
        self._begin_people = jax.jit(jax.vmap(self._begin, in_axes=(-1, 0), out_axes=(-1, 0)))
        x = nominal.steady_state(nominal.basal_insulin_mU_min)
        carry, key = self._begin(x, jax.random.key(0))
        self._engine = make_engine(
            self._step,
            chosen(self._plants.single, self._plants.varies),
            carry,
            jnp.zeros(()),
            jnp.zeros(()),
            key,
            name=None,
            precision="float64",
        )

    def _begin(self, x: jax.Array, key: jax.Array) -> tuple[Any, jax.Array]:
        sensor_key, reading_key = jax.random.split(key)
        glucose = seen_mg_dl(self._plants.single.patient, x, site_of(self._sensor))
        return (x, self._sensor.init(glucose, sensor_key)), reading_key

    def _step(self, values: Any, carry: Any, insulin: Any, shared: Any, rng: Any) -> tuple[Any, jax.Array]:
        (x, in_sensor), (key, index) = carry, rng
        plant = replaced(self._plants.single, self._plants.varies, values)
        glucose = seen_mg_dl(plant.patient, x, site_of(self._sensor))
        in_sensor, reading = self._sensor.read(in_sensor, glucose, jax.random.fold_in(key, index))
        x, _ = plant.advance(x, insulin, Exogenous(t_min=shared, moments=self._fasting))
        return (x, in_sensor), jnp.where(reading.valid, reading.glucose_mg_dl, jnp.nan)

    def run(self, patient: Patient, x: Floats, insulin_mU_min: Floats, key: jax.Array) -> Floats:
        """Readings ``(samples + 1, people)``, as `excite` gives them for one person.

        The people rest in the states `x`, ``(states, people)``; each rate ``(samples, people)`` is held over one
        sample.
        """
        carry, keys = self._begin_people(jnp.asarray(x), key)
        rates = np.concatenate([insulin_mU_min, insulin_mU_min[-1:]])  # what follows the last reading is not looked at
        times = self._sample_time_min * np.arange(rates.shape[0])
        values = chosen(self._plants.of(patient), self._plants.varies)
        _, readings = self._engine.run(values, carry, rates, times, keys)
        return np.asarray(readings, np.float64)
