"""Rhythms: the published periods, factors and probabilities, people and days of their own, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import glucoloop as gl
from glucoloop.physiology.dawn import Dawn
from glucoloop.physiology.rhythm import changes_of
from glucoloop.physiology.visentin2015 import FACTORS, PROBABILITIES, Visentin2015, patterns_of

PEOPLE = np.arange(20_000)


@pytest.mark.parametrize("pattern", PROBABILITIES)
def test_each_period_has_the_factor_of_its_letter(pattern):
    clock = np.array([239.9, 240.1, 659.9, 660.1, 1019.9, 1020.1, 1439.0, 1441.0, 1679.9, 1680.1])
    found = Visentin2015(pattern, day_spread_pct=0.0).changes(clock, 3, PEOPLE[:2]).sensitivity
    letters = [pattern[i] for i in (2, 0, 0, 1, 1, 2, 2, 2, 2, 0)]
    np.testing.assert_array_equal(found[:, 1], [FACTORS[letter] for letter in letters])


def test_patterns_are_as_frequent_as_published():
    assert sum(PROBABILITIES.values()) == pytest.approx(1.0)
    drawn = np.bincount(patterns_of("drawn", 1, PEOPLE), minlength=7) / PEOPLE.size
    error = np.sqrt(np.array(list(PROBABILITIES.values())) / PEOPLE.size)
    assert np.all(np.abs(drawn - list(PROBABILITIES.values())) < 4.0 * error)


def test_a_period_of_a_person_has_one_factor_of_its_own():
    rhythm = Visentin2015("hhh")
    clock = np.arange(0.5, 3 * 1440.0)
    found = rhythm.changes(clock, 5, PEOPLE[:500]).sensitivity
    changes = np.flatnonzero(np.any(np.diff(found, axis=0) != 0.0, axis=1)) + 1
    np.testing.assert_array_equal(changes % 1440, [240, 660, 1020] * 3)
    periods = found[np.concatenate([[0], changes])]
    assert abs(periods.mean() - 1.0) < 0.02
    # normal within three standard deviations: 0.2 times the square root of 1 - 6 phi(3) / (2 Phi(3) - 1)
    assert periods.std() == pytest.approx(0.2 * np.sqrt(1.0 - 6.0 * 0.0044318 / 0.9973), rel=0.03)
    assert np.all((periods > 0.399) & (periods < 1.601))
    assert np.abs(np.corrcoef(periods) - np.eye(len(periods))).max() < 0.2
    again = rhythm.changes(clock[2000:2100], 5, np.array([311])).sensitivity
    np.testing.assert_array_equal(again[:, 0], found[2000:2100, 311])
    assert np.all(rhythm.changes(clock[:1], 6, PEOPLE[:9]).sensitivity != found[:1, :9])


@given(st.floats(0.0, 1e6), st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
def test_any_person_at_any_time_has_a_factor_above_zero(clock, seed, person):
    found = changes_of([Visentin2015(), Dawn()], np.array([clock]), seed, [person])
    assert 0.15 < found.sensitivity[0, 0] < 1.61
    assert 0.0 <= found.production_mg_kg_min[0, 0] <= 1.5


def test_production_rises_before_dawn_and_falls_back():
    added = Dawn().changes(np.array([0.0, 180.0, 300.0, 420.0, 480.0, 540.0, 1740.0]), 0, PEOPLE[:1])
    np.testing.assert_allclose(added.production_mg_kg_min[:, 0], [0.0, 0.0, 0.75, 1.5, 0.75, 0.0, 0.75])


def test_rhythms_are_laid_over_each_other():
    clock = np.arange(0.0, 1440.0, 30.0)
    one, two = Visentin2015("lhh", 0.0), Visentin2015("hhl", 0.0)
    found = changes_of([one, Dawn(), two, Dawn(rise_mg_kg_min=0.5)], clock, 0, [0])
    np.testing.assert_allclose(
        found.sensitivity, one.changes(clock, 0, PEOPLE[:1]).sensitivity * two.changes(clock, 0, PEOPLE[:1]).sensitivity
    )
    assert found.production_mg_kg_min.max() == 2.0
    assert changes_of([], clock, 0, [0]).sensitivity is None


def test_a_rhythm_is_a_part():
    assert gl.rhythm("visentin-2015, pattern=hhl") == Visentin2015("hhl")
    assert gl.rhythm("dawn, rise_mg_kg_min=2") == Dawn(rise_mg_kg_min=2.0)
    for text, told in (
        ("noon", "unknown rhythm 'noon'; the known ones are: visentin-2015, dawn"),
        ("visentin-2015, pattern=lll", "pattern is 'lll'"),
        (
            "dawn, from_min=600",
            "a dawn from 600 to 420 min that falls for 120 min is not possible; give times in their",
        ),
        ("dawn, to_min=1400", "a dawn from 180 to 1400 min"),
        ("dawn, rise_mg_kg_min=nan", "rise_mg_kg_min is nan"),
    ):
        with pytest.raises(ValueError, match=told):
            gl.rhythm(text)


def test_a_rhythm_of_ones_own_changes_a_run(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "examples"))
    night = gl.rhythm("your_own_rhythm:Night, factor=0.5")
    patient, controller = (
        gl.patient("hovorka-2004"),
        gl.design_open_loop(gl.patient("hovorka-2004").basal_insulin_mU_min),
    )
    with_rhythm = gl.simulate(patient, controller, scenario=gl.Scenario([], 1440.0, rhythms=[night]))
    assert float(with_rhythm.glucose_mg_dl[0]) == pytest.approx(120.0)
    assert float(with_rhythm.glucose_mg_dl[-1]) > 130.0
    with pytest.raises(ValueError, match=r"factor is 2, but must be above 0 and at most 1|factor"):
        gl.rhythm("your_own_rhythm:Night, factor=2")
