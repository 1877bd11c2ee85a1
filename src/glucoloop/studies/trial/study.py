"""A trial carried out: distributions over the people, percentiles over time, figure and page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import polars as pl

from glucoloop.metrics.control_variability import zone_pct
from glucoloop.metrics.metric import result_named
from glucoloop.reporting import Repeat
from glucoloop.reporting.columns import MetricRow, in_other_unit, lines_table
from glucoloop.reporting.descriptions import (
    controllers_facts,
    engine_facts,
    engine_notes,
    person_in_words,
    trial_facts,
)
from glucoloop.reporting.figure_files import figure_files
from glucoloop.situations.run import intravenous_boluses, steady_without_rhythm
from glucoloop.storage.results import Results
from glucoloop.studies.trial import TrialRequest
from glucoloop.studies.trial.figure import plot_trial
from glucoloop.studies.trial.page import trial_page
from glucoloop.studies.trial.report import (
    CaseReport,
    MetricDistribution,
    TrialReport,
    WorstPerson,
    difference_rows,
    margin_conclusions,
    ranges_pct,
)
from glucoloop.studies.trial.report import sentences as sentences
from glucoloop.text import NOT_AVAILABLE, NOT_VALID, how_many, percent
from glucoloop.trials import engine
from glucoloop.trials.folder import BANDS, REPORT, TrialFolder
from glucoloop.trials.shard import BY_WEEK, Counts, add_counts, edges, no_counts, times
from glucoloop.trials.statistics import BAND_QUANTILES, quantiles_of_counts, times_pct
from glucoloop.trials.summary import TrialSummary, summarise_people
from glucoloop.trials.trial import Trial

Bands = Mapping[str, Mapping[str, np.ndarray[Any, np.dtype[np.float64]]]]
"""Quantiles ``(quantiles, times)`` by controller and quantity."""
_SETTLING: Final = "settling_5pct_min"
_FILES: Final = {
    "summary.json": "numbers of each controller",
    BANDS: "percentiles over time",
}
"""Files with the data of a trial, beside its page."""
_HEADLINES: Final = {
    "time_70_180_pct": ("mean", "p5"),
    "time_above_180_pct": ("mean", "p95"),
    "time_above_250_pct": ("mean", "p95"),
    "time_below_70_pct": ("mean", "p95"),
    "time_below_54_pct": ("mean", "p95"),
    "minimum_mg_dl": ("median", "min"),
    "undershoot_mg_dl": ("median", "p95", "max"),
    "peak_mg_dl": ("median", "p95"),
    "mean_mg_dl": ("median",),
    "insulin_total_mU": ("median",),
    "insulin_off_min": ("median", "p95"),
    _SETTLING: ("median",),
}
"""Metrics and their statistics over the people, in the order in which a clinician reads them."""
_OF_GLUCAGON: Final = {"glucagon_total_ug": ("mean", "p95", "max")}
"""The same of glucagon, where it is given."""
_ON_THE_PAGE: Final = {
    **{"mean": ", mean", "median": ", median", "p5": ", 5th percentile", "p95": ", 95th percentile"},
    **dict.fromkeys(("min", "max"), " of the worst person"),
}
"""Statistics in words, after the name of a metric."""
_EVER_BELOW: Final = {"time_below_70_pct": "70", "time_below_54_pct": "54"}
"""Glucose below which people are counted, after the row of a metric."""
_LOST: Final = {
    "below_validity": "was lower than the model is valid for: {}. Read it as severe hypoglycemia; "
    "its depth means nothing.",
    "not_finite": "did not stay finite: {}.",
}
"""Sentences on glucose, by the name of the people affected."""
_NAMED: Final = 10


def trial_of(config: TrialRequest) -> Trial:
    """The trial, which is computed whatever is asked of its results."""
    return config.trial


def notes(config: TrialRequest) -> tuple[str, ...]:
    """Notes on intravenous boluses, and on rhythms."""
    return (*intravenous_boluses(config), *steady_without_rhythm(config))


def results_of(config: TrialRequest, folder: TrialFolder) -> Results:
    """Distributions and percentiles of all people; those with the worst outcomes are simulated again."""
    summary = summarise_people(folder.people, max_insulin_mU_min=float(config.limits.max_mU_min))
    counts, origin, prepared = _counts(folder), folder.recorded, engine.prepare(folder.trial)
    bands = _bands(config, counts)
    numbers, designed = summary.plain, prepared.computed_settings
    numbers["differences"]["margins"] = margin_conclusions(config, numbers["differences"])
    for label, of_label in numbers["controllers"].items():
        of_label |= {**prepared.engines[label], "settled": designed[label]}
        of_label["control_variability_pct"] = zone_pct(summary.cvga_counts[label])
        if BY_WEEK in counts[label]:
            of_label["weeks"] = list(_weeks(bands[label][BY_WEEK], counts[label][BY_WEEK]))
    plain = {"libraries": origin.libraries, "config": origin.config, "setpoint_mg_dl": config.target_mg_dl, **numbers}
    report = TrialReport(
        title=f"{config.population.name}, {how_many(config.people, 'person', 'people')}",
        setpoint_mg_dl=config.target_mg_dl,
        subcutaneous=config.patient.subcutaneous,
        people=numbers["people"],
        infeasible=numbers["unable"]["count"],
        facts={
            **controllers_facts(config.cases, designed, config.start_min or 0.0),
            **trial_facts(config),
            **engine_facts(prepared.engines),
        },
        meals=[(meal.t_min, meal.carbs_g) for meal in config.plan.nominal()],
        exercise=config.bouts,
        faults=config.fault_texts,
        length_min=config.horizon_min,
        start_min=config.start_min or 0.0,
        repeat=Repeat("trial --config trial.toml", config.tree(whole=True), _FILES, explicit=config.tree()),
        cases={label: _case_report(prepared, label, summary, bands[label]) for label in numbers["controllers"]},
        reference=numbers["differences"]["reference"],
        differences=list(difference_rows(config, numbers)),
        conclusions=list(sentences(config, Results(numbers, {}))),
    )
    return Results(
        {**plain, "notes": [*_notes(config, plain), *_of_processors(folder)]},
        {BANDS: pl.concat(_band_tables(config, bands))},
        report,
    )


def files_of(config: TrialRequest, results: Results) -> dict[str, bytes]:
    """Page and figure, by the names of their files."""
    report: TrialReport = results.extra
    return {REPORT: trial_page(report).encode(), **figure_files("figure", plot_trial(report))}


def tables(config: TrialRequest, results: Results) -> Iterator[object]:
    """Statistics of the metrics over the people, and differences of the controllers from the first one."""
    yield lines_table("Over the people", results.plain["controllers"], list(_rows(config, results.plain)))
    differences = results.plain["differences"]
    if differences["controllers"]:
        head = f"Difference from {differences['reference']}, mean and 95 % interval"
        yield lines_table(head, differences["controllers"], list(difference_rows(config, results.plain)))


def _counts(folder: TrialFolder) -> dict[str, Counts]:
    total = no_counts(folder.trial)
    for index in range(folder.trial.shards):
        add_counts(folder.shard(index), folder.trial, index, total)
    return total


def _bands(trial: Trial, counts: Mapping[str, Counts]) -> Bands:
    bins = edges(trial)
    return {
        label: {quantity: quantiles_of_counts(bins[quantity], results) for quantity, results in of_label.items()}
        for label, of_label in counts.items()
    }


def _weeks(quantiles: Any, counts: Any) -> Iterator[dict[str, float]]:
    """Glucose of each week, all samples of all people together: quantiles, and shares of the time in ranges."""
    shares = times_pct(counts)
    for week in range(len(counts)):
        results = {f"p{100 * q:.0f}": of[week] for q, of in zip(BAND_QUANTILES, quantiles, strict=True)}
        yield {"week": week + 1, **results, **{name: share[week] for name, share in shares.items()}}


def _band_tables(trial: Trial, bands: Bands) -> Iterator[pl.DataFrame]:
    t_min = times(trial)
    for label, of_label in bands.items():
        for quantity, quantiles in of_label.items():
            columns = {f"q{100 * q:02.0f}": values for q, values in zip(BAND_QUANTILES, quantiles, strict=True)}
            table = pl.DataFrame({"t_min": t_min[quantity], **columns}).with_columns(pl.col(pl.Float64).fill_nan(None))
            yield table.select(pl.lit(label).alias("controller"), pl.lit(quantity).alias("quantity"), pl.all())


def _case_report(
    prepared: engine.PreparedTrial, label: str, summary: TrialSummary, bands: Mapping[str, Any]
) -> CaseReport:
    trial = prepared.trial
    t_min, plain = times(trial), summary.plain["controllers"][label]
    metrics = plain["metrics"]
    low = {int(name.removesuffix("_mg_dl")): share for name, share in plain["ever_below"].items()}
    return CaseReport(
        bands_t_min=t_min["glucose"],
        glucose_quantiles=dict(zip(BAND_QUANTILES, bands["glucose"], strict=True)),
        insulin_t_min=t_min["insulin"],
        insulin_quantiles=dict(zip(BAND_QUANTILES, bands["insulin"], strict=True)),
        metric_counts={
            metric: MetricDistribution(
                edges=counted.edges,
                counts=counted.counts,
                **{name: metrics[metric][name] for name in ("p5", "median", "p95")},
            )
            for metric, counted in summary.distributions[label].items()
            if metric != _SETTLING or _one_meal(trial)
        },
        cvga_counts=summary.cvga_counts[label],
        time_in_range_pct=ranges_pct(lambda metric: metrics[metric]["mean"]),
        table=dict(_page_numbers(trial, plain)),
        worst=_worst(prepared, label, plain["worst"]),
        ever_below={limit: (share["people"], share["share_pct"]) for limit, share in low.items()},
        not_finite=plain["not_finite"]["count"],
        weeks=plain.get("weeks", ()),
    )


def _one_meal(trial: Trial) -> bool:
    """Whether there is one meal from which settling counts; after many, it counts from the last."""
    return len(trial.plan.nominal()) == 1


def _headlines(trial: Trial) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Metrics and their statistics; settling only after one meal."""
    of_all = _HEADLINES if trial.glucagon is None else {**_HEADLINES, **_OF_GLUCAGON}
    yield from (item for item in of_all.items() if item[0] != _SETTLING or _one_meal(trial))


def _page_numbers(trial: Trial, plain: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str], float | str]]:
    """Headline numbers of one controller by their names and units on the page, from its plain values."""
    for metric, statistics in _headlines(trial):
        how = result_named(metric, trial.further_metrics)
        for statistic in statistics:
            value = plain["metrics"][metric][statistic]
            valid = how.text(value, trial.target_mg_dl) != NOT_VALID
            name = how.title + _ON_THE_PAGE[statistic]
            yield (name, how.unit), value / how.divisor if valid else NOT_VALID
        if metric in _EVER_BELOW:
            limit = _EVER_BELOW[metric]
            yield (f"People ever below {limit} mg/dl", "%"), plain["ever_below"][f"{limit}_mg_dl"]["share_pct"]
    yield ("People ever below the valid range of the model", ""), str(plain["below_validity"]["count"])


def _worst(prepared: engine.PreparedTrial, label: str, people: Sequence[Mapping[str, Any]]) -> list[WorstPerson]:
    """People with the worst outcomes, with their traces; a person is the same in every simulation.

    Of a long run they have the week with the minimum glucose.
    """
    if not people:
        return []
    worst = np.array([person["person"] for person in people], np.int64)
    trial, again = prepared.trial, engine.run_people(prepared, label, worst, traces=True)
    if again.glucose_mg_dl is None or again.insulin_mU_min is None:
        raise TypeError("traces were asked for, but the engine gave none")
    results = []
    for column, person in enumerate(people):
        glucose, insulin = (of[:, column].astype(np.float64) for of in (again.glucose_mg_dl, again.insulin_mU_min))
        note = person_in_words(trial.population, person, trial.seed)
        if trial.counted_weeks:
            week = int(np.nanargmin(glucose[:-1])) // trial.samples_a_week
            first, last = week * trial.samples_a_week, min((week + 1) * trial.samples_a_week, trial.samples)
            glucose, insulin, note = glucose[first : last + 1], insulin[first:last], f"week {week + 1}; {note}"
        t_min = trial.sample_time_min * np.arange(glucose.size, dtype=np.float64)
        results.append(
            WorstPerson(
                person=person["person"],
                minimum_mg_dl=person["metrics"]["minimum_mg_dl"],
                t_min=t_min,
                glucose_mg_dl=glucose,
                insulin_t_min=t_min[:-1],
                insulin_mU_min=insulin,
                note=note,
            )
        )
    return results


def _rows(trial: Trial, summary: Mapping[str, Any]) -> Iterator[MetricRow]:
    controllers = summary["controllers"].values()
    for metric, statistics in _headlines(trial):
        how = result_named(metric, trial.further_metrics)
        for position, statistic in enumerate(statistics):
            values = [controller["metrics"][metric][statistic] for controller in controllers]
            cells = [NOT_AVAILABLE if v is None else how.text(v, summary["setpoint_mg_dl"]) for v in values]
            title, others = "" if position else how.title, in_other_unit(how, cells, values)
            yield MetricRow("", title, how.unit, cells, others, statistic=statistic)
        if metric in _EVER_BELOW:
            limit = _EVER_BELOW[metric]
            counts = (controller["ever_below"][f"{limit}_mg_dl"] for controller in controllers)
            shares = (
                NOT_AVAILABLE if count["share_pct"] is None else f"{count['people']} ({percent(count['share_pct'])})"
                for count in counts
            )
            yield MetricRow("", f"People ever below {limit} mg/dl", "", list(shares), statistic="number")
    yield MetricRow("", "Engine", "", [controller["engine"] for controller in controllers])


def _of_processors(folder: TrialFolder) -> Iterator[str]:
    """Note on people whom other kinds of processors computed."""
    if others := folder.other_processors:
        kinds = "another kind of processor" if len(others) == 1 else f"{len(others)} other kinds of processors"
        yield (
            f"Some people were computed by {kinds} ({', '.join(others)}): portable arithmetic rounds the loops alike, "
            "and what JAX and SciPy compute before and after them may differ in the last digits."
        )


def _notes(trial: Trial, summary: Mapping[str, Any]) -> Iterator[str]:
    """Notes on people who are left out, and on people whose basal rate is beyond the pump."""
    infeasible, beyond = summary["unable"], summary["basal_beyond_pump"]
    setpoint = f"{summary['setpoint_mg_dl']:g} mg/dl"
    if count := infeasible["count"]:
        yield (
            f"Of {how_many(summary['people'], 'person', 'people')} {how_many(count, 'has', 'have')} no basal rate for "
            f"{setpoint}: {_persons(trial, infeasible)}."
        )
    if beyond["count"]:
        yield (
            f"{how_many(beyond['count'], 'person', 'people')} would need more than the pump gives to rest there: "
            f"{_persons(trial, beyond)}."
        )
    yield from engine_notes(summary["controllers"])
    for label, plain in summary["controllers"].items():
        for name, happened in _LOST.items():
            if plain[name]["count"]:
                who = how_many(plain[name]["count"], "person", "people")
                yield f"{label}: glucose of {who} {happened.format(_persons(trial, plain[name]))}"


def _persons(trial: Trial, named: Mapping[str, Any]) -> str:
    names = ", ".join(trial.population.called(trial.seed, named["person"][:_NAMED]))
    return f"person {names}" if named["count"] <= _NAMED else f"person {names} and others, see summary.json"
