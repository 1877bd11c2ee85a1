"""A patient of whom only the derivative is known, with its explicit integrator: alone, of the clock, and of many."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import glucoloop as gl
from glucoloop._pytree import pytree
from glucoloop.meals import HovorkaGut, Meal, Scenario, eaten
from glucoloop.meals.moments import moments_of_steps
from glucoloop.metrics.running import RunningMetrics
from glucoloop.patients import SemilinearPatient
from glucoloop.sensors import IdealSensor
from glucoloop.simulation import Adaptive, Explicit, Exponential
from glucoloop.simulation.cohort import Cohort, People
from glucoloop.simulation.explicit import fastest_rate_per_min
from glucoloop.simulation.integrators import default_integrator, plants_of_people
from glucoloop.simulation.plant import SampleGrid
from glucoloop.simulation.user_objects import goes_fast

PERSON_1 = {"clearance": 2.01, "tau_1": 49.0, "tau_2": 47.0, "p_2": 0.0106, "S": 0.000811, "GEZI": 0.0022, "EGP": 1.33}
"""Person 1 of Kanderian et al. (2009); the clearance in l/min."""
LIMITS = gl.dose_limits(max_mU_min=150.0, max_change_mU_min=100.0)
DAY = Scenario([Meal(50.0, 60.0), Meal(80.0, 362.0, 15.0), Meal(60.0, 733.3)], 1440.0)


@pytree
class Derivative:
    """A patient without any form but the derivative; its production of glucose may follow the clock."""

    constants: dict
    basal_insulin_mU_min: object
    setpoint_mg_dl: object
    more_by_day: object = 0.0

    insulin_route = "subcutaneous"
    meal_model = HovorkaGut(time_to_maximum_min=47.0, bioavailability=1.0)

    def insulin_for(self, glucose_mg_dl):
        c = self.constants
        return (c["EGP"] / glucose_mg_dl - c["GEZI"]) / c["S"] * c["clearance"]

    def steady_state(self, insulin_mU_min):
        c = self.constants
        insulin = insulin_mU_min / c["clearance"]
        glucose = c["EGP"] / (c["GEZI"] + c["S"] * insulin)
        return jnp.stack(jnp.broadcast_arrays(insulin, insulin, c["S"] * insulin, glucose))

    def derivative(self, t_min, x, inputs):
        c, (skin, plasma, effect, glucose) = self.constants, x
        made = c["EGP"] * (1.0 + self.more_by_day * jnp.sin(2.0 * jnp.pi * t_min / 1440.0))
        return jnp.stack(
            [
                (inputs.insulin_mU_min / c["clearance"] - skin) / c["tau_1"],
                (skin - plasma) / c["tau_2"],
                c["p_2"] * (c["S"] * plasma - effect),
                made - (c["GEZI"] + effect) * glucose + inputs.meal_mg_min / 253.0,
            ]
        )

    def glucose_mg_dl(self, x):
        return x[3]


def person(more_by_day=0.0, **constants):
    made = Derivative(
        constants={**PERSON_1, **constants},
        basal_insulin_mU_min=jnp.nan,
        setpoint_mg_dl=jnp.asarray(120.0),
        more_by_day=more_by_day,
    )
    return dataclasses.replace(made, basal_insulin_mU_min=jnp.asarray(made.insulin_for(120.0)))


def by(integrator, patient=None, scenario=DAY):
    controller = gl.design_pid(gl.PIDTuning(0.15, 400.0, 20.0), LIMITS)
    pump = gl.LimitedPump(limits=LIMITS)
    patient = person() if patient is None else patient
    trace = gl.simulate(patient, controller, pump=pump, scenario=scenario, integrator=integrator)
    return np.asarray(trace.fine_glucose_mg_dl)


@pytree
class Linear:
    """A patient whose equations are linear, and so solved by the matrix exponential."""

    rates: jax.Array
    basal_insulin_mU_min: jax.Array
    setpoint_mg_dl: jax.Array

    def insulin_for(self, glucose_mg_dl):
        return self.basal_insulin_mU_min

    def steady_state(self, insulin_mU_min):
        return jnp.zeros(self.rates.shape[0])

    def derivative(self, t_min, x, inputs):
        return self.rates @ x + (inputs.insulin_mU_min - self.basal_insulin_mU_min)

    def glucose_mg_dl(self, x):
        return 100.0 + x[0]


def linear(fastest):
    return Linear(
        rates=jnp.array([[-0.02, 0.01], [0.0, -fastest]]),
        basal_insulin_mU_min=jnp.asarray(10.0),
        setpoint_mg_dl=jnp.asarray(100.0),
    )


def test_a_linear_patient_is_the_matrix_exponential():
    patient, held = linear(0.3), 12.0
    trace = gl.simulate(patient, gl.design_open_loop(held), scenario=Scenario([], 120.0))
    augmented = np.zeros((3, 3))
    augmented[:2, :2], augmented[:2, 2] = patient.rates, held - 10.0
    truth = [100.0 + scipy.linalg.expm(t * augmented)[0, 2] for t in np.asarray(trace.fine_t_min)]
    assert np.ptp(truth) > 1.0
    np.testing.assert_allclose(trace.fine_glucose_mg_dl, truth, rtol=0.0, atol=1e-4)


@pytest.mark.long
def test_the_error_falls_with_the_fourth_power_of_the_step():
    truth = by(Adaptive(1e-12))
    coarse, fine = (np.max(np.abs(by(Explicit(steps)) - truth)) for steps in (1, 2))
    assert coarse < 1e-4
    assert fine < coarse / 12.0


@pytest.mark.long
@pytest.mark.parametrize(("name", "allowed"), [("hovorka-2004", 2e-3), ("parker-1999", 1e-2), ("wilinska-2010", 2e-3)])
def test_patients_with_a_faster_form_are_the_same_by_the_derivative(name, allowed):
    patient = gl.patient(name)
    controller = gl.design_pid(gl.PIDTuning(0.15, 400.0, 20.0), gl.usual_limits(patient))
    explicit, truth = (
        np.asarray(gl.simulate(patient, controller, scenario=DAY, integrator=of).fine_glucose_mg_dl)
        for of in (Explicit(), Adaptive(1e-11))
    )
    assert np.ptp(truth) > 30.0
    np.testing.assert_allclose(explicit, truth, rtol=0.0, atol=allowed)


@pytest.mark.long
def test_a_derivative_is_all_that_a_patient_needs():
    patient = person()
    assert not isinstance(patient, SemilinearPatient)
    assert isinstance(default_integrator(patient), Explicit)
    np.testing.assert_allclose(by(None), by(Adaptive(1e-11)), rtol=0.0, atol=1e-4)


@pytest.mark.long
def test_the_clock_of_the_derivative_is_the_time_of_day():
    rhythm = person(more_by_day=0.3)
    for start_min in (None, 0.0, 420.0):
        day = Scenario(DAY.meals, 1440.0, start_min=start_min)
        np.testing.assert_allclose(by(None, rhythm, day), by(Adaptive(1e-11), rhythm, day), rtol=0.0, atol=1e-3)
    night, morning = (by(None, rhythm, Scenario((), 300.0, start_min=t)) for t in (1200.0, 300.0))
    assert night[60] < 119.0 < 121.0 < morning[60]


@pytest.mark.long
def test_a_stepper_has_the_clock():
    rhythm, held = person(more_by_day=0.3), float(person().basal_insulin_mU_min)
    stepper = gl.Stepper(rhythm, start_min=420.0)
    for _ in range(12):
        stepper.step(held)
    scenario = Scenario((), 60.0, start_min=420.0)
    trace = gl.simulate(rhythm, gl.design_open_loop(held), scenario=scenario)
    np.testing.assert_allclose(stepper.glucose_mg_dl, trace.fine_glucose_mg_dl[-1], rtol=1e-13)


def test_fast_rates_get_short_steps_or_are_refused():
    assert fastest_rate_per_min(linear(10.0)) == pytest.approx(10.0)
    grid = SampleGrid(5.0, 1)
    assert Explicit().steps_per_point(linear(0.1), grid) == 2
    assert Explicit().steps_per_point(linear(10.0), grid) == 5
    trace = gl.simulate(linear(10.0), gl.design_open_loop(12.0), scenario=Scenario([], 60.0))
    assert np.all(np.abs(np.asarray(trace.fine_glucose_mg_dl) - 100.0) < 100.0)
    with pytest.raises(
        ValueError, match=r"2 steps per minute are too few for Linear, .* 10 per minute; give 5 or more"
    ):
        gl.simulate(linear(10.0), gl.design_open_loop(12.0), integrator=Explicit(2))
    with pytest.raises(
        ValueError, match=r"fastest rate of Linear at steady state is 500 per minute.* 209 steps .* adaptive"
    ):
        gl.simulate(linear(500.0), gl.design_open_loop(12.0))
    with pytest.raises(ValueError, match="steps_per_min of 0 is not possible"):
        Explicit(0)


@pytest.mark.long
def test_a_patient_that_is_traced_asks_for_its_steps():
    def highest(made, integrator):
        return jnp.max(
            gl.simulate(
                dataclasses.replace(person(), constants={**PERSON_1, "EGP": made}),
                gl.design_open_loop(20.0),
                scenario=Scenario([Meal(40.0, 20.0)], 240.0),
                integrator=integrator,
            ).fine_glucose_mg_dl
        )

    slope = jax.grad(highest)(1.33, Explicit(2))
    step = 1e-4
    rise = float(highest(1.33 + step, Explicit(2)) - highest(1.33 - step, Explicit(2)))
    assert float(slope) == pytest.approx(rise / (2.0 * step), rel=1e-4)
    with pytest.raises(TypeError, match=r"Explicit\(steps_per_min=2\)"):
        jax.grad(highest)(1.33, Explicit())


@pytest.mark.parametrize("sample_time_min", [0.5, 2.5, 7.0, 15.0])
def test_steps_end_where_glucose_is_recorded(sample_time_min):
    grid = SampleGrid(sample_time_min, 4)
    plants = plants_of_people(person(), person(), grid)
    assert plants.substeps % grid.inside_min.size == 0
    assert plants.step_min * plants.substeps == pytest.approx(sample_time_min)
    assert plants.step_min <= 0.5 + 1e-12


def test_moments_of_parts_are_those_of_the_quadratic():
    weights = np.array([3.0, -1.0, 0.4])
    parts = np.asarray(moments_of_steps(jnp.asarray(weights)[None], 4))
    np.testing.assert_allclose(parts[:, 0].mean(), weights[0], rtol=1e-14)
    # the quadratic at the ends of the parts is continuous, and at the ends of the whole that of the whole
    values = parts @ np.array([[1.0, 1.0, 1.0], [-3.0, 0.0, 3.0], [5.0, -2.5, 5.0]])
    np.testing.assert_allclose(values[1:, 0], values[:-1, 2], rtol=1e-12)
    np.testing.assert_allclose(values[0, 0], weights @ [1.0, -3.0, 5.0], rtol=1e-12)
    # and back again, also by steps of which neither ends with the other
    np.testing.assert_allclose(moments_of_steps(jnp.asarray(parts), 1), weights[None], rtol=1e-12)
    thirds = moments_of_steps(jnp.asarray(parts), 3)
    np.testing.assert_allclose(moments_of_steps(jnp.asarray(weights)[None], 3), thirds, rtol=1e-12)


def test_nonlinear_control_advances_its_model_by_the_derivative():
    model = gl.nonlinear_model(person(), sample_time_min=5.0)
    fed = jnp.array([80.0, 10.0, -4.0])
    once = model.advance_fed(model.state, model.insulin_mU_min + 20.0, fed)

    def rate(t, x):
        s = 2.0 * t / 5.0 - 1.0
        meal = fed @ jnp.array([1.0, 3.0 * s, 5.0 * (1.5 * s * s - 0.5)])
        inputs = gl.patients.Inputs(insulin_mU_min=model.insulin_mU_min + 20.0, meal_mg_min=meal)
        return np.asarray(person().derivative(0.0, x, inputs))

    truth = scipy.integrate.solve_ivp(rate, (0.0, 5.0), np.asarray(model.state), rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(once, truth, rtol=1e-8)
    np.testing.assert_allclose(model.advance(model.state, model.insulin_mU_min), model.state, rtol=1e-11)


def cohort_and_people(engine, precision="float64", more_by_day=0.0):
    """Some people who differ in three constants, each with a basal rate, and their loop over a day."""
    factors = np.linspace(0.8, 1.25, 9)
    varied = person(more_by_day, S=PERSON_1["S"] * factors, EGP=PERSON_1["EGP"] / factors**0.5, tau_1=49.0 * factors)
    nominal = person(more_by_day)
    grid = SampleGrid(5.0, 288)
    cohort = Cohort(
        nominal,
        varied,
        gl.design_pid(gl.PIDTuning(0.15, 400.0, 20.0), LIMITS),
        IdealSensor(),
        gl.LimitedPump(limits=LIMITS),
        grid,
        RunningMetrics(setpoint_mg_dl=120.0, inside_min=tuple(grid.inside_min.tolist())),
        setpoint_mg_dl=120.0,
        meals=eaten(DAY.meals),
        start_min=420.0 if more_by_day else None,
        engine=engine,
        precision=precision,
    )
    basal = np.asarray(varied.basal_insulin_mU_min)
    return varied, cohort.run(
        People(
            patient=varied,
            x=np.asarray(varied.steady_state(basal)),
            insulin_mU_min=basal,
            key=jax.random.split(jax.random.key(0), 9),
        )
    )


@pytest.mark.long
@pytest.mark.parametrize("more_by_day", [0.0, 0.3])
def test_many_people_are_each_the_simulation_of_one(more_by_day):
    varied, native = cohort_and_people("native", more_by_day=more_by_day)
    _, mapped = cohort_and_people("xla", more_by_day=more_by_day)
    np.testing.assert_allclose(native.glucose_mg_dl, mapped.glucose_mg_dl, rtol=0.0, atol=1e-9)
    day = Scenario(DAY.meals, 1440.0, start_min=420.0 if more_by_day else None)
    for i in (0, 8):
        one = jax.tree.map(lambda number, i=i: jnp.asarray(number)[i] if np.ndim(number) else number, varied)
        alone = by(None, one, day)
        np.testing.assert_allclose(native.glucose_mg_dl[:, i], alone[::5], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(alone, by(Adaptive(1e-11), one, day), rtol=0.0, atol=1e-3)


@pytest.mark.long
def test_single_precision_is_near():
    (_, double), (_, single) = (cohort_and_people("native", precision) for precision in ("float64", "float32"))
    np.testing.assert_allclose(single.glucose_mg_dl, double.glucose_mg_dl, rtol=0.0, atol=5e-3)


def test_the_exponential_integrator_names_the_others_for_a_derivative_alone():
    with pytest.raises(TypeError, match=r"Derivative has no linear driven block.*Explicit\(\)"):
        by(Exponential())
    assert not goes_fast(person())
