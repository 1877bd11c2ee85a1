"""Controller prepared for C: in the precision of the chip, with a decision that is always a finite number."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.control.protocol import (
    Controller,
    Decision,
    Observation,
    Status,
    draws,
    gives_boluses,
    gives_glucagon,
)
from glucoloop.native.primitives import UnsupportedError
from glucoloop.native.targets.c.compact.arithmetic import Evaluation
from glucoloop.native.targets.c.source import LastClamp, Source, Traced, trace, write_source
from glucoloop.pumps import DEFAULT_BOLUS_LIMITS, BolusLimits, DoseLimits, GlucagonLimits
from glucoloop.refusal import Refusal

PRECISIONS = ("float32", "float64")
_BOLUS, _GLUCAGON = "bolus_mU", "glucagon_ug"
"""Fields of a decision for amounts beside the rate."""


@dataclass(frozen=True)
class Exported:
    """A controller in C, and its reference."""

    source: Source
    traced: Traced
    precision: str
    limits: DoseLimits
    last: LastClamp
    """Bounds that C applies last."""

    @property
    def gives_boluses(self) -> bool:
        """Whether the controller decides on boluses beside its rate."""
        return _BOLUS in self.last.amounts

    @property
    def gives_glucagon(self) -> bool:
        """Whether it decides on glucagon too."""
        return _GLUCAGON in self.last.amounts

    def meaning(self) -> tuple[Evaluation, Evaluation]:
        """Init and step of the compact form in NumPy, as a reference."""
        return Evaluation(self.traced.init, self.precision), Evaluation(self.traced.step, self.precision)


def export(
    controller: Controller,
    limits: DoseLimits,
    observation: Observation,
    title: list[str],
    *,
    precision: str = "float32",
    form: str = "auto",
    bolus: BolusLimits = DEFAULT_BOLUS_LIMITS,
    glucagon: GlucagonLimits | None = None,
) -> Exported:
    """Write a controller in C, as of an example of an observation, whose fields that are None are absent in C.

    A dose of NaN is replaced by the minimum rate of the pump, with the status `NO_FINITE_DOSE`; the maximum bolus of
    the pump bounds those of the controller, and its maximum of glucagon likewise. An unknown precision or form, and a
    controller that C cannot express, are refused.
    """
    if precision not in PRECISIONS:
        raise Refusal(f"the precision is {precision!r}; give {' or '.join(PRECISIONS)}")
    if draws(controller):
        raise Refusal(f"{type(controller).__name__} draws random numbers, which C has not; export one that draws none")
    real = np.dtype(precision)

    def cast(leaf: Any) -> Any:
        array = np.asarray(leaf)
        return array.astype(real) if np.issubdtype(array.dtype, np.floating) else leaf

    of_chip = jax.tree.map(cast, controller)
    example = jax.tree.map(lambda leaf: np.asarray(cast(leaf)), observation)
    amounts = {_BOLUS: float(bolus.max_mU)} if gives_boluses(controller) else {}
    amounts |= {_GLUCAGON: float((glucagon or GlucagonLimits()).max_ug)} if gives_glucagon(controller) else {}
    last = _last_clamp(limits, amounts, real)

    def step(state: Any, observation: Observation) -> tuple[Any, Decision]:
        state, decision = of_chip.step(state, observation)
        return state, _finished(decision, last, real)

    try:
        traced = trace(of_chip.init, step, example, precision)
        source = write_source(traced, title, form, last)
    except UnsupportedError as error:
        raise Refusal(f"this controller cannot be written in C in the {form} form: it uses {error}") from None
    return Exported(source=source, traced=traced, precision=precision, limits=limits, last=last)


def _last_clamp(limits: DoseLimits, amounts: Mapping[str, float], real: np.dtype[Any]) -> LastClamp:
    """Limits of the pump as C applies them last, with room for the rounding that controllers and guard allow."""
    rounding = 8.0 * float(np.finfo(real).eps) * float(limits.max_mU_min)
    return LastClamp(
        rate="insulin_mU_min",
        delivered="delivered_mU_min",
        minimum=float(real.type(limits.min_mU_min)),
        maximum=float(real.type(limits.max_mU_min)),
        change=float(real.type(float(limits.max_change_mU_min) + rounding)),
        amounts={name: float(real.type(largest)) for name, largest in amounts.items()},
    )


def _finished(decision: Decision, last: LastClamp, real: np.dtype[Any]) -> Decision:
    """A decision whose dose is a number within the limits of the pump."""
    dose, minimum, maximum = decision.insulin_mU_min, real.type(last.minimum), real.type(last.maximum)
    amounts = {name: getattr(decision, name) for name in last.amounts}
    finite = jnp.isfinite(dose)
    for amount in amounts.values():
        finite = finite & jnp.isfinite(amount)
    return dataclasses.replace(
        decision,
        insulin_mU_min=jnp.clip(jnp.where(finite, dose, minimum), minimum, maximum),
        status=jnp.where(finite, decision.status, int(Status.NO_FINITE_DOSE)),
        **{
            name: jnp.where(finite & (amount > 0.0), jnp.minimum(amount, real.type(last.amounts[name])), 0.0)
            for name, amount in amounts.items()
        },
    )
