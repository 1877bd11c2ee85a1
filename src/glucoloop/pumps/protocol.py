"""Protocol of a pump in the loop."""

from __future__ import annotations

import inspect
from typing import Any, Protocol

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.arguments import ArgumentTypeError


@pytree
class Delivery:
    """Result of a command to a pump."""

    insulin_mU_min: jax.Array
    """Basal rate that reaches the patient until the next command."""
    reported_mU_min: jax.Array
    """Basal rate that the pump reports, which is all that a controller learns; NaN if it reports nothing."""
    bolus_mU: jax.Array | None = None
    """Bolus that reaches the patient before the next command, beside the basal rate, or None without a request."""
    reported_bolus_mU: jax.Array | None = None
    """Bolus that the pump reports; NaN if it reports nothing."""
    glucagon_ug: jax.Array | None = None
    """Glucagon that reaches the patient until the next command, which the loop adds; None without a request."""


class Pump(Protocol):
    """Turns a commanded dose into a delivered one. The state is any pytree; randomness comes from the key alone.

    A pump whose `deliver` has no argument ``bolus_mU`` works with every controller that gives no boluses, and one
    without an attribute ``glucagon``, the limits of a second route, with every controller that gives no glucagon.
    """

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Any:
        """State of a pump that has delivered the given rate for a long time."""

    def deliver(
        self, state: Any, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[Any, Delivery]:
        """Delivery until the next command, with a key of its own; never raises, for any command.

        The basal rate and the bolus are separate: limits of the rate do not bind the bolus. None stands for a
        controller that never gives a bolus; the delivery then has none either.
        """


def deliver(
    pump: Pump, state: Any, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None
) -> tuple[Any, Delivery]:
    """Pass a basal rate to a pump, and a bolus unless that is None; refuse a bolus where the pump can give none."""
    if bolus_mU is None:
        return pump.deliver(state, command_mU_min, key)
    if "bolus_mU" not in inspect.signature(pump.deliver).parameters:
        raise ArgumentTypeError(
            f"the pump {type(pump).__name__} cannot give a bolus, and the controller asks for one; "
            "write deliver(self, state, command_mU_min, key, bolus_mU=None), or take a controller without boluses"
        )
    return pump.deliver(state, command_mU_min, key, bolus_mU)


def glucagon_route(pump: Pump) -> Any:
    """Limits of the second route of a pump, or of the pump inside of it; refuse a pump without one."""
    part: Any = pump
    while part is not None:
        limits = getattr(part, "glucagon", None)
        if limits is not None:
            return limits
        part = getattr(part, "inner", None)
    raise ArgumentTypeError(
        f"the pump {type(pump).__name__} has no route for glucagon, and the controller asks for some; give it one, as "
        "in LimitedPump(glucagon=GlucagonLimits()), or take a controller without glucagon"
    )


def gives_bolus(pump: Pump) -> bool:
    """Whether a pump, and every inner pump, can give a bolus."""

    def first_delivery() -> Any:
        dose, key = jnp.zeros(()), jax.random.key(0)
        return deliver(pump, pump.init(dose, key), dose, key, dose)

    try:
        jax.eval_shape(first_delivery)
    except ArgumentTypeError:
        return False
    return True
