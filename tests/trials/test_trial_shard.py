"""The files of a shard say what the engine said, and come back as they went."""

import io

import numpy as np
import polars as pl
import pytest

from glucoloop.trials.computing import run_here
from glucoloop.trials.folder import trial_folder
from glucoloop.trials.shard import add_counts, compute_shard, edges, no_counts, read_people, times


def tables(trial, index, simulate):
    files = compute_shard(trial, index, simulate)
    return {name: pl.read_parquet(io.BytesIO(data)) for name, data in files.items()}


def test_people_are_rows_with_their_parameters_and_metrics(make_trial, pretend):
    trial = make_trial(first_person=1000)
    table = tables(trial, 1, pretend(trial))["people.parquet"]
    person = 1000 + np.arange(64, 128)
    assert table["controller"].to_list() == ["mpc"] * 64 + ["pid"] * 64
    for label in ("mpc", "pid"):
        rows, said = table.filter(pl.col("controller") == label), pretend(trial)(label, person, False)
        assert np.array_equal(rows["person"], person)
        assert np.array_equal(rows["able"], said.feasible)
        np.testing.assert_array_equal(rows["basal_insulin_mU_min"], said.basal_insulin_mU_min)
        np.testing.assert_array_equal(rows["M_IHGP_strength"], said.drawn["M_IHGP.strength"])
        for name, values in said.metrics.items():
            assert rows[name].to_list() == [
                value if feasible else None for value, feasible in zip(values.tolist(), said.feasible, strict=True)
            ]


def test_who_is_not_able_is_a_row_of_nulls_and_in_no_count(make_trial, pretend):
    trial = make_trial(people=2000, shard_people=2000)
    made = tables(trial, 0, pretend(trial))
    infeasible = made["people.parquet"].filter(~pl.col("able"))
    assert infeasible.height > 4
    assert infeasible["F_LC"].null_count() == 0
    for name in ("basal_insulin_mU_min", "minimum_mg_dl", "settled_2pct", "samples_missing"):
        assert infeasible[name].null_count() == infeasible.height
    counts = made["bands.parquet"].group_by("controller", "quantity", "t_min").agg(pl.col("count").sum())
    assert set(counts["count"]) == {2000 - infeasible.height // 2}


@pytest.mark.parametrize("traces", ["none", 5, 70, "all"])
def test_traces_are_kept_of_the_first_people(make_trial, pretend, traces):
    trial = make_trial(traces=traces)
    kept = {"none": 0, "all": 300}.get(traces, traces)
    found = [tables(trial, index, pretend(trial)).get("traces.parquet") for index in range(trial.shards)]
    assert [table is not None for table in found] == [64 * index < kept for index in range(5)]
    people = [person for table in found if table is not None for person in table["person"].unique().sort()]
    assert people == list(range(kept))
    if kept:
        rows = found[0].filter((pl.col("person") == 3) & (pl.col("controller") == "pid"))
        said = pretend(trial)("pid", np.arange(3, 4), True)
        assert rows["t_min"].to_list() == [5.0 * sample for sample in range(61)]
        assert rows["glucose_mg_dl"].to_list() == said.glucose_mg_dl[:, 0].tolist()
        assert rows["insulin_mU_min"].to_list() == [*said.insulin_mU_min[:, 0].tolist(), None]


def test_shard_is_read_back(make_trial, pretend, tmp_path):
    trial = make_trial()
    with trial_folder(tmp_path / "out", trial) as folder:
        run_here(folder, pretend(trial))
        total = no_counts(trial)
        for index in range(trial.shards):
            add_counts(folder.shard(index), trial, index, total)
        people = read_people(folder.shard(2), trial, 2)["pid"]
        shards = list(folder.people())
    said = pretend(trial)("pid", trial.shard(2), False)
    np.testing.assert_array_equal(people.person, said.person)
    assert people.drawn.keys() == said.drawn.keys()
    np.testing.assert_array_equal(people.drawn["F_LC"], said.drawn["F_LC"])
    assert people.metrics.keys() == said.metrics.keys()
    np.testing.assert_array_equal(people.metrics["minimum_mg_dl"], said.metrics["minimum_mg_dl"])
    np.testing.assert_array_equal(
        people.metrics["settled_2pct"], np.where(said.feasible, said.metrics["settled_2pct"], np.nan)
    )
    assert "settled_2pct" in people.yes_or_no
    assert "minimum_mg_dl" not in people.yes_or_no
    assert [shard["mpc"].person.size for shard in shards] == [64, 64, 64, 64, 44]
    everybody = pretend(trial)("mpc", np.arange(300), False)
    np.testing.assert_array_equal(total["mpc"]["glucose"], everybody.glucose_counts)
    np.testing.assert_array_equal(total["mpc"]["insulin"], everybody.insulin_counts)
    for quantity, counts in total["mpc"].items():
        assert counts.shape == (times(trial)[quantity].size, edges(trial)[quantity].size - 1)
