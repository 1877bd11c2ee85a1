"""Traces prepared for drawing: labelled, of one person each, and of the same scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from glucoloop.control import Status
from glucoloop.refusal import Refusal
from glucoloop.report.validity import concentrations, stretches, validity_note
from glucoloop.simulation import Trace
from glucoloop.units import MU_PER_U

Floats = npt.NDArray[np.float64]
Pair = tuple[float, float]

STATUS_WORDS: Final = {
    Status.SATURATED: "Dose at the pump's limits",
    Status.READING_MISSING: "Reading missing",
    Status.NOT_CONVERGED: "Optimisation not converged",
    Status.NON_FINITE: "Computation without a finite number",
    Status.READING_REJECTED: "Guard: reading not believed",
    Status.FALLBACK_BASAL: "Guard: basal rate, no reading believed",
    Status.FALLBACK_REDUCED: "Guard: part of the basal rate, no reading believed",
    Status.SUSPENDED: "Guard: insulin suspended",
    Status.DOSE_LIMITED: "Guard: dose cut",
    Status.RESTARTED: "Guard: controller started anew",
    Status.NO_FINITE_DOSE: "No finite dose",
}
"""Statuses of decisions in words, in the order shown."""

_SAME_MG_DL = 1e-9


@dataclass(frozen=True)
class PlottedRun:
    """One trace as NumPy arrays; rates hold from each time on, and the last one repeats that of the last sample."""

    label: str
    t_min: Floats
    """(samples + 1,) times of the samples and of the horizon."""
    insulin_mU_min: Floats
    command_mU_min: Floats
    """(samples + 1,) rates that the controller commanded; NaN where it gave no number."""
    fine_t_min: Floats
    fine_glucose_mg_dl: Floats
    """Glucose of the model, which may be below 0 where the model is not valid."""
    reading_t_min: Floats
    """Times of valid readings; empty if all of them equal the patient's glucose."""
    reading_mg_dl: Floats
    setpoint_mg_dl: float
    basal_insulin_mU_min: float
    lowest_valid_mg_dl: float
    validity_note: str | None
    boluses: Sequence[Pair]
    """Time in min and size in U of each bolus that was delivered."""
    command_boluses: Sequence[Pair]
    meals: Sequence[Pair]
    """Time in min and carbohydrate in g of each meal."""
    periods: Mapping[str, Sequence[Pair]]
    """Periods without a valid reading, and those of each status of decisions but OK, by a name in words."""

    @property
    def shown_glucose_mg_dl(self) -> Floats:
        """Glucose to be drawn; NaN where it is below 0."""
        return concentrations(self.fine_glucose_mg_dl)


def labelled_runs(traces: Trace | Mapping[str, Trace]) -> list[PlottedRun]:
    """Runs of a trace, or of several by label; Refusal for none, one of many people, or different meals."""
    named = {"glucose": traces} if isinstance(traces, Trace) else traces
    if not named:
        raise Refusal("there is no trace to show; give at least one")
    runs = [_run(str(name), trace) for name, trace in named.items()]
    for run in runs[1:]:
        if run.meals != runs[0].meals:
            raise Refusal(
                f"{run.label!r} and {runs[0].label!r} have different meals; show runs of one scenario together, "
                "and others apart"
            )
    return runs


def _run(label: str, trace: Trace) -> PlottedRun:
    fine_glucose = np.asarray(trace.fine_glucose_mg_dl, float)
    if fine_glucose.ndim != 1:
        raise Refusal(f"{label!r} is of people of shape {fine_glucose.shape[1:]}; show one person at a time")
    sample_t_min, fine_t_min = np.asarray(trace.t_min, float), np.asarray(trace.fine_t_min, float)
    t_min, status = np.append(sample_t_min, fine_t_min[-1]), np.asarray(trace.status)
    insulin, command = np.asarray(trace.insulin_mU_min, float), np.asarray(trace.command_mU_min, float)
    reading = np.asarray(trace.reading_mg_dl, float)
    valid = np.asarray(trace.reading_valid, bool) & np.isfinite(reading)
    differs = ~np.isclose(reading, np.asarray(trace.glucose_mg_dl), rtol=0.0, atol=_SAME_MG_DL)
    shown = valid if (valid & differs).any() else np.zeros_like(valid)
    there = {words: status == kind for kind, words in STATUS_WORDS.items()}
    there[STATUS_WORDS[Status.READING_MISSING]] |= ~valid
    return PlottedRun(
        label=label,
        t_min=t_min,
        insulin_mU_min=np.append(insulin, insulin[-1]),
        command_mU_min=np.append(command, command[-1]),
        fine_t_min=fine_t_min,
        fine_glucose_mg_dl=fine_glucose,
        reading_t_min=sample_t_min[shown],
        reading_mg_dl=reading[shown],
        setpoint_mg_dl=float(trace.setpoint_mg_dl),
        basal_insulin_mU_min=float(trace.basal_insulin_mU_min),
        lowest_valid_mg_dl=float(trace.lowest_valid_mg_dl),
        validity_note=validity_note(trace),
        boluses=_above_zero(t_min, trace.bolus_mU, MU_PER_U),
        command_boluses=_above_zero(t_min, trace.command_bolus_mU, MU_PER_U),
        meals=_above_zero(t_min, trace.carbs_g),
        periods={words: periods(t_min, of) for words, of in there.items() if of.any()},
    )


def periods(t_min: Floats, there: npt.NDArray[np.bool_]) -> list[Pair]:
    """Periods in which something is there at samples ``(n,)`` that begin at the times ``(n + 1,)``."""
    return [(float(t_min[first]), float(t_min[after])) for first, after in stretches(there)]


def _above_zero(t_min: Floats, amounts: npt.ArrayLike | None, divisor: float = 1.0) -> list[Pair]:
    """Times and amounts, where there is any."""
    some = () if amounts is None else np.asarray(amounts, float) / divisor
    return [(float(t), float(amount)) for t, amount in zip(t_min, some, strict=False) if amount > 0.0]


def limits_passed(runs: Sequence[PlottedRun]) -> list[float]:
    """The limits of the patients' models that glucose fell below, each once."""
    return list(dict.fromkeys(run.lowest_valid_mg_dl for run in runs if run.validity_note is not None))


def values_in_words(values: Sequence[float], unit: str) -> str:
    """Text of the distinct values with their unit."""
    return " and ".join(dict.fromkeys(f"{value:.4g}" for value in values)) + f" {unit}"
