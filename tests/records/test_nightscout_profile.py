"""Usual basal rates of Nightscout's profiles; rates under a switch are those that Nightscout and AndroidAPS show."""

import json
from datetime import UTC, datetime, timedelta

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device_files import START, nightscout_entries, nightscout_treatments
from glucoloop.records import nightscout_site
from glucoloop.records.nightscout_profile import usual_rates
from nightscout_server import UNTIL, running_site

DAY = datetime(2026, 9, 24, tzinfo=UTC)


def stepped(zone="UTC", rates=(1.0, 2.0, 3.0)):
    times = ("00:00", "10:00", "12:00")
    return {"timezone": zone, "basal": [{"time": time, "value": rate} for time, rate in zip(times, rates, strict=True)]}


def profile(store=None, begin="2020-01-01T00:00:00Z"):
    return {"defaultProfile": "Default", "startDate": begin, "store": store or {"Default": stepped()}}


def switch(**changes):
    """A switch as AndroidAPS sends it to Nightscout."""
    return {"profile": "Default (150%)", "duration": 1440, "profileJson": json.dumps(stepped()), **changes}


def rate_at(rates, text):
    at = DAY + timedelta(hours=int(text[:2]), minutes=int(text[3:]))
    return [rate for moment, rate in rates if moment <= at][-1]


def day_of(profiles, *switches, zone=None):
    return usual_rates(profiles, switches, DAY, DAY + timedelta(days=1), zone)


H = 3_600_000
LOOKED_AT = [
    (150, 0, {"09:00": 1.5, "11:00": 3.0, "13:00": 4.5}),
    (50, 0, {"09:00": 0.5, "11:00": 1.0, "13:00": 1.5}),
    (150, 2 * H, {"09:00": 1.5, "11:00": 1.5, "13:00": 3.0, "14:30": 4.5}),
    (150, -2 * H, {"07:00": 1.5, "09:00": 3.0, "11:00": 4.5, "23:00": 1.5}),
    (100, 1.5 * H, {"11:00": 2.0, "10:30": 1.0}),
]


@pytest.mark.parametrize(("percentage", "timeshift", "expected"), LOOKED_AT)
def test_a_switch_of_androidaps_scales_and_shifts_its_schedule(percentage, timeshift, expected):
    since = DAY - timedelta(hours=1)
    rates = day_of([profile()], (since, switch(percentage=percentage, timeshift=timeshift, duration=2000)))
    assert {text: rate_at(rates, text) for text in expected} == expected


def test_a_switch_ends_and_the_default_schedule_goes_on():
    rates = day_of([profile()], (DAY + timedelta(minutes=30), switch(percentage=150, duration=60)))
    assert {text: rate_at(rates, text) for text in ("00:00", "00:30", "01:29", "01:30", "11:00")} == {
        "00:00": 1.0,
        "00:30": 1.5,
        "01:29": 1.5,
        "01:30": 1.0,
        "11:00": 2.0,
    }


def test_a_switch_of_an_older_androidaps_is_scaled_and_not_shifted():
    rates = day_of([profile()], (DAY, switch(percentage=150, timeshift=2, CircadianPercentageProfile=True)))
    assert rate_at(rates, "11:00") == 3.0


def test_a_switch_by_name_takes_the_schedule_of_the_profile_in_force():
    old = {"Default": stepped(), "Sport": stepped(rates=(0.5, 0.5, 0.5))}
    new = {"Default": stepped(), "Sport": stepped(rates=(0.4, 0.4, 0.4))}
    profiles = [profile(new, "2026-09-24T06:00:00Z"), profile(old)]
    rates = day_of(profiles, (DAY + timedelta(hours=1), {"profile": "Sport", "percentage": 150}))
    assert rates == [(DAY, 1.0), (DAY + timedelta(hours=1), 0.75), (DAY + timedelta(hours=6), pytest.approx(0.6))]


def test_a_switch_for_good_ends_all_before_it():
    flat = {name: stepped(rates=(rate,) * 3) for name, rate in (("Default", 1.0), ("A", 0.1), ("B", 0.2), ("C", 0.3))}
    told = [("A", 0, 60), ("B", 120, 60), ("C", 0, 90)]
    switches = [(DAY + timedelta(minutes=at), {"profile": name, "duration": long}) for name, long, at in told]
    rates = day_of([profile(flat)], *switches)
    assert [(round((moment - DAY).total_seconds() / 60), rate) for moment, rate in rates] == [
        (0, 1.0),
        (60, 0.2),
        (90, 0.3),
    ]


def test_before_the_first_profile_the_rate_is_not_known():
    rates = day_of([profile(begin="2026-09-24T06:00:00+00:00")])
    assert str(rates[0][1]) == "nan"
    assert rates[1] == (DAY + timedelta(hours=6), 1.0)


def test_steps_keep_their_hour_when_the_clock_changes():
    begin = datetime(2024, 3, 30, 23, tzinfo=UTC)  # midnight in Berlin, where the clock goes forward at two
    rates = usual_rates([profile({"Default": stepped("Europe/Berlin")})], [], begin, begin + timedelta(hours=23), None)
    assert [(moment.hour, rate) for moment, rate in rates] == [(23, 1.0), (8, 2.0), (10, 3.0), (22, 1.0)]


def test_a_zone_as_loop_writes_it_and_a_rate_as_a_text():
    store = {"Default": {"timezone": "ETC/GMT+5", "basal": [{"time": "00:00", "value": "0.85"}]}}
    assert day_of([profile(store)]) == [(DAY, 0.85)]


def test_files_of_a_person_are_read_together(read):
    store = {"Default": {"timezone": "Etc/GMT-1", "basal": [{"time": "00:00", "value": 0.8}]}}
    at = [START + timedelta(minutes=minutes) for minutes in (0, 10, 60, 90)]
    treatments = nightscout_treatments(
        (at[0], {"eventType": "Meal Bolus", "insulin": 4, "carbs": 45}),
        (at[1], {"eventType": "Temp Basal", "absolute": 0.5, "duration": 30}),
        (at[2], {"eventType": "Temp Basal", "percent": 50, "duration": 15}),
        (at[3], {"eventType": "Correction Bolus", "insulin": 1}),
    )
    record = read(nightscout_entries(), json.dumps([profile(store)]), treatments)
    rates = record.frame.filter(pl.col("basal_U_h").is_not_null())
    expected = [(0, 0.8), (10, 0.5), (40, 0.8), (60, 1.2), (75, 0.8)]
    assert rates["time"].to_list() == [START + timedelta(minutes=minutes) for minutes, _ in expected]
    assert rates["basal_U_h"].to_list() == pytest.approx([rate for _, rate in expected])
    assert "The usual basal rate is that of the profiles of Nightscout; it changes 0 times." in " ".join(record.notes)
    assert not record.left_out


def test_a_profile_alone_is_refused(refused):
    assert refused(json.dumps([profile()])) == (
        "it has no readings, meals or insulin, only what helps to read other files; give those too"
    )


def test_a_site_tells_the_usual_rate():
    with running_site() as site:
        site.data["profile"] = [profile({"Default": stepped("Europe/Berlin", (0.7, 0.7, 0.7))})]
        rates = nightscout_site.read_nightscout(site.url, days=2, until=UNTIL).frame["basal_U_h"].drop_nulls()
    assert rates.to_list() == [0.7]


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=8) | st.sampled_from(["00:00", "25:99", "UTC", "basal"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["basal", "time", "value", "timezone", "Default"]), inner, max_size=4)
    ),
    max_leaves=12,
)


@given(
    store=st.dictionaries(st.sampled_from(["Default", "Sport", ""]), ANYTHING, max_size=3),
    told=st.dictionaries(
        st.sampled_from(["profile", "duration", "percentage", "timeshift", "profileJson"]), ANYTHING, max_size=5
    ),
    begin=ANYTHING,
)
def test_anything_in_a_profile_gives_rates_or_nan(store, told, begin):
    given_one = {"defaultProfile": "Default", "startDate": begin, "mills": begin, "store": store}
    for _, rate in day_of([given_one], (DAY, told)):
        assert rate != rate or rate >= 0.0


def test_a_treatment_of_1970_does_not_fill_decades_with_rates(read):
    meals = [(START + timedelta(minutes=n), {"eventType": "Meal Bolus", "insulin": 1.0}) for n in range(120)]
    far = (datetime(1970, 1, 1), {"eventType": "Meal Bolus", "insulin": 1.0})
    record = read(nightscout_treatments(far, *meals), json.dumps([profile(begin="1969-01-01T00:00:00Z")]))
    assert record.frame["time"][0] == START
    assert record.frame["basal_U_h"].drop_nulls().to_list() == [3.0, 1.0]  # until midnight in UTC, and from there on
