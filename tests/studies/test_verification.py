"""Random loops with random faults: each breach of a promise is found, and each loop can be closed again."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree, static
from glucoloop.build.random_keys import keys_of_people
from glucoloop.build.surroundings import faulty_pump, faulty_sensor
from glucoloop.control import Decision, Guard, Observation, Status
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.faults import FAULTS, Episode
from glucoloop.metrics import promises
from glucoloop.metrics.promises import PROMISES, Promises, all_finite
from glucoloop.patients import patient
from glucoloop.patients.sorensen.equations import STATE_NAMES
from glucoloop.patients.sorensen.patient import SorensenPatient
from glucoloop.pumps import PARKER_1999_LIMITS, Delivery, LimitedPump
from glucoloop.sensors import Reading, WhiteNoise
from glucoloop.simulation.cohort import SampledInside
from glucoloop.simulation.loop import LoopState
from glucoloop.studies.verification import Verification, campaign
from glucoloop.studies.verification.campaign import (
    KINDS,
    PUMP_KINDS,
    _draw_people,
    _draw_random_meals,
    _feasible_people,
    _random_faults,
    _random_order,
    circumstances_of,
)
from glucoloop.studies.verification.study import SAME_BITS
from verified import results_of_verification

PERSON = patient()
REST = PERSON.steady_state(PERSON.basal_insulin_mU_min)
GLUCOSE = float(PERSON.glucose_mg_dl(REST))


def clock(until, age):
    return Episode(until=jnp.asarray(until), age=jnp.asarray(age))


def happened(**others):
    """A sample at steady state, but for what is given."""
    told = {
        "x": REST,
        "reading": 81.1,
        "dose": 20.0,
        "command": 20.0,
        "word": 20.0,
        "status": int(Status.OK),
        "in_controller": (jnp.asarray([3.0, 0.0]), jnp.asarray(3)),
        "in_pump": {"rate": 3.0, "episode": clock(math.inf, -1.0)},
        "in_sensor": (math.nan, clock(3.0, 0.0)),  # a sensor may keep any reading
        "inside": jnp.full(5, GLUCOSE),
        **others,
    }
    state = LoopState(
        x=told["x"],
        reported_mU_min=jnp.asarray(told["word"]),
        in_sensor=told["in_sensor"],
        in_controller=told["in_controller"],
        in_pump=told["in_pump"],
    )
    return SampledInside(
        x=told["x"],
        glucose_mg_dl=jnp.asarray(GLUCOSE),
        reading=Reading(glucose_mg_dl=jnp.asarray(told["reading"]), valid=jnp.asarray(True)),
        decision=Decision(insulin_mU_min=jnp.asarray(told["command"]), status=jnp.asarray(told["status"])),
        delivery=Delivery(insulin_mU_min=jnp.asarray(told["dose"]), reported_mU_min=jnp.asarray(told["word"])),
        infused_mU_min=jnp.asarray(told["dose"]),
        inside_mg_dl=told["inside"],
        lowest_valid_mg_dl=jnp.asarray(0.0),
        before=state,
        after=state,
    )


def broken_by(sampled, lowest=GLUCOSE):
    held = Promises(sound=SorensenPatient.sound).fulfilled(sampled, jnp.asarray(lowest), sampled.before.reported_mU_min)
    assert tuple(held) == PROMISES
    return {name for name, holds in held.items() if not bool(holds)}


def with_state(**values):
    x = REST
    for name, value in values.items():
        x = x.at[STATE_NAMES.index(name)].set(value)
    return x


@pytest.mark.parametrize(
    ("told", "promise"),
    [
        *(({"dose": value}, promises.DOSE) for value in (math.nan, math.inf, -1e-12, 66.9000001)),
        *(({"command": value}, promises.COMMAND) for value in (-1e-9, 66.9000001)),
        ({"command": 36.71, "word": 20.0}, promises.RATE),
        ({"command": 3.29, "word": 20.0}, promises.RATE),
        *(({"status": value}, promises.STATUS) for value in (-1, len(Status), 0.5)),
        ({"in_controller": (jnp.asarray([3.0, math.nan]), jnp.asarray(3))}, promises.CONTROLLER),
        ({"in_pump": {"rate": math.inf, "episode": clock(3.0, 0.0)}}, promises.PUMP),
        *(
            ({"in_pump": {"rate": 3.0, "episode": clock(until, 0.0)}}, promises.FAULTS)
            for until in (math.nan, -math.inf)
        ),
        *(({"in_sensor": clock(0.0, age)}, promises.FAULTS) for age in (math.nan, math.inf, 0.5, -2.0)),
        *(({"x": with_state(**{name: -1e-6})}, promises.INSULIN_THERE) for name in ("I_B", "I_PI", "N")),
        *(({"x": with_state(**{name: GLUCOSE - 20.0})}, promises.GLUCOSE_THERE) for name in ("G_BV", "G_G")),
        ({"x": with_state(G_BI=GLUCOSE - 75.0)}, promises.GLUCOSE_THERE),  # 70 for the lightest person
        *(({"x": with_state(**{name: -0.2})}, promises.GLUCOSE_THERE) for name in ("G_L", "G_K", "G_PV", "G_PI")),
    ],
)
def test_each_breach_is_found_and_nothing_else(told, promise):
    command = {} if "command" not in told or "word" in told else {"word": told["command"]}
    assert broken_by(happened(**told, **command)) == {promise}


def test_nothing_is_broken_at_rest_and_what_is_no_number_breaks_what_it_is_in():
    assert broken_by(happened()) == set()
    assert promises.PATIENT in broken_by(happened(x=with_state(A_NHGP=math.nan)))
    assert broken_by(happened(command=math.nan)) == {promises.COMMAND, promises.RATE}
    # a pump that says nothing, or nothing that can be meant, has no rate to keep to
    for word in (math.nan, math.inf, -1.0, 70.0):
        assert broken_by(happened(word=word)) == set()
    # what glucose was, not what it is, explains what an organ has left
    assert broken_by(happened(x=with_state(G_G=GLUCOSE - 20.0)), lowest=GLUCOSE - 19.0) == set()


def test_a_fall_may_begin_at_the_last_request_where_the_pump_reports_more():
    """After a request of 20 mU/min, of which the pump reports twice as much."""
    for command, broken in ((3.31, set()), (3.29, {promises.RATE}), (56.6, set()), (56.8, {promises.RATE})):
        sampled = happened(command=command, word=40.0)
        held = Promises(sound=SorensenPatient.sound).fulfilled(sampled, jnp.asarray(GLUCOSE), jnp.asarray(20.0))
        assert {name for name, holds in held.items() if not bool(holds)} == broken


def test_breaches_are_counted_and_dated():
    fold, place = Promises(sound=SorensenPatient.sound), PROMISES.index(promises.DOSE)
    kept = fold.init(jnp.asarray(GLUCOSE), jnp.asarray(20.0))
    low = jnp.asarray([80.0, 59.9, 70.0, 60.0, 50.0])
    for number, (dose, inside) in enumerate([(20.0, low), (-1.0, low), (20.0, low + 20.0), (-1.0, low)]):
        kept = fold.step(kept, happened(dose=dose, inside=inside), jnp.asarray(5.0 * number))
    assert float(kept.broken[place]) == 2.0
    assert float(kept.first_min[place]) == 5.0
    assert float(kept.broken.sum()) == 2.0
    assert np.isinf(np.delete(np.asarray(kept.first_min), place)).all()
    assert float(kept.below_60) == 6.0
    assert float(kept.lowest_mg_dl) == 50.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_one_number_that_is_not_finite_is_seen_wherever_it_is(value):
    sound = {"a": jnp.asarray([1e300, -1e300, 1.7e308, 1.7e308]), "b": (jnp.asarray(3), jnp.asarray(True), 2.0)}
    assert bool(all_finite(sound))
    assert not bool(all_finite({**sound, "a": sound["a"].at[2].set(value)}))
    assert not bool(all_finite({**sound, "b": value}))


# people, meals and faults


SAMPLES = 96


@pytest.fixture(scope="module")
def faults():
    return _random_faults(_random_order(5, 2), 5, np.arange(4000), SAMPLES)


def test_faults_are_up_to_three_at_once_of_every_kind(faults):
    there = np.array([faults.there[kind] for kind in KINDS])
    share = np.bincount(there.sum(axis=0)) / 4000
    np.testing.assert_allclose(share, np.full(4, 0.25), atol=0.03)
    np.testing.assert_allclose(there.mean(axis=1), 1.5 / len(KINDS), atol=0.02)
    assert np.isnan(faults.settings["nonsense"]["value"]).any()
    assert sorted(faults.order.sensor) == sorted(set(KINDS) - set(PUMP_KINDS))
    for kind in KINDS:
        never_begins = np.isinf(faults.episodes[kind].earliest) & (faults.episodes[kind].probability == 0.0)
        if kind != "resolution":
            np.testing.assert_array_equal(never_begins, ~faults.there[kind])


def test_what_a_person_meets_does_not_depend_on_who_else_is_asked_for(faults):
    some = _random_faults(faults.order, 5, [17, 3, 999], SAMPLES)
    for of_all, of_some in zip(jax.tree.leaves(vars(faults)), jax.tree.leaves(vars(some)), strict=True):
        if np.ndim(of_all):
            np.testing.assert_array_equal(np.asarray(of_all)[[17, 3, 999]], of_some)


def test_faults_as_text_are_the_same_faults_to_the_bit(faults):
    """The text makes its own few wrappers; the campaign has all of them around every person."""
    many = np.array([sum(faults.there[kind][i] for kind in KINDS) for i in range(200)])
    chosen = [*np.flatnonzero(many == 3)[:3], np.flatnonzero(faults.there["resolution"])[0]]
    glucose = 81.0 + 40.0 * np.sin(np.arange(SAMPLES) / 9.0)
    command = 25.0 + 20.0 * np.cos(np.arange(SAMPLES) / 4.0)
    seen = set()

    def run(sensor, pump, key):
        def one(carry, entry):
            number, true, wanted = entry
            of_sensor, of_pump = carry
            now = jax.random.fold_in(key, number)
            of_sensor, reading = sensor.read(of_sensor, true, now)
            of_pump, delivery = pump.deliver(of_pump, wanted, now)
            return (of_sensor, of_pump), (reading, delivery)

        start = sensor.init(jnp.asarray(81.0), key), pump.init(jnp.asarray(25.0), key)
        return jax.lax.scan(one, start, (np.arange(SAMPLES), glucose, command))[1]

    keys = keys_of_people(5, np.asarray(chosen))
    few = _random_faults(faults.order, 5, chosen, SAMPLES)
    together = jax.jit(run)
    for place, person in enumerate(chosen):
        texts = faults.texts(int(person))
        seen |= {text.split(",")[0] for text in texts}
        told = [FAULTS.choose(text) for text in texts]
        noise = WhiteNoise(few.noise_variance[place], few.noise_bound_mg_dl[place])
        alone = jax.jit(run)(
            faulty_sensor(noise, told, 5.0),
            faulty_pump(LimitedPump(), told, 5.0, PARKER_1999_LIMITS),
            keys[place],
        )
        of_all = together(few.sensor(person=place), few.pump(PARKER_1999_LIMITS, person=place), keys[place])
        jax.tree.map(np.testing.assert_array_equal, alone, of_all)
    assert len(seen) >= 6


def test_people_are_of_two_populations_by_turns_and_eat_up_to_four_meals():
    drawn = _draw_people(9, np.arange(6))
    flow, weight = np.asarray(drawn.patient.parameters.q_H), drawn.draw.values["weight_kg"]
    np.testing.assert_allclose(flow[1::2], 43.7 * weight[1::2] / 70.0, rtol=1e-12)
    np.testing.assert_allclose(flow[::2], 43.7, rtol=1e-12)
    assert _draw_people(9, [4]).basal_insulin_mU_min == drawn.basal_insulin_mU_min[4]
    eaten = _draw_random_meals(9, np.arange(500), 300.0)
    t_min, carbs_g = eaten.t_min, eaten.carbs_g
    assert (t_min.min() > 0.0) & (t_min.max() < 300.0)
    assert set((carbs_g > 0.0).sum(axis=0)) == {0, 1, 2, 3, 4}
    assert (carbs_g[carbs_g > 0.0].min() > 5.0) & (carbs_g.max() < 120.0)
    feasible = _feasible_people(9, 30)
    assert feasible.size == 30
    assert np.isfinite(_draw_people(9, feasible).basal_insulin_mU_min).all()


# a campaign


@pytree
class Rogue:
    """A controller that does what none may where something told to it is not a number, and else nothing much."""

    sample_time_min: float = static(default=5.0)

    def init(self, observation: Observation):
        return jnp.zeros_like(observation.glucose_mg_dl)

    def step(self, state, observation: Observation):
        mad = jnp.isnan(observation.glucose_mg_dl)
        rate = jnp.where(mad, 1000.0, observation.delivered_mU_min)
        state = jnp.where(mad, jnp.inf, state)
        return state, Decision(insulin_mU_min=rate, status=jnp.where(mad, 77, int(Status.OK)))


@pytest.fixture(scope="module")
def closed():
    """Campaigns with a rogue among the controllers; its loops are compiled once."""
    made = {}
    real = campaign._WatchedLoops

    def once(trial, controller, order):
        guarded = isinstance(controller, Guard)
        if guarded not in made:
            made[guarded] = real(trial, controller, order)
        return made[guarded]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "catalogue_controller", lambda name, patient: Rogue())
        patch.setattr(campaign, "_horizon_min", lambda name: 300.0)
        patch.setattr(campaign, "_WatchedLoops", once)
        patch.setattr(campaign, "block_size", lambda engine: 256)
        yield found


def found(progress=lambda loops: None, **given):
    """What a campaign of the controller `basal` found, as it is read back."""
    return results_of_verification(progress, seed=5, controllers=("basal",), **given)


@pytest.mark.long
def test_a_rogue_is_found_and_a_guard_makes_an_honest_controller_of_it(closed):
    result = closed(loops=600)
    bare, guarded = result["arms"]
    assert (result["loops"], result["samples"]) == (600, 600 * 60)
    assert [(arm["loops"], arm["guarded"]) for arm in (bare, guarded)] == [(300, False), (300, True)]
    expected = {promises.COMMAND, promises.RATE, promises.STATUS, promises.CONTROLLER}
    assert {promise for promise, count in bare["broken"].items() if count} == expected
    # the pump keeps its limits whatever it is asked for, and a guard cleans what the rogue is told
    assert not any(guarded["broken"].values())
    assert result["violations"][SAME_BITS] == 0
    assert bare["repeated"] == guarded["repeated"] == math.ceil(300 / campaign.REPEATED)
    assert not result["holds"]
    assert result["guarding"][0]["pairs"] == 300


def test_a_broken_loop_is_closed_again_by_its_person_alone(closed):
    told = {promise: [] for promise in PROMISES}
    for broken in closed(loops=600)["arms"][0]["examples"]:
        told[broken["promise"]].append(broken)
    assert len(told[promises.COMMAND]) == 10
    broken = told[promises.COMMAND][3]
    assert any(fault.split(",")[0] in ("missing", "nonsense", "battery") for fault in broken["faults"])
    assert broken["faults"] == circumstances_of("basal", 5, broken["person"])["faults"]
    alone = closed(person=broken["person"])
    assert alone["loops"] == 2
    again = next(row for row in alone["arms"][0]["examples"] if row["promise"] == broken["promise"])
    assert again == broken


def test_other_bits_of_a_second_time_are_found(closed, monkeypatch):
    real, calls = campaign._bits_of, []

    def flip(arrays):
        calls.append(None)
        bits = real(arrays)
        # two blocks, and then some of them for the second time
        return bits if len(calls) != 3 else np.where(np.arange(bits.size) == 2, bits + np.uint64(1), bits)

    monkeypatch.setattr(campaign, "_bits_of", flip)
    result = closed(loops=600)
    assert result["violations"][SAME_BITS] == 1
    assert len(result["arms"][0]["not_repeated"]) == 1
    assert not result["holds"]


def test_a_single_bit_makes_other_bits():
    rows = np.random.default_rng(1).normal(size=(50, 40))
    other = rows.copy()
    other[np.arange(40) % 50, np.arange(40)] = np.nextafter(other[np.arange(40) % 50, np.arange(40)], np.inf)
    assert np.all(campaign._bits_of([rows]) != campaign._bits_of([other]))
    np.testing.assert_array_equal(campaign._bits_of([rows]), campaign._bits_of([rows[:20], rows[20:]]))


def test_an_interrupt_hands_back_what_is_done(closed):
    told = []

    def progress(number):
        told.append(number)
        if sum(told) > 300:
            raise KeyboardInterrupt

    result = closed(progress, loops=600)
    assert result["interrupted"]
    assert [arm["guarded"] for arm in result["arms"]] == [False]
    assert result["loops"] == 300


def test_every_controller_has_its_share_and_as_many_with_a_guard_as_without():
    pairs = Verification(loops=100_000).people()
    assert sum(pairs.values()) >= 50_000
    assert 2 * sum(pairs.values()) < 100_000 + 2 * len(pairs)  # each share is rounded up
    assert pairs["meal-mpc"] * 20 == pytest.approx(pairs["mpc"], abs=20)
    for slow in (True, False):
        assert len({count for name, count in pairs.items() if CONTROLLERS[name].slow == slow}) == 1
    assert Verification(loops=1, controllers=("meal-mpc",)).people() == {"meal-mpc": 1}


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"loops": 0}, "loops is 0; give a whole number from 1"),
        ({"loops": True}, "loops is True"),
        ({"loops": 10**10}, "loops is 10000000000"),
        ({"seed": -1}, "seed is -1"),
        ({"person": 2**32}, "person is 4294967296"),
        ({"controllers": ("mcp",)}, "unknown controller 'mcp'"),
        ({"controllers": ("pid", "pid")}, "named twice"),
        ({"patient": "parker"}, "unknown patient 'parker'"),
        ({"nonsense": 0}, "nonsense is 0; give a whole number from 1"),
        (
            {"nonsense": 100, "controllers": ("meal-mpc",)},
            "meal-mpc takes too long for nonsense in masses; give some",
        ),
    ],
)
def test_what_cannot_be_tried_is_refused(given, told):
    with pytest.raises(ValueError, match=told):
        Verification(**given)


def test_a_person_without_a_basal_rate_is_refused(monkeypatch):
    def nobody(seed, person, patient):
        drawn = _draw_people(seed, person, patient)
        return dataclasses.replace(drawn, feasible=np.zeros_like(drawn.feasible))

    monkeypatch.setattr(campaign, "_draw_people", nobody)
    with pytest.raises(ValueError, match="no basal rate holds person 3 of seed 5 at the setpoint; give another person"):
        found(person=3)


def test_people_without_a_basal_rate_are_passed_over(monkeypatch):
    def odd(seed, person, patient):
        drawn = _draw_people(seed, person, patient)
        return dataclasses.replace(drawn, feasible=np.asarray(person) % 2 == 1)

    monkeypatch.setattr(campaign, "_draw_people", odd)
    np.testing.assert_array_equal(_feasible_people(1, 700), 1 + 2 * np.arange(700))
