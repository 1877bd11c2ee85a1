"""The constraints (17) to (19) at, within and beyond their bounds."""

import numpy as np
import pytest

from glucoloop.metrics import glucose_satisfied, insulin_changes, magnitude_satisfied, rate_satisfied
from glucoloop.pumps.limits import PARKER_1999_LIMITS as LIMITS
from glucoloop.pumps.limits import DoseLimits


def test_the_first_change_is_from_the_rate_at_rest():
    np.testing.assert_allclose(insulin_changes([22.0, 30.0, 10.0], 20.0), [2.0, 8.0, -20.0])


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
def test_the_rate_is_limited(insulin, satisfied):
    assert bool(rate_satisfied(insulin, 20.0, LIMITS)) == satisfied


@pytest.mark.parametrize(
    ("insulin", "satisfied"),
    [([0.0, 66.9], True), ([0.0, 66.91], False), ([-0.01, 20.0], False), ([np.nan, 20.0], False)],
)
def test_the_magnitude_is_limited(insulin, satisfied):
    assert bool(magnitude_satisfied(insulin, LIMITS)) == satisfied


def test_a_clipped_dose_satisfies_what_clipped_it():
    delivered = [np.float64(25.6060573442)]
    for wanted in np.random.default_rng(0).uniform(-300.0, 300.0, 500):
        delivered.append(LIMITS.clip(wanted, delivered[-1]))
    assert rate_satisfied(delivered[1:], delivered[0], LIMITS)
    assert magnitude_satisfied(delivered[1:], LIMITS)


def test_each_person_has_limits_of_their_own():
    limits = DoseLimits(max_change_mU_min=np.array([1.0, 10.0]), max_mU_min=np.array([50.0, 22.0]))
    insulin = np.array([[20.0, 20.0], [25.0, 25.0]])
    np.testing.assert_array_equal(rate_satisfied(insulin, 20.0, limits), [False, True])
    np.testing.assert_array_equal(magnitude_satisfied(insulin, limits), [True, False])


@pytest.mark.parametrize(
    ("glucose", "satisfied"),
    [([80.0, 60.0], True), ([80.0, 59.999], False), ([80.0, np.nan], False), ([80.0, np.inf], False)],
)
def test_glucose_stays_above_its_bound(glucose, satisfied):
    assert bool(glucose_satisfied(glucose)) == satisfied


def test_another_bound_may_be_set():
    assert glucose_satisfied([58.0], 54.0)
