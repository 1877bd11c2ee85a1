"""From a record to the model that a controller is designed on."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from glucoloop._pytree import pytree, static
from glucoloop.identification import _check
from glucoloop.identification.impulse_response import cross_correlation, least_squares
from glucoloop.identification.laguerre import laguerre_coefficients, laguerre_functions
from glucoloop.identification.record import Record
from glucoloop.models.step_response import StepResponseModel, lagged_inputs

METHODS = ("csrs", "least-squares")
# Correlation between two past inputs, relative to the input's power, above which cross-correlation would
# count the answer to one as the answer to the other.
LARGEST_CORRELATION = 0.05


@pytree
class Identification:
    """A step-response model, and how it came about.

    Attributes
    ----------
    model : StepResponseModel
        The model, from the smoothed impulse response.
    impulse_response : Array, shape (M,)
        The estimate as the record gives it [mg/dl per mU/min].
    smoothed_impulse_response : Array, shape (M,)
        Its Laguerre projection, or the estimate itself if none was asked for [mg/dl per mU/min].
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
    method : str
        How the impulse response was estimated.
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
    method: str = static()


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
        Cross-correlation, for a record of pulses from `design_csrs` that starts at rest; or least squares, for any
        input that excites the patient enough.
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
        Whether insulin was at the basal rate for the memory before the record. If not, least squares leaves out the
        first M readings.

    Returns
    -------
    Identification
        Model, raw and smoothed impulse response, and their residuals.

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
        raise ValueError(f"Unknown identification method {method!r}: use one of {', '.join(map(repr, METHODS))}.")
    memory = _check.whole_number("The memory", memory, 1)
    _check.input_and_readings(record.insulin_mU_min, record.glucose_mg_dl)
    if np.ndim(record.glucose_mg_dl) != 1:
        raise ValueError(
            f"Readings of shape {np.shape(record.glucose_mg_dl)} are not one-dimensional: use one record at a time."
        )
    by_pulses = method == "csrs"
    if by_pulses and not starts_at_rest:
        raise ValueError("Cross-correlation takes the record to start at rest: use method='least-squares'.")
    if basal_insulin_mU_min is None:
        basal = _median_rate(record, by_pulses or not starts_at_rest)
    else:
        basal = _finite("basal insulin rate", basal_insulin_mU_min)
    insulin = jnp.asarray(record.insulin_mU_min, dtype=float) - basal
    glucose = jnp.asarray(record.glucose_mg_dl, dtype=float)
    offset = glucose.mean() if baseline_glucose_mg_dl is None else _finite("baseline glucose", baseline_glucose_mg_dl)

    if by_pulses:
        _refuse_correlated(np.asarray(insulin), memory)
        estimate = cross_correlation(insulin, glucose - offset, memory)
    else:
        estimate = least_squares(
            insulin,
            glucose - offset,
            memory,
            starts_at_rest=starts_at_rest,
            free_baseline=baseline_glucose_mg_dl is None,
        )
    coefficients, smoothed = _smooth(estimate, laguerre_pole, laguerre_functions)

    first = 0 if starts_at_rest else memory
    past = lagged_inputs(insulin, memory)[first:]
    left = glucose[first:] - past @ estimate
    baseline = offset if by_pulses or baseline_glucose_mg_dl is not None else left.mean()
    return Identification(
        model=StepResponseModel.from_impulse_response(smoothed, record.sample_time_min),
        impulse_response=estimate,
        smoothed_impulse_response=smoothed,
        laguerre_coefficients=coefficients,
        laguerre_pole=float(laguerre_pole),
        basal_insulin_mU_min=basal,
        baseline_glucose_mg_dl=float(baseline),
        smoothing_residual_norm=float(jnp.linalg.norm(estimate - smoothed)),
        estimate_rms_mg_dl=_rms(left - baseline),
        model_rms_mg_dl=_rms(glucose[first:] - past @ smoothed - baseline),
        method=method,
    )


def _smooth(estimate: Array, pole: float, functions: int | None) -> tuple[Array, Array]:
    """Laguerre coefficients and projection of an estimate, or none and the estimate itself."""
    if functions is None:
        return jnp.zeros(0), estimate
    coefficients = laguerre_coefficients(estimate, pole, functions)
    return coefficients, laguerre_functions(pole, functions, len(estimate)).T @ coefficients


def _median_rate(record: Record, median_will_do: bool) -> float:
    levels = np.unique(np.asarray(record.insulin_mU_min))
    if len(levels) == 2 and not median_will_do:
        raise ValueError(
            f"The insulin has only the two levels {levels[0]:g} and {levels[1]:g} mU/min, so its median does not tell "
            "the basal rate before the record: give basal_insulin_mU_min, or starts_at_rest=False."
        )
    return float(np.median(np.asarray(record.insulin_mU_min)))


def _finite(name: str, value: float) -> float:
    if not np.isfinite(value) or value < 0:
        raise ValueError(f"The {name} is {value}: it must be a finite number of at least 0.")
    return float(value)


def _refuse_correlated(insulin: np.ndarray[tuple[int, ...], np.dtype[np.float64]], memory: int) -> None:
    """Refuse an input for which cross-correlation isn't the impulse response."""
    if len(insulin) < 2 * memory:
        raise ValueError(
            f"A record of {len(insulin)} samples is too short for cross-correlation over {memory} samples: at least "
            f"{2 * memory} are needed, for one pulse up and one down. Lengthen the record or shorten the memory."
        )
    power = float(insulin @ insulin)
    if power == 0:
        raise ValueError("The insulin never leaves its basal rate, so it shows no response: use design_csrs.")
    past = np.asarray(lagged_inputs(insulin, memory))
    correlation = np.abs(past.T @ past / power - np.eye(memory))
    worst = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    if correlation[worst] > LARGEST_CORRELATION:
        lag = abs(int(worst[0]) - int(worst[1]))
        what = f"is correlated with itself {lag} samples later" if lag else "moves too close to the end of the record"
        raise ValueError(
            f"The insulin {what} (by {correlation[worst]:.2g} of its power, at most {LARGEST_CORRELATION:g} will do), "
            "so cross-correlation would mistake one response for another: use method='least-squares'."
        )
    imbalance = abs(float(insulin.sum())) / float(np.abs(insulin).sum())
    if imbalance > LARGEST_CORRELATION:
        raise ValueError(
            f"The insulin deviates up and down unequally (by {imbalance:.2g} of its total, at most "
            f"{LARGEST_CORRELATION:g} will do), so the baseline would leak into the response: give the basal rate, or "
            "use method='least-squares'."
        )


def _rms(residuals: Array) -> float:
    return float(jnp.sqrt(jnp.mean(residuals**2)))
