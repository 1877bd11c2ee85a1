"""Identification of the model that a controller is designed on, from a record."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from glucoloop._pytree import pytree, static
from glucoloop.arguments import checked, on_host
from glucoloop.identification import _check
from glucoloop.identification.impulse_response import cross_correlation, least_squares
from glucoloop.identification.laguerre import (
    laguerre_coefficients,
    laguerre_functions,
    laguerre_realisation,
    laguerre_sum,
)
from glucoloop.identification.meal_response import meal_columns, meal_impulse_response, meal_memory
from glucoloop.identification.record import Record
from glucoloop.identification.reliability import Reliability, doubts, reliability
from glucoloop.models.step_response import StepResponseModel, lagged_inputs
from glucoloop.refusal import Refusal

METHODS = ("csrs", "least-squares")
# Correlation between two past inputs, relative to the input's power, above which cross-correlation would
# count the answer to one as the answer to the other.
LARGEST_CORRELATION = 0.05


@pytree
class Identification:
    """A step-response model, and how it was obtained.

    Attributes
    ----------
    model : StepResponseModel
        The model, from the smoothed impulse response.
    impulse_response : Array, shape (M,)
        The estimate as the record gives it [mg/dl per mU/min].
    smoothed_impulse_response : Array, shape (M,)
        Laguerre projection of the estimate, or the estimate itself if none was asked for [mg/dl per mU/min].
    laguerre_coefficients : Array, shape (L,)
        Coefficients of the projection; empty if none was asked for [mg/dl per mU/min].
    laguerre_pole : float
        Pole of the projection.
    basal_insulin_mU_min : float
        Rate from which the insulin deviation was taken [mU/min].
    baseline_glucose_mg_dl : float
        Glucose at that rate [mg/dl].
    smoothing_residual_norm : float
        2-norm of the estimate minus its projection [mg/dl per mU/min].
    estimate_rms_mg_dl, model_rms_mg_dl : float
        Root mean square of the readings minus the prediction by the raw estimate, and by the model [mg/dl].
    meal_impulse_response : Array, shape (K,)
        Rise of glucose 1, 2, .. samples after a gram of carbohydrate; empty for a record without meals [mg/dl per g].
    reliability : Reliability
        Quality of the model according to the record.
    method : str
        Method of the estimation.
    """

    model: StepResponseModel
    impulse_response: Array
    smoothed_impulse_response: Array
    laguerre_coefficients: Array
    laguerre_pole: float
    basal_insulin_mU_min: float
    baseline_glucose_mg_dl: float
    smoothing_residual_norm: float
    estimate_rms_mg_dl: float
    model_rms_mg_dl: float
    meal_impulse_response: Array
    reliability: Reliability
    method: str = static()

    def doubts(self) -> tuple[str, ...]:
        """Reasons why no controller should be designed on the model, one sentence each; empty for a sound model."""
        return doubts(
            float(self.model.gain),
            self.reliability,
            basal_insulin_mU_min=self.basal_insulin_mU_min,
            glucose_mg_dl=self.baseline_glucose_mg_dl,
        )


@checked
@on_host("a least-squares fit and its checks are made with NumPy")
def identify_record(
    record: Record,
    method: str = "csrs",
    *,
    memory: int = 36,
    laguerre_pole: float = 0.84,
    laguerre_functions: int | None = 2,
    basal_insulin_mU_min: float | None = None,
    baseline_glucose_mg_dl: float | None = None,
    starts_at_rest: bool = True,
) -> Identification:
    """Estimate the impulse response from a record, smooth it, and sum it to a step-response model.

    Parameters
    ----------
    record : Record
        N samples of insulin and N + 1 readings.
    method : {"csrs", "least-squares"}
        Cross-correlation, for a record of pulses from `design_csrs` without meals that starts at rest; or least
        squares, for any input that excites the patient enough, with meals or without.
    memory : int
        M, the samples after which the patient's response has died out.
    laguerre_pole : float
        Pole of the Laguerre functions, between 0 and 1; `best_pole` finds one.
    laguerre_functions : int or None
        Number of Laguerre functions, from 1 to M; None leaves the estimate as it is.
    basal_insulin_mU_min : float, optional
        Rate before the record, from which deviations are taken [mU/min]. By default the record's median, which is the
        basal rate of a record of pulses.
    baseline_glucose_mg_dl : float, optional
        Steady glucose at that rate [mg/dl]. By default the mean reading for "csrs", as in the paper, where the
        estimate doesn't depend on it, and a value fitted along with the impulse response for "least-squares".
    starts_at_rest : bool
        Whether insulin was at the basal rate for the memory before the record, and nothing was eaten in the six hours
        before it. If not, least squares leaves out the first M readings, or those of six hours in a record with meals.

    Returns
    -------
    Identification
        Model, raw and smoothed impulse response, their residuals, and what the record says about their quality.

    Raises
    ------
    ValueError
        If the method is unknown, the record is too short, not finite or not of the kind that the method needs, or a
        setting is out of bounds.

    References
    ----------
    Parker, Doyle & Peppas 1999, section III.
    """
    if method not in METHODS:
        raise Refusal(f"Unknown identification method {method!r}: use one of {', '.join(map(repr, METHODS))}.")
    memory = _check.whole_number("The memory", memory, 1)
    _check.input_and_readings(record.insulin_mU_min, record.glucose_mg_dl)
    if np.ndim(record.glucose_mg_dl) != 1:
        raise Refusal(
            f"Readings of shape {np.shape(record.glucose_mg_dl)} are not one-dimensional: use one record at a time."
        )
    by_pulses = method == "csrs"
    meals = meal_columns(record)
    if by_pulses and not starts_at_rest:
        raise Refusal("Cross-correlation takes the record to start at rest: use method='least-squares'.")
    if by_pulses and meals.shape[1]:
        raise Refusal("Cross-correlation takes the patient to fast, but there are meals: use method='least-squares'.")
    if basal_insulin_mU_min is None:
        basal = _median_rate(record, by_pulses or not starts_at_rest)
    else:
        basal = _finite("basal insulin rate", basal_insulin_mU_min)
    insulin = jnp.asarray(record.insulin_mU_min, dtype=float) - basal
    glucose = jnp.asarray(record.glucose_mg_dl, dtype=float)
    if meals.shape[1] and not starts_at_rest:
        # What was eaten before the record is as unknown as what was infused, and acts for longer.
        unknown = max(0, meal_memory(record.sample_time_min) - memory)
        insulin, glucose, meals = insulin[unknown:], glucose[unknown:], meals[unknown:]
    if not insulin.any() or (not starts_at_rest and jnp.ptp(insulin) == 0):
        raise Refusal(
            "The insulin never leaves its basal rate, so the record shows no response to it: record again while it is "
            "moved up and down, as design_csrs does."
        )
    free_baseline = baseline_glucose_mg_dl is None
    offset = glucose.mean() if baseline_glucose_mg_dl is None else _finite("baseline glucose", baseline_glucose_mg_dl)

    basis = _basis(laguerre_pole, laguerre_functions, memory)
    if by_pulses:
        _refuse_correlated(np.asarray(insulin), memory)
        estimate = cross_correlation(insulin, glucose - offset, memory)
        coefficients = None if basis is None else laguerre_coefficients(estimate, laguerre_pole, basis.shape[0])
    else:

        def fit(rows: Array | None) -> Array:
            return least_squares(
                insulin,
                glucose - offset,
                memory,
                starts_at_rest=starts_at_rest,
                free_baseline=free_baseline,
                basis=rows,
                beside=meals,
            )

        estimate, coefficients = fit(None), None if basis is None else fit(basis)
    smoothed = estimate if basis is None or coefficients is None else basis.T @ coefficients
    network = None if coefficients is None else laguerre_realisation(coefficients, laguerre_pole, memory)
    model = StepResponseModel.from_impulse_response(smoothed, record.sample_time_min, realisation=network)

    first = 0 if starts_at_rest else memory
    past, readings, meals = lagged_inputs(insulin, memory)[first:], (glucose - offset)[first:], meals[first:]
    constant = jnp.ones((len(readings), int(free_baseline)))
    # Cross-correlation takes the mean reading for the baseline, as the paper does.
    beside = meals if by_pulses else jnp.concatenate([meals, constant], axis=1)
    left_by_estimate, _ = _left(readings - past @ estimate, beside)
    left_by_model, of_beside = _left(readings - model.predict(insulin)[first:], beside)
    sought = past if basis is None else past @ basis.T
    of_gain = np.ones(memory)
    if basis is not None:
        of_gain = np.full(basis.shape[0], laguerre_sum(laguerre_pole)) if network else np.asarray(basis.sum(axis=1))
    return Identification(
        model=model,
        impulse_response=estimate,
        smoothed_impulse_response=smoothed,
        laguerre_coefficients=jnp.zeros(0) if coefficients is None else coefficients,
        laguerre_pole=float(laguerre_pole),
        basal_insulin_mU_min=basal,
        baseline_glucose_mg_dl=float(offset + of_beside[meals.shape[1] :].sum()),
        smoothing_residual_norm=float(jnp.linalg.norm(estimate - smoothed)),
        estimate_rms_mg_dl=_rms(left_by_estimate),
        model_rms_mg_dl=_rms(left_by_model),
        meal_impulse_response=meal_impulse_response(of_beside[: meals.shape[1]], record.sample_time_min),
        reliability=reliability(
            np.concatenate([sought, meals, constant], axis=1),
            np.asarray(readings),
            np.append(of_gain, np.zeros(meals.shape[1] + free_baseline)),
        ),
        method=method,
    )


def _basis(pole: float, functions: int | None, memory: int) -> Array | None:
    """Rows in whose span the impulse response is sought; None if it is not smoothed."""
    return None if functions is None else laguerre_functions(pole, functions, memory)


def _left(readings: Array, columns: Array) -> tuple[Array, Array]:
    """Residuals of the readings after a fit of the columns, and the coefficients of the fit."""
    if not columns.shape[1]:
        return readings, jnp.zeros(0)
    coefficients = jnp.linalg.lstsq(columns, readings)[0]
    return readings - columns @ coefficients, coefficients


def _median_rate(record: Record, median_will_do: bool) -> float:
    levels = np.unique(np.asarray(record.insulin_mU_min))
    if len(levels) == 2 and not median_will_do:
        raise Refusal(
            f"The insulin has only the two levels {levels[0]:g} and {levels[1]:g} mU/min, so its median does not tell "
            "the basal rate before the record: give basal_insulin_mU_min, or starts_at_rest=False."
        )
    return float(np.median(np.asarray(record.insulin_mU_min)))


def _finite(name: str, value: float) -> float:
    if not np.isfinite(value) or value < 0:
        raise Refusal(f"The {name} is {value}: it must be a finite number of at least 0.")
    return float(value)


def _refuse_correlated(insulin: np.ndarray[tuple[int, ...], np.dtype[np.float64]], memory: int) -> None:
    """Refuse an input for which cross-correlation isn't the impulse response."""
    if len(insulin) < 2 * memory:
        raise Refusal(
            f"A record of {len(insulin)} samples is too short for cross-correlation over {memory} samples: at least "
            f"{2 * memory} are needed, for one pulse up and one down. Lengthen the record or shorten the memory."
        )
    power = float(insulin @ insulin)
    past = np.asarray(lagged_inputs(insulin, memory))
    correlation = np.abs(past.T @ past / power - np.eye(memory))
    worst = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    if correlation[worst] > LARGEST_CORRELATION:
        lag = abs(int(worst[0]) - int(worst[1]))
        what = f"is correlated with itself {lag} samples later" if lag else "moves too close to the end of the record"
        raise Refusal(
            f"The insulin {what} (by {correlation[worst]:.2g} of its power, at most {LARGEST_CORRELATION:g} will do), "
            "so cross-correlation would mistake one response for another: use method='least-squares'."
        )
    imbalance = abs(float(insulin.sum())) / float(np.abs(insulin).sum())
    if imbalance > LARGEST_CORRELATION:
        raise Refusal(
            f"The insulin deviates up and down unequally (by {imbalance:.2g} of its total, at most "
            f"{LARGEST_CORRELATION:g} will do), so the baseline would leak into the response: give the basal rate, or "
            "use method='least-squares'."
        )


def _rms(residuals: Array) -> float:
    return float(jnp.sqrt(jnp.mean(residuals**2)))
