"""Faults by name: their texts, what is refused, and an object behind every name."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.experiments.faulty import episodes_of, faulty_pump, faulty_sensor
from glucoloop.pumps import PARKER_1999_LIMITS, LimitedPump
from glucoloop.registry.fault_text import fault_text, parse_fault
from glucoloop.registry.faults import FAULTS, fault
from glucoloop.sensors import IdealSensor
from glucoloop.studies.stress.cells import STANDARD_FAULTS


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_made_with_its_defaults(name):
    told = fault(name)
    sensor = faulty_sensor(IdealSensor(), [told], 5.0)
    pump = faulty_pump(LimitedPump(), [told], 5.0, PARKER_1999_LIMITS)
    assert isinstance(sensor, IdealSensor) == (FAULTS[name].part == "pump")
    assert isinstance(pump, LimitedPump) == (FAULTS[name].part == "sensor")
    assert (sensor if FAULTS[name].part == "sensor" else pump).inner is not None


@pytest.mark.parametrize("text", STANDARD_FAULTS)
def test_what_is_tried_by_default_is_told_in_full(text):
    assert fault_text(parse_fault(text)) == text


NUMBERS = st.floats(0.01, 1e4).map(lambda value: float(f"{value:.6g}"))
TIMES = st.one_of(
    st.fixed_dictionaries({}, optional={"start_min": NUMBERS, "duration_min": NUMBERS}),
    st.fixed_dictionaries({"per_day": NUMBERS}, optional={"duration_min": NUMBERS, "key": st.integers(0, 9)}),
)


@settings(max_examples=100, deadline=None)
@given(st.sampled_from([name for name, entry in FAULTS.items() if entry.timed]), TIMES)
def test_a_fault_is_read_again_from_its_text(name, when):
    told = fault(name, when)
    assert parse_fault(fault_text(told)) == told


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("mising", "unknown fault 'mising'; did you mean 'missing'?"),
        ("missing, start=3", "the fault missing has no setting 'start'; did you mean 'start_min'?"),
        ("missing, start_min=soon", "start_min is 'soon'; give a number"),
        ("missing, start_min=-5", "start_min of the fault missing is -5; give a finite value of 0 or more"),
        ("missing, duration_min=0", "duration_min of the fault missing is 0; give a finite value above 0"),
        ("missing, start_min=inf", "start_min of the fault missing is inf"),
        ("missing, start_min=60, latest_min=30", "begin from 60 to 30 min; give a latest_min of 60 or more"),
        ("spikes, per_day=3, start_min=4", "has both per_day and start_min"),
        ("missed-pulses, start_min=4", "the fault missed-pulses has no setting 'start_min'"),
        ("late, delay_min=15, delay_min=20", "delay_min is given twice"),
        ("late, delay_min", "'delay_min' in the fault"),
        ("occlusion, noticed=maybe", "noticed is 'maybe'; give true or false"),
        ("=3", "'=3' is not a fault; write one like"),
        ("", "'' is not a fault; write one like"),
    ],
)
def test_what_is_no_fault_is_refused_in_a_sentence(text, sentence):
    with pytest.raises(ValueError, match=r"^.*$") as refused:
        parse_fault(text)
    assert sentence in str(refused.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("late, delay_min=0", "a delay of 0 min is not possible; give a finite value above 0"),
        ("late, delay_min=inf", "a delay of inf min is not possible"),
        ("calibration, gain=-1", "a calibration gain of -1 is not possible"),
        ("compression, depth=0", "a compression depth of 0 is not possible; give a value above 0 and up to 1"),
        ("saturation, low_mg_dl=90, high_mg_dl=80", "a sensor range of 90 to 80 mg/dl is not possible"),
        ("missed-pulses, share=2", "a share of missed doses of 2 is not possible; give 0 to 1"),
    ],
)
def test_a_setting_out_of_its_bounds_is_refused_where_the_text_is_read(text, sentence):
    with pytest.raises(ValueError, match="possible") as refused:
        parse_fault(text)
    assert sentence in str(refused.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("late, delay_min=9000", "a delay of 1800 samples is not possible"),
        ("spikes, per_day=300", "per_day of the fault spikes is 300; give at most one a sample, 288"),
    ],
)
def test_what_cannot_be_made_is_refused_where_it_is_made(text, sentence):
    told = parse_fault(text)

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
    when = episodes_of(parse_fault(text), 5.0)
    assert (when.earliest, when.latest, when.length) == (earliest, latest, length)
    assert when.probability == pytest.approx(probability)
    assert when.random == ("per_day" in text)


def test_the_first_fault_stands_next_to_the_sensor():
    faults = [parse_fault("drift"), parse_fault("occlusion"), parse_fault("missing")]
    sensor = faulty_sensor(IdealSensor(), faults, 5.0)
    assert [type(sensor).__name__, type(sensor.inner).__name__] == ["Missing", "Drift"]
