"""What people do by hand and tell: each is counted once by whoever counts insulin and carbohydrate."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree, static
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.control import Decision, Observation, Status, guarded
from glucoloop.control.action import ACTIONS
from glucoloop.control.basal_bolus import BasalBolus
from glucoloop.control.decision import target_mg_dl, with_rescue
from glucoloop.control.guard_settings import OF_ROUTE, GuardSettings
from glucoloop.control.loop_like import LoopLike
from glucoloop.control.oref0.controller import Oref0
from glucoloop.pumps.limits import DoseLimits
from glucoloop.therapy import Profile

PROFILE = Profile(basal_mU_min=10.0, setpoint_mg_dl=110.0, carb_ratio_g_U=12.0, correction_mg_dl_U=50.0)
LIMITS = DoseLimits(max_change_mU_min=16.7, max_mU_min=66.9)


def seen(glucose=110.0, bolus=0.0, **others):
    return Observation(
        glucose_mg_dl=jnp.asarray(glucose),
        valid=jnp.asarray(math.isfinite(glucose)),
        setpoint_mg_dl=jnp.asarray(110.0),
        delivered_mU_min=jnp.asarray(10.0),
        announced_carbs_g=jnp.asarray(0.0),
        delivered_bolus_mU=None if bolus is None else jnp.asarray(bolus),
        **others,
    )


@pytree
class Told:
    """A controller whose state is what it was told last, and who always asks for a bolus of 300 mU."""

    sample_time_min: float = static(default=5.0)
    gives_boluses: bool = static(default=True)

    def init(self, observation):
        return observation

    def step(self, state, observation):
        del state
        bolus = jnp.asarray(300.0) if self.gives_boluses else None
        status = jnp.asarray(int(Status.OK))
        return observation, Decision(insulin_mU_min=jnp.asarray(10.0), status=status, bolus_mU=bolus)


def around(text, inner=None, **others):
    return ACTIONS.choose(text).made(inner=Told() if inner is None else inner, profile=PROFILE, **others)


def doses_of(controller, observations):
    """Boluses of a controller, and what it was told, where each report is the bolus before."""
    state, bolus, result = None, jnp.asarray(0.0), []
    for observation in observations:
        observation = dataclasses.replace(observation, delivered_bolus_mU=bolus)
        state = controller.init(observation) if state is None else state
        state, decision = controller.step(state, observation)
        bolus = decision.bolus_mU
        result.append((float(bolus), state.inner))
    return result


def test_a_bolus_by_hand_is_added_once_and_told_with_the_report():
    action = "bolus, time=5min, above_mg_dl=180"
    results = doses_of(around(action), [seen(210.0)] * 4)
    assert [bolus for bolus, _ in results] == pytest.approx([300.0, 2300.0, 300.0, 300.0])
    assert [float(told.delivered_bolus_mU) for _, told in results] == pytest.approx([0.0, 300.0, 2300.0, 300.0])
    hidden = doses_of(around(f"{action}, told=false"), [seen(210.0)] * 4)
    assert [bolus for bolus, _ in hidden] == pytest.approx([300.0, 2300.0, 300.0, 300.0])
    assert [float(told.delivered_bolus_mU) for _, told in hidden] == pytest.approx([0.0, 300.0, 300.0, 300.0])


@pytest.mark.parametrize("glucose", [170.0, math.nan])
def test_no_bolus_by_hand_without_a_high_reading(glucose):
    results = doses_of(around("bolus, time=5min, above_mg_dl=180"), [seen(glucose)] * 4)
    assert [bolus for bolus, _ in results] == [300.0] * 4


def test_times_count_from_the_end_of_the_warm_up():
    results = doses_of(around("bolus, time=5min, units_U=2", warm_up_min=10.0), [seen(210.0)] * 5)
    assert [bolus for bolus, _ in results] == [300.0, 300.0, 300.0, 2300.0, 300.0]


def test_a_controller_without_boluses_is_told_of_one_by_hand_as_of_a_rate():
    controller = around("bolus, time=0min, units_U=1", Told(gives_boluses=False))
    assert controller.gives_boluses
    results = doses_of(controller, [seen(210.0)] * 3)
    assert [bolus for bolus, _ in results] == [1000.0, 0.0, 0.0]
    assert [float(told.delivered_mU_min) for _, told in results] == [10.0, 210.0, 10.0]
    assert all(told.delivered_bolus_mU is None for _, told in results)


def test_a_bolus_by_hand_passes_the_guard():
    settings = GuardSettings(**OF_ROUTE[SUBCUTANEOUS])
    guard = guarded(around("bolus, time=10min, above_mg_dl=0, units_U=50"), settings, LIMITS)

    def third(glucose):
        state = guard.init(seen(glucose))
        for _ in range(3):
            state, decision = guard.step(state, seen(glucose))
        return decision

    decision = third(150.0)
    assert 300.0 < float(decision.bolus_mU) < 50_000.0
    assert int(decision.status) == Status.DOSE_LIMITED
    assert float(third(62.0).bolus_mU) == 0.0


def test_boluses_that_nobody_confirms_are_not_given():
    results = doses_of(around("no-bolus, time=5min, duration=10min"), [seen()] * 4)
    assert [bolus for bolus, _ in results] == [300.0, 0.0, 0.0, 300.0]


def test_exercise_is_told_from_its_announcement_to_its_end():
    text = "exercise, time=20min, duration=10min, before_min=10"
    told = [float(inner.exercise_in_min) for _, inner in doses_of(around(text), [seen()] * 8)]
    assert told == [math.inf, math.inf, 10.0, 5.0, 0.0, 0.0, math.inf, math.inf]
    both = around(text, around("exercise, time=0min, duration=5min, before_min=0"))
    state = both.init(seen())
    assert float(both.step(state, seen())[0].inner.inner.exercise_in_min) == 0.0


def test_the_target_of_exercise_is_higher_and_never_lower():
    assert float(target_mg_dl(seen())) == 110.0
    for ahead, expected in ((math.inf, 110.0), (30.0, 150.0), (0.0, 150.0), (math.nan, 110.0)):
        assert float(target_mg_dl(seen(exercise_in_min=jnp.asarray(ahead)))) == expected
    high = dataclasses.replace(seen(exercise_in_min=jnp.asarray(0.0)), setpoint_mg_dl=jnp.asarray(180.0))
    assert float(target_mg_dl(high)) == 180.0


def test_impossible_rescue_carbohydrate_is_none():
    carbs = jnp.asarray(20.0)
    assert with_rescue(carbs, seen()) is carbs
    for told, expected in ((15.0, 35.0), (-5.0, 20.0), (math.nan, 20.0), (1e6, 20.0)):
        assert float(with_rescue(carbs, seen(rescue_carbs_g=jnp.asarray(told)))) == expected


CONTROLLERS = {
    "oref0": lambda: Oref0().of_person(PROFILE, LIMITS),
    "loop-like": lambda: LoopLike().of_person(PROFILE, LIMITS),
}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_rescue_carbohydrate_is_on_board_and_gets_no_bolus(name):
    controller = CONTROLLERS[name]()

    def told(carbs, kind):
        at = seen(90.0, rescue_carbs_g=jnp.asarray(0.0))
        state = controller.init(at)
        state, _ = controller.step(state, at)
        return controller.step(state, dataclasses.replace(at, **{kind: jnp.asarray(carbs)}))

    (without, _), (rescued, decision), (announced, meal) = (
        told(*of) for of in ((0.0, "rescue_carbs_g"), (15.0, "rescue_carbs_g"), (15.0, "announced_carbs_g"))
    )

    def on_board(state):
        return float(jnp.sum(state.carbs_g if name == "oref0" else state.meals.carbs_g))

    assert on_board(rescued) - on_board(without) == pytest.approx(15.0)
    assert on_board(announced) - on_board(without) == pytest.approx(15.0)
    assert float(decision.bolus_mU) < float(meal.bolus_mU)


@pytest.mark.parametrize("make", [lambda: BasalBolus().of_person(PROFILE, LIMITS), *CONTROLLERS.values()])
def test_insulin_by_hand_is_on_board(make):
    """A correction by hand that was told leaves nothing, or less, for the controller to correct."""
    controller = make()

    def wanted(bolus):
        state = controller.init(seen(200.0))
        state, _ = controller.step(state, seen(200.0))
        state, decision = controller.step(state, seen(200.0, bolus))
        return 5.0 * float(decision.insulin_mU_min) + float(decision.bolus_mU), state

    (none, before), (much, after) = wanted(0.0), wanted(3000.0)
    assert much <= none
    on_board = {
        "basal-bolus": lambda state: float(state.first_mU + state.second_mU) / 1000.0,
        "oref0": lambda state: float(jnp.sum(state.insulin_U)),
        "loop-like": lambda state: float(jnp.sum(state.acting_U)),
    }[controller.name]
    assert on_board(after) - on_board(before) == pytest.approx(3.0, rel=0.02)


def test_people_trail():
    controller = ACTIONS.choose("bolus, time=0min").made(
        inner=Told(),
        profile=Profile(basal_mU_min=jnp.ones(2), setpoint_mg_dl=110.0, correction_mg_dl_U=jnp.array([50.0, 25.0])),
    )
    two = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), seen(210.0))
    _, decision = controller.step(controller.init(two), two)
    np.testing.assert_allclose(decision.bolus_mU, [2300.0, 4300.0])
