"""Work of finding a twin: record, search, check, page, and the files from which other commands take the person."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import polars as pl
import tomli_w

from glucoloop.records import read_record
from glucoloop.refusal import Refusal
from glucoloop.reporting.columns import Column, FittingTable, terminal_table
from glucoloop.reporting.days_figure import DayTraces, days_plot, plot_days
from glucoloop.reporting.print_figure import figure_files
from glucoloop.reporting.template import render
from glucoloop.situations.population import population_keys
from glucoloop.storage.results import Results
from glucoloop.studies.twin import RecordOfPerson, TwinRequest
from glucoloop.trials.trial import population_of
from glucoloop.twins import RecordedDays, Twin, find_twin, recorded_days
from glucoloop.units import MIN_PER_DAY

if TYPE_CHECKING:
    from glucoloop.patients.population import Population

_PERSON: Final = "person.toml"
_POSTERIOR: Final = "posterior.toml"
_WEIGHT: Final = "weight_kg"


def days_of(config: RecordOfPerson) -> RecordedDays:
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
        return recorded_days(record, most_days=config.most_days, basal_U_h=config.basal_U_h)
    except Refusal as error:
        raise error.within(", ".join(config.files)) from None


def results_of(config: TwinRequest, progress: Callable[[str], None]) -> Results:
    """Find the twin; Refusal for a record that is not enough, or a family whose people do not differ."""
    days = days_of(config)
    progress(f"{days.days} days")
    twin = find_twin(
        days,
        population_of(config.population, config.patient),
        known={} if config.weight_kg is None else {_WEIGHT: config.weight_kg},
        held_out_days=config.held_out_days,
        starts=config.starts,
        seed=config.seed,
        tell=progress,
    )
    notes = [*days.notes, *twin.warnings()]
    return Results({**twin.plain(), "notes": notes}, _tables(twin), twin)


def _tables(twin: Twin) -> dict[str, pl.DataFrame]:
    held_out = twin.held_out
    parameters = pl.DataFrame(twin.rows())
    if held_out is None:
        return {"parameters.csv": parameters}
    columns = {name: value for name, value in vars(held_out).items() if isinstance(value, np.ndarray)}
    return {"parameters.csv": parameters, "held_out.csv": pl.DataFrame(columns)}


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
        [("", [(row["parameter"], [row]) for row in rows])],
        _COLUMNS,
        caption="Width: of the interval, in percent of that of the population.",
    )


def sentences(config: TwinRequest, results: Results) -> Iterator[str]:
    """Sentences on what was found, and how well it predicts."""
    plain = results.plain
    record, held_out = plain["record"], plain["held_out"]
    yield (
        f"A twin of {plain['patient']} was found from {record['fitted_days']:.1f} days with "
        f"{record['fitted_meals']} meals and {record['total_daily_dose_U']:.0f} U a day; readings lie "
        f"{plain['fit_rmse_mg_dl']:.1f} mg/dl about it."
    )
    if held_out is not None:
        yield (
            f"On the days held out it errs by {held_out['rmse_mg_dl']:.1f} mg/dl, the median of the population by "
            f"{held_out['by_population_rmse_mg_dl']:.1f} mg/dl, and the mean of the earlier readings by "
            f"{held_out['by_mean_rmse_mg_dl']:.1f} mg/dl; {held_out['covered_pct']:.0f} % of the readings lie within "
            "the intervals of 90 %."
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
    """Readings, the twin and its band: of the days held out, or of the last two that were used."""
    days, held_out = twin.days, twin.held_out
    begin = days.length_min - 2.0 * MIN_PER_DAY if held_out is None else twin.fitted_min[1]
    chosen = days.reading_min >= max(begin, 0.0)
    trajectories = days.at_readings(twin.courses_mg_dl, chosen)
    band = (
        np.percentile(trajectories, (5.0, 95.0), axis=0)
        if held_out is None
        else (held_out.low_mg_dl, held_out.high_mg_dl)
    )
    return DayTraces(
        first=days.first,
        t_min=days.reading_min[chosen],
        reading_mg_dl=days.reading_mg_dl[chosen],
        trajectory_mg_dl={"twin": trajectories[0]},
        band_mg_dl={"twin": (band[0], band[1])},
        meals=days.meals_from(begin),
    )


def _facts(twin: Twin) -> Mapping[str, str]:
    noise, record = twin.noise, twin.plain()["record"]
    known: Any = ", ".join(f"{name} {value:g}" for name, value in twin.prior.known.items())
    return {
        "Family": f"{twin.patient}, population {twin.prior.population}",
        **({"Known": known} if known else {}),
        "Record": f"{record['readings']} readings and {record['meals']} meals from {record['first']} on",
        "Error of readings": (
            f"slow part {noise.slow_sd_mg_dl:.1f} mg/dl with a time constant of {noise.time_constant_min:.0f} min, own "
            f"part {noise.own_sd_mg_dl:.1f} mg/dl"
        ),
        "Search": f"{twin.agreeing_starts} of {twin.starts} starts ended at this twin",
    }


def next_steps(results: Results, files: Mapping[str, str]) -> Iterator[str]:
    """Sentences on the files."""
    if _PERSON in files:
        patient = results.plain["patient"]
        yield f"The person, in run: --patient '{patient}, person={files[_PERSON]}:twin'"
        yield f"People drawn from the posterior, in trial: --patient {patient} --population {files[_POSTERIOR]}"
