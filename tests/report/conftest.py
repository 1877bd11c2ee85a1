"""Runs and trials written down by hand, without a patient, and a reader of pages."""

from html.parser import HTMLParser

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.metrics.control_variability import grid_counts
from glucoloop.report.trial_report import QUANTILES, CaseReport, Distribution, TrialReport, WorstPerson, ranges_pct
from glucoloop.simulation import Trace

VOID = {"meta", "br", "img", "link", "input", "hr"}


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


def _trace(fine_glucose, insulin=None, *, setpoint=80.0, basal=20.0, meal_sample=10, **fields):
    fine = np.asarray(fine_glucose, float)
    samples = (len(fine) - 1) // 5
    assert len(fine) == 5 * samples + 1
    people = fine.shape[1:]
    insulin = np.full((samples, *people), basal) if insulin is None else np.asarray(insulin, float)
    carbs_g = np.zeros(samples)
    if meal_sample is not None:
        carbs_g[meal_sample] = 50.0
    values = {
        "t_min": 5.0 * np.arange(samples),
        "glucose_mg_dl": fine[:-1:5],
        "reading_mg_dl": fine[:-1:5],
        "reading_valid": np.ones((samples, *people), bool),
        "command_mU_min": insulin,
        "insulin_mU_min": insulin,
        "reported_mU_min": insulin,
        "status": np.zeros((samples, *people), int),
        "carbs_g": carbs_g,
        "states": np.zeros((samples + 1, 1, *people)),
        "fine_t_min": np.arange(len(fine), dtype=float),
        "fine_glucose_mg_dl": fine,
        "setpoint_mg_dl": np.full(people, setpoint),
        "basal_insulin_mU_min": np.full(people, basal),
    }
    return Trace(**{name: jnp.asarray(value) for name, value in (values | fields).items()})


@pytest.fixture(scope="session")
def make_trace():
    """A run of 5-min samples whose glucose on the grid of one minute is given; people trail."""
    return _trace


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
        glucose_quantiles={q: np.quantile(glucose, q, axis=1) for q in QUANTILES},
        insulin_t_min=t_min[:-1],
        insulin_quantiles={q: np.quantile(insulin, q, axis=1) for q in QUANTILES},
        metric_counts={
            name: Distribution(edges, np.histogram(values, edges)[0], *np.quantile(values, [0.05, 0.5, 0.95]))
            for name, (values, edges) in metrics.items()
        },
        cvga_counts=grid_counts(minimum, maximum),
        time_in_range_pct=ranges_pct(
            time_below_54_pct=100.0 * float((glucose < 54.0).mean()),
            time_below_70_pct=100.0 * float((glucose < 70.0).mean()),
            time_70_180_pct=100.0 * float(((glucose >= 70.0) & (glucose <= 180.0)).mean()),
            time_above_180_pct=100.0 * float((glucose > 180.0).mean()),
            time_above_250_pct=0.0,
        ),
        table={"Undershoot, median (mg/dl)": float(np.median(81.1 - minimum)), "Settled": "all", "Unknown": np.nan},
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
            "unable": 3,
            "facts": {"Population": "parker2000", "Seed": "1"},
            "cases": cases,
        }
        return TrialReport(**(values | fields))

    return make
