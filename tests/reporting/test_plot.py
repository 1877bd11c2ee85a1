"""Parts of the plots of pages: thinned curves, bands and periods."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.faults import FAULTS
from glucoloop.patients import population
from glucoloop.reporting.charts import GLUCOSE, Panel, thinned
from glucoloop.reporting.descriptions import _window_of, person_in_words
from glucoloop.reporting.labelled_traces import _periods

finite = st.floats(-1e4, 1e4)


@given(values=st.lists(finite | st.just(float("nan")), min_size=1, max_size=400), most=st.integers(4, 100))
def test_a_thinned_curve_keeps_its_ends_and_extremes(values, most):
    t = np.arange(len(values), dtype=float)
    kept_t, kept = thinned(t, values, most)
    assert len(kept) <= most + 2
    assert np.all(np.diff(kept_t) > 0.0)
    np.testing.assert_array_equal(kept, np.asarray(values)[kept_t.astype(int)])
    assert (kept_t[0], kept_t[-1]) == (t[0], t[-1])
    if np.isfinite(values).any():
        assert (np.nanmin(kept), np.nanmax(kept)) == (np.nanmin(values), np.nanmax(values))


@given(there=st.lists(st.booleans(), min_size=1, max_size=60))
def test_periods_cover_the_samples_and_no_others(there):
    t_min = 5.0 * np.arange(len(there) + 1)
    found = _periods(t_min, np.array(there))
    covered = [any(start <= t < stop for start, stop in found) for t in t_min[:-1]]
    assert covered == there
    assert all(before[1] < after[0] for before, after in itertools.pairwise(found))


def test_a_band_is_drawn_only_where_there_is_something_between():
    panel = Panel(GLUCOSE, (0.0, 200.0), 100)
    panel.area([0.0, 5.0], [0.0, 0.0], [0.0, 0.0], 0, "nothing")
    panel.area([0.0, 5.0], [np.nan, np.nan], [np.nan, np.nan], 0, "nothing")
    assert panel.areas == []
    panel.area([0.0, 5.0, 7.5], [80.0, np.nan, 81.0], [90.0, 99.0, 91.5], 2, "something")
    assert panel.areas == [
        {"name": "something", "colour": 2, "t": [0, 50, 25], "low": [800, None, 10], "high": [900, 90, -75]}
    ]


def test_a_value_that_is_held_is_written_once():
    panel = Panel(GLUCOSE, (0.0, 200.0), 100)
    panel.line([0.0, 5.0, 10.0, 15.0, 20.0], [80.0, 80.0, np.nan, 80.0], 0)
    (line,) = panel.lines
    assert (line["t"], line["y"]) == ([0, 100, 50, 50], [800, None, 0])


@pytest.mark.parametrize(
    ("fault", "window"),
    [
        ("stuck, start_min=60, duration_min=90", (60.0, 150.0)),
        ("stuck, start_min=60, latest_min=100, duration_min=90", (60.0, 190.0)),
        ("stuck, start_min=500", (500.0, 600.0)),
        ("missing", (0.0, 600.0)),
        ("stuck, start_min=700", None),
        ("spikes, per_day=12", None),
        ("missed-pulses, share=0.2", None),
    ],
)
def test_the_time_of_a_fault_is_what_its_settings_say(fault, window):
    assert _window_of(FAULTS.choose(fault), 600.0) == window


def test_a_person_is_told_by_what_is_farthest_from_the_usual():
    drawn = {name: of.centre for name, of in population("parker2000").distributions().items()}
    drawn |= {"F_LC": 0.52, "M_IHGU.inflection": -0.3}
    told = person_in_words(population("parker2000"), {"basal_insulin_mU_min": 31.24, "parameters": drawn})
    basal, first, second, _ = told.split("; ")
    assert basal == "basal rate 31.2 mU/min"
    assert {first, second} == {
        "fraction of insulin cleared by the liver 0.52, 30 % above the usual 0.4",
        "insulin on hepatic uptake: inflection -0.3, below the usual 0",
    }


def test_a_person_with_insulin_under_the_skin_is_told_in_the_unit_of_pumps_too():
    people = population("boiroux2017", patient="hovorka-2004")
    drawn = {name: of.centre for name, of in people.distributions().items()}
    told = person_in_words(people, {"basal_insulin_mU_min": 6.7288, "parameters": drawn})
    assert told.startswith("basal rate 6.7 mU/min (0.40 U/h); ")


@pytest.mark.parametrize(
    ("patient", "name"),
    [("parker-1999", "lognormal"), ("hovorka-2004", "boiroux2017"), ("wilinska-2010", "wilinska2010")],
)
def test_every_parameter_that_varies_has_words(patient, name):
    of = population(name, patient=patient)
    drawn = {parameter: distribution.upper for parameter, distribution in of.distributions().items()}
    told = person_in_words(of, {"basal_insulin_mU_min": 10.0, "parameters": drawn})
    assert not [word for word in told.split() if word in drawn]
