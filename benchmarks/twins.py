"""Twins of simulated people whose parameters are known: prediction of two days from doses and meals alone.

    PYTHONPATH=tests/shared python benchmarks/twins.py hovorka-2004 boiroux2017 --people 20 --first 1000
    PYTHONPATH=tests/shared python benchmarks/twins.py hovorka-2004 boiroux2017 --messy

A person lives seven days with four meals a day of drawn sizes and times, boluses by the person's own ratio, and a
Dexcom G6 under the skin. The last two days are held out, and predicted from the midnight before them without any of
their readings; the day from midnight stands beside that of other methods. With ``--messy`` 15 % of the meals are
neither bolused nor entered, counts err by 30 %, and sensitivity to insulin differs by 15 % from one part of a day to
the next.
"""

import argparse
import json
import statistics
import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

from glucoloop.forecasts.grid import SAMPLES_PER_DAY, gridded_record  # noqa: E402
from glucoloop.forecasts.method import METHODS  # noqa: E402
from glucoloop.forecasts.scores import DAY, forecast_errors  # noqa: E402
from glucoloop.patients.population import population  # noqa: E402
from glucoloop.refusal import Refusal  # noqa: E402
from glucoloop.twins import find_twin  # noqa: E402
from glucoloop.twins.forecast import TwinPredictor  # noqa: E402
from lived_records import lived  # noqa: E402

HELD_OUT_DAYS = 2
OTHERS = ("ridge", "kalman", "time-of-day")
MESSY = {
    "carb_error_pct": 30.0,
    "habits": [{"name": "unannounced", "probability": 0.15}],
    "rhythm": [{"name": "visentin-2015", "pattern": "hhh", "day_spread_pct": 15.0}],
}


def measured(twin, truth):
    """Errors of a twin, and whether its intervals hold the true parameters."""
    record, first = twin.record, (twin.record.days - HELD_OUT_DAYS) * SAMPLES_PER_DAY
    horizons = np.arange(1, HELD_OUT_DAYS * SAMPLES_PER_DAY + 1)
    predictor = TwinPredictor.of(twin.mode, twin.training)
    forecast = predictor.forecast(record, np.array([first - 1]), horizons, future_known=True)
    day = twin.checks[-1]
    others = {f"{name}_mg_dl": METHODS.choose(name).fit(twin.training) for name in OTHERS}
    inside = [row["low"] <= truth[row["parameter"]] <= row["high"] for row in twin.rows()]
    return {
        "two_days_mg_dl": float(np.sqrt(np.nanmean((forecast.mean_mg_dl[0] - record.reading_mg_dl[first:]) ** 2))),
        "day_mg_dl": day.rmse_mg_dl,
        "mean_mg_dl": day.by_mean_rmse_mg_dl,
        **{name: day_error(method, record) for name, method in others.items()},
        "day_covered_pct": day.covered_pct,
        "parameters_covered_pct": 100.0 * sum(inside) / len(inside),
    }


def day_error(method, record):
    """Error of a method on the days held out from the midnight before each, with meals and boluses known."""
    errors = forecast_errors(method, record, record.days - HELD_OUT_DAYS, (), future_known=True)[DAY]
    return float(np.sqrt(np.mean(errors.error_mg_dl**2)))


def main():
    """Find the twin of each person, and print its errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("patient")
    parser.add_argument("population")
    parser.add_argument("--people", type=int, default=20)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--days", type=int, default=7)
    parser.add_argument("--messy", action="store_true")
    request = parser.parse_args()
    people = population(request.population, patient=request.patient)
    rows, begun = [], time.process_time()
    for person in range(request.first, request.first + request.people):
        try:
            settings = MESSY if request.messy else {}
            record, truth = lived(request.patient, request.population, person, days=request.days, **settings)
        except Refusal as error:  # nobody holds the setpoint in this person
            print(person, "left out:", error)
            continue
        twin = find_twin(gridded_record(record), people, held_out_days=HELD_OUT_DAYS)
        rows.append({"person": person, **measured(twin, truth)})
        print(json.dumps(rows[-1]), flush=True)
    for name in list(rows[0])[1:]:
        values = sorted(row[name] for row in rows)
        middle = f"mean {statistics.mean(values):.1f}, median {statistics.median(values):.1f}"
        print(f"{name}: {middle}, from {values[0]:.1f} to {values[-1]:.1f}")
    for name in OTHERS:
        better = sum(row["day_mg_dl"] < row[f"{name}_mg_dl"] for row in rows)
        print(f"day better than {name}: {better} of {len(rows)}")
    print(f"{len(rows)} people, {(time.process_time() - begun) / len(rows):.1f} s of a processor each")


if __name__ == "__main__":
    main()
