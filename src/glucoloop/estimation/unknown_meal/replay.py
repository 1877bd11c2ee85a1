"""Replay of a record of readings and doses, simulated or a person's own, through an estimator of unknown meals."""

from __future__ import annotations

from typing import Any

from glucoloop._lazy_jax import jax, jit, jnp, np, npt
from glucoloop._pytree import pytree
from glucoloop._representation import represented
from glucoloop.arguments import checked, on_host
from glucoloop.estimation.unknown_meal.protocol import MealEstimate, MealEstimator, Sensed
from glucoloop.models.nonlinear import FedModel
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY

_ON_GRID = 1e-6  # of a sample; times nearer than this are the same time


@represented
@pytree
class MealEstimates:
    """Estimates at each sample; time is the leading axis."""

    t_min: jax.Array
    """(samples,) times of the estimates."""
    glucose_mg_dl: jax.Array
    """(samples, ...) glucose of the estimated state."""
    eating: jax.Array
    """(samples, ...) probability that a meal that was not announced is being served, 0 to 1."""
    carbs_g: jax.Array
    """(samples, ...) size so far of the latest meal that was not announced."""
    remaining_g: jax.Array
    """(samples, ...) carbohydrate of that meal that is likely still to come."""
    emptying_mg_min: jax.Array
    """(samples, ...) rate at which the stomach empties, of all meals."""
    disturbance_mg_min: jax.Array
    """(samples, ...) appearance of glucose that no meal explains."""
    lost: jax.Array
    """(samples, ...) probability that no insulin arrives, whatever the pump reports, 0 to 1."""


def replay(
    model: FedModel,
    estimator: MealEstimator,
    t_min: jax.Array,
    readings_mg_dl: jax.Array,
    insulin_mU_min: jax.Array,
    announced_g: jax.Array,
    initial_insulin_mU_min: jax.Array,
    dead_time_samples: int = 0,
    start_min: jax.Array | float | None = None,
) -> MealEstimates:
    """Estimates along a record, as `estimate_meals` gives them; JAX can trace this function and map it over people."""
    late, samples = dead_time_samples, t_min.shape[0]
    initial = jnp.asarray(initial_insulin_mU_min, float)
    since = jnp.concatenate([jnp.broadcast_to(initial, (1 + late,)), insulin_mU_min])[:samples]
    announced = jnp.concatenate([jnp.zeros(late), announced_g])[:samples]
    known = jnp.isfinite(readings_mg_dl)
    clock = None if start_min is None else (start_min + t_min - late * model.sample_time_min) % MIN_PER_DAY
    sensed = Sensed(
        glucose_mg_dl=jnp.where(known, readings_mg_dl, 0.0),
        known=known,
        insulin_mU_min=since,
        reported=jnp.ones(samples, bool),
        announced_carbs_g=announced,
        time_of_day_min=clock,
    )

    def one(state: Any, sensed: Sensed) -> tuple[Any, MealEstimate]:
        return estimator.step(model, state, sensed)

    first = Sensed(
        glucose_mg_dl=sensed.glucose_mg_dl[0],
        known=known[0],
        insulin_mU_min=initial,
        reported=jnp.asarray(True),
        announced_carbs_g=jnp.zeros_like(initial),
    )
    _, estimates = jax.lax.scan(one, estimator.init(model, first), sensed)
    return MealEstimates(
        t_min=t_min,
        glucose_mg_dl=jax.vmap(model.glucose_mg_dl)(estimates.x),
        eating=estimates.eating,
        carbs_g=estimates.carbs_g,
        remaining_g=estimates.remaining_g,
        emptying_mg_min=jax.vmap(lambda stomach: stomach.emptying_mg_min)(estimates.stomach),
        disturbance_mg_min=estimates.disturbance_mg_min,
        lost=estimates.lost,
    )


_replay = jit(static_argnames="dead_time_samples")(replay)


@checked
@on_host("the record is checked with NumPy")
def estimate_meals(
    model: FedModel,
    estimator: MealEstimator,
    t_min: npt.ArrayLike,
    readings_mg_dl: npt.ArrayLike,
    insulin_mU_min: npt.ArrayLike,
    announced_g: npt.ArrayLike | None = None,
    *,
    initial_insulin_mU_min: float | None = None,
    dead_time_samples: int = 0,
    start_min: float | None = None,
) -> MealEstimates:
    """Estimate the meals in a record of readings and doses.

    Parameters
    ----------
    model : FedModel
        Model of the person; `models.nonlinear.individual_model` adapts the nominal one to another basal rate.
    estimator : MealEstimator
        Estimator that was designed for the model.
    t_min : (samples,) array
        Times, the model's sample time apart.
    readings_mg_dl : (samples,) array
        Readings; values that are not finite are missing.
    insulin_mU_min : (samples,) array
        Rate that was delivered from each sample to the next, 0 or more. The last one does not count.
    announced_g : (samples,) array, optional
        Carbohydrate of the meals that begin between each sample and the next and that the estimator is to be told of,
        0 or more; none by default.
    initial_insulin_mU_min : float, optional
        Rate under which the person rested before the first sample; the model's own by default.
    dead_time_samples : int
        Delay of the readings. Each estimate is of the moment at which its reading was taken.
    start_min : float, optional
        Time of day at which `t_min` is 0, in minutes after midnight, for habits that depend on it; not known by
        default.

    Raises
    ------
    ValueError
        For columns that differ in length or hold nothing, times that are not the sample time apart, a rate or an
        amount that is negative or no number, a negative dead time, or a start that is no time of day.

    Examples
    --------
    >>> import numpy as np
    >>> import glucoloop as gl
    >>> from glucoloop.estimation.unknown_meal import design_meal_horizon
    >>> model = gl.nonlinear_model(gl.patient())
    >>> t_min, basal = 5.0 * np.arange(4), np.full(4, float(model.insulin_mU_min))
    >>> told = estimate_meals(model, design_meal_horizon(model), t_min, [81.1, 81.0, np.nan, 81.2], basal)
    >>> bool((told.eating < 0.5).all())
    True
    """
    times, readings, insulin = (
        _column(name, values)
        for name, values in (("times", t_min), ("readings", readings_mg_dl), ("insulin rates", insulin_mU_min))
    )
    announced = np.zeros_like(times) if announced_g is None else _column("announced amounts", announced_g)
    for name, values in (("readings", readings), ("insulin rates", insulin), ("announced amounts", announced)):
        if values.size != times.size:
            raise Refusal(f"{times.size} times and {values.size} {name} do not go together; give one of each a sample")
    if not times.size:
        raise Refusal("a record without samples tells nothing; give at least one")
    if dead_time_samples < 0:
        raise Refusal(f"a dead time of {dead_time_samples} samples is not possible; give a whole number of 0 or more")
    if start_min is not None:
        from glucoloop.meals.scenario import check_time_of_day  # which imports JAX

        check_time_of_day(start_min)
    _refuse_times(times, model.sample_time_min)
    initial = float(model.insulin_mU_min) if initial_insulin_mU_min is None else float(initial_insulin_mU_min)
    _refuse_amounts("an insulin rate", "mU/min", np.append(initial, insulin[:-1]))
    _refuse_amounts("an announced meal", "g", announced)
    estimates: MealEstimates = _replay(
        model,
        estimator,
        jnp.asarray(times),
        jnp.asarray(readings),
        jnp.asarray(insulin),
        jnp.asarray(announced),
        jnp.asarray(initial),
        dead_time_samples=dead_time_samples,
        start_min=start_min,
    )
    return estimates


def _column(name: str, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    try:
        column = np.asarray(values, float)
    except (TypeError, ValueError):
        raise Refusal(f"the {name} are not all numbers; give numbers, and NaN for what is missing") from None
    if column.ndim != 1:
        raise Refusal(f"the {name} have the shape {column.shape}; give one number a sample")
    return column


def _refuse_times(times: npt.NDArray[np.float64], sample_time_min: float) -> None:
    wrong = ~(np.abs(np.diff(times) - sample_time_min) <= _ON_GRID * sample_time_min)
    if not np.isfinite(times[0]) or wrong.any():
        at = int(np.argmax(wrong)) if np.isfinite(times[0]) else 0
        then = times[at : at + 2].tolist()
        raise Refusal(
            f"the times {' and '.join(f'{t:g}' for t in then)} min are not {sample_time_min:g} min apart, as the "
            "model's samples are; bring the record to that grid, with NaN for a missing reading"
        )


def _refuse_amounts(what: str, unit: str, values: npt.NDArray[np.float64]) -> None:
    wrong = ~((values >= 0.0) & np.isfinite(values))
    if wrong.any():
        raise Refusal(f"{what} of {values[wrong][0]:g} {unit} is not possible; give a finite value of 0 or more")
