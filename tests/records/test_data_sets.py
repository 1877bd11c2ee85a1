"""Files of published data sets, with the traps of their real ones."""

import csv
import io

import polars as pl
import pytest

from device_files import START, clarity, every
from record_values import rates_of

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
