"""A soft floor under predicted glucose runs in native code, and decides there as everywhere."""

import numpy as np
import pytest

from glucoloop.build.random_keys import keys_of_people
from glucoloop.control import MPCTuning, design_linear_mpc
from glucoloop.meals import Meal, eaten
from glucoloop.models.state_space import step_response
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients.population import population, virtual_people
from glucoloop.pumps import LimitedPump
from glucoloop.sensors import white_noise
from glucoloop.simulation import linear_model
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.cohort import Cohort, People

PEOPLE = 6


class Nothing:
    """Keeps nothing of a loop."""

    def init(self, glucose_mg_dl, insulin_mU_min):
        return ()

    def step(self, state, happened, t_min):
        return ()


@pytest.fixture(scope="module")
def run(patient_81):
    varied = virtual_people(population("parker2000"), 1, np.arange(PEOPLE))
    known = StepResponseModel(step_response=step_response(linear_model(patient_81), 40), sample_time_min=5.0)
    people = People(
        patient=varied.patient,
        x=varied.rest,
        insulin_mU_min=varied.basal_insulin_mU_min,
        key=keys_of_people(5, varied.draw.person),
    )

    def of(engine, precision="float64", **settings):
        cohort = Cohort(
            patient_81,
            varied.patient,
            design_linear_mpc(known, MPCTuning(2, 10, 3.0, 1.0), **settings),
            white_noise(1.45),
            LimitedPump(),
            sample_grid(400.0, 5.0),
            Nothing(),
            setpoint_mg_dl=81.1,
            meals=eaten([Meal(60.0, 50.0)]),
            announced=False,
            engine=engine,
            precision=precision,
        )
        return cohort.run(people)

    return of


@pytest.mark.long
def test_native_code_keeps_a_floor_as_jax_does(run):
    native, xla = (run(engine, glucose_floor_mg_dl=72.0) for engine in ("native", "xla"))
    np.testing.assert_allclose(native.insulin_mU_min, xla.insulin_mU_min, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(native.glucose_mg_dl, xla.glucose_mg_dl, rtol=0.0, atol=1e-9)
    without = run("native", constraints="qp")
    assert np.abs(native.insulin_mU_min - without.insulin_mU_min).max() > 0.5
    single = run("native", "float32", glucose_floor_mg_dl=72.0)
    np.testing.assert_allclose(single.insulin_mU_min, native.insulin_mU_min, rtol=0.0, atol=0.01)
