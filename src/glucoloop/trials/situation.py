"""What surrounds a controller, made of plain numbers: sensor, pump, and the keys of chance."""

from __future__ import annotations

from typing import Final

import jax

from glucoloop.pumps import DoseLimits, LimitedPump, Pump, with_resolution
from glucoloop.sensors import IdealSensor, Sensor, dead_time, white_noise

# Far from the small numbers by which the loop splits its key, so that the record's noise is not the loop's.
_RECORD: Final = 0x4D4F444C
_PEOPLE: Final = 0x50454F50


def sensor_of(noise_variance: float, bound_mg_dl: float, dead_time_samples: int) -> Sensor:
    """Sensor with noise, dead time, both or neither."""
    inner: Sensor = IdealSensor()
    if noise_variance > 0.0:
        inner = white_noise(noise_variance, bound_mg_dl, inner)
    return dead_time(dead_time_samples, inner) if dead_time_samples else inner


def pump_of(limits: DoseLimits, resolution_mU_min: float | None) -> Pump:
    """Pump with limits, and with a smallest step of its rate if one is given."""
    pump = LimitedPump(limits=limits)
    return pump if resolution_mU_min is None else with_resolution(resolution_mU_min, pump)


def record_key(seed: int | jax.Array) -> jax.Array:
    """Key of the record that a model is identified from; the loop's own is the seed's."""
    key: jax.Array = jax.random.fold_in(jax.random.key(seed), _RECORD)
    return key


@jax.jit
def keys_of_records(seed: jax.Array, person: jax.Array) -> jax.Array:
    """Key of the record that each person's own model is identified from, ``(people,)``."""
    keys: jax.Array = jax.vmap(lambda number: jax.random.fold_in(record_key(seed), number))(person)
    return keys


@jax.jit
def keys_of_people(seed: jax.Array, person: jax.Array) -> jax.Array:
    """Key of each person's loop, ``(people,)``: of a seed and his number alone."""
    root = jax.random.fold_in(jax.random.key(seed), _PEOPLE)
    keys: jax.Array = jax.vmap(lambda number: jax.random.fold_in(root, number))(person)
    return keys
