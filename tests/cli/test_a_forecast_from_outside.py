"""A method of forecasting of another package: one class, and the command takes it."""

import json

import pytest

from forecast_records import device_record, drawn_record
from glucoloop.forecasts.method import METHODS


@pytest.mark.parametrize("name", ["returning", "your_own_forecast:Returning"])
def test_it_is_found_and_forecasts(install, glucoloop, tmp_path, name):
    install("your_own_forecast", "forecast_methods", "returning", "Returning")
    assert "returning" in METHODS.names()
    device_record(drawn_record(8, 1)).write_parquet(tmp_path / "a.parquet")
    slow = f"{name}, time_constant_min=1e4"
    answer = glucoloop(
        "forecast", "a.parquet", "--method", slow, "--method", "persistence", "--horizon", "30", "--json"
    )
    assert answer.code == 0, answer.err
    rows = json.loads(answer.out)["people"]
    errors = {row["method"].partition(",")[0]: row["rmse_mg_dl"] for row in rows if row["horizon"] == "30 min"}
    # what returns in a week is a reading that stays
    assert errors[name] == pytest.approx(errors["persistence"], rel=0.01)


def test_what_is_no_method_is_refused(install, refused):
    install("your_own_sampler", "forecast_methods", "sobol", "Sobol")
    assert "sobol is no forecast method" in refused("forecast", "a.csv", "--method", "sobol")
