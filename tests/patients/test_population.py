"""Virtual people: who they are, that they rest, and that each is the same in any company."""

import math

import jax
import numpy as np
import pytest
import scipy.optimize
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.patients import Inputs, Population, Variation, draw, patient, population, virtual_people
from glucoloop.patients.sorensen.equations import ARTERIAL_GLUCOSE, GLUCOSE
from glucoloop.patients.sorensen.parker1999 import CONSTANTS, PARKER_1999
from glucoloop.patients.sorensen.rest import rest_under
from glucoloop.patients.sorensen.varying import NOMINAL, with_values
from glucoloop.threefry import name_word

EIGHT = {
    "F_LC": (0.24, 0.56),
    "F_PC": (0.09, 0.21),
    "M_IHGP.strength": (0.6, 1.4),
    "M_IHGP.inflection": (0.6 * 0.8885, 1.4 * 0.8885),
    "M_IHGU.strength": (0.6, 1.4),
    "M_IHGU.inflection": (-0.4, 0.4),
    "M_IPGU.strength": (0.6, 1.4),
    "M_IPGU.inflection": (0.6 * 5.82113, 1.4 * 5.82113),
}


def uniform(parameter, spread_pct=10.0, **keys):
    return Variation(parameter=parameter, distribution="uniform", spread_pct=spread_pct, **keys)


@pytest.fixture(scope="module")
def people():
    return virtual_people(population("parker2000"), 3, np.arange(1500))


@pytest.fixture(scope="module")
def heavy_and_light():
    return virtual_people(population("lognormal"), 3, np.arange(1500))


@pytest.fixture(scope="module")
def rates():
    """Right-hand side of people, without a meal."""
    return jax.jit(lambda p, x, u: p.derivative(0.0, x, Inputs(insulin_mU_min=u, meal_mg_min=np.zeros(np.shape(u)))))


def test_parker2000_is_the_eight_parameters_within_forty_percent():
    drawn = draw(population("parker2000"), 1, np.arange(20_000)).values
    assert list(drawn) == list(EIGHT)
    for name, (low, high) in EIGHT.items():
        assert scipy.stats.kstest(drawn[name], scipy.stats.uniform(low, high - low).cdf).pvalue > 1e-3
        assert low <= drawn[name].min() < low + 1e-3 * (high - low)
        assert high - 1e-3 * (high - low) < drawn[name].max() <= high
    assert np.abs(np.corrcoef(list(drawn.values())) - np.eye(8)).max() < 0.03


def test_lognormal_spreads_as_it_says():
    drawn = draw(population("lognormal"), 1, np.arange(20_000)).values
    assert set(drawn) == {*EIGHT, "weight_kg"}
    for name, cv in (("F_LC", 0.2), ("M_IPGU.strength", 0.2), ("weight_kg", 0.15)):
        sigma = math.sqrt(math.log(1 + cv**2))
        deviation = np.log(drawn[name] / NOMINAL[name]) / sigma
        assert scipy.stats.kstest(deviation, scipy.stats.truncnorm(-3, 3).cdf).pvalue > 1e-3
    assert drawn["F_PC"].max() <= 0.21


@pytest.mark.long
@pytest.mark.parametrize("who", ["people", "heavy_and_light"])
def test_everybody_rests_at_the_setpoint_under_his_basal_rate(who, rates, request):
    found = request.getfixturevalue(who)
    assert found.feasible.all()
    np.testing.assert_allclose(rates(found.patient, found.rest, found.basal_insulin_mU_min), 0.0, atol=1e-11)
    np.testing.assert_allclose(found.rest[ARTERIAL_GLUCOSE], 81.1, rtol=1e-13)
    assert (found.rest[GLUCOSE] > 0.0).all()
    np.testing.assert_allclose(
        rest_under(found.patient.parameters, found.basal_insulin_mU_min), found.rest, rtol=1e-9, atol=1e-9
    )


def test_rest_is_where_a_general_solver_finds_it(people, rates):
    """All nineteen balances and the setpoint, for the state and the rate, from the nominal patient's."""
    nominal = patient()
    start = np.append(np.asarray(nominal.steady_state(nominal.basal_insulin_mU_min)), 25.6)
    for i in range(6):
        person = jax.tree.map(lambda leaf, i=i: leaf[i] if leaf.ndim else leaf, people.patient)
        solution = scipy.optimize.root(
            lambda v, person=person: np.append(rates(person, v[:19], v[19]), v[ARTERIAL_GLUCOSE] - 81.1), start
        )
        assert people.basal_insulin_mU_min[i] == pytest.approx(solution.x[19], rel=1e-7)
        np.testing.assert_allclose(people.rest[:, i], solution.x[:19], rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 63, 1025])
def test_a_person_is_the_same_in_any_company(people, n):
    some = np.random.default_rng(n).integers(0, 1500, n)
    again = virtual_people(population("parker2000"), 3, some)
    assert np.array_equal(again.draw.person, some)
    assert np.array_equal(again.basal_insulin_mU_min, people.basal_insulin_mU_min[some])
    assert np.array_equal(again.rest, people.rest[:, some])
    for name, values in again.draw.values.items():
        assert np.array_equal(values, people.draw.values[name][some])
    for leaf, whole in zip(jax.tree.leaves(again.patient), jax.tree.leaves(people.patient), strict=True):
        assert leaf.dtype == np.float64
        assert np.array_equal(leaf, whole[some] if whole.ndim else whole)


def test_nobody_drawn_is_nobody():
    none = virtual_people(population("parker2000"), 3, [])
    assert none.basal_insulin_mU_min.shape == none.feasible.shape == (0,)
    assert none.rest.shape == (19, 0)


def test_another_line_in_the_table_leaves_the_others():
    alone = draw(Population("a", (uniform("F_LC", 40.0),)), 3, np.arange(50)).values["F_LC"]
    among = draw(Population("b", (uniform("tau_I"), uniform("F_LC", 40.0))), 3, np.arange(50)).values["F_LC"]
    assert np.array_equal(alone, among)
    assert not np.array_equal(alone, draw(Population("a", (uniform("F_LC", 40.0),)), 4, np.arange(50)).values["F_LC"])


def test_no_two_parameters_share_their_numbers():
    assert len({name_word(f"parameter {name}") for name in NOMINAL}) == len(NOMINAL)


def test_the_nominal_population_is_the_nominal_patient():
    people = virtual_people(population("nominal"), 0, np.arange(3))
    assert people.draw.values == {}
    np.testing.assert_allclose(people.basal_insulin_mU_min, patient().basal_insulin_mU_min, rtol=1e-14)
    assert with_values({}) == PARKER_1999
    higher = virtual_people(
        population("nominal"), 0, [0], setpoint_mg_dl=float(patient(operating_point="nominal-22").setpoint_mg_dl)
    )
    assert higher.basal_insulin_mU_min[0] == pytest.approx(22.33, rel=1e-11)


def test_who_has_no_basal_rate_is_told_and_kept():
    """At 170 mg/dl some rest below the setpoint even without insulin."""
    people = virtual_people(population("parker2000"), 3, np.arange(1024), setpoint_mg_dl=170.0)
    without_insulin = np.asarray(rest_under(people.patient.parameters, 0.0)[ARTERIAL_GLUCOSE])
    assert 0 < (~people.feasible).sum() < 1024
    assert np.array_equal(people.feasible, without_insulin >= 170.0)
    assert np.isnan(people.basal_insulin_mU_min[~people.feasible]).all()
    assert np.isnan(people.rest[:, ~people.feasible]).all()
    assert (people.basal_insulin_mU_min[people.feasible] >= 0.0).all()


def test_who_cannot_feed_his_brain_has_no_basal_rate():
    """The brain takes 70 mg/min whatever its flow, so glucose in it would be below zero under 38.4 kg."""
    light = Population("light", (uniform("weight_kg", centre=38.0),))
    people = virtual_people(light, 0, np.arange(200))
    weight = people.draw.values["weight_kg"]
    assert np.array_equal(people.feasible, 81.1 - (70.0 / 5.9 + 70.0 * 2.1 / 4.5) * 70.0 / weight > 0.0)
    assert 0 < people.feasible.sum() < 200


def test_values_become_constants():
    x, factor = np.linspace(0.0, 8.0, 5), np.array([0.5, 1.0, 1.5, 2.0, 2.5])
    p = with_values({"M_IPGU.strength": factor, "M_IPGU.inflection": 5.0, "q_A": 3.0, "weight_kg": 140.0, "F_LC": 0.3})
    np.testing.assert_allclose(p.M_IPGU(x), factor * (7.035 + 6.51623 * np.tanh(0.33827 * (x - 5.0))), rtol=1e-14)
    assert (p.F_LC, p.q_A) == (0.3, 6.0)
    assert p.q_L == pytest.approx(2.0 * (3.0 + 10.1))  # what comes to the liver leaves it
    assert p.Q_L == pytest.approx(2.0 * 0.9)


def test_what_varies_covers_the_constants():
    assert {c.name for c in CONSTANTS} - set(NOMINAL) == {"q_L", "Q_L"}
    assert all(NOMINAL[c.name] == c.value for c in CONSTANTS if c.name in NOMINAL)


parameters = st.sampled_from(sorted(NOMINAL)) | st.text(max_size=5)
number = st.floats(-10.0, 200.0) | st.none()
tables = st.lists(
    st.fixed_dictionaries(
        {"parameter": parameters, "distribution": st.sampled_from(["uniform", "normal", "lognormal"])},
        optional={"spread_pct": st.floats(0.0, 120.0), "spread": number, "lower": number, "upper": number},
    ),
    max_size=5,
)


@pytest.mark.long
@given(tables)
def test_any_table_is_refused_or_makes_people_who_can_be(table):
    try:
        made = Population("made", tuple(Variation(**row) for row in table))
    except ValueError:
        return
    values = draw(made, 0, np.arange(64)).values
    p = with_values(values)
    for c in CONSTANTS:
        value = values.get(c.name, c.value)
        if c.unit in ("dl/min", "l/min", "dl", "l", "min"):
            assert np.all(np.asarray(value) > 0.0)
    for fraction in (p.F_LC, p.F_KC, p.F_PC):
        assert np.all((np.asarray(fraction) > 0.0) & (np.asarray(fraction) < 1.0))
    assert np.all(np.asarray(p.peripheral_clearance) > 0.0)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(p))


@pytest.mark.parametrize(
    ("variations", "told"),
    [
        ([uniform("F_LX")], "unknown parameter 'F_LX'; did you mean 'F_LC'"),
        ([uniform("zzzzzzz")], "unknown parameter 'zzzzzzz'; the known ones are the constants of the patient"),
        ([uniform("q_L")], "q_L follows from q_A and q_G; vary these instead"),
        ([uniform("F_LC"), uniform("F_LC")], "F_LC is varied twice; leave one out"),
        ([uniform("F_LC", 160.0)], r"F_LC can vary from -0\.24 to 1\.04 but must stay above 0 and below 1; narrow"),
        ([uniform("v_G", 100.0)], r"v_G can vary from 0 to 22\.4 but must stay above 0; narrow its spread"),
        ([uniform("weight_kg", 100.0)], "weight_kg can vary from 0 to 140 but must stay above 0"),
        ([uniform("F_PC", 70.0)], r"F_PC can be 0\.255, but .* from 0\.243 on; narrow the spread of F_PC"),
        ([uniform("F_PC", 40.0), uniform("T_PI", 60.0)], r"F_PC can be 0\.21, but .* from 0\.1671 on"),
        ([uniform("T_PI", 90.0)], r"F_PC can be 0\.15, but .* narrow the spread of T_PI"),
        ([uniform("M_IPGU.scale", 40.0)], r"M_IPGU would change its sign: .* vary M_IPGU\.strength instead"),
        ([uniform("excretion.offset")], "excretion would change its sign: .* vary excretion_clearance instead"),
    ],
)
def test_a_table_that_makes_the_impossible_is_refused(variations, told):
    with pytest.raises(ValueError, match=told):
        Population("made", tuple(variations))


def test_bounds_make_a_wide_spread_possible():
    made = Population("made", (uniform("F_LC", 160.0, lower=0.1, upper=0.9),))
    drawn = draw(made, 0, np.arange(500)).values["F_LC"]
    assert 0.1 <= drawn.min() < drawn.max() <= 0.9


def test_an_unknown_population_is_refused_with_the_known_ones():
    with pytest.raises(
        ValueError,
        match=r"unknown population 'people' of parker-1999; the known ones are: nominal, parker2000, lognormal$",
    ):
        population("people")
    with pytest.raises(ValueError, match="a population has no name; give it one"):
        Population(" ")


@pytest.mark.parametrize("setpoint", [0.0, -1.0, math.nan, math.inf])
def test_an_impossible_setpoint_is_refused(setpoint):
    with pytest.raises(
        ValueError, match=r"^a setpoint of .* mg/dl is not possible; give a finite value above 0 mg/dl$"
    ):
        virtual_people(population("nominal"), 0, [0], setpoint_mg_dl=setpoint)
