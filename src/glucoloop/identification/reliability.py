"""Reliability of an identified gain, by the delete-block jackknife and cross-validation.

The readings are divided into contiguous blocks. The response is fitted again without each block in turn; how the gain
differs from fit to fit gives its standard error, and how well each fit predicts the block that it has not seen gives
the variance explained. Blocks, not single readings, are left out because what a model leaves of glucose is correlated
over hours (meals that nobody wrote down, exercise, drift), so that the usual standard errors are far too small.

The jackknife tells how a fit varies, not what its functions cannot say: those that end too early give a gain that is
too small, and always the same. So the response is fitted again with one function beside those of the fit that is twice
as slow, and the margin reaches the end of the interval of that gain, as in the bias-corrected intervals of Calonico,
Cattaneo and Titiunik (2014). It reaches further where the record lets still slower functions stand, beside those of the
fit or in their place: the record does not say where the response ends, or says that it ends later.

H. R. Künsch, "The jackknife and the bootstrap for general stationary observations", Ann. Statist. 17(3), 1217-1241,
1989. S. Calonico, M. D. Cattaneo, R. Titiunik, "Robust nonparametric confidence intervals for regression-discontinuity
designs", Econometrica 82(6), 2295-2326, 2014. A gain margin of 2: S. Skogestad, I. Postlethwaite, Multivariable
Feedback Control, 2nd ed., 2005, Sec. 2.4.3.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from glucoloop._pytree import pytree
from glucoloop.identification.laguerre import laguerre_sum
from glucoloop.identification.subcutaneous_response import filtered_input

Floats = npt.NDArray[np.float64]

BLOCKS: Final = 10
CONFIDENCE: Final = 0.95
_LONGEST_TAU_MIN: Final = 1000.0
"""Longest time constant of the slower functions, four times that of the slowest that a record chooses."""
_LONGEST_BESIDE: Final = 1 / 2
_LONGEST_IN_PLACE: Final = 1 / 4
"""Longest time constants of slower functions, in lengths of the record: of slower ones it does not show the end."""
_SLOW_FUNCTIONS: Final = 2
_MAX_SLOW_FUNCTIONS: Final = 8
"""Slower functions are as many as those of the fit, so that they say as much of how the response begins."""
_NEGLIGIBLE: Final = 1e-9
"""Share of the largest singular value below which others are left out of a fit: without a block, a column may be empty.
"""


@pytree
class Reliability:
    """Quality of an identified model according to the record."""

    gain_margin: float
    """Half the width of the 95 % confidence interval of the gain [mg/dl per mU/min]."""
    explained_percent: float
    """Part of the variance of left-out readings that the fit predicts: 100 is perfect, 0 as good as a mean."""


def doubts(
    gain: float, reliability: Reliability | None, *, basal_insulin_mU_min: float, glucose_mg_dl: float
) -> tuple[str, ...]:
    """Reasons why no controller should be designed on a model, one sentence each; empty for a sound model.

    A gain differs from 0 if its confidence interval does not reach 0. The true gain is then at most twice the model's,
    so a loop designed with the customary gain margin of 2 is stable on the person as well. A gain is too large if a
    tenth of the basal rate more would take all glucose away.

    Parameters
    ----------
    gain : float
        Steady change of glucose for a lasting change of insulin [mg/dl per mU/min].
    reliability : Reliability or None
        Reliability of the model, or None if it is not known.
    basal_insulin_mU_min, glucose_mg_dl : float
        Operating point at which the model holds.
    """
    sentence = f"The gain is {gain:+.3g} mg/dl per mU/min"
    result = []
    if not gain < 0.0:
        result.append(f"{sentence}, so more insulin would raise glucose; in a person it lowers glucose.")
    elif reliability is not None and not reliability.gain_margin < -gain:
        margin = f"{reliability.gain_margin:.3g} ({100 * CONFIDENCE:g} % confidence)"
        result.append(
            f"{sentence}, give or take {margin}, so it cannot be distinguished from 0. "
            "A longer record, a longer memory or insulin that changes more would make it smaller than the gain."
        )
    if not glucose_mg_dl + 0.1 * basal_insulin_mU_min * gain > 0.0:
        result.append(
            f"{sentence}: a tenth of the basal rate of {basal_insulin_mU_min:.3g} mU/min more would lower glucose from "
            f"{glucose_mg_dl:.3g} mg/dl to below 0."
        )
    if reliability is not None and not reliability.explained_percent > 0.0:
        result.append(
            "Readings that were left out of the fit are predicted no better than by the mean of the others "
            f"({reliability.explained_percent:.0f} % of their variance is explained)."
        )
    return tuple(result)


def reliability(columns: Floats, readings: Floats, gain_of: Floats) -> Reliability:
    """Fit a regression again without each of ten blocks of readings; the gain is `gain_of` times coefficients."""
    errors, gains, spreads = held_out_errors(columns, readings)
    misfit, variation = float(errors.sum()), float(spreads.sum())
    return Reliability(
        gain_margin=_student(gains.size) * _estimate(columns, readings, gain_of)[1],
        explained_percent=100.0 * (1.0 - misfit / variation) if variation else 0.0,
    )


def margin_of_slower_functions(
    insulin_deviation: Floats,
    readings: Floats,
    columns: Floats,
    of_gain: Floats,
    gain: float,
    *,
    functions: int,
    pole: float,
    sample_time_min: float,
    starts_at_rest: bool,
) -> float:
    """Margin of a gain that reaches what slower functions say, where the record lets them stand; else 0.

    Insulin ``(N,)`` is of the whole record, and `readings` ``(n,)`` are its last ones. The first `functions` of the
    `columns` ``(n, K)`` of the fit are responses to insulin, of functions with a pole; `of_gain` ``(K,)`` is the share
    of each coefficient in the gain.

    A function beside those of the fit that is twice as slow always stands; a slower one does where its coefficient
    differs from 0. Slower functions in place of those of the fit stand where they predict left-out readings as well,
    within one standard error, and where the first function of the fit has no coefficient beside them that differs
    from 0.
    """
    errors = held_out_errors(columns, readings)[0]
    student, length_min = _student(errors.size), insulin_deviation.size * sample_time_min
    number = functions if _SLOW_FUNCTIONS <= functions <= _MAX_SLOW_FUNCTIONS else _SLOW_FUNCTIONS
    k = np.arange(readings.size)[:, None] / readings.size
    twice_min, *slower_min = _slower_min(-sample_time_min / math.log(pole))
    margin = 0.0
    for tau_min in (twice_min, *slower_min):
        slow = math.exp(-sample_time_min / tau_min)
        responses = filtered_input(insulin_deviation, slow, number)[-readings.size :]
        # what is left of insulin before the record, of one function and of all
        left = slow ** (readings.size * k) * k ** np.arange(0 if starts_at_rest else number)
        others, of_others = columns[:, functions:], of_gain[functions:]
        nothing, share = np.zeros(left.shape[1]), laguerre_sum(slow)
        beside = np.concatenate([responses[:, :1], left[:, :1], columns], axis=1)
        in_place = np.concatenate([responses, left, others], axis=1)
        alternatives = []
        if tau_min == twice_min or (
            tau_min <= _LONGEST_BESIDE * length_min and _first_differs_from_0(beside, readings, student)
        ):
            alternatives.append((beside, np.concatenate([[share], nothing[:1], of_gain])))
        if tau_min == twice_min or tau_min <= _LONGEST_IN_PLACE * length_min:
            worse = held_out_errors(in_place, readings)[0] - errors
            as_good = worse.mean() <= worse.std(ddof=1) / math.sqrt(worse.size)
            with_first = np.concatenate([columns[:, :1], in_place], axis=1)
            if as_good and not _first_differs_from_0(with_first, readings, student):
                alternatives.append((in_place, np.concatenate([np.full(number, share), nothing, of_others])))
        for regressors, of_regressors in alternatives:
            slower, error = _estimate(regressors, readings, of_regressors)
            margin = max(margin, abs(slower - gain) + student * error)
    return margin


def _first_differs_from_0(columns: Floats, readings: Floats, student: float) -> bool:
    """Whether the coefficient of the first column differs from 0."""
    coefficient, error = _estimate(columns, readings, np.eye(columns.shape[1])[0])
    return abs(coefficient) > student * error


def _slower_min(tau_min: float) -> list[float]:
    """Time constants of two, four, .. times one, up to the longest that a record is asked about."""
    doublings = max(2, math.floor(math.log2(_LONGEST_TAU_MIN / tau_min)))
    return [tau_min * 2.0**k for k in range(1, doublings + 1)]


def _student(blocks: int) -> float:
    return float(stdtrit(blocks - 1, (1.0 + CONFIDENCE) / 2.0))


def _estimate(columns: Floats, readings: Floats, of: Floats) -> tuple[float, float]:
    """A sum `of` coefficients, and its standard error by the jackknife."""
    without = held_out_errors(columns, readings, of)[1]
    error = np.sqrt((without.size - 1) / without.size * np.sum((without - without.mean()) ** 2))
    return float(of @ _coefficients(columns, readings)), float(error)


def _coefficients(columns: Floats, readings: Floats) -> Floats:
    return np.asarray(np.linalg.lstsq(columns, readings, rcond=_NEGLIGIBLE)[0], np.float64)


def held_out_errors(columns: Floats, readings: Floats, gain_of: Floats | None = None) -> tuple[Floats, Floats, Floats]:
    """Errors of fits that have not seen one of ten blocks of readings, on that block.

    They are the sum of squared errors on each block, the gain of the fit without it (0 without `gain_of`), and the sum
    of squares about the mean of the others.
    """
    blocks = np.array_split(np.arange(readings.size), min(BLOCKS, readings.size))
    errors, gains, spreads = np.zeros((3, len(blocks)))
    for number, block in enumerate(blocks):
        remaining = np.ones(readings.size, bool)
        remaining[block] = False
        coefficients = _coefficients(columns[remaining], readings[remaining])
        gains[number] = 0.0 if gain_of is None else gain_of @ coefficients
        errors[number] = np.sum((readings[block] - columns[block] @ coefficients) ** 2)
        spreads[number] = np.sum((readings[block] - readings[remaining].mean()) ** 2)
    return errors, gains, spreads
