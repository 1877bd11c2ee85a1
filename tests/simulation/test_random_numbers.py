"""Random numbers of people before their loop: by native code wherever a part of this package draws, or by JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build.surroundings import surroundings_of
from glucoloop.faults import FAULTS
from glucoloop.native.lower import lower
from glucoloop.native.targets import FUSED
from glucoloop.native.words import lower_drawing
from glucoloop.pumps import PUMPS
from glucoloop.pumps.protocol import deliver
from glucoloop.sensors import SENSORS
from glucoloop.simulation.engines import draws
from glucoloop.situations.situation import Situation, configured

KEY, INDEX = jax.random.key(3), jnp.zeros((), int)
PARTS = [
    *({"sensor": [name]} for name in SENSORS),
    *({"pump": name} for name in PUMPS),
    *({"faults": [name]} for name in FAULTS),
    {"sensor": ["dexcom-g6"], "faults": ["spikes, per_day=3", "missed-pulses", "occlusion, per_day=1"]},
]


def drawing_of(sensor, pump):
    """What a sensor and a pump draw at a sample."""

    def step(person, carry, own, shared, rng):
        del person, shared
        key = jax.random.fold_in(*rng)
        in_sensor, reading = sensor.read(carry[0], own, key)
        in_pump, delivery = deliver(pump, carry[1], own, key, None)
        return (in_sensor, in_pump), (reading.glucose_mg_dl, delivery.insulin_mU_min)

    number = jnp.asarray(100.0)
    return lower(step, (), (sensor.init(number, KEY), pump.init(number, KEY)), number, (), (KEY, INDEX)).drawing


@pytest.mark.long
def test_what_parts_of_this_package_draw_is_drawn_by_native_code():
    drawn = 0
    for keys in PARTS:
        around = surroundings_of(configured(Situation, keys))
        drawing = drawing_of(around.sensor, around.pump)
        drawn += bool(drawing.results)
        lower_drawing(drawing, KEY, INDEX)
    assert drawn >= 9


@pytest.mark.long
@pytest.mark.parametrize(
    "draw",
    [
        lambda key: (jax.random.uniform(key, (2,)), jax.random.normal(jax.random.split(key)[1])),
        lambda key: (1.0 * jax.random.randint(key, (2,), 0, 100), jax.random.bernoulli(key)),  # by JAX
    ],
    ids=["native", "jax"],
)
def test_each_person_has_the_numbers_of_an_own_key_and_sample(draw):
    def step(person, carry, own, shared, rng):
        del person, own, shared
        return carry, draw(jax.random.fold_in(*rng))

    drawing = lower(step, (), jnp.zeros(()), (), (), (KEY, INDEX)).drawing
    keys, first = jax.random.split(KEY, 5), np.array([0, 3, 3, 11, 2])
    found = draws(drawing, KEY, FUSED)(np.asarray(jax.random.key_data(keys)), first, 3)
    for person, key in enumerate(keys):
        for sample in range(3):
            alone = draw(jax.random.fold_in(key, int(first[person]) + sample))
            expected = np.concatenate([np.ravel(np.asarray(part, float)) for part in alone])
            np.testing.assert_allclose(np.sort(found[sample, :, person]), np.sort(expected), rtol=4e-15)


def test_where_nothing_is_drawn_there_is_nothing_to_draw():
    def step(person, carry, own, shared, rng):
        del person, own, shared, rng
        return carry + 1.0, carry

    assert draws(lower(step, (), jnp.zeros(()), (), (), (KEY, INDEX)).drawing, KEY, FUSED) is None
