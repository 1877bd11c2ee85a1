"""The folder of work whose units are rows."""

import json

import polars as pl
import pytest

from glucoloop.storage.disk import SUMS, read_sums

pytestmark = pytest.mark.usefixtures("_quick_disk")


def contents(path):
    return {file.name: file.read_bytes() for file in path.iterdir()}


@pytest.fixture
def begun(tmp_path, counting):
    with counting().opened(tmp_path / "out") as folder:
        folder.add(0)
    return tmp_path / "out"


def test_work_that_was_cut_short_goes_on_to_the_same_bits(tmp_path, counting, begun):
    counting().run(tmp_path / "whole")
    with counting().opened(begun) as folder:
        assert (folder.rows, folder.progress, folder.finished) == ([0], "1 of 3 numbers", False)
    counting().run(begun)
    assert contents(begun) == contents(tmp_path / "whole")
    assert read_sums(begun).keys() == contents(begun).keys() - {SUMS}


def test_finished_work_goes_further_and_never_back(counting, begun):
    counting().run(begun)
    with counting().opened(begun) as folder:
        assert folder.finished
    with counting(wanted=5).opened(begun) as folder:
        assert (folder.rows, folder.finished) == ([0, 1, 2], False)
    with pytest.raises(ValueError, match="holds 3 numbers, and 2 are asked for"):
        counting(wanted=2).run(begun)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"seed": 2, "controller": [{"label": "a", "gain": 1.0}]}, "seed is 1 there and 2 here"),
        ({"seed": 1, "controller": [{"label": "b"}]}, "the list of cases is a there and b here"),
        ({"seed": 1, "controller": [{"label": "a", "gain": 2.0}]}, "gain of case 'a' is 1.0 there and 2.0 here"),
        ({"seed": 1}, "the list of cases is a there and not given here"),
    ],
)
def test_another_configuration_is_refused_by_its_first_difference(counting, begun, keys, told):
    before = contents(begun)
    with pytest.raises(ValueError, match=f"holds another count: {told}"):
        counting(keys=keys).run(begun)
    assert contents(begun) == before


def test_a_configuration_that_somebody_wrote_is_refused(counting, begun):
    place = begun / "origin.json"
    found = json.loads(place.read_text())
    for config in ({"seed": "1979-05-27"}, {"case": 3}, {"controller": [{"label": "a"}, {"gain": 1.0}]}, 3):
        place.write_text(json.dumps({**found, "config": config}))
        with pytest.raises(ValueError, match=r"holds another count|origin\.json is damaged"):
            counting().run(begun)


@pytest.mark.parametrize("rows", [{"number": [1]}, {"number": [0.0]}, {"other": [0]}, {"number": [None]}])
def test_rows_of_something_else_are_refused(counting, begun, rows):
    pl.DataFrame(rows).write_parquet(begun / "numbers.parquet")
    with pytest.raises(ValueError, match=r"numbers\.parquet is damaged: .*; delete it and run the same command again"):
        counting().run(begun)


def test_what_was_changed_or_is_not_listed_is_refused(counting, begun):
    counting().run(begun)
    sums = (begun / SUMS).read_text()
    (begun / SUMS).write_text("".join(line for line in sums.splitlines(True) if "count.json" not in line))
    with pytest.raises(ValueError, match=r"does not list count\.json as it is"):
        counting().run(begun)
    (begun / SUMS).write_text(sums)
    (begun / "count.json").write_text("{} ")
    for overwrite in (False, True):
        with pytest.raises(ValueError, match=r"count\.json.* was changed since glucoloop wrote it"):
            counting(keys={"seed": 2} if overwrite else {**counting().keys}).run(begun, overwrite=overwrite)


def test_rows_of_other_arithmetic_are_not_mixed_and_finished_ones_are_told(counting, begun):
    place = begun / "origin.json"
    found = json.loads(place.read_text())
    place.write_text(json.dumps({**found, "arithmetic": {**found["arithmetic"], "jax": "0.0.1"}}))
    with pytest.raises(ValueError, match=r"was computed with jax 0\.0\.1, and here it is .* the same bits"):
        counting().run(begun)
    place.write_text("")
    with pytest.raises(ValueError, match=r"origin\.json is damaged: .*; delete"):
        counting().run(begun)
    counting().run(begun, overwrite=True)
    assert json.loads(place.read_text()) == found
