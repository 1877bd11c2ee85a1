"""The last step of every controller: limits, and a status that tells how the dose came about."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.control import MPCTuning, Observation, Status
from glucoloop.control.decision import decide, delivered_since, is_known
from glucoloop.control.planning import plan_moves
from glucoloop.pumps import dose_limits

LIMITS = dose_limits(max_change_mU_min=10.0, min_mU_min=5.0, max_mU_min=60.0)


def observe(glucose=100.0, valid=True, delivered=25.0):
    return Observation(
        glucose_mg_dl=jnp.asarray(glucose),
        valid=jnp.asarray(valid),
        setpoint_mg_dl=jnp.asarray(100.0),
        delivered_mU_min=jnp.asarray(delivered),
        announced_carbs_g=jnp.asarray(0.0),
    )


def decided(wanted, delivered=25.0, known=True, converged=True):
    decision = decide(jnp.asarray(wanted), jnp.asarray(delivered), LIMITS, jnp.asarray(known), jnp.asarray(converged))
    return float(decision.insulin_mU_min), Status(int(decision.status))


@pytest.mark.parametrize(
    ("glucose", "valid", "known"),
    [(100.0, True, True), (-5.0, True, True), (100.0, False, False)]
    + [(nonsense, valid, False) for nonsense in (np.nan, np.inf, -np.inf) for valid in (True, False)],
)
def test_a_reading_is_known_if_it_is_a_number_that_the_sensor_stands_by(glucose, valid, known):
    assert bool(is_known(observe(glucose, valid))) is known


@pytest.mark.parametrize(("told", "taken"), [(30.0, 30.0), (0.0, 0.0), (np.nan, 25.0), (np.inf, 25.0)])
def test_the_pumps_word_counts_unless_it_is_no_number(told, taken):
    assert float(delivered_since(observe(delivered=told), jnp.asarray(25.0))) == taken


@pytest.mark.parametrize(
    ("arguments", "dose", "status"),
    [
        ({"wanted": 30.0}, 30.0, Status.OK),
        ({"wanted": 35.0}, 35.0, Status.OK),
        ({"wanted": 35.1}, 35.0, Status.SATURATED),
        ({"wanted": 14.0}, 15.0, Status.SATURATED),
        ({"wanted": 4.0, "delivered": 8.0}, 5.0, Status.SATURATED),
        ({"wanted": 64.0, "delivered": 58.0}, 60.0, Status.SATURATED),
        ({"wanted": 1e300}, 35.0, Status.SATURATED),
        ({"wanted": 30.0, "known": False}, 30.0, Status.READING_MISSING),
        ({"wanted": 90.0, "known": False}, 35.0, Status.READING_MISSING),
        ({"wanted": 30.0, "converged": False}, 30.0, Status.NOT_CONVERGED),
        ({"wanted": 30.0, "converged": False, "known": False}, 30.0, Status.READING_MISSING),
        ({"wanted": np.nan}, 25.0, Status.NON_FINITE),
        ({"wanted": np.inf, "known": False, "converged": False}, 25.0, Status.NON_FINITE),
        ({"wanted": -np.inf, "delivered": 3.0}, 5.0, Status.NON_FINITE),
    ],
)
def test_doses_and_statuses(arguments, dose, status):
    assert decided(**arguments) == (dose, status)


def test_rounding_at_a_limit_is_no_saturation():
    for wanted, delivered in ((0.1 + 0.2 + 9.7, 0.3 - 0.3), (35.0 + 4e-15, 25.0), (60.0 + 1e-12, 55.0)):
        _, status = decided(wanted, delivered + 0.0)
        assert status is Status.OK


@given(st.floats(), st.floats(5.0, 60.0), st.booleans(), st.booleans())
def test_whatever_is_wanted_the_dose_keeps_the_limits(wanted, delivered, known, converged):
    dose, status = decided(wanted, delivered, known, converged)
    assert 5.0 <= dose <= 60.0
    assert abs(dose - delivered) <= 10.0 + 1e-13 * delivered
    if status is Status.OK:
        assert dose == pytest.approx(wanted, abs=1e-9)
    elif status is Status.NON_FINITE:
        assert not np.isfinite(wanted)
        assert dose == delivered


def test_a_program_without_a_finite_gradient_has_not_converged():
    plan = plan_moves(np.array([-1.0, -2.0, -3.0]), MPCTuning(2, 3), LIMITS, "qp")
    move, converged = plan.first_move(jnp.full(3, 1e308), jnp.asarray(25.0))
    dose, status = decided(25.0 + float(move), converged=bool(converged))
    assert status is Status.NOT_CONVERGED
    assert 15.0 <= dose <= 35.0


def test_every_status_is_told_in_sentences_of_its_own():
    texts = [status.text for status in Status]
    assert len(set(texts)) == len(Status)
    for text in texts:
        assert text[0].isupper()
        assert text.endswith(".")
        assert len(text.split()) > 4
    # all but the ordinary one say what to do
    assert all("check" in text.lower() for text in texts[1:])
