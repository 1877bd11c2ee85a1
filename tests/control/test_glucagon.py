"""Controllers of glucagon, its caps in the guard, its route in the pump, and what has none."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from given_glucagon import GivenGlucagon
from glucoloop.arguments import ArgumentTypeError
from glucoloop.control import Decision, GuardSettings, guarded, paced
from glucoloop.control.glucagon import GLUCAGON
from glucoloop.control.guard_glucagon import repaired_glucagon
from glucoloop.control.protocol import gives_glucagon
from glucoloop.faults import FAULTS
from glucoloop.patients.population import population, virtual_people
from glucoloop.pumps import GlucagonLimits, LimitedPump
from guarding import BASAL, SETPOINT, observe
from observing import observing

seen = observing(110.0, 10.0)


def around(text, inner=None, **more):
    inner = GivesBoluses() if inner is None else inner
    return GLUCAGON.choose(text).made(inner=inner, sample_time_min=5.0, **more)


@gl.plugin.pytree
class GivesBoluses:
    """Gives a rate and a bolus at each sample."""

    sample_time_min: float = 5.0
    gives_boluses = True

    def init(self, observation):
        return 0.0 * observation.glucose_mg_dl

    def step(self, state, observation):
        one = jnp.ones_like(observation.glucose_mg_dl)
        status = jnp.zeros(one.shape, int)
        return state, Decision(insulin_mU_min=10.0 * one, status=status, bolus_mU=500.0 * one)


def doses(controller, readings):
    """Decisions on readings, NaN for one that is missing."""
    state = controller.init(seen(readings[0]))
    decisions = []
    for reading in readings:
        valid = not np.isnan(reading)
        state, decision = controller.step(state, seen(reading if valid else 40.0, valid=valid))
        decisions.append(decision)
    return decisions


def test_threshold_is_its_equation():
    readings = [90.0, 84.0, 77.0, 70.0, np.nan, np.nan, 66.0, 69.0, 79.0, 81.0]
    for ahead, of_filter, gain in ((15.0, 15.0, 0.5), (0.0, 15.0, 2.0), (30.0, 5.0, 0.1)):
        controller = around(f"threshold, gain_ug_per_mg_dl={gain}, ahead_min={ahead}, filter_min={of_filter}")
        expected, last, since, rate = [], readings[0], 5.0, 0.0
        for y in readings:
            if np.isnan(y):
                expected.append(0.0)
                since += 5.0
                continue
            kept = np.exp(-since / of_filter)
            rate = kept * rate + (1.0 - kept) * (y - last) / since
            last, since = y, 5.0
            expected.append(gain * max(80.0 - y - ahead * min(rate, 0.0), 0.0) if y < 80.0 else 0.0)
        given = [float(decision.glucagon_ug) for decision in doses(controller, readings)]
        assert given == pytest.approx(expected, rel=1e-9)
        assert sum(given) > 0.0


def test_the_default_gain_is_of_the_route():
    one = [float(doses(around("threshold", subcutaneous=of), [75.0])[0].glucagon_ug) for of in (True, False)]
    assert one == pytest.approx([2.5, 0.1])


def test_mini_dose_comes_again_after_half_an_hour():
    controller = around("mini-dose, dose_ug=100")
    given = [float(decision.glucagon_ug) for decision in doses(controller, [80.0, *[65.0] * 13, 71.0, np.nan])]
    assert np.flatnonzero(given).tolist() == [1, 7, 13]
    assert set(given) == {0.0, 100.0}


def test_insulin_is_suspended_where_glucagon_is_given_but_for_the_bolus_of_a_meal():
    for text in ("threshold", "mini-dose"):
        controller = around(text)
        low, high = doses(controller, [60.0])[0], doses(controller, [120.0])[0]
        assert (float(low.insulin_mU_min), float(low.bolus_mU)) == (0.0, 0.0)
        assert (float(high.insulin_mU_min), float(high.bolus_mU), float(high.glucagon_ug)) == (10.0, 500.0, 0.0)
        eats = dataclasses.replace(seen(60.0), announced_carbs_g=jnp.asarray(30.0))
        _, decision = controller.step(controller.init(eats), eats)
        assert (float(decision.insulin_mU_min), float(decision.bolus_mU)) == (0.0, 500.0)


def test_what_is_around_passes_glucagon_on():
    inner = around("mini-dose", gl.design_open_loop(10.0))
    assert not gives_glucagon(GivesBoluses())
    for outer in (guarded(inner), paced(inner, 2.5)):
        assert gives_glucagon(outer)
    decisions = doses(paced(inner, 2.5), [60.0, 60.0, 60.0, 60.0])
    assert [float(decision.glucagon_ug) for decision in decisions] == [150.0, 0.0, 0.0, 0.0]


def guard_doses(wanted, readings, setpoint=SETPOINT, valid=None, **settings):
    controller = guarded(GivenAlways(glucagon_ug=wanted), GuardSettings(**settings), basal_mU_min=BASAL)
    step = jax.jit(controller.step)
    state = controller.init(observe(readings[0], setpoint=setpoint))
    given = []
    for number, reading in enumerate(readings):
        state, decision = step(state, observe(reading, setpoint=setpoint, valid=valid is None or valid[number]))
        given.append(float(decision.glucagon_ug))
    return np.array(given), state


@gl.plugin.pytree
class GivenAlways:
    """Asks for one amount at each sample."""

    glucagon_ug: float
    sample_time_min: float = 5.0
    gives_glucagon = True

    def init(self, observation):
        return 0.0 * observation.glucose_mg_dl

    def step(self, state, observation):
        one = jnp.ones_like(observation.glucose_mg_dl)
        return state, Decision(
            insulin_mU_min=BASAL * one, status=jnp.zeros(one.shape, int), glucagon_ug=self.glucagon_ug * one
        )


def largest(amounts, samples):
    return max(amounts[first : first + samples].sum() for first in range(amounts.size))


@pytest.mark.long
def test_no_hour_and_no_day_passes_its_cap():
    readings = np.where(np.arange(3 * 288) % 2, 60.0, 61.0)
    for wanted, hour, day in ((7.0, 100.0, 400.0), (250.0, 300.0, 1000.0), (3.0, 10_000.0, 500.0)):
        given, _ = guard_doses(wanted, readings, max_glucagon_hour_ug=hour, max_glucagon_day_ug=day)
        assert largest(given, 12) <= hour + 1e-9
        assert largest(given, 288) == pytest.approx(day)
        assert given[600:].sum() > 0.0


@pytest.mark.long
def test_there_is_no_glucagon_on_a_reading_that_is_not_one_to_act_on():
    low = np.where(np.arange(24) % 2, 60.0, 61.0)
    given, _ = guard_doses(5.0, low)
    assert np.all(given == 5.0)
    missing, _ = guard_doses(5.0, low, valid=np.arange(24) < 12)
    assert np.all(missing[12:] == 0.0)
    stuck, _ = guard_doses(5.0, np.full(24, 60.0))
    assert np.all(stuck[4:] == 0.0)
    too_fast, _ = guard_doses(5.0, [*low[:8], 20.5, *low[8:16]])
    assert too_fast[8] == 0.0
    high, _ = guard_doses(5.0, low + 40.0)
    assert np.all(high == 0.0)
    for not_possible in (np.nan, np.inf, -5.0):
        assert np.all(guard_doses(not_possible, low[:4])[0] == 0.0)


@pytest.mark.long
def test_a_memory_that_is_lost_counts_as_the_cap():
    settings, (_, state) = GuardSettings(), guard_doses(5.0, [60.0, 61.0])
    lost = dataclasses.replace(state.glucagon, hours_ug=state.glucagon.hours_ug.at[3].set(jnp.nan).at[4].set(-1.0))
    again = repaired_glucagon(dataclasses.replace(lost, newest_min=jnp.asarray(jnp.nan)), settings)
    assert again.hours_ug[3] == again.hours_ug[4] == 300.0
    assert again.newest_min == 0.0
    np.testing.assert_array_equal(repaired_glucagon(state.glucagon, settings).hours_ug, state.glucagon.hours_ug)


@pytest.mark.long
def test_the_route_of_a_pump():
    limits = GlucagonLimits()
    asked = jnp.asarray([0.4, 0.5, 0.99, 12.3, 400.0, -1.0, jnp.nan, jnp.inf])
    np.testing.assert_allclose(limits.allowed(asked), [0.0, 0.5, 0.5, 12.0, 300.0, 0.0, 0.0, 0.0])
    patient = gl.patient("wilinska-2010-glucagon")
    controller, short = GivenGlucagon(insulin_mU_min=10.0, glucagon_ug=9.0), gl.Scenario([], 30.0)
    with pytest.raises(ArgumentTypeError, match="has no route for glucagon"):
        gl.simulate(patient, controller, pump=LimitedPump(), scenario=short)
    faulty = FAULTS.choose("occlusion, start_min=0").made(inner=LimitedPump(glucagon=limits), sample_time_min=5.0)
    assert float(gl.simulate(patient, controller, pump=faulty, scenario=short).glucagon_ug[0]) == 9.0


@pytest.mark.long
def test_a_controller_that_contradicts_itself_is_refused():
    patient = gl.patient("wilinska-2010-glucagon")

    @gl.plugin.pytree
    class Silent(GivenAlways):
        gives_glucagon = False

    pump = LimitedPump(glucagon=GlucagonLimits())
    with pytest.raises(ArgumentTypeError, match="gives_glucagon contradict"):
        gl.simulate(patient, Silent(glucagon_ug=1.0), pump=pump, scenario=gl.Scenario([], 30.0))


@pytest.mark.long
def test_people_have_it_in_both_engines_as_one_person_does():
    people = virtual_people(population("wilinska2010", patient="wilinska-2010-glucagon"), 3, np.arange(12))
    patient = gl.patient("wilinska-2010-glucagon")
    controller = guarded(around("threshold", gl.design_open_loop(14.0, gl.usual_limits(patient))))
    scenario = gl.Scenario([gl.Meal(20.0, 60.0)], 600.0)
    runs = [gl.simulate_people(people, controller, scenario=scenario, engine=engine) for engine in ("native", "xla")]
    native, xla = (np.asarray(run.glucose_mg_dl) for run in runs)
    np.testing.assert_allclose(native, xla, rtol=0.0, atol=1e-9)
    alone = jax.tree.map(lambda leaf: leaf[..., 5] if jnp.ndim(leaf) else leaf, people.patient)
    trace = gl.simulate(alone, controller, scenario=scenario)
    np.testing.assert_allclose(native[:-1, 5], trace.glucose_mg_dl, rtol=0.0, atol=1e-6)
