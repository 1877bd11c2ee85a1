"""A dose is a basal rate and a bolus: what reaches the patient, the controller and the trace of it; and the time."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import glucoloop as gl
from glucoloop._pytree import pytree
from glucoloop.arguments import ArgumentTypeError
from glucoloop.build.assemble import PeopleLoop
from glucoloop.build.random_keys import keys_of_people
from glucoloop.control.protocol import Decision, Observation, Status
from glucoloop.faults import Occlusion, once
from glucoloop.meals import Meal, Scenario, eaten
from glucoloop.metrics import summarise
from glucoloop.metrics.running import RunningMetrics
from glucoloop.simulation import simulate
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.engines import ENGINES
from glucoloop.situations.situation import Situation, configured
from glucoloop.trials.people_run import simulate_people

PATIENT = gl.patient("hovorka-2004")
SCENARIO = Scenario([Meal(50.0, 50.0, announced_g=40.0)], 300.0, announced=True, start_min=1410.0)
SAMPLES = 60
PER_MIN_OF_DAY = 2.0**-12
"""mU/min by which the controller of these tests raises its rate at each minute, to show what time it was told."""
TIMES = (1410.0 + 5.0 * np.arange(SAMPLES)) % 1440.0
RATES = float(PATIENT.basal_insulin_mU_min) + TIMES * PER_MIN_OF_DAY


@pytree
class _Bolus:
    """Gives what a meal needs at once, and sums up what the pump says it gave."""

    mU_per_g: jax.Array | float = 50.0
    sample_time_min: float = 5.0
    gives_boluses: ClassVar[bool] = True

    def init(self, observation: Observation) -> dict[str, jax.Array]:
        return {
            "basal": observation.delivered_mU_min,
            "given": 0.0 * observation.delivered_bolus_mU,
        }

    def step(self, state, observation):
        state = {
            "basal": state["basal"],
            "given": state["given"] + observation.delivered_bolus_mU,
        }
        bolus = self.mU_per_g * observation.announced_carbs_g
        rate = state["basal"] + observation.time_of_day_min * PER_MIN_OF_DAY
        return state, Decision(insulin_mU_min=rate, status=jnp.asarray(0), bolus_mU=bolus)


@pytest.fixture(scope="module")
def trace():
    return simulate(PATIENT, _Bolus(), scenario=SCENARIO)


@pytest.mark.long
def test_a_bolus_reaches_the_patient_beside_the_basal_rate(trace):
    bolus = np.asarray(trace.bolus_mU)
    assert np.flatnonzero(bolus).tolist() == [10]
    assert bolus[10] == 2000.0  # of 40 g, as announced, not of 50 g
    total = float(summarise(trace).insulin_total_mU)
    assert total == pytest.approx(5.0 * RATES.sum() + 2000.0, rel=1e-12)


def test_all_of_a_bolus_arrives_in_the_depots_under_the_skin(trace):
    """Against SciPy on the three balances of insulin alone, written down once more."""
    p, x = PATIENT.parameters, np.asarray(trace.states)
    t_max, k_e, volume = float(p.t_maxI), float(p.k_e), float(p.insulin_volume_l)

    def balances(_, z, u):
        S1, S2, I = z
        return [u - S1 / t_max, (S1 - S2) / t_max, S2 / (t_max * volume) - k_e * I]

    z = x[0, 3:6]
    for number in range(20):
        rate = RATES[number] + (2000.0 / 5.0 if number == 10 else 0.0)
        z = solve_ivp(balances, (0.0, 5.0), z, args=(rate,), rtol=1e-11, atol=1e-11, method="LSODA").y[:, -1]
        np.testing.assert_allclose(x[number + 1, 3:6], z, rtol=1e-7)


def test_the_table_tells_of_boluses_and_announcements_where_there_are_any(trace):
    table = trace.to_polars()
    assert {"bolus_mU", "command_bolus_mU", "reported_bolus_mU", "announced_carbs_g"} <= set(table.columns)
    assert table["bolus_mU"].sum() == 2000.0
    assert table["announced_carbs_g"].sum() == 40.0
    assert table["carbs_g"].sum() == 50.0


def test_the_time_of_day_goes_on_past_midnight(trace):
    np.testing.assert_allclose(trace.insulin_mU_min, RATES, rtol=1e-14)
    assert TIMES.min() == 0.0


def test_the_controller_learns_what_the_pump_says_of_a_bolus():
    fault = Occlusion(open_fraction=0.5, noticed=True, schedule=once(10, 3))
    told = simulate(PATIENT, _Bolus(), pump=fault, scenario=SCENARIO)
    assert float(told.bolus_mU[10]) == float(told.reported_bolus_mU[10]) == 1000.0
    assert float(told.command_bolus_mU[10]) == 2000.0


@pytest.mark.long
def test_stepping_with_boluses_is_the_simulation_to_the_bit(trace):
    stepper = gl.Stepper(PATIENT, start_min=1410.0)
    seen = stepper.observation()
    for k in range(12):
        assert float(seen.time_of_day_min) == (1410.0 + 5.0 * k) % 1440.0
        if k == 11:
            assert float(seen.delivered_bolus_mU) == 2000.0
        bolus = None if k != 10 else 2000.0
        seen = stepper.step(float(trace.command_mU_min[k]), 50.0 if k == 10 else 0.0, bolus)
    np.testing.assert_array_equal(stepper.state, trace.states[12])


@pytest.mark.parametrize("bolus", [np.nan, np.inf, -3000.0])
def test_a_stepper_takes_nonsense_for_no_bolus(bolus):
    stepper = gl.Stepper(PATIENT)
    stepper.step(5.0, bolus_mU=bolus)
    assert float(stepper.last.delivery.bolus_mU) == 0.0
    if not np.isfinite(bolus):
        assert int(stepper.last.decision.status) == Status.NO_FINITE_DOSE


@pytest.mark.long
@pytest.mark.parametrize("engine", ENGINES)
def test_a_cohort_carries_boluses_as_the_loop_of_one_person_does(trace, engine):
    people = gl.virtual_people(gl.population("nominal", patient="hovorka-2004"), 1, range(2))
    run = simulate_people(people, _Bolus(), scenario=SCENARIO, engine=engine)
    assert run.engine == engine
    np.testing.assert_allclose(run.glucose_mg_dl[:-1, 0], trace.glucose_mg_dl, rtol=2e-4)
    np.testing.assert_allclose(run.metrics.insulin_total_mU, summarise(trace).insulin_total_mU, rtol=1e-9)
    assert run.insulin_mU_min[10, 0] == pytest.approx(RATES[10] + 400.0)


@pytree
class _Unsaid(_Bolus):
    gives_boluses: ClassVar[bool] = False

    def init(self, observation):
        return observation.delivered_mU_min

    def step(self, state, observation):
        return state, Decision(insulin_mU_min=state, status=jnp.asarray(0), bolus_mU=jnp.zeros(()))


@pytree
class _None(_Unsaid):
    gives_boluses: ClassVar[bool] = True

    def step(self, state, observation):
        return state, dataclasses.replace(super().step(state, observation)[1], bolus_mU=None)


@pytest.mark.parametrize(
    ("controller", "told"), [(_Unsaid(), "write gives_boluses = True"), (_None(), "decides on none")]
)
def test_a_controller_that_does_other_than_it_says_is_refused(controller, told):
    with pytest.raises(ArgumentTypeError, match=told):
        simulate(PATIENT, controller, scenario=SCENARIO)


@pytest.mark.parametrize("start_min", [-1.0, 1440.0, np.nan])
def test_what_is_no_time_of_day_is_refused(start_min):
    with pytest.raises(ValueError, match="time of day"):
        Scenario(start_min=start_min)


@pytest.mark.parametrize("announced_g", [-1.0, 1000.1, np.nan])
def test_an_impossible_announcement_is_refused(announced_g):
    with pytest.raises(ValueError, match="announced as"):
        Meal(50.0, 50.0, announced_g=announced_g)


@pytest.mark.long
@pytest.mark.parametrize("engine", ENGINES)
def test_each_controller_of_a_cohort_is_told_what_is_announced_to_it(engine):
    """Boluses of 50 mU for each gram, and everybody is told of another amount."""
    people = gl.virtual_people(gl.population("nominal", patient="hovorka-2004"), 1, range(3))
    told = np.array([[20.0, 40.0, 60.0]])
    grid = sample_grid(300.0, 5.0)
    loop = PeopleLoop(
        configured(Situation, patient="hovorka-2004", announce_meals=True, start="00:00"),
        _Bolus(),
        people,
        grid,
        RunningMetrics(setpoint_mg_dl=120.0, inside_min=tuple(grid.inside_min.tolist())),
        meals=eaten([Meal(50.0, 50.0)]),
        own_announcements=True,
        engine=engine,
    )
    run = loop.run(people, keys_of_people(1, people.draw.person), announced_g=told)
    basal = 5.0 * run.insulin_mU_min.sum(axis=0) - 50.0 * told[0]
    np.testing.assert_allclose(basal, basal[0], rtol=1e-9)
    assert np.all(np.diff(run.glucose_mg_dl[-1]) < -5.0)
