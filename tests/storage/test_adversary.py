"""The folder of a search for the worst errors."""

import numpy as np
import polars as pl
import pytest

from glucoloop.situations.situation import configured
from glucoloop.storage.results import Results
from glucoloop.storage.resumable import Work
from glucoloop.storage.rows import rows_folder
from glucoloop.studies.adversary import ADVERSARY
from glucoloop.studies.adversary.study import _GenerationScores, rows

KEYS = {"controller": ["pid"], "errors_pct": [10.0], "generations": 3, "starts": 1, "sequences": 4}
ASKED = configured(ADVERSARY.request, KEYS)
NAME = "pid, guarded, ±10 %"
FIRST, SECOND = np.array([0.5, -np.inf, 2.0, 1.0 / 3.0]), np.arange(4.0)


def adversary_folder(path, asked):
    final = (*ADVERSARY.files, ADVERSARY.summary)
    work = Work(
        command="adversary",
        what="search",
        keys=asked.tree(whole=True),
        explicit=asked.tree(),
        final=final,
    )
    return rows_folder(path, work, rows(asked))


@pytest.fixture
def begun(tmp_path):
    with adversary_folder(tmp_path / "worst", ASKED) as folder:
        folder.add(_GenerationScores(NAME, 0, FIRST))
        folder.add(_GenerationScores(NAME, 1, SECOND))
    return tmp_path / "worst"


def test_what_was_kept_is_there_to_the_bit(begun):
    with adversary_folder(begun, ASKED) as folder:
        assert [(row.search, row.generation) for row in folder.rows] == [(NAME, 0), (NAME, 1)]
        np.testing.assert_array_equal([row.score for row in folder.rows], [FIRST, SECOND])
        assert not folder.finished


def test_a_finished_search_tells_its_summary(begun):
    with adversary_folder(begun, ASKED) as folder:
        folder.finish({**dict.fromkeys(ADVERSARY.files, b""), "adversary.json": b'{"searches": []}'})
    with adversary_folder(begun, ASKED) as folder:
        assert folder.finished
        assert Results.read(begun / ADVERSARY.summary).plain == {"searches": []}


@pytest.mark.parametrize("change", [{"errors_pct": [20.0]}, {"search_seed": 2}, {"generations": 4}, {"sequences": 5}])
def test_another_search_is_refused(begun, change):
    with pytest.raises(ValueError, match=f"holds another search: {next(iter(change))} is"):
        adversary_folder(begun, configured(ADVERSARY.request, {**KEYS, **change})).__enter__()


@pytest.mark.parametrize(
    "rows",
    [
        [{"search": "another", "generation": 0, "score": [1.0] * 4}],
        [{"search": NAME, "generation": 1, "score": [1.0] * 4}],
        [{"search": NAME, "generation": 0, "score": [1.0] * 3}],
        [{"search": NAME, "generation": number, "score": [1.0] * 4} for number in range(4)],
        [{"search": NAME, "generation": 0}],
    ],
)
def test_scores_of_something_else_are_refused(begun, rows):
    pl.DataFrame(rows).write_parquet(begun / "scores.parquet")
    with pytest.raises(ValueError, match=r"is damaged(: .*)?; delete it and run the same command again"):
        adversary_folder(begun, ASKED).__enter__()


def test_nothing_is_left_of_a_search_that_failed_at_once(tmp_path):
    with pytest.raises(RuntimeError), adversary_folder(tmp_path / "worst", ASKED):
        raise RuntimeError
    assert not (tmp_path / "worst").exists()
