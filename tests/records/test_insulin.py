"""Everything that changes insulin is read, or named as such; amounts that nobody can mean are asked about."""

import json
from datetime import timedelta

import polars as pl
import pytest

from device_files import START, carelink, every, nightscout_treatments, tandem
from naming import naming
from record_values import minutes, notes_of, profile, rates_of, values


def doses(record):
    return [tuple(row) for row in record.frame.filter(pl.col("bolus_U") > 0).select("bolus_U", "bolus_min").rows()]


@pytest.mark.parametrize(
    ("combo", "expected"),
    [
        ({"duration": 30, "splitNow": 0, "splitExt": 100, "enteredinsulin": 7, "relative": 14}, [(7.0, 30.0)]),
        (
            {"duration": 120, "splitNow": 40, "splitExt": 60, "enteredinsulin": 10, "insulin": 4, "relative": 3},
            [(4.0, None), (6.0, 120.0)],
        ),
        ({"duration": "60", "enteredinsulin": "5", "splitNow": "50", "splitExt": "50"}, [(2.5, None), (2.5, 60.0)]),
        ({"durationInMilliseconds": 1_800_000, "relative": 2.0}, [(1.0, 30.0)]),
        ({"duration": 0, "enteredinsulin": 3}, [(3.0, None)]),
    ],
)
def test_combo_boluses(read, combo, expected):
    record = read(nightscout_treatments((START, {"eventType": "Combo Bolus", **combo})))
    assert doses(record) == expected


def test_what_nobody_gets_is_named(read):
    record = read(
        nightscout_treatments(
            (START, {"eventType": "Meal Bolus", "insulin": 5, "carbs": 50, "isValid": False}),
            (START + timedelta(hours=1), {"eventType": "Meal Bolus", "insulin": 2, "carbs": 20, "isValid": True}),
            (START + timedelta(hours=2), {"eventType": "Correction Bolus", "insulin": 1, "type": "PRIMING"}),
            (START + timedelta(hours=3), {"eventType": "Bolus"}),
        )
    )
    assert (record.frame["bolus_U"].sum(), record.frame["carbs_g"].sum()) == (2.0, 20.0)
    assert record.left_out == {
        "entries that were deleted": 1,
        "insulin that fills a tube or a cannula, which nobody gets": 1,
        "entries about insulin without a dose": 1,
    }


def test_pens_of_long_acting_insulin(read):
    pens = json.dumps([{"insulin": "Lantus", "units": 18.0}, {"insulin": "NovoRapid", "units": 4.0}])
    record = read(
        nightscout_treatments(
            (START, {"eventType": "<none>", "insulin": 22, "insulinInjections": pens}),
            (START + timedelta(hours=1), {"eventType": "Long-Acting Insulin", "insulin": 10}),
        )
    )
    assert record.frame["long_acting_U"].drop_nulls().to_list() == [18.0, 10.0]
    assert record.frame["bolus_U"].drop_nulls().to_list() == [4.0]


@pytest.mark.parametrize(
    ("stop", "go"),
    [
        ("Suspend Pump", "Resume Pump"),
        ("Pump Suspend", "Pump Resume"),
        ("PumpSuspended", "PumpResumed"),
        ("Suspend", "Unsuspend"),
        ("Pump Stopped", "Pump Started"),
        ("Insulin suspended", "Insulin restarted"),
    ],
)
def test_suspensions_in_each_spelling(read, stop, go):
    meal = {"eventType": "Meal Bolus", "insulin": 1, "carbs": 10}
    at = [START + timedelta(hours=hours) for hours in (0, 2, 5, 8)]
    treatments = nightscout_treatments(
        (at[0], meal), (at[1], {"eventType": stop}), (at[2], {"eventType": go}), (at[3], meal), offset=0
    )
    assert rates_of(read(treatments, profile("UTC"))) == [(at[0], 0.8), (at[1], 0.0), (at[2], 0.8)]


@pytest.mark.parametrize(
    ("temporary", "share"),
    [
        ({"percent": -50}, 0.5),
        ({"percent": "50"}, 1.5),
        ({"temp": "percent", "rate": 150}, 1.5),
        ({"percent": -100}, 0.0),
        ({"isAbsolute": False, "rate": 120}, 1.2),
        ({"isAbsolute": False, "rate": 120, "percent": 20}, 1.2),
        ({"eventType": "Temp Basal Start", "percent": 20}, 1.2),
    ],
)
def test_percentages_as_uploaders_write_them(read, temporary, share):
    meal = {"eventType": "Meal Bolus", "insulin": 1, "carbs": 10}
    at = [START + timedelta(hours=hours) for hours in (0, 2, 3, 8)]
    event = {"eventType": "Temp Basal", "duration": 60, **temporary}
    treatments = nightscout_treatments((at[0], meal), (at[1], event), (at[3], meal), offset=0)
    rates = rates_of(read(treatments, profile("UTC")))
    assert rates == [(at[0], 0.8), (at[1], pytest.approx(0.8 * share)), (at[2], 0.8)]


def test_a_temporary_rate_that_is_ended_by_an_entry(read):
    meal = {"eventType": "Meal Bolus", "insulin": 1, "carbs": 10}
    at = [START + timedelta(hours=hours) for hours in (0, 2, 3, 8)]
    start, end = {"eventType": "Temp Basal Start", "absolute": 0.3, "duration": 120}, {"eventType": "Temp Basal End"}
    treatments = nightscout_treatments((at[0], meal), (at[1], start), (at[2], end), (at[3], meal), offset=0)
    assert rates_of(read(treatments, profile("UTC"))) == [(at[0], 0.8), (at[1], 0.3), (at[2], 0.8)]


@pytest.mark.parametrize(
    "mark", [{"isValid": False}, {"isValid": "false"}, {"isValid": 0}, {"isDeleted": True}, {"deleted": "true"}]
)
def test_entries_that_were_deleted_by_each_mark(read, mark):
    meal = {"eventType": "Meal Bolus", "insulin": 5, "carbs": 50}
    record = read(nightscout_treatments((START, {**meal, **mark}), (START + timedelta(hours=1), meal)))
    assert (record.frame["bolus_U"].sum(), record.left_out) == (5.0, {"entries that were deleted": 1})


def test_a_switch_by_name_with_a_percentage(read):
    meal = {"eventType": "Meal Bolus", "insulin": 1, "carbs": 10}
    at = [START + timedelta(hours=hours) for hours in (0, 2, 5, 8)]
    switch = {"eventType": "Profile Switch", "profile": "Default", "percentage": 50, "duration": 180}
    treatments = nightscout_treatments((at[0], meal), (at[1], switch), (at[3], meal), offset=0)
    assert rates_of(read(treatments, profile("UTC"))) == [(at[0], 0.8), (at[1], 0.4), (at[2], 0.8)]


def table(rows, names="time,glucose_mg_dl,carbs_g,bolus_U,basal_U_h"):
    return "\n".join([names, *(",".join(map(str, row)) for row in rows)]) + "\n"


def with_basal(rates):
    return table([(f"{time:%Y-%m-%d %H:%M}", 100 + n % 9, "", "", rate) for n, (time, rate) in enumerate(rates)])


def test_a_rate_that_is_refused_is_not_known_from_there_on(read):
    rates = [0.9] * 6 + [5.0] + [1910] * 3 + ["x"] + [0.9] * 6
    text = with_basal(zip(every(60, len(rates)), rates, strict=True))
    record = read(text)
    assert str([rate for _, rate in rates_of(record)]) == str([0.9] * 6 + [5.0] + [float("nan")] * 4 + [0.9] * 6)
    assert "not known from there on" in notes_of(record)
    mixed = [rate for _, rate in rates_of(read(text, file_units="basal=U/h|mU/h"))]
    assert mixed[7] == pytest.approx(1.91)


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [("basal", [80] * 20, "a basal rate"), ("bolus", [8400] * 20, "a bolus"), ("carbs", [4000] * 20, "carbohydrate")],
)
def test_amounts_that_nobody_can_mean_are_asked_about(refused, name, values, words):
    place = {"carbs": 2, "bolus": 3, "basal": 4}[name]
    rows = []
    for time, value in zip(every(60, 20), values, strict=True):
        row = [f"{time:%Y-%m-%d %H:%M}", 100, "", "", ""]
        row[place] = value
        rows.append(row)
    sentence = refused(table(rows))
    assert words in sentence
    assert f"file_units='{name}=" in sentence


def test_a_daily_dose_that_nobody_can_mean_is_asked_about(refused):
    rows = [(f"{time:%Y-%m-%d %H:%M}", 100, "", 90, "") for time in every(60, 48)]
    assert "U of boluses on half of its days, which nobody can mean" in refused(table(rows))


@pytest.mark.parametrize(
    ("unit", "rate"), [("mU/h", 0.0009), ("U/5min", 10.8), ("mU/min", 0.054), ("U/day", 0.0375), ("U/h", 0.9)]
)
def test_units_of_any_table(read, unit, rate):
    text = table([("2024-03-13 00:00", 100, 2, "", 0.9), ("2024-03-13 00:05", 101, "", "", 0.9)])
    record = read(text, file_units=f"basal={unit},carbs=10g")
    assert record.frame["basal_U_h"][0] == pytest.approx(rate)
    assert record.frame["carbs_g"][0] == 20.0


def test_a_basal_rate_whose_name_has_no_time(read, refused):
    for name, unit in (("basal (U)", "U"), ("Basal [IE]", "IE"), ("basal_U", "U"), ("Basal units", "units")):
        with naming(name):
            columns = f"time=time,glucose_mg_dl=bg,basal_U_h={name}"
            text = f"time,bg,{name}\n2024-03-13 00:00,100,0.075\n2024-03-13 00:05,101,0.075\n"
            sentence = f"the column {name!r} is taken as U/h, and its name has {unit!r} without a time; say its unit"
            assert refused(text, columns=columns).startswith(sentence)
            assert read(text, columns=columns, file_units="basal=U/5min").frame["basal_U_h"][0] == pytest.approx(0.9)
    for name in ("basal (U/h)", "basal_U_h", "basal rate", "Basalrate (E/h)"):
        with naming(name):
            text = f"time,bg,{name}\n2024-03-13 00:00,100,0.9\n2024-03-13 00:05,101,0.9\n"
            assert read(text, columns=f"time=time,glucose_mg_dl=bg,basal_U_h={name}").frame["basal_U_h"][0] == 0.9


def types_of(record):
    return record.frame.filter(pl.col("bolus_U") > 0)["bolus_type"].to_list()


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ({"eventType": "Correction Bolus", "type": "SMB", "isSMB": True}, "automatic"),
        ({"eventType": "Correction Bolus", "automatic": True}, "automatic"),
        ({"eventType": "SMB"}, "automatic"),
        ({"eventType": "Correction Bolus", "type": "NORMAL", "isSMB": False}, "manual"),
        ({"eventType": "Meal Bolus"}, "manual"),
        ({"eventType": "Combo Bolus", "duration": 60, "enteredinsulin": 3, "splitNow": 0, "splitExt": 100}, "manual"),
        ({"eventType": "Correction Bolus"}, None),
    ],
)
def test_type_of_a_bolus_of_nightscout(read, told, expected):
    assert set(types_of(read(nightscout_treatments((START, {"insulin": 3.0, **told}))))) == {expected}


def test_type_of_a_bolus_of_pumps(read):
    pump = [
        (START + timedelta(hours=at), {"Bolus Volume Delivered": units, "Bolus Source": source})
        for at, units, source in (
            (1, "3", "BOLUS_WIZARD"),
            (2, "0.6", "CLOSED_LOOP_AUTO_BOLUS"),
            (3, "1", "CLOSED_LOOP_BG_CORRECTION"),
            (4, "2", ""),
        )
    ]
    assert types_of(read(carelink(pump, []))) == ["manual", "automatic", "manual", None]
    lines = tandem().replace('"Bolus","Standard","120"', '"Bolus","Automatic Bolus/Correction","120"', 1)
    assert types_of(read(lines)) == ["automatic", "manual", "manual", "manual", "manual"]


def test_a_sum_of_automatic_insulin_is_the_basal_rate_of_its_day(read):
    first, day = START.replace(minute=0), timedelta(days=1)
    pump = [
        (first + day, {"Bolus Volume Delivered": "27,6", "Bolus Source": "CLOSED_LOOP_AUTO_INSULIN"}),
        (first + 2 * day, {"Bolus Volume Delivered": "12", "Bolus Source": "CLOSED_LOOP_AUTO_INSULIN"}),
        (
            first + 1.5 * day,
            {"Bolus Volume Delivered": "4,5", "Bolus Source": "CLOSED_LOOP_BG_CORRECTION_AND_FOOD_BOLUS"},
        ),
        (first, {"Basal Rate": "0,8"}),
        (first + 1.6 * day, {"Basal Rate": "2,0"}),
        (first + 1.7 * day, {"Suspend": "USER_SUSPEND"}),
    ]
    sensor = [(first + 2.5 * day, {"Sensor Glucose": "120"})]
    record = read(carelink(pump, sensor))
    assert values(record, "bolus_U") == [(first + 1.5 * day, 4.5)]
    rates = dict(values(record, "basal_U_h"))
    assert rates == {
        first: 0.8,
        first + day: pytest.approx(1.15),
        first + 1.6 * day: pytest.approx(1.15),
        first + 2 * day: pytest.approx(1.0),  # the last day ends with the file, at noon
        first + 2.5 * day: 2.0,
    }
    told = " ".join(record.notes)
    assert "2 days have a sum of the insulin that automation gave" in told
    assert "1 of these days has basal rates of the pump too" in told


def test_after_a_day_of_automation_the_rate_is_not_known_without_one_of_the_pump(read):
    first = START.replace(minute=0)
    pump = [
        (first, {"Basal Rate": "0,8"}),
        (first + timedelta(days=1), {"Bolus Volume Delivered": "24", "Bolus Source": "CLOSED_LOOP_AUTO_INSULIN"}),
    ]
    record = read(carelink(pump, [(first + timedelta(days=3), {"Sensor Glucose": "120"})]))
    assert str([rate for _, rate in values(record, "basal_U_h")]) == "[0.8, 1.0, nan]"


def test_micro_boluses_take_the_place_of_the_basal_rate(read):
    pump = [(minutes(0), {"Basal Rate": "1,2"}), (minutes(120), {"Basal Rate": "0,9"})]
    pump += [
        (minutes(60 + 5 * n), {"Bolus Volume Delivered": "0,1", "Bolus Source": "CLOSED_LOOP_MICRO_BOLUS"})
        for n in range(12)
    ]
    record = read(carelink(pump, []))
    changes = values(record, "basal_U_h")
    assert [changes[0], changes[1], changes[-1]] == [(minutes(0), 1.2), (minutes(60), 0.0), (minutes(120), 0.9)]
    assert {rate for _, rate in changes[1:-1]} == {0.0}
    assert types_of(record) == ["automatic"] * 12


@pytest.mark.parametrize(
    ("kinds", "expected"), [(("normal", "automated"), ["manual", "automatic"]), (("normal",), [None])]
)
def test_type_of_a_bolus_of_tidepool(read, kinds, expected):
    items = [
        {"type": "bolus", "subType": kind, "time": f"2024-03-13T0{at}:00:00.000Z", "normal": 1.5 + at}
        for at, kind in enumerate(kinds)
    ]
    assert types_of(read(json.dumps(items))) == expected


def test_type_of_a_bolus_of_any_table(read):
    text = "time,bolus_U,bolus_type\n2024-03-13 08:00,1,automatic\n2024-03-13 09:00,2,Manual\n2024-03-13 10:00,3,x\n"
    assert types_of(read(text)) == ["automatic", "manual", None]


def test_a_bolus_that_two_apps_have_leaves_nothing_of_the_second(read):
    twice = [(START, {"eventType": "SMB", "insulin": 1.0, "carbs": 5, "enteredBy": app}) for app in ("a", "b")]
    frame = read(nightscout_treatments(*twice)).frame
    assert frame["bolus_type"].drop_nulls().to_list() == ["automatic"]
