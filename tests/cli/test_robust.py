"""``glucoloop robust``, with a closed form in place of the loops."""

import json
from typing import ClassVar

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure

from glucoloop.control.catalogue import CONTROLLERS, SEARCHED
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.toml import read_toml
from glucoloop.studies.robust import RANGES, Search
from glucoloop.studies.robust.search import NO_SCORES
from glucoloop.studies.robust.tuning_loop import METRICS

SMALL = ("--people", 4, "--seeds", 3, "--check-people", 5, "--check-seeds", 4, "--batch", 4, "--rounds", 3)
FILES = {
    "origin.json",
    "SHA256SUMS",
    "tables.tex",
    "best.toml",
    "candidates.csv",
    "candidates.parquet",
    "check.parquet",
    "front.png",
    "front.svg",
    "front.pdf",
    "robust.json",
    "robust.toml",
}


class ClosedForm:
    """More weight on moves: less undershoot and travel, a higher peak; it is refused below 0.03."""

    interrupt_after = None
    engine_facts: ClassVar = {"engine": "xla", "not_native": "the operation 'sort' in the controller"}

    def __init__(self, trial, case, space, example):
        self.case = case

    def run(self, subjects, tunings=({},)):
        spread = np.linspace(0.0, 1.0, subjects.number)
        for number, tuning in enumerate(tunings):
            if number == self.interrupt_after:
                raise KeyboardInterrupt
            weight = np.log10({**self.case.tuning, **tuning}["move_weight"] + 1e-3)
            if tuning and weight < np.log10(0.031):
                yield None
                continue
            undershoot = 5.0 - 4.0 * weight + spread
            metrics = (undershoot, 81.1 - undershoot, 90.0 + 5.0 * weight + spread, 300.0 - 200.0 * weight + spread)
            yield dict(zip(METRICS, metrics, strict=True))


@pytest.fixture(autouse=True)
def _closed_form(monkeypatch):
    monkeypatch.setattr("glucoloop.studies.robust.search.TuningLoop", ClosedForm)


@pytest.mark.long
def test_folder_holds_the_search_and_repeats_itself(glucoloop, tmp_path):
    first = glucoloop("robust", *SMALL, "--at-most", "total-variation=450", "--out", "a")
    assert first.code == 0, first.err
    assert {entry.name for entry in (tmp_path / "a").iterdir()} == FILES
    for part in (
        "chosen",
        "as it was",
        "mpc-se",
        "Never seen before",
        "total-variation at most 450",
        "Engine: JAX (xla): the operation 'sort' in the controller.",
        "Wrote best.toml",
    ):
        assert part in first.out
    table = pl.read_csv(tmp_path / "a/candidates.csv")
    assert table.height == 12
    assert table["chosen"].sum() == 1
    kept = table["total_variation_mU_min"] <= 450.0
    assert kept.any()
    assert not kept.all()
    assert table["keeps_the_bounds"].to_list() == kept.fill_null(False).to_list()
    assert table.filter(pl.col("chosen"))["on_the_front"].item()
    summary = json.loads((tmp_path / "a/robust.json").read_text())
    check = pl.read_parquet(tmp_path / "a/check.parquet")
    assert check.group_by("controller", "group").len().height == 6
    assert summary["check"].keys() == {"chosen", "as it was", "mpc-se"}
    assert summary["engines"] == dict.fromkeys(("mpc-se", "meal-mpc"), ClosedForm.engine_facts)

    run = configured(Run, read_toml((tmp_path / "a/best.toml").read_text(), "best.toml").keys)
    assert run.case.controller.name == "meal-mpc"
    assert {name: run.case.tuning[name] for name in summary["chosen"]["tuning"]} == summary["chosen"]["tuning"]
    assert run.noise_variance == 1.45

    again = glucoloop("robust", *SMALL, "--at-most", "total-variation=450", "--out", "a", "--json")
    assert "nothing is computed again" in again.err
    assert {key: value for key, value in again.json.items() if key != "files"} == summary
    assert glucoloop("robust", "--config", "a/robust.toml", "--out", "b").code == 0
    assert (tmp_path / "a/SHA256SUMS").read_text() == (tmp_path / "b/SHA256SUMS").read_text()


@pytest.fixture
def _plain(monkeypatch):
    monkeypatch.setattr("glucoloop.studies.robust.study._plot_robust", lambda *_, **__: Figure())


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_a_search_that_was_cut_short_goes_on(glucoloop, tmp_path, monkeypatch):
    assert glucoloop("robust", *SMALL, "--out", "whole").code == 0
    with monkeypatch.context() as patch:
        patch.setattr(ClosedForm, "interrupt_after", 2)
        cut = glucoloop("robust", *SMALL, "--out", "cut")
    assert cut.code == 130
    assert "2 of 12 candidates are kept, the same command goes on" in cut.err
    rest = glucoloop("robust", *SMALL, "--out", "cut")
    assert "2 of 12 candidates of cut are there already; going on." in rest.err
    assert (tmp_path / "cut/SHA256SUMS").read_text() == (tmp_path / "whole/SHA256SUMS").read_text()

    farther = (*SMALL[:-1], 4, "--prefer", "peak-median")
    assert glucoloop("robust", *farther, "--out", "cut").code == 0
    table = pl.read_csv(tmp_path / "cut/candidates.csv")
    assert table.height == 16
    chosen = table.filter(pl.col("chosen"))
    assert chosen["peak_median_mg_dl"].item() == table["peak_median_mg_dl"].min()
    before = (tmp_path / "cut/SHA256SUMS").read_text()
    less = glucoloop("robust", *SMALL[:-1], 1, "--out", "cut")
    assert "cut holds 16 candidates, and 4 are asked for, which is fewer; ask for more" in less.err
    other = glucoloop("robust", *seeded(farther, 5), "--out", "cut")
    assert "cut holds another search: seeds is 3 there and 5 here" in other.err
    assert (tmp_path / "cut/SHA256SUMS").read_text() == before
    assert glucoloop("robust", *seeded(SMALL, 5), "--sampler", "random", "--out", "cut", "--overwrite").code == 0
    (tmp_path / "cut/candidates.parquet").write_bytes(b"nothing")
    damaged = glucoloop("robust", *seeded(SMALL, 5), "--sampler", "random", "--out", "cut")
    assert "candidates.parquet is damaged: it is not a Parquet file; delete it" in damaged.err


def seeded(options, seeds):
    where = options.index("--seeds")
    return (*options[: where + 1], seeds, *options[where + 2 :])


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_bounds_that_nothing_keeps_are_told(glucoloop):
    told = glucoloop("robust", *SMALL, "--at-most", "peak-p95=mpc-se", "--at-most", "total-variation=1", "--out", "a")
    assert told.code == 0
    assert "0 keep the bounds; chosen is the one that exceeds them by the smallest amount" in told.out
    assert "what mpc-se comes to" in told.out


def test_what_is_read_is_told_as_it_was():
    controller = {"name": "meal-mpc", "move_weight": "0.1:1", "caution_weight": 3, "estimator": {"name": "kalman"}}
    asked = configured(Search, controller=controller, people=7)
    for whole in (False, True):
        assert configured(Search, asked.tree(whole=whole)).tree(whole=True) == asked.tree(whole=True)
    assert asked.tree() == {"controller": [controller], "people": 7}
    assert asked.case.tuning["caution_weight"] == 3.0
    assert "caution_weight" not in asked.initial


def test_what_can_be_searched_are_settings_of_the_controller():
    assert set(RANGES) <= set(CONTROLLERS[SEARCHED].settings())
    assert [name for name, tuned in RANGES.items() if not tuned.by_default] == [
        "output_weight",
        "glucose_floor_mg_dl",
        "floor_weight",
        "measurement_variance",
    ]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "--out is missing"),
        (("--out", "a", "--top", 0), "--top is 0"),
        (("--out", "a", "--objective", "peak-p95"), "--objective is peak-p95; give two objectives"),
        (("--out", "a", "--at-most", "peak=3"), "unknown objective 'peak'"),
        (("--out", "a", "--at-most", "peak-p95"), "--at-most is 'peak-p95'; write it like"),
        (("--out", "a", "--at-most", "peak-p95=mpc"), "neither a number nor a controller that stands beside: mpc-se"),
        (("--out", "a", "--controller", "move_weight=2:1"), "move_weight is '2:1'"),
        (("--out", "a", "--prefer", "peak-p95"), "--prefer is 'peak-p95'; give undershoot-p95, peak-median or both"),
        (("--out", "a", "--beside", "meal-mpc"), "--beside is meal-mpc"),
        (("--out", "a", "--check-people-seed", 424242), "give another seed for one of them"),
        (("--out", "a", "--people", 0), "--people is 0"),
        (
            ("--out", "a", "--sampler", "luck"),
            "--sampler: unknown sampler 'luck'; the known ones are: tpe, nsga2, random",
        ),
    ],
)
def test_mistakes(refused, tmp_path, arguments, sentence):
    assert sentence in refused("robust", *arguments)
    assert not (tmp_path / "a").exists()


@pytest.mark.long
@pytest.mark.usefixtures("_plain")
def test_every_objective_has_a_column(glucoloop, tmp_path):
    assert glucoloop("robust", *SMALL, "--sampler", "random", "--out", "a").code == 0
    columns = set(pl.read_parquet(tmp_path / "a/candidates.parquet").columns)
    assert set(NO_SCORES) <= columns
