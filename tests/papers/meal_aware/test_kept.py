"""Runs that the folder of a comparison keeps."""

import jax
import numpy as np
import pytest

from glucoloop.papers.meal_aware.kept import KeptRuns, loops_in, rows_of, work_of
from glucoloop.papers.meal_aware.situations import read_asked
from glucoloop.storage.rows import rows_folder
from glucoloop.tuning.oscillation import Oscillation

ASKED = read_asked({"only": ["noise", "fasting"], "seeds": 3})


@pytest.fixture
def runs(written, at_samples):
    quiet = Oscillation(crossings=np.asarray(2), turns=np.asarray(3), oscillates=np.asarray(False))
    dips = [1.0 / 3.0, 2.0, 4.0]
    return [
        KeptRuns("noise", "mpc", written(dips, quiet=quiet)),
        KeptRuns("noise", "pid", written(dips)),
        KeptRuns("fasting, white", "mpc", at_samples(dips)),
    ]


def opened(place):
    return rows_folder(place, work_of(ASKED), rows_of(ASKED, ("mpc", "pid")))


def test_runs_are_read_as_they_were_written(runs, tmp_path):
    with opened(tmp_path / "kept") as folder:
        for row in runs:
            folder.add(row)
    with opened(tmp_path / "kept") as folder:
        again = folder.rows
    assert [row[:2] for row in again] == [row[:2] for row in runs]
    assert loops_in(again) == 9
    for before, after in zip(runs, again, strict=True):
        assert jax.tree.structure(vars(before.runs)) == jax.tree.structure(vars(after.runs))
        for one, other in zip(jax.tree.leaves(vars(before.runs)), jax.tree.leaves(vars(after.runs)), strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("case", [("noise", "imc"), ("juice", "mpc"), ("noise", "mpc")])
def test_runs_that_are_not_asked_for_are_refused(runs, tmp_path, case):
    with opened(tmp_path / "kept") as folder:
        folder.add(runs[0])
        folder.add(KeptRuns(*case, runs[0].runs))
    with pytest.raises(ValueError, match=r"loops.parquet is damaged; delete it"), opened(tmp_path / "kept"):
        pass
