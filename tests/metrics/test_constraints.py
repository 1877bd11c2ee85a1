"""The constraints (17) to (19) at, within and beyond their bounds."""

import numpy as np
import pytest

from glucoloop.pumps.limits import PARKER_1999_LIMITS as LIMITS
from glucoloop.pumps.limits import DoseLimits


@pytest.fixture
def after(measured):
    """Metrics of rates, with glucose at the setpoint."""

    def of_rates(insulin, **given):
        insulin = np.asarray(insulin)
        return measured(np.full((len(insulin) + 1, *insulin.shape[1:]), 80.0), insulin, **given)

    return of_rates


def test_the_first_change_is_from_the_rate_at_rest(after):
    found = after([22.0, 30.0, 10.0])  # from 20 mU/min on
    assert found.insulin_total_variation_mU_min == 2.0 + 8.0 + 20.0
    assert found.largest_change_mU_min == 20.0


@pytest.mark.parametrize(
    ("insulin", "satisfied"),
    [
        ([20.0, 36.7, 20.0], True),
        ([20.0, 36.8, 20.0], False),
        ([20.0, 3.3, 20.0], True),
        ([36.8, 36.8, 36.8], False),  # the very first move counts
        ([20.0, np.nan, 20.0], False),
    ],
)
def test_the_rate_is_limited(after, insulin, satisfied):
    assert bool(after(insulin).rate_satisfied) == satisfied


@pytest.mark.parametrize(
    ("insulin", "satisfied"),
    [([0.0, 66.9], True), ([0.0, 66.91], False), ([-0.01, 20.0], False), ([np.nan, 20.0], False)],
)
def test_the_magnitude_is_limited(after, insulin, satisfied):
    assert bool(after(insulin).magnitude_satisfied) == satisfied


def test_a_clipped_dose_satisfies_what_clipped_it(after):
    delivered = [np.float64(25.6060573442)]
    for wanted in np.random.default_rng(0).uniform(-300.0, 300.0, 500):
        delivered.append(LIMITS.clip(wanted, delivered[-1]))
    found = after(delivered[1:], basal=delivered[0])
    assert found.rate_satisfied
    assert found.magnitude_satisfied


def test_each_person_has_limits_of_their_own(after):
    limits = DoseLimits(max_change_mU_min=np.array([1.0, 10.0]), max_mU_min=np.array([50.0, 22.0]))
    found = after(np.array([[20.0, 20.0], [25.0, 25.0]]), limits=limits)
    np.testing.assert_array_equal(found.rate_satisfied, [False, True])
    np.testing.assert_array_equal(found.magnitude_satisfied, [True, False])


@pytest.mark.parametrize(
    ("glucose", "satisfied"),
    [([80.0, 60.0], True), ([80.0, 59.999], False), ([80.0, np.nan], False), ([80.0, np.inf], False)],
)
def test_glucose_stays_above_its_bound(measured, glucose, satisfied):
    assert bool(measured(glucose).glucose_satisfied) == satisfied


def test_another_bound_may_be_set(measured):
    assert measured([58.0, 58.0], lowest=54.0).glucose_satisfied
