"""The loops of the claims are those that anybody can close with ``glucoloop run`` and ``glucoloop trial``."""

import numpy as np
import pytest

from glucoloop.config.run import read_run
from glucoloop.papers.meal_aware.experiments import study
from glucoloop.papers.meal_aware.measures import MEASURES, numbers_of
from glucoloop.papers.meal_aware.options import MOST_SEEDS
from glucoloop.papers.meal_aware.situations import SITUATIONS, read_asked
from glucoloop.patients.population import population, virtual_people
from glucoloop.studies.closed_loop import close_the_loop
from glucoloop.tuning.oscillation import oscillation

DEAD_TIME = next(one for one in SITUATIONS if one.name == "dead-time-10")


PEOPLE = next(one for one in SITUATIONS if one.name == "people")


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def loops(told):
    """Linear MPC, which has a model of its own for each seed."""
    asked = read_asked({"seed": 11, "seeds": 2})
    found = study(asked, [DEAD_TIME], controllers=("mpc",), ours="mpc", progress=told.append, timed=False)
    return found.loops["dead-time-10"]["mpc"]


def _run(seed, **other):
    return close_the_loop(read_run({**DEAD_TIME.of("mpc", seed), **other}))


@pytest.mark.long
def test_a_seed_is_the_run_of_that_seed(loops, told):
    assert loops.run.tolist() == [11, 12]
    one = _run(12)
    np.testing.assert_allclose(loops.glucose_mg_dl[:, 1], one.trace.fine_glucose_mg_dl, atol=1e-6)
    np.testing.assert_allclose(loops.insulin_mU_min[:, 1], one.trace.insulin_mU_min, atol=1e-5)
    assert loops.numbers["undershoot_mg_dl"][1] == pytest.approx(float(one.metrics.undershoot_mg_dl))
    assert abs(loops.glucose_mg_dl[:, 0] - loops.glucose_mg_dl[:, 1]).max() > 0.5
    assert sum(told) == 2  # the run without noise is none of the loops


def test_oscillation_is_that_of_the_same_controller_without_noise(loops):
    noisy = read_run(DEAD_TIME.of("mpc", 11)).case
    of_noise = {**noisy.tuning, "model_noise_variance": noisy.model_noise_variance}
    alone = oscillation(_run(11, noise_variance=0.0, **of_noise).trace)
    assert (int(loops.quiet.crossings), int(loops.quiet.turns)) == (int(alone.crossings), int(alone.turns))


@pytest.mark.long
def test_people_are_those_of_a_trial():
    asked = read_asked({"seed": 11, "people": 3})
    told = []
    found = study(asked, [PEOPLE], controllers=("basal",), ours="basal", progress=told.append, timed=False)
    loops = found.loops["people"]["basal"]
    assert loops.run.tolist() == [0, 1, 2]
    assert sum(told) == 3
    assert loops.infeasible == 0
    # without a controller everybody follows his own basal rate
    drawn = virtual_people(population("parker2000"), 11, [0, 1, 2])
    np.testing.assert_allclose(loops.insulin_mU_min, np.tile(drawn.basal_insulin_mU_min, (120, 1)), rtol=1e-6)
    assert np.all(loops.numbers["overshoot_mg_dl"] > 15.0)
    within = np.abs(loops.glucose_mg_dl - loops.setpoint_mg_dl) <= 15.0
    np.testing.assert_allclose(loops.numbers["time_near_pct"], 100.0 * within.mean(axis=0), atol=1.5)


def test_time_between_samples_is_taken_as_straight():
    t_min = np.arange(0.0, 601.0, 5.0)
    ramp = 81.1 + 30.0 * t_min[:, None] / 600.0  # beyond 15 from 300 min on
    metrics = {measure.name: np.zeros(1) for measure in MEASURES}
    metrics |= {"undershoot_mg_dl": np.zeros(1), "overshoot_mg_dl": np.full(1, 30.0)}
    found = numbers_of(metrics, t_min, ramp, 81.1)
    assert found["time_near_pct"][0] == pytest.approx(100.0 * 301 / 601, abs=100.0 / 601 + 1e-9)
    assert found["deviation_mg_dl"][0] == 30.0
    assert found["late_deviation_mg_dl"][0] == pytest.approx(30.0)
    assert found["late_swings"][0] == 0.0


class TestAsked:
    def test_overlap_with_the_tuning_is_found(self):
        assert read_asked({"seed": 1}).tuned_on == ()
        assert read_asked({"seed": 899_900, "seeds": 101}).tuned_on == ("seeds 900000 to 900000 of the sensor",)
        assert read_asked({"seed": 899_900, "seeds": 100}).tuned_on == ()
        assert read_asked({"seed": 900_199}).tuned_on == ("seeds 900199 to 900199 of the sensor",)
        assert read_asked({"seed": 900_200}).tuned_on == ()
        assert read_asked({"seed": 424_242}).tuned_on == ("the people of seed 424242",)

    @pytest.mark.parametrize(
        ("keys", "sentence"),
        [
            ({"seeds": 0}, "seeds is 0; give"),
            ({"seeds": MOST_SEEDS + 1}, f"at most {MOST_SEEDS}"),
            ({"people": 0}, "people is 0"),
            ({"seed": -1}, "seed is -1"),
            ({"sees": 3}, "unknown key 'sees'; did you mean 'seeds'"),
        ],
    )
    def test_mistakes(self, keys, sentence):
        with pytest.raises(ValueError, match=sentence):
            read_asked(keys)
