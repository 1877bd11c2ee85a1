"""A continuous glucose monitor on the page is that of glucoloop, in readings and glucose of whole runs."""

import numpy as np
import pytest

from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import surroundings_of
from page_loops import run_of

RUNS = [
    "#controller=pid&sensor=dexcom-g6",
    "#controller=mpc&sensor=dexcom-g6,+worn_min=0&seed=3",
    "#patient=hovorka-2004&controller=mpc&sensor=dexcom-g5,+display=false&sensor=dead-time,+minutes=10&seed=2",
    "#patient=wilinska-2010&controller=mpc-se&sensor=facchinetti-2014,+noise=false&faults=missing,+start_min=100",
    "#controller=imc&sensor=dexcom-g6,+lag_min=0,+drift=false,+worn_min=14300&seed=4",
]
CLOSE_MG_DL = 1e-4
"""A part in 10^6, to which the page's models are those of a fit on another processor."""


@pytest.mark.long
@pytest.mark.parametrize("link", RUNS)
def test_a_run_with_a_monitor_is_that_of_the_page(link, in_node):
    [answer] = in_node([link])
    run = run_of(answer["toml"])
    trace = close_loop(run, controller_of(run, run.case), run.as_scenario(), surroundings=surroundings_of(run))
    glucose, reading = (np.array(answer["trace"][name], float) for name in ("fine_glucose_mg_dl", "reading_mg_dl"))
    np.testing.assert_allclose(glucose, trace.fine_glucose_mg_dl, rtol=0.0, atol=CLOSE_MG_DL)
    np.testing.assert_allclose(reading, trace.reading_mg_dl, rtol=0.0, atol=CLOSE_MG_DL)
    assert np.isfinite(reading).any()


def test_readings_are_missing_while_a_monitor_warms_up_and_whole_from_then_on(in_node):
    [answer] = in_node(["#controller=pid&sensor=dexcom-g6,+worn_min=0"])
    reading = np.array(answer["trace"]["reading_mg_dl"], float)
    assert np.isnan(reading[:24]).all()
    np.testing.assert_array_equal(reading[24:], np.round(reading[24:]))


def test_a_monitor_is_told_in_every_form(in_node):
    [answer] = in_node(["#controller=pid&sensor=dexcom-g6,+noise=false,+worn_min=0&sensor=dead-time,+minutes=5"])
    assert answer["again"]["situation"] == answer["situation"]
    assert "--sensor 'dexcom-g6, noise=false, worn_min=0' --dead-time 5" in answer["command"]
    assert '"dexcom-g6, noise=false, worn_min=0", "dead-time, minutes=5"' in answer["toml"]
    assert '"dexcom-g6, noise=false, worn_min=0", "dead-time, minutes=5"' in answer["python"]


@pytest.mark.parametrize(
    ("link", "sentence"),
    [
        ("#sensor=dexcom-g6,+lag_min=5", "lag min is 5; give a multiple of 10 from 0 to 10"),
        ("#sensor=dexcom-g6,+worn_min=14400", "worn min is 14400; give from 0 to 14395"),
        ("#sensor=dexcom-g6&sensor=dexcom-g5", "it has the sensor dexcom-g5, which this page cannot simulate"),
        ("#sensor=white-noise&sensor=dexcom-g6", "it has the sensor dexcom-g6, which this page cannot simulate"),
        ("#sensor=vettoretti-2019", "it has the sensor vettoretti-2019, which this page cannot simulate"),
        ("#sensor=dexcom-g6,+wear_min=1440", "it has sensor.wear_min = 1440, which this page cannot simulate"),
        (
            "#controller=mpc,+prediction_horizon=3&sensor=dexcom-g6",
            "a prediction horizon of 3 samples sees less than 5 % of the gain of insulin; a controller that sees so "
            "little gives far too much or too little, so give a prediction horizon of 4 or more",
        ),
    ],
)
def test_what_the_page_has_no_monitor_for_is_refused(link, sentence, in_node):
    assert in_node([link])[0]["refused"] == sentence


@pytest.mark.long
def test_glucoloop_refuses_the_horizon_that_the_page_refuses_behind_a_lag(in_node):
    answers = in_node(
        [f"#controller=mpc,+prediction_horizon={p}&sensor=dexcom-g6,+lag_min={lag}" for p, lag in ((4, 10), (3, 0))]
    )
    for answer in answers:
        run = run_of(answer["toml"])
        controller_of(run, run.case)
    refused = run_of(answers[1]["toml"].replace(", lag_min=0", ""))
    with pytest.raises(ValueError, match="give a prediction horizon of 4 or more"):
        controller_of(refused, refused.case)
