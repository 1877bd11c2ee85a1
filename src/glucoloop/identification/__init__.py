"""Identification: from a record of insulin and glucose to the linear model a controller is designed on.

Everywhere an input has N samples, each held over one sample time, and comes with N + 1 readings, one at either end of
each sample; deviations are taken from a steady state.
"""

from glucoloop.identification.basis import Basis
from glucoloop.identification.fopdt import FirstOrderModel, fit_first_order
from glucoloop.identification.identify import METHODS, Identification, bases_given, chosen_basis, identify_record
from glucoloop.identification.impulse_response import cross_correlation, least_squares
from glucoloop.identification.laguerre import (
    PoleSearch,
    best_pole,
    laguerre_coefficients,
    laguerre_functions,
    laguerre_realisation,
    laguerre_smooth,
)
from glucoloop.identification.meal_response import meal_answer
from glucoloop.identification.record import Record, record_from_samples
from glucoloop.identification.reliability import Reliability, doubts
from glucoloop.identification.subcutaneous_response import filtered_input, subcutaneous_coefficients
from glucoloop.identification.validation import Validation, design_csrs, random_binary_sequence, validate

__all__ = [
    "METHODS",
    "Basis",
    "FirstOrderModel",
    "Identification",
    "PoleSearch",
    "Record",
    "Reliability",
    "Validation",
    "bases_given",
    "best_pole",
    "chosen_basis",
    "cross_correlation",
    "design_csrs",
    "doubts",
    "filtered_input",
    "fit_first_order",
    "identify_record",
    "laguerre_coefficients",
    "laguerre_functions",
    "laguerre_realisation",
    "laguerre_smooth",
    "least_squares",
    "meal_answer",
    "random_binary_sequence",
    "record_from_samples",
    "subcutaneous_coefficients",
    "validate",
]
