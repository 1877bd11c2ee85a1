"""Controllers by the clock: a constant schedule is the plain profile, and each segment holds in its hours alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of
from glucoloop.control import Observation
from glucoloop.control.basal_bolus import BasalBolus
from glucoloop.control.guard_doses import at_basal, initial_doses
from glucoloop.control.scheduled import Scheduled, scheduled
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.unused import without_effect
from glucoloop.therapy import TARGET, Profile, Schedule, TherapyChange

PERSON = Profile(basal_mU_min=10.0, setpoint_mg_dl=110.0)
DAY = {"patient": "hovorka-2004", "announce_meals": True, "start": "06:00", "days": 1, "meals": ["60g@1h", "50g@15h"]}
BY_PROFILE = ("basal-bolus", "loop-like", "oref0", "profile-mpc", "therapy-mpc")


def trace_of(controller, **settings):
    run = configured(Run, {**DAY, "controller": [controller], **settings})
    return close_loop(run, controller_of(run, run.case), run.as_scenario())


@pytest.mark.parametrize("controller", BY_PROFILE)
@pytest.mark.long
def test_a_constant_schedule_is_the_plain_profile_to_the_bit(controller):
    more = {"guard": "usual"}
    plain = trace_of(controller, **more)
    constant = trace_of(
        controller, therapy=["basal, 100%, 0h-7h", "basal, 100%, 7h-24h"], targets=["120@0h-24h"], **more
    )
    assert float(configured(Run, DAY).target_mg_dl) == 120.0
    for one, other in ((plain.glucose_mg_dl, constant.glucose_mg_dl), (plain.command_mU_min, constant.command_mU_min)):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))


@pytest.mark.long
@pytest.mark.parametrize("change", [{"therapy": ["basal, +50%, from 22h"]}, {"targets": ["150@22h"]}])
def test_what_changes_at_22_h_changes_nothing_before(change):
    for controller in ("loop-like", "oref0", "therapy-mpc"):
        plain, changed = trace_of(controller, guard="usual"), trace_of(controller, guard="usual", **change)
        late = np.asarray(plain.t_min) >= 16 * 60.0  # the run begins at 6 h
        same = np.asarray(plain.command_mU_min) == np.asarray(changed.command_mU_min)
        assert same[~late].all()
        assert not same[late].all()


def test_the_basal_rate_is_that_of_the_segment_and_of_the_sample_before():
    schedule = Schedule(
        (
            TherapyChange("basal_mU_min", 1320.0, 360.0, factor=1.5),
            TherapyChange("basal_mU_min", 360.0, 720.0, value=8.0),
        )
    )
    starts = schedule.starts_min(5.0)
    profiles = schedule.profiles(PERSON, 5.0)
    assert starts == (0.0, 360.0, 365.0, 720.0, 725.0, 1320.0, 1325.0)
    assert [float(profile.basal_mU_min) for profile in profiles] == [15.0, 8.0, 8.0, 10.0, 10.0, 15.0, 15.0]
    assert [float(profile.past_basal_mU_min) for profile in profiles] == [15.0, 15.0, 8.0, 8.0, 10.0, 10.0, 15.0]
    # twice the daily basal dose without factors: 6 h at 8 and 18 h at 10 mU/min
    assert float(profiles[0].total_daily_dose_U) == pytest.approx(2.0 * (6 * 8.0 + 18 * 10.0) * 60 / 1000)
    assert float(profiles[0].max_daily_basal_mU_min) == 15.0


def test_people_have_the_schedule_on_their_own_numbers():
    schedule = Schedule(
        (TherapyChange("basal_mU_min", 0.0, 360.0, factor=1.5), TherapyChange(TARGET, 0.0, 360.0, 140.0))
    )
    one = scheduled(BasalBolus().of_person(PERSON), schedule, PERSON)
    people = one.with_profile(
        Profile(basal_mU_min=jnp.asarray([10.0, 16.0]), setpoint_mg_dl=jnp.asarray([110.0, 100.0]))
    )
    assert isinstance(people, Scheduled)
    assert people.varies == one.varies

    def rates(time):
        two = jnp.ones(2)
        seen = Observation(
            glucose_mg_dl=110.0 * two,
            valid=two > 0.0,
            setpoint_mg_dl=110.0 * two,
            delivered_mU_min=10.0 * two,
            announced_carbs_g=0.0 * two,
            delivered_bolus_mU=0.0 * two,
            time_of_day_min=time * two,
        )
        return jax.jit(lambda c, s: c.step(c.init(s), s)[1].insulin_mU_min)(people, seen)

    np.testing.assert_allclose(rates(355.0), [15.0, 24.0])
    np.testing.assert_allclose(rates(360.0), [10.0, 16.0])


@pytest.mark.parametrize("controller", BY_PROFILE)
def test_the_same_numbers_vary_of_one_person_and_of_people_with_arrays_of_other_libraries(controller):
    schedule = Schedule((TherapyChange("basal_mU_min", 0.0, 180.0, factor=0.9),))
    run = configured(Run, {**DAY, "controller": [controller]})
    plain = controller_of(run, run.case)
    one = scheduled(plain, schedule, PERSON)
    people = Profile(basal_mU_min=jnp.array([10.0, 12.0]), setpoint_mg_dl=np.array([110.0, 110.0]))
    assert one.varies == scheduled(plain, schedule, people).varies


def test_a_guard_counts_the_same_insulin_in_another_basal_rate():
    doses = initial_doses(jnp.asarray(10.0), jnp.asarray(10.0), 5.0, None)
    other = at_basal(jax.tree.map(lambda leaf: leaf + 2.0, doses), jnp.asarray(6.0))
    assert float(other.on_board * other.basal_mU_min) == pytest.approx(2.0 * 12.0)
    assert float(other.counted * other.basal_mU_min) == pytest.approx(2.0 * 12.0)
    assert float(other.per_basal * other.basal_mU_min) == pytest.approx(1.0)
    assert float(at_basal(doses, jnp.asarray(0.0)).per_basal) == 0.0


@pytest.mark.long
def test_controllers_on_equations_use_targets_by_the_clock_and_no_other_number_of_a_therapy():
    """Their notes say so; what is given of a basal rate by the clock is not taken for that of another person."""
    insulin = {"therapy": ["basal, +50%", "carb_ratio, 5, 9h-24h"], "overrides": ["override, from=8h, insulin=70%"]}
    for controller in ("meal-mpc", "mpc-se"):
        plain = trace_of(controller, duration_min=300.0, days=None, meals=["60g@1h"])
        same = trace_of(controller, duration_min=300.0, days=None, meals=["60g@1h"], **insulin)
        np.testing.assert_array_equal(np.asarray(plain.command_mU_min), np.asarray(same.command_mU_min))
        aimed = trace_of(
            controller, duration_min=300.0, days=None, meals=["60g@1h"], overrides=["exercise, from=8h, to=10h"]
        )
        late = np.asarray(plain.t_min) >= 120.0
        other = np.asarray(plain.command_mU_min) != np.asarray(aimed.command_mU_min)
        assert other[late].any()
        assert not other[~late].any()
        notes = " ".join(without_effect(configured(Run, {**DAY, "controller": [controller], **insulin})))
        assert f"therapy has no effect: the controller {controller} does not use the profile of a person" in notes
        assert "insulin_pct of the override override has no effect" in notes


def test_a_temporary_target_is_one_until_another_target_takes_its_place():
    run = configured(Run, {**DAY, "targets": ["110@6h-22h"], "overrides": ["exercise, from=8h, to=10h"]})
    changed = run.with_changes(("target, 100, 9:00-9:30",))
    for of, expected in ((run, [(8.5, True), (9.25, True), (7.0, False)]), (changed, [(8.5, True), (9.25, False)])):
        for hour, temporary in expected:
            assert of.schedule.temporary(60.0 * hour) is temporary, hour
    factor = Schedule((*run.schedule.changes, TherapyChange(TARGET, 0.0, 1440.0, factor=1.1)))
    assert factor.temporary(510.0)
