"""Numbers of a record beside those of a replay."""

import numpy as np
import pytest

from forecast_records import gridded
from glucoloop.studies.replay.study import _record


@pytest.mark.parametrize("every", [1, 3])
def test_the_daily_dose_of_a_record_does_not_depend_on_how_often_it_was_read(every):
    readings = np.full(288, np.nan)
    readings[::every] = 120.0
    readings[200:236] = np.nan  # a gap of three hours
    bolus_U = np.zeros(288)
    bolus_U[200] = 5.0
    record = gridded(readings, basal_U=np.full(288, 0.05), bolus_U=bolus_U)
    [dose_U] = _record(record).numbers()["daily_dose_U"]
    assert dose_U == pytest.approx(2.0 * (144 * 0.05 + 5.0))  # of the half day from noon on
