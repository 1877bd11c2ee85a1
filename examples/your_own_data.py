"""From a table of your own to a controller: times, insulin rates and glucose readings in a CSV file.

The example makes its own file, from a patient whose insulin was moved up and down at random; put yours in its place.
The same on the command line: ``glucoloop identify --data record.csv --out model``.

    python examples/your_own_data.py
"""

import csv
import tempfile
from pathlib import Path

import numpy as np

import glucoloop as gl

FOLDER = Path(tempfile.mkdtemp())


def make_record(path: Path) -> None:
    """Two days of readings, one of which is missing."""
    patient = gl.patient()
    moves = np.random.default_rng(0).choice([-5.0, 5.0], 576)
    insulin = float(patient.basal_insulin_mU_min) + moves
    glucose = np.asarray(gl.excite(patient, insulin, gl.white_noise(1.45), key=0).glucose_mg_dl)
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["t_min", "insulin_mU_min", "glucose_mg_dl"])
        for k, rate in enumerate(insulin):
            table.writerow([5 * k, rate, "" if k == 100 else glucose[k]])


make_record(FOLDER / "record.csv")

with (FOLDER / "record.csv").open() as file:
    rows = list(csv.DictReader(file))
columns = [[float(row[name] or "nan") for row in rows] for name in ("t_min", "insulin_mU_min", "glucose_mg_dl")]
record, notes = gl.record_from_samples(*columns)
for note in notes:
    print(note)
# Insulin has only two levels here, so the rate before the record is told.
basal = float(gl.patient().basal_insulin_mU_min)
identified = gl.identify_record(record, "least-squares", basal_insulin_mU_min=basal)
print(f"gain {float(identified.model.gain):.2f} mg/dl per mU/min")

trace = gl.simulate(gl.patient(), gl.design_linear_mpc(identified.model))
print(f"undershoot {float(gl.summarise(trace).undershoot_mg_dl):.1f} mg/dl")
