"""Closed loops of controllers in one situation carried out: their numbers, tables, pictures and sentences."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.bounds import OptimalDoses, distance_to_bound
from glucoloop.bounds.optimal_doses import check_samples
from glucoloop.build.titration import profile_of
from glucoloop.models.settings import FileComponent
from glucoloop.records.nightscout_profile import document_of
from glucoloop.refusal import Refusal
from glucoloop.reporting import Repeat, comparison_table, interactive_page, metrics_table, plot
from glucoloop.reporting.columns import Column, terminal_table
from glucoloop.reporting.descriptions import comparison_facts, run_facts
from glucoloop.reporting.figure_files import figure_files
from glucoloop.simulation import Trace
from glucoloop.situations.run import Run
from glucoloop.situations.therapy_text import NUMBERS, read_change
from glucoloop.storage import results
from glucoloop.storage.results import Results
from glucoloop.studies.bound.study import bound_of_run
from glucoloop.studies.closed_loop import Outcome, close_the_loop
from glucoloop.studies.run import Comparison
from glucoloop.therapy import TARGET, TherapyChange
from glucoloop.trials.statistics import Moments, mean_interval
from glucoloop.units import MIN_PER_DAY

_FILES: Final = {
    "trace.csv": "one row per sample",
    "metrics.json": "all metrics",
    "glucose_1min.parquet": "glucose every minute",
}
"""Files with the data of runs, beside their page."""
_FORECASTS: Final = {"forecasts.csv": "one row per decision and time ahead of it"}
"""Files with the forecasts of a run, where there are any."""
_DIFFERENCES: Final = {
    "time_70_180_pct": "70-180\n(%)",
    "time_below_70_pct": "< 70\n(%)",
    "time_above_180_pct": "> 180\n(%)",
    "mean_mg_dl": "mean\n(mg/dl)",
}
"""Numbers in which a changed therapy is compared with the one as it is, with their headings."""
_MIN_DAYS: Final = 3
"""Least number of days over which differences have an interval."""


@dataclass(frozen=True)
class ClosedLoops:
    """The loops that were closed, by label, and the bound for all of them."""

    outcomes: Mapping[str, Outcome]
    bound: OptimalDoses | None = None
    unchanged: Mapping[str, str] = field(default_factory=dict)
    """Label of the case with the therapy as it is, by that of each case under a change."""

    def differences(self) -> dict[str, dict[str, float | None]]:
        """Numbers of each case under a change, less those with the therapy as it is."""
        results: dict[str, dict[str, float | None]] = {}
        for label, of in self.unchanged.items():
            numbers: list[dict[str, Any]] = [self.outcomes[at].metrics.as_dict() for at in (label, of)]
            pairs = {name: [of_case[name] for of_case in numbers] for name in _DIFFERENCES}
            results[label] = {name: None if None in pair else pair[0] - pair[1] for name, pair in pairs.items()}
        return results

    def intervals(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Interval of 95 % of each difference over the whole days of the run; empty for fewer than three days.

        It is Student's t, of the differences of each day.
        """
        by_day = {label: _by_day(outcome.trace) for label, outcome in self.outcomes.items()} if self.unchanged else {}
        results: dict[str, dict[str, tuple[float, float]]] = {}
        for label, of in self.unchanged.items():
            for name, values in by_day[label].items():
                if values.size >= _MIN_DAYS and np.isfinite(values).all() and np.isfinite(by_day[of][name]).all():
                    moments = Moments()
                    moments.add(values - by_day[of][name])
                    results.setdefault(label, {})[name] = mean_interval(moments)
        return results

    def distances(self) -> dict[str, Any] | None:
        """Distance of each from the bound, which is one of rates: it does not hold where boluses are given."""
        if self.bound is None:
            return None
        return {
            label: distance_to_bound(outcome.trace.fine_glucose_mg_dl, self.bound)
            for label, outcome in self.outcomes.items()
            if not _gave_boluses(outcome)
        }


def notes(config: Run) -> tuple[str, ...]:
    """Refuse several controllers outside a comparison, and a bound over too many samples, before a loop is closed."""
    if not isinstance(config, Comparison):
        _ = config.case
    elif config.bound:
        check_samples(config.horizon_min, config.sample_time_min)
    return tuple(_notes_on_changes(config))


def _notes_on_changes(config: Run) -> Iterator[str]:
    """Sentences on changes without effect: outside of the run, or on some of the controllers."""
    for text in config.changes:
        change = read_change(text)
        if isinstance(change, TherapyChange) and config.start_min is not None:
            samples = np.arange(0.0, config.horizon_min, config.sample_time_min) + config.start_min
            if not any(map(change.holds, np.unique(samples % MIN_PER_DAY).tolist())):
                yield f"The change {text!r} has no effect: its hours lie outside of the run."
        if isinstance(config, Comparison):
            for case in config.cases:
                why = config.without_effect(text, case)
                if why:
                    yield f"The change {text!r} has no effect on {case.label}, which has no case with it: {why}."


def results_of(config: Run, progress: Callable[[str], None]) -> Results:
    """Close the loop of each controller; Refusal for one that is not possible, with its label."""
    outcomes: dict[str, Outcome] = {}
    as_it_is = config.with_changes(()) if isinstance(config, Comparison) else config
    for case in config.cases:
        try:
            outcomes[case.label] = close_the_loop(as_it_is, case)
        except Refusal as error:
            if isinstance(config, Comparison):
                raise error.within(f"case {case.label!r}") from error
            raise
        progress(f"the loop of {case.label}")
    if not isinstance(config, Comparison):
        [outcome] = outcomes.values()
        return results_of_loop(outcome, outcome.report(), outcome.notes)
    unchanged = {}
    for of in config.changed_cases:
        run = dataclasses.replace(as_it_is, changes=(of.change,))
        outcomes[of.label] = close_the_loop(run, dataclasses.replace(of.case, label=of.label))
        unchanged[of.label] = of.case.label
        progress(f"the loop of {of.label}")
    loops = ClosedLoops(outcomes, bound_of_run(config) if config.bound else None, unchanged)
    plain: dict[str, Any] = {"cases": {label: outcome.report() for label, outcome in outcomes.items()}}
    if unchanged:
        intervals = loops.intervals()
        plain["changes"] = {
            label: {"of": unchanged[label], "difference": numbers, "interval": intervals.get(label)}
            for label, numbers in loops.differences().items()
        }
    if loops.bound is not None:
        plain["bound"] = {
            "known_after_min": loops.bound.known_after_min,
            "deviation_mg_dl": loops.bound.bound,
            "converged": loops.bound.converged,
            "distances": {label: dataclasses.asdict(distance) for label, distance in (loops.distances() or {}).items()},
        }
    without = [label for label, of in outcomes.items() if config.forecasts and of.trace.forecast is None]
    plain["notes"] = [
        *([f"No forecast is made by: {', '.join(without)}."] if 0 < len(without) < len(outcomes) else ()),
        *(
            f"{label}: {text}"
            for label, outcome in outcomes.items()
            if label not in unchanged
            for text in outcome.notes
        ),
        *(
            f"{label}: this change has no effect in this run."
            for label, of in unchanged.items()
            if _same(outcomes[label].trace, outcomes[of].trace)
        ),
        *_notes_on_bound(config, loops),
    ]
    samples, minutes = (
        results.stacked({label: table(outcome.trace) for label, outcome in outcomes.items()})
        for table in (Trace.to_polars, results.minute_table)
    )
    return Results(plain, {**_tables(samples, minutes), **_forecasts(outcomes)}, loops)


def results_of_loop(outcome: Outcome, report: Mapping[str, Any], notes: tuple[str, ...]) -> Results:
    """Results of one loop."""
    tables = _tables(outcome.trace.to_polars(), results.minute_table(outcome.trace))
    if outcome.trace.forecast is not None:
        tables |= _as_files("forecasts", outcome.trace.forecasts_to_polars())
    return Results(
        {**report, "notes": list(notes)}, tables, ClosedLoops({outcome.case.controller.display_name: outcome})
    )


def _tables(samples: pl.DataFrame, minutes: pl.DataFrame) -> dict[str, pl.DataFrame]:
    return {**_as_files("trace", samples), "glucose_1min.parquet": minutes}


def _forecasts(outcomes: Mapping[str, Outcome]) -> dict[str, pl.DataFrame]:
    """Forecasts of the cases that have any."""
    tables = {label: of.trace.forecasts_to_polars() for label, of in outcomes.items() if of.trace.forecast is not None}
    return _as_files("forecasts", results.stacked(tables)) if tables else {}


def _as_files(name: str, table: pl.DataFrame) -> dict[str, pl.DataFrame]:
    return {f"{name}.parquet": table, f"{name}.csv": table}


def _by_day(trace: Trace) -> dict[str, npt.NDArray[np.float64]]:
    """The numbers of `_DIFFERENCES` of each whole day ``(days,)``."""
    t_min, glucose = np.asarray(trace.fine_t_min), np.asarray(trace.fine_glucose_mg_dl, np.float64)
    each = round(MIN_PER_DAY / float(t_min[1] - t_min[0]))
    days = (glucose.size - 1) // each
    of_day = glucose[1 : 1 + days * each].reshape(days, each)
    inside = {
        "time_70_180_pct": (of_day >= 70.0) & (of_day <= 180.0),
        "time_below_70_pct": of_day < 70.0,
        "time_above_180_pct": of_day > 180.0,
    }
    known = np.where(np.isfinite(of_day), 1.0, np.nan)
    shares = {name: 100.0 * (there * known).mean(axis=1) for name, there in inside.items()}
    return {**shares, "mean_mg_dl": of_day.mean(axis=1)}


def _sentences_on_changes(loops: ClosedLoops) -> Iterator[str]:
    """Sentences on the difference by each change, with its interval over the days."""
    intervals, differences = loops.intervals(), loops.differences()
    for label, of in intervals.items():
        inside, below = (
            f"{differences[label][name]:+z.1f}" + "{} ({:+z.1f} to {:+z.1f})".format(unit, *of[name])
            for name, unit in (("time_70_180_pct", " percentage points"), ("time_below_70_pct", ""))
        )
        yield (
            f"{label} instead of the therapy as it is: time from 70 to 180 mg/dl {inside}, time below 70 mg/dl {below}."
        )
    if intervals:
        yield "The ranges are intervals of 95 % over the days of this person (Student's t); people differ more."


def _gave_boluses(outcome: Outcome) -> bool:
    return outcome.trace.bolus_mU is not None and bool((outcome.trace.bolus_mU > 0.0).any())


def _same(one: Trace, other: Trace) -> bool:
    """Whether two traces have the same insulin and glucose."""
    names = ("insulin_mU_min", "bolus_mU", "fine_glucose_mg_dl")
    return all(np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in names)


def _notes_on_bound(config: Comparison, loops: ClosedLoops) -> Iterator[str]:
    bound = loops.bound
    if bound is None:
        return
    after_min = bound.known_after_min
    information = f"{after_min:g} min after its start" if after_min > 0.0 else "from its start"
    yield (
        f"The bound is that of a controller that knows each meal {information}, the patient and the pump's limits"
        f"{'' if bound.converged else '; it did not converge, so it is not a bound'}."
    )
    for label, outcome in loops.outcomes.items():
        if _gave_boluses(outcome):
            yield (
                f"{label} gave boluses. The bound is of rates alone, so it does not hold for {label}, which has no "
                "distance from it."
            )
    if len(config.meals) > 1:
        yield "A controller that prepares for a likely meal could do better."


def tables(config: Run, results: Results) -> Iterator[object]:
    """The metrics, one column for each controller, with the distances from the bound."""
    loops: ClosedLoops = results.extra
    metrics = {label: outcome.metrics for label, outcome in loops.outcomes.items()}
    if isinstance(config, Comparison):
        if loops.unchanged:
            lines = [(label, [numbers]) for label, numbers in loops.differences().items()]
            columns = [Column(name=name, short=short, text="{:+z.1f}".format) for name, short in _DIFFERENCES.items()]
            yield terminal_table("Change", [("Difference from the therapy as it is", lines)], columns)
        yield comparison_table(metrics, loops.distances(), config.start_min or 0.0)
    else:
        yield metrics_table(next(iter(metrics.values())), config.start_min or 0.0)


def sentences(config: Run, results: Results) -> Iterator[str]:
    """Sentences that a clinician would say first of each loop."""
    if "cases" not in results.plain:
        if config.changes:
            yield f"The therapy is changed: {'; '.join(config.changes)}."
        yield from results.plain["summary"]["sentences"]
        return
    yield from _sentences_on_changes(results.extra)
    for label, case in results.plain["cases"].items():
        yield from (f"{label}: {text}" for text in case["summary"]["sentences"])


def files_of(config: Run, results: Results) -> dict[str, bytes]:
    """Page and figure, the models, and the configuration, which names them."""
    loops: ClosedLoops = results.extra
    outcomes, models = loops.outcomes, _models(config, loops)
    files = {name: text.encode() for name, text in models.values()}
    if isinstance(config, Comparison):
        command, title = "compare", f"Comparison at {config.place}"
        facts = comparison_facts(config, {label: outcome.computed_settings for label, outcome in outcomes.items()})
        facts |= {f"Change: {label}": _in_words(numbers) for label, numbers in loops.differences().items()}
    else:
        [(name, outcome)] = outcomes.items()
        command, title = "run" if type(config) is Run else "hil", f"{name} at {config.place}"
        facts = run_facts(config, outcome.case, outcome.computed_settings)
        facts |= {"Changes of the therapy": "; ".join(config.changes)} if config.changes else {}
    files |= _profile_file(config)
    again = _repeat(config, loops, command, {label: name for label, (name, _) in models.items()})
    first = next(iter(outcomes.values()))
    traces = {label: outcome.trace for label, outcome in outcomes.items()}
    metrics = {label: outcome.metrics for label, outcome in outcomes.items()}
    figure = plot(
        traces,
        title=title,
        subcutaneous=config.patient.subcutaneous,
        start_min=config.start_min,
        limits=config.limits,
    )
    page = interactive_page(
        traces if len(traces) > 1 else first.trace,
        metrics if len(metrics) > 1 else first.metrics,
        title=title,
        limits=config.limits,
        faults=config.fault_texts,
        start_min=config.start_min or 0.0,
        facts=facts,
        repeat=again,
    )
    return {
        **files,
        f"{command}.toml": again.text.encode(),
        **figure_files("figure", figure),
        "figure.html": page.encode(),
    }


def _profile_file(config: Run) -> dict[str, bytes]:
    """Therapy by the clock as a profile of Nightscout, without its overrides; empty where it is constant.

    That of a comparison is the therapy as it is, without the changes beside it.
    """
    changed: Run = dataclasses.replace(config, overrides=())
    changed = changed.with_changes(changed.changes if changed.changes_together else ())
    schedule, own = changed.schedule, profile_of(changed)
    if not schedule.changes:
        return {}
    starts = schedule.starts_min()
    segments: dict[str, list[tuple[float, float]]] = {name: [] for name in NUMBERS}
    for start, profile in zip(starts, schedule.profiles(own, 0.0), strict=True):
        target = schedule.value(TARGET, changed.target_mg_dl, start)
        numbers = (profile.basal_mU_min, profile.carb_ratio(), profile.correction_factor(), target)
        for (name, number), value in zip(NUMBERS.items(), numbers, strict=True):
            segments[name].append((start, float(value) / number.scale))
    return {"profile.json": json.dumps([document_of(segments)], indent=2).encode()}


def _in_words(differences: Mapping[str, float | None]) -> str:
    """Difference from the therapy as it is, in words."""
    words = (heading.split("\n")[0] for heading in _DIFFERENCES.values())
    texts = ("not known" if value is None else f"{value:+z.1f}" for value in differences.values())
    named = dict(zip(words, texts, strict=True))
    points = ", ".join(f"{word} mg/dl {text}" for word, text in named.items() if word != "mean")
    return f"{points} percentage points; mean {named['mean']} mg/dl"


def _models(config: Run, loops: ClosedLoops) -> dict[str, tuple[str, str]]:
    """Name and text of the file of each model, by the label of the case."""
    results = {}
    for number, outcome in enumerate(loops.outcomes.values(), start=1):
        if outcome.model is not None and outcome.case.label not in loops.unchanged:
            label = outcome.case.label
            short = re.sub(r"[^a-z0-9]+", "-", label.lower()).strip("-") or "case"
            name = f"model-{number}-{short}.json" if isinstance(config, Comparison) else "model.json"
            results[label] = name, outcome.model.text()
    return results


def _repeat(config: Run, loops: ClosedLoops, command: str, models: Mapping[str, str]) -> Repeat:
    """Command and configuration that repeat the loops from the folder alone, with the models beside it."""
    used, explicit = config.tree(whole=True), config.tree()
    by_label = {outcome.case.label: outcome for outcome in loops.outcomes.values()}
    model_files = {
        case.label: {"name": FileComponent.name, "path": models[case.label]}
        for case in config.cases
        if isinstance(case.model, FileComponent) and case.label in models
    }
    for table in used["controller"]:
        label = table["label"]
        designed = by_label[label].computed_settings
        table.update({"settled": dict(designed)} if designed else {})
        table.update({"model": model_files[label]} if label in model_files else {})
    if model_files:
        explicit.pop("model", None)
        explicit["controller"] = explicit.get("controller") or [case.tree() for case in config.cases]
        for table, case in zip(explicit["controller"], config.cases, strict=True):
            table.update({"model": model_files[case.label]} if case.label in model_files else {})
    forecasts = any(outcome.trace.forecast is not None for outcome in loops.outcomes.values())
    files = {**_FILES, **(_FORECASTS if forecasts else {})}
    return Repeat(f"{command} --config {command}.toml", used, files, explicit=explicit)
