"""The tunings of Parker, Doyle and Peppas (1999), and the choices that the paper leaves open.

Horizons, weights and reference filters are printed in the captions of Fig. 4 and 5 and in Sec. IV to VI. The
entries of the process noise are not legible: the paper says that those of the glucose and glucagon states are raised
without noise and that all are below 1 with it. The values here are our reading, one per operating point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from glucoloop.control.settings import MPCTuning, StateTuning
from glucoloop.control.tuning import NOISE_FREE, NOISY

IMC_FILTER_MIN: Final = 1.0
IMC_DELAY_MIN: Final = 5.0
IMC_STEP_MU_MIN: Final = 11.165
"""Half the nominal rate: the step on which the first-order model is fitted."""


@dataclass(frozen=True)
class PaperTuning:
    """Tuning of the paper's controllers in one setting."""

    mpc: MPCTuning
    mpc_se: StateTuning
    nlqdmc_se: StateTuning
    glucose_noise: float
    """Process noise of each glucose state, (mg/dl)^2 per sample."""
    other_noise: float
    """Process noise of the insulin states and the slow insulin effects."""
    glucagon_noise: float
    """Process noise of glucagon and its slow effect."""

    @property
    def noise(self) -> tuple[float, float, float]:
        """The three variances, as `patients.capabilities.process_noise` takes them."""
        return self.glucose_noise, self.other_noise, self.glucagon_noise


def _tuning(reference_start: int, noisy: bool, noise: tuple[float, float, float]) -> PaperTuning:
    glucose, other, glucagon = noise
    return PaperTuning(
        mpc=NOISY if noisy else NOISE_FREE,
        mpc_se=StateTuning(2, 8 if noisy else 7, 1.0, 1.0 if noisy else 0.0, 0.65, reference_start),
        # The paper shows NLQDMC/SE without noise only; with noise it is detuned here as MPC/SE is.
        nlqdmc_se=StateTuning(2, 6 if noisy else 5, 1.0, 1.0 if noisy else 0.0, 0.57, reference_start),
        glucose_noise=glucose,
        other_noise=other,
        glucagon_noise=glucagon,
    )


PARKER_1999: Final = {
    ("setpoint-81", False): _tuning(1, False, (30.0, 0.1, 10.0)),
    ("setpoint-81", True): _tuning(1, True, (0.9, 0.01, 0.005)),
    ("nominal-22", False): _tuning(0, False, (10.0, 0.01, 0.1)),
    ("nominal-22", True): _tuning(0, True, (0.9, 0.01, 0.003)),
    ("fasting-81", False): _tuning(0, False, (10.0, 0.01, 0.1)),
    ("fasting-81", True): _tuning(0, True, (0.3, 0.1, 0.03)),
}
"""Tunings by operating point, and by whether readings are noisy."""
