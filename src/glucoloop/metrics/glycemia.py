"""Glycemia as diabetes care reports it: times in ranges, mean and variation, indices of risk, and low events."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.arguments import is_traced
from glucoloop.metrics.formulas import glycemia_risk_index, gmi_pct, symmetric_glucose
from glucoloop.metrics.metric import Ended, Metric, Result, Trajectory, count

if TYPE_CHECKING:
    from glucoloop.simulation.loop import Sampled

LOW_BOUNDS_MG_DL: Final = {"low_events": 70.0, "very_low_events": 54.0}
"""Bound of the events of each level, by the name of its result."""
_LASTING_MIN: Final = 15.0
_ROUNDING: Final = 1e-4
"""Part of a sample by which rounding of its time, in float32 too, may make more samples of the same minutes."""


def _share(name: str, where: str, title: str = "", more: str = "", **shown: Any) -> Result:
    summary = f"Percentage of time with glucose {where}{more}."
    return Result(name, summary, title or f"Time {where}", "%", **shown)


def _events(name: str, bound_mg_dl: int) -> Result:
    summary = f"Times that glucose fell below {bound_mg_dl} mg/dl for 15 min or longer, on the controller's samples."
    return Result(name, summary, f"Events below {bound_mg_dl} mg/dl", digits=0)


@pytree
class _Points:
    """Numbers of points of the grid."""

    below_54: jax.Array
    below_60: jax.Array
    below_70: jax.Array
    below_validity: jax.Array
    above_180: jax.Array
    above_250: jax.Array


class TimeInRanges(Metric, name="time-in-ranges"):
    """Times in ranges of glucose, and the risk index that follows from them.

    Times in ranges, and the glycemia risk index ``min(100, 3 VLow + 2.4 Low + 1.6 VHigh + .8 High)``.

    A time is the percentage of the points of the grid of one minute, both ends included. VLow, Low, High, VHigh are the
    percentages of points below 54, from 54 to below 70, above 180 to 250, and above
    250 mg/dl.

    References
    ----------
    T. Battelino et al., "Clinical targets for continuous glucose monitoring data interpretation: recommendations from
    the international consensus on time in range", Diabetes Care 42(8), 1593-1603, 2019. The index is that of
    `formulas.glycemia_risk_index`.
    """

    section = "Glycemia"
    always = True
    sources = ("battelino2019", "klonoff2023")
    numbers = (
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
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Points:
        return _Points(**{field.name: jnp.zeros_like(glucose_mg_dl) for field in dataclasses.fields(_Points)})

    def point(self, trajectory: Trajectory, state: _Points, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Points:
        g = glucose_mg_dl
        return dataclasses.replace(
            state,
            below_54=state.below_54 + count(g < 54.0, g),
            below_60=state.below_60 + count(g < 60.0, g),
            below_70=state.below_70 + count(g < 70.0, g),
            above_180=state.above_180 + count(g > 180.0, g),
            above_250=state.above_250 + count(g > 250.0, g),
        )

    def sample(self, trajectory: Trajectory, state: _Points, happened: Sampled, t_min: jax.Array) -> _Points:
        g, lowest = happened.glucose_mg_dl, happened.lowest_valid_mg_dl
        # The first point of the grid is the first sample; the others lie after a sample.
        below = count((t_min <= 0.0) & (g < lowest), g)
        for place in range(len(trajectory.inside_min)):
            below = below + count(happened.inside_mg_dl[place] < lowest, g)
        return dataclasses.replace(state, below_validity=state.below_validity + below)

    def finish(self, trajectory: Trajectory, state: _Points, ended: Ended) -> dict[str, Any]:
        very_low, very_high = ended.pct(state.below_54), ended.pct(state.above_250)
        below, above = ended.pct(state.below_70), ended.pct(state.above_180)
        return {
            "time_below_54_pct": very_low,
            "time_below_60_pct": ended.pct(state.below_60),
            "time_below_70_pct": below,
            "time_below_validity_pct": ended.pct(state.below_validity),
            "time_70_180_pct": ended.pct(ended.points - state.below_70 - state.above_180),
            "time_above_180_pct": above,
            "time_above_250_pct": very_high,
            "gri": glycemia_risk_index(ended.xp, very_low, below, very_high, above),
        }


@pytree
class _Sums:
    """Sums over the grid of glucose less the setpoint, so that little is lost to rounding."""

    deviation: jax.Array
    squared: jax.Array


class MeanAndVariation(Metric, name="mean-and-variation"):
    """Mean glucose and its variation.

    Mean, coefficient of variation with ``n - 1`` as its denominator, and `formulas.gmi_pct`.
    """

    section = "Glycemia"
    always = True
    sources = ("bergenstal2018",)
    numbers = (
        Result("mean_mg_dl", "Mean glucose over the grid.", "Mean glucose", "mg/dl", concentration=True),
        Result(
            "cv_pct",
            "Coefficient of variation: standard deviation (n - 1) in percent of the mean.",
            "Coefficient of variation",
            "%",
        ),
        Result("gmi_pct", "Glucose management indicator.", "Glucose management indicator", "%"),
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Sums:
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Sums(deviation=zero, squared=zero)

    def point(self, trajectory: Trajectory, state: _Sums, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Sums:
        deviation = glucose_mg_dl - trajectory.setpoint_mg_dl
        return _Sums(deviation=state.deviation + deviation, squared=state.squared + deviation * deviation)

    def finish(self, trajectory: Trajectory, state: _Sums, ended: Ended) -> dict[str, Any]:
        mean = ended.of_glucose(trajectory.setpoint_mg_dl + state.deviation / ended.points)
        variance = (state.squared - state.deviation**2 / ended.points) / (ended.points - 1)
        deviation = ended.xp.sqrt(ended.xp.maximum(ended.of_glucose(variance), 0.0))
        return {"mean_mg_dl": mean, "cv_pct": 100.0 * deviation / mean, "gmi_pct": gmi_pct(mean)}


@pytree
class _Risks:
    """Sums over the grid."""

    low: jax.Array
    high: jax.Array


class RiskIndices(Metric, name="risk-indices"):
    """Risk of low and of high glucose.

    Means over the grid of the risk to be low and of the risk to be high.

    ::

        LBGI = mean(10 min(f, 0)^2),    HBGI = mean(10 max(f, 0)^2),    f of `formulas.symmetric_glucose`

    References
    ----------
    B. P. Kovatchev, M. Straume, D. J. Cox, L. S. Farhy, "Risk analysis of blood glucose data: a quantitative approach
    to optimizing the control of insulin dependent diabetes", J. Theor. Med. 3, 1-10, 2000.
    """

    section = "Glycemia"
    always = True
    sources = ("kovatchev1997",)
    numbers = (
        Result("lbgi", "Low blood glucose index.", "Low blood glucose index", digits=2),
        Result("hbgi", "High blood glucose index.", "High blood glucose index", digits=2),
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Risks:
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Risks(low=zero, high=zero)

    def point(self, trajectory: Trajectory, state: _Risks, glucose_mg_dl: jax.Array, t_min: jax.Array) -> _Risks:
        f = symmetric_glucose(jnp, glucose_mg_dl)
        return _Risks(
            low=state.low + 10.0 * jnp.minimum(f, 0.0) ** 2, high=state.high + 10.0 * jnp.maximum(f, 0.0) ** 2
        )

    def finish(self, trajectory: Trajectory, state: _Risks, ended: Ended) -> dict[str, Any]:
        return {
            "lbgi": ended.of_glucose(state.low / ended.points),
            "hbgi": ended.of_glucose(state.high / ended.points),
        }


@pytree
class _Events:
    """Events counted so far; all arrays have the shape of the people."""

    events: jax.Array
    going: jax.Array
    """Indicator, 1 within an event, else 0."""
    lasting: jax.Array
    """Samples in a row on the side of the bound on which the event, or its absence, would end."""

    def with_sample(self, low: jax.Array, in_a_row: jax.Array | float) -> _Events:
        going = self.going > 0.5
        lasting = jnp.where(low != going, self.lasting + 1.0, 0.0)
        turned = lasting >= in_a_row
        return _Events(
            events=self.events + count(turned & ~going, self.events),
            going=jnp.where(turned, 1.0 - self.going, self.going),
            lasting=jnp.where(turned, 0.0, lasting),
        )


class LowEvents(Metric, name="low-events"):
    """Events of low glucose.

    Events of low glucose of both levels, counted as for a continuous sensor.

    An event begins when glucose has been below a bound for 15 min, and ends when it has not been for 15 min.

    References
    ----------
    T. Battelino et al., "Continuous glucose monitoring and metrics for clinical trials: an international consensus
    statement", Lancet Diabetes Endocrinol. 11(1), 2023: level 1 is below 70 mg/dl, level 2 below 54 mg/dl.
    """

    section = "Glycemia"
    always = True
    sources = ("battelino2023",)
    numbers = (
        _events("low_events", 70),
        _events("very_low_events", 54),
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> dict[str, _Events]:
        zero = jnp.zeros_like(glucose_mg_dl)
        return {name: _Events(events=zero, going=zero, lasting=zero) for name in LOW_BOUNDS_MG_DL}

    def sample(
        self, trajectory: Trajectory, state: dict[str, _Events], happened: Sampled, t_min: jax.Array
    ) -> dict[str, _Events]:
        in_a_row = samples_in_a_row(trajectory.sample_time_min)
        low = {name: happened.glucose_mg_dl < bound for name, bound in LOW_BOUNDS_MG_DL.items()}
        return {name: events.with_sample(low[name], in_a_row) for name, events in state.items()}

    def finish(self, trajectory: Trajectory, state: dict[str, _Events], ended: Ended) -> dict[str, Any]:
        return {name: ended.of_glucose(events.events) for name, events in state.items()}


def samples_in_a_row(sample_time_min: jax.Array | float) -> jax.Array | float:
    """Minimum number of samples that take 15 min or longer."""
    if is_traced(sample_time_min):
        return jnp.ceil(_LASTING_MIN / sample_time_min - _ROUNDING)
    return float(math.ceil(_LASTING_MIN / float(sample_time_min) - _ROUNDING))  # native code does not round
