"""A test of estimators of unknown meals carried out: its numbers, in a table, files and a figure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import polars as pl

from glucoloop.reporting import _style
from glucoloop.reporting._style import FONT_PT, GREY
from glucoloop.reporting.columns import (
    Column,
    FittingTable,
    Line,
    Row,
    decimals,
    headings,
    measured,
    terminal_table,
    whole,
)
from glucoloop.reporting.descriptions import engine_facts
from glucoloop.reporting.figure_files import figure_files
from glucoloop.storage.results import Results
from glucoloop.studies.detection import Detection
from glucoloop.studies.detection.evaluate import ENGINE, JUDGED_AFTER_MIN, QUANTILES, Scores, evaluate
from glucoloop.text import NOT_AVAILABLE, how_many
from glucoloop.units import MIN_PER_DAY, MIN_PER_H

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZES_G: Final = (0.0, 30.0, 60.0, np.inf)
"""Limits between small, middling and large meals."""


def _spread(name: str, value: pl.Expr, unit: str, group: str, text: Callable[[float], str]) -> list[Column]:
    """The 10 % quantile, the median and the 90 % quantile over meals."""
    return [
        Column(
            name=f"{name}_{quantile}_{unit}", value=value.quantile(share, "linear"), group=group, head=unit, text=text
        )
        for quantile, share in zip(("p10", "median", "p90"), QUANTILES, strict=True)
    ]


def _size_error(name: str, value: str, group: str) -> list[Column]:
    error = pl.col(value) - pl.col("carbs_g")
    return [
        *_spread(f"size_error_{name}", error, "g", group, "{:+z.1f}".format),
        Column(name=f"size_error_{name}_mean_absolute_g", value=error.abs().mean()),
        Column(name=f"size_error_{name}_meals", value=error.count(), empty=0),
    ]


_DELAYS: Final = _spread("delay", pl.col("delay_min"), "min", "Delay of detection", whole)
_DETECTED_COLUMNS: Final = (
    Column(name="meals", value=pl.len(), empty=0, group="Meals", text=whole),
    Column(name="detected_pct", value=100.0 * pl.col("delay_min").is_not_null().mean()),
    Column(name="missed_pct", value=100.0 * pl.col("missed").mean(), group="Missed", head="%", text=decimals(1)),
    Column(
        name="already_pct",
        value=100.0 * pl.col("already").mean(),
        group="Began while above the threshold",
        head="%",
        text=decimals(1),
    ),
    *_DELAYS,
    Column(name="delay_max_min", value=pl.col("delay_min").max()),
)
_SIZES: Final = (
    *_size_error("after_end", "estimated_g", "  60 min after the end"),
    *(
        column
        for after in JUDGED_AFTER_MIN
        for column in _size_error(
            f"at_{after}_min", f"expected_{after}_min_g", f"Error of the size, {after} min after the beginning"
        )
    ),
)
_ALARMS: Final = tuple(
    Column(name=f"false_alarms_{when}_per_day", group=group, head="per day", text=decimals(2))
    for when, group in (("fasting", "False alarms on fasting days"), ("between", "  between meals"))
)


def results_of(config: Detection, progress: Callable[[str], None]) -> Results:
    """Simulate the days, try the estimators on them, and score what they say."""
    return _results(config, evaluate(config, progress))


def _results(config: Detection, scores: Scores) -> Results:
    """Numbers of all estimators; a number without meals is null."""
    columns = {name: [pl.lit(name).alias("estimator"), pl.all()] for name in scores.by_estimator}
    tables = {
        table: pl.concat([score.tables[table].select(columns[name]) for name, score in scores.by_estimator.items()])
        for table in ("meals", "curve", "size_error", "day")
    }
    plain = {
        "config": config.tree(whole=True),
        "days": scores.days,
        "unable": scores.infeasible,
        "estimators": dict(_numbers(scores, tables["meals"])),
        "engines": dict.fromkeys(scores.by_estimator, ENGINE),
        "curves": {name: score.tables["curve"].to_dict(as_series=False) for name, score in scores.by_estimator.items()},
        "notes": list(_notes(config, scores)),
    }
    return Results(plain, {f"{name}.{kind}": table for name, table in tables.items() for kind in ("csv", "parquet")})


def _numbers(scores: Scores, meals: pl.DataFrame) -> Iterator[tuple[str, dict[str, Any]]]:
    """Numbers of each estimator, over all meals and by their size."""
    columns, cells = (*_DETECTED_COLUMNS, *_SIZES), pl.DataFrame({"estimator": list(scores.by_estimator)})
    sizes = pl.DataFrame({"from_g": _SIZES_G[:-1], "to_g": [*_SIZES_G[1:-1], None]})
    sized = meals.sort("carbs_g").join_asof(sizes, left_on="carbs_g", right_on="from_g")
    by_size = measured(sized, cells.join(sizes, how="cross"), columns).partition_by("estimator", include_key=False)
    for row, of_sizes in zip(measured(meals, cells, columns).to_dicts(), by_size, strict=True):
        name = row.pop("estimator")
        yield name, {**row, **scores.by_estimator[name].alarms, "by_size": of_sizes.to_dicts()}


def _notes(config: Detection, scores: Scores) -> Iterator[str]:
    days = how_many(scores.days, "day")
    fed = f"{days} with meals and as many without" if config.trial.plan.meals else f"{days} without a meal"
    yield (
        f"Of {fed}; three numbers are the 10 % quantile, the median and the 90 % "
        f"quantile. A meal is detected above a probability of {config.threshold:g}; errors of the size are those of "
        "meals that are detected by then."
    )
    if scores.infeasible:
        people = how_many(scores.infeasible, "person has", "people have")
        yield f"{people} no basal rate that holds them at the setpoint, and take no part."
    late = config.trial.dead_time_samples * config.trial.sample_time_min
    if late and not config.trial.cases[0].known_dead_time:
        yield (
            f"The estimators do not know of the dead time of {late:g} min; --controller known_dead_time=true tells it."
        )
    yield f"Engine: {engine_facts(dict.fromkeys(scores.by_estimator, ENGINE))['Engine']}."


def tables(config: Detection, results: Results) -> Iterator[FittingTable]:
    """One column for each estimator: meals found and missed, delay, error of the size, and false alarms."""
    estimators = results.plain["estimators"]
    lines = _lines(estimators, _DETECTED_COLUMNS)
    for rows in zip(*(row["by_size"] for row in estimators.values()), strict=True):
        (line,) = _lines(dict(zip(estimators, rows, strict=True)), _DELAYS)
        lines.append((f"  {_size(rows[0])}, {how_many(rows[0]['meals'], 'meal')}", line[1]))
    # the error of the size after the end of a meal stands below the others
    after_end, *later = _lines(estimators, _SIZES)
    columns = [Column(name=name, short=name, text=str) for name in estimators]
    sections = [("", lines), ("", [*later, after_end]), ("", _lines(estimators, _ALARMS))]
    yield terminal_table("", sections, [*columns, Column(name="unit", short="Unit", text=str, left=True)])


def _lines(rows: Mapping[str, Row], columns: Sequence[Column]) -> list[Line]:
    """A line for each heading of the columns, with the texts of every estimator and the unit."""
    lines: list[Line] = []
    for group, of_group in headings(columns):
        texts = {name: "  ".join(column.value_text(row) for column in of_group) for name, row in rows.items()}
        available = {
            name: text if rows[name][of_group[0].name] is not None else NOT_AVAILABLE for name, text in texts.items()
        }
        lines.append((group, [{**available, "unit": of_group[0].head}]))
    return lines


def _size(row: Row) -> str:
    if row["to_g"] is None:
        return f"{row['from_g']:g} g and more"
    return f"{row['from_g']:g} to {row['to_g']:g} g" if row["from_g"] else f"up to {row['to_g']:g} g"


def files_of(config: Detection, results: Results) -> dict[str, bytes]:
    """Figure, by the names of its files."""
    return figure_files("figure", _plot_detection(results, title=_title(config)))


def _title(config: Detection) -> str:
    trial = config.trial
    people = f"each of {trial.people} people of {trial.population.name}" if trial.people > 1 else "one person"
    days = "A day" if config.number_of_days == 1 else f"{config.number_of_days} days"
    under = sorted({case.controller.display_name for case in trial.cases})
    return f"{days} of {people}, with meals that nobody announced; doses by {', '.join(under)}"


_MAX_UNDETECTED_PCT: Final = 50.0
"""Largest percentage of undetected meals at which a median delay is drawn."""
_FEWEST: Final = 0.1
"""Share of the meals that must be detected for quantiles to be meaningful."""


def _plot_detection(results: Results, *, title: str | None = None) -> Figure:
    """Draw delay against false alarms, the error of the size over time, and a day.

    The first panel has a point for each threshold, the one that was asked for filled: the median delay of the meals
    that are detected, against the rises above the threshold on days without a meal. The second one shows what is
    expected of a meal's size less the true size, by the time since its beginning, of the meals detected by then:
    median, and from the 10 % to the 90 % quantile. The others show the first day of the first person.
    """
    figure = _style.new_figure("double", 130.0, title)
    rows: Any = [["curve", "size"], ["eating", "eating"], ["emptying", "emptying"]]
    panels = figure.subplot_mosaic(rows, height_ratios=[1.5, 1.0, 1.0])
    threshold = results.plain["config"]["threshold"]
    entries: dict[str, Artist] = {}
    for index, name in enumerate(results.plain["estimators"]):
        style = _style.line_style(index)
        curve, size, day = (
            results.tables[f"{table}.parquet"].filter(estimator=name) for table in ("curve", "size_error", "day")
        )
        entries[name] = _draw_curve(panels["curve"], curve, threshold, index)
        _draw_size(panels["size"], size, style)
        hours = day["t_min"] / MIN_PER_H
        panels["eating"].plot(hours, day["eating"], **{**style, "linewidth": 0.9})
        panels["emptying"].plot(hours, day["estimated_emptying_mg_min"], **{**style, "linewidth": 0.9})
    true = panels["emptying"].plot(hours, day["emptying_mg_min"], color="black", linewidth=0.9, zorder=1)
    entries["true rate"] = true[0]
    _label(panels, threshold, float(size["after_min"][-1]))
    for axes in panels.values():
        _style.dress(axes)
    figure.align_ylabels([panels["eating"], panels["emptying"]])
    _style.add_legend(figure, entries, "double")
    return figure


def _draw_curve(axes: Axes, curve: pl.DataFrame, threshold: float, index: int) -> Artist:
    style = _style.line_style(index)
    # thresholds that detect enough meals for a meaningful median
    enough = pl.col("missed_pct") + pl.col("already_pct") < _MAX_UNDETECTED_PCT
    curve = curve.filter(pl.col("delay_median_min").is_not_null(), enough)
    across, upwards = "false_alarms_fasting_per_day", "delay_median_min"
    line = axes.plot(curve[across], curve[upwards], marker="o", markersize=2.2, **style)[0]
    for place in curve.filter(threshold=threshold).select(across, upwards).rows():
        axes.plot(*place, marker="o", markersize=5.0, color=style["color"], linestyle="none", zorder=4)
        axes.annotate(
            f"{threshold:g}",
            place,
            xytext=(4 + 2.2 * FONT_PT * index, 4),  # beside one another where two estimators are at one place
            textcoords="offset points",
            fontsize=FONT_PT,
            color=style["color"],
        )
    return line


def _draw_size(axes: Axes, size: pl.DataFrame, style: Mapping[str, Any]) -> None:
    few = pl.col("meals") < _FEWEST * pl.max_horizontal(pl.col("meals").max(), 1)
    error = size.select(pl.when(~few).then(pl.col("^error.*$"))).to_numpy()
    low, middle, high = error.T
    axes.fill_between(size["after_min"], low, high, color=style["color"], alpha=0.15, linewidth=0.0)
    for edge in (low, high):
        axes.plot(size["after_min"], edge, **{**style, "linewidth": 0.4})
    axes.plot(size["after_min"], middle, **style)


def _label(panels: Mapping[str, Axes], threshold: float, longest_min: float) -> None:
    curve, size, eating, emptying = (panels[name] for name in ("curve", "size", "eating", "emptying"))
    # Few false alarms are worth as much room as many, and there may be none.
    curve.set_xscale("symlog", linthresh=0.1)
    curve.set(xlim=(-0.01, None), ylim=(0.0, None))
    curve.xaxis.set_major_formatter(lambda value, place: f"{value:g}")
    curve.set(xlabel="False alarms per fasting day", ylabel="Median delay (min)")
    size.axhline(0.0, color=GREY, linewidth=0.6, zorder=1)
    size.set(xlabel="Time since the meal began (min)", ylabel="Error of the size (g)", xlim=(0.0, longest_min))
    size.xaxis.set_major_locator(_style.every(60.0))
    eating.axhline(threshold, color=GREY, linewidth=0.6, linestyle=(0, (4, 3)), zorder=1)
    eating.set(ylim=(-0.03, 1.03), ylabel="Probability\nof a meal")
    eating.tick_params(labelbottom=False)
    emptying.set(xlabel="Time (h)", ylabel="Emptying of\nthe stomach\n(mg/min)")
    for axes in (eating, emptying):
        axes.set_xlim(0.0, MIN_PER_DAY / MIN_PER_H)
        axes.xaxis.set_major_locator(_style.every(2.0))
