"""The gut of Roy and Parker: its appearance against SciPy, and all that is eaten."""

import numpy as np
import pytest
import scipy.integrate
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.meals import Meal, RoyParkerGut, absorb, appearance_mg_min, eaten


@pytest.mark.long
@settings(max_examples=20)
@given(st.floats(1.0, 200.0), st.floats(1.0, 60.0), st.floats(0.0, 90.0), st.floats(1.0, 60.0), st.floats(0.01, 0.1))
def test_it_passes_on_all_that_is_eaten(carbs_g, rise, plateau, fall, rate):
    gut = RoyParkerGut(rise_min=rise, plateau_min=plateau, fall_min=fall, absorption_per_min=rate)
    absorbed = absorb(gut, eaten([Meal(carbs_g, 0.0)]))
    times = np.linspace(0.0, rise + plateau + fall + 30.0 / rate, 40_001)
    appearing = np.array([float(appearance_mg_min(t, absorbed)) for t in times[::2000]])
    assert np.all(appearing >= -1e-9 * appearing.max())  # four jumps of slope that cancel

    def emptying(t):
        peak = 2.0 * 1000.0 * carbs_g / (rise + 2.0 * plateau + fall)
        return peak * max(0.0, min(1.0, t / rise, (rise + plateau + fall - t) / fall))

    assert scipy.integrate.quad(emptying, 0.0, rise + plateau + fall, points=[rise, rise + plateau])[0] == (
        pytest.approx(1000.0 * carbs_g, rel=1e-6)
    )
    truth = scipy.integrate.solve_ivp(
        lambda t, q: [emptying(t) - rate * q[0]], (0.0, times[-1]), [0.0], t_eval=times[::2000], max_step=0.5, rtol=1e-8
    )
    np.testing.assert_allclose(appearing, rate * truth.y[0], atol=1e-3 * appearing.max())


def test_a_long_meal_empties_for_as_long_as_it_is_eaten():
    quick, slow = (absorb(RoyParkerGut(), eaten([Meal(50.0, 0.0, minutes)])) for minutes in (20.0, 90.0))
    assert float(appearance_mg_min(60.0, slow)) < float(appearance_mg_min(60.0, quick))
    assert float(slow.jumps.t_min[-1]) == 110.0
    assert float(quick.jumps.t_min[-1]) == 55.0
