"""Identification of the model that a controller is designed on, from a record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from glucoloop._pytree import pytree, static
from glucoloop._representation import represented
from glucoloop.arguments import checked, on_host
from glucoloop.identification import _check
from glucoloop.identification.basis import Basis, candidates, chosen
from glucoloop.identification.gain_interval import gain_interval
from glucoloop.identification.impulse_response import cross_correlation, least_squares
from glucoloop.identification.laguerre import laguerre_coefficients, laguerre_realisation
from glucoloop.identification.meal_response import meal_columns, meal_impulse_response, meal_memory
from glucoloop.identification.record import Record
from glucoloop.identification.reliability import Reliability, doubts, reliability
from glucoloop.identification.subcutaneous_response import filtered_input, subcutaneous_basis, subcutaneous_coefficients
from glucoloop.models.step_response import StepResponseModel, lagged_inputs
from glucoloop.refusal import Refusal

Floats = npt.NDArray[np.float64]

METHODS = ("csrs", "least-squares")
USUAL: Final = "usual"
"""Number of Laguerre functions that goes with the record."""
# Correlation between two past inputs, relative to the input's power, above which cross-correlation would
# count the answer to one as the answer to the other.
LARGEST_CORRELATION = 0.05


@represented
@pytree
class Identification:
    """A step-response model from the smoothed impulse response, and how it was obtained."""

    model: StepResponseModel
    impulse_response: Array
    """``(M,)``, the estimate as the record gives it [mg/dl per mU/min]."""
    smoothed_impulse_response: Array
    """``(M,)``, Laguerre projection of the estimate, or the estimate if none was asked for [mg/dl per mU/min]."""
    laguerre_coefficients: Array
    """``(L,)``, coefficients of the projection; empty if none was asked for [mg/dl per mU/min]."""
    laguerre_pole: float
    basal_insulin_mU_min: float
    """Rate from which the insulin deviation was taken."""
    baseline_glucose_mg_dl: float
    """Glucose at that rate."""
    smoothing_residual_norm: float
    """2-norm of the estimate minus its projection [mg/dl per mU/min]."""
    estimate_rms_mg_dl: float
    model_rms_mg_dl: float
    """Root mean square of the readings minus the prediction by the model; before, by the raw estimate."""
    meal_impulse_response: Array
    """``(K,)``, rise of glucose 1, 2, .. samples after a gram eaten [mg/dl per g]; empty for a record without meals."""
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
    memory: int | None = None,
    laguerre_pole: float | None = None,
    laguerre_functions: int | str | None = USUAL,
    subcutaneous: bool | None = None,
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
        Cross-correlation, for a record of pulses from `design_csrs` without meals that starts at steady state; or
        least squares, for any input that excites the patient enough, with meals or without.
    memory : int, optional
        M, the samples after which the patient's response has died out.
    laguerre_pole : float, optional
        Pole of the Laguerre functions, between 0 and 1; `best_pole` finds one.
    laguerre_functions : int, None or "usual"
        Number of Laguerre functions, from 1 to M; None leaves the estimate as it is.
    subcutaneous : bool, optional
        Whether insulin is given subcutaneously, so that its response begins at 0 with a slope of 0 and is never above
        0; see `identification.subcutaneous_response`.
    basal_insulin_mU_min : float, optional
        Rate before the record, from which deviations are taken [mU/min]. By default the record's median, which is the
        basal rate of a record of pulses.
    baseline_glucose_mg_dl : float, optional
        Steady glucose at that rate [mg/dl]. By default the mean reading for "csrs", as in the paper, where the
        estimate doesn't depend on it, and a value fitted along with the impulse response for "least-squares".
    starts_at_rest : bool
        Whether insulin was at the basal rate for the memory before the record, and nothing was eaten in the six hours
        before it. If not, least squares leaves out the first M readings, or those of six hours in a record with meals.

    Notes
    -----
    Memory, pole, functions and route that are not given are the paper's for "csrs": 3 hours, .84 at 5-min samples, 2,
    and intravenous insulin. For "least-squares" they are chosen by how well readings left out of the fit are predicted,
    see `identification.basis`.

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
    if memory is not None:
        memory = _check.whole_number("The memory", memory, 1)
    _check.input_and_readings(record.insulin_mU_min, record.glucose_mg_dl)
    if np.ndim(record.glucose_mg_dl) != 1:
        raise Refusal(
            f"Readings of shape {np.shape(record.glucose_mg_dl)} are not one-dimensional: use one record at a time."
        )
    by_pulses = method == "csrs"
    meals = np.asarray(meal_columns(record))
    if by_pulses and not starts_at_rest:
        raise Refusal("Cross-correlation takes the record to start at steady state: use method='least-squares'.")
    if by_pulses and meals.shape[1]:
        raise Refusal("Cross-correlation takes the patient to fast, but there are meals: use method='least-squares'.")
    if basal_insulin_mU_min is None:
        basal = _median_rate(record, by_pulses or not starts_at_rest)
    else:
        basal = _finite("basal insulin rate", basal_insulin_mU_min)
    insulin = np.asarray(record.insulin_mU_min, dtype=float) - basal
    glucose = np.asarray(record.glucose_mg_dl, dtype=float)
    if not insulin.any() or (not starts_at_rest and np.ptp(insulin) == 0):
        raise Refusal(
            "The insulin never leaves its basal rate, so the record shows no response to it: record again while it is "
            "moved up and down, as design_csrs does."
        )
    bases = bases_given(record, method, memory, laguerre_pole, laguerre_functions, subcutaneous)
    basis = chosen_basis(record, bases, basal_insulin_mU_min=basal, starts_at_rest=starts_at_rest)
    memory, pole = basis.memory, float(basis.pole)
    if meals.shape[1] and not starts_at_rest:
        # What was eaten before the record is as unknown as what was infused, and acts for longer.
        unknown = max(0, meal_memory(record.sample_time_min) - memory)
        insulin, glucose, meals = insulin[unknown:], glucose[unknown:], meals[unknown:]
    free_baseline = baseline_glucose_mg_dl is None
    offset = glucose.mean() if baseline_glucose_mg_dl is None else _finite("baseline glucose", baseline_glucose_mg_dl)

    functions = basis.rows()
    rows = None if functions is None else np.asarray(functions)
    in_skin = rows is not None and basis.subcutaneous
    coefficients: Floats | None = None
    if by_pulses:
        _refuse_correlated(insulin, memory)
        estimate = np.asarray(cross_correlation(insulin, glucose - offset, memory))
        if rows is not None and not in_skin:
            coefficients = np.asarray(laguerre_coefficients(estimate, pole, rows.shape[0]))
    else:

        def fit(rows: Floats | None) -> Floats:
            coefficients = least_squares(
                insulin,
                glucose - offset,
                memory,
                starts_at_rest=starts_at_rest,
                free_baseline=free_baseline,
                basis=rows,
                beside=meals,
            )
            return np.asarray(coefficients)

        estimate, coefficients = fit(None), None if rows is None else fit(rows)

    first = 0 if starts_at_rest else memory
    past = np.asarray(lagged_inputs(insulin, memory))[first:]
    readings, meals = (glucose - offset)[first:], meals[first:]
    constant = np.ones((len(readings), int(free_baseline)))
    # Cross-correlation takes the mean reading for the baseline, as the paper does.
    other_inputs = meals if by_pulses and not in_skin else np.concatenate([meals, constant], axis=1)
    sought = past
    if rows is not None:
        endless = laguerre_realisation(np.ones(rows.shape[0]), pole, memory) is not None
        sought = past @ rows.T
        if starts_at_rest and endless and not (by_pulses and not in_skin):
            sought = filtered_input(insulin, pole, rows.shape[0])
            _, coefficients = _left(_left(readings, other_inputs)[0], _left(sought, other_inputs)[0])
    if rows is not None and in_skin:
        columns, left = (_left(part, other_inputs)[0] for part in (sought, readings))
        coefficients = subcutaneous_coefficients(columns, left, pole, rows.shape[0], memory)
        sought = sought @ subcutaneous_basis(pole, rows.shape[0], memory)
    smoothed = estimate if rows is None or coefficients is None else rows.T @ coefficients
    network = None if coefficients is None else laguerre_realisation(coefficients, pole, memory)
    model = StepResponseModel.from_impulse_response(smoothed, record.sample_time_min, realisation=network)

    interval = gain_interval(
        insulin,
        readings,
        meals,
        sample_time_min=record.sample_time_min,
        gain_scale=_gain_scale(record),
        starts_at_rest=starts_at_rest,
    )
    columns = np.concatenate([sought, meals, constant], axis=1)

    left_by_estimate, _ = _left(readings - past @ estimate, other_inputs)
    moved = np.asarray(model.predict(insulin))[first:]
    left_by_model, of_other_inputs = _left(readings - moved, other_inputs)
    baseline = float(offset + of_other_inputs[meals.shape[1] :].sum())
    moved_percent = None if meals.shape[1] or not baseline > 0.0 else 100.0 * float(np.abs(moved).max()) / baseline
    return Identification(
        model=model,
        impulse_response=jnp.asarray(estimate),
        smoothed_impulse_response=jnp.asarray(smoothed),
        laguerre_coefficients=jnp.asarray(np.zeros(0) if coefficients is None else coefficients),
        laguerre_pole=pole,
        basal_insulin_mU_min=basal,
        baseline_glucose_mg_dl=baseline,
        smoothing_residual_norm=float(np.linalg.norm(estimate - smoothed)),
        estimate_rms_mg_dl=_rms(left_by_estimate),
        model_rms_mg_dl=_rms(left_by_model),
        meal_impulse_response=meal_impulse_response(
            jnp.asarray(of_other_inputs[: meals.shape[1]]), record.sample_time_min
        ),
        reliability=reliability(columns, readings, interval, moved_percent),
        method=method,
    )


def bases_given(
    record: Record, method: str, memory: int | None, pole: float | None, functions: int | str | None, skin: bool | None
) -> tuple[Basis, ...]:
    """Bases that have the given values, the default ones in place of what is not given; for "csrs" one alone."""
    given = {"memory": memory, "pole": pole, "subcutaneous": skin}
    values: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if functions != USUAL:
        values["functions"] = functions
    bases = candidates(record.sample_time_min, values)
    return bases[:1] if method == "csrs" else bases


def chosen_basis(
    record: Record,
    bases: Sequence[Basis],
    *,
    basal_insulin_mU_min: float | None = None,
    starts_at_rest: bool = True,
) -> Basis:
    """The basis in which readings left out of the fit are predicted best, or the first if it is about as good.

    Other arguments are those of `identify_record`; the usual basis comes first.
    """
    basal = np.median(np.asarray(record.insulin_mU_min)) if basal_insulin_mU_min is None else basal_insulin_mU_min
    insulin, glucose = np.asarray(record.insulin_mU_min, float) - basal, np.asarray(record.glucose_mg_dl, float)
    meals = np.asarray(meal_columns(record))
    first = 0
    if not starts_at_rest:
        memories = [basis.memory for basis in bases if 2 * basis.memory <= insulin.size]
        first = max([bases[0].memory, *memories, meal_memory(record.sample_time_min) if meals.shape[1] else 0])

    def regression(basis: Basis) -> tuple[Floats, Floats]:
        if basis.functions is None:
            columns = np.asarray(lagged_inputs(insulin, basis.memory))
        elif starts_at_rest:
            columns = filtered_input(insulin, basis.pole, basis.functions)
        else:
            columns = np.asarray(lagged_inputs(insulin, basis.memory) @ basis.rows().T)
        if basis.functions is not None and basis.subcutaneous:
            columns = columns @ subcutaneous_basis(basis.pole, basis.functions, basis.memory)
        return np.concatenate([columns, meals, np.ones((glucose.size, 1))], axis=1)[first:], glucose[first:]

    return chosen(bases, regression, insulin.size)


def _left(readings: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """Residuals of the readings after a fit of the columns, and the coefficients of the fit."""
    if not columns.shape[1]:
        return readings, np.zeros(0)
    coefficients = np.asarray(np.linalg.lstsq(columns, readings)[0], np.float64)
    return readings - columns @ coefficients, coefficients


def _gain_scale(record: Record) -> float:
    """Mean glucose for the mean rate of insulin, at least 1 mg/dl of glucose."""
    glucose, insulin = np.asarray(record.glucose_mg_dl), np.asarray(record.insulin_mU_min)
    return float(max(abs(glucose.mean()), 1.0) / np.abs(insulin).mean())


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


def _rms(residuals: Floats) -> float:
    return float(np.sqrt(np.mean(residuals**2)))
