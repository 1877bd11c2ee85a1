"""Results of a whole trial: summary, bands, figure and page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import polars as pl

import glucoloop
from glucoloop.cohorts.counts import BAND_QUANTILES, quantiles_of_counts
from glucoloop.cohorts.engine import prepare
from glucoloop.cohorts.summary import CaseSummary, TrialSummary, summarise_people
from glucoloop.cohorts.trial import Trial
from glucoloop.metrics.control_variability import zone_pct
from glucoloop.printable import NOT_VALID, how_many
from glucoloop.report import CaseReport, MetricDistribution, Repeat, TrialReport, WorstPerson, plot_trial, trial_page
from glucoloop.report.facts import controllers_facts, engine_facts, trial_facts
from glucoloop.report.person_words import person_in_words
from glucoloop.report.print_figure import figure_files
from glucoloop.report.trial_report import ranges_pct
from glucoloop.storage.strict_json import json_text
from glucoloop.storage.tables import parquet
from glucoloop.storage.trials.folder import BANDS, REPORT, SUMMARY, TrialFolder
from glucoloop.storage.trials.header import read_header
from glucoloop.storage.trials.shard import Counts, Simulate, add_counts, edges, no_counts, times
from glucoloop.units import MIN_PER_H, MU_PER_U

Bands = Mapping[str, Mapping[str, np.ndarray[Any, np.dtype[np.float64]]]]
"""Quantiles ``(quantiles, times)`` by controller and quantity."""
_SETTLING: Final = "settling_5pct_min"
_FILES: Final = {
    "summary.json": "numbers of each controller",
    BANDS: "percentiles over time",
}
"""Files with the data of a trial, beside its page."""


def results(folder: TrialFolder, simulate: Simulate) -> dict[str, bytes]:
    """Files about a whole trial, by name, from its shards; people with the worst outcomes are simulated again."""
    trial = folder.trial
    summary = summarise_people(folder.people, max_insulin_mU_min=float(trial.limits.max_mU_min))
    bands = _bands(folder)
    setpoint = trial.target_mg_dl
    report = TrialReport(
        title=f"{trial.population.name}, {how_many(trial.people, 'person', 'people')}",
        setpoint_mg_dl=setpoint,
        units_per_hour=trial.patient.under_the_skin,
        people=summary.people,
        infeasible=summary.infeasible.count,
        facts={**controllers_facts(trial.cases), **trial_facts(trial), **engine_facts(prepare(trial).engines)},
        meals=[(meal.t_min, meal.carbs_g) for meal in trial.plan.nominal()],
        faults=trial.fault_texts,
        repeat=Repeat("trial --config trial.toml", trial.tree(whole=True), _FILES, given=trial.tree()),
        cases={
            label: _case_report(trial, label, of_label, bands[label], simulate)
            for label, of_label in summary.cases.items()
        },
    )
    return {
        BANDS: parquet(pl.concat(_band_tables(trial, bands))),
        SUMMARY: _summary_text(folder, summary, setpoint).encode(),
        REPORT: trial_page(report).encode(),
        **figure_files("figure", plot_trial(report)),
    }


def _summary_text(folder: TrialFolder, summary: TrialSummary, setpoint_mg_dl: float) -> str:
    header = read_header(folder.path)
    told = summary.as_dict()
    for label, of_label in summary.cases.items():
        told["controllers"][label] |= prepare(folder.trial).engines[label]
        told["controllers"][label]["control_variability_pct"] = zone_pct(of_label.cvga_counts)
    versions = {"version": glucoloop.__version__, "libraries": header.libraries}
    return json_text({**versions, "config": header.config, "setpoint_mg_dl": setpoint_mg_dl, **told}) + "\n"


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


def _case_report(
    trial: Trial, label: str, summary: CaseSummary, bands: Mapping[str, Any], simulate: Simulate
) -> CaseReport:
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
        worst=_worst(trial, label, summary, simulate),
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


def _worst(trial: Trial, label: str, summary: CaseSummary, simulate: Simulate) -> list[WorstPerson]:
    """People with the worst outcomes, with their traces; a person is the same in every simulation."""
    if not summary.worst:
        return []
    again = simulate(label, np.array([person["person"] for person in summary.worst], np.int64), True)
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
