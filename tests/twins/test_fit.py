"""Twins of people whose parameters are known: the days held out are predicted within the noise."""

import numpy as np
import pytest

from glucoloop.patients.population import population
from glucoloop.twins import find_twin, recorded_days
from lived_records import lived

pytestmark = pytest.mark.long
FAMILY, PEOPLE = "hovorka-2004", "boiroux2017"


@pytest.fixture(scope="module")
def twins():
    """Twins of two people, and their true parameters."""
    people, found = population(PEOPLE, patient=FAMILY), []
    for person in (2000, 2001):
        record, truth = lived(FAMILY, PEOPLE, person, days=5)
        found.append((find_twin(recorded_days(record), people, held_out_days=1), truth))
    return found


def test_days_held_out_are_predicted_within_the_noise(twins):
    for twin, _ in twins:
        held = twin.held_out
        assert held.rmse_mg_dl < 1.5 * twin.noise.sd_mg_dl
        assert held.rmse_mg_dl < min(held.by_population_rmse_mg_dl, held.by_mean_rmse_mg_dl)
    assert 75.0 < np.mean([twin.held_out.covered_pct for twin, _ in twins]) <= 100.0


def test_the_true_parameters_lie_within_the_intervals(twins):
    inside = [row["low"] <= truth[row["parameter"]] <= row["high"] for twin, truth in twins for row in twin.rows()]
    assert np.mean(inside) > 0.7


def test_what_the_record_does_not_tell_is_said(twins):
    twin, _ = twins[0]
    assert "V_I" in twin.unidentified
    assert any("next to nothing of" in sentence for sentence in twin.warnings())


def test_all_starts_end_at_the_same_twin(twins):
    assert all(twin.agreeing_starts >= 3 for twin, _ in twins)
