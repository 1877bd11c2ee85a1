"""``glucoloop claims``."""

import json

import pytest

from glucoloop.papers.meal_aware.experiments import MismatchedLoops

RUN = MismatchedLoops.run
SMALL = ("--seeds", 2, "--seed", 3, "--only", "dead-time-10", "--only", "correlated", "--no-bounds")


@pytest.fixture
def _small(monkeypatch):
    """One quick controller, of which the claims are then made."""
    monkeypatch.setattr("glucoloop.papers.meal_aware.reproduce.CONTROLLERS", ("mpc",))
    monkeypatch.setattr("glucoloop.papers.meal_aware.reproduce.OURS", "mpc")


@pytest.mark.usefixtures("_small")
@pytest.mark.long
def test_folder_holds_page_and_numbers_repeats_itself_and_goes_on(glucoloop, tmp_path, monkeypatch):
    first = glucoloop("claims", *SMALL, "--out", "a")
    assert first.code == 0, first.err
    for part in ("undershoot, median", "≤ 12.00", "does not hold", "None of them is here", "Wrote claims.csv"):
        assert part in first.out
    told = json.loads((tmp_path / "a/claims.json").read_text())
    asked = {"seed": 3, "seeds": 2, "people": 1000, "only": ["dead-time-10", "correlated"], "bounds": False}
    assert told["config"] == asked
    assert {claim["situation"] for claim in told["claims"]} == {"dead-time-10", "correlated"}
    verdict = told["claims"][0]
    assert verdict["holds"] is False  # linear MPC undershoots by some 22 mg/dl
    assert f"{verdict['found']:.2f}" in first.out

    repeated = ("claims", "--config", "a/claims.toml", "--out", "b")
    with monkeypatch.context() as patch:
        patch.setattr(MismatchedLoops, "run", interrupted)
        stopped = glucoloop(*repeated)
    assert stopped.code == 130
    assert "interrupted; 1 of 3 pairs of situation and controller are kept, the same command goes on." in stopped.err
    assert {path.name for path in (tmp_path / "b").iterdir()} == {"arithmetic.json", "claims.toml", "loops.parquet"}

    with monkeypatch.context() as patch:
        patch.setattr(MismatchedLoops, "run", after_one_situation)
        stopped = glucoloop(*repeated)
    assert "interrupted; 2 of 3 pairs of situation and controller are kept" in stopped.err

    with monkeypatch.context() as patch:
        patch.setattr("glucoloop.papers.meal_aware.experiments._loops_of_seeds", interrupted)  # they are there
        closed = []
        patch.setattr(
            MismatchedLoops, "run", lambda of, design, **rest: closed.append(of.rows) or RUN(of, design, **rest)
        )
        again = glucoloop(*repeated, "--json")
    assert [len(rows) for rows in closed] == [1]  # the other one of the two is there
    assert again.json["claims"] == told["claims"]
    assert "2 of 3 pairs of situation and controller of b are there already; going on." in again.err
    assert "Sensor seeds 3 to 4" in again.err
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name

    monkeypatch.setattr("glucoloop.papers.meal_aware.experiments.study", interrupted)
    finished = glucoloop(*repeated)
    assert "was finished before" in finished.err
    assert finished.out.replace("to b.", "to a.") == first.out


def interrupted(*given, **named):
    raise KeyboardInterrupt


def after_one_situation(loops, design, *, progress):
    """Runs of which one situation is kept before the user stops."""
    runs = RUN(loops, design, progress=progress)

    class Stopped(dict):
        def items(self):
            yield next(iter(runs.items()))
            raise KeyboardInterrupt

    return Stopped()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--seeds", 0), "--seeds is 0; give"),
        (("--seeds", "x"), "--seeds is 'x'; give a whole number"),
        (("--people", -1), "--people is -1"),
        (("--only", "stomach"), "--only is 'stomach', which is no situation; the known ones are: noise-free, noise"),
        (("--overwrite",), "name one with --out"),
        (("--out", ""), "--out is empty"),
        (("--config", "none.toml"), "none.toml"),
    ],
)
def test_mistakes(refused, arguments, sentence):
    assert sentence in refused("claims", *arguments)


def test_a_file_with_an_unknown_key_is_refused(refused, tmp_path):
    (tmp_path / "claims.toml").write_text("horizon = 3\n")
    assert "unknown key 'horizon'" in refused("claims", "--config", "claims.toml")


def test_help(glucoloop):
    assert "claims --quick --out glimpse" in glucoloop("claims", "--help").out
