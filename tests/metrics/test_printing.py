"""Metrics as people read them."""

import numpy as np

from glucoloop.metrics import Metrics
from glucoloop.metrics.metric import default_results


def metrics_of(value, **changed):
    names = [result.name for result in default_results()]
    return Metrics.of({name: np.asarray(changed.get(name, value)) for name in names})


def test_one_person_is_a_short_table_with_units():
    lines = str(metrics_of(1.25, minimum_mg_dl=63.21, settled_2pct=True, settling_2pct_min=345.0)).splitlines()
    assert lines[0].split() == ["Time", "from", "70", "to", "180", "mg/dl", "1.2", "%"]
    assert any(line.split() == ["Minimum", "glucose", "63.2", "mg/dl"] for line in lines)
    assert any(line.split() == ["Settling,", "2", "%", "band", "345", "min"] for line in lines)
    assert max(map(len, lines)) <= 60


def test_who_has_not_settled_is_told():
    lines = str(metrics_of(345.0, settled_2pct=False)).splitlines()
    assert any(line.split() == ["Settling,", "2", "%", "band", "345+", "min"] for line in lines)


def test_people_are_their_spread():
    people = np.arange(101.0)
    lines = str(metrics_of(people, minimum_mg_dl=np.append(people[:-1], np.nan))).splitlines()
    assert lines[0].split() == ["5th", "pct.", "median", "95th", "pct.", "of", "101", "people"]
    by_title = {line[:31].strip(): line.split()[-4:] for line in lines}
    assert by_title["Undershoot"] == ["5.0", "50.0", "95.0", "mg/dl"]
    assert by_title["Minimum glucose"] == ["5.0", "49.5", "94.0", "mg/dl"]


def test_nobody_with_a_number_is_told_too():
    assert "nan" in str(metrics_of(np.full(3, np.nan)))
