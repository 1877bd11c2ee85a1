"""Environments for Gymnasium: its own checks, and the closed loop as truth."""

import copy
import functools
import os
import pickle
import subprocess
import sys

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import glucoloop as gl
import glucoloop.gym.people
from glucoloop._pytree import pytree, static
from glucoloop.build.surroundings import surroundings_of
from glucoloop.component.effects import NoEffectWarning
from glucoloop.control.protocol import Decision
from glucoloop.gym import ENVIRONMENT
from glucoloop.gym.environment import GlucoseEnv, GlucoseVectorEnv
from glucoloop.gym.people import DosedPeople, _Nothing
from glucoloop.refusal import Refusal
from glucoloop.situations.situation import configured
from glucoloop.trials.engine import brought, loop_of, people_of
from glucoloop.trials.people import block_size
from glucoloop.trials.trial import Trial

DAY = {
    "patient": "hovorka-2004",
    "sensor": ["dexcom-g6"],
    "announce_meals": True,
    "meals": ["45g@30min", "60g@2h"],
    "duration_min": 240.0,
}
# The recommendation of a normalised action space: ours has units, and Gymnasium's RescaleAction normalises it.
UNITS = pytest.mark.filterwarnings("ignore:.*symmetric and normalized")


def made(**changed):
    return gymnasium.make(ENVIRONMENT, disable_env_checker=True, **{**DAY, **changed})


def vector(number, **changed):
    return gymnasium.make_vec(ENVIRONMENT, num_envs=number, **{**DAY, **changed})


@pytree
class Planned:
    """Rates and boluses that were planned, one for each sample."""

    rates: jnp.ndarray
    boluses: jnp.ndarray
    sample_time_min: float = 5.0

    @property
    def gives_boluses(self):
        return True

    def init(self, observation):
        return jnp.zeros_like(observation.delivered_mU_min)

    def step(self, state, observation):
        now = jnp.arange(self.rates.size) == state
        rate, bolus = (jnp.where(now, of, 0.0).sum() for of in (self.rates, self.boluses))
        return state + 1, Decision(insulin_mU_min=rate, status=jnp.asarray(0), bolus_mU=bolus)


@UNITS
@pytest.mark.long
def test_gymnasium_finds_nothing_to_object_to():
    check_env(made().unwrapped, skip_render_check=True)  # of a window, which not every machine can open
    other = made(patient="parker-1999", sensor=[], meals=["20g@30min"], truth=True)
    check_env(other.unwrapped, skip_render_check=True)


@pytest.mark.long
def test_stable_baselines_takes_it():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    scaled = gymnasium.wrappers.RescaleAction(made(), -1.0, 1.0)
    checker.check_env(scaled, warn=True)


def test_it_is_found_by_its_module():
    found = gymnasium.make("glucoloop.gym:glucoloop/Glucose-v0", disable_env_checker=True, **DAY)
    assert type(found.unwrapped).__name__ == "GlucoseEnv"
    found.close()


@pytest.mark.long
@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"start": "07:00", "carb_error_pct": 30.0, "rhythm": ["dawn"]},
        {"meal_time_spread_min": 20.0, "meal_size_spread_pct": 20.0},
        {"faults": ["occlusion, start_min=60"], "seed": 9},
    ],
    ids=["same meals", "rhythm", "own meals", "fault"],
)
def test_steps_with_the_doses_of_a_closed_loop_are_that_loop_to_the_bit(changed):
    settings, number = {**DAY, **changed}, np.arange(8)
    trial = configured(Trial, settings)
    rates = 2.0 + 1.5 * np.sin(np.arange(trial.samples))
    boluses = np.where(np.arange(trial.samples) % 9 == 4, 800.0, 0.0)
    loop = loop_of(
        trial, Planned(rates=jnp.asarray(rates), boluses=jnp.asarray(boluses)), _Nothing(), record_decisions=True
    )
    block = np.arange(block_size(loop.engine))  # people are drawn in blocks of this size
    run = loop.run(people_of(trial, block), **brought(trial, trial.drawn_days(block)))
    assert loop.engine == "native"
    people = DosedPeople(settings, number.size)
    people.reset()
    np.testing.assert_array_equal(people.person, number)
    for k in range(trial.samples):
        np.testing.assert_array_equal(people.reading_mg_dl, run.reading_mg_dl[k, :8])
        # the first and the last glucose of a run are computed outside of native code
        exact = {"rtol": 0.0} if 0 < k else {"rtol": 1e-14}
        np.testing.assert_allclose(people.glucose_mg_dl, run.glucose_mg_dl[k, :8], **exact)
        people.step(np.full(8, rates[k]), np.full(8, boluses[k]))
        np.testing.assert_array_equal(people._lanes.seen.infused_mU_min, run.insulin_mU_min[k, :8])
    np.testing.assert_allclose(people.glucose_mg_dl, run.glucose_mg_dl[-1, :8], rtol=1e-14)


@pytest.mark.long
def test_the_slower_engine_makes_the_same_steps(monkeypatch):
    """JAX carries those whom native code cannot."""
    native = DosedPeople(DAY, 3)
    monkeypatch.setattr(glucoloop.gym.people, "loop_of", functools.partial(loop_of, engine="xla"))
    mapped = DosedPeople(DAY, 3)
    assert [people.engine for people in (native, mapped)] == ["native", "xla"]
    for people in (native, mapped):
        people.reset()
    for k in range(24):
        for name in ("reading_mg_dl", "glucose_mg_dl"):
            np.testing.assert_allclose(getattr(mapped, name), getattr(native, name), rtol=0.0, atol=1e-9)
        for people in (native, mapped):
            people.step(np.full(3, 5.0 + k % 3), np.array([0.0, 500.0 * (k == 6), 0.0]))
    assert np.ptp(native.glucose_mg_dl) > 1.0


@pytest.mark.long
def test_one_person_is_the_first_of_many():
    one, many = made(), vector(3)
    seen, _ = one.reset(seed=5)
    of_all, _ = many.reset(seed=5)
    action = np.array([1.0, 0.5])
    for _ in range(10):
        np.testing.assert_array_equal(seen, of_all[0])
        assert one.observation_space.contains(seen)
        seen, reward, *_ = one.step(action)
        of_all, rewards, *_ = many.step(np.tile(action, (3, 1)))
        assert reward == rewards[0]


@pytest.mark.long
def test_places_that_end_at_different_times_get_the_next_person_and_the_others_go_on():
    env = vector(4, lowest_mg_dl=10.0, highest_mg_dl=190.0, patient="hovorka-2004", sensor=["ideal"], people=300)
    _, info = env.reset(seed=1)
    low = np.zeros((4, 2))
    low[0, 1] = 6.0  # enough insulin to stay below the bound
    came = [info["person"].copy()]
    ended = np.zeros(4, bool)
    seen_apart = False
    for _ in range(100):
        _, reward, terminated, truncated, info = env.step(low)
        np.testing.assert_array_equal(info["t_min"][ended], 0.0)
        np.testing.assert_array_equal(reward[ended], 0.0)
        assert not (terminated | truncated)[ended].any()
        np.testing.assert_array_equal(terminated, (info["glucose_mg_dl"] > 190.0) | (info["glucose_mg_dl"] < 10.0))
        seen_apart |= np.unique(info["t_min"]).size > 2
        ended = terminated | truncated
        came.append(info["person"].copy())
    assert seen_apart
    begun = np.unique(came)
    np.testing.assert_array_equal(begun, np.arange(begun.size))

    # A person who came later runs as one who is alone from the start.
    place = int(np.argmax(np.where(info["person"] > 3, info["t_min"], -1.0)))
    steps = round(info["t_min"][place] / 5.0)
    assert steps > 3
    alone = vector(1, sensor=["ideal"], first_person=int(info["person"][place]))
    alone.reset(seed=1)
    for _ in range(steps):
        _, _, _, _, of_one = alone.step(low[place : place + 1])
    assert of_one["glucose_mg_dl"][0] == info["glucose_mg_dl"][place]


@pytest.mark.long
def test_the_same_seed_gives_the_same_people_and_another_seed_others():
    env = vector(5)
    first, info = env.reset(seed=3)
    env.step(np.ones((5, 2)))
    again, told = env.reset(seed=3)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(info["person"], told["person"])
    other, _ = env.reset(seed=4)
    assert not np.array_equal(first, other)
    _, later = env.reset()
    np.testing.assert_array_equal(later["person"], np.arange(5, 10))


@pytest.mark.long
def test_observations_tell_what_happened():
    env = vector(1, start="06:00", sensor=["ideal"])
    assert env.observation_names == (
        "reading_mg_dl",
        "reading_age_min",
        "insulin_U",
        "announced_g",
        "time_of_day_min",
    )
    assert env.action_names == ("basal_U_h", "bolus_U")
    seen, _ = env.reset(seed=0)
    told, eaten, times = [seen[0, 3]], [], [seen[0, 4]]
    for _ in range(47):
        seen, _, _, _, info = env.step([[1.2, 0.0]])
        told.append(seen[0, 3])
        times.append(seen[0, 4])
        eaten.append(info["carbohydrate_g"][0])
        np.testing.assert_allclose(seen[0, 2], 0.1, rtol=1e-6)  # 1.2 U/h over 5 min
        np.testing.assert_allclose(info["insulin_U"], 0.1, rtol=1e-12)
    assert {k: g for k, g in enumerate(told) if g} == {6: 45.0, 24: 60.0}
    assert {k: g for k, g in enumerate(eaten) if g} == {6: 45.0, 24: 60.0}
    np.testing.assert_array_equal(times, 360.0 + 5.0 * np.arange(48))
    *_, terminated, truncated, _ = env.step([[1.2, 0.0]])
    assert truncated[0]
    assert not terminated[0]


@pytest.mark.long
def test_a_guard_stands_between_agent_and_pump():
    doses = {}
    for guard in (False, True, "usual, max_hour=2"):
        env = vector(1, guard=guard, sensor=["ideal"], meals=[], announce_meals=False)
        env.reset(seed=0)
        doses[guard] = sum(env.step([[0.5, 20.0]])[4]["insulin_U"][0] for _ in range(6))
    assert doses[False] > 100.0
    assert doses["usual, max_hour=2"] < doses[True] < 10.0


def test_a_dose_that_is_no_number_is_the_least_of_the_pump_and_none_exceeds_its_limits():
    env = vector(3, sensor=["ideal"])
    env.reset(seed=0)
    for _ in range(6):  # since a pump may change its rate by so much at once
        _, _, _, _, info = env.step([[np.nan, np.nan], [1e9, 1e9], [-5.0, -1.0]])
    highest = env.single_action_space.high
    np.testing.assert_allclose(info["insulin_U"], [0.0, highest[0] / 12.0 + highest[1], 0.0], rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"controller": ["pid"]}, "controller is no setting of an environment: the agent takes the place"),
        ({"warm_up_min": 60.0}, "warm_up_min is no setting of an environment"),
        (
            {"reward": "best"},
            "unknown reward 'best'; the known ones are: bounded-risk, magni-risk, risk-change, time-in-range",
        ),
        ({"lowest_mg_dl": 700.0, "highest_mg_dl": 600.0}, "glucose from 700 to 600 mg/dl is no range"),
        ({"patient": "nobody"}, "nobody"),
        ({"days": 1}, "days"),
        ({"glucose": 1}, "glucose"),
    ],
)
def test_what_is_not_possible_is_refused_with_a_sentence(settings, sentence):
    with pytest.raises(Refusal, match=sentence):
        made(**settings)


@pytest.mark.long
def test_what_is_done_out_of_turn_is_refused():
    env = made().unwrapped
    with pytest.raises(Refusal, match="call reset first"):
        env.step([1.0, 0.0])
    env.reset(seed=0)
    with pytest.raises(Refusal, match=r"an action of the shape \(1, 3\) is not possible; give \(1, 2\)"):
        env.step([1.0, 0.0, 0.0])
    for _ in range(48):
        *_, truncated, _ = env.step([1.0, 0.0])
    assert truncated
    with pytest.raises(Refusal, match="call reset first"):
        env.step([1.0, 0.0])
    with pytest.raises(Refusal, match="nobody is there yet"):
        vector(2).step(np.ones((2, 2)))


@pytest.mark.long
def test_environments_without_a_seed_are_different_people_and_with_one_the_same():
    first, other, given = made(), made(), [made(seed=4) for _ in range(2)]
    rates = [env.reset()[1]["insulin_U"] for env in (first, other, *given)]
    assert rates[0] != rates[1]
    assert rates[2] == rates[3] == given[0].reset(seed=4)[1]["insulin_U"]


@pytest.mark.long
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
def test_a_copy_is_made_from_the_same_arguments_and_is_before_its_first_episode(copied):
    for env in (made(), vector(2)):
        seen, _ = env.reset(seed=3)
        again = copied(env)
        assert again.spec == env.spec
        with pytest.raises(Refusal, match="call reset first"):
            again.unwrapped.step(np.array(env.action_space.low))
        np.testing.assert_array_equal(again.reset(seed=3)[0], seen)
        for each in (env, again):
            each.close()
            each.close()


@pytest.mark.long
def test_a_picture_shows_the_episode_so_far(monkeypatch):
    env = made(render_mode="rgb_array").unwrapped
    with pytest.raises(Refusal, match="call reset first"):
        env.render()
    env.reset(seed=1)
    first = env.render()
    for _ in range(12):
        env.step(np.array([1.0, 0.0]))
    later = env.render()
    assert first.shape == later.shape == (400, 640, 3)
    assert first.dtype == np.uint8
    assert not np.array_equal(first, later)
    with pytest.raises(Refusal, match="unknown render_mode 'ansi'"):
        GlucoseEnv(render_mode="ansi", **DAY)
    with pytest.raises(Refusal, match="a picture is of one person"):
        GlucoseVectorEnv(2, render_mode="rgb_array", **DAY)
    monkeypatch.setenv("MPLBACKEND", "agg")
    shown = GlucoseEnv(render_mode="human", **DAY)
    with pytest.raises(Refusal, match="cannot open; use render_mode 'rgb_array'"):
        shown.reset()


@pytest.mark.long
def test_a_window_follows_each_step_until_it_is_closed(monkeypatch):
    import matplotlib
    import matplotlib.pyplot as plt

    drawn = []
    monkeypatch.setattr(matplotlib, "get_backend", lambda: "one with windows")
    monkeypatch.setattr(plt, "pause", lambda seconds: drawn.append(len(plt.gcf().axes[0].lines[0].get_xdata())))
    env = GlucoseEnv(render_mode="human", **DAY)
    before = plt.get_fignums()
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.array([1.0, 0.0]))
    assert drawn == [1, 2, 3, 4]
    assert len(plt.get_fignums()) == len(before) + 1
    env.close()
    env.close()
    assert plt.get_fignums() == before


WITHOUT_A_DISPLAY = """
import glucoloop
from glucoloop.gym.environment import GlucoseEnv
env = GlucoseEnv(render_mode="human", patient="hovorka-2004", meals=["45g@30min"], duration_min=240.0)
try:
    env.reset(seed=1)
except glucoloop.Refusal as error:
    print(error)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere windows need no display")
@pytest.mark.parametrize("backend", ["", "TkAgg", "QtAgg", "agg"])
def test_without_a_display_a_window_is_refused_in_a_sentence(backend):
    surroundings = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    surroundings |= {"MPLBACKEND": backend} if backend else {}
    code = [sys.executable, "-c", WITHOUT_A_DISPLAY]
    done = subprocess.run(code, env=surroundings, capture_output=True, text=True, timeout=240, check=True)
    assert done.stdout.startswith("render_mode 'human' needs a window, which matplotlib's backend")
    assert done.stdout.endswith("cannot open; use render_mode 'rgb_array'\n")


FORKED = """
import gymnasium, glucoloop.gym
settings = {"patient": "hovorka-2004", "meals": ["45g@30min"], "duration_min": 240.0}
if __name__ == "__main__":
    env = gymnasium.make_vec("glucoloop/Glucose-v0", num_envs=2, vectorization_mode="async", **of_mode, **settings)
    assert env.reset(seed=3)[0].shape == (2, 5)
    env.close()
"""


@pytest.mark.long
def test_processes_that_start_afresh_have_environments_and_forks_refuse_them(tmp_path):
    path = tmp_path / "program.py"
    for context in ("forkserver", "fork"):
        path.write_text(f"of_mode = {{'vector_kwargs': {{'context': '{context}'}}}}\n{FORKED}")
        done = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=240)
        assert (done.returncode == 0) == (context == "forkserver")
    assert "this process was forked from one in which JAX had run" in done.stderr


def test_without_gymnasium_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "glucoloop.gym")
    with pytest.raises(
        Refusal, match=r"an environment needs gymnasium; install it with: pip install 'glucoloop\[gym\]'"
    ):
        __import__("glucoloop.gym")


@pytest.mark.parametrize(
    ("without_use", "setting"),
    [
        ({"profile_by": "titration"}, "profile_by"),
        ({"meals": []}, "announce_meals"),
        ({"truth": True}, "sensor"),
        ({"exercise_spread_pct": 9.0}, "exercise_spread_pct"),
    ],
)
def test_a_setting_without_effect_is_warned_of(without_use, setting):
    with pytest.warns(NoEffectWarning, match=f"{setting}.* has no effect") as warned:
        GlucoseEnv(**{**DAY, **without_use})
    assert {warning.filename for warning in warned} == {__file__}


def test_an_environment_whose_settings_all_have_an_effect_warns_of_none(recwarn):
    GlucoseEnv(**DAY)
    assert not [warning for warning in recwarn if issubclass(warning.category, NoEffectWarning)]


@pytest.mark.long
@pytest.mark.parametrize("context", ["spawn", "forkserver"])
def test_environments_in_processes_of_their_own(context):
    """Gymnasium's processes, which are not forks of one that has run JAX, are the same people."""
    makers = [functools.partial(GlucoseEnv, **{**DAY, "seed": seed}) for seed in (1, 2)]
    apart = gymnasium.vector.AsyncVectorEnv(makers, context=context, shared_memory=False)
    here = gymnasium.vector.SyncVectorEnv(makers)
    try:
        np.testing.assert_array_equal(apart.reset()[0], here.reset()[0])
        action = np.full((2, 2), [1.0, 0.0], np.float32)
        np.testing.assert_array_equal(apart.step(action)[0], here.step(action)[0])
    finally:
        apart.close(terminate=True)


DUAL = {"patient": "wilinska-2010-glucagon", "glucagon": True, "meals": ["20g@30min"], "sensor": []}


@pytest.mark.long
def test_an_agent_gives_glucagon():
    env = made(**DUAL).unwrapped
    assert env.action_names == ("basal_U_h", "bolus_U", "glucagon_ug")
    assert env.observation_names[-1] == "glucagon_ug"
    assert float(env.action_space.high[2]) == 300.0
    without = made(**{**DUAL, "glucagon": False}).unwrapped
    assert "glucagon_ug" not in (*without.action_names, *without.observation_names)
    env.reset(seed=3)
    without.reset(seed=3)
    glucose, seen_ug = [], []
    for sample in range(24):
        dose_ug = 100.3 if sample == 4 else np.nan if sample == 9 else 0.0
        observation, *_, info = env.step(np.array([0.5, 0.0, dose_ug]))
        *_, plain = without.step(np.array([0.5, 0.0]))
        glucose.append((info["glucose_mg_dl"], plain["glucose_mg_dl"]))
        seen_ug.append(float(observation[-1]))
    dual, alone = np.array(glucose).T
    assert np.flatnonzero(seen_ug).tolist() == [4]
    assert seen_ug[4] == 100.0  # in whole steps of 0.5 ug
    np.testing.assert_allclose(dual[:4], alone[:4], rtol=1e-9)
    assert (dual - alone)[4:].max() > 20.0
    assert env.people.engine == "native"


@pytest.mark.long
def test_doses_of_glucagon_of_an_agent_are_those_of_the_loop():
    """Of one person, beside the loop of a run in which a controller gives the same."""

    @pytree
    class Given:
        rate_mU_min: jnp.ndarray
        sample_time_min: float = static(default=5.0)
        gives_boluses = gives_glucagon = True

        def init(self, observation):
            return jnp.zeros_like(observation.delivered_mU_min)

        def step(self, state, observation):
            glucagon_ug = jnp.where(state == 4, 100.0, 0.0)
            status, none = jnp.asarray(0), jnp.zeros(())
            decision = Decision(insulin_mU_min=self.rate_mU_min, status=status, bolus_mU=none, glucagon_ug=glucagon_ug)
            return state + 1, decision

    env = made(**DUAL, people=1).unwrapped
    env.reset(seed=5)
    course = [env.step(np.array([0.5, 0.0, 100.0 if sample == 4 else 0.0]))[-1] for sample in range(24)]
    trial = env.people.trial
    person = people_of(trial, [0])
    patient = jax.tree.map(lambda leaf: leaf[..., 0] if jnp.ndim(leaf) else leaf, person.patient)
    controller = Given(rate_mU_min=jnp.asarray(0.5 * 1000.0 / 60.0))
    scenario = gl.Scenario([gl.Meal(20.0, 30.0)], 120.0, setpoint_mg_dl=trial.target_mg_dl)
    pump = surroundings_of(trial).pump
    trace = gl.simulate(patient, controller, pump=pump, scenario=scenario)
    np.testing.assert_allclose(
        [info["glucose_mg_dl"] for info in course], trace.fine_glucose_mg_dl[5::5], rtol=0.0, atol=1e-6
    )


def test_glucagon_that_is_not_possible_is_refused():
    with pytest.raises(Refusal, match="glucagon is 'threshold', but the agent decides on it; give True or False"):
        made(**{**DUAL, "glucagon": "threshold"})
    with pytest.raises(Refusal, match="no infusion of glucagon"):
        made(**{**DUAL, "patient": "hovorka-2004"})
