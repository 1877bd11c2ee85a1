"""Metrics of a run: all as one accumulator, which `summarise` runs over a trace and a cohort within its program."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, Self

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._kept_programs import kept_jit
from glucoloop._pytree import pytree, static
from glucoloop._representation import represented
from glucoloop.arguments import ArgumentTypeError, checked, is_traced
from glucoloop.control.protocol import Decision
from glucoloop.metrics.metric import LOWEST_GLUCOSE_MG_DL, Ended, Metric, Trajectory, default_results, metrics_with
from glucoloop.pumps import Delivery
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.sensors import Reading
from glucoloop.simulation.loop import Sampled
from glucoloop.simulation.trace import Trace
from glucoloop.simulation.user_objects import NEED_VALUES, needs_values

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

    The names and definitions are those of the results in `metrics.metric.METRICS`, and of further metrics that were
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


_ROUNDING_MU_MIN: Final = {"float64": 1e-9, "float32": 1e-4}


@pytree
class _Tally:
    """States of all metrics, of one person or of many."""

    states: tuple[Any, ...]
    glucose: jax.Array
    """0 while glucose was finite at all points of the grid, then NaN."""
    insulin: jax.Array
    """0 while all delivered insulin was finite, then NaN."""


@pytree
class RunningMetrics(Trajectory):
    """Fold of the loop that computes metrics; implements `simulation.cohort.Accumulator`."""

    further: tuple[str, ...] = static(default=())
    """Texts of metrics beside those of this package: name and settings."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Tally:
        """States at the start, which is the first point of the grid."""
        zero = jnp.zeros_like(glucose_mg_dl)
        start = _Tally(
            states=tuple(metric.init(self, glucose_mg_dl, insulin_mU_min) for metric in self._metrics),
            glucose=zero,
            insulin=zero,
        )
        return self._point(start, glucose_mg_dl, zero)

    def step(self, tally: _Tally, happened: Sampled, t_min: jax.Array) -> _Tally:
        """Include a sample and the grid until the next."""
        pairs = zip(self._metrics, tally.states, strict=True)
        tally = _Tally(
            states=tuple(metric.sample(self, state, happened, t_min) for metric, state in pairs),
            glucose=tally.glucose,
            insulin=tally.insulin + 0.0 * happened.infused_mU_min,
        )
        for place, after in enumerate(self.inside_min):
            tally = self._point(tally, happened.inside_mg_dl[place], t_min + after)
        return tally

    def _point(self, tally: _Tally, glucose: jax.Array, t_min: jax.Array) -> _Tally:
        pairs = zip(self._metrics, tally.states, strict=True)
        return _Tally(
            states=tuple(metric.point(self, state, glucose, t_min) for metric, state in pairs),
            glucose=tally.glucose + 0.0 * glucose,
            insulin=tally.insulin,
        )

    def finish(
        self,
        tally: _Tally,
        *,
        samples: int,
        sample_time_min: float,
        meal_t_min: npt.NDArray[Any] | float,
        precision: str = "float64",
    ) -> Metrics:
        """Metrics ``(people,)`` of a run of a cohort, as NumPy arrays; NaN for a person whose glucose was not finite.

        `meal_t_min` is the time of the sample in which the first meal begins, 0 if nothing is eaten. With the precision
        ``"float32"`` a dose at its limit may exceed it by more rounding.
        """
        accumulator, states = jax.tree.map(lambda a: np.asarray(a, np.float64), (self, tally))
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):  # of people without metrics
            metrics: Metrics = accumulator.finished(
                states,
                samples=samples,
                sample_time_min=sample_time_min,
                first_meal_min=meal_t_min,
                xp=np,
                rounding_mU_min=_ROUNDING_MU_MIN[precision],
            )
        return metrics

    def finished(self, tally: _Tally, *, samples: int, **of_run: Any) -> Metrics:
        """Metrics of a run; further arguments are those of `metrics.metric.Ended`."""
        ended = Ended(
            samples=samples,
            points=samples * len(self.inside_min) + 1,
            finite_glucose=tally.glucose == 0.0,
            finite_insulin=tally.insulin == 0.0,
            **of_run,
        )
        return Metrics.of(dict(self._results(tally, ended)), self.further)

    def _results(self, tally: _Tally, ended: Ended) -> Iterator[tuple[str, Any]]:
        for metric, state in zip(self._metrics, tally.states, strict=True):
            results, names = metric.finish(self, state, ended), [result.name for result in metric.results]
            if not isinstance(results, Mapping):
                raise Refusal(
                    f"finish of the metric {metric.name} returns {type(results).__name__}; "
                    "it has to return its results by name, as {'time_70_140_pct': 98.5}"
                )
            if sorted(results) != sorted(names):
                raise Refusal(
                    f"the metric {metric.name} gives {', '.join(sorted(results)) or 'nothing'}, but its entry says "
                    f"{', '.join(sorted(names))}; let both say the same"
                )
            for name in names:
                value = results[name]
                if isinstance(value, str | None) or np.shape(value) not in ((), np.shape(ended.finite_glucose)):
                    has = f"has shape {np.shape(value)}" if np.shape(value) else f"is {value!r}"
                    raise Refusal(f"{name} of the metric {metric.name} {has}; it has to be one number for each person")
                yield name, value

    @property
    def takes_meals(self) -> bool:
        """Whether a metric needs what was eaten at each sample."""
        return any(metric.takes_meals for metric in self._metrics)

    @property
    def _metrics(self) -> tuple[Metric, ...]:
        return _made(self.further)


@functools.lru_cache(maxsize=8)
def _made(further: tuple[str, ...]) -> tuple[Metric, ...]:
    """All metrics of this package, and further ones."""
    return tuple(metrics_with(further))


def first_meal_min(trace: Trace) -> jax.Array:
    """Time of the sample in which the first meal begins [min]; 0 if nothing is eaten.

    A trace knows the sample of a meal, not the moment within it.
    """
    eats = trace.carbs_g > 0.0
    # argmax gives the first sample, which is the start of the run, if nothing is eaten
    return jnp.asarray(trace.t_min)[eats.argmax(axis=0)]


@checked
def summarise(
    trace: Trace,
    limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    lowest_glucose_mg_dl: jax.Array | float = LOWEST_GLUCOSE_MG_DL,
    metrics: Sequence[str] = (),
) -> Metrics:
    """Metrics of a run, of one person or of many.

    Parameters
    ----------
    limits : DoseLimits
        Bounds of the constraints (17) and (18), by default those of 1999; give ``gl.usual_limits(patient)`` for another
        patient.
    lowest_glucose_mg_dl : array_like
        Bound of the constraint (19).
    metrics : sequence of str
        Further metrics beside the default ones, like "sensor-accuracy": name and settings, see `metrics.metric`.

    Returns
    -------
    Metrics
        Metrics; one that rests on glucose or insulin that is not finite is NaN, not settled and not satisfied.

    Raises
    ------
    ValueError
        For an unknown metric, or one that gives other results than its entry says.

    References
    ----------
    Parker, Doyle & Peppas 1999, eq. (17)-(19), Tables I and II; for the rest see the modules of `metrics`.
    """
    times = trace.t_min.shape[0], trace.fine_t_min
    sample_min = None if is_traced(times[1]) else float(times[1][-1]) / times[0]
    try:
        result: Metrics = _summarised(trace, limits, lowest_glucose_mg_dl, tuple(metrics), sample_min)
    except NEED_VALUES as error:
        raise ArgumentTypeError(needs_values(f"the metric {' or '.join(metrics)}", error)) from None
    return result


@kept_jit(static_argnums=(3, 4))
def _summarised(
    trace: Trace,
    limits: DoseLimits,
    lowest_glucose_mg_dl: jax.Array | float,
    further: tuple[str, ...],
    sample_min: float | None,
) -> Metrics:
    samples, fine = trace.t_min.shape[0], trace.fine_glucose_mg_dl
    inside = (fine.shape[0] - 1) // samples
    accumulator = RunningMetrics(
        setpoint_mg_dl=trace.setpoint_mg_dl,
        limits=limits,
        lowest_glucose_mg_dl=lowest_glucose_mg_dl,
        inside_min=tuple(trace.fine_t_min[1 : inside + 1]),
        sample_min=sample_min,
        further=further,
    )

    def sample(tally: _Tally, entry: tuple[Sampled, jax.Array]) -> tuple[_Tally, None]:
        return accumulator.step(tally, *entry), None

    before = trace.basal_insulin_mU_min if trace.rate_before_mU_min is None else trace.rate_before_mU_min
    start = accumulator.init(fine[0], jnp.broadcast_to(before, fine.shape[1:]))
    sample_time_min = accumulator.sample_time_min
    happened = _happened(trace, inside, sample_time_min)
    tally: _Tally = jax.lax.scan(sample, start, (happened, trace.t_min))[0]
    return accumulator.finished(
        tally, samples=samples, sample_time_min=sample_time_min, first_meal_min=first_meal_min(trace)
    )


def _happened(trace: Trace, inside: int, sample_time_min: jax.Array | float) -> Sampled:
    """Events of all samples of a trace, with time on the leading axis."""
    fine, shape = trace.fine_glucose_mg_dl, trace.glucose_mg_dl.shape
    bolus = trace.bolus_mU
    return Sampled(
        x=trace.states[:-1],
        glucose_mg_dl=trace.glucose_mg_dl,
        reading=Reading(glucose_mg_dl=trace.reading_mg_dl, valid=trace.reading_valid),
        decision=Decision(
            insulin_mU_min=trace.command_mU_min,
            status=trace.status,
            bolus_mU=trace.command_bolus_mU,
            glucagon_ug=trace.command_glucagon_ug,
        ),
        delivery=Delivery(
            insulin_mU_min=trace.insulin_mU_min,
            reported_mU_min=trace.reported_mU_min,
            bolus_mU=bolus,
            reported_bolus_mU=trace.reported_bolus_mU,
            glucagon_ug=trace.glucagon_ug,
        ),
        infused_mU_min=trace.insulin_mU_min if bolus is None else trace.insulin_mU_min + bolus / sample_time_min,
        inside_mg_dl=fine[1:].reshape(shape[0], inside, *shape[1:]),
        lowest_valid_mg_dl=jnp.broadcast_to(trace.lowest_valid_mg_dl, shape),
        rescue_g=trace.rescue_g,
        basal_mU_min=jnp.broadcast_to(trace.basal_insulin_mU_min, shape),
        carbs_g=jnp.broadcast_to(trace.carbs_g.reshape(-1, *(1,) * (len(shape) - 1)), shape),
    )
