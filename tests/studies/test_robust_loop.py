"""Many tunings in one program are what each comes to alone."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop._pytree import pytree, static
from glucoloop.component.setting import Tuned
from glucoloop.control import Decision, Status
from glucoloop.meals import Meal, Scenario
from glucoloop.metrics import summarise
from glucoloop.sensors import white_noise
from glucoloop.simulation import simulate
from glucoloop.situations.situation import configured
from glucoloop.studies.robust import RANGES, Search
from glucoloop.studies.robust.search import SearchEngine, _tuning_of
from glucoloop.studies.robust.study import notes
from glucoloop.studies.robust.tuning_loop import METRICS, TuningLoop, draw_subjects
from glucoloop.trials import people
from glucoloop.trials.trial import Trial

SPACE = (Tuned("filter_min", 0.5, 20.0, log=True),)
MINUTES = 150.0
FIXED = {name: 1.0 for name, of in RANGES.items() if of.by_default}


@pytest.fixture(scope="module", autouse=True)
def _designed_at_once():
    """The minimum controller with a number to tune in place of one whose design takes seconds."""

    def design_of(trial, case):
        del trial, case

        def design(controller):
            return proportional(controller.filter_min)

        return design

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("glucoloop.studies.robust.tuning_loop.design_of", design_of)
        yield


@pytree
class Proportional:
    """Insulin beyond what was delivered at the start, in proportion to the reading."""

    gain: jax.Array
    sample_time_min: float = static()

    def init(self, observation):
        return observation.delivered_mU_min

    def step(self, state, observation):
        rate = state + self.gain * (observation.glucose_mg_dl - observation.setpoint_mg_dl)
        return state, Decision(insulin_mU_min=jnp.clip(rate, 0.0, 66.9), status=jnp.asarray(Status.OK))


def proportional(filter_min):
    return Proportional(gain=jnp.asarray(2.0 / filter_min), sample_time_min=5.0)


@pytest.fixture(scope="module")
def trial():
    return configured(
        Trial,
        duration_min=MINUTES,
        meals=["40g@30min"],
        sensor=["white-noise, variance=1.45"],
        people=3,
        seed=7,
        controller=["imc"],
    )


@pytest.fixture(scope="module")
def subjects(trial):
    return draw_subjects(trial, 3, 7, seeds=2, first_seed=100)


@pytest.fixture(scope="module")
def loop(trial, subjects):
    return TuningLoop(trial, trial.cases[0], SPACE, subjects)


@pytest.mark.long
def test_each_tuning_and_subject_is_as_alone(subjects, loop):
    tunings = [{"filter_min": value} for value in (1.0, 4.0, 15.0)]
    found = list(loop.run(subjects, tunings))
    for tuning, metrics in zip(tunings, found, strict=True):
        controller = proportional(tuning["filter_min"])
        for place in (1, 4):
            person = jax.tree.map(lambda a, i=place: a[i] if jnp.ndim(a) else a, subjects.patient)
            key = subjects.key[place] if place < subjects.people else jax.random.key(101)  # as the command line has it
            scenario = Scenario([Meal(40.0, 30.0)], MINUTES)
            alone = summarise(simulate(person, controller, white_noise(1.45, 5.0), None, scenario, key))
            for name, error in zip(METRICS, (0.01, 0.01, 0.01, 0.2), strict=True):
                assert metrics[name][place] == pytest.approx(float(getattr(alone, name)), abs=error)
    peaks = [metrics["peak_mg_dl"][4] for metrics in found]
    assert peaks[0] < peaks[1] < peaks[2]  # less insulin


def test_blocks_make_no_difference(subjects, loop, monkeypatch):
    tunings = [{"filter_min": value} for value in (1.0, 2.0, -1.0, 3.0)]
    whole = list(loop.run(subjects, tunings))
    assert [metrics is None for metrics in whole] == [False, False, True, False]  # the third one is refused
    monkeypatch.setitem(people._SIZES, "native", 8)
    for one, other in zip(whole, loop.run(subjects, tunings), strict=True):
        for name in METRICS if one is not None else ():
            np.testing.assert_array_equal(one[name], other[name])


class ClosedForm:
    """Stands for the loop: subject i undershoots by what the weight is away from their own best."""

    engine_facts: ClassVar = {"engine": "native"}

    def __init__(self, trial, case, space, example):
        pass

    def run(self, subjects, tunings=({},)):
        own = np.linspace(1.0, 3.0, subjects.number) + float(subjects.basal_insulin_mU_min[0]) / 100.0
        for tuning in tunings:
            undershoot = np.abs(tuning["move_weight"] - own)
            metrics = (undershoot, 81.1 - undershoot, 90.0 + tuning["move_weight"] + own, own)
            yield dict(zip(METRICS, metrics, strict=True))


def test_a_search_goes_on_to_the_same_candidates(monkeypatch):
    monkeypatch.setattr("glucoloop.studies.robust.search.TuningLoop", ClosedForm)
    search = configured(
        Search, controller={"name": "meal-mpc", **FIXED, "move_weight": "0.1:20"}, duration_min=MINUTES, people=2,
        people_seed=1, seeds=2, first_seed=0, check_people=2, check_people_seed=2, check_seeds=2, batch=4,
        sampler="tpe, seed=1", rounds=2, beside=[],
    )  # fmt: skip
    assert [of.name for of in search.space] == ["move_weight"]
    engine = SearchEngine(search)
    whole = list(engine.missing([]))
    assert [of["candidate"] for of in whole] == list(range(8))
    assert [of["round"] for of in whole] == [0] * 4 + [1] * 4
    assert _tuning_of(search, whole[0]) == search.initial
    assert list(engine.missing(whole[:3])) == whole[3:]
    assert list(engine.missing(whole)) == []
    other = {**whole[2], "move_weight": 1.23}
    with pytest.raises(ValueError, match="candidate 2 of the search was another tuning than tpe proposes now"):
        next(engine.missing([*whole[:2], other]))
    table, scores = engine.check(_tuning_of(search, whole[3]))
    assert scores.keys() == {"chosen", "as it was"}
    assert table.group_by("controller", "group", maintain_order=True).len().rows() == [
        (label, group, 2) for label in scores for group in ("people", "noise")
    ]
    assert scores["chosen"]["undershoot_p95_mg_dl"] != whole[3]["undershoot_p95_mg_dl"]  # on others


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"controller": {"name": "meal-mpc", **FIXED}}, "nothing is tuned"),
        ({"objectives": ["peak-p95", "peak-p95"]}, "give two objectives that differ"),
        ({"objectives": ["peak-p95", "peaks"]}, "unknown objective 'peaks'"),
        ({"at_most": ["peak-p95=mpc"]}, "'mpc' is neither a number nor a controller that stands beside: mpc-se"),
        ({"at_most": ["peaks=1"]}, "--at-most is 'peaks=1': unknown objective 'peaks'"),
        ({"check_people_seed": 424242}, "people are drawn with the seed 424242 for the search and for the check"),
        ({"check_first_seed": 900_039}, "the noise of seed 900039 is met in the search and in the check"),
    ],
)
def test_searches_that_are_refused(keys, sentence):
    with pytest.raises(ValueError, match=sentence):
        notes(configured(Search, keys))
