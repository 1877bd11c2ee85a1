"""Reason why a person was worse off under a fault: the run is repeated, and its salient events described."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import jax
import numpy as np

from glucoloop.control import Status
from glucoloop.reporting.labelled_traces import period_text
from glucoloop.text import glucose_text, how_many
from glucoloop.trials.engine import PreparedTrial, alone

_LOW_MG_DL: Final = 60.0
_BEFORE_MIN: Final = 90.0
"""Time before a low for which the insulin is examined."""
_BIAS_MG_DL: Final = 4.0
_LESS: Final = 0.05
_ACTS: Final = (
    (Status.READING_REJECTED, "rejected {}", "reading"),
    (Status.FALLBACK_BASAL, "gave at most the basal rate for {}", "sample"),
    (Status.FALLBACK_REDUCED, "gave a part of it for {}", "sample"),
    (Status.DOSE_LIMITED, "cut {}", "dose"),
    (Status.SUSPENDED, "suspended insulin for {}", "sample"),
)


def reason_of(prepared: PreparedTrial, label: str, person: int) -> str:
    """Description of the run of a person under a case of a trial, in a few sentences."""
    trace: Any = jax.tree.map(np.asarray, alone(prepared, label, person))
    return " ".join(_sentences(trace, prepared.trial.sample_time_min, prepared.trial.start_min or 0.0))


def _sentences(trace: Any, sample_time_min: float, start_min: float = 0.0) -> Iterator[str]:
    glucose = trace.fine_glucose_mg_dl
    low = np.flatnonzero(glucose < _LOW_MG_DL)
    if not low.size:
        margin = f"{glucose.min() - _LOW_MG_DL:.1f} mg/dl"
        yield f"Simulated alone, the person stayed above {_LOW_MG_DL:g} mg/dl, by {margin}."
        return
    first_min, last_min = trace.fine_t_min[low[0]], trace.fine_t_min[low[-1]]
    least = glucose_text(glucose.min())
    when = period_text(round(first_min), round(last_min), float(trace.fine_t_min[-1]), start_min)
    yield f"Below {_LOW_MG_DL:g} mg/dl {when}, minimum {least} mg/dl."
    before = (trace.t_min >= first_min - _BEFORE_MIN) & (trace.t_min <= first_min)
    yield from _on_readings(trace, before)
    yield from _on_pump(trace, trace.t_min <= first_min, sample_time_min)
    basal = float(trace.basal_insulin_mU_min)
    rate = trace.insulin_mU_min[before].mean() / basal if basal else np.nan
    yield f"In the {before.sum() * sample_time_min:.0f} min before, the person got {rate:.2f} of the basal rate."
    status = trace.status[trace.t_min <= last_min]
    counted = [(text, int((status == act).sum()), what) for act, text, what in _ACTS]
    if acts := [text.format(how_many(count, what)) for text, count, what in counted if count]:
        yield f"Up to the end of it the guard {', '.join(acts)}."


def _on_readings(trace: Any, before: Any) -> Iterator[str]:
    valid = trace.reading_valid & np.isfinite(trace.reading_mg_dl)
    missing = int((~valid & before).sum())
    if missing:
        yield f"Of the {int(before.sum())} readings before it {how_many(missing, 'was', 'were')} missing."
    used = before & valid
    if not used.any():
        return
    error = (trace.reading_mg_dl - trace.glucose_mg_dl)[used]
    middle, largest = float(np.median(error)), float(error[np.abs(error).argmax()])
    if abs(middle) > _BIAS_MG_DL:
        yield f"Readings were {abs(middle):.0f} mg/dl too {'high' if middle > 0.0 else 'low'} in the median before it."
    elif abs(largest) > 2.0 * _BIAS_MG_DL:
        yield f"One reading was {abs(largest):.0f} mg/dl too {'high' if largest > 0.0 else 'low'}."


def _on_pump(trace: Any, so_far: Any, sample_time_min: float) -> Iterator[str]:
    doses = (
        (trace.command_mU_min, trace.command_bolus_mU),
        (trace.insulin_mU_min, trace.bolus_mU),
        (trace.reported_mU_min, trace.reported_bolus_mU),
    )
    # boluses count evenly
    command, delivered, reported = (
        (rate if bolus is None else rate + bolus / sample_time_min)[so_far] for rate, bolus in doses
    )
    lost = float((command - delivered).sum() / max(command.sum(), 1.0))
    if lost > _LESS:
        yield f"Until then the pump had delivered {100.0 * lost:.0f} % less than it was told."
    if float(np.nansum(reported - delivered)) > _LESS * float(delivered.sum()):
        yield "It had not said so."
