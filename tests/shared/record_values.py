"""What tests look at in a record."""

import json
from datetime import timedelta

import polars as pl

from device_files import START, every, glucose, nightscout_entries


def entries(device, offset, shift_min=0, count=40, start=START):
    """Nightscout's entries of one uploader, whose readings come so many minutes later."""
    items = json.loads(nightscout_entries(count, start + timedelta(minutes=shift_min), 0))
    return [{**item, "device": device, "utcOffset": offset} for item in items]


def reading_times(record):
    """Times of the readings of a record."""
    return record.frame.filter(pl.col("glucose_mg_dl").is_not_null())["time"].to_list()


def notes_of(record):
    """Notes of a record in one text."""
    return " ".join(record.notes)


def rates_of(record):
    return record.frame.filter(pl.col("basal_U_h").is_not_null()).select("time", "basal_U_h").rows()


def profile(zone, rates=(0.8,)):
    steps = [{"time": f"{6 * n:02}:00", "value": str(rate)} for n, rate in enumerate(rates)]
    store = {"Default": {"timezone": zone, "basal": steps}}
    return json.dumps([{"startDate": "2020-01-01T00:00:00Z", "defaultProfile": "Default", "store": store}])


def readings(record):
    told = record.frame.filter(pl.col("glucose_mg_dl").is_not_null() & pl.col("out_of_range").is_null())
    return dict(told.select("time", "glucose_mg_dl").iter_rows())


def expected(minutes, count=40, start=START):
    return {time: float(glucose(number)) for number, time in enumerate(every(minutes, count, start))}


def values(record, column):
    return record.frame.filter(pl.col(column).is_not_null()).select("time", column).rows()


def minutes(number):
    return START + timedelta(minutes=number)
