"""Pace: a controller at its own sample time in a loop with a shorter one, against the loop at its own sample time."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import glucoloop as gl
from glucoloop._pytree import pytree, static
from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of
from glucoloop.build.random_keys import keys_of_people
from glucoloop.control import Decision, Observation, PIDTuning, Status, design_open_loop, design_pid, paced
from glucoloop.control.pace import Paced, samples_of_pace
from glucoloop.meals import Meal, Scenario
from glucoloop.patients.population import of_people, virtual_people
from glucoloop.simulation import Adaptive, simulate
from glucoloop.simulation.closed_loop import usual_limits
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.trials.people_run import simulate_people

# The scenario is one for controllers of all kinds, of whom some hear of no meal.
pytestmark = pytest.mark.filterwarnings("ignore:announced has no effect")

TUNING = PIDTuning(0.3, 150.0, 20.0)
SCENARIO = Scenario([Meal(40.0, 32.0)], 240.0, announced=True)
NUMBERS = st.floats(0.0, 500.0)


@pytree
class Told:
    """A controller whose state is what it was told last, and who asks for a dose that grows with the reading."""

    sample_time_min: float = static(default=15.0)
    gives_boluses = True

    def init(self, observation):
        return observation

    def step(self, state, observation):
        del state
        dose = 0.1 * observation.glucose_mg_dl
        return observation, Decision(insulin_mU_min=dose, status=jnp.asarray(int(Status.OK)), bolus_mU=dose)


def seen(reading, delivered, bolus, carbs):
    return Observation(
        glucose_mg_dl=jnp.asarray(np.nan if reading is None else reading),
        valid=jnp.asarray(reading is not None),
        setpoint_mg_dl=jnp.asarray(100.0),
        delivered_mU_min=jnp.asarray(delivered),
        announced_carbs_g=jnp.asarray(carbs),
        delivered_bolus_mU=jnp.asarray(bolus),
    )


step = jax.jit(lambda controller, state, observation: controller.step(state, observation))


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.none() | NUMBERS, NUMBERS, NUMBERS, NUMBERS), min_size=7, max_size=12))
def test_a_controller_is_told_of_everything_since_it_acted(entries):
    controller = paced(Told(), 5.0)
    state, acted, doses = controller.init(seen(*entries[0])), 0, []
    for k, entry in enumerate(entries):
        state, decision = step(controller, state, seen(*entry))
        doses.append((float(decision.insulin_mU_min), float(decision.bolus_mU)))
        if k % 3:
            assert doses[-1] == (doses[acted][0], 0.0) or np.isnan(doses[acted][0])
            continue
        since, acted, told = entries[max(0, k - 2) : k + 1] if k else entries[:1], k, state.inner
        readings = [reading for reading, *_ in since if reading is not None]
        _, delivered, bolus, carbs = (np.array(column, float) for column in zip(*since, strict=True))
        assert bool(told.valid) == bool(readings)
        assert not readings or float(told.glucose_mg_dl) == readings[-1]
        np.testing.assert_allclose(told.delivered_mU_min, delivered.mean(), rtol=1e-12, atol=1e-300)
        np.testing.assert_allclose(told.delivered_bolus_mU, bolus.sum(), rtol=1e-12, atol=1e-300)
        np.testing.assert_allclose(told.announced_carbs_g, carbs.sum(), rtol=1e-12, atol=1e-300)
        np.testing.assert_array_equal(*doses[-1])


@pytest.fixture(scope="module")
def patient_hovorka():
    return gl.patient("hovorka-2004")


@pytest.mark.long
def test_a_pace_of_one_sample_is_the_bare_controller(patient_hovorka):
    bare = design_pid(TUNING, limits=usual_limits(patient_hovorka))
    assert paced(bare, 5.0) is bare
    wrapped = Paced(inner=bare, samples=1, sample_time_min=5.0)
    noisy = gl.white_noise(9.0)
    one, other = (simulate(patient_hovorka, each, noisy, scenario=SCENARIO, key=4) for each in (bare, wrapped))
    for name in ("fine_glucose_mg_dl", "command_mU_min", "status", "reading_mg_dl"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.long
@pytest.mark.parametrize("design", ["open loop", "pid"])
def test_a_paced_controller_in_a_loop_of_a_minute_is_that_of_five(patient_hovorka, design):
    limits = usual_limits(patient_hovorka)
    bare = design_pid(TUNING, limits=limits) if design == "pid" else design_open_loop(limits=limits)
    slow = simulate(patient_hovorka, bare, scenario=SCENARIO, integrator=Adaptive())
    fast = simulate(patient_hovorka, paced(bare, 1.0), scenario=SCENARIO, integrator=Adaptive())
    assert fast.t_min.size == 5 * slow.t_min.size
    # the same dose holds for five minutes; all that differs is the error of the integrator, within 1e-8
    np.testing.assert_allclose(fast.command_mU_min.reshape(-1, 5), slow.command_mU_min[:, None] * np.ones(5), rtol=1e-6)
    np.testing.assert_allclose(fast.fine_glucose_mg_dl, slow.fine_glucose_mg_dl, rtol=1e-6)


@pytest.mark.long
def test_a_bolus_is_given_once_and_within_a_minute():
    run = configured(
        Run,
        patient="hovorka-2004",
        controller=["basal-bolus, every=5min"],
        sample_time_min=1.0,
        announce_meals=True,
        meals=["40g@30min"],
        duration_min=240.0,
    )
    five = dataclasses.replace(run.case, every_min=None)
    slow_run = configured(Run, patient="hovorka-2004", controller=["basal-bolus"], announce_meals=True)
    fast = close_loop(run, controller_of(run, run.case), run.as_scenario())
    slow = close_loop(slow_run, controller_of(slow_run, five), run.as_scenario())
    given_fast, given_slow = np.asarray(fast.bolus_mU), np.asarray(slow.bolus_mU)
    assert np.flatnonzero(given_fast).tolist() == [30]
    assert np.flatnonzero(given_slow).tolist() == [6]
    assert given_fast[30] == given_slow[6] > 1000.0
    # over one minute in place of five, which `loop.sample` says is up to 1.5 mg/dl for each unit
    apart = np.abs(np.asarray(fast.fine_glucose_mg_dl) - np.asarray(slow.fine_glucose_mg_dl)).max()
    assert 0.0 < apart < 1.5 * given_slow[6] / 1000.0


@pytest.mark.long
def test_people_in_native_code_are_those_of_one_at_a_time():
    people = virtual_people(gl.population("boiroux2017", patient="hovorka-2004"), 3, np.arange(2))
    controller = paced(design_pid(TUNING, limits=usual_limits(people.patient)), 1.0)
    cohort = simulate_people(people, controller, gl.white_noise(4.0), scenario=SCENARIO, seed=1)
    assert cohort.engine == "native"
    for i, key in enumerate(keys_of_people(1, people.draw.person)):
        alone = simulate(of_people(people.patient, i), controller, gl.white_noise(4.0), scenario=SCENARIO, key=key)
        # people have another step of the integrator, which errs by some 1e-6
        np.testing.assert_allclose(cohort.insulin_mU_min[:, i], alone.insulin_mU_min, rtol=2e-5)
        np.testing.assert_allclose(cohort.glucose_mg_dl[:-1, i], alone.glucose_mg_dl, rtol=2e-5)


@settings(max_examples=60, deadline=None)
@given(st.floats(0.1, 120.0), st.floats(0.1, 120.0))
def test_a_pace_is_a_whole_number_of_samples_or_refused(every_min, sample_time_min):
    nearest = max(1, round(every_min / sample_time_min)) * sample_time_min
    if nearest == pytest.approx(every_min, rel=1e-9):
        assert samples_of_pace(every_min, sample_time_min) * sample_time_min == pytest.approx(every_min, rel=1e-8)
    else:
        with pytest.raises(gl.Refusal, match=f"acts every {every_min:g} min .* like {nearest:g} min"):
            samples_of_pace(every_min, sample_time_min)


@pytest.mark.parametrize(
    "text", ["pid, every=5", "pid, every=300s", "pid, every_min=5.0", "pid, every=0.0833333333333h"]
)
def test_a_pace_is_one_of_the_settings_of_a_controller(text):
    run = configured(Run, controller=[text], sample_time_min=1.0)
    assert run.case.every_min == pytest.approx(5.0)
    assert run.case.controller.display_name == "pid"


def test_a_pace_within_a_sample_is_refused():
    with pytest.raises(gl.Refusal, match=r"acts every 3 min .* 5-min samples; give .* like 5 min"):
        configured(Run, controller=["pid, every=3min"])
