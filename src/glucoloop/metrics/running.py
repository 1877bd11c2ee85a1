"""All metrics as one fold of the loop, which `summarise` runs over a trace and a cohort within its program."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop._pytree import pytree, static
from glucoloop.metrics.metrics import Metrics
from glucoloop.metrics.protocol import LOWEST_GLUCOSE_MG_DL, Course, Ended, Metric
from glucoloop.parts.metrics import metrics_with
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal
from glucoloop.simulation.loop import Sampled

_ROUNDING_MU_MIN: Final = {"float64": 1e-9, "float32": 1e-4}


@pytree
class Tally:
    """States of all metrics, of one person or of many."""

    states: tuple[Any, ...]
    glucose: jax.Array
    """0 while glucose was finite at all points of the grid, then NaN."""
    insulin: jax.Array
    """0 while all delivered insulin was finite, then NaN."""


@pytree
class RunningMetrics:
    """Fold of the loop that computes metrics; implements `simulation.cohort.Fold`."""

    setpoint_mg_dl: jax.Array | float
    limits: DoseLimits = PARKER_1999_LIMITS
    lowest_glucose_mg_dl: jax.Array | float = LOWEST_GLUCOSE_MG_DL
    inside_min: tuple[jax.Array | float, ...]
    """Moments of the fine grid between samples; see `SampleGrid.inside_min`."""
    further: tuple[str, ...] = static(default=())
    """Texts of metrics beside those of this package: name and settings."""

    @property
    def _course(self) -> Course:
        return Course(
            setpoint_mg_dl=self.setpoint_mg_dl,
            limits=self.limits,
            lowest_glucose_mg_dl=self.lowest_glucose_mg_dl,
            inside_min=self.inside_min,
        )

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> Tally:
        """States at the start, which is the first point of the grid."""
        zero = jnp.zeros_like(glucose_mg_dl)
        start = Tally(
            states=tuple(metric.init(self._course, glucose_mg_dl, insulin_mU_min) for metric in self._metrics),
            glucose=zero,
            insulin=zero,
        )
        return self._point(start, glucose_mg_dl, zero)

    def step(self, tally: Tally, happened: Sampled, t_min: jax.Array) -> Tally:
        """Include a sample and the grid until the next."""
        course, pairs = self._course, zip(self._metrics, tally.states, strict=True)
        tally = Tally(
            states=tuple(metric.sample(course, state, happened, t_min) for metric, state in pairs),
            glucose=tally.glucose,
            insulin=tally.insulin + 0.0 * happened.infused_mU_min,
        )
        for place, after in enumerate(self.inside_min):
            tally = self._point(tally, happened.inside_mg_dl[place], t_min + after)
        return tally

    def _point(self, tally: Tally, glucose: jax.Array, t_min: jax.Array) -> Tally:
        course, pairs = self._course, zip(self._metrics, tally.states, strict=True)
        return Tally(
            states=tuple(metric.point(course, state, glucose, t_min) for metric, state in pairs),
            glucose=tally.glucose + 0.0 * glucose,
            insulin=tally.insulin,
        )

    def finish(
        self,
        tally: Tally,
        *,
        samples: int,
        sample_time_min: float,
        meal_t_min: npt.NDArray[Any] | float,
        precision: str = "float64",
    ) -> Metrics:
        """Metrics of a run of a cohort.

        Parameters
        ----------
        tally : Tally
            States ``(people,)`` at the end.
        samples : int
        sample_time_min : float
        meal_t_min : () or (people,) array
            Time of the sample in which the first meal begins; 0 if nothing is eaten.
        precision : {"float64", "float32"}
            Precision of the tally: a dose at its limit may seem to exceed it by rounding.

        Returns
        -------
        Metrics
            NumPy arrays ``(people,)``; as `summarise` has them, NaN for a person whose glucose was not finite.
        """
        fold, states = jax.tree.map(lambda a: np.asarray(a, np.float64), (self, tally))
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):  # of people without metrics
            metrics: Metrics = fold.finished(
                states,
                samples=samples,
                sample_time_min=sample_time_min,
                first_meal_min=meal_t_min,
                xp=np,
                rounding_mU_min=_ROUNDING_MU_MIN[precision],
            )
        return metrics

    def finished(self, tally: Tally, *, samples: int, **of_run: Any) -> Metrics:
        """Metrics of a run; further arguments are those of `metrics.protocol.Ended`."""
        ended = Ended(
            samples=samples,
            points=samples * len(self.inside_min) + 1,
            finite_glucose=tally.glucose == 0.0,
            finite_insulin=tally.insulin == 0.0,
            **of_run,
        )
        return Metrics.of(dict(self._results(tally, ended)), self.further)

    def _results(self, tally: Tally, ended: Ended) -> Iterator[tuple[str, Any]]:
        chosen = metrics_with(self.further)
        for choice, metric, state in zip(chosen, self._metrics, tally.states, strict=True):
            found, names = metric.finish(self._course, state, ended), [result.name for result in choice.results]
            if sorted(found) != sorted(names):
                raise Refusal(
                    f"the metric {choice.name} gives {', '.join(sorted(found)) or 'nothing'}, but its entry says "
                    f"{', '.join(sorted(names))}; let both say the same"
                )
            yield from ((name, found[name]) for name in names)

    @property
    def _metrics(self) -> tuple[Metric, ...]:
        return _made(self.further)


@functools.lru_cache(maxsize=8)
def _made(further: tuple[str, ...]) -> tuple[Metric, ...]:
    """All metrics of this package, and further ones."""
    return tuple(choice.made() for choice in metrics_with(further))
