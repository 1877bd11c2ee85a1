"""Tables as LaTeX: every cell of the terminal, escaped, with units in the headings and the rules of booktabs."""

import re

import polars as pl
import pytest
from rich.table import Table
from rich.text import Text

from glucoloop.component.code import loaded
from glucoloop.display_units import showing
from glucoloop.reporting.columns import Column, MetricRow, lines_table, terminal_table, whole
from glucoloop.reporting.latex import _latex_text, latex_tables
from glucoloop.studies.catalogue import STUDIES
from glucoloop.studies.study import PlainStudy

COLUMNS = (
    Column(name="people", short="worse\noff", text=whole, strong=lambda row: row["people"] > 1),
    Column(name="below_60_pct", short="<60\nmean"),
    Column(name="lowest_mg_dl", short="lowest\nmg/dl", text=whole),
    Column(name="why", short="Why", text=str, left=True),
)
SECTIONS = [
    ("pid & imc", [("no fault", [{"people": 0, "below_60_pct": 1.5, "lowest_mg_dl": 64.0, "why": "50 % of $5_0"}])]),
    ("mpc", [("spikes", [{"people": 2, "below_60_pct": None, "lowest_mg_dl": 54.0, "why": "-3 → −5, 70-180"}])]),
]


def body(text):
    """Rows between the rules, cell by cell."""
    inner = re.search(r"\\midrule\n(.*?)\s*\\bottomrule", text, re.S)[1]
    return [line.strip().removesuffix(r" \\").split(" & ") for line in inner.split("\n")]


@pytest.fixture
def written():
    return latex_tables(
        [terminal_table("Fault", SECTIONS, COLUMNS, caption="In 3 % of runs")], "stress", "glucoloop stress"
    )


def test_each_cell_stands_in_its_row(written):
    assert body(written) == [
        [r"\multicolumn{5}{@{}l@{}}{\textbf{pid \& imc}}"],
        [r"\quad no fault", "0", "1.5", "64", r"50 \% of \$5\_0"],
        [r"\addlinespace"],
        [r"\multicolumn{5}{@{}l@{}}{\textbf{mpc}}"],
        [r"\quad spikes", r"\textbf{2}", "n/a", "54", r"$-$3 $\rightarrow$ $-$5, 70--180"],
    ]


def test_headings_have_their_units_and_are_aligned_as_their_numbers(written):
    def below(align, *lines):
        return rf"\begin{{tabular}}[b]{{@{{}}{align}@{{}}}}" + r"\\".join(lines) + r"\end{tabular}"

    heads = re.search(r"\\toprule\n\s*(.*) \\\\\n", written)[1].split(" & ")
    shares = below("r", "$<$60", "mean", r"\%")
    assert heads == ["Fault", below("r", "worse", "off"), shares, below("r", "lowest", "mg/dl"), "Why"]
    assert r"\begin{tabular}{@{}lrrrl@{}}" in written


def test_other_units_are_in_headings_and_numbers():
    with showing("mmol/l"):
        written = latex_tables([terminal_table("Fault", SECTIONS, COLUMNS)], "stress", "glucoloop stress")
    assert "mmol/l" in written
    assert "mg/dl" not in written
    assert body(written)[1][3] == "3.6"


def test_it_is_a_float_with_caption_and_label(written):
    assert written.count(r"\begin{table}") == written.count(r"\end{table}") == 1
    assert r"\caption{By \texttt{glucoloop stress}. In 3 \% of runs}" in written
    assert r"\label{tab:stress-1}" in written
    assert r"\usepackage{booktabs}" in written.split(r"\begin{table}")[0]
    assert all(line.startswith("%") for line in written.split("\n\n")[0].split("\n"))


def test_metrics_side_by_side_keep_their_units():
    rows = [
        MetricRow("Glycemia", "Mean glucose", "mg/dl", ["81.1", "-1.0"]),
        MetricRow("", "SSE", "(mg/dl)²", ["3", "4"]),
    ]
    written = latex_tables([lines_table("Metric", ["a_b", "[x]"], rows)], "compare", "glucoloop compare")
    assert r"Metric & a\_b & [x] & Unit \\" in written
    assert body(written) == [
        [r"\multicolumn{4}{@{}l@{}}{\textbf{Glycemia}}"],
        [r"\quad Mean glucose", "81.1", "$-$1.0", "mg/dl"],
        ["SSE", "3", "4", "(mg/dl)$^2$"],
    ]


def test_tables_are_numbered_and_what_is_no_table_is_a_bug():
    table = Table()
    table.add_column("A")
    table.add_row(Text("1"))
    assert re.findall(r"tab:(\S+)\}", latex_tables([table, table], "x", "y")) == ["x-1", "x-2"]
    assert latex_tables([], "x", "y").count("table}") == 0
    with pytest.raises(TypeError, match="DataFrame is no table"):
        latex_tables([pl.DataFrame()], "x", "y")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (r"a\b{c}~^", r"a\textbackslash{}b\{c\}\textasciitilde{}\textasciicircum{}"),
        ("#1 & 2_3 $", r"\#1 \& 2\_3 \$"),
        ("12| 3", r"12\textbar{}3"),
        ("± 30 %, ≤ 5 µU", r"$\pm$ 30 \%, $\le$ 5 $\mu$U"),
        ("-3.5", "$-$3.5"),
        ("a-3, 2026-11-27, hovorka-2004", "a-3, 2026-11-27, hovorka-2004"),
        ("70-180", "70--180"),
        ("Nørgaard", "Nørgaard"),
    ],
)
def test_text_is_escaped(text, shown):
    assert _latex_text(text) == shown


@pytest.mark.parametrize("name", [name for name, entry in STUDIES.items()])
def test_every_study_that_resumes_has_its_figure_as_pdf(name):
    study = loaded(STUDIES[name].place)
    draws = any(file.endswith(".pdf") for file in study.files)
    assert isinstance(study, PlainStudy) or draws == (
        name != "verify"
    )  # which says whether promises are kept, in words
