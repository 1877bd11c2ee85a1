"""Each reader on a file in the shape of its vendor, against the values that were written into it."""

from datetime import datetime, timedelta
from pathlib import Path

import polars as pl
import pytest

from device_files import (
    CARELINK_HEADER,
    LIBRE_HEADER,
    NAME,
    RAW_HEADER,
    SERIAL,
    START,
    SURNAME,
    apple_health,
    carelink,
    carelink_raw,
    clarity,
    every,
    glucose,
    juggluco,
    libre,
    nightscout_entries,
    nightscout_treatments,
    ohio,
    tandem,
    tidepool,
    xdrip,
)
from record_values import expected, minutes, readings, values

EVENTS = (
    ("EGV", "", "Low", "", ""),
    ("EGV", "", "High", "", ""),
    ("Carbs", "", "", "", "45"),
    ("Insulin", "Fast-Acting", "", "4.5", ""),
    ("Insulin", "Long-Acting", "", "14", ""),
    ("Calibration", "", "101", "", ""),
    ("Alert", "Urgent Low", "", "", ""),
)


def test_clarity(read):
    record = read(clarity(events=EVENTS[2:]))
    assert readings(record) == expected(5)
    assert values(record, "carbs_g") == [(START, 45.0)]
    assert values(record, "bolus_U") == [(minutes(5), 4.5)]
    assert values(record, "long_acting_U") == [(minutes(10), 14.0)]
    assert set(record.frame["device"]) == {"Dexcom G6"}
    assert record.left_out == {
        "rows about the patient and the devices": 4,
        "calibrations and finger pricks": 1,
        "alerts": 1,
    }
    assert record.rows == 40 + 4 + 5


def test_words_in_the_place_of_a_reading_stand_at_the_limit_of_the_sensor(read):
    told = read(clarity(count=0, events=EVENTS[:2])).frame
    assert told["glucose_mg_dl"].to_list() == [40.0, 400.0]
    assert told["out_of_range"].to_list() == ["low", "high"]


def test_clarity_in_german_with_commas(read):
    text = (
        "Index;Zeitstempel (JJJJ-MM-TTThh:mm:ss);Ereignistyp;Ereignissubtyp;Patienteninfo;Geräteinfo;"
        "Quellgeräte-ID;Glukosewert (mmol/l);Insulinwert (u);Kohlenhydratwert (Gramm)\r\n"
        f"1;;Vorname;;{NAME};;;;;\r\n"
        "2;2024-03-13T00:00:00;EGV;;;;iPhone G7;5,8;;\r\n"
        "3;2024-03-13T00:05:00;EGV;;;;iPhone G7;Niedrig;;\r\n"
        "4;2024-03-13T00:06:00;Insulin;Schnellwirkend;;;iPhone G7;;2,5;\r\n"
    )
    record = read(text.encode("cp1252"))
    assert record.frame["glucose_mg_dl"].to_list()[:2] == [pytest.approx(5.8 * 18.0156), 40.0]
    assert record.frame["bolus_U"][2] == 2.5
    assert record.frame["device"][0] == "Dexcom G7"
    told = " ".join(record.notes)
    for words in ("Windows-1252", "decimal commas", "from mmol/l to mg/dl", "1 reading is low"):
        assert words in told


LIBRE_EVENTS = (
    (1, "Scan Glucose mg/dL", 111),
    (2, "Strip Glucose mg/dL", 120),
    (4, "Rapid-Acting Insulin (units)", 5.5),
    (4, "Long-Acting Insulin Value (units)", 20),
    (5, "Carbohydrates (grams)", 30),
    (6, "Notes", "walk"),
)


def test_libreview(read):
    record = read(libre(events=LIBRE_EVENTS))
    assert readings(record) == expected(15)
    assert values(record, "bolus_U") == [(minutes(7 + 30), 5.5)]
    assert values(record, "long_acting_U") == [(minutes(7 + 45), 20.0)]
    assert values(record, "carbs_g") == [(minutes(7 + 60), 30.0)]
    assert set(record.frame["device"]) == {"FreeStyle LibreLink"}
    assert record.left_out == {
        "scans, beside the readings that the sensor stores": 1,
        "strips": 1,
        "notes and other entries": 1,
    }
    assert readings(read(libre(events=LIBRE_EVENTS), scans=True))[minutes(7)] == 111.0
    assert readings(read(libre(count=0, events=LIBRE_EVENTS[:1]))) == {minutes(7): 111.0}


def test_libreview_in_mmol_with_the_limits_of_its_sensor(read):
    header = LIBRE_HEADER.replace("Glucose mg/dL", "Glucose mmol/L")
    record = read(libre(3, header=header, value=lambda number: ("5.5", "LO", "HI")[number]))
    assert record.frame["glucose_mg_dl"].to_list() == [pytest.approx(99.0858), 40.0, 500.0]


def test_libreview_in_german(read):
    text = (
        f"Glukose-Werte,Erstellt am,25-02-2024 09:55 UTC,Erstellt von,{NAME}\n\n"
        "Gerät,Seriennummer,Gerätezeitstempel,Aufzeichnungstyp,Glukosewert-Verlauf mg/dL,Glukose-Scan mg/dL,"
        "Nicht numerisches schnellwirkendes Insulin,Schnellwirkendes Insulin (Einheiten),Kohlenhydrate (Gramm)\n"
        f"FreeStyle Libre 3,{SERIAL},13-02-2024 00:03,0,104,,,,\n"
        f'FreeStyle Libre 3,{SERIAL},13-02-2024 00:05,4,,,,"2,5",\n'
        f"FreeStyle Libre 3,{SERIAL},13-02-2024 00:06,5,,,,,40\n"
    )
    frame = read(text).frame
    assert frame["glucose_mg_dl"].to_list() == [104.0, None, None]
    assert frame["bolus_U"].to_list() == [None, 2.5, None]
    assert frame["carbs_g"].to_list() == [None, None, 40.0]
    assert frame["device"][0] == "FreeStyle Libre 3"


PUMP = (
    (minutes(0), {"Basal Rate": "1,0"}),
    (minutes(30), {"Temp Basal Amount": "50", "Temp Basal Type": "Percent", "Temp Basal Duration": "0:30:00"}),
    (minutes(120), {"Suspend": "USER_SUSPEND"}),
    (minutes(150), {"Suspend": "NORMAL_PUMPING"}),
    (minutes(180), {"Bolus Type": "Normal", "Bolus Volume Selected": "3,0"}),
    (minutes(182), {"Bolus Type": "Normal", "Bolus Volume Selected": "3,0", "Bolus Volume Delivered": "2,9"}),
    (minutes(183), {"BWZ Carb Input": "35"}),
    (minutes(184), {"BG Reading": "140"}),
    (minutes(185), {"Alarm": "LOW SG"}),
    (minutes(186), {"Event Marker": "Meal: 60,00grams"}),
    (minutes(187), {"Event Marker": "Insulin: 27,00"}),
    (minutes(188), {"Basal Rate": "1,2"}),
)


def test_carelink(read):
    sensor = [(time, {"Sensor Glucose": str(glucose(number))}) for number, time in enumerate(every(5, 40))]
    record = read(carelink(PUMP, sensor))
    assert readings(record) == expected(5)
    assert values(record, "basal_U_h") == [
        (minutes(0), 1.0),
        (minutes(30), 0.5),
        (minutes(60), 1.0),
        (minutes(120), 0.0),
        (minutes(150), 1.0),
        (minutes(188), 1.2),
    ]
    assert values(record, "bolus_U") == [(minutes(182), 2.9)]
    assert values(record, "carbs_g") == [(minutes(183), 35.0), (minutes(186), 60.0)]
    assert set(record.frame["device"]) == {"MiniMed 780G"}
    assert record.left_out == {
        "finger pricks": 1,
        "boluses as they were selected, before their delivery": 1,
        "alarms": 1,
        "event markers of insulin of an unknown kind": 1,
    }
    assert record.rows == 40 + len(PUMP)


def test_carelink_in_mmol(read):
    sensor = [(START, {"Sensor Glucose": "5,5"})]
    record = read(carelink(sensor=sensor, header=CARELINK_HEADER.replace("mg/dL", "mmol/L")))
    assert record.frame["glucose_mg_dl"].to_list() == [pytest.approx(99.0858)]


def test_tidepool(read):
    more = (
        (minutes(1), {"type": "bolus", "normal": 2.5, "extended": 1.5, "duration": 3600000}),
        (minutes(2), {"type": "wizard", "carbInput": 40}),
        (minutes(3), {"type": "food", "nutrition": {"carbohydrate": {"net": 12, "units": "grams"}}}),
        (minutes(0), {"type": "basal", "deliveryType": "scheduled", "rate": 0.8, "duration": 1800000}),
        (minutes(30), {"type": "basal", "deliveryType": "suspend", "duration": 1800000}),
        (minutes(4), {"type": "smbg", "units": "mmol/L", "value": 6.1}),
        (minutes(5), {"type": "upload", "deviceSerialNumber": SERIAL}),
        (minutes(5), {"type": "bolus", "normal": 9.0, "deletedTime": "2024-04-01T00:00:00Z"}),
        (
            minutes(6),
            {
                "type": "cbg",
                "units": "mg/dL",
                "value": 39,
                "annotations": [{"code": "bg/out-of-range", "value": "low"}],
            },
        ),
    )
    record = read(tidepool(more=more))
    told = readings(record)
    assert list(told) == every(5, 40)
    assert list(told.values()) == pytest.approx(list(expected(5).values()), rel=1e-5)
    assert values(record, "bolus_U") == [(minutes(1), 2.5), (minutes(1), 1.5)]
    assert record.frame["bolus_min"].drop_nulls().to_list() == [60.0]
    assert values(record, "carbs_g") == [(minutes(2), 40.0), (minutes(3), 12.0)]
    assert str(values(record, "basal_U_h")) == str([(minutes(0), 0.8), (minutes(30), 0.0), (minutes(60), float("nan"))])
    assert record.frame.filter(pl.col("out_of_range") == "low")["glucose_mg_dl"].to_list() == [39.0]
    assert set(record.frame["utc_offset_min"]) == {-420}
    assert record.left_out == {"finger pricks": 1, "entries about uploads": 1, "entries that were deleted": 1}


def test_any_table_whose_columns_are_named(read, refused):
    text = "Name\tZeit\tBZ\tKE\n" + "\n".join(
        f"{NAME}\t{time:%d.%m.%Y %H:%M}\t{glucose(n)}\t" for n, time in enumerate(every(5, 40))
    )
    assert readings(read(text, columns="time=Zeit,glucose_mg_dl=BZ")) == expected(5)
    assert refused(text, columns="time=Zeiten,glucose_mg_dl=BZ") == (
        "no line of its beginning has all of the columns Zeiten, BZ; did you mean 'Zeit'?"
    )
    assert refused(text) == (
        "no reader knows it: it is text of 41 lines, the first of 4 fields by tabs; name its columns, perhaps as "
        "columns='time=Zeit,glucose_mg_dl=BZ,carbs_g=KE' (--columns), and check the units"
    )
    own = "time,glucose_mmol_l,bolus_U\n2024-03-13T00:03,5.5,\n2024-03-13T00:08,6.0,1.5\n"
    assert read(own).frame["bolus_U"].to_list() == [None, 1.5]
    milliseconds = "ts,sg\n1710284580000,100\n1710284880000,101\n"
    record = read(milliseconds, columns={"time": "ts", "glucose_mg_dl": "sg"}, time_zone="Europe/Berlin")
    assert record.frame["time"][0] == datetime(2024, 3, 13, 0, 3)
    assert record.frame["utc_offset_min"][0] == 60


EVERYTHING = {
    "dexcom-clarity": clarity(events=EVENTS),
    "libreview": libre(events=LIBRE_EVENTS),
    "carelink": carelink(PUMP, [(START, {"Sensor Glucose": "100"})]),
    "nightscout": nightscout_entries(),
    "treatments": nightscout_treatments((START, {"eventType": "Bolus", "insulin": 1.0, "notes": f"for {NAME}"})),
    "tidepool": tidepool(),
    "ohio-t1dm": ohio(glucose_level=[{"ts": "13-03-2024 00:03:00", "value": "100"}]),
}


@pytest.mark.parametrize("name", EVERYTHING)
def test_no_name_and_no_serial_number_gets_into_a_record(read, tmp_path, name):
    record = read(EVERYTHING[name])
    told = f"{record.frame.rows()} {record.notes} {record.left_out}"
    for secret in (NAME, SURNAME, SERIAL):
        assert secret not in told
        assert secret.encode() not in record.parquet()


@pytest.mark.parametrize("name", EVERYTHING)
def test_a_record_is_written_and_read_back_whole(read, name):
    record = read(EVERYTHING[name])
    again = read(record.parquet())
    assert again.frame.equals(record.frame)
    assert (again.notes, again.left_out, again.rows) == (record.notes, record.left_out, record.rows)


def test_a_reader_of_another_package_is_one_class(read, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "examples")
    told = read("2024-03-13 07:00|101\n2024-03-13 07:05|x\n", reader="your_own_reader:Diary")
    assert told.frame["glucose_mg_dl"].to_list() == [101.0]
    assert told.left_out == {"rows with values that are no number or not possible": 1}


def test_tandem(read):
    record = read(tandem(40))
    assert readings(record) == expected(5)
    assert [(time - START, units) for time, units in values(record, "bolus_U")] == [
        (timedelta(minutes=at), units) for at, units in ((10, 4.5), (20, 2.0), (20, 3.0), (30, 2.0), (30, 4.0))
    ]
    assert values(record, "bolus_min") == [(minutes(20), 120.0), (minutes(30), 60.0)]
    assert values(record, "carbs_g") == [(minutes(10), 45.0), (minutes(20), 30.0)]
    assert values(record, "basal_U_h") == [(START, 0.85)]
    assert record.left_out == {"entries of insulin on board": 1}


def test_xdrip(read):
    record = read(xdrip(40))
    assert readings(record) == expected(5)
    assert values(record, "carbs_g") == [(START, 40.0)]
    assert values(record, "bolus_U") == [(START, 3.5)]
    assert record.left_out == {"finger pricks": 1}


RAW_EVENTS = (
    (minutes(0), "BasalProfileStart", "PATTERN_NAME=standard, RATE=0.5, START_TIME=0, ACTION_REQUESTOR=pump", {}),
    (minutes(1), "BolusWizardBolusEstimate", "CARB_INPUT=64, CARB_UNITS=grams, CARB_RATIO=13", {23: 64}),
    (minutes(2), "BolusNormal", "AMOUNT=3.6, PROGRAMMED_AMOUNT=3.6, IS_DUAL_COMPONENT=true", {11: 3.6, 12: 3.6}),
    (minutes(3), "BolusSquare", "AMOUNT=1.7, PROGRAMMED_AMOUNT=2.3, DURATION=3600000", {11: 2.3, 12: 1.7}),
    (minutes(4), "BolusWizardBolusEstimate", "CARB_INPUT=0, CARB_UNITS=grams", {23: 0}),
    (minutes(5), "JournalEntryMealMarker", "CARB_INPUT=20, CARB_UNITS=grams", {}),
    (minutes(6), "JournalEntryMealMarker", "CARB_INPUT=2, CARB_UNITS=exchanges", {}),
    (minutes(10), "ChangeTempBasalPercent", "PERCENT_OF_RATE=60, DURATION=36000000, ACTION_REQUESTOR=pump", {7: 60}),
    (minutes(20), "ChangeTempBasalPercent", "PERCENT_OF_RATE=0, DURATION=0", {}),
    (minutes(30), "ChangeSuspendEnable", "ENABLE=user_suspend, PRE_ENABLE=normal_pumping", {16: "Suspended"}),
    (minutes(40), "ChangeSuspendState", "STATE=auto_resume_complete", {}),
    (minutes(50), "ChangeTempBasal", "DURATION=1800000, ACTION_REQUESTOR=pump", {7: 0.2}),
    (minutes(60), "Prime", "AMOUNT=0.3", {15: 0.3}),
    (minutes(61), "BGReceived", "AMOUNT=130", {5: 130}),
    (minutes(62), "SensorCalBG", "AMOUNT=130", {29: 130}),
    (minutes(63), "AlarmPump", "RAW_TYPE=4", {28: "No Delivery (4)"}),
    (minutes(64), "GlucoseSensorDataLow", "AMOUNT=null", {}),
)


@pytest.mark.parametrize("german", [False, True])
def test_carelink_before_2017(read, german):
    if german:
        header = RAW_HEADER.replace("Index,Date,Time", "Index,Datum,Zeit").replace("Raw-Type,Raw-", "Roh-Typ,Roh-")
        events = [
            (
                time,
                kind,
                values.replace("0.5", "0,5").replace("3.6", "3,6"),
                {n: str(c).replace(".", ",") for n, c in cells.items()},
            )
            for time, kind, values, cells in RAW_EVENTS
        ]
        record = read(carelink_raw(40, events, header.replace("Sensor Glucose", "Sensorglukose"), "%d.%m.%y", ";"))
    else:
        record = read(carelink_raw(40, RAW_EVENTS))
    assert readings(record) == expected(5)
    assert values(record, "bolus_U") == [(minutes(2), 3.6), (minutes(3), 1.7)]
    assert values(record, "bolus_min") == [(minutes(3), 60.0)]
    assert values(record, "carbs_g") == [(minutes(1), 64.0), (minutes(5), 20.0)]
    assert values(record, "basal_U_h") == [
        (minutes(at), pytest.approx(rate))
        for at, rate in ((0, 0.5), (10, 0.3), (20, 0.5), (30, 0.0), (40, 0.5), (50, 0.2), (80, 0.5))
    ]
    assert record.frame["out_of_range"].drop_nulls().to_list() == ["low"]
    assert set(record.frame["device"]) == {"Medtronic"}
    assert record.left_out == {
        "entries of the bolus calculator and of meals without carbohydrate": 1,
        "meals in exchanges, not in grams": 1,
        "insulin that fills a tube or a cannula, which nobody gets": 1,
        "finger pricks": 1,
        "calibrations": 1,
        "alarms": 1,
    }


def test_juggluco(read):
    at = [round((minutes(n) - datetime(1970, 1, 1)).total_seconds()) - 7200 for n in (3, 4, 5, 6)]
    amounts = zip(at, (4.5, 40, 14, 3), ("Fast Insuli", "Carbohydra", "Long Insuli", "Bike"), strict=True)
    lines = [f"0\t{n}\t{s}\t2024-03-13T00:00:00\t2\t{v}\t{label}" for n, (s, v, label) in enumerate(amounts)]
    head = "Source\tnr\tUnixTime\tYYYY-mm-dd-HH:MM:SS\tTZ\tValue\tLabel"
    history = juggluco(13, 15, head="mg/dL", tail="", value=lambda n: glucose(3 * n))
    record = read(juggluco(40), "\n".join([head, *lines]), history)
    assert readings(record) == expected(5)
    assert set(record.frame["utc_offset_min"]) == {120}
    assert [record.frame[name].sum() for name in ("bolus_U", "carbs_g", "long_acting_U")] == [4.5, 40.0, 14.0]
    assert record.left_out == {
        "amounts whose label is none of carbohydrate or insulin": 1,
        "rows that repeat another one": 13,
    }


def health(kind, unit, value, begin, end=None, **metadata):
    """Record of Apple's Health app, at minutes after midnight."""
    at, until = (START.replace(minute=0) + timedelta(minutes=t) for t in (begin, begin if end is None else end))
    entries = "".join(f'<MetadataEntry key="{key}" value="{text}"/>' for key, text in metadata.items())
    return (
        f'<Record type="HKQuantityTypeIdentifier{kind}" sourceName="Loop" unit="{unit}" '
        f'startDate="{at} +0100" endDate="{until} +0100" value="{value}">\n {entries}\n</Record>'
    )


def test_apple_health(read):
    basal, bolus = {"HKInsulinDeliveryReason": "1"}, {"HKInsulinDeliveryReason": "2"}
    more = [
        health("BloodGlucose", "mmol&lt;180.1558800000541&gt;/L", "5.5", 300),
        health("BloodGlucose", "mg/dL", "99", 301, HKWasUserEntered="1"),
        health("InsulinDelivery", "IU", "0.4", 0, 30, **basal),
        health("InsulinDelivery", "IU", "0.1", 30, 60, **basal),
        health("InsulinDelivery", "IU", "18", 1300, **basal),
        health("InsulinDelivery", "IU", "4.5", 400, 401, **bolus),
        health("InsulinDelivery", "IU", "3", 500, 620, **bolus),
        health("InsulinDelivery", "IU", "2", 700),
        health("DietaryCarbohydrates", "g", "45", 400),
        health("StepCount", "count", "45", 400),
    ]
    record = read(apple_health(40, "\n".join(more)))
    begin = START.replace(minute=0)
    names = ("bolus_U", "basal_U_h")
    told = {name: [(time - begin).seconds // 60 for time, _ in values(record, name)] for name in names}
    assert told == {"bolus_U": [400, 500], "basal_U_h": [0, 30, 60]}
    assert str([rate for _, rate in values(record, "basal_U_h")]) == "[0.8, 0.2, nan]"
    assert values(record, "long_acting_U") == [(begin + timedelta(minutes=1300), 18.0)]
    assert values(record, "carbs_g") == [(begin + timedelta(minutes=400), 45.0)]
    assert record.frame["bolus_min"].drop_nulls().to_list() == [120.0]
    assert expected(5).items() <= readings(record).items()
    assert record.frame["glucose_mg_dl"].drop_nulls()[-1] == pytest.approx(99.0858)
    assert set(record.frame["utc_offset_min"]) == {60}
    assert record.left_out == {
        "finger pricks, which a person entered": 1,
        "doses of insulin of an unknown kind": 1,
    }


def test_an_export_of_health_that_breaks_off_is_refused(refused):
    assert refused(apple_health()[:-20]).startswith("its XML breaks off or is damaged")
