"""Summary of a run in the order in which a clinician reads it: times in ranges, extremes of glucose, insulin.

References
----------
T. Battelino et al., "Clinical targets for continuous glucose monitoring data interpretation: recommendations from the
international consensus on time in range", Diabetes Care 42(8), 1593-1603, 2019: the ambulatory glucose profile.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from glucoloop.metrics.running import Metrics
from glucoloop.simulation.trace import Trace
from glucoloop.text import percent
from glucoloop.units import MIN_PER_H, MU_PER_U


@dataclass(frozen=True)
class ClinicalSummary:
    """Facts about the run of one person; a value is None where glucose or insulin was not finite throughout."""

    duration_h: float
    time_70_180_pct: float | None
    time_above_180_pct: float | None
    time_above_250_pct: float | None
    time_below_70_pct: float | None
    time_below_54_pct: float | None
    lowest_mg_dl: float | None
    """Minimum glucose; None, too, if it was below the range in which the patient's model is valid."""
    lowest_valid_mg_dl: float
    """Glucose below which the patient's model is not valid."""
    below_validity: bool
    """Whether glucose was ever below that; it means severe hypoglycemia, not a number."""
    highest_mg_dl: float | None
    mean_mg_dl: float | None
    """Mean glucose; None, too, if glucose was ever below 0, which is no concentration."""
    insulin_U: float | None
    insulin_off_h: float | None
    longest_insulin_off_h: float | None
    beyond_limits_pct: float
    """Percentage of the samples at which the controller wanted a dose beyond its limits."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, with the sentences."""
        return {**dataclasses.asdict(self), "sentences": list(self.sentences())}

    def sentences(self) -> Iterator[str]:
        """The summary in words, one sentence for each subject."""
        yield from self._ranges()
        yield from self._extremes()
        yield from self._insulin()

    def _ranges(self) -> Iterator[str]:
        inside, above, below = self.time_70_180_pct, self.time_above_180_pct, self.time_below_70_pct
        if inside is None or above is None or below is None:
            yield "Glucose did not stay a finite number, so that nothing can be said about it."
            return
        yield f"Glucose was from 70 to 180 mg/dl for {percent(inside)} of the {_hours(self.duration_h)}."
        for name, bound, further, time, far in (
            ("above", 180, 250, above, self.time_above_250_pct),
            ("below", 70, 54, below, self.time_below_54_pct),
        ):
            if not time:
                yield f"Glucose was never {name} {bound} mg/dl."
            else:
                beyond = (
                    f"and {name} {further} mg/dl for {self._of_time(far)}"
                    if far
                    else f"but never {name} {further} mg/dl"
                )
                yield f"Glucose was {name} {bound} mg/dl for {self._of_time(time)}, {beyond}."

    def _of_time(self, pct: float) -> str:
        return f"{percent(pct)} of the time ({_hours(pct / 100.0 * self.duration_h)})"

    def _extremes(self) -> Iterator[str]:
        if self.below_validity:
            yield (
                f"Glucose fell below {self.lowest_valid_mg_dl:.1f} mg/dl, where the patient's model is not valid: read "
                "this as severe hypoglycemia, of a depth that is not known."
            )
        values = {"lowest": self.lowest_mg_dl, "highest": self.highest_mg_dl, "mean": self.mean_mg_dl}
        known = {name: f"{value:.1f} mg/dl" for name, value in values.items() if value is not None}
        for first in list(known)[:1]:
            others = "".join(f", the {name} {value}" for name, value in known.items() if name != first)
            yield f"The {first} glucose was {known[first]}{others}."

    def _insulin(self) -> Iterator[str]:
        if self.insulin_U is None:
            yield "The delivered insulin did not stay a finite number."
        else:
            off, longest = self.insulin_off_h, self.longest_insulin_off_h
            sentence = f"The pump delivered {self.insulin_U:.2f} U of insulin"
            if off and longest:
                most = "" if math.isclose(off, longest) else f", at most for {_hours(longest)} without a break"
                sentence += f", and none at all for {_hours(off)}{most}"
            yield f"{sentence}."
        if self.beyond_limits_pct:
            often = "for most of the time, " if self.beyond_limits_pct > 50.0 else ""
            yield (
                f"The controller wanted a dose beyond its limits {often}at {percent(self.beyond_limits_pct)} of the "
                "samples."
            )


def clinical_summary(trace: Trace, metrics: Metrics) -> ClinicalSummary:
    """Summary of a run of one person.

    Parameters
    ----------
    metrics : Metrics
        Metrics of that trace, as `summarise` finds them.

    Raises
    ------
    ValueError
        For a run of more than one person.
    """
    values: dict[str, Any] = metrics.as_dict()
    invalid = bool(values["time_below_validity_pct"])

    def divided(name: str, divisor: float) -> float | None:
        return None if values[name] is None else values[name] / divisor

    return ClinicalSummary(
        duration_h=float(trace.fine_t_min[-1]) / MIN_PER_H,
        **{f"time_{name}_pct": values[f"time_{name}_pct"] for name in ("70_180", "above_180", "above_250")},
        time_below_70_pct=values["time_below_70_pct"],
        time_below_54_pct=values["time_below_54_pct"],
        lowest_mg_dl=None if invalid else values["minimum_mg_dl"],
        lowest_valid_mg_dl=float(trace.lowest_valid_mg_dl),
        below_validity=invalid,
        highest_mg_dl=values["peak_mg_dl"],
        mean_mg_dl=None if invalid and values["minimum_mg_dl"] < 0.0 else values["mean_mg_dl"],
        insulin_U=divided("insulin_total_mU", MU_PER_U),
        insulin_off_h=divided("insulin_off_min", MIN_PER_H),
        longest_insulin_off_h=divided("longest_insulin_off_min", MIN_PER_H),
        beyond_limits_pct=100.0 * values["samples_saturated"] / trace.t_min.shape[0],
    )


def _hours(hours: float) -> str:
    """Text of a time in hours, or in minutes below one hour."""
    return f"{hours:.3g} h" if hours >= 1.0 else f"{hours * MIN_PER_H:.0f} min"
