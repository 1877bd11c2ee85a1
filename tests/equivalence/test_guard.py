"""Native code: a guard that has nothing to do changes no bit of what becomes of people."""

import numpy as np
import pytest

from glucoloop.control import Guard, guarded
from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials.trial import Trial
from guarding import OPEN

PEOPLE = np.arange(7)
KEYS = {"people": PEOPLE.size, "seed": 211, "duration_min": 240.0, "meals": ["50g@30min"], "sensor": "white-noise"}


@pytest.mark.long
def test_of_people_in_native_code(monkeypatch):
    trial = configured(Trial, KEYS, controller="mpc")

    def run():
        prepared = engine._prepare(trial)
        assert prepared.cases["mpc"].loop.engine == "native"
        return prepared, engine.run_people(prepared, "mpc", PEOPLE, traces=True)

    _, plain = run()
    design = engine.controller_of
    monkeypatch.setattr(engine, "controller_of", lambda *given: guarded(design(*given), OPEN, trial.limits))
    prepared, behind_guard = run()
    assert isinstance(prepared.cases["mpc"].controller, Guard)
    np.testing.assert_array_equal(behind_guard.insulin_mU_min, plain.insulin_mU_min)
    for metric in ("minimum_mg_dl", "mean_mg_dl", "insulin_total_mU", "samples_saturated"):
        np.testing.assert_array_equal(behind_guard.metrics[metric], plain.metrics[metric])
    assert np.ptp(plain.insulin_mU_min) > 30.0
