"""Traces prepared for drawing, labelled and of one person each, and moments and periods of a run in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glucoloop.control import Status
from glucoloop.metrics.readings.series import stretches
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY, MIN_PER_H, MU_PER_U

if TYPE_CHECKING:
    from glucoloop.physiology.exercise import Exercise
    from glucoloop.simulation import Trace

_MAX_PERIODS: Final = 3


def moment_text(t_min: float, end_min: float | None = None, start_min: float = 0.0) -> str:
    """A moment of a run that ends at `end_min`: ``45 min``, or ``day 10, 17:30`` if the run is longer than a day.

    Without the end, the moment itself says whether it is. The run starts on day 1, `start_min` after midnight.
    """
    if (t_min if end_min is None else end_min) <= MIN_PER_DAY:
        return f"{t_min:g} min"
    day, of_day = divmod(round(start_min + t_min), round(MIN_PER_DAY))
    hour, minute = divmod(of_day, round(MIN_PER_H))
    return f"day {day + 1}, {hour:02d}:{minute:02d}"


def period_text(first_min: float, last_min: float, end_min: float | None = None, start_min: float = 0.0) -> str:
    """A period of a run, in a phrase: ``at 45 min``, ``from 45 to 60 min``, ``from day 2, 07:00 to day 2, 07:45``."""
    end_min = last_min if end_min is None else end_min
    first, last = (moment_text(t_min, end_min, start_min) for t_min in (first_min, last_min))
    if first_min == last_min:
        return f"at {last}"
    return f"from {first.removesuffix(' min')} to {last}"


def periods_text(periods: Sequence[tuple[float, float]], end_min: float, start_min: float = 0.0) -> str:
    """The first periods, and how many there are besides: ``from 10 to 20 min and at 35 min``."""
    phrases = [period_text(first, last, end_min, start_min) for first, last in periods]
    if len(phrases) > _MAX_PERIODS:
        phrases = [*phrases[: _MAX_PERIODS - 1], f"in {len(phrases) - _MAX_PERIODS + 1} later periods"]
    return phrases[0] if len(phrases) == 1 else f"{', '.join(phrases[:-1])} and {phrases[-1]}"


def periods_below(
    t_min: npt.ArrayLike, glucose_mg_dl: npt.ArrayLike, limit_mg_dl: npt.ArrayLike
) -> list[tuple[float, float]]:
    """First and last moment of each period in which the glucose of one person is below a limit; NaN is not."""
    t, below = np.asarray(t_min, float), np.asarray(glucose_mg_dl, float) < np.asarray(limit_mg_dl, float)
    return [(float(t[first]), float(t[after - 1])) for first, after in stretches(below)]


def concentrations(glucose_mg_dl: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Glucose to be shown: NaN below 0, which is no concentration; the valid range of the model ended above it."""
    return np.where(glucose_mg_dl < 0.0, np.nan, glucose_mg_dl)


def validity(trace: Trace) -> dict[str, Any]:
    """Plain values for JSON: the limit of one patient's model, and the periods below it."""
    periods = periods_below(trace.fine_t_min, trace.fine_glucose_mg_dl, trace.lowest_valid_mg_dl)
    return {
        "lowest_valid_mg_dl": float(trace.lowest_valid_mg_dl),
        "periods_below_min": [list(period) for period in periods],
    }


def validity_note(trace: Trace, start_min: float = 0.0) -> str | None:
    """Warning about a run in which glucose was below the range in which the model is valid, or None."""
    return validity_sentence(trace.fine_t_min, trace.fine_glucose_mg_dl, float(trace.lowest_valid_mg_dl), start_min)


def validity_sentence(
    t_min: npt.ArrayLike, glucose_mg_dl: npt.ArrayLike, limit_mg_dl: float, start_min: float = 0.0
) -> str | None:
    """The same warning for glucose at given times and the limit of the model; arguments as for `periods_below`.

    The run starts `start_min` after midnight.
    """
    periods = periods_below(t_min, glucose_mg_dl, limit_mg_dl)
    if not periods:
        return None
    when = periods_text(periods, float(np.asarray(t_min)[-1]), start_min)
    return (
        f"Glucose was below {limit_mg_dl:.1f} mg/dl {when}: the patient's model is not valid there. Read these values "
        "as severe hypoglycemia; their depth means nothing."
    )


Floats = npt.NDArray[np.float64]
Pair = tuple[float, float]

STATUS_WORDS: Final = {
    Status.SATURATED: "Dose at the pump's limits",
    Status.READING_MISSING: "Reading missing",
    Status.NOT_CONVERGED: "Optimisation not converged",
    Status.NON_FINITE: "Computation without a finite number",
    Status.READING_REJECTED: "Guard: reading not accepted",
    Status.FALLBACK_BASAL: "Guard: at most the basal rate, no reading accepted",
    Status.FALLBACK_REDUCED: "Guard: part of the basal rate, no reading accepted",
    Status.SUSPENDED: "Guard: insulin suspended",
    Status.DOSE_LIMITED: "Guard: dose cut",
    Status.RESTARTED: "Guard: controller started again",
    Status.NO_FINITE_DOSE: "No finite dose",
}
"""Statuses of decisions in words, in the order shown."""

_SAME_MG_DL = 1e-9
_MAX_FORECASTS: Final = 24
"""Most forecasts of a picture, at even distances; more would hide one another."""
_SHOWN_MG_DL: Final = (40.0, 400.0)
"""Range of a sensor, to which the axis of a picture has room for forecasts; a line beyond it is cut."""


class Bout(NamedTuple):
    """Exercise that was simulated, in whole samples."""

    intensity_pct: float
    t_min: float
    duration_min: float


class PlottedRun:
    """One trace of one person as NumPy arrays, by a label; Refusal for many people."""

    def __init__(self, label: str, trace: Trace) -> None:
        self.label = label
        self.fine_t_min = np.asarray(trace.fine_t_min, float)
        self.fine_glucose_mg_dl = np.asarray(trace.fine_glucose_mg_dl, float)  # below 0 where the model is not valid
        if self.fine_glucose_mg_dl.ndim != 1:
            people = self.fine_glucose_mg_dl.shape[1:]
            raise Refusal(f"{label!r} is of people of shape {people}; show one person at a time")
        self.shown_glucose_mg_dl = concentrations(self.fine_glucose_mg_dl)
        self.setpoint_mg_dl = float(trace.setpoint_mg_dl)
        self.basal_insulin_mU_min = float(trace.basal_insulin_mU_min)
        self.lowest_valid_mg_dl = float(trace.lowest_valid_mg_dl)
        self.validity_note = validity_note(trace)
        # (samples + 1,) times of the samples and of the horizon, and rates from each on, of which the last is repeated
        sample_t_min = np.asarray(trace.t_min, float)
        self.t_min = np.append(sample_t_min, self.fine_t_min[-1])
        self.insulin_mU_min = _extended_to_the_end(trace.insulin_mU_min)
        self.command_mU_min = _extended_to_the_end(trace.command_mU_min)  # NaN where the controller gave no number
        # valid readings, or none if all of them equal the patient's glucose
        reading = np.asarray(trace.reading_mg_dl, float)
        valid = np.asarray(trace.reading_valid, bool) & np.isfinite(reading)
        differs = ~np.isclose(reading, np.asarray(trace.glucose_mg_dl), rtol=0.0, atol=_SAME_MG_DL)
        differing = valid & (valid & differs).any()
        self.reading_t_min, self.reading_mg_dl = sample_t_min[differing], reading[differing]
        # times in min, with U of insulin, ug of glucagon or g of carbohydrate
        self.boluses = _above_zero(self.t_min, trace.bolus_mU, MU_PER_U)
        self.command_boluses = _above_zero(self.t_min, trace.command_bolus_mU, MU_PER_U)
        self.glucagon = _above_zero(self.t_min, trace.glucagon_ug)
        self.command_glucagon = _above_zero(self.t_min, trace.command_glucagon_ug)
        self.meals = _above_zero(self.t_min, trace.carbs_g)
        # (samples,) what is on board, with subcutaneous insulin; intravenous insulin acts within minutes
        nothing = np.zeros(0)
        self.insulin_on_board_U = trace.insulin_on_board_U if trace.subcutaneous else nothing
        self.carbs_on_board_g = trace.carbs_on_board_g if trace.subcutaneous else nothing
        self.exercise = _bouts(self.t_min, trace.exercise_pct)
        self.forecasts, self.forecasts_every_min = _some_forecasts(trace)
        # periods without a valid reading, and those of each status of decisions but OK
        there = {text: np.asarray(trace.status) == kind for kind, text in STATUS_WORDS.items()}
        there[STATUS_WORDS[Status.READING_MISSING]] |= ~valid
        self.periods = {text: _periods(self.t_min, present) for text, present in there.items() if present.any()}


def _some_forecasts(trace: Trace) -> tuple[list[tuple[Floats, Floats]], float]:
    """Times and glucose of some of the forecasts of a trace, within the run, and the time between them."""
    if trace.forecast is None:
        return [], 0.0
    ahead, glucose, t_min = (
        np.asarray(of, float) for of in (trace.forecast.ahead_min, trace.forecast.glucose_mg_dl, trace.t_min)
    )
    made = np.flatnonzero(np.isfinite(ahead[:, 0]))  # a controller may act at some samples alone
    end_min, step = float(trace.fine_t_min[-1]), -(-made.size // _MAX_FORECASTS)
    inside = [(t_min[at] + ahead[at], glucose[at]) for at in made[::step]]
    lines = [(times[times <= end_min], values[times <= end_min]) for times, values in inside]
    return lines, float(t_min[made[step]] - t_min[made[0]]) if made.size > step else 0.0


def _extended_to_the_end(rates: npt.ArrayLike) -> Floats:
    values = np.asarray(rates, float)
    return np.append(values, values[-1])


def labelled_runs(traces: Trace | Mapping[str, Trace]) -> list[PlottedRun]:
    """Runs of a trace, or of several by label; Refusal for none, one of many people, or different meals."""
    named = traces if isinstance(traces, Mapping) else {"glucose": traces}
    if not named:
        raise Refusal("there is no trace to show; give at least one")
    runs = [PlottedRun(str(label), trace) for label, trace in named.items()]
    for run in runs[1:]:
        if run.meals != runs[0].meals:
            raise Refusal(
                f"{run.label!r} and {runs[0].label!r} have different meals; show runs of one scenario together, "
                "and others apart"
            )
    return runs


def in_view(forecasts: Sequence[tuple[Floats, Floats]]) -> list[Floats]:
    """Values of forecasts for which the axis of a picture has room."""
    return [np.clip(values, *_SHOWN_MG_DL) for _, values in forecasts]


def _periods(t_min: Floats, there: npt.NDArray[np.bool_]) -> list[Pair]:
    """Periods in which something is there at samples ``(n,)`` that begin at the times ``(n + 1,)``."""
    return [(float(t_min[first]), float(t_min[after])) for first, after in stretches(there)]


def _above_zero(t_min: Floats, amounts: npt.ArrayLike | None, divisor: float = 1.0) -> list[Pair]:
    """Times and amounts, where there is any."""
    some = () if amounts is None else np.asarray(amounts, float) / divisor
    return [(float(t), float(amount)) for t, amount in zip(t_min, some, strict=False) if amount > 0.0]


def _bouts(t_min: Floats, intensity_pct: npt.ArrayLike | None) -> list[Bout]:
    """Bouts of exercise on the grid of samples ``(n + 1,)``, each with its mean intensity."""
    intensity = np.zeros(t_min.size - 1) if intensity_pct is None else np.asarray(intensity_pct, float)
    return [
        Bout(float(intensity[first:after].mean()), float(t_min[first]), float(t_min[after] - t_min[first]))
        for first, after in stretches(intensity > 0.0)
    ]


def exercise_in_words(bout: Bout | Exercise) -> str:
    """A bout without its time, to be written beside it."""
    return f"{bout.intensity_pct:.3g} % for {bout.duration_min:g} min"


def limits_passed(runs: Sequence[PlottedRun]) -> list[float]:
    """The limits of the patients' models that glucose fell below, each once."""
    return list(dict.fromkeys(run.lowest_valid_mg_dl for run in runs if run.validity_note is not None))


def values_in_words(values: Sequence[float], unit: str) -> str:
    """Text of the distinct values with their unit."""
    return " and ".join(dict.fromkeys(f"{value:.4g}" for value in values)) + f" {unit}"
