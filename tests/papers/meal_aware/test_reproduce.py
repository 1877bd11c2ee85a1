"""The page, the figures and the tables."""

import io
import json
import re
from html.parser import HTMLParser

import polars as pl
import pytest

from glucoloop.papers.meal_aware.comparison import verdicts
from glucoloop.papers.meal_aware.figures import draw
from glucoloop.papers.meal_aware.pages import number, spread_told
from glucoloop.papers.meal_aware.reproduce import files_of
from glucoloop.papers.meal_aware.situations import CONTROLLERS


@pytest.fixture(scope="module")
def study(study_of, written, at_samples):
    rows = {"fasting, white": at_samples([2.0, 2.2, 2.4])}
    return study_of({"noise-free": written([1.5]), "noise": written([5.0, 6.5, 7.0])}, rows=rows, seed=899_999)


@pytest.fixture(scope="module")
def files(study):
    return {name: data if name.endswith((".png", ".pdf")) else data.decode() for name, data in made(study).items()}


def made(study):
    return files_of(study, verdicts(study))


class _Page(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.sources, self.links, self.text = [], [], set(), ""

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "img"):
            self.open.append(tag)
        self.sources += [value[:26] for name, value in attrs if name == "src"]
        self.links |= {value for name, value in attrs if name == "href"}

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.mark.long
def test_writes_a_figure_for_each_situation_and_all_tables(files):
    drawn = {f"{name}.{kind}" for name in ("noise-free", "noise") for kind in ("pdf", "png", "svg")}
    tables = {"claims.csv", "claims.json", "numbers.csv", "runs.csv", "timing.json", "claims.html"}
    assert set(files) == drawn | tables


@pytest.mark.long
def test_the_page_is_whole_and_needs_nothing_else(files):
    page = _Page()
    page.feed(files["claims.html"])
    assert page.open == []
    assert page.sources == ["data:image/svg+xml;base64,"] * 2
    assert page.links - {"loops.parquet"} == {"claims.csv", "numbers.csv", "runs.csv", "claims.json"} <= set(files)
    for part in (
        "8 of 9 claims hold.",
        "fasting, white 3 runs of seed 899999",
        "seeds 899999 to 900001",
        "chosen on sensor seeds 900000 to 900199",
    ):
        assert part in page.text
    assert "seeds 900000 to 900001 of the sensor are here too: they are no independent test" in page.text
    assert page.text.count("does not hold") == 1


@pytest.mark.long
def test_all_files_tell_the_same(files):
    told = {claim["id"]: claim for claim in json.loads(files["claims.json"])["claims"]}
    table = pl.read_csv(io.StringIO(files["claims.csv"]))
    assert table["claim"].to_list() == list(told)
    assert table["found"].to_list() == pytest.approx([claim["found"] for claim in told.values()])
    assert told["noise.undershoot"]["holds"] is False
    assert told["noise.undershoot"]["found"] == pytest.approx(6.5)
    numbers = pl.read_csv(io.StringIO(files["numbers.csv"]))
    row = numbers.filter(situation="noise", controller="imc", measure="undershoot_mg_dl").row(0, named=True)
    assert (row["runs"], row["median"]) == (3, pytest.approx(6.5))
    runs = pl.read_csv(io.StringIO(files["runs.csv"]))
    assert runs.height == len(CONTROLLERS) * (1 + 3 + 3)
    assert told["fasting.noise"]["found"] == pytest.approx(2.2)
    fasting = runs.filter(situation="fasting, white", controller="imc")["undershoot_mg_dl"]
    assert fasting.to_list() == pytest.approx([2.0, 2.2, 2.4])
    assert "0.5" in files["timing.json"]
    assert "step_ms" not in files["claims.json"]  # nothing there that another run would change


def test_figures_have_a_column_for_each_controller_where_there_are_many_runs(study):
    figures = draw(study)
    assert len(figures["noise-free"].axes) == 2
    assert len(figures["noise"].axes) == 2 * len(CONTROLLERS)
    median = figures["noise"].axes[0].lines[0].get_ydata()
    assert median.min() == pytest.approx(81.1 - 6.5)
    assert len(draw(study, width="single")["noise"].axes) == 12
    with pytest.raises(ValueError, match="unknown width"):
        draw(study, width="wide")


def test_numbers_in_words():
    assert number(-0.004, 2) == "0.00"
    assert number(-1.25, 1) == "−1.2"
    assert number(float("nan"), 1) == "–"
    assert spread_told({"p5": 1.0, "median": 2.0, "p95": 3.0}, 1, one=False) == "2.0 (1.0 to 3.0)"
    assert not re.search(r"\(", spread_told({"p5": 2.0, "median": 2.0, "p95": 2.0}, 1, one=True))
