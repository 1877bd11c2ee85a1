"""Memory of long runs, as the operating system counts it, of a process of its own."""

import json

import numpy as np
import pytest
import tomli_w

from forecast_records import device_record, drawn_record
from glucoloop.patients.population import population
from glucoloop.twins.extended import NOISES, WAVES
from glucoloop.twins.prior import prior_of
from peak_memory import command_and_peak_mib, needs_peak

STARTS_DIFFER_BY_MIB = 150.0
"""Room for what differs from start to start; a table of samples by jumps of 120 days would take 30 GB."""


def peak_mib(*arguments):
    done, peak = command_and_peak_mib(*arguments)
    assert done.returncode == 0
    return peak


@needs_peak
@pytest.mark.long
@pytest.mark.parametrize("arguments", [["run", "--controller", "pid"], ["trial", "--people", 2, "--controller", "pid"]])
def test_the_memory_of_a_run_grows_with_its_days_and_not_with_their_square(tmp_path, arguments):
    short, long = (peak_mib(*arguments, "--days", days, "--out", tmp_path / str(days)) for days in (30, 120))
    assert long < 1500.0
    assert long - short < STARTS_DIFFER_BY_MIB


@needs_peak
@pytest.mark.long
def test_the_memory_of_a_replay_does_not_hold_more_people_than_are_replayed(tmp_path):
    prior = prior_of(population("boiroux2017", patient="hovorka-2004"), None)
    coordinates = len(prior.parameters) + WAVES + len(NOISES)
    twin = {
        "patient": prior.patient,
        "population": prior.population,
        "verdict": "The median person.",
        "predicts": True,
        "known": {},
        "filter": {
            "parameters": list(prior.parameters),
            "prior_mean": prior.mean.tolist(),
            "prior_factor": prior.factor.tolist(),
            "coordinates": [0.0] * coordinates,
            "covariance": np.eye(coordinates).tolist(),
            "mean_mg_dl": 150.0,
            "steps": 2,
            "site": "interstitial",
        },
    }
    person = {"name": "twin", **dict(zip(prior.parameters, np.exp(prior.mean).tolist(), strict=True))}
    (tmp_path / "twin.json").write_text(json.dumps(twin))
    (tmp_path / "person.toml").write_text(tomli_w.dumps({"person": [person]}))
    device_record(drawn_record(90, 0)).write_parquet(tmp_path / "record.parquet")
    asked = ("--days", 90, "--twin", tmp_path, "--controller", "basal-bolus", "--draws", 0)
    # with a block of 1024 people, of whom each table of all samples takes 200 MB, it had 2190 MiB
    assert peak_mib("replay", tmp_path / "record.parquet", *asked, "--out", tmp_path / "out") < 1300.0
