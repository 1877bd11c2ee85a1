"""Texts of a therapy by the clock, and profiles in files."""

import contextlib
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.refusal import Refusal
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.therapy_settings import OVERRIDES
from glucoloop.situations.therapy_text import change_text, parse_change, profile_texts, target_change
from glucoloop.therapy import TARGET, Schedule, TherapyChange
from glucoloop.units import MG_DL_PER_MMOL_L, MU_MIN_PER_U_H


def test_texts_are_what_they_say():
    assert parse_change("basal, +10%, 0h-6h") == TherapyChange("basal_mU_min", 0.0, 360.0, factor=1.1)
    assert parse_change("basal, 0.9 U/h") == TherapyChange("basal_mU_min", 0.0, 1440.0, value=0.9 * MU_MIN_PER_U_H)
    assert parse_change("carb_ratio, 8, breakfast") == TherapyChange("carb_ratio_g_U", 300.0, 660.0, value=8.0)
    assert parse_change("correction, 2.5 mmol/l/U, 22:30-06:00").value == 2.5 * MG_DL_PER_MMOL_L
    assert target_change("110@22h") == TherapyChange(TARGET, 1320.0, 1440.0, value=110.0)
    assert target_change("150@17h-19h") == TherapyChange(TARGET, 1020.0, 1140.0, value=150.0)


@given(st.sampled_from(["basal", "carb_ratio", "correction"]), st.floats(11.0, 900.0), st.integers(0, 1439))
def test_a_text_is_read_as_it_was_written(name, percent, start):
    change = parse_change(f"{name}, {percent!r}%, {start}min-1440min")
    again = parse_change(change_text(change))
    assert again.factor == pytest.approx(change.factor, rel=1e-15)
    assert again[:3] == change[:3]


@given(st.text(max_size=30))
def test_any_other_text_is_refused_in_a_sentence(text):
    for read in (parse_change, target_change):
        with contextlib.suppress(Refusal):
            assert isinstance(read(text), TherapyChange)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("basl, +10%", "did you mean 'basal'"),
        ("basal, 90", "from 0 to 30 U/h"),
        ("basal, 2%", "10% to 1000%"),
        ("basal, 10 mg", "no unit of basal"),
        ("basal, +10%, 6h", "hours of the day"),
        ("basal, +10%, 25h-26h", "no time of day"),
        ("basal, +10%, 6h-6h", "empty"),
        ("basal", "write it like"),
    ],
)
def test_a_wrong_text_is_refused(text, says):
    with pytest.raises(Refusal, match=says):
        parse_change(text)


def test_a_profile_of_a_file_holds_from_each_time_until_the_next(tmp_path):
    file = tmp_path / "profile.toml"
    file.write_text('basal_U_h = {"06:00" = 1.1, "00:00" = 0.9, "22:00" = "80%"}\ntarget_mg_dl = 105\n')
    changes = Schedule(tuple(map(parse_change, profile_texts([str(file)]))))
    basal = [float(changes.value("basal_mU_min", 10.0, hour * 60.0)) for hour in (0, 5, 6, 21, 22, 23)]
    assert basal == pytest.approx([15.0, 15.0, 1100 / 60, 1100 / 60, 8.0, 8.0])
    assert float(changes.value(TARGET, 110.0, 600.0)) == 105.0


def test_a_profile_of_nightscout_is_read_as_exported(tmp_path):
    day = {
        "units": "mmol",
        "timezone": "Europe/Berlin",
        "basal": [{"time": "00:00", "value": 0.6, "timeAsSeconds": 0}, {"time": "05:30", "value": "0.75"}],
        "carbratio": [{"time": "00:00", "value": 12}],
        "sens": [{"time": "00:00", "value": 3}],
        "target_low": [{"time": "00:00", "value": 5}, {"time": "22:00", "value": 6}],
        "target_high": [{"time": "00:00", "value": 6}],
    }
    old = {"startDate": "2020-01-01T00:00:00Z", "defaultProfile": "Default", "store": {"Default": {"basal": []}}}
    new = {"startDate": "2024-01-01T00:00:00Z", "defaultProfile": "Default", "store": {"Default": day}}
    file = tmp_path / "profile.json"
    file.write_text(json.dumps([new, old]))
    schedule = Schedule(tuple(map(parse_change, profile_texts([str(file)]))))
    at_6, at_23 = (
        [
            float(schedule.value(field, 1.0, time))
            for field in ("basal_mU_min", "carb_ratio_g_U", "correction_mg_dl_U", TARGET)
        ]
        for time in (360.0, 1380.0)
    )
    assert at_6 == pytest.approx([12.5, 12.0, 3 * MG_DL_PER_MMOL_L, 5.5 * MG_DL_PER_MMOL_L])
    assert at_23 == pytest.approx([12.5, 12.0, 3 * MG_DL_PER_MMOL_L, 6.0 * MG_DL_PER_MMOL_L])
    assert float(schedule.value("basal_mU_min", 1.0, 329.0)) == pytest.approx(10.0)
    file.write_text("{}")
    with pytest.raises(Refusal, match="no profile of Nightscout"):
        profile_texts([str(file)])


def test_an_override_scales_insulin_and_sets_the_target():
    override = OVERRIDES.choose("exercise, from=17h, to=19h, insulin=70%")
    schedule = Schedule(override.changes())
    assert float(schedule.value(TARGET, 110.0, 1020.0)) == 150.0
    assert float(schedule.value("basal_mU_min", 10.0, 1139.0)) == pytest.approx(7.0)
    assert float(schedule.value("carb_ratio_g_U", 7.0, 1139.0)) == pytest.approx(10.0)
    assert float(schedule.value("basal_mU_min", 10.0, 1140.0)) == 10.0


def test_a_therapy_by_the_clock_needs_the_time_at_the_start():
    with pytest.raises(Refusal, match="--start 06:00"):
        configured(Run, {"patient": "hovorka-2004", "targets": ["110@22h"]})
