"""Files of published data sets, with the traps of their real ones."""

import csv
import io
from datetime import datetime, timedelta

import polars as pl
import pytest

from device_files import (
    START,
    clarity,
    every,
    glucose,
    jaeb,
    ohio,
    tidepool_table,
)
from glucoloop.records import read_people
from record_values import expected, minutes, rates_of, readings, values

AUTOMATIC = "Automatic Bolus/Correction"


def azt1d(rows):
    names = (
        "EventDateTime,DeviceMode,BolusType,Basal,CorrectionDelivered,TotalBolusInsulinDelivered,FoodDelivered,CarbSize,"
        "CGM"
    )
    lines = [f"{at:%Y-%m-%d %H:%M:%S},,,{rate},,{bolus},,{carbs},{cgm}" for at, rate, bolus, carbs, cgm in rows]
    return "\n".join([names, *lines]) + "\n"


def test_azt1d_with_rates_in_two_units(read):
    rates = [0.9, 0.8, 900, 12, 800, 1200, 0.9, 2.0, 0.7]
    rows = [(time, rate, "", "", 100) for time, rate in zip(every(5, 9), rates, strict=True)]
    rows[3] = (*rows[3][:2], 2.5, 30, "")
    record = read(azt1d(rows))
    assert [rate for _, rate in rates_of(record)] == pytest.approx([0.9, 0.8, 0.9, 0.012, 0.8, 1.2, 0.9, 2.0, 0.7])
    assert (record.frame["bolus_U"].sum(), record.frame["carbs_g"].sum()) == (2.5, 30.0)


def test_a_second_reading_of_a_time_does_not_take_its_bolus(read):
    record = read(azt1d([(START, "", "", "", 100), (START, "", 2.5, "", 101), (every(5, 2)[1], "", "", "", 102)]))
    assert record.frame["bolus_U"].sum() == 2.5
    assert record.frame["glucose_mg_dl"].drop_nulls().to_list() == [100.0, 102.0]


def test_azt1d_tells_automatic_boluses(read):
    text = azt1d([(time, 0.9, units, "", 100) for time, units in zip(every(5, 4), (2.5, 0.7, 1, ""), strict=True)])
    rows = text.split("\n")
    rows[1:4] = [
        row.replace(",,,", f",,{kind},", 1) for row, kind in zip(rows[1:4], ("Standard", AUTOMATIC, "0"), strict=True)
    ]
    boluses = read("\n".join(rows)).frame.filter(pl.col("bolus_U").is_not_null())
    assert boluses["bolus_type"].to_list() == ["manual", "automatic", None]


def test_t1d_uom_of_four_files(read):
    record = read(
        "bg_ts,value\n13/03/2024 00:00,5.5\n13/03/2024 00:05,6.0\n",
        "\ufeffbolus_ts,bolus_dose\n13/03/2024 00:01,4\n",
        "\ufeffbasal_ts,basal_dose,insulin_kind\n13/03/2024 00:00,0.9,R\n13/03/2024 00:02,12,L\n",
        "\ufeffmeal_ts,meal_type,meal_tag,carbs_g,prot_g,fat_g,fibre_g\n13/03/2024 00:01,Lunch,x,45,1,2,3\n",
    )
    sums = record.frame.select(pl.col("carbs_g", "bolus_U", "long_acting_U", "basal_U_h").sum()).row(0)
    assert sums == (45.0, 4.0, 12.0, 0.9)


def test_hupa_ucm_in_its_units(read):
    names = "time;glucose;calories;heart_rate;steps;basal_rate;bolus_volume_delivered;carb_input"
    record = read(f"{names}\n2024-03-13T00:00:00;100;5;70;0;0.075;2;4\n2024-03-13T00:05:00;101;5;70;0;0.075;0;0\n")
    sums = record.frame.select(pl.col("carbs_g", "bolus_U").sum(), pl.col("basal_U_h").first()).row(0)
    assert sums == (40.0, 2.0, pytest.approx(0.9))


def test_a_csv_writer_s_quotes_do_no_harm(read):
    buffer = io.StringIO()
    csv.writer(buffer, quoting=csv.QUOTE_ALL).writerows([line.split(",") for line in clarity(20).splitlines()])
    assert read(buffer.getvalue()).frame.equals(read(clarity(20)).frame)


def test_ohio(read):
    def at(number):
        return f"{minutes(number):%d-%m-%Y %H:%M:%S}"

    text = ohio(
        glucose_level=[{"ts": at(5 * n), "value": str(glucose(n))} for n in range(40)],
        finger_stick=[{"ts": at(3), "value": "120"}],
        basal=[{"ts": at(0), "value": "0.9"}],
        temp_basal=[{"ts_begin": at(60), "ts_end": at(90), "value": "0.0"}],
        bolus=[{"ts_begin": at(10), "ts_end": at(10), "type": "normal", "dose": "3.5", "bwz_carb_input": "30"}],
        meal=[{"ts": at(10), "type": "Lunch", "carbs": "30"}],
        sleep=[{"ts_begin": at(300), "ts_end": at(600), "quality": "3"}],
        basis_steps=[{"ts": at(1), "value": "12"}],
    )
    record = read(text)
    assert readings(record) == expected(5)
    assert values(record, "basal_U_h") == [(minutes(0), 0.9), (minutes(60), 0.0), (minutes(90), 0.9)]
    assert values(record, "bolus_U") == [(minutes(10), 3.5)]
    assert values(record, "carbs_g") == [(minutes(10), 30.0)]
    assert record.left_out == {"finger pricks": 1, "times of sleep": 1, "events of other kinds": 1}


def test_simglucose(read):
    lines = [
        f"{time:%Y-%m-%d %H:%M:%S},{glucose(n)}.5,{glucose(n)},{5.0 if n == 3 else 0.0},0.02,0,0,0"
        for n, time in enumerate(every(3, 40))
    ]
    record = read("\n".join(["Time,BG,CGM,CHO,insulin,LBGI,HBGI,Risk", *lines]))
    assert readings(record) == expected(3)
    assert values(record, "carbs_g") == [(minutes(9), 15.0)]
    assert {rate for _, rate in values(record, "basal_U_h")} == {1.2}


def test_replaybg(read):
    lines = [
        f"{time:%d-%b-%Y %H:%M:%S},{glucose(n) if n else ''},{2 * (n == 4)},{0.5 * (n == 2)},0.02,,"
        for n, time in enumerate(every(5, 40))
    ]
    record = read("\n".join(["t,glucose,cho,bolus,basal,bolus_label,cho_label", *lines]))
    assert readings(record) == {time: value for time, value in expected(5).items() if time != START}
    assert values(record, "carbs_g") == [(minutes(20), 10.0)]
    assert values(record, "bolus_U") == [(minutes(10), 2.5)]
    assert {rate for _, rate in values(record, "basal_U_h")} == {1.2}
    assert record.rows_used == 40


def test_jaeb_of_two_people(tmp_path):
    (tmp_path / "HDeviceCGM.txt").write_text(jaeb(40, people=("7", "9")))
    (tmp_path / "HDeviceBolus.txt").write_text(
        "RecID|PtID|DeviceDtTmDaysFromEnroll|DeviceTm|BolusType|Normal|Extended|Duration\n"
        "1|7|2|00:13:00|Dual|2.5|1.5|3600000\n2|7|2|00:23:00|Normal|1||\n3|9|2|00:33:00|Square||4|90\n"
    )
    (tmp_path / "HDeviceBasal.txt").write_text(
        "RecID|PtID|DeviceDtTmDaysFromEnroll|DeviceTm|BasalType|Duration|Rate\n"
        "1|7|2|00:00:00|scheduled|3600000|0.8\n2|7|2|01:00:00|suspend|3600000|\n3|9|2|00:00:00|scheduled|1|1.1\n"
    )
    records = read_people(tmp_path)
    day = datetime(2000, 1, 3)
    assert list(records) == ["7", "9"]
    for record in records.values():
        assert [time - day for time in readings(record)] == [time - datetime(2024, 3, 13) for time in every(5, 40)]
    assert values(records["7"], "bolus_U") == [
        (day + timedelta(minutes=at), units) for at, units in ((13, 2.5), (13, 1.5), (23, 1.0))
    ]
    assert values(records["7"], "bolus_min") == [(day + timedelta(minutes=13), 60.0)]
    assert values(records["9"], "bolus_min") == [(day + timedelta(minutes=33), 90.0)]
    assert values(records["7"], "basal_U_h") == [(day, 0.8), (day + timedelta(hours=1), 0.0)]
    assert records["7"].left_out == {"finger pricks and calibrations": 1}


def test_pedap_tells_the_later_part_at_its_end_and_leaves_out_midnight(read):
    boluses = (
        "PtID|DeviceDtTm|BolusAmount|CarbAmount|BolusType|Duration|ExtendedBolusPortion\n"
        "5|3/13/2024|1.5|20|Standard||\n5|3/13/2024 10:00:00 AM|2|30|Extended|60|Now\n"
        "5|3/13/2024 11:00:00 AM|3||Extended|60|Later\n"
    )
    sensor = (
        "PtID|DeviceDtTm|CGMValue|HighLowIndicator\n5|3/13/2024 12:05:00 AM|120|0\n5|3/13/2024 12:10:00 AM|0|2\n"
        "5|3/13/2024 12:15:00 AM|0|1\n"
    )
    record = read(boluses, sensor)
    ten = datetime(2024, 3, 13, 10)
    assert values(record, "bolus_U") == [(datetime(2024, 3, 13), 1.5), (ten, 2.0), (ten, 3.0)]
    assert values(record, "bolus_min") == [(ten, 60.0)]
    assert values(record, "carbs_g") == [(datetime(2024, 3, 13), 20.0), (ten, 30.0)]
    assert record.frame["glucose_mg_dl"].drop_nulls().to_list() == [120.0, 40.0, 400.0]


def test_the_loop_study_is_in_utc_and_in_mmol(read):
    rows = ("1|2018-05-29 10:02:56|CGM|5.5|mmol/L", "1|2018-05-29 10:07:56|CGM|6|mmol/L")
    record = read("\n".join(["PtID|UTCDtTm|RecordType|CGMVal|Units", *rows]))
    assert record.frame["glucose_mg_dl"].to_list() == pytest.approx([99.09, 108.1], abs=0.1)
    assert record.frame["utc_offset_min"].to_list() == [0, 0]


def test_tidepool_as_a_table(read):
    assert readings(read(tidepool_table(30))) == expected(5, 30)
