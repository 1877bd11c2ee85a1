"""Paired differences between the cases of a trial: table, and conclusions on margins."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from glucoloop.display_units import OTHERS, in_shown_units, other_value
from glucoloop.metrics.metric import result_named
from glucoloop.reporting.columns import MetricRow
from glucoloop.storage.results import Results
from glucoloop.studies.trial import TrialRequest
from glucoloop.text import NOT_AVAILABLE, how_many
from glucoloop.trials.intervals import Margin, people_for

_COMPARED: Final = (
    *("time_70_180_pct", "time_above_180_pct", "time_above_250_pct", "time_below_70_pct", "time_below_54_pct"),
    *("mean_mg_dl", "minimum_mg_dl", "insulin_total_mU"),
)
"""Metrics whose differences are shown."""
_EVER_BELOW: Final = ("70", "54")
_VERDICTS: Final = {
    "equivalent": "equivalent, since the 95 % interval of the difference lies within ±{margin}",
    "higher": "higher by more than {margin} under {label}",
    "lower": "lower by more than {margin} under {label}",
    "inconclusive": "open, since the 95 % interval of the difference lies neither within ±{margin} nor beyond it",
}
"""Conclusions by the names of `intervals.Margin.verdict`."""


def difference_rows(trial: TrialRequest, plain: Mapping[str, Any]) -> Iterator[MetricRow]:
    """Difference of each controller from the first one in each metric, mean with its interval."""
    cases = plain["differences"]["controllers"].values()
    for metric in dict.fromkeys((*_COMPARED, *trial.margins)):
        how = result_named(metric, trial.further_metrics)
        values = [case["metrics"][metric] for case in cases]

        def own(value: float, divisor: float = how.divisor, digits: int = how.digits) -> str:
            return f"{value / divisor:+z.{digits}f}"

        def other(value: float, unit: str = how.unit, divisor: float = how.divisor, digits: int = how.digits) -> str:
            return f"{other_value(value / divisor, unit):+z.{digits + 1}f}"

        others = [_with_interval(of, other) for of in values] if how.unit in OTHERS else None
        texts = [_with_interval(of, own) for of in values]
        yield MetricRow("", how.title or metric, _unit(how.unit), texts, others)
    for limit in _EVER_BELOW:
        shares = [_with_interval(case["ever_below"][f"{limit}_mg_dl"], "{:+z.1f}".format) for case in cases]
        yield MetricRow("", f"People ever below {limit} mg/dl", "points", shares)


def margin_conclusions(trial: TrialRequest, differences: Mapping[str, Any]) -> dict[str, Any]:
    """Conclusion on each margin as plain values, by metric and controller."""
    return {
        metric: {
            label: {
                "margin": margin,
                "verdict": Margin(metric, margin).verdict(of["metrics"][metric]),
                "people_for_margin": people_for(margin, of["metrics"][metric]["sd"]),
            }
            for label, of in differences["controllers"].items()
        }
        for metric, margin in trial.margins.items()
    }


def sentences(config: TrialRequest, results: Results) -> Iterator[str]:
    """Conclusions on the margins, with the number of people that such a precision takes."""
    differences = results.plain.get("differences", {})
    for metric, by_label in differences.get("margins", {}).items():
        how = result_named(metric, config.further_metrics)
        for label, of in by_label.items():
            margin = in_shown_units(f"{of['margin'] / how.divisor:g} {_unit(how.unit)}".strip())
            conclusion = _VERDICTS[of["verdict"]].format(margin=margin, label=label)
            people = of["people_for_margin"]
            needed = (
                ""
                if people is None
                else (f" An interval of that half width takes {how_many(people, 'person', 'people')}.")
            )
            yield f"{how.title or metric}, {label} against {differences['reference']}: {conclusion}.{needed}"


def _unit(unit: str) -> str:
    """Unit of a difference; percentages differ by points."""
    return "points" if unit == "%" else unit


def _with_interval(difference: Mapping[str, float | None], text: Callable[[float], str]) -> str:
    """Mean difference with its interval, as ``+1.2 [+0.8, +1.6]``."""
    mean, low, high = (difference[name] for name in ("mean", "low", "high"))
    if mean is None or not math.isfinite(mean):
        return NOT_AVAILABLE
    if low is None or high is None or not math.isfinite(low):
        return f"{text(mean)} [n/a]"
    return f"{text(mean)} [{text(low)}, {text(high)}]"
