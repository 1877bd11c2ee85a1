"""A trial carried out: distributions over the people, percentiles over time, figure and page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import polars as pl

from glucoloop.cohorts import engine
from glucoloop.cohorts.counts import BAND_QUANTILES, quantiles_of_counts
from glucoloop.cohorts.summary import CaseSummary, summarise_people
from glucoloop.cohorts.trial import Trial
from glucoloop.metrics.control_variability import zone_pct
from glucoloop.parts.metrics import described
from glucoloop.printable import NOT_AVAILABLE, NOT_VALID, glucose_text, how_many, percent
from glucoloop.report import CaseReport, MetricDistribution, Repeat, TrialReport, WorstPerson, plot_trial, trial_page
from glucoloop.report.columns import MetricRow, lines_table
from glucoloop.report.descriptions import (
    controllers_facts,
    engine_facts,
    engine_notes,
    person_in_words,
    trial_facts,
)
from glucoloop.report.print_figure import figure_files
from glucoloop.report.trial_report import ranges_pct
from glucoloop.situations.warnings import boluses_into_a_vein
from glucoloop.storage.findings import Findings
from glucoloop.storage.trials.folder import BANDS, REPORT, TrialFolder
from glucoloop.storage.trials.header import read_header
from glucoloop.storage.trials.shard import Counts, add_counts, edges, no_counts, times
from glucoloop.units import MIN_PER_H, MU_PER_U, mmol_l_from_mg_dl

Bands = Mapping[str, Mapping[str, np.ndarray[Any, np.dtype[np.float64]]]]
"""Quantiles ``(quantiles, times)`` by controller and quantity."""
_SETTLING: Final = "settling_5pct_min"
_FILES: Final = {
    "summary.json": "numbers of each controller",
    BANDS: "percentiles over time",
}
"""Files with the data of a trial, beside its page."""
_TABLE: Final = (
    ("time_70_180_pct", ("mean", "p5")),
    ("time_above_180_pct", ("mean", "p95")),
    ("time_above_250_pct", ("mean", "p95")),
    ("time_below_70_pct", ("mean", "p95")),
    ("time_below_54_pct", ("mean", "p95")),
    ("minimum_mg_dl", ("median", "min")),
    ("undershoot_mg_dl", ("median", "p95", "max")),
    ("peak_mg_dl", ("median", "p95")),
    ("mean_mg_dl", ("median",)),
    ("insulin_total_mU", ("median",)),
    ("insulin_off_min", ("median", "p95")),
)
"""Metrics and their statistics over the people, in the order in which a clinician reads them."""
_EVER_BELOW: Final = {"time_below_70_pct": "70", "time_below_54_pct": "54"}
"""Glucose below which people are counted, after the row of a metric."""
_NAMED: Final = 10


def trial_of(asked: Trial) -> Trial:
    """The trial itself."""
    return asked


def notes(asked: Trial) -> tuple[str, ...]:
    """Sentence on boluses into a vein."""
    return boluses_into_a_vein(asked)


def found(asked: Trial, folder: TrialFolder) -> Findings:
    """Distributions and percentiles of all people; those with the worst outcomes are simulated again."""
    summary = summarise_people(folder.people, max_insulin_mU_min=float(asked.limits.max_mU_min))
    bands, header, engines = _bands(folder), read_header(folder.path), engine.prepare(asked).engines
    told = summary.as_dict()
    for label, of_label in summary.cases.items():
        told["controllers"][label] |= engines[label]
        told["controllers"][label]["control_variability_pct"] = zone_pct(of_label.cvga_counts)
    plain = {"libraries": header.libraries, "config": header.config, "setpoint_mg_dl": asked.target_mg_dl, **told}
    report = TrialReport(
        title=f"{asked.population.name}, {how_many(asked.people, 'person', 'people')}",
        setpoint_mg_dl=asked.target_mg_dl,
        units_per_hour=asked.patient.under_the_skin,
        people=summary.people,
        infeasible=summary.infeasible.count,
        facts={**controllers_facts(asked.cases), **trial_facts(asked), **engine_facts(engines)},
        meals=[(meal.t_min, meal.carbs_g) for meal in asked.plan.nominal()],
        faults=asked.fault_texts,
        repeat=Repeat("trial --config trial.toml", asked.tree(whole=True), _FILES, given=asked.tree()),
        cases={label: _case_report(asked, label, of_label, bands[label]) for label, of_label in summary.cases.items()},
    )
    return Findings({**plain, "notes": list(_notes(plain))}, {BANDS: pl.concat(_band_tables(asked, bands))}, report)


def drawn(asked: Trial, found: Findings, *, mmol: bool = False) -> dict[str, bytes]:
    """Page and figure, by the names of their files; the page shows mmol/l beside mg/dl always."""
    del mmol
    report: TrialReport = found.extra
    return {REPORT: trial_page(report).encode(), **figure_files("figure", plot_trial(report))}


def tables(asked: Trial, found: Findings) -> Iterator[object]:
    """Statistics of the metrics over the people, one column for each controller."""
    yield lines_table("Over the people", found.plain["controllers"], list(_rows(found.plain)))


def sentences(asked: Trial, found: Findings) -> tuple[str, ...]:
    """Return no sentence; the notes among what was found say all."""
    return ()


def _bands(folder: TrialFolder) -> Bands:
    trial = folder.trial
    total: dict[str, Counts] = no_counts(trial)
    for index in range(trial.shards):
        add_counts(folder.shard(index), trial, index, total)
    bins = edges(trial)
    return {
        label: {quantity: quantiles_of_counts(bins[quantity], counts) for quantity, counts in of_label.items()}
        for label, of_label in total.items()
    }


def _band_tables(trial: Trial, bands: Bands) -> Iterator[pl.DataFrame]:
    t_min = times(trial)
    for label, of_label in bands.items():
        for quantity, quantiles in of_label.items():
            columns = {f"q{100 * q:02.0f}": values for q, values in zip(BAND_QUANTILES, quantiles, strict=True)}
            table = pl.DataFrame({"t_min": t_min[quantity], **columns}).with_columns(pl.col(pl.Float64).fill_nan(None))
            yield table.select(pl.lit(label).alias("controller"), pl.lit(quantity).alias("quantity"), pl.all())


def _case_report(trial: Trial, label: str, summary: CaseSummary, bands: Mapping[str, Any]) -> CaseReport:
    t_min = times(trial)
    metrics = summary.metrics
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
            for metric, counted in summary.distributions.items()
            if metric != _SETTLING or _one_meal(trial)
        },
        cvga_counts=summary.cvga_counts,
        time_in_range_pct=ranges_pct(lambda metric: metrics[metric]["mean"]),
        table=_headlines(summary, setpoint_mg_dl=trial.target_mg_dl, settling=_one_meal(trial)),
        worst=_worst(trial, label, summary),
        ever_below={limit: (int(of["people"]), float(of["share_pct"])) for limit, of in summary.ever_below.items()},
        not_finite=summary.not_finite.count,
    )


def _one_meal(trial: Trial) -> bool:
    """Whether there is one meal from which settling counts; after many, it counts from the last."""
    return len(trial.plan.nominal()) == 1


def _headlines(summary: CaseSummary, *, setpoint_mg_dl: float, settling: bool) -> dict[str, float | str]:
    """Numbers over the people in the order in which a clinician reads them."""
    metrics = summary.metrics
    undershoot = metrics["undershoot_mg_dl"]

    def valid(glucose_mg_dl: float, *, fall: bool = False) -> float | str:
        lowest = setpoint_mg_dl - glucose_mg_dl if fall else glucose_mg_dl
        return NOT_VALID if lowest < 0.0 else glucose_mg_dl

    return {
        "Time from 70 to 180 mg/dl, mean (%)": metrics["time_70_180_pct"]["mean"],
        "Time above 180 mg/dl, mean (%)": metrics["time_above_180_pct"]["mean"],
        "Time above 250 mg/dl, mean (%)": metrics["time_above_250_pct"]["mean"],
        "Time below 70 mg/dl, mean (%)": metrics["time_below_70_pct"]["mean"],
        "Time below 70 mg/dl of the worst 5 % (%)": metrics["time_below_70_pct"]["p95"],
        "Time below 54 mg/dl, mean (%)": metrics["time_below_54_pct"]["mean"],
        "Time below 54 mg/dl of the worst 5 % (%)": metrics["time_below_54_pct"]["p95"],
        "People ever below 70 mg/dl (%)": summary.ever_below[70]["share_pct"],
        "People ever below 54 mg/dl (%)": summary.ever_below[54]["share_pct"],
        "People ever below the valid range of the model": str(summary.below_validity.count),
        "Lowest glucose of all people (mg/dl)": valid(metrics["minimum_mg_dl"]["min"]),
        "Greatest fall below the setpoint, median (mg/dl)": undershoot["median"],
        "Greatest fall below the setpoint of the worst 5 % (mg/dl)": valid(undershoot["p95"], fall=True),
        "Highest glucose, median (mg/dl)": metrics["peak_mg_dl"]["median"],
        "Highest glucose of the worst 5 % (mg/dl)": metrics["peak_mg_dl"]["p95"],
        "Mean glucose, median (mg/dl)": metrics["mean_mg_dl"]["median"],
        "Insulin delivered, median (U)": metrics["insulin_total_mU"]["median"] / MU_PER_U,
        "Time without insulin, median (h)": metrics["insulin_off_min"]["median"] / MIN_PER_H,
        "Time without insulin of the worst 5 % (h)": metrics["insulin_off_min"]["p95"] / MIN_PER_H,
        **({"Settling to 5 %, median (min)": metrics[_SETTLING]["median"]} if settling else {}),
    }


def _worst(trial: Trial, label: str, summary: CaseSummary) -> list[WorstPerson]:
    """People with the worst outcomes, with their traces; a person is the same in every simulation."""
    if not summary.worst:
        return []
    worst = np.array([person["person"] for person in summary.worst], np.int64)
    again = engine.run_people(engine.prepare(trial), label, worst, traces=True)
    if again.glucose_mg_dl is None or again.insulin_mU_min is None:
        raise TypeError("traces were asked for, but the engine gave none")
    t_min = times(trial)
    return [
        WorstPerson(
            person=person["person"],
            minimum_mg_dl=person["metrics"]["minimum_mg_dl"],
            t_min=t_min["glucose"],
            glucose_mg_dl=again.glucose_mg_dl[:, column].astype(np.float64),
            insulin_t_min=t_min["insulin"],
            insulin_mU_min=again.insulin_mU_min[:, column].astype(np.float64),
            note=person_in_words(trial.population, person),
        )
        for column, person in enumerate(summary.worst)
    ]


def _rows(summary: Mapping[str, Any]) -> Iterator[MetricRow]:
    controllers = summary["controllers"].values()
    for metric, statistics in _TABLE:
        how = described(metric)
        for position, statistic in enumerate(statistics):
            values = (of["metrics"][metric][statistic] for of in controllers)
            cells = (NOT_AVAILABLE if v is None else how.text(v, summary["setpoint_mg_dl"]) for v in values)
            yield MetricRow("", "" if position else how.title, how.unit, list(cells), statistic=statistic)
        if metric in _EVER_BELOW:
            limit = _EVER_BELOW[metric]
            counts = (of["ever_below"][f"{limit}_mg_dl"] for of in controllers)
            cells = (
                NOT_AVAILABLE if of["share_pct"] is None else f"{of['people']} ({percent(of['share_pct'])})"
                for of in counts
            )
            yield MetricRow("", f"People ever below {limit} mg/dl", "", list(cells), statistic="number")
    if all("engine" in of for of in controllers):  # earlier versions did not tell it
        yield MetricRow("", "Engine", "", [of["engine"] for of in controllers])


def _notes(summary: Mapping[str, Any]) -> Iterator[str]:
    """Notes on people who are left out, and on people whose basal rate is beyond the pump."""
    infeasible, beyond = summary["unable"], summary["basal_beyond_pump"]
    setpoint = f"{summary['setpoint_mg_dl']:g} mg/dl"
    if count := infeasible["count"]:
        yield (
            f"Of {how_many(summary['people'], 'person', 'people')} {how_many(count, 'has', 'have')} no basal rate for "
            f"{setpoint}: {_persons(infeasible)}."
        )
    if beyond["count"]:
        yield (
            f"{how_many(beyond['count'], 'person', 'people')} would need more than the pump gives to rest there: "
            f"{_persons(beyond)}."
        )
    yield from engine_notes(summary["controllers"])
    for label, of in summary["controllers"].items():
        below = of.get("below_validity", {"count": 0})  # earlier versions did not measure it
        if below["count"]:
            yield (
                f"{label}: glucose of {_people(below['count'])} was lower than the model is valid for: "
                f"{_persons(below)}. Read it as severe hypoglycemia; its depth means nothing."
            )
        if of["not_finite"]["count"]:
            lost = of["not_finite"]
            yield f"{label}: glucose of {_people(lost['count'])} did not stay finite: {_persons(lost)}."


def _people(count: int) -> str:
    return "one person" if count == 1 else f"{count} people"


def _persons(named: Mapping[str, Any]) -> str:
    shown = ", ".join(map(str, named["person"][:_NAMED]))
    return f"person {shown}" if named["count"] <= _NAMED else f"person {shown} and others, see summary.json"


def mmol_lines(found: Findings) -> Iterator[str]:
    """Glucose under each controller in mmol/l."""
    for label, of in found.plain["controllers"].items():
        least, peak = of["metrics"]["minimum_mg_dl"], of["metrics"]["peak_mg_dl"]
        values = (least["median"], least["min"], peak["median"], peak["max"])
        if None not in values:
            median, worst, high, highest = (glucose_text(mmol_l_from_mg_dl(value), 2) for value in values)
            yield (
                f"{label}: least glucose {median} mmol/l in the median and {worst} at worst, "
                f"greatest {high} in the median and {highest} at worst."
            )
