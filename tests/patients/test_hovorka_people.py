"""People around the nominal Hovorka patient, and the integrator that carries many of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree
from glucoloop.control import PIDTuning, design_pid
from glucoloop.meals import Meal, Scenario, eaten
from glucoloop.patients import Population, Variation, patient, population, virtual_people
from glucoloop.patients.hovorka import HOVORKA_2004, STATE_NAMES, WILINSKA_2010
from glucoloop.patients.hovorka.hovorka2004 import DISTRIBUTIONS
from glucoloop.patients.hovorka.patient import Hovorka2004
from glucoloop.patients.hovorka.varying import nominal_values, with_values
from glucoloop.sensors import IdealSensor
from glucoloop.simulation import Exponential, simulate
from glucoloop.simulation.cohort import Cohort, People
from glucoloop.simulation.plant import SampleGrid

PATIENT = "hovorka-2004"


@pytest.fixture(scope="module")
def published():
    return population("boiroux2017", patient=PATIENT)


@pytest.fixture(scope="module")
def people(published):
    return virtual_people(published, 0, np.arange(2000))


def of(*variations):
    return Population("mine", tuple(variations), patient=PATIENT)


def test_the_nominal_values_are_the_published_ones_and_make_the_nominal_person():
    for person in (HOVORKA_2004, WILINSKA_2010):
        assert with_values(person, {}) == person
        named = nominal_values(person)
        assert all(getattr(person, name) == value for name, value in named.items() if name != "absorption_rate")
        assert with_values(person, {"absorption_rate": 0.02}).t_maxI == 50.0
    assert nominal_values(WILINSKA_2010)["absorption_rate"] == 0.018


PRINTED = {  # minimum and most, typed in from means and errors
    "weight_kg": (65.0, 95.0),
    "A_G": (0.7, 1.2),
    "EGP_0": (0.012181, 0.020019),
    "F_01": (0.0074955, 0.0119045),
    "k_12": (0.036731, 0.093069),
    "k_a1": (0.00055, 0.0111338),
    "k_a2": (0.017596, 0.119004),
    "k_a3": (0.0068849, 0.0539151),
    "S_IT": (0.0019112, 0.0083288),
    "S_ID": (0.36163e-4, 16.0384e-4),
    "S_IE": (0.0213814, 0.0826186),
    "k_e": (0.105, 0.175),
    "V_I": (0.108, 0.132),
    "absorption_rate": (0.0135, 0.0225),
    "V_G": (0.119180, 0.188790),
    "t_maxG": (31.157, 51.369),
}


def test_the_published_population_varies_as_printed(published, people):
    assert {d.parameter for d in DISTRIBUTIONS} == set(PRINTED)
    for name, distribution in published.distributions().items():
        assert (distribution.lower, distribution.upper) == pytest.approx(PRINTED[name], rel=1e-4)
        drawn = people.draw.values[name]
        assert distribution.lower <= drawn.min() < drawn.max() <= distribution.upper
        middle = 0.5 * (distribution.lower + distribution.upper)
        assert np.median(drawn) == pytest.approx(middle, rel=0.06)


def test_almost_everybody_can_be_held_at_the_usual_setpoint(people):
    basal = people.basal_insulin_mU_min
    assert people.feasible.mean() > 0.99
    assert 5.0 < np.median(basal[people.feasible]) < 9.0  # 0.3 to 0.5 U/h
    x = people.rest[:, people.feasible]
    assert (x >= 0.0).all()
    insulin, glucose = Hovorka2004.sound(x, np.full(x.shape[1], 120.0))
    assert np.all(insulin)
    assert np.all(glucose)
    np.testing.assert_allclose(x[STATE_NAMES.index("IG")] * 18.016, 120.0, rtol=1e-12)


def test_people_of_2010_vary_as_told_and_almost_all_can_be_held():
    published = population("wilinska2010", patient="wilinska-2010")
    bounds = {name: (of.lower, of.upper) for name, of in published.distributions().items()}
    assert bounds["k_e"] == pytest.approx((0.035, 0.245))
    assert bounds["V_G"] == pytest.approx((0.0752, 0.2991), rel=1e-3)
    assert bounds["renal_clearance"] == pytest.approx((0.001, 0.085))
    assert bounds["A_G"] == pytest.approx((0.7, 1.2))
    people = virtual_people(published, 0, np.arange(500))
    assert people.feasible.mean() > 0.98
    assert 12.0 < np.median(people.basal_insulin_mU_min[people.feasible]) < 18.0
    with pytest.raises(ValueError, match="unknown parameter 'uptake_threshold'"):
        Population("mine", (Variation(parameter="uptake_threshold", distribution="uniform", spread=1.0),),
                   patient="wilinska-2010")  # fmt: skip


def test_who_cannot_be_held_has_no_rate():
    scarce = of(Variation(parameter="EGP_0", distribution="uniform", centre=0.0105, spread=0.002))
    people = virtual_people(scarce, 3, np.arange(50))
    assert 0 < people.feasible.sum() < 50
    rests_below = people.draw.values["EGP_0"] < 0.0097  # of what is used without insulin
    np.testing.assert_array_equal(people.feasible, ~rests_below)
    assert np.isnan(people.rest[:, ~people.feasible]).all()
    assert np.isnan(people.basal_insulin_mU_min[~people.feasible]).all()


@pytest.mark.parametrize(
    ("variations", "message"),
    [
        (
            [Variation(parameter="k_e", distribution="normal", spread=0.05)],
            r"k_e can vary from -0\.012 to 0\.288 but must stay above 0",
        ),
        (
            [
                Variation(parameter="t_maxI", distribution="uniform", spread_pct=10.0),
                Variation(parameter="absorption_rate", distribution="uniform", spread_pct=10.0),
            ],
            r"absorption_rate is 1 / t_maxI; vary one of the two",
        ),
        (
            [Variation(parameter="uptake_threshold", distribution="uniform", spread=4.4, centre=8.0)],
            r"uptake_threshold can be 12\.4 mmol/l and renal_threshold 9 mmol/l",
        ),
        (
            [Variation(parameter="k_12b", distribution="uniform", spread=1.0)],
            r"unknown parameter 'k_12b'; did you mean",
        ),
    ],
)
def test_people_who_cannot_be_are_refused(variations, message):
    with pytest.raises(ValueError, match=message):
        of(*variations)


def test_soundness_sees_an_amount_below_zero_and_interstitial_glucose_below_all_that_was_in_plasma():
    x = np.tile(Hovorka2004.at_operating_point("fasting-120").steady_state(5.0)[:, None], (1, 3))
    x[STATE_NAMES.index("S2"), 0] = -1e-3
    x[STATE_NAMES.index("Q2"), 1] = -1e-3
    insulin, glucose = Hovorka2004.sound(x, np.full(3, 50.0))
    assert list(insulin) == [False, True, True]
    assert list(glucose) == [True, False, True]
    x[STATE_NAMES.index("IG")] = 49.0 / 18.016
    assert not np.any(Hovorka2004.sound(x, np.full(3, 50.0))[1])


@pytree
class Extremes:
    """Lowest and highest glucose on the fine grid, which is what metrics are made of."""

    def init(self, glucose_mg_dl, insulin_mU_min):
        del insulin_mU_min
        return {"least": glucose_mg_dl, "most": glucose_mg_dl}

    def step(self, state, happened, t_min):
        del t_min
        inside = happened.inside_mg_dl
        return {
            "least": jnp.minimum(state["least"], jnp.min(inside, axis=0)),
            "most": jnp.maximum(state["most"], jnp.max(inside, axis=0)),
        }


@pytest.mark.long
def test_native_code_carries_people_as_finer_steps_carry_each(published, open_pump):
    """Each with own constants, own gut and own basal rate; two steps a sample, about the nominal person."""
    people = virtual_people(published, 1, np.arange(4))
    controller = design_pid(PIDTuning(gain_mU_min_per_mg_dl=0.08, integral_time_min=1500.0, derivative_time_min=48.0))
    meals = Meal(50.0, 51.3, 12.0), Meal(30.0, 287.0)
    cohort = Cohort(
        patient(PATIENT),
        people.patient,
        controller,
        IdealSensor(),
        open_pump,
        SampleGrid(sample_time_min=5.0, samples=180),
        Extremes(),
        setpoint_mg_dl=120.0,
        meals=eaten(meals),
        engine="native",
    )
    keys = jax.random.split(jax.random.key(0), 4)
    run = cohort.run(
        People(patient=people.patient, x=people.rest, insulin_mU_min=people.basal_insulin_mU_min, key=keys)
    )
    for i in (1, 3):  # whose program is the same
        one = jax.tree.map(lambda leaf, i=i: leaf[..., i] if leaf.ndim else leaf, people.patient)
        trace = simulate(
            one, controller, pump=open_pump, scenario=Scenario(meals, 900.0), integrator=Exponential(substeps=6)
        )
        assert np.ptp(trace.glucose_mg_dl) > 100.0
        fine = np.asarray(trace.fine_glucose_mg_dl)
        at_samples = np.append(trace.glucose_mg_dl, fine[-1])
        np.testing.assert_allclose(run.glucose_mg_dl[:, i], at_samples, rtol=0.0, atol=0.02)
        assert run.accumulator["least"][i] == pytest.approx(fine.min(), abs=0.05)
        assert run.accumulator["most"][i] == pytest.approx(fine.max(), abs=0.05)
