"""People whose parameters vary together."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from glucoloop.patients import JointVariation, Population, Variation, draw

NAMES = ("S_IT", "S_ID", "S_IE")
MEDIAN = (51.2e-4, 8.2e-4, 520e-4)
COVARIANCE = ((0.09, 0.05, 0.02), (0.05, 0.16, -0.03), (0.02, -0.03, 0.04))


def joint(**keys):
    return JointVariation(**{"parameters": NAMES, "mean": MEDIAN, "covariance": COVARIANCE, "scale": "log", **keys})


def people(*variations):
    return Population("people", variations, "", "hovorka-2004")


@pytest.fixture(scope="module")
def by_numpy():
    """Standard deviations and vectors of logarithms about their mean, those beyond three deviations thrown away."""
    sd = np.sqrt(np.diag(COVARIANCE))
    vectors = np.random.default_rng(0).multivariate_normal(np.zeros(3), COVARIANCE, 200_000)
    return sd, vectors[(np.abs(vectors) <= 3.0 * sd).all(axis=1)].T


def test_logarithms_are_distributed_as_numpy_draws_them(by_numpy):
    sd, reference = by_numpy
    drawn = draw(people(joint()), 1, np.arange(20_000)).values
    logarithms = np.log(np.array([drawn[name] for name in NAMES]) / np.array(MEDIAN)[:, None])
    assert (np.abs(logarithms) <= (3.0 + 1e-9) * sd[:, None]).all()
    for row, others in zip(logarithms, reference, strict=True):
        assert scipy.stats.ks_2samp(row, others).pvalue > 1e-3
    # five standard errors of a covariance, of 20 000 people
    error = 5.0 * np.outer(sd, sd) * np.sqrt(2.0 / 20_000)
    assert (np.abs(np.cov(logarithms) - np.cov(reference)) < error).all()


def test_one_parameter_alone_is_a_truncated_normal():
    """Drawing again what lies beyond the bounds is the truncated distribution, whatever the number of attempts."""
    one = JointVariation(parameters=("k_e",), mean=(0.14,), covariance=((0.035**2,),), lower=(0.13,), upper=(0.2,))
    drawn = draw(people(one), 2, np.arange(5000)).values["k_e"]
    of = scipy.stats.truncnorm((0.13 - 0.14) / 0.035, (0.2 - 0.14) / 0.035, 0.14, 0.035)
    assert scipy.stats.kstest(drawn, of.cdf).pvalue > 1e-3
    assert drawn.min() >= 0.13
    assert drawn.max() <= 0.2


def test_a_person_is_the_same_whoever_else_is_drawn_and_whatever_else_varies():
    alone = draw(people(joint()), 3, [17]).values
    weight = Variation(parameter="weight_kg", distribution="uniform", spread_pct=20.0)
    among = draw(people(weight, joint()), 3, np.arange(40)).values
    assert all(np.array_equal(among[name][[17]], alone[name]) for name in NAMES)
    again = draw(people(weight), 3, np.arange(40)).values["weight_kg"]
    assert np.array_equal(again, among["weight_kg"])
    assert not np.array_equal(draw(people(joint()), 4, [17]).values["S_IT"], alone["S_IT"])


@given(arrays(float, (3, 3), elements=st.floats(-1.0, 1.0)))
def test_the_factor_is_that_of_lapack(root):
    """Any covariance that is far enough from singular has the factor that NumPy finds."""
    covariance = root @ root.T + 0.1 * np.eye(3)
    covariance = (covariance + covariance.T) / 2.0
    made = joint(covariance=tuple(map(tuple, covariance.tolist())))
    factor = np.array([[*row, *[0.0] * (3 - len(row))] for row in made.factor()])
    np.testing.assert_allclose(factor, np.linalg.cholesky(covariance), rtol=1e-9, atol=1e-12)


@given(st.floats(-3.0, 3.0))
def test_a_correlation_is_possible_within_one(correlation):
    def made():
        return JointVariation(parameters=("k_e", "V_I"), covariance=((1.0, correlation), (correlation, 1.0)))

    if abs(correlation) < 1.0 - 1e-9:
        made()
    elif abs(correlation) >= 1.0:
        with pytest.raises(ValueError, match=r"^the covariance is not positive definite: V_I would vary less than k_e"):
            made()


WRONG = [
    ({"parameters": ()}, "0 parameters cannot vary together; name 1 to 100"),
    ({"parameters": ("S_IT", "S_ID", "S_IT")}, "S_IT is varied twice; leave one out"),
    ({"scale": "cubic"}, "unknown scale 'cubic'; the known ones are: linear, log"),
    ({"mean": (1.0, 2.0)}, r"mean is \[1.0, 2.0\]; give a finite number for each of the 3 parameters"),
    ({"upper": (1.0, np.inf, 1.0)}, "upper is .*; give a finite number"),
    ({"covariance": ((1.0, 0.0), (0.0, 1.0))}, "the covariance of 3 parameters has 3 rows of 3 numbers; give as many"),
    ({"covariance": ((0.0, 0, 0), (0, 1, 0), (0, 0, 1))}, "the variance of S_IT is 0; give a finite value above 0"),
    (
        {"covariance": ((np.nan, 0, 0), (0, 1, 0), (0, 0, 1))},
        "the variance of S_IT is nan; give a finite value above 0",
    ),
    ({"covariance": ((1, 0.1, 0), (0.2, 1, 0), (0, 0, 1))}, "S_IT and S_ID is 0.1 in one place and 0.2 in another"),
    ({"covariance": ((1, np.nan, 0), (np.nan, 1, 0), (0, 0, 1))}, "make the matrix symmetric"),
    ({"covariance": ((1, 0.9, -0.9), (0.9, 1, 0.9), (-0.9, 0.9, 1))}, "not positive definite: S_IE would vary less"),
]


@pytest.mark.parametrize(("keys", "told"), WRONG)
def test_what_is_no_joint_distribution_is_refused(keys, told):
    with pytest.raises(ValueError, match=told):
        joint(**keys)


@pytest.mark.parametrize(
    ("variations", "told"),
    [
        ((joint(parameters=("S_IT", "S_ID", "S_XX")),), "unknown parameter 'S_XX'; the known ones are: weight_kg"),
        ((joint(), Variation(parameter="S_IT", distribution="uniform", spread_pct=5.0)), "S_IT is varied twice"),
        ((joint(scale="linear"),), "S_IT can vary from .* but must stay above 0; narrow its spread"),
        ((joint(mean=(-1.0, 1.0, 1.0)),), "S_IT varies on the scale log about -1; give a mean above 0"),
        ((joint(upper=(1e-9, 1.0, 1.0)),), "of which its bounds leave nothing; move lower or upper"),
    ],
)
def test_what_makes_no_people_is_refused(variations, told):
    with pytest.raises(ValueError, match=told):
        people(*variations)


def test_bounds_that_leave_next_to_nothing_are_refused_when_people_are_drawn():
    lower = tuple(median * np.exp(2.9 * sd) for median, sd in zip(MEDIAN, (0.3, 0.4, 0.2), strict=True))
    far = people(joint(lower=lower))
    with pytest.raises(ValueError, match="none of 1000 vectors of S_IT, S_ID, S_IE lies within the bounds; widen them"):
        draw(far, 0, [0])
