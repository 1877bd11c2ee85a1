"""Where the patient's model is not valid: periods, sentences, picture and page."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.metrics import summarise
from glucoloop.reporting import interactive_page, plot
from glucoloop.reporting.labelled_traces import periods_below, validity, validity_note

HIGH, LOW = 80.0, 30.0


def with_low(make_trace, *minutes, samples=20, **fields):
    glucose = np.full(5 * samples + 1, HIGH)
    for first, last in minutes:
        glucose[first : last + 1] = LOW
    return make_trace(glucose, **fields)


@given(st.lists(st.sampled_from([20.0, 39.9, 40.0, 41.0, np.nan]), min_size=1, max_size=30))
def test_periods_hold_the_points_below_and_no_others(values):
    glucose, t = np.array(values), 2.0 * np.arange(len(values))
    found = periods_below(t, glucose, 40.0)
    inside = np.zeros(len(values), bool)
    for first, last in found:
        inside |= (t >= first) & (t <= last)
    assert np.array_equal(inside, glucose < 40.0)
    # A point that is not below lies between any two periods.
    assert all(after > last + 2.0 for (_, last), (after, _) in itertools.pairwise(found))


@pytest.mark.parametrize(
    ("minutes", "when"),
    [
        ([(10, 20)], "from 10 to 20 min"),
        ([(0, 0)], "at 0 min"),
        ([(10, 20), (40, 100)], "from 10 to 20 min and from 40 to 100 min"),
        ([(10, 12), (20, 22), (30, 32)], "from 10 to 12 min, from 20 to 22 min and from 30 to 32 min"),
        ([(10, 12), (20, 22), (30, 32), (40, 42)], "from 10 to 12 min, from 20 to 22 min and in 2 later periods"),
    ],
)
def test_note_tells_when(make_trace, minutes, when):
    assert validity_note(with_low(make_trace, *minutes)) == (
        f"Glucose was below 40.0 mg/dl {when}: the patient's model is not valid there. Read these values as severe "
        "hypoglycemia; their depth means nothing."
    )


def test_valid_run_has_no_note(make_trace):
    trace = with_low(make_trace)
    assert validity_note(trace) is None
    assert validity(trace) == {"lowest_valid_mg_dl": 40.0, "periods_below_min": []}
    assert float(summarise(trace).time_below_validity_pct) == 0.0
    assert "not valid" not in interactive_page(trace, summarise(trace))


def test_page_and_picture_tell_of_it(make_trace):
    low, fine = with_low(make_trace, (10, 19)), with_low(make_trace)
    assert float(summarise(low).time_below_validity_pct) == pytest.approx(100.0 * 10 / 101)
    traces = {"deep <b>": low, "fine": fine}
    page = interactive_page(traces, {label: summarise(trace) for label, trace in traces.items()})
    assert '<li>deep &lt;b&gt;: Glucose was below <span class="mg">40.0 mg/dl' in page
    assert "from 10 to 19 min: the patient&#39;s model" in page
    assert 'model not valid below <span class="mg">40 mg/dl' in page
    assert "Time below the model&#39;s validity" in page
    texts = [text.get_text() for text in plot(traces).legends[0].get_texts()]
    assert "model not valid, below 40.0 mg/dl" in texts
