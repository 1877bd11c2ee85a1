"""The tuning of the controllers that estimate states, and the paper's tunings as printed or as read."""

import numpy as np
import pytest

from glucoloop.control import MPCTuning, StateTuning
from glucoloop.control.imc import IMC
from glucoloop.control.mpc_se import MPCSE
from glucoloop.control.nlqdmc_se import NLQDMC
from glucoloop.control.tuning import PARKER_1999
from glucoloop.patients import patient
from glucoloop.patients.capabilities import process_noise


def test_the_reference_goes_to_the_setpoint_by_the_filter():
    tuning = StateTuning(2, 4, reference_filter=0.5, reference_start=0)
    np.testing.assert_allclose(tuning.reference_factors(), [0.5, 0.25, 0.125, 0.0625])
    late = StateTuning(2, 4, reference_filter=0.5, reference_start=1)
    np.testing.assert_allclose(late.reference_factors(), [1.0, 0.5, 0.25, 0.125])


def test_without_a_filter_the_setpoint_is_asked_for_at_once():
    np.testing.assert_array_equal(StateTuning(1, 3, reference_filter=0.0, reference_start=0).reference_factors(), 0.0)
    # sample s is where the reference still is: 0^0 = 1
    np.testing.assert_array_equal(StateTuning(1, 3, reference_filter=0.0).reference_factors(), [1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"move_horizon": 0}, r"move_horizon is 0; give a whole number from 1 to 50"),
        ({"move_horizon": 51, "prediction_horizon": 60}, r"move_horizon is 51; give a whole number from 1 to 50"),
        ({"move_horizon": 1.5}, r"move_horizon is 1.5, a float; give a whole number"),
        ({"move_horizon": True}, r"move_horizon is True, a bool; give a whole number"),
        ({"move_horizon": np.nan}, r"move_horizon is nan, a float; give a whole number"),
        ({"prediction_horizon": 1}, r"prediction horizon of 1 .* move horizon of 2; give a whole number from 2 to 288"),
        ({"prediction_horizon": 7.5}, r"prediction_horizon is 7.5, a float; give a whole number"),
        ({"prediction_horizon": 289}, r"prediction_horizon is 289; give"),
        ({"output_weight": 0.0}, r"output_weight is 0; give a finite number above 0"),
        ({"output_weight": np.inf}, r"output_weight is inf; give"),
        ({"move_weight": -1.0}, r"move_weight is -1; give a finite number of 0 or more"),
        ({"move_weight": np.nan}, r"move_weight is nan; give"),
        ({"reference_filter": 1.0}, r"reference_filter is 1; give a number of 0 or more and below 1"),
        ({"reference_filter": -0.1}, r"reference_filter is -0.1; give"),
        ({"reference_filter": np.nan}, r"reference_filter is nan; give"),
        ({"reference_start": 2}, r"reference_start is 2; give a whole number from 0 to 1"),
        ({"reference_start": 0.5}, r"reference_start is 0.5, a float; give a whole number"),
    ],
)
def test_a_tuning_out_of_bounds_is_refused(changed, sentence):
    with pytest.raises(ValueError, match=sentence):
        StateTuning(**{"move_horizon": 2, "prediction_horizon": 8, **changed})


def test_horizons_counted_by_numpy_are_whole_numbers_too():
    assert MPCTuning(np.int64(2), np.int32(8)) == MPCTuning(2, 8)


def test_what_the_paper_prints():
    for point in ("setpoint-81", "nominal-22"):
        quiet, noisy = PARKER_1999[point, False], PARKER_1999[point, True]
        assert quiet.mpc == MPCTuning(2, 8, 1.0, 0.0)
        assert noisy.mpc == MPCTuning(2, 10, 3.0, 1.0)
        start = 1 if point == "setpoint-81" else 0
        assert quiet.mpc_se == StateTuning(2, 7, 1.0, 0.0, 0.65, start)
        assert noisy.mpc_se == StateTuning(2, 8, 1.0, 1.0, 0.65, start)
        assert quiet.nlqdmc_se == StateTuning(2, 5, 1.0, 0.0, 0.57, start)
    assert MPCSE().measurement_variance == NLQDMC().measurement_variance == 1.45
    assert (IMC().filter_min, IMC().delay_min) == (1.0, 5.0)


@pytest.mark.parametrize(
    ("point", "noisy", "glucose", "other", "glucagon"),
    [
        ("setpoint-81", False, 30.0, 0.1, 10.0),
        ("setpoint-81", True, 0.9, 0.01, 0.005),
        ("nominal-22", False, 10.0, 0.01, 0.1),
        ("nominal-22", True, 0.9, 0.01, 0.003),
    ],
)
def test_the_process_noise_is_that_of_glucose_insulin_and_glucagon(point, noisy, glucose, other, glucagon):
    expected = [glucose] * 8 + [other] * 9 + [glucagon] * 2
    np.testing.assert_array_equal(process_noise(patient(), *PARKER_1999[point, noisy].noise), expected)
    if noisy:
        assert max(expected) < 1.0  # as the paper says
