"""Self-contained page of the closed loop: one file that needs no network and can be zoomed and shared."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from glucoloop.display_units import other_number
from glucoloop.faults import FAULTS, FaultComponent
from glucoloop.metrics import LOWEST_GLUCOSE_MG_DL, TARGET_RANGE_MG_DL, Metrics, clinical_summary
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.reporting.charts import (
    BOLUS,
    CARBS_ON_BOARD,
    GLUCAGON,
    GLUCOSE,
    INSULIN,
    INSULIN_ON_BOARD,
    Panel,
    Plot,
    PlottedQuantity,
    extent,
    thinned,
)
from glucoloop.reporting.columns import metric_rows
from glucoloop.reporting.descriptions import fault_in_words, windows
from glucoloop.reporting.labelled_traces import (
    STATUS_WORDS,
    Floats,
    Pair,
    PlottedRun,
    exercise_in_words,
    in_view,
    labelled_runs,
    limits_passed,
    moment_text,
    periods_below,
    periods_text,
    values_in_words,
)
from glucoloop.reporting.template import Repeat, render
from glucoloop.simulation import Trace
from glucoloop.text import glucose_text
from glucoloop.units import MIN_PER_DAY

_LOW_MG_DL: Final = (54.0, 70.0)
_HIGH_MG_DL: Final = (250.0, 180.0)
_MAX_POINTS: Final = 40_000
"""Largest number of points of all curves of a page, but for `_MIN_POINTS` of each."""
_MIN_POINTS: Final = 200
_MAX_ROWS: Final = 61
_MAX_BOLUSES: Final = 12
_MAX_LANES: Final = 8


def interactive_page(
    traces: Trace | Mapping[str, Trace],
    metrics: Metrics | Mapping[str, Metrics],
    *,
    title: str = "Closed loop",
    limits: DoseLimits = PARKER_1999_LIMITS,
    lowest_glucose_mg_dl: float = LOWEST_GLUCOSE_MG_DL,
    faults: Sequence[str] = (),
    start_min: float = 0.0,
    facts: Mapping[str, str] | None = None,
    repeat: Repeat | None = None,
) -> str:
    """One run, or several of the same scenario, as a self-contained HTML page.

    Glucose and insulin share their time axis. A moment, chosen by pointing or by a slider, tells glucose in mg/dl and
    mmol/l and insulin in mU/min and U/h; time can be zoomed. Above stands a summary in the order in which a clinician
    reads it, below the events in words, the metrics, numbers of the picture, and the situation.

    Parameters
    ----------
    traces : Trace or mapping of str to Trace
        Traces of one person each.
    metrics : Metrics or mapping of str to Metrics
        Metrics of these runs, under the same labels.
    limits : DoseLimits
        Limits of the pump.
    lowest_glucose_mg_dl : float
        The bound on glucose.
    faults : sequence of str
        Faults of sensor and pump in all runs, each as its text, whose times are marked.
    start_min : float
        Time of day at the start, after midnight.
    facts : mapping, optional
        Settings of the runs by name.
    repeat : Repeat, optional
        Command and configuration that repeat the runs.

    Returns
    -------
    str
        HTML; labels and the title are shown as they are, whatever they hold.

    Raises
    ------
    ValueError
        If there is no trace, one is of many people, the meals differ, or the labels of the metrics differ from those of
        the traces.
    """
    runs = labelled_runs(traces)
    labels = [run.label for run in runs]
    single = isinstance(traces, Trace)
    by_label = {labels[0]: metrics} if isinstance(metrics, Metrics) else dict(metrics)
    if isinstance(metrics, Metrics) != single or list(by_label) != labels:
        raise Refusal(
            f"there are traces of {labels} but metrics of {list(by_label)}; give both under the same labels, in the "
            "same order"
        )
    end_min = max(float(run.t_min[-1]) for run in runs)
    panels = [_glucose_panel(runs, lowest_glucose_mg_dl), _insulin_panel(runs, limits)]
    if any(run.boluses or run.command_boluses for run in runs):
        panels.append(_stems_panel(runs, BOLUS, [(run.command_boluses, run.boluses) for run in runs]))
    if any(run.glucagon or run.command_glucagon for run in runs):
        panels.append(_stems_panel(runs, GLUCAGON, [(run.command_glucagon, run.glucagon) for run in runs]))
    on_board = (
        (INSULIN_ON_BOARD, [run.insulin_on_board_U for run in runs]),
        (CARBS_ON_BOARD, [run.carbs_on_board_g for run in runs]),
    )
    panels += [_on_board_panel(runs, *of) for of in on_board if any(values.any() for values in of[1])]
    chosen = [FAULTS.choose(fault) for fault in faults]
    mark_faults(panels, chosen, end_min)
    named = dict.fromkeys(by_label, traces) if isinstance(traces, Trace) else traces
    return render(
        Path(__file__).with_name("templates") / "run.html",
        title,
        facts=facts,
        repeat=repeat,
        script=True,
        summaries={label: clinical_summary(named[label], run).sentences() for label, run in by_label.items()},
        labels=labels,
        rules=[rule for panel in panels for rule in panel.rules],
        faults=faults,
        dots=any(run.reading_t_min.size for run in runs),
        forecasts_every_min=max(run.forecasts_every_min for run in runs),
        commanded=len(panels[1].lines) > len(runs),
        plot=Plot("Glucose and insulin", end_min, panels, list(_lanes(runs, chosen, end_min, start_min)), start_min),
        events=list(_events(runs, chosen, start_min)),
        metrics=["Value"] if single else labels,
        rows=metric_rows(by_label, start_min),
        **_numbers(runs, start_min),
    )


def _name(runs: Sequence[PlottedRun], run: PlottedRun, what: str, apart: str = ", ") -> str:
    """Text on a run, with the label of the run where there are several."""
    return f"{run.label}{apart}{what}" if len(runs) > 1 else what


def glucose_panel(setpoints: Sequence[float], lowest_mg_dl: float, curves: Sequence[Floats], **about: Any) -> Panel:
    """Panel with room for the curves shown, on which the range of the target, setpoints and the bound are drawn."""
    low, high = extent([*setpoints, lowest_mg_dl], *curves)
    margin = 0.05 * (high - low)
    panel = Panel(GLUCOSE, (low - margin, high + margin), band=TARGET_RANGE_MG_DL, **about)
    panel.rule(setpoints, 0, f"setpoint {values_in_words(setpoints, 'mg/dl')}")
    panel.rule([lowest_mg_dl], 1, f"lowest allowed {lowest_mg_dl:g} mg/dl")
    return panel


def _glucose_panel(runs: Sequence[PlottedRun], lowest_mg_dl: float) -> Panel:
    panel = glucose_panel(
        [run.setpoint_mg_dl for run in runs],
        lowest_mg_dl,
        [part for run in runs for part in (run.shown_glucose_mg_dl, run.reading_mg_dl, *in_view(run.forecasts))],
        height=310,
        marks=[
            *((t_min, f"{carbs_g:.4g} g") for t_min, carbs_g in runs[0].meals),
            *((bout.t_min, exercise_in_words(bout)) for bout in runs[0].exercise),
        ],
    )
    if passed := limits_passed(runs):
        panel.rule(passed, 4, f"model not valid below {values_in_words(passed, 'mg/dl')}")
    most = max(_MIN_POINTS, _MAX_POINTS // (3 * len(runs)))
    for index, run in enumerate(runs):
        if run.reading_t_min.size:
            panel.dot(run.reading_t_min, run.reading_mg_dl, index, run=index)
        drawn = thinned(run.fine_t_min, run.shown_glucose_mg_dl, most)
        panel.line(*drawn, index, dash=index, run=index, name=_name(runs, run, "glucose"))
        for times, values in run.forecasts:
            panel.line(times, values, index, kind="ahead", run=index)
    return panel


def _insulin_panel(runs: Sequence[PlottedRun], limits: DoseLimits) -> Panel:
    bounds = float(limits.min_mU_min), float(limits.max_mU_min)
    basal = [run.basal_insulin_mU_min for run in runs]
    # within the limits of the pump, so that a command beyond them does not squeeze the other rates
    commanded = [np.clip(run.command_mU_min, *bounds) for run in runs]
    high = 1.08 * extent([0.0, *basal], *(run.insulin_mU_min for run in runs), *commanded)[1]
    panel = Panel(INSULIN, (0.0, high), height=185)
    panel.rule(basal, 2, f"basal {values_in_words(basal, 'mU/min')}")
    seen = [bound for bound in bounds if 0.0 < bound <= high]
    panel.rule(seen, 3, f"pump limits {values_in_words(bounds, 'mU/min')}")
    for index, (run, config) in enumerate(zip(runs, commanded, strict=True)):
        # a command is drawn where it differs from the delivered rate by more than the picture shows
        if not np.allclose(config, run.insulin_mU_min, rtol=0.0, atol=INSULIN.step, equal_nan=True):
            look = {"kind": "asked", "dash": 2, "run": index}
            panel.line(run.t_min, config[:-1], index, **look, name=_name(runs, run, "commanded"))
        delivered = run.insulin_mU_min[:-1]
        panel.line(run.t_min, delivered, index, dash=index, run=index, name=_name(runs, run, "delivered"))
    return panel


def _stems_panel(
    runs: Sequence[PlottedRun], quantity: PlottedQuantity, amounts: Sequence[tuple[Sequence[Pair], Sequence[Pair]]]
) -> Panel:
    """Amounts that each run commanded and delivered, as stems."""
    delivered = amounts[0][1]
    few = len(runs) == 1 and len(delivered) <= _MAX_BOLUSES
    panel = Panel(
        quantity,
        (0.0, 1.1 * max(size for of_run in amounts for stems in of_run for _, size in stems)),
        height=100,
        marks=[(t_min, f"{size:.3g} {quantity.unit}") for t_min, size in delivered] if few else (),
    )
    for index, of_run in enumerate(amounts):
        for stems, kind in zip(of_run, ("asked", "stems"), strict=True):
            t = np.repeat([t_min for t_min, _ in stems], 3)
            panel.line(t, np.ravel([(0.0, size, np.nan) for _, size in stems]), index, kind=kind, run=index)
    return panel


def _on_board_panel(runs: Sequence[PlottedRun], quantity: PlottedQuantity, amounts: Sequence[Floats]) -> Panel:
    """Amount on board of each run at its samples."""
    low, high = extent([0.0], *amounts)
    panel = Panel(quantity, (1.05 * low, 1.08 * high), height=100)
    for index, (run, values) in enumerate(zip(runs, amounts, strict=True)):
        panel.line(run.t_min[:-1], values, index, dash=index, run=index, name=_name(runs, run, quantity.name.lower()))
    return panel


def mark_faults(panels: Sequence[Panel], faults: Iterable[FaultComponent], end_min: float) -> None:
    """Shade the times of faults below the curves: those of the sensor in the first panel, of the pump in the second."""
    for fault, window in windows(faults, end_min):
        panels[0 if fault.part == "sensor" else 1].spans.append(window)


def _lanes(
    runs: Sequence[PlottedRun], faults: Sequence[FaultComponent], end_min: float, start_min: float
) -> Iterator[dict[str, Any]]:
    """Times of faults, and what the guard, the pump and the sensor did, one line of time for each."""
    for fault, window in windows(faults, end_min):
        yield {"name": f"Fault: {fault_in_words(fault, start_min)}", "rows": [{"periods": [window], "colour": 1}]}
    for name in STATUS_WORDS.values():
        rows = [{"periods": run.periods.get(name, []), "colour": index} for index, run in enumerate(runs)]
        if any(row["periods"] for row in rows):
            yield {"name": name, "rows": rows if len(runs) <= _MAX_LANES else [row for row in rows if row["periods"]]}


def _doses_text(doses: Sequence[Pair], noun: str, unit: str, end_min: float, start_min: float) -> str:
    if not doses:
        return "none"
    total = sum(size for _, size in doses)
    if len(doses) > _MAX_BOLUSES:
        return f"{len(doses)} {noun}, {total:.4g} {unit} in all"
    return "; ".join(f"{size:.4g} {unit} at {moment_text(t_min, end_min, start_min)}" for t_min, size in doses)


def _events(runs: Sequence[PlottedRun], faults: Sequence[FaultComponent], start_min: float) -> Iterator[str]:
    """Meals, faults, boluses, high and low glucose and what the guard did, in words."""
    end_min = float(runs[0].t_min[-1])
    meals = (f"{carbs:.4g} g at {moment_text(t, end_min, start_min)}" for t, carbs in runs[0].meals)
    yield f"Meals: {'; '.join(meals) or 'none'}."
    if runs[0].exercise:
        bouts = (
            f"{exercise_in_words(bout)} at {moment_text(bout.t_min, end_min, start_min)}" for bout in runs[0].exercise
        )
        yield f"Exercise: {'; '.join(bouts)}."
    yield from (f"Fault: {fault_in_words(fault, start_min)}." for fault in faults)
    for run in runs:
        yield from (_name(runs, run, event, ": ") for event in _events_of(run, start_min))


def _events_of(run: PlottedRun, start_min: float) -> Iterator[str]:
    end_min = float(run.t_min[-1])
    for where, limits, sign in (("above", _HIGH_MG_DL, -1.0), ("below", _LOW_MG_DL, 1.0)):
        for limit in limits:
            if beyond := periods_below(run.fine_t_min, sign * run.fine_glucose_mg_dl, sign * limit):
                yield f"Glucose {where} {limit:g} mg/dl {periods_text(beyond, end_min, start_min)}."
    if run.boluses or run.command_boluses:
        yield f"Boluses delivered: {_doses_text(run.boluses, 'boluses', 'U', end_min, start_min)}."
    if run.glucagon or run.command_glucagon:
        yield f"Glucagon delivered: {_doses_text(run.glucagon, 'doses', 'ug', end_min, start_min)}."
    yield from (f"{name} {periods_text(periods, end_min, start_min)}." for name, periods in run.periods.items())
    if run.validity_note is not None:
        yield run.validity_note


def _numbers(runs: Sequence[PlottedRun], start_min: float) -> dict[str, Any]:
    """Some of the samples as a table, in place of the picture."""
    t_min = runs[0].t_min
    every = -(-(t_min.size - 1) // max(13, _MAX_ROWS // len(runs)))
    end_min = float(t_min[-1])
    in_days = end_min > MIN_PER_DAY
    heads, numbers = ["Time" if in_days else "Time (min)"], []
    row: list[Any]
    for run in runs:
        heads += [_name(runs, run, what, ": ") for what in ("glucose (mg/dl)", "insulin (mU/min)")]
    for place in range(0, t_min.size, every):
        row = [moment_text(t_min[place], end_min, start_min) if in_days else f"{t_min[place]:g}"]
        for run in runs:
            if place < run.t_min.size:
                rate = float(run.insulin_mU_min[place])
                glucose = np.interp(run.t_min[place], run.fine_t_min, run.fine_glucose_mg_dl)
                texts = ((glucose_text(float(glucose)), float(glucose), "mg/dl"), (f"{rate:.2f}", rate, "mU/min"))
                row += [(text, other_number(text, value, unit), unit) for text, value, unit in texts]
        numbers.append(row)
    return {"every": f"{every * (t_min[1] - t_min[0]):g}", "heads": heads, "numbers": numbers}
