"""Twins beside those of ReplayBG (py-replay-bg 1.4.0) on the same records: a day is fitted, the next one predicted.

    python -m venv replaybg && replaybg/bin/pip install py-replay-bg==1.4.0
    PYTHONPATH=tests/shared python benchmarks/twins_beside_replaybg.py replaybg/bin/python --people 2

ReplayBG has a model of its own, of one day with a gut for each meal, and other priors; the people are of our family, so
that it cannot know them as well. Its search starts from `--reruns` places instead of 128, which takes many minutes.
Both are told the weight and the basal rate.
"""

import argparse
import json
import subprocess
import tempfile
import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
import polars as pl  # noqa: E402

from glucoloop.patients.population import population  # noqa: E402
from glucoloop.twins import find_twin, recorded_days  # noqa: E402
from lived_records import FIRST, lived  # noqa: E402

FAMILY, PEOPLE = "hovorka-2004", "boiroux2017"
THEIRS = """
import json, sys, time, warnings
warnings.filterwarnings("ignore")
import numpy as np, pandas as pd
asked = json.load(sys.stdin)
from py_replay_bg.py_replay_bg import ReplayBG
from py_replay_bg.twinning.map import MAP
of_map = MAP.__init__
def with_fewer(self, *args, **kwargs):
    of_map(self, *args, **kwargs)
    self.n_rerun = asked["reruns"]
MAP.__init__ = with_fewer
def day(rows):
    frame = pd.DataFrame(rows)
    frame["t"] = pd.to_datetime(frame["t"])
    return frame
begun = time.process_time()
rbg = ReplayBG(blueprint="multi-meal", save_folder=asked["folder"], yts=5, seed=1, verbose=False, plot_mode=False)
rbg.twin(data=day(asked["first"]), bw=asked["weight_kg"], save_name="one", twinning_method="map", parallelize=False,
         u2ss=asked["u2ss"])
spent = time.process_time() - begun
def errors(rows):
    data = day(rows)
    found = rbg.replay(data=data, bw=asked["weight_kg"], save_name="one", twinning_method="map", save_workspace=False)
    glucose = np.asarray(found["glucose"]["median"])
    return float(np.sqrt(np.nanmean((glucose[::5][: len(data)] - data["glucose"].to_numpy()) ** 2)))
print("\\n" + json.dumps({"fit": errors(asked["first"]), "next": errors(asked["second"]), "s": spent}))
"""


def rows_of(record, day):
    """Rows of one day as ReplayBG takes them: rates per minute, and a label for each meal."""
    begin = FIRST + np.timedelta64(day, "D").astype("timedelta64[us]").item()
    frame = record.frame.filter((pl.col("time") >= begin) & (pl.col("time") < begin + np.timedelta64(1, "D").item()))
    result, labels = [], iter("BLDS")
    for row in frame.iter_rows(named=True):
        carbs, bolus = row["carbs_g"] or 0.0, row["bolus_U"] or 0.0
        result.append(
            {
                "t": str(row["time"]),
                "glucose": row["glucose_mg_dl"],
                "cho": carbs / 5.0,
                "cho_label": next(labels) if carbs else "",
                "bolus": bolus / 5.0,
                "bolus_label": "B" if bolus else "",
                "basal": row["basal_U_h"] / 60.0,
                "exercise": 0,
            }
        )
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("python")
    parser.add_argument("--people", type=int, default=2)
    parser.add_argument("--first", type=int, default=3000)
    parser.add_argument("--reruns", type=int, default=4)
    asked = parser.parse_args()
    for person in range(asked.first, asked.first + asked.people):
        record, truth = lived(FAMILY, PEOPLE, person, days=2)
        first, second = rows_of(record, 0), rows_of(record, 1)
        begun = time.process_time()
        twin = find_twin(
            recorded_days(record),
            population(PEOPLE, patient=FAMILY),
            known={"weight_kg": truth["weight_kg"]},
            held_out_days=1,
        )
        ours = {"fit": twin.fit_rmse_mg_dl, "next": twin.held_out.rmse_mg_dl, "s": time.process_time() - begun}
        given = {
            "first": first,
            "second": second,
            "weight_kg": truth["weight_kg"],
            "u2ss": 1000.0 * first[0]["basal"] / truth["weight_kg"],
            "reruns": asked.reruns,
        }
        with tempfile.TemporaryDirectory() as folder:
            answer = subprocess.run(
                [asked.python, "-c", THEIRS],
                input=json.dumps({**given, "folder": folder}),
                capture_output=True,
                text=True,
                check=False,
            )
        theirs = json.loads(answer.stdout.splitlines()[-1]) if answer.returncode == 0 else answer.stderr[-2000:]
        print(json.dumps({"person": person, "glucoloop": ours, "replaybg": theirs}), flush=True)


if __name__ == "__main__":
    main()
