"""A controller that answers no number, and glucose lower than the model is valid for: in native code too."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree, static
from glucoloop.control import Decision, Status
from glucoloop.meals import Scenario
from glucoloop.metrics import summarise
from glucoloop.patients import Inputs, virtual_people
from glucoloop.patients.capabilities import lowest_valid_glucose_mg_dl
from glucoloop.patients.population import Population
from glucoloop.patients.sorensen import equations as sorensen
from glucoloop.patients.variation import Variation
from glucoloop.simulation import simulate
from glucoloop.trials.people_run import simulate_people

FAULTY_FROM, SAMPLES, PEOPLE = 36, 60, 3
SCENARIO = Scenario([], 5.0 * SAMPLES)
BRAINS = Population(
    "brains",
    tuple(Variation(parameter=name, distribution="uniform", spread_pct=10.0) for name in ("brain_uptake", "q_B")),
)


@pytree
class Broken:
    """Far too much insulin for three hours, and then no number."""

    answer: float
    sample_time_min: float = static(default=5.0)

    def init(self, observation):
        return jnp.zeros_like(observation.glucose_mg_dl)

    def step(self, state, observation):
        dose = jnp.where(state < FAULTY_FROM, 60.0, self.answer)
        return state + 1.0, Decision(insulin_mU_min=dose, status=jnp.zeros_like(dose, int))


@pytest.fixture(scope="module")
def people():
    return virtual_people(BRAINS, 3, np.arange(PEOPLE))


@pytest.fixture(scope="module")
def of_person(people):
    """The run of a person, by his number and what the controller answers in the end."""

    def run(i, answer):
        own = jax.tree.map(lambda a: jnp.asarray(a)[i] if jnp.ndim(a) else jnp.asarray(a, float), people.patient)
        return simulate(own, Broken(answer=jnp.asarray(answer)), scenario=SCENARIO)

    return run


@pytest.mark.parametrize("answer", [np.nan, np.inf, -np.inf])
def test_no_finite_dose_is_the_least_dose_and_is_told(of_person, answer):
    trace = of_person(0, answer)
    status, insulin = np.asarray(trace.status), np.asarray(trace.insulin_mU_min)
    assert np.all(status[:FAULTY_FROM] == Status.OK)
    assert np.all(status[FAULTY_FROM:] == Status.NO_FINITE_DOSE)
    assert not np.isfinite(np.asarray(trace.command_mU_min)[FAULTY_FROM:]).any()
    np.testing.assert_allclose(insulin[FAULTY_FROM : FAULTY_FROM + 4], [43.3, 26.6, 9.9, 0.0], atol=1e-12)
    assert np.all(insulin[FAULTY_FROM + 3 :] == 0.0)
    assert np.isfinite(np.asarray(trace.fine_glucose_mg_dl)).all()
    assert int(summarise(trace).samples_non_finite) == SAMPLES - FAULTY_FROM


def test_the_brain_is_empty_at_rest_at_the_limit(patient_81):
    """The limit is where the balances of the brain, at steady state, leave its interstitial space without glucose."""
    p, x = patient_81.parameters, patient_81.steady_state(patient_81.basal_insulin_mU_min)
    limit = float(patient_81.lowest_valid_glucose_mg_dl)
    assert limit == pytest.approx(44.5, abs=0.05)
    names = sorensen.STATE_NAMES
    in_blood = limit - float(p.brain_uptake) / float(p.q_B)
    for name, value in (("G_H", limit), ("G_BV", in_blood), ("G_BI", 0.0)):
        x = x.at[names.index(name)].set(value)
    none = jnp.zeros(())
    rates = patient_81.derivative(none, x, Inputs(insulin_mU_min=none, meal_mg_min=none))
    for name in ("G_BV", "G_BI"):
        assert float(rates[names.index(name)]) == pytest.approx(0.0, abs=1e-12)


def test_a_patient_without_a_limit_is_valid_down_to_nothing():
    assert lowest_valid_glucose_mg_dl(object()) == 0.0


def test_native_code_counts_what_a_trace_shows(people, of_person):
    run = simulate_people(people, Broken(answer=np.nan), scenario=SCENARIO)
    assert run.engine == "native"
    traces = [of_person(i, np.nan) for i in range(PEOPLE)]
    limits = [float(trace.lowest_valid_mg_dl) for trace in traces]
    assert len(set(limits)) == PEOPLE
    np.testing.assert_allclose(people.patient.lowest_valid_glucose_mg_dl, limits, rtol=1e-12)
    assert np.all(run.metrics.samples_non_finite == SAMPLES - FAULTY_FROM)
    found = np.asarray(run.metrics.time_below_validity_pct)
    expected = np.array([float(summarise(trace).time_below_validity_pct) for trace in traces])
    assert np.all(expected > 5.0)
    # The integrators differ by less than glucose falls in a minute.
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1.01 * 100.0 / (5 * SAMPLES + 1))


def test_glucose_beyond_the_model_is_told_with_the_glucose(people, of_person):
    run = simulate_people(people, Broken(answer=60.0), scenario=SCENARIO)
    limit = np.broadcast_to(np.asarray(lowest_valid_glucose_mg_dl(people.patient)), PEOPLE)
    np.testing.assert_array_equal(run.glucose_valid, run.glucose_mg_dl >= limit)
    assert run.glucose_valid[0].all()
    assert not run.glucose_valid[-1].any()
    trace = of_person(0, 60.0)
    np.testing.assert_array_equal(trace.glucose_valid, run.glucose_valid[:-1, 0])
    np.testing.assert_array_equal(trace.fine_glucose_valid, trace.fine_glucose_mg_dl >= limit[0])


def test_nothing_below_zero_or_no_number_is_valid_glucose(of_person):
    trace = of_person(0, 0.0)
    with_default = trace.__class__(
        **{**vars(trace), "lowest_valid_mg_dl": 0.0, "glucose_mg_dl": jnp.array([-1.0, 0.0, jnp.nan, 5.0])}
    )
    assert with_default.glucose_valid.tolist() == [False, True, False, True]
