"""Inputs that are held over minutes: exercise and rhythms, in every loop, and nowhere else."""

import dataclasses
import functools
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop.meals import Meal, Scenario, absorb, eaten, meal_model_of
from glucoloop.metrics.running import RunningMetrics
from glucoloop.patients import Inputs, OdePatient
from glucoloop.patients.capabilities import paced
from glucoloop.patients.hovorka.patient import HovorkaPatient
from glucoloop.physiology.dawn import Dawn
from glucoloop.physiology.exercise import draw_bouts
from glucoloop.physiology.visentin2015 import PROBABILITIES, Visentin2015, patterns_of
from glucoloop.sensors import IdealSensor
from glucoloop.simulation import Adaptive, Explicit, Exponential
from glucoloop.simulation.cohort import Cohort, People
from glucoloop.simulation.explicit import plant_with
from glucoloop.simulation.integrators import default_integrator
from glucoloop.simulation.minute_inputs import PeopleMinuteInputs
from glucoloop.simulation.plant import Exogenous, MinuteInputs, SampleGrid
from glucoloop.simulation.stepper import scenario_stepper, simulate_stepped

BOUTS = (gl.Exercise(45.0, 420.0, 40.0), gl.Exercise(70.0, 1000.5, 60.0))
WITH_RHYTHMS = ("hovorka-2004", "wilinska-2010", "kanderian-2009", "uva-padova-2008")
RHYTHMS = (Visentin2015("lhl"), Dawn())


class Kanderian(OdePatient):
    """Person 1 of Kanderian et al. (2009), in whom exercise takes up glucose, and production follows the clock too."""

    nominal: ClassVar = {
        "CI": 2.01,
        "tau_1": 49.0,
        "tau_2": 47.0,
        "p_2": 0.0106,
        "S": 8.11e-4,
        "GEZI": 0.0022,
        "EGP": 1.33,
    }
    near_rest = (11.0, 11.0, 0.009, 120.0)
    near_basal_mU_min = 22.0
    insulin_route = "subcutaneous"
    takes_exercise = True
    insulin_sensitivity = ("S",)
    glucose_production: ClassVar = {"EGP": 89.0 / 253.0}

    def derivative(self, t_min, x, inputs):
        c, (skin, plasma, effect, glucose) = self.parameters, x
        made = c["EGP"] * (1.0 + 0.1 * jnp.sin(2.0 * jnp.pi * t_min / 1440.0))
        return jnp.stack(
            [
                (inputs.insulin_mU_min / c["CI"] - skin) / c["tau_1"],
                (skin - plasma) / c["tau_2"],
                c["p_2"] * (c["S"] * plasma - effect),
                made - (c["GEZI"] + effect + 1e-4 * inputs.exercise_pct) * glucose + inputs.meal_mg_min / 253.0,
            ]
        )

    def glucose_mg_dl(self, x):
        return x[3]


def day(**more):
    meals = [Meal(40.0, 435.0), Meal(60.0, 733.3)]
    return Scenario(
        **{
            "meals": meals,
            "horizon_min": 1440.0,
            "start_min": 60.0,
            "rhythms": RHYTHMS,
            "rhythm_seed": 4,
            "rhythm_person": 2,
            **more,
        }
    )


def pid(patient):
    return gl.design_pid(gl.PIDTuning(0.15, 400.0, 20.0), gl.usual_limits(patient))


def by(patient, scenario, integrator=None):
    return gl.simulate(patient, pid(patient), scenario=scenario, integrator=integrator)


@pytest.mark.long
@pytest.mark.parametrize(
    ("patient_of", "exercise"),
    [
        (lambda: Kanderian.resting_at(120.0), BOUTS),
        *((functools.partial(gl.patient, name), ()) for name in WITH_RHYTHMS),
    ],
)
def test_the_fast_integrator_is_the_adaptive_one(patient_of, exercise):
    patient = patient_of()
    fast, truth = (by(patient, day(exercise=exercise), of) for of in (None, Adaptive(1e-11)))
    plain = by(patient, day(rhythms=(), exercise=(), start_min=None, rhythm_seed=0, rhythm_person=0))
    difference = np.abs(np.asarray(fast.fine_glucose_mg_dl) - truth.fine_glucose_mg_dl)
    assert difference.max() < 0.01
    assert np.max(np.abs(np.asarray(truth.fine_glucose_mg_dl) - plain.fine_glucose_mg_dl)) > 20.0


@pytest.mark.long
def test_sensitivity_of_one_half_is_a_patient_of_half_the_sensitivity():
    person = gl.patient("hovorka-2004")

    @dataclasses.dataclass(frozen=True)
    class Half:
        def changes(self, clock_min, seed, person):
            from glucoloop.physiology.rhythm import Changes

            return Changes(sensitivity=np.full((len(clock_min), len(person)), 0.5))

    p = person.parameters
    halved = dataclasses.replace(
        person, parameters=dataclasses.replace(p, S_IT=p.S_IT / 2.0, S_ID=p.S_ID / 2.0, S_IE=p.S_IE / 2.0)
    )
    minute_inputs = gl.design_open_loop(float(person.basal_insulin_mU_min), gl.usual_limits(person))
    scenario = Scenario([Meal(30.0, 60.0)], 600.0, rhythms=[Half()])
    ours = gl.simulate(person, minute_inputs, scenario=scenario)
    grid = SampleGrid(5.0, 120)
    plant, outside = Explicit().prepare(halved, Scenario([Meal(30.0, 60.0)], 600.0).absorbed_by(person), grid)

    def one(x, entry):
        return plant.advance(x, person.basal_insulin_mU_min, entry)

    _, inside = jax.lax.scan(one, person.steady_state(person.basal_insulin_mU_min), outside)
    np.testing.assert_allclose(np.asarray(ours.fine_glucose_mg_dl)[1:], np.asarray(inside).ravel(), rtol=1e-12)


def more(person, insulin_mU_min, **changes):
    """What changes add to the derivative at steady state under a rate."""
    inputs = Inputs(insulin_mU_min=jnp.asarray(insulin_mU_min), meal_mg_min=jnp.asarray(0.0))
    x = person.steady_state(insulin_mU_min)
    return np.asarray(paced(person, **changes).derivative(0.0, x, inputs) - person.derivative(0.0, x, inputs)), x


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "glucose", "mg_per_kg"),
    [
        ("hovorka-2004", 0, 180.16 / 75.0),  # from mmol
        ("kanderian-2009", 3, 253.0 / 89.0),  # from mg/dl
        ("uva-padova-2008", 0, 1.0),  # from mg/kg
    ],
)
def test_production_that_is_added_is_a_mass_of_glucose(name, glucose, mg_per_kg):
    person = gl.patient(name)
    added, _ = more(person, 0.0, production_mg_kg_min=2.0)
    assert added[glucose] * mg_per_kg == pytest.approx(2.0)
    assert np.count_nonzero(added) == 1
    assert paced(person) is person


def test_basal_insulin_of_a_low_sensitivity_suppresses_production_less():
    """Uptake too falls with the insulin that exceeds I_b, while what k_p1 has of the person at steady state stays."""
    person = gl.patient("uva-padova-2008")
    c = {name: float(value) for name, value in person.parameters.items()}
    added, x = more(person, float(person.basal_insulin_mU_min), sensitivity=0.4)
    uptake = c["V_mx"] * (float(x[3]) / c["V_I"] - c["I_b"]) * float(x[1] / (c["K_m0"] + x[1]))
    assert added[0] == pytest.approx(0.6 * c["k_p3"] * float(x[3]) / c["V_I"])
    assert added[1] == pytest.approx(0.6 * uptake)
    assert np.count_nonzero(added) == 2


def test_pieces_of_a_run_hold_what_the_whole_run_holds():
    number, grid = np.arange(4), SampleGrid(5.0, 600, start_min=60.0)
    bouts = draw_bouts(BOUTS, 4, number, intensity_spread_pct=30.0, time_spread_min=120.0, a_day=2)
    minute_inputs = PeopleMinuteInputs(grid, bouts, (Visentin2015(), Dawn()), 4, number)
    whole = minute_inputs.of(slice(None))
    assert minute_inputs.names == whole.names == ("exercise_pct", "sensitivity", "production_mg_kg_min")
    for first in range(0, 600, 170):
        piece = slice(first, min(first + 170, 600))
        for name in minute_inputs.names:
            np.testing.assert_array_equal(getattr(minute_inputs.of(piece), name), getattr(whole, name)[piece])


def cohort(engine, precision="float64"):
    """Some people who differ in two constants, with bouts and rhythms of their own, and their run."""
    factors, number = np.linspace(0.8, 1.25, 9), np.arange(9)
    nominal, varied = (
        Kanderian.resting_at(120.0),
        Kanderian.resting_at(120.0, S=8.11e-4 * factors, tau_1=49.0 * factors),
    )
    grid = SampleGrid(5.0, 288, start_min=60.0)
    bouts = draw_bouts(BOUTS, 4, number, intensity_spread_pct=30.0, time_spread_min=120.0, a_day=2)
    minute_inputs = PeopleMinuteInputs(grid, bouts, (Visentin2015(), Dawn()), 4, number)
    made = Cohort(
        nominal,
        varied,
        pid(nominal),
        IdealSensor(),
        gl.LimitedPump(limits=gl.usual_limits(nominal)),
        grid,
        RunningMetrics(setpoint_mg_dl=120.0, inside_min=tuple(grid.inside_min.tolist())),
        setpoint_mg_dl=120.0,
        meals=eaten(day().meals),
        start_min=60.0,
        engine=engine,
        precision=precision,
        minute_inputs=minute_inputs.names,
    )
    basal = np.asarray(varied.basal_insulin_mU_min)
    rest, keys = np.asarray(varied.steady_state(basal)), jax.random.split(jax.random.key(0), 9)
    people = People(patient=varied, x=rest, insulin_mU_min=basal, key=keys, minute_inputs=minute_inputs)
    return varied, bouts, made.run(people)


@pytest.mark.long
def test_many_people_are_each_the_simulation_of_one():
    varied, bouts, native = cohort("native")
    _, _, mapped = cohort("xla")
    np.testing.assert_allclose(native.glucose_mg_dl, mapped.glucose_mg_dl, rtol=0.0, atol=1e-9)
    for i in (0, 5):
        one = jax.tree.map(lambda number, i=i: jnp.asarray(number)[i] if np.ndim(number) else number, varied)
        own = [gl.Exercise(*bout) for bout in np.stack(list(vars(bouts).values()))[..., i].T.tolist()]
        scenario = day(exercise=own, rhythms=(Visentin2015(), Dawn()), rhythm_person=i)
        alone = np.asarray(by(one, scenario).fine_glucose_mg_dl)
        np.testing.assert_allclose(native.glucose_mg_dl[:, i], alone[::5], rtol=0.0, atol=1e-9)
    _, _, single = cohort("native", "float32")
    np.testing.assert_allclose(single.glucose_mg_dl, native.glucose_mg_dl, rtol=0.0, atol=5e-3)


@pytest.mark.long
def test_a_stepper_steps_what_is_simulated():
    patient, scenario = Kanderian.resting_at(120.0), day(exercise=BOUTS)
    trace = by(patient, scenario)
    rhythm = {"rhythms": RHYTHMS, "rhythm_seed": 4, "rhythm_person": 2}
    stepper, other = (gl.Stepper(patient, start_min=60.0, **rhythm) for _ in range(2))
    glucose = []
    for index, rate in enumerate(np.asarray(trace.insulin_mU_min).tolist()):
        for meal in scenario.meals:
            if index * 5.0 <= meal.t_min < index * 5.0 + 5.0:
                stepper.eat(meal.carbs_g, meal.t_min - stepper.t_min)
        for bout in BOUTS:
            if index * 5.0 <= bout.t_min < index * 5.0 + 5.0:
                stepper.exercise(bout.intensity_pct, bout.duration_min, bout.t_min - stepper.t_min)
        glucose.append(stepper.glucose_mg_dl)
        if index == 88:  # within the first bout
            other.restore(stepper.save())
        if 88 <= index < 120:
            other.step(rate)
        stepper.step(rate)
        if index == 119:
            assert other.glucose_mg_dl == stepper.glucose_mg_dl
    np.testing.assert_allclose(glucose, trace.glucose_mg_dl, rtol=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(trace.exercise_pct), [*range(84, 92), *range(200, 213)])
    assert trace.to_polars()["exercise_pct"].sum() * 5.0 == pytest.approx(45.0 * 40.0 + 70.0 * 60.0)
    with pytest.raises(ValueError, match="exercise 5 min into a sample of 5 min is not possible"):
        stepper.exercise(50.0, 30.0, 5.0)
    with pytest.raises(ValueError, match="the equations of SorensenPatient have no exercise"):
        gl.Stepper(gl.patient()).exercise(50.0, 30.0)


@pytest.mark.long
@pytest.mark.parametrize("start_min", [None, 60.0])
def test_the_clock_of_a_stepper_goes_back_by_a_warm_up_of_any_length(start_min):
    patient, scenario = (
        Kanderian.resting_at(120.0),
        day(start_min=start_min, warm_up_min=90.0, horizon_min=300.0, meals=[Meal(40.0, 60.0)]),
    )
    trace = by(patient, scenario)
    stepper, controller = scenario_stepper(patient, None, None, scenario, sample_time_min=5.0, key=0), pid(patient)
    state = [controller.init(stepper.observation())]

    def decide(index, seen):
        del index
        state[0], decision = controller.step(state[0], seen)
        return decision

    found = simulate_stepped(stepper, scenario, decide)
    np.testing.assert_allclose(found.fine_glucose_mg_dl, trace.fine_glucose_mg_dl, rtol=1e-12)
    assert np.ptp(np.asarray(trace.fine_glucose_mg_dl)) > 5.0


def test_a_patient_that_does_not_take_an_input_refuses_it():
    patient = gl.patient()
    with pytest.raises(
        ValueError, match="the equations of SorensenPatient have no exercise, so it would change nothing"
    ):
        by(patient, Scenario([], 600.0, exercise=BOUTS[:1]))
    for rhythm, constants in ((Visentin2015(), "insulin_sensitivity"), (Dawn(), "glucose_production")):
        told = rf"SorensenPatient does not declare which of its constants are its .* \({constants}\)"
        with pytest.raises(ValueError, match=told):
            by(patient, Scenario([], 600.0, rhythms=[rhythm]))
        with pytest.raises(ValueError, match=told):
            gl.Stepper(patient, rhythms=[rhythm])
        with pytest.raises(ValueError, match=told):
            gl.optimal_doses(patient, Scenario([], 300.0, rhythms=[rhythm]))


def test_the_exponential_integrator_takes_neither():
    patient = gl.patient("hovorka-2004")
    with pytest.raises(ValueError, match="the exponential integrator has matrices for a patient whose constants stay"):
        by(patient, day(), Exponential())
    assert isinstance(default_integrator(patient), Exponential)
    assert isinstance(default_integrator(patient, minute_inputs=True), Explicit)

    class Exercising(HovorkaPatient):
        takes_exercise = True

    assert isinstance(
        default_integrator(Exercising(parameters=patient.parameters, basal_insulin_mU_min=1.0, setpoint_mg_dl=100.0)),
        Explicit,
    )


def test_what_is_not_there_is_in_no_program():
    patient = gl.patient("hovorka-2004")
    plant = plant_with(patient, 2, SampleGrid(5.0, 1))
    x, moments = patient.working_state(), jnp.zeros((10, 3))

    def operations(minute_inputs):
        outside = Exogenous(t_min=jnp.zeros(()), moments=moments, minute_inputs=minute_inputs)
        program = jax.make_jaxpr(lambda x, outside: plant.advance(x, jnp.ones(()), outside))(x, outside)
        return str(program), len(program.in_avals)

    nothing, inputs = operations(MinuteInputs())
    assert inputs == 3  # the state, the time and the moments of meals
    # the derivative of before, with two inputs, is the same program to the letter
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(MinuteInputs, "inputs", lambda self, u, m: Inputs(insulin_mU_min=u, meal_mg_min=m))
        assert operations(MinuteInputs())[0] == nothing
    assert operations(MinuteInputs(sensitivity=jnp.ones(5)))[1] == 4


@pytest.mark.long
def test_many_people_of_a_library_user_have_rhythms_of_their_own():
    people = gl.virtual_people(gl.population("boiroux2017", patient="hovorka-2004"), 3, np.arange(6))
    scenario = Scenario([], 1440.0, rhythms=[Visentin2015(day_spread_pct=0.0)])
    controller = gl.design_open_loop(6.7, gl.usual_limits(people.patient))
    run, plain = (
        gl.simulate_people(people, controller, scenario=of, seed=2) for of in (scenario, Scenario([], 1440.0))
    )
    assert run.engine == "native"
    changed = np.max(np.abs(run.glucose_mg_dl - plain.glucose_mg_dl), axis=0)
    high = patterns_of("drawn", 2, np.arange(6)) == list(PROBABILITIES).index("hhh")
    assert people.feasible.all()
    assert 0 < high.sum() < 6
    np.testing.assert_array_less(changed[high], 0.01)  # the one integrator for the other
    assert np.all(changed[~high] > 1.0)


def test_an_added_appearance_is_as_one_of_meals():
    patient = gl.patient("hovorka-2004")
    plant = plant_with(patient, 1, SampleGrid(5.0, 1))
    x, basal = patient.steady_state(patient.basal_insulin_mU_min), jnp.asarray(patient.basal_insulin_mU_min)
    by_meal = plant.step(x, jnp.zeros(()), basal, jnp.array([200.0, 0.0, 0.0]))
    by_input = plant.step(x, jnp.zeros(()), basal, jnp.zeros(3), MinuteInputs(appearance_mg_min=200.0))
    np.testing.assert_allclose(by_input, by_meal, rtol=1e-14)
    assert patient.glucose_mg_dl(by_input) > patient.glucose_mg_dl(x)


def test_the_appearance_of_people_is_held_over_each_sample():
    values = np.arange(6.0).reshape(3, 2)
    inputs = PeopleMinuteInputs(SampleGrid(5.0, 3), None, (), 0, [0, 1], values)
    assert inputs.names == ("appearance_mg_min",)
    np.testing.assert_array_equal(inputs.of(slice(1, 3)).appearance_mg_min, np.repeat(values[1:, None], 5, axis=1))
    returning = dataclasses.replace(inputs, return_mg_min=np.array([0.5, 2.0]))
    assert returning.names == ("appearance_mg_min", "return_mg_min")
    np.testing.assert_array_equal(returning.of(slice(1, 3)).return_mg_min, np.tile([0.5, 2.0], (2, 5, 1)))


@pytest.mark.parametrize("integrator", [Explicit(), Adaptive()])
def test_a_return_lessens_the_appearance_by_the_glucose_at_the_beginning_of_a_sample(integrator):
    patient, nothing = gl.patient("hovorka-2004"), eaten([])
    plant, outside = integrator.prepare(patient, absorb(meal_model_of(patient), nothing), SampleGrid(5.0, 1))
    outside = jax.tree.map(lambda values: values[0], outside)
    x, basal = patient.steady_state(patient.basal_insulin_mU_min), jnp.asarray(patient.basal_insulin_mU_min)

    def after(**inputs):
        values = {name: np.full(5, value) for name, value in inputs.items()}
        return plant.advance(x, basal, dataclasses.replace(outside, minute_inputs=MinuteInputs(**values)))[0]

    returned = after(appearance_mg_min=500.0, return_mg_min=2.0)
    np.testing.assert_allclose(
        returned, after(appearance_mg_min=500.0 - 2.0 * float(patient.glucose_mg_dl(x))), rtol=1e-9
    )
    assert patient.glucose_mg_dl(returned) < patient.glucose_mg_dl(after(appearance_mg_min=500.0))
