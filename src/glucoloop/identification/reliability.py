"""Reliability of an identified model: how far its gain may be off, and what it predicts of readings not seen.

The person's gain is in the interval that the record leaves open, see `gain_interval`. For the variance explained the
readings are divided into contiguous blocks, and the response is fitted again without each block in turn. Blocks, not
single readings, are left out because what a model leaves of glucose is correlated over hours (meals that nobody wrote
down, exercise, drift).

A gain is that of small changes. Where insulin moved glucose far, a person responds otherwise than a linear model, and
the interval is too narrow: so the change that the model gives the insulin of the record is told beside it.

A gain margin of 2: S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd ed., 2005, Sec. 2.4.3.
"""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree
from glucoloop.identification.gain_interval import CONFIDENCE
from glucoloop.schema.values import ValueBounds

Floats = npt.NDArray[np.float64]

BLOCKS: Final = 10
MOST_MOVED_PERCENT: Final = 20.0
"""Change of glucose up to which the interval of the gain holds the person's gain as often as it says."""
_NEGLIGIBLE: Final = 1e-9
"""Share of the largest singular value below which others are left out of a fit: without a block, a column may be empty.
"""


@pytree
class Reliability:
    """Quality of an identified model according to the record."""

    gain_from: float
    gain_to: float
    """Ends of the 95 % interval of the person's gain [mg/dl per mU/min]."""
    explained_percent: Annotated[float, ValueBounds(at_most=100.0)]
    """Part of the variance of left-out readings that the fit predicts: 100 is perfect, 0 as good as a mean."""
    moved_percent: Annotated[float, ValueBounds(at_least=0.0)] | None = None
    """Largest change of glucose by the insulin of the record, by the model and of the glucose at the operating point;
    None for a record with meals, or where it is not known."""

    @property
    def moved_far(self) -> bool:
        """Whether insulin moved glucose so far that the gain is not that of small changes."""
        return self.moved_percent is not None and not self.moved_percent <= MOST_MOVED_PERCENT


def doubts(
    gain: float, reliability: Reliability | None, *, basal_insulin_mU_min: float, glucose_mg_dl: float
) -> tuple[str, ...]:
    """Reasons why no controller should be designed on a model, one sentence each; empty for a sound model.

    The confidence interval of the person's gain reaches neither 0 nor twice the model's gain, so that a loop designed
    with the customary gain margin of 2 is stable on the person as well. A gain is too large if a tenth of the basal
    rate more would take all glucose away, and not that of small changes if insulin moved glucose far.

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
    elif reliability is not None and not 2.0 * gain < reliability.gain_from <= reliability.gain_to < 0.0:
        interval = f"{reliability.gain_from:.3g} to {reliability.gain_to:.3g} ({100 * CONFIDENCE:g} % confidence)"
        reason = "may be more than twice that" if reliability.gain_to < 0.0 else "cannot be distinguished from 0"
        result.append(
            f"{sentence}, and the person's is from {interval}, so it {reason}. "
            "A longer record, a longer memory or insulin that changes more would make the interval narrower."
        )
    if not glucose_mg_dl + 0.1 * basal_insulin_mU_min * gain > 0.0:
        result.append(
            f"{sentence}: a tenth of the basal rate of {basal_insulin_mU_min:.3g} mU/min more would lower glucose from "
            f"{glucose_mg_dl:.3g} mg/dl to below 0."
        )
    if reliability is not None and reliability.moved_far:
        result.append(
            f"By the model the insulin of the record moved glucose by up to {reliability.moved_percent:.0f} % of "
            f"{glucose_mg_dl:.3g} mg/dl. Beyond {MOST_MOVED_PERCENT:g} % people do not respond in proportion, so that "
            "the gain is not that of small changes. Insulin that changes less would tell it."
        )
    if reliability is not None and not reliability.explained_percent > 0.0:
        result.append(
            "Readings that were left out of the fit are predicted no better than by the mean of the others "
            f"({reliability.explained_percent:.0f} % of their variance is explained)."
        )
    return tuple(result)


def reliability(
    columns: Floats, readings: Floats, interval: tuple[float, float], moved_percent: float | None = None
) -> Reliability:
    """Quality of a model by its regression, the interval of the person's gain, and how far insulin moved glucose."""
    variation = float(held_out_errors(np.ones((readings.size, 1)), readings).sum())
    misfit = float(held_out_errors(columns, readings).sum())
    return Reliability(
        gain_from=interval[0],
        gain_to=interval[1],
        explained_percent=100.0 * (1.0 - misfit / variation) if np.ptp(readings) else 0.0,
        moved_percent=moved_percent,
    )


def held_out_errors(columns: Floats, readings: Floats) -> Floats:
    """Sums of squared errors on each of ten blocks of readings, of a fit that has not seen the block."""
    blocks = np.array_split(np.arange(readings.size), min(BLOCKS, readings.size))
    errors = np.zeros(len(blocks))
    for number, block in enumerate(blocks):
        remaining = np.ones(readings.size, bool)
        remaining[block] = False
        coefficients = np.linalg.lstsq(columns[remaining], readings[remaining], rcond=_NEGLIGIBLE)[0]
        errors[number] = np.sum((readings[block] - columns[block] @ coefficients) ** 2)
    return errors
