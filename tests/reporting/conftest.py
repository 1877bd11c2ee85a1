"""Runs and trials written down by hand, without a patient, and a reader of pages."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from glucoloop.metrics.control_variability import grid_counts
from glucoloop.storage.results import Results
from glucoloop.studies.stress.study import NO_FAULT
from glucoloop.studies.trial.report import (
    CaseReport,
    MetricDistribution,
    TrialReport,
    WorstPerson,
    ranges_pct,
)
from glucoloop.trials.statistics import BAND_QUANTILES
from glucoloop.tuning.surface import TuningSurface
from made_trace import trace_of

VOID = {"meta", "br", "img", "link", "input", "hr", "col"}


class Reader(HTMLParser):
    """Tags in order, and the text within each kind; it refuses tags that are not closed in order."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.attributes, self.text, self.open = [], [], {}, []
        self.feed(page)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open:
            self.text.setdefault(self.open[-1], []).append(data)

    def refuse_loads(self):
        """Nothing on the page makes a browser ask for another file."""
        assert [value for _, value in self.attributes if value and value.startswith("default-src 'none'")]
        assert not {"link", "iframe", "img", "object", "embed"} & set(self.tags)
        assert not {"src", "onclick"} & {name for name, _ in self.attributes}
        assert not [value for name, value in self.attributes if name == "href" and "/" in value]
        loads = ("url(", "@import", "fetch(", "import(", "XMLHttpRequest", "http://", "https://")
        assert not [
            word for kind in ("style", "script") for part in self.text.get(kind, []) for word in loads if word in part
        ]


def _values(differences, step):
    there = [difference is not None for difference in differences]
    values = np.full(len(there), np.nan)
    values[there] = np.cumsum([difference for difference in differences if difference is not None]) * step
    return values


class Drawn:
    """A curve or a band of a page: ``t_min`` and ``values``, or its ``edges``, NaN where there is a gap."""

    def __init__(self, panel, drawn):
        self.unit, self.name, self.about = panel["unit"], drawn["name"], drawn
        self.t_min = _values(drawn["t"], 0.1)
        self.edges = [_values(drawn[key], panel["step"]) for key in ("y", "low", "high") if key in drawn]
        self.values = self.edges[0]
        self.held = len(self.t_min) > len(self.values)


def plots_on(page):
    """Data of the figures of a page."""
    found = re.findall(r'<figure class="plot"[^>]*><script type="application/json">(.*?)</script>', page)
    return [json.loads(text) for text in found]


def drawn_on(page):
    """Figures of a page, each a list of what is drawn in it and told."""
    return [
        [Drawn(panel, drawn) for panel in plot["panels"] for kind in ("areas", "lines") for drawn in panel[kind]]
        for plot in plots_on(page)
    ]


@pytest.fixture(scope="session")
def plots():
    """Data of the figures of a page."""
    return plots_on


@pytest.fixture(scope="session")
def drawn():
    """What the figures of a page draw."""
    return drawn_on


@pytest.fixture(scope="session")
def make_trace():
    """A run of 5-min samples whose glucose on the grid of one minute is given; people trail."""
    return trace_of


@pytest.fixture(scope="session")
def quiet(make_trace):
    """A run read without noise that settles, its insulin far from the pump's limit."""
    t = np.arange(601.0)
    glucose = 80.0 + np.where(t > 50.0, 10.0 * np.exp(-(((t - 150.0) / 60.0) ** 2)), 0.0)
    insulin = np.full(120, 20.0)
    insulin[20:40] = 35.0
    return make_trace(glucose, insulin)


@pytest.fixture(scope="session")
def noisy(make_trace):
    """A run with a noisy sensor, three missing readings, and a dose at the pump's limit; it does not settle."""
    t = np.arange(601.0)
    glucose = 80.0 + 15.0 * np.sin(t / 40.0)
    insulin = np.full(120, 25.0)
    insulin[20:30] = 66.9
    valid = np.ones(120, bool)
    valid[10:13] = False
    reading = glucose[:-1:5] + np.random.default_rng(0).normal(size=120)
    return make_trace(glucose, insulin, reading_mg_dl=reading, reading_valid=valid)


@pytest.fixture(scope="session")
def reader():
    """What stands on a page."""
    return Reader


def _case(undershoot, seed=0, people=400):
    """A day of people who fall below the setpoint after a meal, by about as much as is said."""
    rng = np.random.default_rng(seed)
    t_min = np.arange(0.0, 1441.0, 5.0)
    after = np.clip(t_min - 480.0, 0.0, None)[:, None]
    below = undershoot * rng.lognormal(0.0, 0.3, people)
    glucose = (
        81.1
        + 60.0 * after / 60.0 * np.exp(1.0 - after / 60.0)
        - below * (after / 200.0) ** 4 * np.exp(4.0 - after / 50.0)
    )
    insulin = 25.0 + 0.1 * (glucose[:-1] - 81.1) + rng.normal(0.0, 1.0, (1, people))
    minimum, maximum = glucose.min(axis=0), glucose.max(axis=0)
    insulin_total = insulin.sum(axis=0) * 5.0
    metrics = {
        "undershoot_mg_dl": (81.1 - minimum, np.linspace(0.0, 80.0, 81)),
        "insulin_total_mU": (insulin_total, np.linspace(0.0, 60000.0, 61)),
    }
    worst = np.argsort(minimum)[:10]
    return CaseReport(
        bands_t_min=t_min,
        glucose_quantiles={q: np.quantile(glucose, q, axis=1) for q in BAND_QUANTILES},
        insulin_t_min=t_min[:-1],
        insulin_quantiles={q: np.quantile(insulin, q, axis=1) for q in BAND_QUANTILES},
        metric_counts={
            name: MetricDistribution(edges, np.histogram(values, edges)[0], *np.quantile(values, [0.05, 0.5, 0.95]))
            for name, (values, edges) in metrics.items()
        },
        cvga_counts=grid_counts(minimum, maximum),
        time_in_range_pct=ranges_pct(
            {
                "time_below_54_pct": 100.0 * float((glucose < 54.0).mean()),
                "time_below_70_pct": 100.0 * float((glucose < 70.0).mean()),
                "time_70_180_pct": 100.0 * float(((glucose >= 70.0) & (glucose <= 180.0)).mean()),
                "time_above_180_pct": 100.0 * float((glucose > 180.0).mean()),
                "time_above_250_pct": 0.0,
            }.get
        ),
        table={
            ("Undershoot, median", "mg/dl"): float(np.median(81.1 - minimum)),
            ("Settled", ""): "all",
            ("Unknown", ""): np.nan,
        },
        worst=[
            WorstPerson(
                person=1000 + int(p),
                minimum_mg_dl=float(minimum[p]),
                t_min=t_min,
                glucose_mg_dl=glucose[:, p],
                insulin_t_min=t_min[:-1],
                insulin_mU_min=insulin[:, p],
                note="hepatic uptake +38 %",
            )
            for p in worst
        ],
        ever_below={
            limit: (int((minimum < limit).sum()), 100.0 * float((minimum < limit).mean())) for limit in (70, 54)
        },
    )


@pytest.fixture(scope="session")
def make_case():
    """What a controller came to under which people undershoot by about so much [mg/dl]."""
    return _case


@pytest.fixture(scope="session")
def make_report(make_case):
    """A trial of controllers by label, each undershooting more than the one before."""

    def make(*labels, **fields):
        cases = {label: make_case(10.0 + 8.0 * index, seed=index) for index, label in enumerate(labels)}
        values = {
            "title": "Trial of two",
            "setpoint_mg_dl": 81.1,
            "people": 12400,
            "infeasible": 3,
            "facts": {"Population": "parker2000", "Seed": "1"},
            "cases": cases,
        }
        return TrialReport(**(values | fields))

    return make


def _stress_row(controller, guarded, fault, *, below=0.0, worse=(), **fields):
    """A cell in which the one who was longest below 60 mg/dl was there for so much of the time."""
    values = {
        "people": 40,
        "below_60_mean_pct": below / 8.0,
        "below_60_worst_pct": below,
        "below_54_mean_pct": below / 16.0,
        "below_54_worst_pct": below / 2.0,
        "ever_below_60_pct": below / 3.0,
        "ever_below_54_pct": below / 5.0,
        "lowest_mg_dl": 75.4 - below,
        "lowest_person": 17,
        "highest_mg_dl": 151.0 + 2.0 * guarded,
        "low_events": round(2.0 * below),
        "very_low_events": round(below),
        "saturated_pct": 12.5,
        "missing_pct": 0.0,
        "rejected_pct": 1.0 * guarded,
        "fallback_pct": 6.66 * guarded,
        "suspended_pct": 0.004 * guarded,
        "dose_limited_pct": 0.25 * guarded,
        "worse": len(worse),
        "worse_people": list(worse),
        "worst_more_pct": below if worse else 0.0,
        "people_below_validity": round(below / 20.0),
    }
    return {"controller": controller, "guarded": guarded, "fault": fault, **(values | fields)}


@pytest.fixture(scope="session")
def make_stress_row():
    """A cell of a stress test, written down by hand."""
    return _stress_row


@pytest.fixture(scope="session")
def make_stress(make_stress_row):
    """A stress test from the time below 60 mg/dl [%] and the people worse off, by controller, guard and fault.

    Cells that are not given pass; each that fails with the guard has its reason. `change` edits a row.
    """

    def make(controllers, faults, bad=(), *, guards=(False, True), change=lambda row: {}, **fields):
        bad = dict(bad)
        rows = []
        for controller in controllers:
            for guarded in guards:
                for fault in (NO_FAULT, *faults):
                    below, worse = bad.get((controller, guarded, fault), (0.0, ()))
                    row = make_stress_row(controller, guarded, fault, below=below, worse=worse)
                    rows.append(row | change(row))
        reasons = [
            {
                "controller": row["controller"],
                "fault": row["fault"],
                "person": row["worse_people"][0],
                "more_pct": row["worst_more_pct"],
                "text": "He ate <nothing> & fell.",
            }
            for row in rows
            if row["guarded"] and row["worse"]
        ]
        plain = {
            "facts": {"Population": "parker2000", "Seed": "1"},
            "people": 40,
            "able": 40,
            "rows": rows,
            "reasons": reasons,
        }
        return Results(plain | fields)

    return make


@pytest.fixture(scope="session")
def stress_page():
    """A function that makes the page of a stress test."""
    from glucoloop.situations.situation import configured
    from glucoloop.studies.stress import StressTest
    from glucoloop.studies.stress.study import page

    asked = configured(StressTest)
    return lambda found: page(asked, found)


@pytest.fixture(scope="session")
def league():
    """A league, and what it found: made-up numbers, in which one controller takes no part."""
    from glucoloop.situations.situation import configured
    from glucoloop.studies.league import League
    from glucoloop.studies.league.numbers import METRICS
    from glucoloop.studies.league.study import _LeagueSearch, _ShardResult, _shards_of

    keys = {"people": 30, "bound_people": 3, "families": ["hovorka-2004", "roy-parker-2007"]}
    asked = configured(League, keys)
    rng, results = np.random.default_rng(0), []
    for number, (line, shard, person) in enumerate(_shards_of(asked)):
        there = person if number else person[:0]
        people = {"person": there, "able": there >= 0, **{name: rng.uniform(0, 90, there.size) for name in METRICS}}
        results.append(_ShardResult(line, shard, "native", "", "" if number else "its <gain> is 0", people))
    return asked, _LeagueSearch(asked).results_of(results)


@pytest.fixture(scope="session")
def league_page(league):
    """The page of that league."""
    from glucoloop.studies.league.report import page

    return page(*league)


@pytest.fixture(scope="session")
def surface_of():
    """A function that makes a surface of tunings and their sums of squared errors, otherwise without blame."""
    return _surface_of


def _surface_of(tunings, sse):
    points = len(tunings)
    none, zero = np.zeros(points, bool), np.zeros(points)
    return TuningSurface(
        controller="toy",
        tunings=tuple(tunings),
        refused=(),
        seeds=1,
        sse=np.asarray(sse, float),
        undershoot_mg_dl=zero,
        minimum_mg_dl=zero,
        settling_2pct_min=zero,
        settled_2pct=none,
        settling_5pct_min=zero,
        settled_5pct=none,
        insulin_total_variation_mU_min=zero,
        kept_share=np.ones(points),
        crossings=np.zeros(points, int),
        turns=np.zeros(points, int),
        oscillates=none,
    )
