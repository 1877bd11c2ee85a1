"""Protocol of a controller: its observations and its decisions.

A controller learns of the patient only by the observation; it never sees the plant.
"""

from __future__ import annotations

import enum
from typing import Any, Protocol

from glucoloop._lazy_jax import jax
from glucoloop._pytree import pytree
from glucoloop.component.effects import OF_CONTROLLERS, Need


@pytree
class Observation:
    """Information at a sample."""

    glucose_mg_dl: jax.Array
    """Reading of the sensor; any number where it is not valid."""
    valid: jax.Array
    """Whether the sensor declares its reading valid."""
    setpoint_mg_dl: jax.Array
    delivered_mU_min: jax.Array
    """Basal rate that the pump reports since the last sample."""
    announced_carbs_g: jax.Array
    """Carbohydrate of a meal that begins during the coming sample, or after `announced_in_min`, if the scenario
    announces meals; else 0.
    """
    delivered_bolus_mU: jax.Array | None = None
    """Bolus that the pump reports since the last sample, those by hand included, apart from the basal rate, or None for
    a controller without boluses. All insulin since then is ``delivered_mU_min * sample_time_min + delivered_bolus_mU``.
    """
    time_of_day_min: jax.Array | None = None
    """Minutes after midnight, from 0 to below 1440, or None if the controller does not get them."""
    announced_in_min: jax.Array | None = None
    """Time from this sample until the announced meal is eaten, or None where meals are announced when they begin."""
    rescue_carbs_g: jax.Array | None = None
    """Fast carbohydrate that was eaten against low glucose since the last sample, or None where that is not told."""
    exercise_in_min: jax.Array | None = None
    """Time from this sample until announced exercise begins, 0 while it lasts and infinity where none is announced; or
    None where exercise is not told.
    """
    temporary_target: jax.Array | None = None
    """Whether the setpoint is a temporary one, as of an override, or None where none is."""
    number: jax.Array | None = None
    """Number of the reading in a loop that runs in real time, or None in a simulation. See `real_time`."""
    read_t_min: jax.Array | None = None
    """Time of the reading in a loop that runs in real time, or None in a simulation."""
    key: jax.Array | None = None
    """Random key of this sample in a simulation, for a controller that draws random numbers, else None; see `draws`."""


class Status(enum.IntEnum):
    """Status of a decision."""

    OK = 0
    SATURATED = 1
    READING_MISSING = 2
    NOT_CONVERGED = 3
    NON_FINITE = 4
    READING_REJECTED = 5
    FALLBACK_BASAL = 6
    FALLBACK_REDUCED = 7
    SUSPENDED = 8
    DOSE_LIMITED = 9
    RESTARTED = 10
    NO_FINITE_DOSE = 11
    NO_ANSWER = 12

    @property
    def text(self) -> str:
        """Sentence that a person can act on."""
        return _STATUS_TEXTS[self]


_STATUS_TEXTS = {
    Status.OK: "The dose is the controller's own.",
    Status.SATURATED: "The dose was cut to the pump's limits; check the tuning if this lasts.",
    Status.READING_MISSING: "There was no valid reading; the dose rests on the model's prediction. Check the sensor.",
    Status.NOT_CONVERGED: "The optimisation did not converge; the best allowed dose found was taken. Check the tuning.",
    Status.NON_FINITE: "The computation gave no possible number; the last dose was kept. Check the model.",
    Status.READING_REJECTED: (
        "The guard did not believe this reading, which is out of range, too fast or stuck; "
        "until one is accepted it gives at most the basal rate. Check the sensor."
    ),
    Status.FALLBACK_BASAL: (
        "No reading could be accepted for longer than the guard's gap (20 min, if not set otherwise); "
        "the guard gives at most the basal rate, and no bolus. Check the sensor, and glucose by another means."
    ),
    Status.FALLBACK_REDUCED: (
        "No reading could be accepted for longer than the guard's long gap (90 min, if not set otherwise); "
        "the guard gives a part of the basal rate. Check glucose by another means, and replace the sensor."
    ),
    Status.SUSPENDED: (
        "Glucose is low, may be low or is about to be; the guard gives no insulin until that has passed, but for the "
        "bolus of an announced meal while no reading is low. "
        "Check glucose; be ready to eat."
    ),
    Status.DOSE_LIMITED: (
        "The controller asked for more insulin than the guard allows on board, in an hour or for this reading; "
        "the guard gives the largest dose that it allows. Check glucose if this lasts."
    ),
    Status.RESTARTED: (
        "The controller's memory or dose was no possible number; the guard started it again and gives the basal "
        "rate for this sample. Check the model."
    ),
    Status.NO_FINITE_DOSE: (
        "The controller answered no finite dose; the pump went toward its minimum rate. Check the controller's code."
    ),
    Status.NO_ANSWER: (
        "The controller did not answer in time; the pump gives its fallback rate, at most the basal rate at first and "
        "no bolus. Check the link and the power of the controller."
    ),
}


@pytree
class Decision:
    """A dose, which is a basal rate and perhaps a bolus, with its status."""

    insulin_mU_min: jax.Array
    """Basal rate until the next decision."""
    status: jax.Array
    """Status of the decision, a `Status` as an integer."""
    holds_until_min: jax.Array | None = None
    """Time after which a pump returns to the basal rate by itself, or None for the next decision. See `real_time`."""
    bolus_mU: jax.Array | None = None
    """Insulin given at once, beside the basal rate; 0 for none at this sample, and None from a controller without
    boluses. A controller with boluses has ``gives_boluses = True``.
    """
    glucagon_ug: jax.Array | None = None
    """Glucagon that is given from this sample to the next, by the second route of the pump; 0 for none, and None from a
    controller without glucagon. One with glucagon has ``gives_glucagon = True``.
    """


def gives_glucagon(controller: object) -> bool:
    """Whether a controller decides on glucagon too.

    A controller declares it by an attribute ``gives_glucagon``, which a wrapper passes on. All its decisions then hold
    an amount.
    """
    return bool(getattr(controller, "gives_glucagon", False))


@pytree
class DoseForecast:
    """Forecast on which a decision rests, with the rates under which it is made; times ahead are the leading axis."""

    ahead_min: jax.Array
    """(points,) times ahead of the sample, from 0 on."""
    glucose_mg_dl: jax.Array
    """(points, ...) glucose that the controller expects then."""
    insulin_mU_min: jax.Array
    """(points, ...) rate from each of these times to the next, a bolus included: the plan, whose first rate is what the
    controller decides on, or for a controller that plans no doses the basal rate.
    """
    others_mg_dl: dict[str, jax.Array] | None = None
    """Further forecasts ``(points, ...)`` by name, such as a cautious one; NaN where there is none."""


def forecast_of(controller: object, state: Any, observation: Observation) -> DoseForecast | None:
    """Forecast on which a controller decides at an observation, in the state before it; None if it makes none.

    A controller tells it by a method ``forecast(state, observation)``, which a wrapper passes on.
    """
    method = getattr(controller, "forecast", None)
    result: DoseForecast | None = None if method is None else method(state, observation)
    return result


def gives_boluses(controller: object) -> bool:
    """Whether a controller decides on boluses beside its basal rate.

    A controller declares it by an attribute ``gives_boluses``, which a wrapper passes on. All its decisions then hold a
    bolus.
    """
    return bool(getattr(controller, "gives_boluses", False))


def uses_of(controller: object) -> frozenset[Need]:
    """Needs that a controller meets, of `component.effects.OF_CONTROLLERS`.

    A controller declares it by an attribute ``uses``, which a wrapper passes on, or by its declaration; one that does
    neither is taken to use everything.
    """
    uses = getattr(controller, "uses", OF_CONTROLLERS)
    result: frozenset[Need] = getattr(controller, "used", OF_CONTROLLERS) if callable(uses) else uses
    return result


def draws(controller: object) -> bool:
    """Whether a controller draws random numbers, as one that stands for a person who miscounts.

    A controller declares it by an attribute ``draws``, which a wrapper passes on. Each observation of a simulation then
    has a key of its own, from which the same numbers follow for the same person and sample.
    """
    return bool(getattr(controller, "draws", False))


def computed_settings(controller: object) -> dict[str, float]:
    """Settings that were settled when a controller was designed, by name, such as a gain that follows from a model.

    A controller tells them by a method ``settled``, which a wrapper passes on; by default it has none. They are those
    of one person, and are not asked of a controller for many.
    """
    method = getattr(controller, "settled", None)
    return {} if method is None else {name: float(value) for name, value in method().items()}


class Controller(Protocol):
    """Controller from observations to decisions. It is designed once; `step` never raises. The state is any pytree."""

    @property
    def sample_time_min(self) -> float:
        """Time between two observations."""

    def init(self, observation: Observation) -> Any:
        """State of a controller that starts at this observation."""

    def step(self, state: Any, observation: Observation) -> tuple[Any, Decision]:
        """Decide on the dose for the coming sample."""
