"""Twins of simulated people whose parameters are known: prediction of days that were held out, and its intervals.

    PYTHONPATH=tests/shared python benchmarks/twins.py hovorka-2004 boiroux2017 --people 100 --first 1000

A person lives seven days with four meals a day of drawn sizes and times, boluses by the person's own ratio, and a
Dexcom G6 under the skin; the last two days are held out.
"""

import argparse
import json
import statistics
import time

import jax

jax.config.update("jax_enable_x64", True)

from glucoloop.patients.population import population  # noqa: E402
from glucoloop.refusal import Refusal  # noqa: E402
from glucoloop.twins import find_twin, recorded_days  # noqa: E402
from lived_records import lived  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("patient")
    parser.add_argument("population")
    parser.add_argument("--people", type=int, default=100)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--days", type=int, default=7)
    parser.add_argument("--carb-error-pct", type=float, default=0.0)
    asked = parser.parse_args()
    rows, begun = [], time.process_time()
    for person in range(asked.first, asked.first + asked.people):
        try:
            record, truth = lived(
                asked.patient, asked.population, person, days=asked.days, carb_error_pct=asked.carb_error_pct
            )
        except Refusal as error:  # nobody holds the setpoint in this person
            print(person, "left out:", error)
            continue
        twin = find_twin(recorded_days(record), population(asked.population, patient=asked.patient))
        held = twin.held_out
        inside = [row["low"] <= truth[row["parameter"]] <= row["high"] for row in twin.rows()]
        rows.append(
            {
                "person": person,
                "rmse_mg_dl": held.rmse_mg_dl,
                "noise_mg_dl": twin.noise.sd_mg_dl,
                "population_mg_dl": held.by_population_rmse_mg_dl,
                "mean_mg_dl": held.by_mean_rmse_mg_dl,
                "covered_pct": held.covered_pct,
                "parameters_covered_pct": 100.0 * sum(inside) / len(inside),
                "agreeing_starts": twin.agreeing_starts,
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    for name in list(rows[0])[1:]:
        values = sorted(row[name] for row in rows)
        print(f"{name}: mean {statistics.mean(values):.1f}, from {values[0]:.1f} to {values[-1]:.1f}")
    print(f"{len(rows)} people, {(time.process_time() - begun) / len(rows):.1f} s of a processor each")


if __name__ == "__main__":
    main()
