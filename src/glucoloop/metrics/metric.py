"""Metric of a run: an accumulator over its samples and over the points of its grid of one minute.

A metric joins the table and the JSON of a run, the columns of a trial, and the documentation by one entry in `METRICS`.
A metric of another package, by an entry point in the group ``glucoloop.metrics`` or as ``module:Class``, is computed
where a request names it. No numerical library is imported before a metric is computed.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree, static
from glucoloop.arguments import is_traced
from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.text import NOT_AVAILABLE, NOT_VALID

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from glucoloop.simulation.loop import Sampled


TARGET_RANGE_MG_DL: Final = (70.0, 180.0)
"""Target range of the consensus on time in range, both ends included."""
LOWEST_GLUCOSE_MG_DL: Final = 60.0
"""Lower bound on glucose, constraint (19) of Parker, Doyle & Peppas (1999)."""


@pytree
class Trajectory:
    """Fixed values of a run, which a metric knows from its beginning."""

    setpoint_mg_dl: jax.Array | float
    limits: DoseLimits = PARKER_1999_LIMITS
    """Bounds of the constraints (17) and (18)."""
    lowest_glucose_mg_dl: jax.Array | float = LOWEST_GLUCOSE_MG_DL
    inside_min: tuple[jax.Array | float, ...]
    """Times after a sample of the points of the grid until the next sample, that one included."""
    sample_min: float | None = static(default=None)
    """The time from one sample to the next where `inside_min` is traced and it is known all the same."""

    @property
    def sample_time_min(self) -> jax.Array | float:
        """Time from one sample to the next."""
        return self.inside_min[-1]

    @property
    def concrete_sample_min(self) -> float:
        """The same as a number, on which the size of a memory may rest; Refusal where it is traced."""
        if self.sample_min is not None:
            return self.sample_min
        if is_traced(self.sample_time_min):
            raise Refusal("the sample time of a traced trace is not known; summarise it outside of jit and vmap")
        return float(self.sample_time_min)


@dataclass(frozen=True, kw_only=True)
class Ended:
    """Facts about a finished run, with which a metric makes its results."""

    samples: int
    points: int
    """Number of points of the grid, those of start and end included."""
    sample_time_min: Any
    first_meal_min: Any
    """Time of the sample in which the first meal begins; 0 if nothing is eaten."""
    finite_glucose: Any
    """Whether glucose was finite at every point of the grid, ``(...)``."""
    finite_insulin: Any
    """Whether all delivered insulin was finite, ``(...)``."""
    xp: Any = jnp
    """Module of the arrays, ``jax.numpy`` or ``numpy``."""
    rounding_mU_min: float = 1e-9
    """Tolerance for the rounding of rates, so that a dose at its limit is within it."""

    @property
    def end_min(self) -> Any:
        """Time of the last point of the grid."""
        return self.samples * self.sample_time_min

    def of_glucose(self, values: Any) -> Any:
        """Values that rest on glucose: NaN where it was not finite throughout, since any number would mislead."""
        return self.xp.where(self.finite_glucose, values, self.xp.nan)

    def of_insulin(self, values: Any) -> Any:
        """Values that rest on delivered insulin: NaN where it was not finite throughout."""
        return self.xp.where(self.finite_insulin, values, self.xp.nan)

    def pct(self, count: Any) -> Any:
        """Percentage of the points of the grid; NaN where glucose was not finite throughout."""
        return self.of_glucose(100.0 * count / self.points)


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
    moment: bool = False
    """Whether it is a moment of the run [min], which tables of long runs show as day and clock."""

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


class Metric(Component):
    """An accumulator: its results, settings and computation. It counts at points of the grid, at samples, or at both.

    All methods are pure functions of JAX arrays with the shape of the people, `()` for one. The same code runs in
    `summarise`, as a scan over a trace, and in the compiled loop of a cohort. Only what `finish` uses beside operators
    comes from `Ended`, since it gets arrays of NumPy as well as those of JAX.
    """

    kind: ClassVar = "metric"
    section: ClassVar[str] = "Further metrics"
    """Heading of its rows in tables."""
    always: ClassVar[bool] = False
    """Whether it is computed without a request."""
    takes_meals: ClassVar[bool] = False
    """Whether it needs what was eaten at each sample, which a loop without such a metric does not carry."""
    numbers: ClassVar[tuple[Result, ...]] = ()
    """Results of the metric, where they do not depend on its settings."""

    @property
    def results(self) -> tuple[Result, ...]:
        """Results with these settings; Refusal for settings that make an impossible name of a result."""
        return self.numbers

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> Any:
        """State at the start, from glucose and the rate at steady state: a pytree of numbers.

        The first point of the grid is counted by `point` afterwards.
        """
        raise Refusal(
            f"the metric {self.name} has no method init; write init(trajectory, glucose_mg_dl, insulin_mU_min)"
        )

    def point(self, trajectory: Trajectory, state: Any, glucose_mg_dl: jax.Array, t_min: jax.Array) -> Any:
        """State after a point of the grid of one minute."""
        return state

    def sample(self, trajectory: Trajectory, state: Any, happened: Sampled, t_min: jax.Array) -> Any:
        """State after a sample of the loop, and before the points of the grid that follow it."""
        return state

    def finish(self, trajectory: Trajectory, state: Any, ended: Ended) -> dict[str, Any]:
        """Results by the names of `results`."""
        raise Refusal(f"the metric {self.name} has no method finish; write finish(trajectory, state, ended)")


def count(condition: jax.Array, like: jax.Array) -> jax.Array:
    """A truth as 1 or 0, in the type of another array."""
    return condition.astype(like.dtype)


def of_glucose(
    metric: Metric, t_min: ArrayLike, glucose_mg_dl: ArrayLike, setpoint_mg_dl: ArrayLike, first_meal_min: float = 0.0
) -> dict[str, Any]:
    """Results of a metric of glucose alone over a course ``(points, ...)`` on an even grid, without a loop."""
    t, glucose = jnp.asarray(t_min), jnp.asarray(glucose_mg_dl, float)
    trajectory = Trajectory(setpoint_mg_dl=jnp.asarray(setpoint_mg_dl, float), inside_min=(t[1] - t[0],))

    def point(state: Any, at: tuple[jax.Array, jax.Array]) -> tuple[Any, None]:
        return metric.point(trajectory, state, at[1], at[0]), None

    start = metric.init(trajectory, glucose[0], jnp.zeros_like(glucose[0]))
    state = jax.lax.scan(point, start, (t, glucose))[0]
    finite = jnp.isfinite(glucose).all(axis=0)
    ended = Ended(
        samples=t.shape[0] - 1,
        points=t.shape[0],
        sample_time_min=trajectory.sample_time_min,
        first_meal_min=first_meal_min,
        finite_glucose=finite,
        finite_insulin=jnp.zeros_like(finite),
    )
    return metric.finish(trajectory, state, ended)


METRICS: Final = Catalogue(
    Metric,
    {
        "time-in-ranges": "glucoloop.metrics.glycemia:TimeInRanges",
        "low-events": "glucoloop.metrics.glycemia:LowEvents",
        "mean-and-variation": "glucoloop.metrics.glycemia:MeanAndVariation",
        "risk-indices": "glucoloop.metrics.glycemia:RiskIndices",
        "extremes": "glucoloop.metrics.regulation:Extremes",
        "settling": "glucoloop.metrics.regulation:Settling",
        "squared-error": "glucoloop.metrics.regulation:SquaredError",
        "insulin": "glucoloop.metrics.dosing:Insulin",
        "insulin-on-board": "glucoloop.metrics.dosing:OnBoard",
        "carbs-on-board": "glucoloop.metrics.dosing:CarbsOnBoard",
        "samples": "glucoloop.metrics.dosing:Samples",
        "constraints": "glucoloop.metrics.dosing:Constraints",
        "rescues": "glucoloop.metrics.dosing:Rescues",
        "glucagon": "glucoloop.metrics.dosing:Glucagon",
        "sensor-accuracy": "glucoloop.metrics.accuracy:SensorAccuracy",
    },
    example="sensor-accuracy",
)
"""Metrics by name, in the order of tables and columns."""


@functools.cache
def _always() -> tuple[Metric, ...]:
    """Metrics that are computed in every run."""
    return tuple(metric() for metric in METRICS.values() if metric.always)


def default_results() -> tuple[Result, ...]:
    """Results of the metrics that are computed in every run, in the order of tables and columns."""
    return tuple(result for metric in _always() for result in metric.results)


def metrics_with(further: Iterable[str | Metric] = ()) -> Iterator[Metric]:
    """Metrics that are always computed, and further ones, as objects or by their texts.

    An unknown metric or setting, and a metric with a result of a name that another one has, are refused.
    """
    seen: dict[str, str] = {}
    requested = (METRICS.choose(metric) if isinstance(metric, str) else metric for metric in further)
    always = {metric.name for metric in _always()}
    for metric in (*_always(), *(metric for metric in requested if metric.name not in always)):
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
