"""Times in range and indices against hand counts, NumPy and published values."""

import numpy as np
import pytest

TEN = np.array([40.0, 53.9, 54.0, 69.9, 70.0, 180.0, 180.1, 250.0, 250.1, 300.0])


@pytest.mark.long
def test_ranges_count_their_bounds_as_the_consensus_does(measured):
    found = measured(TEN)
    assert found.time_below_54_pct == 20.0
    assert found.time_below_70_pct == 40.0
    assert found.time_70_180_pct == 20.0
    assert found.time_above_180_pct == 40.0
    assert found.time_above_250_pct == 20.0


def test_the_glycemia_risk_index_weighs_the_four_ranges(measured):
    assert measured(TEN).gri == 100.0  # 3.0 * 20 + 2.4 * 20 + 1.6 * 20 + 0.8 * 20 = 156, cut
    mild = np.concatenate([np.full(90, 120.0), np.full(4, 60.0), np.full(6, 200.0)])
    assert measured(mild).gri == pytest.approx(2.4 * 4 + 0.8 * 6)


def test_the_glucose_management_indicator_is_as_published(measured):
    # Bergenstal et al. 2018, Table 1
    means = np.array([100.0, 125.0, 150.0, 175.0, 200.0, 225.0, 250.0, 275.0, 300.0, 350.0])
    published = [5.7, 6.3, 6.9, 7.5, 8.1, 8.7, 9.3, 9.9, 10.5, 11.7]
    found = measured(np.tile(means, (2, 1))).gmi_pct
    np.testing.assert_allclose(np.round(found, 1), published, rtol=1e-12)


def test_the_risk_scale_is_symmetric_about_its_centre(measured):
    found = measured(np.tile([112.5, 20.0, 600.0], (2, 1)))
    np.testing.assert_allclose(found.lbgi, [0.0, 100.0, 0.0], atol=0.2)
    np.testing.assert_allclose(found.hbgi, [0.0, 0.0, 100.0], atol=0.2)


def test_glucose_off_the_risk_scale_counts_as_its_end(measured):
    found = measured(np.tile([-50.0, 0.0, 0.5, 1e6], (2, 1)))
    np.testing.assert_allclose(found.lbgi + found.hbgi, 100.0, atol=0.2)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_has_no_measure(measured, bad):
    found = measured(np.array([[80.0, 80.0], [bad, 90.0], [300.0, 50.0]]))
    alone = measured(np.array([80.0, 90.0, 50.0]))
    names = ("time_below_70_pct", "time_above_180_pct", "time_70_180_pct", "cv_pct", "gri", "lbgi", "hbgi")
    for name in names:
        sick, well = np.asarray(getattr(found, name))
        assert np.isnan(sick), name
        assert well == pytest.approx(float(getattr(alone, name)), abs=1e-12)
