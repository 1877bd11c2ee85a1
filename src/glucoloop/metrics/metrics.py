"""Record of the metrics of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, Self

import jax
import numpy as np

from glucoloop._pytree import pytree, represented, static
from glucoloop.metrics.catalogue import default_results
from glucoloop.refusal import Refusal

_EVERYDAY: Final = (
    *("time_70_180_pct", "time_above_180_pct", "time_above_250_pct", "time_below_70_pct", "time_below_54_pct", "gri"),
    *("mean_mg_dl", "cv_pct", "undershoot_mg_dl", "minimum_mg_dl", "peak_mg_dl", "settling_2pct_min"),
    *("insulin_total_mU", "insulin_off_min"),
)
"""Results in the short table of ``print(metrics)``."""


@represented
@pytree
class Metrics:
    """Metrics of a run; each is an attribute and has the shape of the people, `()` for one.

    The names and definitions are those of the results in `metrics.catalogue.METRICS`, and of further metrics that were
    asked for. Glucose is the patient's own, free of noise, on the trace's grid of one minute. A time in a
    range is the percentage of the points of that grid, both ends included. Insulin is what the pump delivered.
    """

    names: tuple[str, ...] = static()
    values: tuple[jax.Array, ...]
    further: tuple[str, ...] = static(default=())
    """Texts of the further metrics, whose results are among the names."""

    @classmethod
    def of(cls, by_name: Mapping[str, Any], further: tuple[str, ...] = ()) -> Self:
        """Record of metrics by name."""
        return cls(names=tuple(by_name), values=tuple(by_name.values()), further=further)

    def by_name(self) -> dict[str, jax.Array]:
        """Metrics by name."""
        return dict(zip(self.names, self.values, strict=True))

    def __getattr__(self, name: str) -> jax.Array:
        # only what is neither a field nor a method comes here; a record that is being made has no fields yet
        names = self.__dict__.get("names", ())
        if name not in names:
            raise AttributeError(f"there is no metric {name!r}; there are {', '.join(names)}")
        value: jax.Array = self.values[names.index(name)]
        return value

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.names]

    def __str__(self) -> str:
        return _short_table(self.by_name())

    def as_dict(self) -> dict[str, float | int | bool | None]:
        """Plain numbers by name, ready for JSON, which knows no NaN: it becomes None.

        Raises
        ------
        ValueError
            For more than one person.
        """
        plain: dict[str, float | int | bool | None] = {}
        for name, array in self.by_name().items():
            value = np.asarray(array)
            if value.ndim:
                raise Refusal(
                    f"these are the metrics of people of shape {value.shape}, not of one; "
                    "pick one with jax.tree.map(lambda values: values[i], metrics)"
                )
            number = value.item()
            plain[name] = None if isinstance(number, float) and not math.isfinite(number) else number
        return plain


def _short_table(metrics: Mapping[str, Any]) -> str:
    """The most used metrics with units: of one person, or their distribution over people."""
    people = np.shape(metrics["minimum_mg_dl"])
    lines = (
        [f"{'':31}{'5th pct.':>9}{'median':>9}{'95th pct.':>10}   of {np.prod(people, dtype=int)} people"]
        if people
        else []
    )
    for result in filter(lambda result: result.name in _EVERYDAY, default_results()):
        values = np.asarray(metrics[result.name], float) / result.divisor
        finite = values[np.isfinite(values)]
        shown = np.percentile(finite, [5, 50, 95]) if people and finite.size else values.reshape(-1)[:1]
        at_least = "+" if not people and result.exact_if and not bool(metrics[result.exact_if]) else ""
        numbers = "".join(f"{value:9.{result.digits}f}" for value in shown)
        lines.append(f"{result.title:31}{numbers}{at_least} {result.unit}".rstrip())
    return "\n".join(lines)
