"""A continuous glucose monitor by one ``--sensor``, in every command that simulates."""

import numpy as np
import polars as pl
import pytest

from glucoloop.build.surroundings import record_sensor
from glucoloop.sensors.delay import Lag
from glucoloop.situations.situation import Situation, configured

WARM = "dexcom-g6, worn_min=0"
SHORT = ("--patient", "hovorka-2004", "--duration", "5h", "--meal", "40g@3h")
ACCURACY = ("--metric", "sensor-accuracy")


@pytest.mark.parametrize("controller", [pytest.param("mpc", marks=pytest.mark.long), "pid"])
def test_a_controller_never_sees_a_reading_while_the_sensor_warms_up(glucoloop, tmp_path, controller):
    told = glucoloop("run", *SHORT, "--controller", controller, "--sensor", WARM, *ACCURACY, "--out", "a", "--json")
    assert told.code == 0, told.err
    trace = pl.read_parquet(tmp_path / "a/trace.parquet")
    warm = np.arange(trace.height) < 24
    readings = trace["reading_mg_dl"].to_numpy()
    np.testing.assert_array_equal(np.isnan(readings), warm)
    np.testing.assert_array_equal(readings[~warm], np.round(readings[~warm]))
    assert set(trace["status"].to_list()[:24]) == {"reading missing"}
    assert told.json["metrics"]["samples_missing"] == 24
    assert 0.0 < told.json["metrics"]["mard_pct"] < 30.0
    assert told.json["config"]["sensor"][0]["warm_up_min"] == 120.0


def test_the_accuracy_is_in_the_table_where_it_is_asked_for(glucoloop):
    asked = ("run", *SHORT, "--controller", "pid", "--sensor", WARM)
    assert "Error grid, zone A" in glucoloop(*asked, *ACCURACY).out
    assert "Error grid" not in glucoloop(*asked).out


@pytest.mark.parametrize(("name", "lag_min"), [("dexcom-g6", 10.0), ("breton-2008", 5.0)])
def test_a_model_is_identified_from_readings_without_the_errors(name, lag_min):
    sensor = record_sensor(configured(Situation, sensor=[name, "dead-time, minutes=10"]), 0.0)
    assert isinstance(sensor, Lag)
    assert sensor.lag_min == lag_min
    assert (sensor.inner.noise, sensor.inner.drift, sensor.inner.warm_up) == (False, False, 0)


@pytest.mark.long
def test_people_of_a_trial_have_sensors_of_their_own(glucoloop, tmp_path):
    asked = ("trial", *SHORT, "--people", 40, "--controller", "pid", "--sensor", "vettoretti-2019", *ACCURACY)
    told = glucoloop(*asked, "--out", "a", "--json")
    assert told.code == 0, told.err
    assert next(iter(told.json["controllers"].values()))["engine"] == "native"
    people = pl.read_parquet(tmp_path / "a/shards/*/people.parquet")
    bias = people["reading_bias_mg_dl"].drop_nans()
    assert bias.len() >= 35  # all but those whose sensor warms up
    assert bias.std() > 5.0


@pytest.mark.long
def test_a_stress_test_takes_a_monitor(glucoloop):
    told = glucoloop(
        *("stress", "--people", 2, "--controller", "pid", "--duration", 300, "--guards", "with"),
        *("--fault", "drift", "--sensor", "dexcom-g6", "--out", "a"),
    )
    assert told.code in (0, 1), told.err


@pytest.mark.long
def test_a_chip_on_the_host_takes_a_monitor(glucoloop):
    told = glucoloop("hil", "--controller", "pid", "--duration", "3h", "--sensor", WARM)
    assert told.code == 0, told.err
    assert "36 of 36 decisions are equal to the bit" in told.out
