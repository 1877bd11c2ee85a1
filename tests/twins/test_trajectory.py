"""The simulation of a twin: against the closed loop of the same person, and its Jacobian against differences."""

import numpy as np
import pytest

from glucoloop.patients.population import population
from glucoloop.twins import Simulator, prior_of, recorded_days
from lived_records import lived

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def person():
    """A person with the true coordinates, and the simulator of a record that was read without error."""
    people = population("boiroux2017", patient="hovorka-2004")
    record, truth = lived("hovorka-2004", "boiroux2017", 3, days=2, sensor=(), time_spread_min=0.0)
    prior = prior_of(people)
    simulator = Simulator.of(people, prior, recorded_days(record))
    return simulator, np.append(prior.coordinates(truth), 0.0)


def test_the_true_person_has_the_recorded_glucose(person):
    simulator, z = person
    days = simulator.days
    course = days.at_readings(simulator.glucose_mg_dl(z[None]), np.ones(days.reading_min.size, bool))[0]
    assert np.abs(course - days.reading_mg_dl).max() < 0.5


def test_the_jacobian_is_that_of_differences(person):
    simulator, z = person
    glucose, jacobian = simulator.with_jacobian(z[None])
    assert glucose == pytest.approx(simulator.glucose_mg_dl(z[None]), abs=1e-9)
    step = 1e-5
    ends = simulator.glucose_mg_dl(z + step * np.vstack([np.eye(z.size), -np.eye(z.size)]))
    assert jacobian[0].T == pytest.approx((ends[: z.size] - ends[z.size :]) / (2.0 * step), abs=1e-4)
