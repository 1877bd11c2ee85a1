"""The paper's mealuntil it is over, and the best doses for it; worked out once."""

import pytest

import glucoloop as gl
from glucoloop.bounds import optimal_doses


@pytest.fixture(scope="session")
def scenario():
    return gl.Scenario([gl.Meal(50.0, 20.0)], 200.0)


@pytest.fixture(scope="session")
def best(scenario):
    """The best plan, by when the meal is known."""
    known = {}

    def plan(known_after_min):
        if known_after_min not in known:
            known[known_after_min] = optimal_doses(gl.patient(), scenario, known_after_min=known_after_min)
        return known[known_after_min]

    return plan
