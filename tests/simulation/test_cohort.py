"""The loop of many people at once is the loop of each of them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree
from glucoloop.build.random_keys import keys_of_people
from glucoloop.control import (
    MPCTuning,
    StateTuning,
    design_linear_mpc,
    design_meal_mpc,
    design_mpc_se,
    design_nlqdmc_se,
)
from glucoloop.meals import Eaten, HovorkaGut, Meal, Scenario, absorb, eaten
from glucoloop.metrics import summarise
from glucoloop.metrics.running import RunningMetrics
from glucoloop.models.state_space import step_response
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients import patient
from glucoloop.patients.population import Population, population, virtual_people
from glucoloop.patients.variation import Variation
from glucoloop.pumps import LimitedPump, with_resolution
from glucoloop.sensors import IdealSensor, dead_time, white_noise
from glucoloop.simulation import Adaptive, linear_model, nonlinear_model, simulate
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.cohort import Cohort, People
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.simulation.exponential import ExponentialPlant, design, substeps_of
from glucoloop.simulation.loop import Loop, begin, sample
from glucoloop.simulation.people_plant import PER_NOMINAL
from glucoloop.simulation.plant import Exogenous

PEOPLE = 20
DAY, SHORT = sample_grid(1440.0, 5.0), sample_grid(400.0, 5.0)
MEALS = Meal(60.0, 407.3), Meal(80.0, 733.1), Meal(70.0, 1080.7)
SETPOINT = 81.1
TRANSPORT = Population(
    "transport",
    tuple(
        Variation(parameter=name, distribution="uniform", spread_pct=30.0)
        for name in ("q_B", "q_K", "v_H", "v_L", "v_PI", "T_P", "V_H", "Q_P", "F_LC", "M_IPGU.strength", "tau_I")
    ),
)


@pytree
class Lowest:
    """A small fold: the minimum glucose on the fine grid, and what was announced."""

    def init(self, glucose_mg_dl, insulin_mU_min):
        return glucose_mg_dl, jnp.zeros_like(insulin_mU_min)

    def step(self, state, happened, t_min):
        lowest, when = state
        least = happened.inside_mg_dl.min()
        return jnp.minimum(lowest, least), jnp.where(least < lowest, t_min, when)


@pytree
class Announced:
    """A controller that adds to another's dose what a meal that is announced calls for."""

    inner: object
    mU_min_per_g: object = 0.1

    @property
    def sample_time_min(self):
        return self.inner.sample_time_min

    def init(self, observation):
        return self.inner.init(observation), observation.announced_carbs_g

    def step(self, state, observation):
        state, decision = self.inner.step(state[0], observation)
        more = self.mU_min_per_g * observation.announced_carbs_g
        return (state, observation.announced_carbs_g), dataclasses.replace(
            decision, insulin_mU_min=decision.insulin_mU_min + more
        )


@pytree
class Fed:
    """A patient with a gut of its own."""

    inner: object
    meal_model: object

    def __getattr__(self, name):
        return getattr(object.__getattribute__(self, "inner"), name)


@pytest.fixture(scope="module")
def nominal(patient_81):
    return patient_81


@pytest.fixture(scope="module")
def varied():
    return virtual_people(population("parker2000"), 1, np.arange(PEOPLE))


@pytest.fixture(scope="module")
def model(nominal):
    return linear_model(nominal)


@pytest.fixture(scope="module")
def mpc(model):
    known = StepResponseModel(step_response=step_response(model, 40), sample_time_min=5.0)
    return design_linear_mpc(known, MPCTuning(2, 8, 1.0, 0.0))


@pytest.fixture(scope="module")
def mpc_se(model):
    tuning = StateTuning(2, 8, 1.0, 1.0, 0.65)
    return Announced(inner=design_mpc_se(model, np.repeat([0.9, 0.01, 0.005], [8, 9, 2]), tuning))


def people_of(virtual, **more):
    return People(
        patient=virtual.patient,
        x=virtual.rest,
        insulin_mU_min=virtual.basal_insulin_mU_min,
        key=keys_of_people(5, virtual.draw.person),
        **more,
    )


def person(tree, i):
    return jax.tree.map(lambda a: jnp.asarray(a)[..., i] if jnp.ndim(a) else jnp.asarray(a, float), tree)


def plant_of(nominal, patient, grid):
    """A person with the matrices of insulin designed for him alone, and the slow block as the cohort has it."""
    h, dense = substeps_of(grid, PER_NOMINAL)
    common = design(nominal, h, dense, nominal.working_state(), nominal.stiff_couplings())
    own = design(patient, h, dense, nominal.working_state())
    matrices = dataclasses.replace(common, driven_end=own.driven_end, driven_gauss=own.driven_gauss)
    return ExponentialPlant(patient=patient, matrices=matrices)


@jax.jit
def plain_scan(loop, x, insulin, key, moments, told):
    """Glucose, insulin and the minimum glucose between samples of one person."""
    state, reading_key = begin(loop, x, insulin, told[0], key)

    def on(state, entry):
        moments, announced, index = entry
        outside = Exogenous(t_min=5.0 * index, moments=moments)
        state, happened = sample(loop, state, outside, announced, reading_key, index)
        return state, (happened.glucose_mg_dl, happened.delivery.insulin_mU_min, happened.inside_mg_dl)

    last, (glucose, insulin, inside) = jax.lax.scan(on, state, (moments, told, jnp.arange(told.shape[0])))
    return jnp.append(glucose, loop.plant.patient.glucose_mg_dl(last.x)), insulin, inside.min()


def day_cohort(nominal, virtual, controller, accumulator=None, **options):
    accumulator = Lowest() if accumulator is None else accumulator
    return Cohort(
        nominal,
        virtual.patient,
        controller,
        IdealSensor(),
        LimitedPump(),
        DAY,
        accumulator,
        setpoint_mg_dl=SETPOINT,
        meals=eaten(MEALS),
        **options,
    )


METRICS = RunningMetrics(setpoint_mg_dl=SETPOINT, inside_min=tuple(DAY.inside_min.tolist()))


@pytest.fixture(scope="module")
def day(nominal, varied, mpc):
    """A day of linear MPC in both precisions: cohorts and runs."""
    cohorts = {p: day_cohort(nominal, varied, mpc, METRICS, precision=p) for p in ("float64", "float32")}
    assert all(cohort.engine == "native" and cohort.precision == p for p, cohort in cohorts.items())
    return cohorts, {p: cohort.run(people_of(varied)) for p, cohort in cohorts.items()}


@pytest.mark.long
def test_portable_arithmetic_changes_glucose_by_rounding_alone(day, nominal, varied, mpc):
    _, runs = day
    portable = day_cohort(nominal, varied, mpc, METRICS, products="strict").run(people_of(varied))
    fused = runs["float64"].glucose_mg_dl
    assert (portable.glucose_mg_dl != fused).any()
    np.testing.assert_allclose(portable.glucose_mg_dl, fused, rtol=0.0, atol=1e-8)


def finished(run):
    return METRICS.finish(run.accumulator, samples=DAY.samples, sample_time_min=5.0, meal_t_min=405.0)


@pytest.fixture(scope="module")
def reference(varied, mpc):
    """The same day of each person by the adaptive method."""
    scenario = Scenario(MEALS, 1440.0)
    return [
        simulate(person(varied.patient, i), mpc, scenario=scenario, integrator=Adaptive(1e-10)) for i in range(PEOPLE)
    ]


@pytest.mark.long
def test_a_day_under_feedback_is_that_of_the_adaptive_method(day, reference):
    _, runs = day
    errors = []
    for i, trace in enumerate(reference):
        found = runs["float64"].glucose_mg_dl[:-1, i]
        errors.append(np.abs(found - np.asarray(trace.glucose_mg_dl)).max())
        assert np.ptp(np.asarray(trace.insulin_mU_min)) > 10.0
    assert max(errors) < 1e-3, max(errors)


@pytest.mark.long
def test_metrics_of_the_day_are_those_of_the_adaptive_trace(day, reference):
    found = finished(day[1]["float64"])
    for i, trace in enumerate(reference):
        expected = summarise(trace)
        assert found.names == expected.names
        for name in expected.names:
            a, b = (np.asarray(getattr(m, name), float) for m in (found, expected))
            assert a[i] == pytest.approx(float(b), rel=1e-4, abs=2e-3), name


@pytest.mark.long
def test_single_precision_is_near_enough(day):
    _, runs = day
    single, double = runs["float32"], runs["float64"]
    assert single.glucose_mg_dl.dtype == np.float32
    np.testing.assert_allclose(single.glucose_mg_dl, double.glucose_mg_dl, rtol=0.0, atol=1e-2)
    a, b = finished(single), finished(double)
    for name in ("minimum_mg_dl", "peak_mg_dl", "mean_mg_dl", "undershoot_mg_dl", "lbgi", "hbgi"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0.0, atol=0.1, err_msg=name)


@pytest.mark.long
def test_everybody_is_himself_among_others(day, varied):
    cohort, run = day[0]["float64"], day[1]["float64"]
    numbers = np.random.default_rng(0).permutation(PEOPLE)
    numbers[3:6] = 7
    some = People(
        patient=jax.tree.map(lambda a: a[numbers] if jnp.ndim(a) else a, varied.patient),
        x=varied.rest[:, numbers],
        insulin_mU_min=varied.basal_insulin_mU_min[numbers],
        key=keys_of_people(5, numbers),
    )
    again = cohort.run(some, threads=2)
    np.testing.assert_array_equal(again.glucose_mg_dl, run.glucose_mg_dl[:, numbers])
    np.testing.assert_array_equal(again.insulin_mU_min, run.insulin_mU_min[:, numbers])
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, b[numbers]), again.accumulator, run.accumulator)


@pytest.mark.long
def test_somebody_who_cannot_rest_spoils_nobody(day, varied):
    cohort, run = day[0]["float64"], day[1]["float64"]
    rest, basal = varied.rest.copy(), varied.basal_insulin_mU_min.copy()
    rest[:, 4], basal[4] = np.nan, np.nan
    again = cohort.run(dataclasses.replace(people_of(varied), x=rest, insulin_mU_min=basal))
    others = np.arange(PEOPLE) != 4
    np.testing.assert_array_equal(again.glucose_mg_dl[:, others], run.glucose_mg_dl[:, others])
    assert np.isnan(again.glucose_mg_dl[:, 4]).all()


@pytest.fixture(scope="module")
def own_meals():
    rng = np.random.default_rng(3)
    t_min, carbs_g = rng.uniform(0.0, 390.0, (3, PEOPLE)), rng.uniform(1.0, 60.0, (3, PEOPLE))
    t_min[0] = 0.0  # announced before the first sample
    eating_min = np.array([0.0, 12.0, 45.0])[:, None] + np.zeros(PEOPLE)
    return Eaten(t_min=t_min, carbs_g=carbs_g, eating_min=eating_min)


@pytest.fixture(scope="module")
def guts():
    rng = np.random.default_rng(4)
    return HovorkaGut(
        time_to_maximum_min=rng.uniform(20.0, 70.0, PEOPLE), bioavailability=rng.uniform(0.7, 1.0, PEOPLE)
    )


@pytest.fixture(scope="module")
def noisy(nominal, varied, mpc_se, own_meals, guts):
    """MPC/SE with individual basal rates; noise, dead time, individual guts and announced meals; by both engines."""
    own = dataclasses.replace(mpc_se, inner=mpc_se.inner.with_basal(jnp.asarray(varied.basal_insulin_mU_min)))
    fed = Fed(inner=varied.patient, meal_model=guts)
    people = dataclasses.replace(people_of(varied, controller=own, meals=own_meals), patient=fed)
    made = {
        engine: Cohort(
            Fed(inner=nominal, meal_model=HovorkaGut()),
            fed,
            mpc_se,
            dead_time(2, white_noise()),
            with_resolution(0.5),
            SHORT,
            Lowest(),
            setpoint_mg_dl=SETPOINT,
            meals=None,
            announced=True,
            varied_controller=own,
            engine=engine,
        )
        for engine in ("native", "xla")
    }
    return people, made, {engine: cohort.run(people) for engine, cohort in made.items()}


@pytest.mark.long
def test_each_person_is_a_plain_scan_of_his_own_loop(noisy, nominal, varied, mpc_se, own_meals, guts):
    people, _, runs = noisy
    for i in (0, 7, 13, 19):
        meals = jax.tree.map(lambda part, i=i: part[:, i], own_meals)
        told = np.zeros(SHORT.samples)
        np.add.at(told, (meals.t_min // 5.0).astype(int), meals.carbs_g)
        basal = jnp.asarray(varied.basal_insulin_mU_min[i])
        loop = Loop(
            plant=plant_of(nominal, person(varied.patient, i), SHORT),
            controller=dataclasses.replace(mpc_se, inner=mpc_se.inner.with_basal(basal)),
            sensor=dead_time(2, white_noise()),
            pump=with_resolution(0.5),
            setpoint_mg_dl=jnp.asarray(SETPOINT),
        )
        moments = absorb(person(guts, i), meals).moments(SHORT.samples, PER_NOMINAL, 5.0 / PER_NOMINAL)
        glucose, insulin, lowest = plain_scan(loop, varied.rest[:, i], basal, people.key[i], moments, told)
        assert np.ptp(np.asarray(insulin)) > 1.0
        for run in runs.values():
            np.testing.assert_allclose(run.glucose_mg_dl[:, i], glucose, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(run.insulin_mU_min[:, i], insulin, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(run.accumulator[0][i], lowest, rtol=0.0, atol=1e-9)


@pytest.mark.long
def test_both_engines_agree(noisy):
    _, made, runs = noisy
    assert [made[engine].engine for engine in ("native", "xla")] == ["native", "xla"]
    np.testing.assert_allclose(runs["native"].glucose_mg_dl, runs["xla"].glucose_mg_dl, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(runs["native"].insulin_mU_min, runs["xla"].insulin_mU_min, rtol=0.0, atol=1e-9)
    for a, b in zip(*(jax.tree.leaves(run.accumulator) for run in runs.values()), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-9)


def linearising():
    nominal = patient("hovorka-2004")
    model = nonlinear_model(nominal)
    controller = design_nlqdmc_se(model, np.full(model.state.size, 0.01), StateTuning(2, 31, 1.0, 1.0, 0.57))
    return nominal, population("boiroux2017", patient="hovorka-2004"), controller


def meal_aware():
    """It has loops that native code keeps."""
    nominal = patient()
    return nominal, population("parker2000"), design_meal_mpc(nonlinear_model(nominal))


@pytest.mark.long
@pytest.mark.parametrize("designed", [linearising, meal_aware])
def test_a_controller_that_linearises_at_each_sample_is_the_same_by_both_engines(designed):
    """In readings with noise; and in float32 to .1 mg/dl."""
    nominal, drawn, controller = designed()
    varied, runs = virtual_people(drawn, 1, np.arange(PEOPLE)), {}
    for engine, precision in (("native", "float64"), ("xla", "float64"), ("native", "float32")):
        made = Cohort(
            nominal,
            varied.patient,
            controller,
            white_noise(),
            LimitedPump(),
            SHORT,
            Lowest(),
            setpoint_mg_dl=nominal.setpoint_mg_dl,
            meals=eaten([Meal(60.0, 47.3)]),
            engine=engine,
            precision=precision,
        )
        runs[engine, precision] = made.run(people_of(varied))
    native, mapped, single = runs.values()
    assert np.ptp(np.asarray(native.insulin_mU_min)) > 1.0
    for name in ("glucose_mg_dl", "insulin_mU_min"):
        np.testing.assert_allclose(getattr(native, name), getattr(mapped, name), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(single.glucose_mg_dl, native.glucose_mg_dl, rtol=0.0, atol=0.1)


@pytest.mark.long
def test_the_last_glucose_is_computed_while_no_other_thread_computes(noisy, monkeypatch):
    people, made, _ = noisy
    cohort = made["native"]
    last = cohort._end_people

    def alone(*given):
        assert one_at_a_time._is_owned()  # two programs of JAX in two threads can wait for one another without end
        return last(*given)

    monkeypatch.setattr(cohort, "_end_people", alone)
    cohort.run(people)


@pytest.mark.long
def test_a_controller_of_ones_own_is_ones_own(noisy, nominal):
    """Somebody with the nominal patient's basal rate in his controller doses otherwise."""
    people, made, runs = noisy
    inner = people.controller.inner
    others = jnp.full(PEOPLE, nominal.basal_insulin_mU_min)
    controller = dataclasses.replace(people.controller, inner=inner.with_basal(others))
    again = made["native"].run(dataclasses.replace(people, controller=controller))
    assert np.abs(again.insulin_mU_min - runs["native"].insulin_mU_min).max(axis=0).min() > 0.01


@pytest.mark.long
def test_meals_of_ones_own_are_asked_for(noisy):
    people, made, _ = noisy
    with pytest.raises(TypeError, match="made for people with meals of their own; give meals"):
        made["native"].run(dataclasses.replace(people, meals=None))


@pytest.mark.long
def test_people_whose_volumes_and_flows_differ(nominal, mpc):
    """Their glucose transport is not that of the exponentials; the difference is integrated with the rest."""
    virtual = virtual_people(TRANSPORT, 2, np.arange(8))
    assert virtual.feasible.all()
    run = day_cohort(nominal, virtual, mpc).run(people_of(virtual))
    scenario = Scenario(MEALS, 1440.0)
    errors = []
    for i in range(4):
        one = person(virtual.patient, i)
        trace = simulate(one, mpc, scenario=scenario, integrator=Adaptive(1e-10))
        errors.append(np.abs(run.glucose_mg_dl[:-1, i] - np.asarray(trace.glucose_mg_dl)).max())
    assert max(errors) < 1e-2, errors


@pytest.mark.long
def test_unknown_engines_are_refused(nominal, varied, mpc):
    with pytest.raises(ValueError, match="unknown engine 'gpu'; the known ones are: native, xla"):
        day_cohort(nominal, varied, mpc, engine="gpu")


@pytest.mark.long
def test_native_code_that_is_not_possible_is_refused_and_else_not_taken(nominal, varied):
    @pytree
    class Sorting:
        sample_time_min = 5.0

        def init(self, observation):
            return observation.delivered_mU_min

        def step(self, state, observation):
            from glucoloop.control import Decision

            return state, Decision(insulin_mU_min=jnp.sort(jnp.stack([state, state]))[0], status=jnp.asarray(0))

    with pytest.raises(
        ValueError, match="native code cannot take this loop, which has the operation 'sort' in the controller; use xla"
    ):
        day_cohort(nominal, varied, Sorting(), engine="native")
    with pytest.raises(
        ValueError, match="'sort' in the controller, and no other engine has portable arithmetic; use fused arithmetic"
    ):
        day_cohort(nominal, varied, Sorting(), products="strict")
    with pytest.raises(ValueError, match="the engine xla has no portable arithmetic; use native code"):
        day_cohort(nominal, varied, Sorting(), engine="xla", products="strict")
    mapped = day_cohort(nominal, varied, Sorting())
    assert (mapped.engine, mapped.not_native) == ("xla", "the operation 'sort' in the controller")
    assert day_cohort(nominal, varied, Sorting(), engine="xla").not_native is None
