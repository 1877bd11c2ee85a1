"""The figures of the paper's results, in its layout."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from glucoloop.papers.parker1999.experiments import Study
from glucoloop.report import plot, plot_identification, plot_validation
from glucoloop.report.surface import plot_surface
from glucoloop.trials.tuning import printed_tuning

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


def draw(study: Study) -> dict[str, Figure]:
    """All figures of one operating point, by name."""
    model = study.model
    insulin = np.asarray(model.validation_record.insulin_mU_min) - float(study.patient.basal_insulin_mU_min)
    noisy = {key: loops.example for key, loops in study.with_noise.items()}
    quiet = {name: loops.example for name, loops in study.without_noise.items()}
    unknown = [dead_time for name, dead_time in noisy if name == "mpc" and not dead_time.endswith("M")]
    surfaces = {
        f"tuning-{name}": plot_surface(surface, printed=printed_tuning(study.operating_point, name))
        for name, surface in study.tuning.items()
    }
    return {
        "figure-2": plot_identification(model.noisy, truth=model.noise_free.impulse_response),
        "figure-3": plot_validation(
            model.validation,
            sample_time_min=model.noisy.model.sample_time_min,
            insulin_deviation_mU_min=insulin,
            width="double",
        ),
        "figure-4": plot({_NAMES[name]: noisy[name, "0"] for name in ("mpc", "mpc-se")}),
        "figure-5": plot({_NAMES[name]: quiet[name] for name in ("mpc", "mpc-se", "nlqdmc-se", "imc")}),
        "figure-6": plot({f"{minutes} min": noisy["mpc", minutes] for minutes in unknown}),
        **surfaces,
    }
