"""Figures of the paper's results, in its layout."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Final

import numpy as np

from glucoloop.papers.parker1999.experiments import NOISE_FREE, PointResults
from glucoloop.report import plot, plot_identification, plot_validation
from glucoloop.report.surface import plot_surface
from glucoloop.tuning.search import printed_tuning

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


def draw(study: PointResults, names: Collection[str]) -> dict[str, Figure]:
    """The named figures of an operating point, apart from those whose experiments were not carried out."""
    figures: dict[str, Callable[[], Figure]] = {}
    if study.model is not None:
        model = study.model
        insulin = np.asarray(model.validation_record.insulin_mU_min) - float(study.patient.basal_insulin_mU_min)
        figures["figure-2"] = lambda: plot_identification(model.noisy, truth=model.noise_free.impulse_response)
        figures["figure-3"] = lambda: plot_validation(
            model.validation,
            sample_time_min=model.noisy.model.sample_time_min,
            insulin_deviation_mU_min=insulin,
            width="double",
        )
    traces = {run: loops.example for run, loops in study.runs.items()}
    loops_of = {
        "figure-4": {_NAMES[name]: traces[name, "0"] for name in _NAMES if (name, "0") in traces},
        "figure-5": {_NAMES[name]: traces[name, NOISE_FREE] for name in _NAMES if (name, NOISE_FREE) in traces},
        "figure-6": {
            f"{time} min": trace for (name, time), trace in traces.items() if name == "mpc" and time.isdigit()
        },
    }
    figures |= {name: functools.partial(plot, loops) for name, loops in loops_of.items() if loops}
    for name, surface in study.tuning.items():
        printed = printed_tuning(study.operating_point, name)
        figures[f"tuning-{name}"] = functools.partial(plot_surface, surface, printed=printed)
    return {name: drawn() for name, drawn in figures.items() if name in names}
