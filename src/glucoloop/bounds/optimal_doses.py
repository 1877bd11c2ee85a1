"""The best doses for a patient with given meals and pump, by optimal control of the nonlinear patient.

The method is direct single shooting: the rates at the samples are the unknowns, the simulation is carried along, and
the limits of the pump are linear constraints. A first minimisation finds how small the deviation can be. Many plans
come as close; a second minimisation takes the one with the smallest sum of squared moves and squared deviations at the
samples, in mU/min and mg/dl, so that the plan is unique and realistic: with moves alone the smallest sum would leave
glucose at the edge.

References
----------
J. T. Betts, Practical Methods for Optimal Control and Estimation Using Nonlinear Programming, SIAM, 2010.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.typing import ArrayLike

from glucoloop._representation import represented
from glucoloop.arguments import checked, on_host
from glucoloop.bounds.prox_linear import Limits, Measure, Minimum, minimise
from glucoloop.bounds.trajectory import RunModel, trajectory_of
from glucoloop.control.design_case import check_sample_time
from glucoloop.meals import Meal, Scenario
from glucoloop.metrics.metric import of_glucose
from glucoloop.metrics.regulation import Settling
from glucoloop.patients.protocol import Patient
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.refusal import Refusal

Values = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

OBJECTIVES: Final = {
    "deviation": "the largest deviation from the setpoint, to either side",
    "undershoot": "the undershoot, and the peak with a hundredth of its weight",
    "peak": "the peak, and the undershoot with a hundredth of its weight",
    "sse": "the sum of squared deviations over samples, those below the setpoint weighted",
}
"""Objectives that a plan can minimise, each with its meaning."""
IN_ADVANCE: Final = -math.inf
"""Value of `known_after_min` for meals that are all known from the start."""
_MAX_SAMPLES: Final = 600
"""Largest number of doses of a plan; a plan of so many takes minutes."""

_TOLERANCE_MG_DL: Final = 1e-4
_LESS_WEIGHT: Final = 0.01
_STATIONARY_MG_DL: Final = 2e-3
_STATIONARY_SHARE: Final = 5e-3
_SLACK_MG_DL: Final = 5e-4  # the shown plan comes so close to the bound
_CALM: Final = 1e-5  # weight of squares in the second minimisation
_SLACK_WEIGHT: Final = 10.0  # weight there of each mg/dl beyond the slack; with 1, squares outweighed it


@represented
@dataclass(frozen=True)
class OptimalDoses:
    """The best doses found and the glucose under them; NumPy arrays of one person."""

    t_min: Values
    """(samples,) times of the doses."""
    insulin_mU_min: Values
    """(samples,) rates from each sample to the next, within the limits of the pump."""
    fine_t_min: Values
    """(points,) a grid of one minute, from 0 to the horizon."""
    glucose_mg_dl: Values
    """(points,) glucose on the fine grid."""
    setpoint_mg_dl: float
    basal_insulin_mU_min: float
    """Rate at which the patient rests before the run."""
    known_after_min: float
    objective: str
    bound: float
    """Minimum value of the objective that was found, mg/dl, or (mg/dl)^2 for ``sse``."""
    deviation_mg_dl: float
    """Largest deviation from the setpoint under this plan; the second minimisation may have raised it by less than
    0.001 mg/dl."""
    undershoot_mg_dl: float
    """Setpoint less the minimum glucose."""
    peak_mg_dl: float
    settling_min: float
    """Time from the first meal until glucose stays within 2 % of the setpoint."""
    settled: bool
    converged: bool
    """Whether the plan is stationary: `optimality` is at most 0.002 mg/dl or half a percent of `bound`."""
    iterations: int
    optimality: float
    """Decrease of the objective that a linear program predicts if every dose may change by up to 1 mU/min; in the unit
    of the objective.
    """

    def within(self, limits: DoseLimits, slack_mU_min: float = 1e-9) -> bool:
        """Whether the plan keeps the limits of a pump that rested at the rate of the patient."""
        before = np.concatenate([[_allowed(self.basal_insulin_mU_min, limits)], self.insulin_mU_min[:-1]])
        return bool(np.all(limits.allow(jnp.asarray(self.insulin_mU_min), jnp.asarray(before), slack_mU_min)))


@checked
@on_host("a search that ends by its own progress cannot be traced")
def optimal_doses(
    patient: Patient,
    scenario: Scenario | None = None,
    pump_limits: DoseLimits = PARKER_1999_LIMITS,
    *,
    known_after_min: float = 0.0,
    objective: str = "deviation",
    undershoot_weight: float = 1.0,
    sample_time_min: float = 5.0,
    start_mU_min: ArrayLike | None = None,
) -> OptimalDoses:
    """Doses that keep a patient as close to the setpoint as any controller could.

    With glucose deviations ``e_k`` on a grid of one minute, ``deviation`` solves ::

        minimise  max_k |e_k(u)|   over the doses u_i,   |u_i - u_{i-1}| <= most,   low <= u_i <= high

    where a dose that is given before a meal is known is that of the plan without it: without earlier meals, the basal
    rate.

    Parameters
    ----------
    patient : Patient
        One person.
    scenario : Scenario, optional
        The 50 g oral glucose test by default. The patient starts at steady state. Announcements do not matter.
    known_after_min : float
        Time at which each meal and its size become known, counted from its start: 0 is perfect information from its
        first minute, a negative value is knowledge in advance, and `IN_ADVANCE` from the start of the run. What is
        known is acted on at the next sample. Delays of readings and of action add up here.
    objective : str
        One of `OBJECTIVES`.
    undershoot_weight : float
        Weight of the squares below the setpoint, for ``sse``.
    start_mU_min : (samples,) array, optional
        Doses from which the search begins; the basal rate by default. They are brought within the limits.

    Returns
    -------
    OptimalDoses
        A local minimum; different starts came to the same one wherever that was tried. With several meals the doses
        are the best for what is known at each moment: a controller that bets on a meal to come could do better.

    Raises
    ------
    ValueError
        For an unknown objective, a weight that is not positive, a sample time or horizon out of bounds, or a patient
        who cannot rest at the initial glucose.
    TypeError
        For a patient whom the exponential integrator cannot carry.
    """
    scenario = Scenario() if scenario is None else scenario
    _check_objective(objective, undershoot_weight)
    check_sample_time(sample_time_min)
    check_known_after(known_after_min)
    check_samples(scenario.horizon_min, sample_time_min)
    fasting = trajectory_of(patient, scenario, sample_time_min, [()])
    doses = np.full(fasting.samples, _allowed(fasting.resting_mU_min, pump_limits))
    minimum, iterations, known = None, 0, fasting
    for meals, first in stages(scenario, fasting, known_after_min):
        known = trajectory_of(patient, scenario, sample_time_min, [meals])
        start = doses if start_mU_min is None else np.concatenate([doses[:first], np.asarray(start_mU_min)[first:]])
        plan = DosePlan.of_course(known, pump_limits, first)
        minimum = plan.least(start, objective, undershoot_weight)
        calm = plan.calm(minimum, objective)
        doses = plan.doses(calm.v)[:, 0]
        iterations += minimum.iterations + calm.iterations
    if minimum is None:  # nothing is eaten
        minimum = DosePlan.of_course(known, pump_limits, known.samples).least(doses, objective, undershoot_weight)
    eaten = trajectory_of(patient, scenario, sample_time_min, [scenario.meals])
    return collected(eaten, scenario, doses, minimum, iterations, known_after_min, objective)


def _check_objective(objective: str, undershoot_weight: float) -> None:
    """Refuse an unknown objective or a weight that is not positive."""
    if objective not in OBJECTIVES:
        raise Refusal(f"unknown objective {objective!r}; the known ones are: {', '.join(OBJECTIVES)}")
    if not 0.0 < undershoot_weight < math.inf:
        raise Refusal(f"a weight of {undershoot_weight:g} is not possible; give a finite value above 0")


def check_known_after(known_after_min: float) -> None:
    """Refuse a time that is not a number or that is infinite."""
    if math.isnan(known_after_min) or known_after_min == math.inf:
        raise Refusal(
            f"meals that are known after {known_after_min:g} min are not possible; give a finite number of minutes"
        )


def check_samples(horizon_min: float, sample_time_min: float) -> None:
    """Refuse a run that is too long for one plan."""
    if horizon_min / sample_time_min > _MAX_SAMPLES:
        raise Refusal(
            f"a plan of {horizon_min / sample_time_min:.0f} doses is too long; at samples of {sample_time_min:g} min "
            f"give a horizon of at most {_MAX_SAMPLES * sample_time_min:g} min"
        )


def first_free_sample(t_min: Values, known_at_min: float) -> int:
    """First sample whose dose can react to a fact that becomes known at the given time."""
    return int(np.searchsorted(t_min, known_at_min - 1e-9))


def stages(scenario: Scenario, trajectory: RunModel, known_after_min: float) -> list[tuple[tuple[Meal, ...], int]]:
    """Meals known at each stage and the first dose that may react to them; all doses are given if no meal is left."""
    stages: dict[int, tuple[Meal, ...]] = {}
    if not trajectory.at_rest:
        stages[0] = ()
    for number, meal in enumerate(scenario.meals, start=1):
        first = first_free_sample(trajectory.grid.t_min, max(0.0, meal.t_min + known_after_min))
        stages[first] = scenario.meals[:number]
    return [(meals, first) for first, meals in stages.items()]


def _allowed(resting_mU_min: float, limits: DoseLimits) -> float:
    """Rate within the pump's limits that the pump has delivered for a long time before the run."""
    return float(np.clip(resting_mU_min, float(limits.min_mU_min), float(limits.max_mU_min)))


@dataclass(frozen=True)
class DosePlan:
    """Doses of one circumstance or several, as one vector within the limits of a pump."""

    trajectory: RunModel
    limits: Limits
    place: Indices
    """(samples, members) position of each dose in the vector; circumstances share doses until they are told apart."""

    @classmethod
    def of_course(cls, trajectory: RunModel, limits: DoseLimits, first: int, apart: int | None = None) -> DosePlan:
        """Plan whose doses before `first` are fixed; several circumstances share those before `apart`."""
        n, members = trajectory.samples, trajectory.members
        apart = n if apart is None else apart
        place = np.arange(n * members).reshape(n, members)
        place[:apart] = place[:apart, :1]
        place = np.unique(place, return_inverse=True)[1].reshape(n, members)
        # As many wherever they are told apart, since each number is compiled for; the rest stands still.
        size = n + (members - 1) * (n - min(first, apart))
        free = np.zeros(size, bool)
        free[place[first:]] = True
        D, d = np.zeros((size, size)), np.zeros(size)
        for now, before in zip(place[1:].ravel(), place[:-1].ravel(), strict=True):
            if free[now]:
                D[now, now], D[now, before] = 1.0, -1.0
        if free[0]:
            D[0, 0], d[0] = 1.0, _allowed(trajectory.resting_mU_min, limits)
        within = Limits(
            low=float(limits.min_mU_min),
            high=float(limits.max_mU_min),
            most=float(limits.max_change_mU_min),
            D=D,
            d=d,
            free=free,
        )
        return cls(trajectory=trajectory, limits=within, place=place)

    def vector(self, doses: Values) -> Values:
        """The vector of doses ``(samples,)``, the same for all members, within the limits."""
        v = np.zeros(self.limits.free.size)
        v[self.place] = self._clipped(doses)[:, None]
        return v

    def doses(self, v: Values) -> Values:
        """Doses of each member, ``(samples, members)``."""
        return np.asarray(v)[self.place]

    def _clipped(self, doses: Values) -> Values:
        limits, clipped = self.limits, np.array(doses, float)
        before = np.clip(self.trajectory.resting_mU_min, limits.low, limits.high)
        for i in range(clipped.shape[0]):
            near = np.clip(clipped[i], before - limits.most, before + limits.most)
            clipped[i] = before = np.clip(near, limits.low, limits.high)
        return clipped

    def deviation(self, v: Values) -> Values:
        """Deviations of all members from the setpoint, one member after the other."""
        return (self.trajectory.glucose_mg_dl(self.doses(v)) - self.trajectory.setpoint_mg_dl).T.ravel()

    def jacobian(self, v: Values) -> Values:
        """Derivative of the deviations, ``(points * members, samples * members)``."""
        by_member = self.trajectory.sensitivity(self.doses(v))
        points, members, _ = by_member.shape
        J = np.zeros((members * points, v.size))
        for member in range(members):
            # Where members share a dose, each answers it on rows of its own.
            J[member * points : (member + 1) * points, self.place[:, member]] = by_member[:, member]
        return J

    def least(self, start: Values, objective: str, undershoot_weight: float = 1.0) -> Minimum:
        """The minimum of an objective."""
        measure = self._measure(objective, undershoot_weight)
        v = self.vector(start)
        tolerance = _TOLERANCE_MG_DL
        if measure.weight is not None:
            tolerance *= max(1.0, 1e-4 * measure.value(self.deviation(v), np.zeros(1)))
        result = self._minimise(measure, v, tolerance)
        # moves count only to make the plan unique
        return replace(result, value=measure.value(result.g, np.zeros(1)))

    def calm(self, result: Minimum, objective: str) -> Minimum:
        """The plan with the least squares among all that come nearly as close as a minimum."""
        measure = self._measure(objective, 1.0)
        if measure.weight is not None:  # there is but one
            return result
        low, high = measure.excess(result.g)
        if measure.joint:
            high = low
        caps = (low + _SLACK_MG_DL, high + _SLACK_MG_DL)
        calm = Measure(
            cost=(_SLACK_WEIGHT, _SLACK_WEIGHT), cap_mg_dl=caps, weight=_CALM * self._at_samples(), moves=_CALM
        )
        return self._minimise(calm, result.v, _TOLERANCE_MG_DL / 10.0)

    def _measure(self, objective: str, undershoot_weight: float) -> Measure:
        if objective == "deviation":
            return Measure(cost=(1.0, 1.0), joint=True)
        if objective == "undershoot":
            return Measure(cost=(1.0, _LESS_WEIGHT))
        if objective == "peak":
            return Measure(cost=(_LESS_WEIGHT, 1.0))
        return Measure(weight=2.0 * self._at_samples(), below=undershoot_weight, moves=1e-6)

    def _at_samples(self) -> Values:
        """Indicator of the points that are samples, 1 there and 0 between them, for all members."""
        weight = np.zeros(self.trajectory.grid.fine_t_min.size)
        weight[: -1 : self.trajectory.grid.inside_min.size] = 1.0
        return np.tile(weight, self.trajectory.members)

    def _minimise(self, measure: Measure, v: Values, tolerance: float) -> Minimum:
        return minimise(self.deviation, self.jacobian, measure, self.limits, v, tolerance=tolerance)


def collected(
    trajectory: RunModel,
    scenario: Scenario,
    doses: Values,
    minimum: Minimum,
    iterations: int,
    known_after_min: float,
    objective: str,
) -> OptimalDoses:
    """Collect the results of a plan in a record."""
    glucose = trajectory.glucose_mg_dl(doses[:, None])[:, 0]
    t_min, setpoint = trajectory.grid.fine_t_min, trajectory.setpoint_mg_dl
    from_min = scenario.meals[0].t_min if scenario.meals else 0.0
    settling = of_glucose(Settling(), t_min, glucose, setpoint, from_min)
    stationary = max(_STATIONARY_MG_DL, _STATIONARY_SHARE * minimum.value)
    return OptimalDoses(
        t_min=trajectory.grid.t_min,
        insulin_mU_min=doses,
        fine_t_min=t_min,
        glucose_mg_dl=glucose,
        setpoint_mg_dl=setpoint,
        basal_insulin_mU_min=trajectory.resting_mU_min,
        known_after_min=known_after_min,
        objective=objective,
        bound=minimum.value,
        deviation_mg_dl=float(np.abs(glucose - setpoint).max()),
        undershoot_mg_dl=float(setpoint - glucose.min()),
        peak_mg_dl=float(glucose.max()),
        settling_min=float(settling["settling_2pct_min"]),
        settled=bool(settling["settled_2pct"]),
        converged=minimum.optimality <= stationary,
        iterations=iterations,
        optimality=minimum.optimality,
    )


@dataclass(frozen=True)
class Distance:
    """The largest deviation of a run, and the part of it that no controller could have avoided."""

    deviation_mg_dl: float
    """Largest deviation of the run from its setpoint, to either side."""
    bound_mg_dl: float
    distance_mg_dl: float
    """Part of the deviation that is above the bound."""


def distance_to_bound(glucose_mg_dl: ArrayLike, bound: OptimalDoses) -> Distance:
    """Distance of one person's run to the bound of the same situation.

    Parameters
    ----------
    glucose_mg_dl : (points,) array
        Glucose free of noise, on the grid of one minute.
    bound : OptimalDoses
        Bound for the objective ``deviation``.

    Raises
    ------
    ValueError
        For a bound of something else, or a run of another length.
    """
    glucose = np.asarray(glucose_mg_dl, float)
    if bound.objective != "deviation":
        raise Refusal(f"the bound is of the objective {bound.objective!r}; work it out for 'deviation'")
    if glucose.shape != bound.glucose_mg_dl.shape:
        raise Refusal(
            f"the run has glucose of shape {glucose.shape}, the bound {bound.glucose_mg_dl.shape}; "
            "give one person's run of the same situation"
        )
    deviation = float(np.abs(glucose - bound.setpoint_mg_dl).max())
    return Distance(deviation_mg_dl=deviation, bound_mg_dl=bound.bound, distance_mg_dl=deviation - bound.bound)


def bound_of_situation(
    patient: Patient,
    scenario: Scenario,
    pump_limits: DoseLimits,
    *,
    dead_time_min: float = 0.0,
    sample_time_min: float = 5.0,
) -> OptimalDoses:
    """The bound that holds for every controller of a situation, however it learns of meals.

    Announced meals are known at the sample before they begin. Other meals are known a dead time after their start, at
    the first reading that they change; with sensor noise no controller knows of them so early. Other arguments are
    those of `optimal_doses`.
    """
    known_after_min = dead_time_min
    if scenario.announced and scenario.meals:
        samples = [math.floor(meal.t_min / sample_time_min) * sample_time_min - meal.t_min for meal in scenario.meals]
        known_after_min = min(samples)
    return optimal_doses(
        patient, scenario, pump_limits, known_after_min=known_after_min, sample_time_min=sample_time_min
    )
