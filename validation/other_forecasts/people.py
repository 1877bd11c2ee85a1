"""Forecasts of GluPredKit's models beside those of `glucoloop forecast`: the same people, days, samples and entries.

    pip install glupredkit==1.0.32                   in an environment that has glucoloop
    python validation/other_forecasts/people.py azt1d.zip [--model ridge] [--json rows.jsonl]

The archive or folder holds ``Subject N.csv`` of AZT1D; ``benchmarks/real_forecasts.py`` names its source. Of each
person the last 28 days are used, 20 to fit and 8 to forecast. Features, targets, interpolation and fit are those of
GluPredKit, configured as the third example of its documentation does: 90 min of lagged glucose, insulin and
carbohydrate, the hour, and what is known of the time to come: meals and boluses of the user, or nothing. An error
counts where both packages have a forecast: every 15 min at which there is a reading, for a horizon with one.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import json
import re
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
from glupredkit.preprocessors.basic import Preprocessor

import glucoloop as gl
from glucoloop.forecasts.grid import SAMPLE_MIN, SAMPLES_PER_DAY, GriddedRecord, gridded_record
from glucoloop.forecasts.method import METHODS, origins_of
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.forecasts.grid import Values

HORIZONS_MIN: Final = (30, 60, 120, 240)
HELD_OUT_DAYS: Final = 8
LAGGED: Final = 18
NUMERICAL: Final = ["CGM", "insulin", "carbs", "bolus"]
TO_COME: Final = ["bolus", "carbs"]
OWN: Final = ("kalman", "ridge", "persistence")
OTHER: Final = "GluPredKit"
FUTURES: Final = ("unknown", "known")
HORIZONS: Final = np.array(HORIZONS_MIN) // round(SAMPLE_MIN)


class Configuration:
    """Configuration as GluPredKit's models read it."""

    def __init__(self, horizon_min: int, to_come: list[str]) -> None:
        self.horizon_min = horizon_min
        self.to_come = to_come

    def get_num_features(self) -> list[str]:
        """Names of the numerical features."""
        return NUMERICAL

    def get_num_lagged_features(self) -> int:
        """Number of earlier samples."""
        return LAGGED

    def get_what_if_features(self) -> list[str]:
        """Names of what is known of the time to come."""
        return self.to_come

    def get_prediction_horizon(self) -> int:
        """Horizon in minutes."""
        return self.horizon_min


def table_of(record: GriddedRecord) -> pd.DataFrame:
    """The record as a table of GluPredKit, with the days held out as its test."""
    at = pd.date_range(record.first, periods=record.reading_mg_dl.size + 1, freq=f"{SAMPLE_MIN:g}min")[1:]
    columns = {
        "CGM": record.reading_mg_dl,
        "insulin": record.insulin_U,
        "bolus": record.user_bolus_U,
        "carbs": record.carbs_g,
        "hour": at.hour,
        "id": 1,
        "is_test": np.arange(at.size) >= (record.days - HELD_OUT_DAYS) * SAMPLES_PER_DAY,
    }
    return pd.DataFrame(columns, index=at)


def forecast_of_other(name: str, record: GriddedRecord, horizon_min: int, *, known: bool) -> tuple[Values, float]:
    """Forecast of a model of GluPredKit from each sample, NaN where it has none, and seconds to fit it.

    A model has one horizon and one target: with more, it would be told entries that come after what it forecasts, and
    a bolus that corrects tells how high glucose was before.
    """
    model = importlib.import_module(f"glupredkit.models.{name}").Model(horizon_min)
    to_come = TO_COME if known else []
    configuration, target = Configuration(horizon_min, to_come), f"target_{horizon_min}"
    training, test = Preprocessor(None, NUMERICAL, ["hour"], to_come, horizon_min, LAGGED)(table_of(record))
    targets = [column for column in training.columns if column.startswith("target")]
    begun = time.process_time()
    training = model.process_data(training, configuration, real_time=False)
    model.fit(training.drop(columns=targets), training[[target]])
    seconds = time.process_time() - begun
    # A reading held out may be missing at a target; the rows of all origins are needed.
    rows = model.process_data(test.drop(columns=[*targets, "imputed"]), configuration, real_time=False)
    result = np.full(record.reading_mg_dl.size, np.nan)
    since = (rows.index - pd.Timestamp(record.first)) // pd.Timedelta(minutes=SAMPLE_MIN)
    result[since.to_numpy() - 1] = np.asarray(model.predict(rows))[:, 0]
    return result, seconds


def errors_of(record: GriddedRecord, models: Sequence[str]) -> dict[str, Any]:
    """Errors of each method by horizon, with a known and an unknown future, on the samples that all have.

    ``fit_s`` has the seconds of a processor of each fit, the later one where there are two.
    """
    first_day = record.days - HELD_OUT_DAYS
    origins = origins_of(record, first_day * SAMPLES_PER_DAY)
    targets = np.minimum(origins[:, None] + HORIZONS, record.reading_mg_dl.size)
    reading = np.append(record.reading_mg_dl, np.nan)[targets]
    result: dict[str, Any] = {"fit_s": {}}
    predictors = {}
    for text in OWN:
        begun = time.process_time()
        predictors[text] = METHODS.choose(text).fit(record.of_days(0, first_day))
        result["fit_s"][text] = time.process_time() - begun
    for known in (True, False):
        errors = {
            text: predictor.forecast(record, origins, HORIZONS, future_known=known).mean_mg_dl - reading
            for text, predictor in predictors.items()
        }
        for name in models:
            each = [forecast_of_other(name, record, horizon_min, known=known) for horizon_min in HORIZONS_MIN]
            errors[f"{OTHER} {name}"] = np.stack([forecast[origins] for forecast, _ in each], axis=-1) - reading
            result["fit_s"][f"{OTHER} {name}"] = sum(of_fit for _, of_fit in each)
        there = np.all([np.isfinite(error) for error in errors.values()], axis=0)
        result[FUTURES[known]] = {
            text: [float(np.sqrt(np.mean(error[there[:, at], at] ** 2))) for at in range(HORIZONS.size)]
            for text, error in errors.items()
        }
    return result


def print_errors(title: str, people: Sequence[dict[str, list[float]]]) -> None:
    """Medians over people of each method, and paired differences."""
    print(f"\n{title}: {len(people)} people, RMSE in mg/dl, median over people")
    others = [name for name in people[0] if name.startswith(OTHER)]
    for name in people[0]:
        cells = np.median([rmse[name] for rmse in people], axis=0)
        print(f"{name:28}" + "".join(f"{cell:8.1f}" for cell in cells))
    random = np.random.default_rng(0)
    for own, other in itertools.product(OWN[:2], others):
        texts = []
        for place, minutes in enumerate(HORIZONS_MIN):
            less = np.array([rmse[other][place] - rmse[own][place] for rmse in people])
            means = less[random.integers(0, less.size, (2000, less.size))].mean(axis=1)
            low, high = np.percentile(means, (2.5, 97.5))
            of = f"{int((less > 0).sum())} of {less.size}"
            texts.append(f"{minutes} min {of}, {less.mean():.1f} ({low:.1f} to {high:.1f})")
        print(f"{own} less than {other}: " + "; ".join(texts))


def main() -> int:
    """Forecast everybody, and print the medians over people and paired differences."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("place", type=Path, help="archive or folder of AZT1D")
    parser.add_argument("--model", action="append", help="model of GluPredKit; ridge if none is given")
    parser.add_argument("--json", type=Path, help="file for a line of JSON for each person")
    options = parser.parse_args()
    models = options.model or ["ridge"]
    warnings.simplefilter("ignore")  # of pandas, about assignments in GluPredKit
    people = []
    with tempfile.TemporaryDirectory() as unpacked:
        folder = options.place
        if folder.is_file():
            with zipfile.ZipFile(folder) as files:
                files.extractall(unpacked)
            folder = Path(unpacked)
        for path in sorted(folder.rglob("Subject *.csv"), key=lambda path: int(re.sub(r"\D", "", path.stem))):
            try:
                record = gridded_record(gl.read_record(path))
                if not record.carbs_g.any():
                    raise Refusal("it has no carbohydrate")
                people.append({"person": path.stem, **errors_of(record, models)})
            except Refusal as error:
                print(f"{path.stem} is left out: {error.problem}")
                continue
            print(json.dumps(people[-1]), flush=True)
            if options.json:
                with options.json.open("a") as file:
                    print(json.dumps(people[-1]), file=file)
    if not people:
        print(f"{options.place} has no file of a person of AZT1D")
        return 2
    for future in FUTURES:
        print_errors(f"Future {future}", [person[future] for person in people])
    for name in people[0]["fit_s"]:
        print(f"{name:28}{np.median([person['fit_s'][name] for person in people]):8.1f} s of a processor for a fit")
    return 0


if __name__ == "__main__":
    sys.exit(main())
