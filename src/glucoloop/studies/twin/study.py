"""Work of finding a twin: record, search, check, page, and the files from which other commands take the person."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import polars as pl
import tomli_w

from glucoloop.forecasts.grid import SAMPLE_MIN, GriddedRecord, gridded_record
from glucoloop.records import read_record
from glucoloop.refusal import Refusal
from glucoloop.reporting.columns import Column, FittingTable, terminal_table
from glucoloop.reporting.days_figure import DayTraces, days_plot, plot_days
from glucoloop.reporting.figure_files import figure_files
from glucoloop.reporting.template import render
from glucoloop.situations.population import population_keys
from glucoloop.storage.results import Results
from glucoloop.studies.twin import RecordOfPerson, TwinRequest
from glucoloop.text import how_many
from glucoloop.trials.trial import population_of
from glucoloop.twins import Twin, find_twin
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

if TYPE_CHECKING:
    from glucoloop.patients.population import Population

_PERSON: Final = "person.toml"
_POSTERIOR: Final = "posterior.toml"
_WEIGHT: Final = "weight_kg"
_MAX_HELD_OUT: Final = 8
"""Number of days that are held out at most where it is not given."""
_PLOTTED_DAYS: Final = 2


def record_of(config: RecordOfPerson) -> GriddedRecord:
    """Days of the record that is asked for; Refusal with its files for one that is not enough."""
    if not config.files:
        raise Refusal("no record is given; give the path of one, like record.parquet")
    try:
        record = read_record(*config.files)
    except Refusal as error:  # a question about the file, which has no option here
        if error.remedies:
            error = error.with_remedy("answer it in `glucoloop records`, and give the record that this writes")
        raise error from None
    try:
        gridded = gridded_record(record, most_days=config.most_days)
        if gridded.basal_U.any():
            return gridded
        if config.basal_U_h is None:
            raise Refusal(
                "it tells neither a basal rate nor long-acting insulin; give the rate with --basal, like --basal 0.8"
            )
    except Refusal as error:
        raise error.within(", ".join(config.files)) from None
    rate_U = np.full(gridded.basal_U.size, config.basal_U_h * SAMPLE_MIN / MIN_PER_H)
    return dataclasses.replace(gridded, basal_U=rate_U)


def results_of(config: TwinRequest, progress: Callable[[str], None]) -> Results:
    """Find the twin; Refusal for a record that is not enough, or a family whose people do not differ."""
    record = record_of(config)
    held_out_days = config.held_out_days
    if held_out_days is None:
        held_out_days = min(_MAX_HELD_OUT, max(1, record.days // 3))
    progress(how_many(record.days, "day"))
    try:
        twin = find_twin(
            record,
            population_of(config.population, config.patient),
            known={} if config.weight_kg is None else {_WEIGHT: config.weight_kg},
            held_out_days=held_out_days,
            tell=progress,
        )
    except Refusal as error:
        raise error.within(", ".join(config.files)) from None
    notes = [*record.notes, *twin.warnings()]
    return Results({**twin.plain(), "notes": notes}, _tables(twin), twin)


def _tables(twin: Twin) -> dict[str, pl.DataFrame]:
    parameters = pl.DataFrame(twin.rows())
    if not twin.checks:
        return {"parameters.csv": parameters}
    checks = pl.DataFrame([check.row() for check in twin.checks])
    errors = twin.day
    day = pl.DataFrame(
        {
            "t_min": errors.t_min,
            "reading_mg_dl": errors.reading_mg_dl,
            "predicted_mg_dl": errors.forecast_mg_dl,
            "low_mg_dl": errors.forecast_mg_dl - errors.half_width_mg_dl,
            "high_mg_dl": errors.forecast_mg_dl + errors.half_width_mg_dl,
        }
    )
    return {"parameters.csv": parameters, "checks.csv": checks, "held_out.csv": day}


def _number(value: float) -> str:
    return f"{value:.3g}"


_COLUMNS: Final = (
    Column(name="value", head="Twin", short="Twin", text=_number),
    Column(name="low", group="90 % interval", head="from", short="from", text=_number),
    Column(name="high", group="90 % interval", head="to", short="to", text=_number),
    Column(name="population_median", group="Population", head="median", short="popu-\nlation", text=_number),
    Column(name="population_low", group="Population", head="from", text=_number),
    Column(name="population_high", group="Population", head="to", text=_number),
    Column(name="width_of_prior_pct", head="Width", short="Width\n(%)", text=lambda value: f"{value:.0f}"),
    Column(name="meaning", head="Meaning", short="Meaning", text=str, left=True),
)


def tables(config: TwinRequest, results: Results) -> Iterator[FittingTable]:
    """The parameters, with their intervals and those of the population."""
    rows = results.plain["parameters"]
    yield terminal_table(
        "Parameter",
        [(results.plain["verdict"], [(row["parameter"], [row]) for row in rows])],
        _COLUMNS,
        caption="Width: of the interval, in percent of that of the population.",
    )


def sentences(config: TwinRequest, results: Results) -> Iterator[str]:
    """Sentences on whether the twin predicts, on what was found, and how well it forecasts."""
    plain = results.plain
    record = plain["record"]
    yield plain["verdict"]
    yield (
        f"A twin of {plain['patient']} was found from {record['fitted_days']} days of "
        f"{record['total_daily_dose_U']:.0f} U a day; 1 U lowers its glucose by {plain['fall_mg_dl_U']:.0f} mg/dl at "
        "most."
    )
    if plain["checks"]:
        errors = ", ".join(
            f"{check['horizon']} {check['rmse_mg_dl']:.1f} mg/dl ({check['by_mean_rmse_mg_dl']:.1f} mg/dl by the mean)"
            for check in plain["checks"]
        )
        yield (
            f"Errors of its forecasts of the days held out, with the meals and boluses of the user known: {errors}; "
            f"{plain['checks'][-1]['covered_pct']:.0f} % of the readings of the day lie within the intervals of 90 %."
        )
    yield "It is a model of the past days, for research; it says nothing on what this person should do."


def files_of(config: TwinRequest, results: Results) -> dict[str, bytes]:
    """The person and the posterior as files of people, the figure, and the page."""
    twin: Twin = results.extra
    days = _days_of_picture(twin)
    page = render(
        Path(__file__).with_name("page.html"),
        f"Twin of {twin.patient}",
        sentences=[*sentences(config, results), *results.plain["notes"]],
        facts=_facts(twin),
        script=True,
        plot=days_plot(days, "90 % interval"),
        rows=[(row["parameter"], [("", row)]) for row in results.plain["parameters"]],
        columns=_COLUMNS,
        person=f"{twin.patient}, person={_PERSON}:twin",
        posterior=_POSTERIOR,
        patient=twin.patient,
    )
    return {
        _PERSON: _text(twin.person()),
        _POSTERIOR: _text(twin.posterior()),
        "page.html": page.encode(),
        **figure_files("figure", plot_days(days)),
    }


def _text(population: Population) -> bytes:
    return tomli_w.dumps(population_keys(population)).encode()


def _days_of_picture(twin: Twin) -> DayTraces:
    """Readings of the last two days, and their forecasts from the midnight before each."""
    record, errors = twin.record, twin.day
    begin = max(0.0, float(errors.t_min[-1]) - _PLOTTED_DAYS * MIN_PER_DAY)
    chosen = errors.t_min >= begin
    t_min, forecast, half = errors.t_min[chosen], errors.forecast_mg_dl[chosen], errors.half_width_mg_dl[chosen]
    first_day = record.days - (twin.held_out_days or min(_PLOTTED_DAYS, record.days - 1))
    shown = record.of_days(first_day, record.days)
    return DayTraces(
        first=shown.first,
        t_min=t_min,
        reading_mg_dl=errors.reading_mg_dl[chosen],
        trajectory_mg_dl={"twin": forecast},
        band_mg_dl={"twin": (forecast - half, forecast + half)},
        meals=[
            (SAMPLE_MIN * sample, float(shown.carbs_g[sample]))
            for sample in np.flatnonzero(shown.carbs_g)
            if SAMPLE_MIN * sample >= begin
        ],
    )


def _facts(twin: Twin) -> Mapping[str, str]:
    noises, record = twin.plain()["unexplained"], twin.on_record()
    known: Any = ", ".join(f"{name} {value:g}" for name, value in twin.prior.known.items())
    return {
        "Family": f"{twin.patient}, population {twin.prior.population}",
        **({"Known": known} if known else {}),
        "Record": f"{record['readings']} readings and {record['meals']} meals from {record['first']} on",
        "Unexplained appearance": (
            f"as through a gut with a time constant of {noises['appearance_min']:.0f} min, a drift with one of "
            f"{noises['drift_min']:.0f} min, and a return to the mean with one of {noises['return_min']:.0f} min"
        ),
    }


def next_steps(results: Results, files: Mapping[str, str]) -> Iterator[str]:
    """Sentences on the files."""
    if _PERSON in files:
        patient = results.plain["patient"]
        yield f"The person, in run: --patient '{patient}, person={files[_PERSON]}:twin'"
        yield f"People drawn from the posterior, in trial: --patient {patient} --population {files[_POSTERIOR]}"
