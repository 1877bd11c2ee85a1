"""An infusion set: how much is lost over its wear, and that a new one loses nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.pumps import InfusionSet, LimitedPump, dose_limits
from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured

KEY = jax.random.key(4)
FREE = LimitedPump(limits=dose_limits(max_change_mU_min=1000.0, max_mU_min=1000.0))


def delivered(pump, samples, rate=20.0, bolus=1000.0, people=()):
    """Rates and boluses that reach the person, of a rate and a bolus that are asked for at each sample."""

    def one(state, _):
        state, delivery = pump.deliver(state, jnp.full(people, rate), KEY, jnp.full(people, bolus))
        return state, delivery

    start = pump.init(jnp.full(people, rate), KEY)
    return jax.lax.scan(one, start, None, length=samples)[1]


def test_the_loss_grows_evenly_after_the_sound_days_and_ends_with_the_change():
    pump = InfusionSet(1440.0, 720.0, 30.0, 0.0, inner=FREE)
    found = delivered(pump, 2 * 288 + 3)
    age = np.arange(2 * 288 + 3) % 288
    share = 1.0 - 0.3 * np.maximum(age - 144, 0) / 144
    np.testing.assert_allclose(found.insulin_mU_min, 20.0 * share, rtol=1e-12)
    np.testing.assert_allclose(found.bolus_mU, 1000.0 * share, rtol=1e-12)
    np.testing.assert_array_equal(found.reported_mU_min, 20.0)
    np.testing.assert_array_equal(found.reported_bolus_mU, 1000.0)


def test_without_a_loss_it_is_the_inner_pump():
    with_set, without = delivered(InfusionSet(loss_pct=0.0, inner=FREE), 50), delivered(FREE, 50)
    np.testing.assert_array_equal(with_set.insulin_mU_min, without.insulin_mU_min)
    np.testing.assert_array_equal(with_set.bolus_mU, without.bolus_mU)


def test_people_begin_on_any_day_of_the_wear():
    pump = InfusionSet(1440.0, 0.0, 100.0, None, inner=FREE)
    first = np.asarray(delivered(pump, 1, people=(4000,)).insulin_mU_min)[0] / 20.0
    np.testing.assert_allclose(np.quantile(first, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.03)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(
    st.floats(1.0, 20_000.0),
    st.floats(0.0, 1.0, exclude_max=True),
    st.floats(0.0, 100.0),
    st.none() | st.floats(0.0, 1.0, exclude_max=True),
    st.sampled_from([0.5, 1.0, 5.0, 15.0]),
)
def test_no_more_than_the_command_and_no_less_than_the_loss_arrives(wear, sound, loss, worn, sample_time_min):
    pump = InfusionSet(
        wear, sound * wear, loss, None if worn is None else worn * wear, inner=FREE, sample_time_min=sample_time_min
    )
    share = np.asarray(delivered(pump, 60).insulin_mU_min) / 20.0
    assert share.max() <= 1.0 + 1e-12
    assert share.min() >= 1.0 - loss / 100.0 - 1e-12


def test_it_is_a_pump_of_every_command():
    run = configured(Run, patient="hovorka-2004", pump="infusion-set, wear=2d, sound=1d, loss=50")
    assert (run.pump.wear_min, run.pump.sound_min, run.pump.loss_pct) == (2880.0, 1440.0, 50.0)
    with pytest.raises(Refusal, match=r"sound_min is 5000 min, but the set is changed after 4320 min"):
        configured(Run, pump="infusion-set, sound_min=5000")
