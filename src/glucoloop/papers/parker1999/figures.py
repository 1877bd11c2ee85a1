"""Figures of the paper's results, in its layout."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Final

import numpy as np

from glucoloop.papers.parker1999.experiments import PointResults
from glucoloop.report import plot, plot_identification, plot_validation
from glucoloop.report.surface import plot_surface
from glucoloop.tuning.paper import printed_tuning

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NAMES: Final = {"mpc": "linear MPC", "mpc-se": "MPC/SE", "nlqdmc-se": "NLQDMC/SE", "imc": "IMC with filter"}

CAPTIONS: Final = {
    "figure-2": (
        "Fig. 2. Impulse response from a noisy record: as estimated, projected on two Laguerre functions, and free of "
        "noise."
    ),
    "figure-3": "Fig. 3. Validation of the Laguerre model by a random binary sequence.",
    "figure-4": "Fig. 4. 50 g of glucose at 50 min, readings with noise of variance 1.45: linear MPC and MPC/SE.",
    "figure-5": "Fig. 5. 50 g of glucose at 50 min without noise: four controllers.",
    "figure-6": "Fig. 6. Linear MPC with dead times that it does not know of, readings with noise of variance 1.45.",
    "tuning-mpc": "Sum of squared errors of linear MPC over its tunings, without noise.",
    "tuning-mpc-se": "Sum of squared errors of MPC/SE over its tunings, without noise.",
    "tuning-nlqdmc-se": "Sum of squared errors of NLQDMC/SE over its tunings, without noise.",
}


def draw(study: PointResults, names: Collection[str] | None = None) -> dict[str, Figure]:
    """Figures of one operating point, by name: those whose experiments were carried out, or the named ones."""
    made = {**_of_model(study), **_of_runs(study)}
    for name, surface in study.tuning.items():
        printed = printed_tuning(study.operating_point, name)
        made[f"tuning-{name}"] = functools.partial(plot_surface, surface, printed=printed)
    return {name: drawn() for name, drawn in made.items() if names is None or name in names}


def _of_model(study: PointResults) -> dict[str, Callable[[], Figure]]:
    if study.model is None:
        return {}
    model = study.model
    insulin = np.asarray(model.validation_record.insulin_mU_min) - float(study.patient.basal_insulin_mU_min)
    return {
        "figure-2": lambda: plot_identification(model.noisy, truth=model.noise_free.impulse_response),
        "figure-3": lambda: plot_validation(
            model.validation,
            sample_time_min=model.noisy.model.sample_time_min,
            insulin_deviation_mU_min=insulin,
            width="double",
        ),
    }


def _of_runs(study: PointResults) -> dict[str, Callable[[], Figure]]:
    noisy = {run: loops.example for run, loops in study.with_noise.items()}
    quiet = {name: loops.example for name, loops in study.without_noise.items()}
    with_noise = {_NAMES[name]: noisy[name, "0"] for name in ("mpc", "mpc-se") if (name, "0") in noisy}
    unknown = {f"{time} min": trace for (name, time), trace in noisy.items() if name == "mpc" and "M" not in time}
    without_noise = {_NAMES[name]: quiet[name] for name in ("mpc", "mpc-se", "nlqdmc-se", "imc") if name in quiet}
    traces = {"figure-4": with_noise, "figure-5": without_noise, "figure-6": unknown}
    return {name: functools.partial(plot, shown) for name, shown in traces.items() if shown}
