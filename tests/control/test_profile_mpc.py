"""The controller by profile on the patient of Hovorka et al. (2004)."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import glucoloop as gl
from glucoloop._pytree import pytree
from glucoloop.control.profile_mpc import ProfileMPC, steps_ahead
from glucoloop.control.protocol import Status, computed_settings
from glucoloop.meals import Scenario
from glucoloop.pumps import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS
from glucoloop.simulation import linear_model, nonlinear_model, simulate
from glucoloop.therapy import Profile
from observing import observing_meals

PATIENT = gl.patient("hovorka-2004")
BASAL = float(PATIENT.basal_insulin_mU_min)


@functools.cache
def models():
    return nonlinear_model(PATIENT), linear_model(PATIENT)


def designed(profile, **settings):
    return ProfileMPC(**settings).of_model(*models(), profile, PARKER_1999_LIMITS, DEFAULT_BOLUS_LIMITS)


PROFILE = Profile(basal_mU_min=BASAL, setpoint_mg_dl=120.0, carb_ratio_g_U=20.0, correction_mg_dl_U=60.0)


@pytest.fixture(scope="module")
def controller():
    return designed(PROFILE)


step = jax.jit(lambda controller, state, observation: controller.step(state, observation))


seen = observing_meals(120.0, BASAL)


def after(controller, *observations):
    """Decision at the last of some observations."""
    state = controller.init(observations[0])
    for observation in observations:
        state, decision = step(controller, state, observation)
    return decision


@pytest.mark.long
def test_rest_is_held(controller):
    decision = after(controller, *[seen()] * 4)
    assert float(decision.insulin_mU_min) == pytest.approx(BASAL, rel=1e-6)
    assert float(decision.bolus_mU) == 0.0
    assert int(decision.status) == Status.OK


@pytest.mark.long
def test_a_day_without_meals_stays_where_it_began():
    trace = simulate(
        PATIENT, designed(Profile(basal_mU_min=BASAL, setpoint_mg_dl=120.0)), scenario=Scenario([], 1440.0)
    )
    np.testing.assert_allclose(trace.glucose_mg_dl, 120.0, atol=0.5)
    np.testing.assert_allclose(trace.insulin_mU_min, BASAL, rtol=0.02)


def test_an_announced_meal_gets_a_bolus_by_the_ratio(controller):
    for carbs_g in (30.0, 60.0):
        decision = after(controller, seen(), seen(carbs_g=carbs_g))
        by_ratio_mU = 1000.0 * carbs_g / 20.0
        assert 0.5 * by_ratio_mU < float(decision.bolus_mU) < 1.5 * by_ratio_mU
        # more at once than the ratio has it is taken from the rate that follows
        assert float(decision.insulin_mU_min) < BASAL


def test_boluses_follow_the_persons_own_ratio(controller):
    """People who need more of all insulin by a factor get boluses that are larger by this factor."""
    several, boluses = (8.0, 16.0, 32.0), []
    for ratio in several:
        basal = BASAL * 16.0 / ratio
        profile = Profile(
            basal_mU_min=basal, setpoint_mg_dl=120.0, carb_ratio_g_U=ratio, correction_mg_dl_U=3.0 * ratio
        )
        rest, meal = seen(delivered=basal), seen(delivered=basal, carbs_g=40.0)
        boluses.append(float(after(controller.with_profile(profile), rest, meal).bolus_mU))
    for bolus_mU, ratio in zip(boluses, several, strict=True):
        assert bolus_mU * ratio == pytest.approx(boluses[1] * 16.0, rel=0.02)


def test_people_are_given_the_gains_of_their_profiles(controller):
    told = computed_settings(controller)
    assert told["insulin_gain"] == pytest.approx(60.0 / float(controller.model.own_correction_mg_dl_U))
    assert told["believed_correction_mg_dl_U"] == pytest.approx(60.0)
    assert told["believed_carb_ratio_g_U"] == pytest.approx(20.0)
    many = controller.with_profile(Profile(basal_mU_min=jnp.array([5.0, 10.0]), setpoint_mg_dl=120.0))
    np.testing.assert_allclose(many.model.insulin_gain, [BASAL / 5.0, BASAL / 10.0])


@pytree
class ShiftedModel:
    """A model that takes the same insulin for less than it is: another basal rate for the same person at rest."""

    model: object
    less_mU_min: float

    @property
    def sample_time_min(self):
        return self.model.sample_time_min

    @property
    def state(self):
        return self.model.state

    @property
    def insulin_mU_min(self):
        return self.model.insulin_mU_min - self.less_mU_min

    def derivative(self, x, insulin_mU_min):
        return self.model.derivative(x, insulin_mU_min + self.less_mU_min)

    def glucose_mg_dl(self, x):
        return self.model.glucose_mg_dl(x)


def total_mU(decision):
    return 5.0 * float(decision.insulin_mU_min) + float(decision.bolus_mU)


@pytest.mark.long
def test_doses_do_not_depend_on_the_basal_rate_of_the_nominal_person(controller):
    """Insulin that does the same to a person is given alike, whatever part of it the model calls the basal rate."""
    nonlinear, linear = models()
    other = ProfileMPC().of_model(
        ShiftedModel(model=nonlinear, less_mU_min=0.5 * BASAL),
        linear,
        PROFILE,
        PARKER_1999_LIMITS,
        DEFAULT_BOLUS_LIMITS,
    )
    for glucose in ((120.0, 124.0, 132.0, 144.0, 158.0), (150.0, 152.0, 156.0)):
        decision, same = (after(one, *[seen(reading) for reading in glucose]) for one in (controller, other))
        assert float(decision.bolus_mU) > 50.0
        # the titration of either model, by an hour of its basal rate, finds almost the same factor
        assert total_mU(same) == pytest.approx(total_mU(decision), rel=0.03)


@pytest.mark.parametrize("glucose", [90.0, 150.0, 200.0])
def test_a_person_who_begins_away_from_the_target_is_corrected_by_the_factor(controller, glucose):
    """No meal is made of the distance: the first dose is at most the correction, and what follows is less."""
    state, delivered, bolus_mU, extra_mU = controller.init(seen(glucose)), BASAL, 0.0, []
    for _ in range(4):
        state, decision = step(controller, state, seen(glucose, delivered=delivered, bolus_mU=bolus_mU))
        delivered, bolus_mU = float(decision.insulin_mU_min), float(decision.bolus_mU)
        extra_mU.append(5.0 * (delivered - BASAL) + bolus_mU)
    correction_mU = 1000.0 * (glucose - 120.0) / 60.0
    if glucose < 120.0:
        assert max(extra_mU) <= 0.0
    else:
        assert 0.3 * correction_mU < extra_mU[0] <= correction_mU
        assert max(extra_mU[1:]) < 0.5 * extra_mU[0]


def test_low_glucose_gets_no_insulin(controller):
    falling = [seen(glucose) for glucose in (120.0, 112.0, 104.0, 96.0, 88.0, 80.0, 72.0, 64.0)]
    decision = after(controller, *falling)
    assert float(decision.insulin_mU_min) == 0.0
    assert float(decision.bolus_mU) == 0.0


def test_glucose_that_rises_gets_insulin_unless_it_was_given_already(controller):
    rising = [seen(glucose) for glucose in (120.0, 124.0, 132.0, 144.0, 158.0)]
    wanting = after(controller, *rising)
    assert float(wanting.bolus_mU) > 100.0
    given = [*rising[:-1], seen(158.0, bolus_mU=8000.0)]
    assert float(after(controller, *given).bolus_mU) == 0.0


@pytest.mark.long
def test_without_automatic_boluses_only_the_rate_answers_a_rise():
    controller = designed(PROFILE, automatic_boluses=False)
    decision = after(controller, *[seen(glucose) for glucose in (120.0, 124.0, 132.0, 144.0, 158.0)])
    assert float(decision.bolus_mU) == 0.0
    assert float(decision.insulin_mU_min) > 2.0 * BASAL
    assert float(after(controller, seen(), seen(carbs_g=50.0)).bolus_mU) > 1000.0


@pytest.mark.parametrize("carbs_g", [np.nan, -5.0, 2000.0])
def test_meals_that_are_not_possible_are_not_heard(controller, carbs_g):
    wanted, found = after(controller, seen(), seen()), after(controller, seen(), seen(carbs_g=carbs_g))
    assert float(found.insulin_mU_min) == pytest.approx(float(wanted.insulin_mU_min))
    assert float(found.bolus_mU) == 0.0


def test_a_missing_reading_is_told(controller):
    assert int(after(controller, seen(), seen(np.nan, valid=False)).status) == Status.READING_MISSING


@pytest.mark.long
def test_a_bolus_that_the_pump_does_not_report_is_the_one_asked_for(controller):
    meal = seen(carbs_g=60.0)
    state, first = step(controller, controller.init(meal), meal)
    reported = seen(125.0, bolus_mU=float(first.bolus_mU), delivered=float(first.insulin_mU_min))
    silent = dataclasses.replace(reported, delivered_bolus_mU=jnp.asarray(-1.0), delivered_mU_min=jnp.asarray(np.nan))
    wanted, found = (step(controller, state, observation)[0] for observation in (reported, silent))
    np.testing.assert_allclose(found.estimate.x, wanted.estimate.x, rtol=1e-12)


def with_time(in_min, **more):
    return dataclasses.replace(seen(**more), announced_in_min=jnp.asarray(in_min))


@pytest.mark.long
def test_a_meal_that_is_announced_early_begins_in_the_model_when_it_is_eaten(controller):
    rest, early = with_time(0.0), with_time(15.0, carbs_g=60.0)
    state, decision = step(controller, controller.init(rest), early)
    assert float(decision.bolus_mU) > 1500.0  # by the ratio 3000, of which a part may come with the meal
    contents = []
    for _ in range(3):
        contents.append(float(jnp.sum(state.estimate.gut_mg)))
        state, _ = step(controller, state, dataclasses.replace(rest, delivered_bolus_mU=decision.bolus_mU))
        rest = with_time(0.0)
    contents.append(float(jnp.sum(state.estimate.gut_mg)))
    np.testing.assert_allclose(contents[:3], 0.0, atol=6000.0)  # what insulin does to readings that stay
    assert contents[3] - contents[2] == pytest.approx(60_000.0, rel=0.1)
    assert not np.any(state.to_come.carbs_g)


@pytest.mark.long
def test_an_announcement_that_tells_of_now_is_one_without_a_time(controller):
    meal = {"glucose": 131.0, "carbs_g": 45.0}
    wanted, found = after(controller, seen(), seen(**meal)), after(controller, with_time(0.0), with_time(0.0, **meal))
    np.testing.assert_allclose(jax.tree.leaves(found), jax.tree.leaves(wanted), rtol=1e-9)


def test_the_forecast_has_the_appearance_of_meals_to_come(controller):
    """Against the compartments of the gut, filled when each meal is eaten."""
    state = controller.init(with_time(0.0))
    to_come = dataclasses.replace(
        state.to_come, carbs_g=jnp.asarray([50.0, 20.0, 0.0, 0.0]), in_min=jnp.asarray([20.0, 7.0, 0.0, 0.0])
    )
    minutes = np.asarray(controller.ahead.step.minutes)
    appeared, expected = controller._later(state.estimate, to_come)[0] * minutes, []
    for end in np.cumsum(minutes):
        filled = [
            np.sum(controller.filter.gut.after(jnp.asarray([1000.0 * carbs_g, 0.0]), end - at)) if end > at else None
            for carbs_g, at in ((50.0, 20.0), (20.0, 7.0))
        ]
        expected.append(sum(1000.0 * c - f for c, f in zip((50.0, 20.0), filled, strict=True) if f is not None))
    np.testing.assert_allclose(np.cumsum(appeared), expected, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("sample_min", [1.0, 5.0, 10.0, 30.0])
def test_the_forecast_covers_eight_hours_in_blocks_of_whole_samples(controller, sample_min):
    ahead = steps_ahead(controller.model, sample_min)
    assert float(jnp.sum(ahead.step.minutes)) == pytest.approx(480.0)
    assert float(ahead.block_min[0]) == sample_min
    np.testing.assert_allclose(np.asarray(ahead.block_min) % sample_min, 0.0, atol=1e-9)
    np.testing.assert_allclose(ahead.step.minutes @ ahead.of_block, ahead.block_min)
