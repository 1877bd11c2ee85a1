"""``glucoloop claims``."""

import json

import pytest

SMALL = ("--seeds", 2, "--seed", 3, "--only", "dead-time-10", "--only", "correlated", "--no-bounds")


@pytest.fixture
def _small(monkeypatch):
    """One quick controller, of which the claims are then made."""
    monkeypatch.setattr("glucoloop.papers.meal_aware.reproduce.CONTROLLERS", ("mpc",))
    monkeypatch.setattr("glucoloop.papers.meal_aware.reproduce.OURS", "mpc")


@pytest.mark.usefixtures("_small")
@pytest.mark.long
def test_folder_holds_page_and_numbers_and_repeats_itself(glucoloop, tmp_path):
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

    again = glucoloop("claims", "--config", "a/claims.toml", "--out", "b", "--json")
    assert again.json["claims"] == told["claims"]
    assert "Sensor seeds 3 to 4" in again.err
    for name in (
        "claims.csv",
        "numbers.csv",
        "runs.csv",
        "claims.json",
        "dead-time-10.svg",
        "dead-time-10.pdf",
        "dead-time-10.png",
    ):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


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
