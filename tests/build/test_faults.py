"""Faults by name: their texts, what is refused, and an object behind every name."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.build.surroundings import faulty_pump, faulty_sensor
from glucoloop.faults import FAULTS
from glucoloop.pumps import PARKER_1999_LIMITS, LimitedPump
from glucoloop.sensors import IdealSensor
from glucoloop.studies.stress import STANDARD_FAULTS


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_made_with_its_defaults(name):
    told = FAULTS[name]()
    sensor = faulty_sensor(IdealSensor(), [told], 5.0)
    pump = faulty_pump(LimitedPump(), [told], 5.0, PARKER_1999_LIMITS)
    assert isinstance(sensor, IdealSensor) == (FAULTS[name].part == "pump")
    assert isinstance(pump, LimitedPump) == (FAULTS[name].part == "sensor")
    assert (sensor if FAULTS[name].part == "sensor" else pump).inner is not None


@pytest.mark.parametrize("text", STANDARD_FAULTS)
def test_what_is_tried_by_default_is_told_in_full(text):
    assert FAULTS.choose(text).text == text


NUMBERS = st.floats(0.01, 1e4).map(lambda value: float(f"{value:.6g}"))
TIMES = st.one_of(
    st.fixed_dictionaries({}, optional={"start_min": NUMBERS, "duration_min": NUMBERS}),
    st.fixed_dictionaries({"per_day": NUMBERS}, optional={"duration_min": NUMBERS, "key": st.integers(0, 9)}),
)


@settings(max_examples=100, deadline=None)
@given(st.sampled_from([name for name, entry in FAULTS.items() if entry.timed]), TIMES)
def test_a_fault_is_read_again_from_its_text(name, when):
    told = FAULTS[name](**when)
    assert FAULTS.choose(told.text) == told


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("mising", "unknown fault 'mising'; did you mean 'missing'?"),
        ("missing, starts=3", "the fault missing has no setting 'starts'; did you mean 'start_min'?"),
        ("missing, start_min=soon", "start_min is 'soon'; give a finite number"),
        ("missing, start_min=-5", "start_min is -5 min; give a finite number of 0 min or more"),
        ("missing, duration_min=0", "duration_min is 0 min; give a finite number above 0 min"),
        ("missing, start_min=inf", "start_min is inf min"),
        ("missing, start_min=60, latest_min=30", "begin from 60 to 30 min; give a latest_min of 60 or more"),
        ("spikes, per_day=3, start_min=4", "has both per_day and start_min"),
        ("missed-pulses, start_min=4", "the fault missed-pulses has no setting 'start_min'"),
        ("late, delay_min=15, delay_min=20", "delay_min is given twice"),
        ("late, delay_min", "'delay_min' in 'late, delay_min' is no setting with a value"),
        ("occlusion, noticed=maybe", "noticed is 'maybe'; give true or false"),
        ("=3", "'=3' in '=3' is no setting with a value; write it like"),
        ("", "no fault is named; begin with its name, like"),
    ],
)
def test_what_is_no_fault_is_refused_in_a_sentence(text, sentence):
    with pytest.raises(ValueError, match=r"^.*$") as refused:
        FAULTS.choose(text)
    assert sentence in str(refused.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("late, delay_min=0", "delay_min is 0 min; give a finite number above 0 min"),
        ("late, delay_min=inf", "delay_min is inf min"),
        ("calibration, gain=-1", "gain is -1; give"),
        ("compression, depth=0", "depth is 0; give a number above 0 and up to 1"),
        ("saturation, low_mg_dl=90, high_mg_dl=80", "a sensor range of 90 to 80 mg/dl is not possible"),
        ("missed-pulses, share=2", "share is 2; give a number from 0 to 1"),
    ],
)
def test_a_setting_out_of_its_bounds_is_refused_where_the_text_is_read(text, sentence):
    with pytest.raises(ValueError, match="give") as refused:
        FAULTS.choose(text)
    assert sentence in str(refused.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("late, delay_min=9000", "a delay of 1800 samples is not possible"),
        ("spikes, per_day=300", "per_day of the fault spikes is 300; give at most one a sample, 288"),
    ],
)
def test_what_cannot_be_made_is_refused_where_it_is_made(text, sentence):
    told = FAULTS.choose(text)

    def make():
        faulty_sensor(IdealSensor(), [told], 5.0)
        faulty_pump(LimitedPump(limits=PARKER_1999_LIMITS), [told], 5.0, PARKER_1999_LIMITS)

    with pytest.raises(ValueError, match=r"possible|per_day") as refused:
        make()
    assert sentence in str(refused.value)


@pytest.mark.parametrize(
    ("text", "earliest", "latest", "length", "probability"),
    [
        ("missing", 0.0, 0.0, math.inf, 0.0),
        ("missing, start_min=12, duration_min=11", 3.0, 3.0, 3.0, 0.0),
        ("missing, start_min=10, latest_min=20", 2.0, 4.0, math.inf, 0.0),
        ("missing, duration_min=60", 0.0, 0.0, 12.0, 0.0),
        ("missing, per_day=144", math.inf, math.inf, 1.0, 0.5),
        ("missing, per_day=14.4, duration_min=15", math.inf, math.inf, 3.0, 0.05),
    ],
)
def test_minutes_become_samples(text, earliest, latest, length, probability):
    when = FAULTS.choose(text).episodes
    assert (when.earliest, when.latest, when.length) == (earliest, latest, length)
    assert when.probability == pytest.approx(probability)
    assert when.random == ("per_day" in text)


def test_the_first_fault_stands_next_to_the_sensor():
    faults = [FAULTS.choose("drift"), FAULTS.choose("occlusion"), FAULTS.choose("missing")]
    sensor = faulty_sensor(IdealSensor(), faults, 5.0)
    assert [type(sensor).__name__, type(sensor.inner).__name__] == ["Missing", "Drift"]
