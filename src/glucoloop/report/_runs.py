"""Traces prepared for drawing: labelled, of one person each, and of the same scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from glucoloop.control import Status
from glucoloop.refusal import Refusal
from glucoloop.report.validity import concentrations, validity_note
from glucoloop.simulation import Trace
from glucoloop.units import MU_PER_U

Floats = npt.NDArray[np.float64]
Period = tuple[float, float]
"""First and last moment, in min."""

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
    """One trace as NumPy arrays."""

    label: str
    t_min: Floats
    """(samples + 1,) times of the samples and of the horizon."""
    insulin_mU_min: Floats
    """(samples + 1,) rates delivered from each of these times on; the last repeats that of the last sample."""
    fine_t_min: Floats
    fine_glucose_mg_dl: Floats
    """Glucose of the model, which may be below 0 where the model is not valid."""
    reading_t_min: Floats
    """Times of valid readings; empty if all of them equal the patient's glucose."""
    reading_mg_dl: Floats
    setpoint_mg_dl: float
    basal_insulin_mU_min: float
    lowest_valid_mg_dl: float
    """Glucose below which the patient's model is not valid."""
    validity_note: str | None
    """Sentence on the times at which glucose was below that limit; None if it never was."""
    boluses: tuple[tuple[float, float], ...]
    """Time and size of each bolus that was delivered, (min, U)."""
    command_mU_min: Floats
    """(samples + 1,) rates that the controller commanded, as `insulin_mU_min`; NaN where it gave no number."""
    command_boluses: tuple[tuple[float, float], ...]
    """Time and size of each bolus that was commanded, (min, U)."""
    periods: Mapping[str, tuple[Period, ...]]
    """Periods without a valid reading, and those of each status of decisions but OK, by a name in words."""
    meals: tuple[tuple[float, float], ...]
    """Time in min and carbohydrate in g of each meal."""

    @property
    def shown_glucose_mg_dl(self) -> Floats:
        """Glucose to be drawn; NaN where it is below 0."""
        return concentrations(self.fine_glucose_mg_dl)

    @property
    def horizon_min(self) -> float:
        """Length of the run."""
        return float(self.fine_t_min[-1])


def labelled_runs(traces: Trace | Mapping[str, Trace], label: str = "glucose") -> list[PlottedRun]:
    """Runs of a trace, or of several by label; Refusal for none, one of many people, or different meals."""
    named = {label: traces} if isinstance(traces, Trace) else dict(traces)
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
    t_min, fine_t_min = np.asarray(trace.t_min, float), np.asarray(trace.fine_t_min, float)
    insulin, reading = np.asarray(trace.insulin_mU_min, float), np.asarray(trace.reading_mg_dl, float)
    carbs_g, command = np.asarray(trace.carbs_g, float), np.asarray(trace.command_mU_min, float)
    valid = np.asarray(trace.reading_valid, bool) & np.isfinite(reading)
    differs = ~np.isclose(reading, np.asarray(trace.glucose_mg_dl), rtol=0.0, atol=_SAME_MG_DL)
    shown = valid if (valid & differs).any() else np.zeros_like(valid)
    return PlottedRun(
        label=label,
        t_min=np.append(t_min, fine_t_min[-1]),
        insulin_mU_min=np.append(insulin, insulin[-1]),
        fine_t_min=fine_t_min,
        fine_glucose_mg_dl=fine_glucose,
        reading_t_min=t_min[shown],
        reading_mg_dl=reading[shown],
        setpoint_mg_dl=float(trace.setpoint_mg_dl),
        basal_insulin_mU_min=float(trace.basal_insulin_mU_min),
        lowest_valid_mg_dl=float(trace.lowest_valid_mg_dl),
        validity_note=validity_note(trace),
        meals=_above_zero(t_min, carbs_g),
        boluses=_boluses(t_min, trace.bolus_mU),
        command_mU_min=np.append(command, command[-1]),
        command_boluses=_boluses(t_min, trace.command_bolus_mU),
        periods=_periods(np.append(t_min, fine_t_min[-1]), np.asarray(trace.status), valid),
    )


def _periods(
    t_min: Floats, status: npt.NDArray[np.int64], valid: npt.NDArray[np.bool_]
) -> dict[str, tuple[Period, ...]]:
    """Periods of each status that occurs, from its first sample to the one after its last."""
    of_all = {STATUS_WORDS[kind]: status == kind for kind in STATUS_WORDS}
    of_all[STATUS_WORDS[Status.READING_MISSING]] |= ~valid
    return {name: periods(t_min, there) for name, there in of_all.items() if there.any()}


def periods(t_min: Floats, there: npt.NDArray[np.bool_]) -> tuple[Period, ...]:
    """Periods in which something is there at samples ``(n,)`` that begin at the times ``(n + 1,)``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    return tuple((float(t_min[first]), float(t_min[after])) for first, after in edges.reshape(-1, 2))


def _boluses(t_min: Floats, bolus_mU: npt.ArrayLike | None) -> tuple[tuple[float, float], ...]:
    return () if bolus_mU is None else _above_zero(t_min, np.asarray(bolus_mU, float) / MU_PER_U)


def _above_zero(t_min: Floats, amounts: Floats) -> tuple[tuple[float, float], ...]:
    """Times and amounts, where there is any."""
    return tuple((float(t), float(amount)) for t, amount in zip(t_min, amounts, strict=True) if amount > 0.0)


def limits_passed(runs: Sequence[PlottedRun]) -> list[float]:
    """The limits of the patients' models that glucose fell below, each once."""
    return list(dict.fromkeys(run.lowest_valid_mg_dl for run in runs if run.validity_note is not None))


def values_in_words(values: list[float], unit: str) -> str:
    """Text of the distinct values with their unit."""
    return " and ".join(dict.fromkeys(f"{value:.4g}" for value in values)) + f" {unit}"
