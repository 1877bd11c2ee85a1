"""Numbers of a league: those of each controller in each cell, and who is best for whom.

Every comparison is paired, a person with the same person. A difference of means has the 95 % interval of Student's t
over the people; that of the worst-off tenth, which no closed form has, the 2.5th and 97.5th percentile of a bootstrap
over the people.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl
from scipy.special import stdtrit

from glucoloop.reporting.columns import Column, Row, decimals, measured, terse_percent, whole
from glucoloop.text import glucose_text

Array = npt.NDArray[np.float64]

_CELL: Final = ("family", "sensor", "scenario")
LINE: Final = (*_CELL, "controller")
RESCUE_CARBS: Final = "rescue_carbs_g"
GLUCAGON_UG: Final = "glucagon_total_ug"
METRICS: Final = (
    *("time_70_180_pct", "time_below_70_pct", "time_below_54_pct", "time_above_180_pct", "time_above_250_pct"),
    *("gri", "lbgi", "hbgi", "mean_mg_dl", "minimum_mg_dl", "time_below_validity_pct", "insulin_total_mU"),
    *(RESCUE_CARBS, GLUCAGON_UG),
)
"""Metrics of each person that are kept."""
A_DAY: Final = {
    "insulin_U_day": ("insulin_total_mU", 1e-3),
    "rescue_g_day": (RESCUE_CARBS, 1.0),
    "glucagon_ug_day": (GLUCAGON_UG, 1.0),
}
"""Numbers of a day, each with its metric and the number of its unit in one of the metric's."""
ALL: Final = ""
"""Sensor and scenario of the line in which a person's numbers are the means over all cells of the family."""
TARGETS: Final[Mapping[str, tuple[float, float]]] = {
    "time_70_180_pct": (70.0, math.inf),
    "time_below_70_pct": (-math.inf, 4.0),
    "time_below_54_pct": (-math.inf, 1.0),
    "time_above_180_pct": (-math.inf, 25.0),
    "time_above_250_pct": (-math.inf, 5.0),
}
"""Bounds between which a percentage is on target, themselves excluded: T. Battelino et al., "Clinical targets for
continuous glucose monitoring data interpretation: recommendations from the international consensus on time in range",
Diabetes Care 42(8), 1593-1603, 2019, for type 1 diabetes."""
_RESAMPLES: Final = 2000
_WORST_PART: Final = 10
"""The worst-off are one of so many people."""
_FEWEST: Final = 5
"""Number of the worst-off below which a bootstrap says nothing."""
_INTERVAL: Final = 0.025, 0.975


def _mean(of: str, group: str, head: str, *, name: str = "", **others: Any) -> Column:
    return Column(name=name or f"{of}_mean", value=pl.col(of).mean(), group=group, head=head, **others)


def _on_target(metric: str) -> pl.Expr:
    return pl.col(metric).is_between(*TARGETS[metric], closed="none")


def _time(metric: str, head: str, short: str) -> Column:
    """Mean of a time, in bold where it is on target."""
    low, high = TARGETS[metric]
    name = f"{metric.removesuffix('_pct')}_mean_pct"

    def strong(row: Row) -> bool:
        return row[name] is not None and bool(low < row[name] < high)

    short = f"{short}\n%"
    return _mean(metric, "Time (%), target", head, name=name, short=short, short_text=terse_percent, strong=strong)


def signed(value: float) -> str:
    """Text of a difference, with its sign."""
    return f"{value:+z.1f}"


def _harm(bound: int) -> list[Column]:
    """Number of people who are harmed, and how the difference from the reference is spread over all people."""
    more, of = pl.col(f"more_{bound}_pct"), f"below_{bound}"
    harmed = more > pl.col("worse_by_pct")
    column = functools.partial(Column, group=f"Below {bound} mg/dl longer than the reference")
    count = pl.when(more.count() > 0).then(harmed.sum())
    ordered = pl.col("person").filter(harmed).sort_by(more.filter(harmed), descending=True, maintain_order=True)
    quantiles = (("median", 0.5, "median (%)"), ("p95", 0.95, "95th"), ("most", 1.0, "most"))
    return [
        column(name=f"harmed_{of}", value=count, head="people", text=whole, short=f"harmed\n<{bound}"),
        Column(name=f"harmed_{of}_people", value=ordered),
        *(
            column(name=f"more_{of}_{name}_pct", value=more.quantile(at, "linear"), head=head, text=signed)
            for name, at, head in quantiles
        ),
    ]


def difference(of: str, name: str, group: str, short: str | None = None, *, factor: str = "factor") -> list[Column]:
    """Mean of paired differences, with its interval; `factor` has Student's factor by `factors`."""
    mean = pl.col(of).mean()
    half = pl.col(factor).first() * pl.col(of).std() / pl.col(of).count().sqrt()
    column = functools.partial(Column, group=group, text=signed)
    return [
        column(name=name, value=mean, head="mean", short=short),
        column(name=f"{name}_low", value=mean - half, head="from"),
        column(name=f"{name}_high", value=mean + half, head="to"),
    ]


_people = functools.partial(Column, group="People")
_worst_in_range: Final = pl.col("time_70_180_pct").quantile(0.05, "linear")
_all_targets: Final = 100.0 * pl.all_horizontal(*map(_on_target, TARGETS)).mean()
_ever_below_54: Final = (pl.col("minimum_mg_dl") < 54.0).sum()
_not_valid: Final = (pl.col("time_below_validity_pct") > 0.0).sum()
COLUMNS: Final = (
    _people(name="people", value=pl.len(), empty=0, head="known", text=whole),
    _people(
        name="on_target_pct",
        value=_all_targets,
        head="on all targets (%)",
        short="on all\ntargets %",
        short_text=terse_percent,
    ),
    _people(name="ever_below_54", value=_ever_below_54, head="ever < 54", text=whole, short="ever\n<54"),
    _people(name="people_below_validity", value=_not_valid, head="model not valid", text=whole),
    _mean("gri", "Risk", "GRI", text=decimals(1), short="GRI"),
    _mean("lbgi", "Risk", "LBGI", text=decimals(2)),
    _mean("hbgi", "Risk", "HBGI", text=decimals(2)),
    _time("time_70_180_pct", "70-180: >70", "70-180"),
    Column(name="time_70_180_p5_pct", value=_worst_in_range, group="Time (%), target", head="its 5th percentile"),
    _time("time_below_70_pct", "<70: <4", "<70"),
    _time("time_below_54_pct", "<54: <1", "<54"),
    _time("time_above_180_pct", ">180: <25", ">180"),
    _time("time_above_250_pct", ">250: <5", ">250"),
    _mean("mean_mg_dl", "Glucose (mg/dl)", "mean", name="mean_mg_dl", text=glucose_text),
    _mean("insulin_U_day", "Insulin", "U/day", name="insulin_U_day", text=decimals(1), short="U/day"),
    *_harm(54),
    *_harm(70),
    *difference("more_in_range_pct", "in_range_difference_pct", "70-180 (%) less reference", "70-180\nless ref."),
    *difference("more_54_pct", "below_54_difference_pct", "< 54 (%) less reference"),
    *difference("more_70_pct", "below_70_difference_pct", "< 70 (%) less reference"),
    *difference("more_gri", "gri_difference", "GRI less reference", "GRI\nless ref."),
)
"""Numbers of a controller in a cell; the people who are harmed most come first."""
RESCUE: Final = _mean(
    "rescue_g_day", "Rescue carbohydrate", "g/day", name="rescue_g_day", text=decimals(1), short="rescue\ng/day"
)
"""Carbohydrate that people ate against low glucose, where they do."""
GLUCAGON: Final = _mean(
    "glucagon_ug_day", "Glucagon", "ug/day", name="glucagon_ug_day", text=decimals(0), short="glucagon\nug/day"
)
"""Glucagon that the pump gave, where the controllers give it."""
EQUATIONS, PROFILE = "equations", "profile"
DESIGN: Final = Column(
    name="design",
    group="Controller",
    head="designed by",
    text=str,
    missing=lambda row: "",
    left=True,
    short="designed\nby",
)
"""Basis of the design of a controller: the equations of the patient that it is tried on, or a profile alone."""
_MORE: Final = {
    "more_in_range_pct": "time_70_180_pct",
    "more_70_pct": "time_below_70_pct",
    "more_54_pct": "time_below_54_pct",
    "more_gri": "gri",
}
"""Metric of each difference from the reference."""


def factors(numbers_of_pairs: pl.Series) -> pl.Series:
    """Factors by which the standard error of a mean of so many differences gives half of the interval."""
    free = np.maximum(numbers_of_pairs.to_numpy().astype(float) - 1.0, 1.0)
    return pl.Series(stdtrit(free, _INTERVAL[1]))


def line_table(
    people: pl.DataFrame,
    lines: pl.DataFrame,
    reference: str,
    worse_by_pct: float,
    columns: Sequence[Column] = COLUMNS,
) -> pl.DataFrame:
    """The numbers of each line over its people; those less the reference over the people known under it as well.

    `people` has the columns of `LINE`, ``person``, those of `A_DAY`, those of `METRICS` and whatever else the `columns`
    are made of; `lines` the columns of `LINE` alone.
    """
    same = [*_CELL, "person"]
    under_reference = people.filter(controller=reference).select(*same, **{f"ref_{of}": of for of in _MORE.values()})
    paired = people.join(under_reference, on=same, how="left", maintain_order="left").with_columns(
        worse_by_pct=worse_by_pct,
        compared=pl.col("ref_gri").count().over(LINE),
        **{more: pl.col(of) - pl.col(f"ref_{of}") for more, of in _MORE.items()},
    )
    return measured(paired.with_columns(factor=factors(paired["compared"])), lines, columns)


def over_all_cells(people: pl.DataFrame, cells: int) -> pl.DataFrame:
    """Each person once for each controller: means over the cells of the family, for those known in all `cells`.

    The minimum glucose is that of all cells.
    """
    results = people.group_by("family", "controller", "person", maintain_order=True).agg(
        pl.col(*METRICS, *A_DAY).exclude("minimum_mg_dl").mean(), pl.col("minimum_mg_dl").min(), pl.len()
    )
    every = [pl.lit(ALL).alias(name) for name in ("sensor", "scenario")]
    known = results.filter(pl.col("len") == cells).with_columns(every)
    return known.select(*LINE, "person", *METRICS, *A_DAY)


def ranking(people: pl.DataFrame, family: str, seed: int) -> dict[str, Any]:
    """The ranking of a family by the glycemia risk index, on the people who are known under all controllers.

    `people` are those of `over_all_cells`. For all people and for the worst-off tenth under each controller: the best
    controller, the next one, and the difference of the two means with its interval. ``for_whom`` has the number of
    people for whom each controller alone has the minimum index.
    """
    wide = people.filter(family=family).pivot(on="controller", index="person", values="gri").drop_nulls()
    labels = [name for name in wide.columns if name != "person"]
    if not labels or not wide.height:
        return {"family": family, "people": 0}
    risk = wide.select(labels).to_numpy().astype(np.float64)
    least = risk.min(axis=1, keepdims=True)
    alone = ((risk == least).sum(axis=1) == 1)[:, None] & (risk == least)
    return {
        "family": family,
        "people": wide.height,
        "overall": _first_two(labels, risk.mean(axis=0), functools.partial(_of_means, risk)),
        "worst_off": {
            "people": _tenth(wide.height),
            **_first_two(labels, _worst_mean(risk), functools.partial(_of_worst, risk, seed)),
        },
        "for_whom": dict(zip(labels, alone.sum(axis=0).tolist(), strict=True)),
    }


def _first_two(labels: list[str], values: Array, interval: Any) -> dict[str, Any]:
    """The minimum value and the next, and the second less the first, with its interval; and who shares the minimum."""
    order = np.argsort(values, kind="stable")
    equal = [labels[place] for place in order if values[place] == values[order[0]]]
    results = {
        "gri": {labels[place]: float(values[place]) for place in order},
        "best": labels[order[0]],
        "equal": equal if len(equal) > 1 else [],
    }
    if order.size < 2:
        return results
    best, second = order[:2]
    low, high = interval(best, second)
    return {
        **results,
        "second": labels[second],
        "difference": float(values[second] - values[best]),
        "low": float(low),
        "high": float(high),
        "distinguished": bool(low > 0.0),
    }


def _of_means(risk: Array, best: int, second: int) -> tuple[float, float]:
    """Interval of the mean paired difference, by Student's t; without bounds for one person."""
    difference = risk[:, second] - risk[:, best]
    if difference.size < 2:
        return -math.inf, math.inf
    half = stdtrit(difference.size - 1, _INTERVAL[1]) * difference.std(ddof=1) / math.sqrt(difference.size)
    return float(difference.mean() - half), float(difference.mean() + half)


def _of_worst(risk: Array, seed: int, best: int, second: int) -> tuple[float, float]:
    """Interval of the difference of the worst-off, by a bootstrap over the people; without bounds for few of them."""
    if _tenth(len(risk)) < _FEWEST:
        return -math.inf, math.inf
    resampled = np.random.default_rng(seed).integers(0, len(risk), (_RESAMPLES, len(risk)))
    worst = [_worst_mean(risk[resampled, column].T) for column in (best, second)]
    low, high = np.quantile(worst[1] - worst[0], _INTERVAL)
    return float(low), float(high)


def _tenth(people: int) -> int:
    return -(-people // _WORST_PART)


def _worst_mean(values: Array) -> Array:
    """Mean of the maximum tenth of the values in each column ``(people, columns)``, a whole number of people."""
    number = _tenth(len(values))
    return np.asarray(np.partition(values, len(values) - number, axis=0)[-number:].mean(axis=0))


def harms(rows: Sequence[Row], reference: str) -> list[Row]:
    """The cell in which each controller harms the largest part of the people below 54 mg/dl, or else below 70.

    With ``harmed_cells``, the cells in which it harms anybody, and ``equal_cells``, those with as large a part.
    """
    cells: dict[str, list[Row]] = {}

    def share(row: Row) -> tuple[float, ...]:
        return tuple((row[f"harmed_below_{bound}"] or 0) / max(row["people"], 1) for bound in (54, 70))

    for row in rows:
        if row["sensor"] != ALL and row["controller"] != reference and any(share(row)):
            cells.setdefault(row["controller"], []).append(row)
    worst = [(max(of, key=share), of) for of in cells.values()]
    return [
        {**row, "harmed_cells": len(of), "equal_cells": sum(share(other) == share(row) for other in of)}
        for row, of in worst
    ]
