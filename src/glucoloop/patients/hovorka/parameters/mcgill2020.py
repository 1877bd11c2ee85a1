"""Constants of Wilinska et al. (2010) with those of glucagon, as the McGill Diabetes Lab has them.

References
----------
McGill Diabetes Lab, "Artificial Pancreas Simulator", 2020: patientOriginal of the class HovorkaPatient.
"""

from __future__ import annotations

from typing import Final

from glucoloop.patients.hovorka.glucagon import GlucagonParameters
from glucoloop.patients.hovorka.parameters.wilinska2010 import CONSTANTS as OF_INSULIN
from glucoloop.patients.provenance import Constant

MCGILL: Final = "McGill Diabetes Lab 2020, Artificial Pancreas Simulator, patientOriginal"

CONSTANTS: Final = (
    *OF_INSULIN,
    Constant("tau_N", 19.0, "min", "time to the maximum of glucagon absorption", MCGILL),
    Constant("MCR_N", 0.012, "l/kg/min", "clearance of glucagon", MCGILL),
    Constant("S_N", 0.0012, "ml/pg", "sensitivity of glucose production to glucagon", MCGILL),
)

MCGILL_2020: Final = GlucagonParameters(**{constant.name: constant.value for constant in CONSTANTS})
