"""Numbers of a record beside those of a replay."""

import datetime as dt

import numpy as np
import pytest

from glucoloop.studies.replay.study import _record
from glucoloop.twins.days import RecordedDays


@pytest.mark.parametrize("every_min", [5.0, 15.0])
def test_the_daily_dose_of_a_record_does_not_depend_on_how_often_it_was_read(every_min):
    reading_min = np.arange(0.0, 1440.0, every_min)
    reading_min = reading_min[(reading_min < 600.0) | (reading_min > 780.0)]  # a gap of three hours
    given = np.full(288, 10.0)
    given[200] += 1000.0  # 5 U at once
    days = RecordedDays(
        first=dt.datetime(2026, 3, 2),
        days=1,
        first_mg_dl=120.0,
        insulin_mU_min=given,
        meal_min=np.array([720.0]),
        carbs_g=np.array([50.0]),
        reading_min=reading_min,
        reading_mg_dl=np.full(reading_min.size, 120.0),
        bolus_U=5.0,
        basal_U=14.4,
        length_min=1440.0,
    )
    [dose_U] = _record(days).numbers()["daily_dose_U"]
    assert dose_U == pytest.approx((18.0 * 60.0 * 10.0 + 5000.0) / 1000.0 * 24.0 / 18.0)  # of the time from 06:00 on
