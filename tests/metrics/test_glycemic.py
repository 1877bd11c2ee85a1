"""Times in range and indices against hand counts, NumPy and published values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from glucoloop.metrics import (
    coefficient_of_variation_pct,
    glucose_management_indicator_pct,
    glycemia_risk_index,
    risk_indices,
    time_above_pct,
    time_below_pct,
    time_between_pct,
)

TEN = np.array([40.0, 53.9, 54.0, 69.9, 70.0, 180.0, 180.1, 250.0, 250.1, 300.0])
COURSES = hnp.arrays(float, 40, elements=st.floats(1.0, 700.0))


def test_ranges_count_their_bounds_as_the_consensus_does():
    assert time_below_pct(TEN, 54.0) == 20.0
    assert time_below_pct(TEN, 70.0) == 40.0
    assert time_between_pct(TEN, 70.0, 180.0) == 20.0
    assert time_above_pct(TEN, 180.0) == 40.0
    assert time_above_pct(TEN, 250.0) == 20.0


def test_the_glycemia_risk_index_weighs_the_four_ranges():
    assert glycemia_risk_index(TEN) == 100.0  # 3.0 * 20 + 2.4 * 20 + 1.6 * 20 + 0.8 * 20 = 156, cut
    mild = np.concatenate([np.full(90, 120.0), np.full(4, 60.0), np.full(6, 200.0)])
    assert glycemia_risk_index(mild) == pytest.approx(2.4 * 4 + 0.8 * 6)


def test_the_glucose_management_indicator_is_as_published():
    # Bergenstal et al. 2018, Table 1
    means = np.array([100.0, 125.0, 150.0, 175.0, 200.0, 225.0, 250.0, 275.0, 300.0, 350.0])
    published = [5.7, 6.3, 6.9, 7.5, 8.1, 8.7, 9.3, 9.9, 10.5, 11.7]
    np.testing.assert_allclose(np.round(glucose_management_indicator_pct(means), 1), published, rtol=1e-12)


def test_the_risk_scale_is_symmetric_about_its_centre():
    assert risk_indices(np.full(5, 112.5)).lbgi == pytest.approx(0.0, abs=1e-3)
    assert risk_indices(np.full(5, 112.5)).hbgi == pytest.approx(0.0, abs=1e-3)
    assert risk_indices(np.full(5, 20.0)).lbgi == pytest.approx(100.0, abs=0.2)
    assert risk_indices(np.full(5, 600.0)).hbgi == pytest.approx(100.0, abs=0.2)


def test_risk_indices_agree_with_a_loop():
    glucose = np.random.default_rng(0).uniform(30.0, 400.0, 200)
    low = high = 0.0
    for value in glucose:
        f = 1.509 * (np.log(value) ** 1.084 - 5.381)
        low, high = low + (10 * f * f if f < 0 else 0.0), high + (10 * f * f if f > 0 else 0.0)
    found = risk_indices(glucose)
    assert found.lbgi == pytest.approx(low / 200)
    assert found.hbgi == pytest.approx(high / 200)


@pytest.mark.parametrize("glucose", [-50.0, 0.0, 0.5, 1e6])
def test_glucose_off_the_risk_scale_counts_as_its_end(glucose):
    found = risk_indices(np.full(3, glucose))
    assert found.lbgi + found.hbgi == pytest.approx(100.0, abs=0.2)


def test_variation_is_that_of_numpy():
    glucose = np.random.default_rng(0).uniform(60.0, 300.0, (50, 3))
    np.testing.assert_allclose(
        coefficient_of_variation_pct(glucose), 100 * np.std(glucose, axis=0, ddof=1) / np.mean(glucose, axis=0)
    )


@settings(deadline=None, max_examples=50)
@given(COURSES)
def test_the_ranges_make_a_hundred(glucose):
    parts = time_below_pct(glucose, 70.0), time_between_pct(glucose, 70.0, 180.0), time_above_pct(glucose, 180.0)
    assert sum(map(float, parts)) == pytest.approx(100.0, abs=1e-9)
    assert all(0.0 <= float(part) <= 100.0 for part in parts)


@settings(deadline=None, max_examples=50)
@given(COURSES)
def test_indices_keep_their_bounds_and_forget_the_order(glucose):
    risk, shuffled = risk_indices(glucose), risk_indices(glucose[::-1])
    assert 0.0 <= risk.lbgi <= 100.2
    assert 0.0 <= risk.hbgi <= 100.2
    assert 0.0 <= glycemia_risk_index(glucose) <= 100.0
    assert float(risk.lbgi) == pytest.approx(float(shuffled.lbgi), abs=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_has_no_measure(bad):
    glucose = np.array([[80.0, 80.0], [bad, 90.0], [300.0, 50.0]])
    for measure in (
        lambda g: time_below_pct(g, 70.0),
        lambda g: time_above_pct(g, 180.0),
        lambda g: time_between_pct(g, 70.0, 180.0),
        coefficient_of_variation_pct,
        glycemia_risk_index,
        lambda g: risk_indices(g).lbgi,
        lambda g: risk_indices(g).hbgi,
    ):
        sick, well = np.asarray(measure(glucose))
        assert np.isnan(sick)
        assert well == measure(glucose[:, 1])
