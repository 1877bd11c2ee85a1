"""Work of `glucoloop forecast`: records, fits, forecasts of the days held out, tables, sentences and the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import polars as pl

from glucoloop.component.grammar import component_text
from glucoloop.forecasts.grid import GriddedRecord, gridded_record
from glucoloop.forecasts.method import ForecastMethod
from glucoloop.forecasts.scores import DAY, forecast_errors
from glucoloop.records import FileRefusal
from glucoloop.refusal import Refusal
from glucoloop.reporting.columns import Column, FittingTable, decimals, terminal_table, whole
from glucoloop.reporting.days_figure import DayTraces, days_plot
from glucoloop.reporting.template import render
from glucoloop.storage.results import Results
from glucoloop.studies.forecast import ForecastRequest
from glucoloop.studies.forecast.comparison import FUTURES, PersonErrors, differences, pooled_rows
from glucoloop.studies.record_report.sources import RecordSource, records, sources_of
from glucoloop.text import how_many
from glucoloop.units import MIN_PER_DAY

_MAX_HELD_OUT: Final = 8
_PLOTTED_DAYS: Final = 2
_FUTURE_TEXTS: Final = {
    "known": "Meals and boluses of the user known",
    "unknown": "Nothing to come known",
}


class _Person(NamedTuple):
    """A record on the grid, and the number of its last days that are held out."""

    label: str
    record: GriddedRecord
    held_out_days: int
    notes: tuple[str, ...]

    @property
    def first_day(self) -> int:
        return self.record.days - self.held_out_days

    def row(self) -> dict[str, Any]:
        """Facts on the record that the results tell, of all its days."""
        record = self.record
        return {
            "person": self.label,
            "days": record.days,
            "held_out_days": self.held_out_days,
            "total_daily_dose_U": record.total_daily_dose_U,
            "carbs_per_day_g": float(record.carbs_g.sum()) / record.days,
            "automated": record.automated,
            "automatic_insulin_pct": record.automatic_insulin_pct,
            "read": list(self.notes),
        }


class _Extra(NamedTuple):
    """Results from which the page is made."""

    people: list[_Person]
    cells: list[PersonErrors]
    unread: list[tuple[str, str]]


def amount(config: ForecastRequest) -> int:
    """Number of files, and of folders of one person."""
    return len(sources_of(config))


def results_of(config: ForecastRequest, progress: Callable[[int], None]) -> Results:
    """Fit each method to the first days of each record, and forecast the others; Refusal where none can be."""
    people, cells, unread, not_read = (
        list[_Person](),
        list[PersonErrors](),
        list[tuple[str, str]](),
        list[dict[str, str]](),
    )
    left_out: dict[str, list[str]] = {}
    for source in sources_of(config):
        try:
            for person in _people_of(source, config):
                own, refused = _cells_of(person, config)
                people.append(person)
                cells += own
                for why in refused:
                    left_out.setdefault(why, []).append(person.label)
        except Refusal as error:
            if not source.group:
                raise
            unread.append((source.label, str(error)))
            not_read.append({"label": source.label, "why": error.why if isinstance(error, FileRefusal) else str(error)})
        progress(1)
    if not people:
        raise Refusal(f"{unread[0][1]}{f' (and {len(unread) - 1} more)' if unread[1:] else ''}")
    first = next(label for label in map(_label_of, config.methods) if any(cell.method == label for cell in cells))
    rows = {
        "people": [cell.row() for cell in cells],
        "pooled": list(pooled_rows(cells)),
        "differences": list(differences(cells, first)),
    }
    plain = {
        "records": [person.row() for person in people],
        "first": first,
        **rows,
        "not_read": not_read,
        "complete": not not_read,
        "notes": [
            *(
                f"{label} was not forecast by {why}."
                for why, labels in left_out.items()
                for label in [", ".join(labels)]
            ),
            *([f"{how_many(len(unread), 'record is', 'records are')} in no number."] if unread else []),
        ],
    }
    forecasts = pl.concat(map(_forecast_table, cells))
    tables = {**{f"{name}.csv": pl.DataFrame(of) for name, of in rows.items()}, "forecasts.parquet": forecasts}
    return Results(plain, tables, _Extra(people, cells, unread))


def _people_of(source: RecordSource, config: ForecastRequest) -> Iterator[_Person]:
    if source.simulated:
        raise Refusal(f"{source.paths[0]} is a simulation and no record; give a record with its insulin and meals")
    for label, _, record in records(source, config):
        try:
            gridded = gridded_record(record, most_days=config.most_days)
        except Refusal as error:
            raise FileRefusal(source.paths, error) from None
        held_out = config.held_out_days or min(_MAX_HELD_OUT, max(1, gridded.days // 3))
        person = _Person(label, gridded, held_out, (*record.notes, *gridded.notes))
        if held_out >= gridded.days:
            few = Refusal(
                f"it has {how_many(gridded.days, 'day')} and --held-out-days is {held_out}, so nothing is left to fit; "
                "hold out fewer days"
            )
            raise FileRefusal(source.paths, few)
        try:
            _refuse_few_readings(person)
        except Refusal as error:
            raise FileRefusal(source.paths, error) from None
        yield person


def _refuse_few_readings(person: _Person) -> None:
    """Refusal where the days before those held out, or these, have too few readings."""
    ForecastMethod.refuse_few_days(person.record.of_days(0, person.first_day))
    if not person.record.of_days(person.first_day, person.record.days).days_with_readings:
        raise Refusal("none of the days held out has 24 readings or more; hold out more days")


def _cells_of(person: _Person, config: ForecastRequest) -> tuple[list[PersonErrors], list[str]]:
    """Forecasts of a person by each method, and why some methods cannot forecast."""
    cells, refused = list[PersonErrors](), list[str]()
    training = person.record.of_days(0, person.first_day)
    for method in config.methods:
        try:
            predictor = method.fit(training)
        except Refusal as error:
            refused.append(f"{_label_of(method)}: {error.problem}")
            continue
        for known, future in FUTURES.items():
            by_horizon = forecast_errors(
                predictor, person.record, person.first_day, config.horizons_min, future_known=known
            )
            cells += [
                PersonErrors(person.label, _label_of(method), future, horizon, errors)
                for horizon, errors in by_horizon.items()
                if errors.t_min.size
            ]
    if not cells:
        raise Refusal(f"no method can forecast it: {'; '.join(refused)}")
    return cells, refused


def _label_of(method: ForecastMethod) -> str:
    """Name of a method with the settings that were given."""
    return component_text(method.tree())


def _forecast_table(cell: PersonErrors) -> pl.DataFrame:
    errors = cell.errors
    names = {"person": cell.person, "method": cell.method, "future": cell.future, "horizon": cell.horizon}
    values = pl.DataFrame(
        {
            "t_min": errors.t_min,
            "reading_mg_dl": errors.reading_mg_dl,
            "forecast_mg_dl": errors.forecast_mg_dl,
            "low_mg_dl": errors.forecast_mg_dl - errors.half_width_mg_dl,
            "high_mg_dl": errors.forecast_mg_dl + errors.half_width_mg_dl,
        }
    )
    return values.select(*(pl.lit(value).alias(name) for name, value in names.items()), pl.all())


def _horizons(results: Results) -> list[str]:
    """Horizons with a forecast, in their order."""
    return list(dict.fromkeys(row["horizon"] for row in results.plain["pooled"]))


def _columns(results: Results) -> tuple[Column, ...]:
    """Error and band at each horizon."""
    heads = [(horizon, horizon.replace(" ", "\n")) for horizon in _horizons(results)]
    return (
        *(
            Column(
                name=f"{horizon} rmse_mg_dl",
                group="Error (RMSE, mg/dl)",
                head=horizon,
                short=f"{short}\nmg/dl",
                text=decimals(1),
            )
            for horizon, short in heads
        ),
        *(
            Column(
                name=f"{horizon} covered_pct",
                group="Readings in the band of 90 % (%)",
                head=horizon,
                short=f"{short}\nin %",
                text=whole,
            )
            for horizon, short in heads
        ),
    )


def _by_method(
    rows: Sequence[dict[str, Any]], future: str, results: Results, prefix: str = ""
) -> list[tuple[str, dict[str, Any]]]:
    """Row of each method, with its numbers at each horizon."""
    of_method: dict[str, dict[str, Any]] = {}
    empty = {column.name: None for column in _columns(results)}
    for row in rows:
        if row["future"] == future:
            cells = of_method.setdefault(row["method"], dict(empty))
            for name in ("rmse_mg_dl", "covered_pct"):
                cells[f"{row['horizon']} {name}"] = row[f"{prefix}{name}"]
    return list(of_method.items())


def tables(config: ForecastRequest, results: Results) -> Iterator[FittingTable]:
    """Errors and bands of each method over all people."""
    people = len(results.plain["records"])
    sections = [
        (text, [(method, [row]) for method, row in _by_method(results.plain["pooled"], future, results, "median_")])
        for future, text in _FUTURE_TEXTS.items()
    ]
    over = "" if people == 1 else f", medians over {people} people"
    yield terminal_table(
        "Method",
        sections,
        _columns(results),
        caption=f"Root mean squared error, and readings in the bands of 90 % (in %){over}. Day: from midnight.",
    )


def sentences(config: ForecastRequest, results: Results) -> Iterator[str]:
    """Comparison of the first method with the others, automation, and what the errors do not say."""
    plain = results.plain
    for horizon in dict.fromkeys((plain["pooled"][0]["horizon"], DAY)):
        yield from _comparison(plain, horizon)
    yield from _on_automation(plain["records"])
    yield (
        "A forecast says how well readings are foreseen, not how strongly insulin acts: what was not entered and what "
        "automation dosed stand between the two. It is for research, and says nothing on what a person should do."
    )
    yield from (f"{label} was not read: {why}." for label, why in (results.extra.unread if results.extra else ()))


def _comparison(plain: dict[str, Any], horizon: str) -> Iterator[str]:
    """Sentence on the error of the first method, and on which others err more, err less, or cannot be told from it."""
    first, people = plain["first"], len(plain["records"])
    rows = [row for row in plain["differences"] if row["future"] == "known" and row["horizon"] == horizon]
    if not rows:
        return
    [error_mg_dl] = (
        row["median_rmse_mg_dl"]
        for row in plain["pooled"]
        if (row["method"], row["future"], row["horizon"]) == (first, "known", horizon)
    )
    groups: dict[str, list[str]] = {"above 0 for": [], "below 0 for": [], "too near to 0 to tell for": []}
    for row in rows:
        low, high = row["low_mg_dl"], row["high_mg_dl"]
        above, below = low is not None and low > 0.0, high is not None and high < 0.0
        name = "above 0 for" if above else "below 0 for" if below else "too near to 0 to tell for"
        groups[name].append(f"{row['method']} {_difference_text(row)}")
    when = "On the day from midnight" if horizon == DAY else f"At {horizon}"
    over, median = ("days held out", "") if people == 1 else ("people", f", the median over {people} people")
    others = "; ".join(f"{name} {', '.join(texts)}" for name, texts in groups.items() if texts)
    yield (
        f"{when} {first} errs by {error_mg_dl:.1f} mg/dl{median}. The others' errors less that one, with the interval "
        f"of 95 % over {over}, are {others}."
    )


def _difference_text(row: dict[str, Any]) -> str:
    """A difference with its interval, and for how many people the first method is better."""
    text = f"{row['difference_mg_dl']:z.1f} mg/dl"
    if row["low_mg_dl"] is not None:
        text += f" ({row['low_mg_dl']:z.1f} mg/dl to {row['high_mg_dl']:z.1f} mg/dl)"
    if row["people"] > 1:
        text += f" with {row['first']} better in {row['first_better_people']} of {row['people']}"
    return text


def _on_automation(people: Sequence[dict[str, Any]]) -> Iterator[str]:
    shares = [row["automatic_insulin_pct"] for row in people if row["automated"]]
    if not shares:
        yield "No basal rate leaves its schedule as under automation; all boluses are taken as the user's."
        return
    whose = (
        "of the insulin" if len(people) == 1 else f"of the insulin of {len(shares)} of {len(people)} people (median)"
    )
    yield (
        f"Automation dosed {np.median(shares):.0f} % {whose}: the basal rate, and boluses without carbohydrate within "
        "30 min. Such doses follow glucose, which could be read off them; they are known to no forecast, which takes "
        "the usual ones at that time of day."
    )


def files_of(config: ForecastRequest, results: Results) -> dict[str, bytes]:
    """The page; of one person it shows the forecasts of the last days too."""
    plain, extra = results.plain, results.extra
    columns = _columns(results)
    people = [row["person"] for row in plain["records"]]
    own = {person: [row for row in plain["people"] if row["person"] == person] for person in people}
    days = _days_of_picture(extra) if len(people) == 1 else None
    page = render(
        Path(__file__).with_name("page.html"),
        "Forecasts of glucose",
        sentences=[*sentences(config, results), *plain["notes"]],
        script=days is not None,
        plot=None if days is None else days_plot(days, "90 % band"),
        horizon=extra.cells[0].horizon,
        columns=columns,
        futures=[
            (text, [(method, [("", row)]) for method, row in _by_method(plain["pooled"], future, results, "median_")])
            for future, text in _FUTURE_TEXTS.items()
        ],
        people=[] if len(people) == 1 else [(person, _by_method(own[person], "known", results)) for person in people],
        differences=_differences_by_method(plain["differences"]),
        difference_columns=_DIFFERENCES if len(people) > 1 else _DIFFERENCES[:3],
        first=plain["first"],
        records=[(row["person"], [("", row)]) for row in plain["records"]],
        record_columns=_RECORDS,
    )
    return {"page.html": page.encode()}


def _differences_by_method(rows: Sequence[dict[str, Any]]) -> list[tuple[str, list[tuple[str, dict[str, Any]]]]]:
    """Each method with its rows by horizon."""
    of_method: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for row in rows:
        if row["future"] == "known":
            of_method.setdefault(row["method"], []).append((row["horizon"], row))
    return list(of_method.items())


_DIFFERENCES: Final = (
    Column(name="difference_mg_dl", head="Difference", text=decimals(1)),
    Column(name="low_mg_dl", group="95 % interval", head="from", text=decimals(1)),
    Column(name="high_mg_dl", group="95 % interval", head="to", text=decimals(1)),
    Column(name="first_better_people", head="People for whom the first is better", text=whole),
    Column(name="people", head="People", text=whole),
)
_RECORDS: Final = (
    Column(name="days", head="Days", text=whole),
    Column(name="held_out_days", head="Held out", text=whole),
    Column(name="total_daily_dose_U", head="Insulin a day (U)", text=decimals(1)),
    Column(name="carbs_per_day_g", head="Carbohydrate a day (g)", text=whole),
    Column(name="automatic_insulin_pct", head="Dosed by automation (%)", text=whole),
)


def _days_of_picture(extra: _Extra) -> DayTraces:
    """Readings of the last days beside their forecasts by the first method at the first horizon."""
    [person], cell = extra.people, extra.cells[0]
    errors = cell.errors
    begin = MIN_PER_DAY * max(person.held_out_days - _PLOTTED_DAYS, 0)
    chosen = errors.t_min > begin
    if not chosen.any():
        chosen = np.ones(errors.t_min.size, bool)
    low, high = errors.forecast_mg_dl - errors.half_width_mg_dl, errors.forecast_mg_dl + errors.half_width_mg_dl
    held_out = person.record.of_days(person.first_day, person.record.days)
    at = np.flatnonzero(held_out.carbs_g)
    meals = [(5.0 * (sample + 1.0), float(held_out.carbs_g[sample])) for sample in at if 5.0 * (sample + 1.0) > begin]
    return DayTraces(
        first=held_out.first,
        t_min=errors.t_min[chosen],
        reading_mg_dl=errors.reading_mg_dl[chosen],
        trajectory_mg_dl={cell.method: errors.forecast_mg_dl[chosen]},
        band_mg_dl={cell.method: (low[chosen], high[chosen])},
        meals=meals,
    )
