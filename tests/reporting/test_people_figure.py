"""People's runs in a picture."""

import numpy as np
import pytest

import glucoloop as gl
from glucoloop.reporting.figure import _bands
from glucoloop.trials.people_run import PeopleRun


def run_of(people=40, samples=24, shift=0.0):
    """A run whose person i lies i mg/dl above 80."""
    level = np.arange(people, dtype=float)
    return PeopleRun(
        metrics=None,
        t_min=5.0 * np.arange(samples + 1),
        glucose_mg_dl=np.tile(80.0 + shift + level, (samples + 1, 1)),
        insulin_mU_min=np.tile(20.0 + level / 10.0, (samples, 1)),
        engine="native",
        scenario=gl.Scenario([gl.Meal(50.0, 50.0)], 5.0 * samples),
        setpoint_mg_dl=81.1,
    )


def test_bands_are_percentiles_of_those_who_have_a_course():
    values = np.tile(np.arange(101.0), (3, 1))
    np.testing.assert_allclose(_bands(values), np.tile([[5.0], [25.0], [50.0], [75.0], [95.0]], 3))
    values[1, 7] = np.nan
    np.testing.assert_allclose(_bands(values), np.percentile(np.delete(values, 7, axis=1), [5, 25, 50, 75, 95], axis=1))
    with pytest.raises(ValueError, match="no person has a finite course"):
        _bands(np.full((3, 4), np.nan))


def test_people_are_drawn_as_bands_about_their_median(tmp_path):
    figure = gl.plot({"PID": run_of(), "MPC": run_of(shift=10.0)}, title="Two controllers")
    above, below = figure.axes
    medians = [line.get_ydata()[0] for line in above.lines[:2]]
    np.testing.assert_allclose(medians, [99.5, 109.5])
    assert len(above.collections) == len(below.collections) == 4
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts[:3] == ["PID: 90 % of people", "PID: 50 % of people", "PID: median"]
    assert "setpoint 81.1 mg/dl" in texts
    figure.savefig(tmp_path / "people.png")
    assert (tmp_path / "people.png").stat().st_size > 10_000


def test_people_may_have_glucose_in_mmol_l_and_rates_in_units_per_hour():
    figure = gl.plot(run_of(), mmol=True, subcutaneous=True)
    figure.draw_without_rendering()
    (mmol,) = figure.axes[0].child_axes
    assert (mmol.get_ylabel(), figure.axes[1].get_ylabel()) == ("Glucose (mmol/l)", "Insulin (U/h)")
    np.testing.assert_allclose(figure.axes[1].get_ylim(), 0.06 * np.array(gl.plot(run_of()).axes[1].get_ylim()))


def test_one_run_needs_no_label():
    assert gl.plot(run_of()).legends[0].get_texts()[2].get_text() == "glucose: median"


@pytest.mark.parametrize(
    ("traces", "sentence"),
    [
        ({"a": 3}, "traces holds int, which cannot be drawn; give what simulate"),
        (None, "traces holds NoneType"),
        ({}, "there is no trace to show"),
    ],
)
def test_what_is_no_run_is_refused(traces, sentence):
    with pytest.raises(ValueError, match=sentence):
        gl.plot(traces)
