"""Traces prepared for drawing: labelled, of one person each, and of the same scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from glucoloop.report.validity import validity_note
from glucoloop.simulation import Trace
from glucoloop.units import MU_PER_U

Floats = npt.NDArray[np.float64]

_SAME_MG_DL = 1e-9


@dataclass(frozen=True)
class Run:
    """One trace as NumPy arrays."""

    label: str
    t_min: Floats
    """(samples + 1,) times of the samples and of the horizon."""
    insulin_mU_min: Floats
    """(samples + 1,) rates delivered from each of these times on; the last repeats that of the last sample."""
    fine_t_min: Floats
    fine_glucose_mg_dl: Floats
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
    meals: tuple[tuple[float, float], ...]
    """Time in min and carbohydrate in g of each meal."""

    @property
    def horizon_min(self) -> float:
        """Length of the run."""
        return float(self.fine_t_min[-1])


def labelled_runs(traces: Trace | Mapping[str, Trace], label: str = "glucose") -> list[Run]:
    """Runs of a trace, or of several by label.

    Parameters
    ----------
    traces : Trace or mapping of str to Trace
    label : str
        Label of a single trace.

    Raises
    ------
    ValueError
        If there is no trace, one is of many people, or the meals differ.
    """
    named = {label: traces} if isinstance(traces, Trace) else dict(traces)
    if not named:
        raise ValueError("there is no trace to show; give at least one")
    runs = [_run(str(name), trace) for name, trace in named.items()]
    for run in runs[1:]:
        if run.meals != runs[0].meals:
            raise ValueError(
                f"{run.label!r} and {runs[0].label!r} have different meals; show runs of one scenario together, "
                "and others apart"
            )
    return runs


def _run(label: str, trace: Trace) -> Run:
    fine_glucose = np.asarray(trace.fine_glucose_mg_dl, float)
    if fine_glucose.ndim != 1:
        raise ValueError(f"{label!r} is of people of shape {fine_glucose.shape[1:]}; show one person at a time")
    t_min, fine_t_min = np.asarray(trace.t_min, float), np.asarray(trace.fine_t_min, float)
    insulin, reading = np.asarray(trace.insulin_mU_min, float), np.asarray(trace.reading_mg_dl, float)
    carbs_g = np.asarray(trace.carbs_g, float)
    valid = np.asarray(trace.reading_valid, bool) & np.isfinite(reading)
    differs = ~np.isclose(reading, np.asarray(trace.glucose_mg_dl), rtol=0.0, atol=_SAME_MG_DL)
    shown = valid if (valid & differs).any() else np.zeros_like(valid)
    return Run(
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
        boluses=() if trace.bolus_mU is None else _above_zero(t_min, np.asarray(trace.bolus_mU, float) / MU_PER_U),
    )


def _above_zero(t_min: Floats, amounts: Floats) -> tuple[tuple[float, float], ...]:
    """Times and amounts, where there is any."""
    return tuple((float(t), float(amount)) for t, amount in zip(t_min, amounts, strict=True) if amount > 0.0)


def limits_passed(runs: Sequence[Run]) -> list[float]:
    """The limits of the patients' models that glucose fell below, each once."""
    return list(dict.fromkeys(run.lowest_valid_mg_dl for run in runs if run.validity_note is not None))


def values_in_words(values: list[float], unit: str) -> str:
    """Text of the distinct values with their unit."""
    return " and ".join(dict.fromkeys(f"{value:.4g}" for value in values)) + f" {unit}"
