"""Choices where the paper is open or illegible: settings, never hidden constants."""

from __future__ import annotations

from typing import Final

READINGS: Final[dict[str, str]] = {
    "patient": (
        "The equations and constants of the 19-state patient are not printed; they are those of Sorensen (1985) as "
        "printed by Parker et al. (2000), in a self-consistent set."
    ),
    "operating-point": (
        "The paper states 22.33 mU/min and 81 mg/dl. With the published references, those of a person with a fasting "
        "glucose of 91.89 mg/dl, no infusion gives both: setpoint-81 keeps the glucose (81.1 mg/dl, 25.606 mU/min), "
        "nominal-22 the insulin (22.33 mU/min, 92.099 mg/dl). fasting-81 has the references of a person with a fasting "
        "glucose of 81 mg/dl, which follow from the balances, and keeps both (22.33 mU/min, 81.153 mg/dl)."
    ),
    "meal": "50 g of glucose at 50 min by the model of Lehmann and Deutsch (1992), not told to any controller.",
    "pump-limits": "0 to 66.9 mU/min, three times the nominal rate, and 16.7 mU/min per sample, a quarter of that.",
    "noise": "Each reading carries independent normal noise of variance 1.45 (mg/dl)^2, clipped to 5 mg/dl.",
    "noise-free-record": "Linear MPC is designed on the Laguerre model of a record without noise, one pulse each way.",
    "noisy-record": "Each seed identifies its own model, from a record with the same noise, for linear MPC.",
    "two-functions": "Two Laguerre functions, with which the best pole is nearest the printed one.",
    "binary-sequence": "A binary sequence of a tenth of the basal rate over 100 samples, answered without noise.",
    "free-dead-time": "First order with a dead time that is fitted too, to a step of 0.01 mU/min over 180 min.",
    "imc-design": (
        "First order with a dead time of 5 min, fitted to a step of 11.165 mU/min over 600 min; filter of 1 min."
    ),
    "process-noise": (
        "The entries of Q are illegible: 30, 0.1 and 10 for the glucose, other and glucagon states at setpoint-81 and "
        "10, 0.01 and 0.1 at nominal-22 and fasting-81; with noise 0.9, 0.01 and 0.005 at setpoint-81, 0.9, 0.01 and "
        "0.003 at nominal-22, and 0.3, 0.1 and 0.03 at fasting-81."
    ),
    "held-innovation": "The correction by the Kalman filter is repeated at each sample ahead, as in Ricker (1990).",
    "reference-start": (
        "The filtered reference starts at this sample at nominal-22 and fasting-81, and at the next at setpoint-81."
    ),
    "band-2": "Settled when within 2 % of the setpoint, counted from the meal; 551+ when not before the end.",
    "band-5": "Settled when within 5 % of the setpoint, counted from the meal; 551+ when not before the end.",
    "shifted-model": (
        "A known dead time shifts the identified step response and lengthens the horizon. Models identified anew from "
        "delayed records, as the paper does, are given beside."
    ),
    "zero-rows": "A known dead time puts rows of zeros into the dynamic matrix and lengthens the horizon.",
    "bound-in-the-median": "Violated where more than half of the runs break one of (17)-(19).",
    "search-grid": (
        "m from 1 to 4, p from m to 14, phi_r from .3 to .8; runs that oscillate or break a bound are left out."
    ),
}
