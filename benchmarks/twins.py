"""Twins of simulated people whose parameters are known: prediction of two days from doses and meals alone.

    PYTHONPATH=tests/shared python benchmarks/twins.py hovorka-2004 boiroux2017 --people 20 --first 1000

A person lives seven days with four meals a day of drawn sizes and times, boluses by the person's own ratio, and a
Dexcom G6 under the skin. The last two days are held out, and predicted from the midnight before them without any of
their readings.
"""

import argparse
import json
import statistics
import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

from glucoloop.forecasts.grid import SAMPLES_PER_DAY, gridded_record  # noqa: E402
from glucoloop.patients.population import population  # noqa: E402
from glucoloop.refusal import Refusal  # noqa: E402
from glucoloop.twins import find_twin  # noqa: E402
from glucoloop.twins.forecast import TwinPredictor  # noqa: E402
from lived_records import lived  # noqa: E402

HELD_OUT_DAYS = 2


def measured(twin, truth):
    """Errors of a twin, and whether its intervals hold the true parameters."""
    record, first = twin.record, (twin.record.days - HELD_OUT_DAYS) * SAMPLES_PER_DAY
    horizons = np.arange(1, HELD_OUT_DAYS * SAMPLES_PER_DAY + 1)
    predictor = TwinPredictor.of(twin.mode, twin.training)
    forecast = predictor.forecast(record, np.array([first - 1]), horizons, future_known=True)
    day = twin.checks[-1]
    inside = [row["low"] <= truth[row["parameter"]] <= row["high"] for row in twin.rows()]
    return {
        "two_days_mg_dl": float(np.sqrt(np.nanmean((forecast.mean_mg_dl[0] - record.reading_mg_dl[first:]) ** 2))),
        "day_mg_dl": day.rmse_mg_dl,
        "mean_mg_dl": day.by_mean_rmse_mg_dl,
        "day_covered_pct": day.covered_pct,
        "parameters_covered_pct": 100.0 * sum(inside) / len(inside),
    }


def main():
    """Find the twin of each person, and print its errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("patient")
    parser.add_argument("population")
    parser.add_argument("--people", type=int, default=20)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--days", type=int, default=7)
    parser.add_argument("--carb-error-pct", type=float, default=0.0)
    request = parser.parse_args()
    people = population(request.population, patient=request.patient)
    rows, begun = [], time.process_time()
    for person in range(request.first, request.first + request.people):
        try:
            record, truth = lived(
                request.patient, request.population, person, days=request.days, carb_error_pct=request.carb_error_pct
            )
        except Refusal as error:  # nobody holds the setpoint in this person
            print(person, "left out:", error)
            continue
        twin = find_twin(gridded_record(record), people, held_out_days=HELD_OUT_DAYS)
        rows.append({"person": person, **measured(twin, truth)})
        print(json.dumps(rows[-1]), flush=True)
    for name in list(rows[0])[1:]:
        values = sorted(row[name] for row in rows)
        print(f"{name}: mean {statistics.mean(values):.1f}, from {values[0]:.1f} to {values[-1]:.1f}")
    print(f"{len(rows)} people, {(time.process_time() - begun) / len(rows):.1f} s of a processor each")


if __name__ == "__main__":
    main()
