"""Distributions against SciPy's, and what they refuse."""

import math

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.patients import Variation

UNIFORM = (np.arange(4001) + 0.5) / 4001
CV = 0.2
SIGMA = math.sqrt(math.log(1.0 + CV**2))


def of(distribution, **keys):
    return Variation(parameter="F_LC", distribution=distribution, **keys)


@pytest.mark.parametrize(
    ("variation", "truth"),
    [
        (of("uniform", spread_pct=40.0), scipy.stats.uniform(0.24, 0.32)),
        (of("uniform", spread=0.1, centre=0.5), scipy.stats.uniform(0.4, 0.2)),
        (of("uniform", spread=0.1, lower=0.35), scipy.stats.uniform(0.35, 0.15)),
        (of("normal", spread_pct=20.0), scipy.stats.truncnorm(-3, 3, 0.4, 0.08)),
        (of("normal", spread=0.1, lower=0.3, upper=0.45), scipy.stats.truncnorm(-1, 0.5, 0.4, 0.1)),
    ],
)
def test_values_are_those_of_scipy(variation, truth):
    np.testing.assert_allclose(variation.around(0.4).values(UNIFORM), truth.ppf(UNIFORM), rtol=1e-11)


def test_lognormal_is_a_truncated_normal_of_the_logarithm():
    truth = 0.4 * np.exp(scipy.stats.truncnorm(-3, 3, 0, SIGMA).ppf(UNIFORM))
    values = of("lognormal", spread_pct=100 * CV).around(0.4).values(UNIFORM)
    np.testing.assert_allclose(values, truth, rtol=1e-11)
    assert np.median(values) == pytest.approx(0.4, rel=1e-3)
    assert values.std() / values.mean() == pytest.approx(CV, rel=0.03)  # truncation takes a little of it


@given(
    st.sampled_from(["uniform", "normal", "lognormal"]),
    st.floats(0.1, 100.0),
    st.floats(1e-3, 1e3),
    st.floats(0.0, 1.0, exclude_min=True, exclude_max=True),
)
def test_no_value_leaves_its_bounds(distribution, spread_pct, centre, uniform):
    of_it = of(distribution, spread_pct=spread_pct, centre=centre).around(0.0)
    value = of_it.values(np.array([uniform]))[0]
    assert of_it.lower <= value <= of_it.upper


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"distribution": "gamma", "spread": 1.0}, "unknown distribution 'gamma' of F_LC; the known ones are: uniform"),
        ({"distribution": "uniform"}, "needs one spread; give spread_pct"),
        ({"distribution": "uniform", "spread": 1.0, "spread_pct": 2.0}, "needs one spread"),
        ({"distribution": "lognormal", "spread": 1.0}, "give its coefficient of variation as spread_pct"),
        ({"distribution": "normal", "spread_pct": 0.0}, "spread_pct of F_LC is 0; give more than 0 and at most 1000"),
        ({"distribution": "normal", "spread_pct": math.nan}, "spread_pct of F_LC is nan"),
        ({"distribution": "normal", "spread": -1.0}, "spread of F_LC is -1; give a finite value above 0"),
        ({"distribution": "normal", "spread": math.inf}, "spread of F_LC is inf"),
        ({"distribution": "normal", "spread": 1.0, "centre": math.nan}, "centre of F_LC is nan; give a finite value"),
        ({"distribution": "normal", "spread": 1.0, "upper": math.inf}, "upper of F_LC is inf"),
    ],
)
def test_an_impossible_variation_is_refused(keys, told):
    with pytest.raises(ValueError, match=told):
        Variation(parameter="F_LC", **keys)


@pytest.mark.parametrize(
    ("variation", "nominal", "told"),
    [
        (of("uniform", spread_pct=40.0), 0.0, "varies about 0, of which a percentage is nothing; give spread instead"),
        (of("lognormal", spread_pct=40.0), -1.0, "lognormal about -1; give a centre above 0, or another distribution"),
        (of("uniform", spread=0.1, lower=0.6), 0.4, r"varies from 0\.3 to 0\.5, of which its bounds leave nothing"),
    ],
)
def test_a_distribution_that_cannot_be_made_is_refused(variation, nominal, told):
    with pytest.raises(ValueError, match=told):
        variation.around(nominal)
