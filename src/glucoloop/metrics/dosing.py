"""Insulin that was delivered, the constraints on it, and what the controller or its guard met with."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.effects import SUBCUTANEOUS, Need
from glucoloop.control.loop_like import on_board_curves
from glucoloop.control.protocol import Status
from glucoloop.metrics.metric import Ended, Metric, Result, Trajectory, count
from glucoloop.units import MU_PER_U

if TYPE_CHECKING:
    from glucoloop.simulation.loop import Sampled

_STATUS: Final = {
    "saturated": (Status.SATURATED,),
    "not_converged": (Status.NOT_CONVERGED,),
    "non_finite": (Status.NON_FINITE, Status.RESTARTED, Status.NO_FINITE_DOSE),
    "rejected": (Status.READING_REJECTED,),
    "fallback": (Status.FALLBACK_BASAL, Status.FALLBACK_REDUCED),
    "suspended": (Status.SUSPENDED,),
    "dose_limited": (Status.DOSE_LIMITED,),
}
"""Statuses that are counted together, by the end of the name of the result."""


def _samples(name: str, where: str, title: str, *, seldom: bool = False) -> Result:
    return Result(f"samples_{name}", f"Samples {where}.", title, digits=0, seldom=seldom)


@pytree
class _Doses:
    total: jax.Array
    """Sum over the samples of the delivered insulin, boluses included; the others are of the basal rate alone."""
    variation: jax.Array
    largest_change: jax.Array
    previous_mU_min: jax.Array
    off: jax.Array
    """Number of samples without any insulin."""
    off_in_a_row: jax.Array
    """Number of them up to this sample, without one with insulin between them."""
    most_off_in_a_row: jax.Array


class Insulin(Metric, name="insulin"):
    """Insulin delivered and its changes.

    Total insulin, boluses included, the time without any, and the changes of the rate, the first from rest.
    """

    section = "Insulin"
    always = True
    numbers = (
        Result(
            "insulin_total_mU",
            "Insulin delivered over the run.",
            "Insulin delivered",
            "U",
            digits=2,
            divisor=MU_PER_U,
        ),
        Result(
            "insulin_off_min",
            "Time of the samples at which the pump delivered no insulin at all.",
            "Time without insulin",
            "min",
            0,
        ),
        Result(
            "longest_insulin_off_min",
            "Longest time without insulin that no delivery interrupts.",
            "  longest",
            "min",
            0,
        ),
        Result(
            "insulin_total_variation_mU_min",
            "Sum of the absolute changes from sample to sample, the first from the rate at steady state.",
            "Total variation",
            "mU/min",
        ),
        Result("largest_change_mU_min", "Largest of these changes.", "Largest change", "mU/min"),
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Doses:
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Doses(
            total=zero,
            variation=zero,
            largest_change=zero,
            previous_mU_min=insulin_mU_min,
            off=zero,
            off_in_a_row=zero,
            most_off_in_a_row=zero,
        )

    def sample(self, trajectory: Trajectory, state: _Doses, happened: Sampled, t_min: jax.Array) -> _Doses:
        rate = happened.delivery.insulin_mU_min
        change = jnp.abs(rate - state.previous_mU_min)
        off = count(happened.infused_mU_min <= 0.0, state.off)
        in_a_row = off * (state.off_in_a_row + 1.0)
        return _Doses(
            total=state.total + happened.infused_mU_min,
            variation=state.variation + change,
            largest_change=jnp.maximum(state.largest_change, change),
            previous_mU_min=rate,
            off=state.off + off,
            off_in_a_row=in_a_row,
            most_off_in_a_row=jnp.maximum(state.most_off_in_a_row, in_a_row),
        )

    def finish(self, trajectory: Trajectory, state: _Doses, ended: Ended) -> dict[str, Any]:
        return {
            "insulin_total_mU": ended.of_insulin(state.total * ended.sample_time_min),
            "insulin_off_min": ended.of_insulin(state.off * ended.sample_time_min),
            "longest_insulin_off_min": ended.of_insulin(state.most_off_in_a_row * ended.sample_time_min),
            "insulin_total_variation_mU_min": ended.of_insulin(state.variation),
            "largest_change_mU_min": ended.of_insulin(state.largest_change),
        }


@pytree
class _Extremes:
    """Extremes of what the constraints bound."""

    largest_change: jax.Array
    previous_mU_min: jax.Array
    lowest_mU_min: jax.Array
    highest_mU_min: jax.Array
    minimum_mg_dl: jax.Array


class Constraints(Metric, name="constraints"):
    """Constraints of Parker, Doyle and Peppas (1999).

    Constraints (17) to (19) of Parker, Doyle & Peppas 1999, on the rate, its changes, and glucose.

    Values that are not finite violate every constraint. The first change is that from the rate at steady state.
    """

    section = "Bounds of Parker et al. (1999)"
    always = True
    sources = ("parker1999",)
    numbers = (
        Result("rate_satisfied", "Constraint (17): no change beyond the pump's limit.", "Change of the rate"),
        Result("magnitude_satisfied", "Constraint (18): every rate within the pump's limits.", "Rate"),
        Result("glucose_satisfied", "Constraint (19): glucose never below 60 mg/dl.", "Glucose not below 60 mg/dl"),
        Result("constraints_satisfied", "Whether all three constraints hold.", "All three"),
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Extremes:
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Extremes(
            largest_change=zero,
            previous_mU_min=insulin_mU_min,
            lowest_mU_min=zero + jnp.inf,
            highest_mU_min=zero - jnp.inf,
            minimum_mg_dl=glucose_mg_dl,
        )

    def point(self, trajectory: Trajectory, state: _Extremes, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Extremes:
        return dataclasses.replace(state, minimum_mg_dl=jnp.minimum(state.minimum_mg_dl, glucose_mg_dl))

    def sample(self, trajectory: Trajectory, state: _Extremes, happened: Sampled, t_min: jax.Array) -> _Extremes:
        rate = happened.delivery.insulin_mU_min
        return dataclasses.replace(
            state,
            largest_change=jnp.maximum(state.largest_change, jnp.abs(rate - state.previous_mU_min)),
            previous_mU_min=rate,
            lowest_mU_min=jnp.minimum(state.lowest_mU_min, rate),
            highest_mU_min=jnp.maximum(state.highest_mU_min, rate),
        )

    def finish(self, trajectory: Trajectory, state: _Extremes, ended: Ended) -> dict[str, Any]:
        slack, limits = ended.rounding_mU_min, trajectory.limits
        rate = ended.finite_insulin & (state.largest_change <= limits.max_change_mU_min + slack)
        magnitude = (
            ended.finite_insulin
            & (state.lowest_mU_min >= limits.min_mU_min - slack)
            & (state.highest_mU_min <= limits.max_mU_min + slack)
        )
        glucose = ended.finite_glucose & (state.minimum_mg_dl >= trajectory.lowest_glucose_mg_dl)
        return {
            "rate_satisfied": rate,
            "magnitude_satisfied": magnitude,
            "glucose_satisfied": glucose,
            "constraints_satisfied": rate & magnitude & glucose,
        }


class Samples(Metric, name="samples"):
    """Samples at which the controller or its guard met a difficulty.

    Numbers of samples at which controller or guard met a difficulty, by status, and of those without a reading.
    """

    section = "Samples"
    always = True
    numbers = (
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
            "Reading not accepted",
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
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> dict[str, jax.Array]:
        return {name: jnp.zeros_like(glucose_mg_dl) for name in (*_STATUS, "missing")}

    def sample(
        self, trajectory: Trajectory, state: dict[str, jax.Array], happened: Sampled, t_min: jax.Array
    ) -> dict[str, jax.Array]:
        status, reading = happened.decision.status, happened.reading
        there = {name: jnp.zeros_like(reading.valid) for name in _STATUS}
        for name, statuses in _STATUS.items():
            for one in statuses:
                there[name] = there[name] | (status == one)
        there["missing"] = ~(reading.valid & jnp.isfinite(reading.glucose_mg_dl))
        return {name: number + count(there[name], number) for name, number in state.items()}

    def finish(self, trajectory: Trajectory, state: dict[str, jax.Array], ended: Ended) -> dict[str, Any]:
        return {f"samples_{name}": number.astype(int) for name, number in state.items()}


@pytree
class _BoardState:
    amounts: jax.Array
    """(samples, ...) doses or meals of past samples, the newest first."""
    total: jax.Array
    largest: jax.Array


class _OnBoard(Metric):
    """Mean and largest of what is on board at the samples, by a curve of `on_board_curves`."""

    curve: ClassVar[int]
    """Place of the curve."""
    divisor: ClassVar[float] = 1.0
    """Number of units of an amount in one of the results."""

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _BoardState:
        zero = jnp.zeros_like(glucose_mg_dl)
        past = on_board_curves(trajectory.concrete_sample_min)[self.curve].size - 1
        return _BoardState(
            amounts=jnp.zeros((past, *zero.shape), zero.dtype), total=zero, largest=jnp.full_like(zero, -jnp.inf)
        )

    def sample(self, trajectory: Trajectory, state: _BoardState, happened: Sampled, t_min: jax.Array) -> _BoardState:
        left = jnp.asarray(on_board_curves(trajectory.concrete_sample_min)[self.curve][1:], state.total.dtype)
        on_board = jnp.tensordot(left, state.amounts, 1) / self.divisor
        amount = jnp.broadcast_to(self.amount(trajectory, happened), state.total.shape).astype(state.total.dtype)
        return _BoardState(
            amounts=jnp.concatenate([amount[None], state.amounts[:-1]]),
            total=state.total + on_board,
            largest=jnp.maximum(state.largest, on_board),
        )

    def amount(self, trajectory: Trajectory, happened: Sampled) -> jax.Array:
        """Amount of a sample, which is on board from the next one on."""
        raise NotImplementedError


class OnBoard(_OnBoard, name="insulin-on-board"):
    """Insulin on board at the samples, mean and largest.

    Insulin of the run above the basal rate that has not acted yet, as in the trace; that of a warm-up is left out.
    """

    section = "Insulin on board"
    numbers = (
        Result("mean_insulin_on_board_U", "Mean insulin on board of the samples.", "Mean", "U", 2),
        Result("largest_insulin_on_board_U", "Largest insulin on board of a sample.", "Largest", "U", 2),
    )
    curve = 0
    divisor = MU_PER_U

    def needs(self) -> tuple[Need, ...]:
        """The curve is one of subcutaneous insulin."""
        return (SUBCUTANEOUS,)

    def amount(self, trajectory: Trajectory, happened: Sampled) -> jax.Array:
        assert happened.basal_mU_min is not None  # whoever folds metrics gives it
        return (happened.infused_mU_min - happened.basal_mU_min) * trajectory.sample_time_min

    def finish(self, trajectory: Trajectory, state: _BoardState, ended: Ended) -> dict[str, Any]:
        return {
            "mean_insulin_on_board_U": ended.of_insulin(state.total / ended.samples),
            "largest_insulin_on_board_U": ended.of_insulin(state.largest),
        }


class CarbsOnBoard(_OnBoard, name="carbs-on-board"):
    """Carbohydrate on board at the samples, mean and largest.

    Carbohydrate of meals, and against low glucose, that is not absorbed yet by the curve of the trace, as eaten; that
    of a warm-up is left out.
    """

    section = "Carbohydrate on board"
    numbers = (
        Result("mean_carbs_on_board_g", "Mean carbohydrate on board of the samples.", "Mean", "g"),
        Result("largest_carbs_on_board_g", "Largest carbohydrate on board of a sample.", "Largest", "g"),
    )
    curve = 1
    takes_meals = True

    def amount(self, trajectory: Trajectory, happened: Sampled) -> jax.Array:
        assert happened.carbs_g is not None  # whoever folds metrics gives it
        return happened.carbs_g if happened.rescue_g is None else happened.carbs_g + happened.rescue_g

    def finish(self, trajectory: Trajectory, state: _BoardState, ended: Ended) -> dict[str, Any]:
        return {
            "mean_carbs_on_board_g": state.total / ended.samples,
            "largest_carbs_on_board_g": state.largest,
        }


@pytree
class _Amounts:
    total: jax.Array
    times: jax.Array


def _with_amount(state: _Amounts, amount: jax.Array | None) -> _Amounts:
    """Total and times after a sample; nothing changes where there is no such amount."""
    if amount is None:
        return state
    return _Amounts(total=state.total + amount, times=state.times + count(amount > 0.0, state.times))


class Rescues(Metric, name="rescues"):
    """Carbohydrate that the person ate against low glucose, where the loop has a rescue.

    Carbohydrate that the person ate against low glucose, and how often.
    """

    section = "Rescue carbohydrate"
    numbers = (
        Result("rescue_carbs_g", "Carbohydrate that was eaten against low glucose.", "Carbohydrate", "g", 0),
        Result("rescues", "Times that it was eaten.", "Times", digits=0),
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Amounts:
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Amounts(total=zero, times=zero)

    def sample(self, trajectory: Trajectory, state: _Amounts, happened: Sampled, t_min: jax.Array) -> _Amounts:
        return _with_amount(state, happened.rescue_g)

    def finish(self, trajectory: Trajectory, state: _Amounts, ended: Ended) -> dict[str, Any]:
        return {"rescue_carbs_g": state.total, "rescues": state.times}


class Glucagon(Metric, name="glucagon"):
    """Glucagon that was delivered, and how often, where the pump gives any."""

    section = "Glucagon"
    numbers = (
        Result("glucagon_total_ug", "Glucagon that was delivered.", "Glucagon", "ug", 0),
        Result("glucagon_doses", "Samples at which it was delivered.", "Doses", digits=0),
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Amounts:
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Amounts(total=zero, times=zero)

    def sample(self, trajectory: Trajectory, state: _Amounts, happened: Sampled, t_min: jax.Array) -> _Amounts:
        return _with_amount(state, happened.delivery.glucagon_ug)

    def finish(self, trajectory: Trajectory, state: _Amounts, ended: Ended) -> dict[str, Any]:
        return {"glucagon_total_ug": state.total, "glucagon_doses": state.times}
