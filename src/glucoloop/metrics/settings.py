"""Catalogue of metrics: the numbers of each, how they are shown, and the place of the fold that computes them.

A metric joins the table and the JSON of a run, the columns of a trial, and the documentation by one entry in `METRICS`.
One that is not usual, or of another package, by an entry point in the group ``glucoloop.metrics`` or as
``module:attribute``, is computed where it is asked for by name. Nothing here imports a numerical library.
"""

from __future__ import annotations

import math
import types
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.component.part import MadePart
from glucoloop.refusal import Refusal
from glucoloop.text import NOT_AVAILABLE, NOT_VALID
from glucoloop.units import MU_PER_U


@dataclass(frozen=True)
class Result:
    """One number of a metric."""

    name: str
    """Key in JSON and column of trials, with the unit of the value at its end."""
    summary: str
    """Definition, one sentence."""
    title: str = ""
    """Name in tables; without one it is not shown there."""
    unit: str = ""
    """Unit in tables."""
    digits: int = 1
    divisor: float = 1.0
    """Number by which the value is divided to be in the unit of tables."""
    exact_if: str = ""
    """Result that is true where the value is exact, and false where it is only a lower bound."""
    seldom: bool = False
    """Whether tables leave it out if it is 0 in all runs."""
    concentration: bool = False
    """Whether it is a concentration of glucose; one below 0 is not valid."""
    fall: bool = False
    """Whether it is a fall of glucose below the setpoint; one to below 0 is not valid."""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise Refusal(
                f"{self.name!r} cannot name the result of a metric; use letters, digits and underscores only, "
                "as in 'time_70_140_pct'"
            )

    @property
    def heading(self) -> str:
        """Name and unit in tables."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def text(self, value: float, setpoint_mg_dl: float = math.inf) -> str:
        """Text of a value in the unit of tables, without the unit; the setpoint is that of a fall."""
        if (self.concentration and value < 0.0) or (self.fall and value > setpoint_mg_dl):
            return NOT_VALID
        return f"{value / self.divisor:z.{self.digits}f}" if math.isfinite(value) else NOT_AVAILABLE


class MetricPart(MadePart):
    """A metric; `make` names the `metrics.protocol.Metric`, a class or a function."""

    kind: ClassVar = "metric"
    section: ClassVar[str] = "Further metrics"
    """Heading of its rows in tables."""
    always: ClassVar[bool] = False
    """Whether it is computed without being asked for."""
    numbers: ClassVar[tuple[Result, ...]] = ()
    """Numbers that it gives, where they do not depend on its settings."""

    @property
    def results(self) -> tuple[Result, ...]:
        """Numbers that it gives with these settings; Refusal for settings that make an impossible name of a number."""
        return self.numbers


_MODULES: Final = {"Glycemia": "glycemia", "Regulation": "regulation", "Sensor": "accuracy"}


def _metric(
    name: str, section: str, summary: str, *numbers: Result, always: bool = True, sources: tuple[str, ...] = ()
) -> type[MetricPart]:
    """A metric of this package; ``low-events`` is the class ``LowEvents`` of the module of its section."""
    accumulator = name.title().replace("-", "")
    place = f"glucoloop.metrics.{_MODULES.get(section, 'dosing')}:{accumulator}"
    body = {
        "__doc__": summary,
        "__module__": __name__,
        "make": place,
        "section": section,
        "numbers": numbers,
        "always": always,
        "sources": sources,
    }
    return types.new_class(f"{accumulator}Part", (MetricPart,), {"name": name}, lambda names: names.update(body))


def _share(name: str, where: str, title: str = "", more: str = "", **shown: Any) -> Result:
    summary = f"Percentage of time with glucose {where}{more}."
    return Result(name, summary, title or f"Time {where}", "%", **shown)


def _minutes(name: str, summary: str, title: str, **shown: Any) -> Result:
    return Result(name, summary, title, "min", 0, **shown)


def _events(name: str, bound_mg_dl: int) -> Result:
    summary = f"Times that glucose fell below {bound_mg_dl} mg/dl for 15 min or longer, on the controller's samples."
    return Result(name, summary, f"Events below {bound_mg_dl} mg/dl", digits=0)


def _samples(name: str, where: str, title: str, *, seldom: bool = False) -> Result:
    return Result(f"samples_{name}", f"Samples {where}.", title, digits=0, seldom=seldom)


_CLARKE: Final = {
    "A": "accurate",
    "B": "off with little consequence",
    "C": "which would lead to a treatment that is not needed",
    "D": "which would hide low or high glucose",
    "E": "which would lead to the opposite treatment",
}

METRICS: Final = Catalogue(
    MetricPart,
    (
        _metric(
            "time-in-ranges",
            "Glycemia",
            "Times in ranges of glucose, and the risk index that follows from them.",
            _share(
                "time_70_180_pct",
                "from 70 to 180 mg/dl",
                more=", both included; with those below 70 and above 180 it makes 100",
            ),
            _share("time_above_180_pct", "above 180 mg/dl"),
            _share("time_above_250_pct", "above 250 mg/dl"),
            _share("time_below_70_pct", "below 70 mg/dl"),
            _share("time_below_60_pct", "below 60 mg/dl"),
            _share("time_below_54_pct", "below 54 mg/dl"),
            _share(
                "time_below_validity_pct",
                "below the valid range of the patient's model",
                "Time below the model's validity",
                "; a value above 0 means severe hypoglycemia",
                seldom=True,
            ),
            Result("gri", "Glycemia risk index.", "Glycemia risk index"),
            sources=("battelino2019", "klonoff2023"),
        ),
        _metric(
            "low-events",
            "Glycemia",
            "Events of low glucose.",
            _events("low_events", 70),
            _events("very_low_events", 54),
            sources=("battelino2023",),
        ),
        _metric(
            "mean-and-variation",
            "Glycemia",
            "Mean glucose and its variation.",
            Result("mean_mg_dl", "Mean glucose over the grid.", "Mean glucose", "mg/dl", concentration=True),
            Result(
                "cv_pct",
                "Coefficient of variation: standard deviation (n - 1) in percent of the mean.",
                "Coefficient of variation",
                "%",
            ),
            Result("gmi_pct", "Glucose management indicator.", "Glucose management indicator", "%"),
            sources=("bergenstal2018",),
        ),
        _metric(
            "risk-indices",
            "Glycemia",
            "Risk of low and of high glucose.",
            Result("lbgi", "Low blood glucose index.", "Low blood glucose index", digits=2),
            Result("hbgi", "High blood glucose index.", "High blood glucose index", digits=2),
            sources=("kovatchev1997",),
        ),
        _metric(
            "extremes",
            "Regulation",
            "Least and greatest glucose.",
            Result("undershoot_mg_dl", "Setpoint minus the least glucose.", "Undershoot", "mg/dl", fall=True),
            Result("minimum_mg_dl", "Least glucose of the run.", "Least glucose", "mg/dl", concentration=True),
            _minutes("minimum_t_min", "Time from the start of the run at which the minimum is first reached.", "  at"),
            Result("overshoot_mg_dl", "Greatest glucose minus the setpoint.", "Overshoot", "mg/dl"),
            Result("peak_mg_dl", "Greatest glucose of the run.", "Greatest glucose", "mg/dl", concentration=True),
            _minutes("peak_t_min", "Time from the start of the run at which the peak is first reached.", "  at"),
        ),
        _metric(
            "settling",
            "Regulation",
            "Time until glucose stays near the setpoint.",
            _minutes(
                "settling_2pct_min",
                "Last minute farther than 2 % of the setpoint from it, plus 1, minus the time of the first meal, "
                "or of the start if nothing is eaten; 0 if never so far. Where not settled, the horizon plus 1 "
                "takes the place of that minute.",
                "Settling, 2 % band",
                exact_if="settled_2pct",
            ),
            Result("settled_2pct", "Whether glucose is within 2 % of the setpoint at the end."),
            _minutes(
                "settling_5pct_min",
                "Settling time for a band of 5 % of the setpoint.",
                "Settling, 5 % band",
                exact_if="settled_5pct",
            ),
            Result("settled_5pct", "Whether glucose is within 5 % of the setpoint at the end."),
        ),
        _metric(
            "squared-error",
            "Regulation",
            "Sum of squared errors.",
            Result(
                "sse",
                "Sum over the controller's samples of the squared distance from the setpoint [(mg/dl)^2].",
                "Sum of squared errors",
                "(mg/dl)²",
                digits=0,
            ),
        ),
        _metric(
            "insulin",
            "Insulin",
            "Insulin delivered and its changes.",
            Result(
                "insulin_total_mU",
                "Insulin delivered over the run.",
                "Insulin delivered",
                "U",
                digits=2,
                divisor=MU_PER_U,
            ),
            _minutes(
                "insulin_off_min",
                "Time of the samples at which the pump delivered no insulin at all.",
                "Time without insulin",
            ),
            _minutes(
                "longest_insulin_off_min", "Longest time without insulin that no delivery interrupts.", "  longest"
            ),
            Result(
                "insulin_total_variation_mU_min",
                "Sum of the absolute changes from sample to sample, the first from the rate at rest.",
                "Total variation",
                "mU/min",
            ),
            Result("largest_change_mU_min", "Largest of these changes.", "Largest change", "mU/min"),
        ),
        _metric(
            "samples",
            "Samples",
            "Samples at which the controller or its guard met a difficulty.",
            _samples("saturated", "at which the controller wanted a dose beyond its limits", "Dose beyond limits"),
            _samples("missing", "without a valid, finite reading", "Reading missing"),
            _samples("not_converged", "at which an optimisation did not converge", "Not converged"),
            _samples(
                "non_finite",
                "at which the controller computed no finite dose, or was restarted by its guard because of that",
                "Dose not finite",
            ),
            _samples(
                "rejected",
                "at which the guard rejected a reading; 0, like the next three, without a guard",
                "Reading not believed",
                seldom=True,
            ),
            _samples(
                "fallback",
                "at which the guard gave at most the basal rate, because readings were missing",
                "Fallback to the basal rate",
                seldom=True,
            ),
            _samples("suspended", "at which the guard suspended insulin", "Insulin suspended", seldom=True),
            _samples(
                "dose_limited",
                "at which the guard cut the dose to its limit per hour or of insulin on board",
                "Dose cut by the guard",
                seldom=True,
            ),
        ),
        _metric(
            "constraints",
            "Bounds of Parker et al. (1999)",
            "Constraints of Parker, Doyle and Peppas (1999).",
            Result("rate_satisfied", "Constraint (17): no change beyond the pump's limit.", "Change of the rate"),
            Result("magnitude_satisfied", "Constraint (18): every rate within the pump's limits.", "Rate"),
            Result("glucose_satisfied", "Constraint (19): glucose never below 60 mg/dl.", "Glucose not below 60 mg/dl"),
            Result("constraints_satisfied", "Whether all three constraints hold.", "All three"),
            sources=("parker1999",),
        ),
        _metric(
            "rescues",
            "Rescue carbohydrate",
            "Carbohydrate that the person ate against low glucose, where the loop has a rescue.",
            Result("rescue_carbs_g", "Carbohydrate that was eaten against low glucose.", "Carbohydrate", "g", 0),
            Result("rescues", "Times that it was eaten.", "Times", digits=0),
            always=False,
        ),
        _metric(
            "sensor-accuracy",
            "Sensor",
            "Accuracy of the readings: mean absolute relative difference, bias and error grid.",
            Result(
                "mard_pct",
                "Mean absolute relative difference of the readings from the patient's glucose at the samples.",
                "Mean absolute relative difference",
                "%",
            ),
            Result("reading_bias_mg_dl", "Mean difference of the readings from it.", "Bias of the readings", "mg/dl"),
            *(
                Result(
                    f"clarke_{zone.lower()}_pct",
                    f"Percentage of the readings in zone {zone} of Clarke's error grid, {what}.",
                    f"Error grid, zone {zone}",
                    "%",
                )
                for zone, what in _CLARKE.items()
            ),
            always=False,
            sources=("clarke1987",),
        ),
    ),
    example="sensor-accuracy",
)

_USUAL: Final[tuple[MetricPart, ...]] = tuple(part() for part in METRICS.values() if part.always)
RESULTS: Final = tuple(result for metric in _USUAL for result in metric.results)
"""Results of the metrics that are always computed, in the order of tables and columns."""


def metrics_with(further: Iterable[str | MetricPart] = ()) -> Iterator[MetricPart]:
    """Metrics that are always computed, and further ones, as parts or by their texts.

    An unknown metric or setting, and a metric with a result of a name that another one has, are refused.
    """
    seen: dict[str, str] = {}
    requested = (METRICS.choose(metric) if isinstance(metric, str) else metric for metric in further)
    usual = {metric.name for metric in _USUAL}
    for metric in (*_USUAL, *(metric for metric in requested if metric.name not in usual)):
        for result in metric.results:
            if result.name in seen:
                raise Refusal(
                    f"the metric {metric.name} gives {result.name}, which the metric {seen[result.name]} gives "
                    "already; leave one of them out, or rename it"
                )
            seen[result.name] = metric.name
        yield metric


def result_named(name: str, further: Iterable[str] = ()) -> Result:
    """Description of a result by its name; Refusal for a name that no metric has."""
    known = {result.name: result for metric in metrics_with(further) for result in metric.results}
    if name not in known:
        raise Refusal(f"unknown metric {name!r}; use one of {', '.join(known)}")
    return known[name]
