"""The prior of a twin: the population on the scale of logarithms, given what is known."""

import math

import numpy as np
import pytest

from glucoloop.patients.population import Population, population
from glucoloop.patients.variation import JointVariation, Variation
from glucoloop.refusal import Refusal
from glucoloop.twins import prior_of

PATIENT = "hovorka-2004"


def test_independent_lognormal_parameters_keep_their_median_and_spread():
    prior = prior_of(population("lognormal", patient="uva-padova-2008"))
    scale = {name: math.sqrt(math.log1p(0.2**2)) for name in prior.parameters} | {
        "weight_kg": math.sqrt(math.log1p(0.15**2))
    }
    within_3_sd = math.sqrt(0.97334)  # variance of a normal distribution that is cut at three standard deviations
    assert prior.sd == pytest.approx([within_3_sd * scale[name] for name in prior.parameters], rel=0.03)
    correlation = prior.covariance / np.outer(prior.sd, prior.sd)
    assert np.abs(correlation - np.eye(prior.sd.size)).max() < 0.07


def test_what_is_known_moves_what_goes_with_it():
    joint = JointVariation(
        parameters=("weight_kg", "EGP_0"), mean=(75.0, 0.016), covariance=((0.01, 0.008), (0.008, 0.01)), scale="log"
    )
    people = Population("both", (joint,), patient=PATIENT)
    prior = prior_of(people, {"weight_kg": 75.0 * math.exp(0.1)})
    assert prior.parameters == ("EGP_0", "S_IT", "S_ID", "S_IE")
    assert prior.mean[0] == pytest.approx(math.log(0.016) + 0.8 * 0.1, abs=0.01)
    assert prior.sd[0] == pytest.approx(0.1 * math.sqrt(1.0 - 0.8**2), rel=0.05)


def test_a_sensitivity_that_a_population_does_not_draw_is_found_about_its_nominal_value():
    prior = prior_of(population("wilinska2010", patient="wilinska-2010"))
    assert prior.parameters[-3:] == ("S_IT", "S_ID", "S_IE")
    assert prior.mean[-3:] == pytest.approx(np.log([0.001841, 0.000505, 0.019]))
    assert prior.sd[-3:] == pytest.approx([0.4] * 3)
    given = prior_of(population("wilinska2010", patient="wilinska-2010"), {"S_IE": 0.02})
    assert given.parameters == tuple(name for name in prior.parameters if name != "S_IE")


def test_coordinates_and_values_are_inverse():
    prior = prior_of(population("boiroux2017", patient=PATIENT), {"weight_kg": 70.0})
    z = np.random.default_rng(0).standard_normal(len(prior.parameters))
    values = {name: float(value[0]) for name, value in prior.values(z[:, None]).items()}
    assert values["weight_kg"] == 70.0
    assert prior.coordinates(values) == pytest.approx(z)


def test_a_table_of_few_people_makes_a_covariance_that_can_be_used():
    prior = prior_of(population("kanderian2009", patient="kanderian-2009"))
    assert np.linalg.eigvalsh(prior.covariance).min() > 0.0


@pytest.mark.parametrize(
    ("people", "known", "sentence"),
    [
        (Population("alike", (), patient=PATIENT), {}, "do not differ"),
        (population("boiroux2017", patient=PATIENT), {"renal_threshold": 9.0}, "does not differ between the people"),
        (population("boiroux2017", patient=PATIENT), {"weight_kg": -1.0}, "give a finite value above 0"),
        (
            Population("one", (Variation(parameter="EGP_0", distribution="uniform", spread_pct=1.0),), patient=PATIENT),
            {"EGP_0": 0.016, "S_IT": 0.005, "S_ID": 0.001, "S_IE": 0.05},
            "every parameter is given",
        ),
    ],
)
def test_what_cannot_be_a_prior_is_refused(people, known, sentence):
    with pytest.raises(Refusal, match=sentence):
        prior_of(people, known)
