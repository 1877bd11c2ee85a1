"""Limits of a pump: the constraints (17) and (18) of Parker, Doyle and Peppas (1999), and those of a bolus.

Every pump has them as settings; `LimitedPump` keeps them, alone or inside another pump.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import KW_ONLY
from typing import Annotated, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.arguments import checked, is_traced
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import BOLUSES, GLUCAGON
from glucoloop.component.pytree_component import DATA, HOST, PytreeComponent, wired
from glucoloop.component.routes import PUMP_OF_1999
from glucoloop.component.setting import About, known_names
from glucoloop.pumps.protocol import Delivery, Pump
from glucoloop.refusal import Refusal
from glucoloop.unit_guess import BOLUS_STEP, LARGEST_BOLUS, LARGEST_RATE, RATE_CHANGE, RATE_STEP, refuse_unusual
from glucoloop.units import MU_PER_U


@pytree
class DoseLimits:
    """Bounds on the infusion and on its change from one sample to the next."""

    max_change_mU_min: jax.Array | float = PUMP_OF_1999.max_change_mU_min
    min_mU_min: jax.Array | float = PUMP_OF_1999.min_mU_min
    max_mU_min: jax.Array | float = PUMP_OF_1999.max_mU_min

    def clip(self, insulin_mU_min: jax.Array, previous_mU_min: jax.Array) -> jax.Array:
        """Clip the change first and the magnitude second, as the paper does."""
        change = jnp.clip(insulin_mU_min - previous_mU_min, -self.max_change_mU_min, self.max_change_mU_min)
        return jnp.clip(previous_mU_min + change, self.min_mU_min, self.max_mU_min)

    def allow(self, insulin_mU_min: jax.Array, previous_mU_min: jax.Array, slack_mU_min: float = 0.0) -> jax.Array:
        """Whether a rate keeps both limits, compared with the limits themselves, since a clipped rate is rounded."""
        change = jnp.abs(insulin_mU_min - previous_mU_min)
        return (
            (change <= self.max_change_mU_min + slack_mU_min)
            & (insulin_mU_min >= self.min_mU_min - slack_mU_min)
            & (insulin_mU_min <= self.max_mU_min + slack_mU_min)
        )


PARKER_1999_LIMITS: Final = DoseLimits()
"""Limits of the paper."""


@checked
def dose_limits(
    *,
    max_change_mU_min: float = PUMP_OF_1999.max_change_mU_min,
    min_mU_min: float = PUMP_OF_1999.min_mU_min,
    max_mU_min: float = PUMP_OF_1999.max_mU_min,
    allow_unusual: bool = False,
) -> DoseLimits:
    """Limits with the given bounds; those of Parker et al. (1999) for the others.

    Raises
    ------
    ValueError
        Unless ``0 < max_change`` and ``0 <= min < max``, all finite; for a maximum rate or change so small that U/h
        were probably meant, unless `allow_unusual`.
    """
    if not is_traced(max_change_mU_min) and not 0.0 < max_change_mU_min < math.inf:
        raise Refusal(
            f"a rate limit of {max_change_mU_min:g} mU/min per sample is not possible; give a finite value above 0"
        )
    if not is_traced(min_mU_min, max_mU_min) and not 0.0 <= min_mU_min < max_mU_min < math.inf:
        raise Refusal(
            f"a dose range of {min_mU_min:g} to {max_mU_min:g} mU/min is not possible; "
            "give 0 or more as the lower and a larger finite value as the upper bound"
        )
    for name, value, quantity in (
        ("max_mU_min", max_mU_min, LARGEST_RATE),
        ("max_change_mU_min", max_change_mU_min, RATE_CHANGE),
    ):
        if not allow_unusual and not is_traced(value) and value < quantity.least:  # a large one is no bound
            refuse_unusual(value, quantity, name)
    return DoseLimits(max_change_mU_min=max_change_mU_min, min_mU_min=min_mU_min, max_mU_min=max_mU_min)


_HAIR: Final = 1e-9  # of a step: a whole number of steps may come out just below itself


@pytree
class BolusLimits:
    """Bounds and resolution of one bolus. The limits of the basal rate do not bind it."""

    max_mU: jax.Array | float = 25_000.0
    min_mU: jax.Array | float = 50.0
    step_mU: jax.Array | float = 50.0

    def allowed(self, bolus_mU: jax.Array) -> jax.Array:
        """Bolus that a pump gives for a requested one, which may be any number or NaN.

        It is rounded down to whole steps, and the remainder is not given later. A bolus above the largest one is cut to
        it. One that is below the minimum, below zero or not finite is not given at all.
        """
        whole = _whole_steps(bolus_mU, self.max_mU, self.step_mU)
        return jnp.where(whole >= self.min_mU - _HAIR * self.step_mU, whole, 0.0)


def _whole_steps(dose: jax.Array, most: jax.Array | float, step: jax.Array | float) -> jax.Array:
    """Dose cut to the largest and rounded down to whole steps; 0 where it is below zero or not finite."""
    wanted = jnp.where(jnp.isfinite(dose) & (dose > 0.0), dose, 0.0)
    return jnp.floor(jnp.minimum(wanted, most) / step + _HAIR) * step


@pytree
class GlucagonLimits:
    """Bounds and resolution of glucagon from one sample to the next, by a second route of the pump.

    The step is a pulse of 0.5 ul, as pumps of insulin have it, of 1 mg/ml; the largest amount is the largest of the
    doses of M. W. Haymond et al., Diabetes Care 39(3), 2016, 465-468.
    """

    max_ug: jax.Array | float = 300.0
    step_ug: jax.Array | float = 0.5

    def allowed(self, glucagon_ug: jax.Array) -> jax.Array:
        """Amount that a pump gives for a requested one, any number or NaN, as a bolus: rounded down to whole steps."""
        return _whole_steps(glucagon_ug, self.max_ug, self.step_ug)


DEFAULT_BOLUS_LIMITS: Final = BolusLimits()
"""Largest bolus of 25 U, as of the t:slim X2 (Tandem), in steps of 0.05 U, the pulse of the Omnipod (Insulet); the
usual pumps can give every bolus within these limits.
"""


@checked
def bolus_limits(*, max_U: float = 25.0, min_U: float = 0.05, step_U: float = 0.05) -> BolusLimits:
    """Limits of boluses in units of insulin.

    Parameters
    ----------
    max_U : float
        Largest bolus [U].
    min_U : float
        Minimum bolus that is given at all [U].
    step_U : float
        Step of which boluses are multiples [U].

    Raises
    ------
    ValueError
        Unless ``0 < step <= max`` and ``0 <= min <= max``, all finite.
    """
    if not is_traced(max_U, step_U) and not 0.0 < step_U <= max_U < math.inf:
        raise Refusal(
            f"boluses in steps of {step_U:g} U up to {max_U:g} U are not possible; "
            "give a step above 0 U and a finite largest bolus of at least one step"
        )
    if not is_traced(min_U, max_U) and not 0.0 <= min_U <= max_U:
        raise Refusal(
            f"a minimum bolus of {min_U:g} U is not possible; give 0 U or more, and at most the largest, {max_U:g} U"
        )
    return BolusLimits(max_mU=MU_PER_U * max_U, min_mU=MU_PER_U * min_U, step_mU=MU_PER_U * step_U)


_limit: Final = functools.partial(About, at_most=10_000.0)
_bolus: Final = functools.partial(About, at_most=1000.0, needs=(BOLUSES,))
_glucagon: Final = functools.partial(About, at_most=10_000.0, above=0.0, needs=(GLUCAGON,))


class PumpComponent(PytreeComponent):
    """A pump with its limits, `init` and `deliver`; one around another extends `PumpAround`."""

    kind: ClassVar = "pump"
    own_limits: ClassVar[Mapping[str, float]] = {}
    """Limits of the pump by setting, where they are not those usual for the patient. With this pump they are the
    defaults of a run, so that controllers, guard and metrics know them."""

    _: KW_ONLY
    max_change_mU_min: Annotated[
        float | None,
        _limit("Largest change of the rate from one sample to the next; that of the patient's pump.", above=0.0),
        HOST,
    ] = None
    min_insulin_mU_min: Annotated[
        float | None,
        _limit("Minimum rate of the pump; that of the patient's pump.", at_least=0.0),
        HOST,
    ] = None
    max_insulin_mU_min: Annotated[
        float | None,
        _limit("Maximum rate of the pump; that of the patient's pump.", above=0.0),
        HOST,
    ] = None
    resolution_mU_min: Annotated[
        float | None,
        _limit("Smallest step of the rate; any rate by default.", above=0.0, quantity=RATE_STEP),
        HOST,
    ] = None
    max_bolus_U: Annotated[float, _bolus("Largest bolus of the pump.", above=0.0, quantity=LARGEST_BOLUS), HOST] = 25.0
    min_bolus_U: Annotated[
        float,
        _bolus("Minimum bolus that the pump gives; a smaller one is not given.", at_least=0.0, quantity=BOLUS_STEP),
        HOST,
    ] = 0.05
    bolus_step_U: Annotated[
        float,
        _bolus("Step of a bolus, which is rounded down to whole ones.", above=0.0, quantity=BOLUS_STEP),
        HOST,
    ] = 0.05
    max_glucagon_ug: Annotated[float, _glucagon("Most glucagon of the pump from one sample to the next."), HOST] = 300.0
    glucagon_step_ug: Annotated[float, _glucagon("Step of glucagon, which is rounded down to whole ones."), HOST] = 0.5
    sample_time_min: float = wired(HOST, default=5.0)

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        for key in cls.own_limits:
            if key not in PumpComponent.settings():
                raise TypeError(
                    f"the pump {cls.name} has a limit {key!r}; {known_names(key, PumpComponent.settings())}"
                )

    def __post_init__(self) -> None:
        if not 0.0 < self.sample_time_min < math.inf:
            raise Refusal(
                f"a sample time of {self.sample_time_min:g} min is not possible; give a finite one above 0 min"
            )

    @classmethod
    def _limits(cls, values: Mapping[str, Any]) -> tuple[DoseLimits, BolusLimits]:
        """Limits of the settings, of the class, and of the paper."""
        defaults = {name: setting.default.noise_free for name, setting in PumpComponent.settings().items()}
        of_pump = {name: values[name] for name in cls.settings() if values[name] != defaults.get(name)}
        settings = {**defaults, **cls.own_limits, **of_pump}

        def rate(name: str, default: Any) -> Any:
            return default if settings[name] is None else settings[name]

        paper = PARKER_1999_LIMITS
        return DoseLimits(
            max_change_mU_min=rate("max_change_mU_min", paper.max_change_mU_min),
            min_mU_min=rate("min_insulin_mU_min", paper.min_mU_min),
            max_mU_min=rate("max_insulin_mU_min", paper.max_mU_min),
        ), BolusLimits(
            max_mU=MU_PER_U * settings["max_bolus_U"],
            min_mU=MU_PER_U * settings["min_bolus_U"],
            step_mU=MU_PER_U * settings["bolus_step_U"],
        )


PUMPS: Final = Catalogue(
    PumpComponent,
    {
        "limited": "glucoloop.pumps.limits:LimitedPump",
        "resolution": "glucoloop.pumps.resolution:Resolution",
        "expiring": "glucoloop.pumps.expiring:Expiring",
        "infusion-set": "glucoloop.pumps.infusion_set:InfusionSet",
        "pen": "glucoloop.pumps.pen:Pen",
    },
    example="expiring, samples=3",
    unnamed=True,
)


class LimitedPump(PumpComponent, name="limited"):
    """Keeps its limits.

    It clips rate of change and magnitude of the basal rate, and keeps the limits of a bolus. A commanded rate that is
    not a number moves toward the minimum rate. A bolus does not count as a change of the rate.
    """

    _: KW_ONLY
    limits: DoseLimits = wired(DATA, default=None)
    """Limits of the rate; by default those of the settings."""
    bolus: BolusLimits = wired(DATA, default=None)
    glucagon: GlucagonLimits | None = wired(DATA, default=None)
    """Limits of a second route; None for a pump without one."""

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes, with limits that follow from the settings."""
        of_settings = dict(zip(("limits", "bolus"), cls._limits(values), strict=True))
        connected = {name: value for name, value in values.items() if value is not None or name not in of_settings}
        return super().resolved({**of_settings, **connected})

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> jax.Array:
        """State of the pump: the last delivered rate."""
        return jnp.clip(insulin_mU_min, self.limits.min_mU_min, self.limits.max_mU_min)

    def deliver(
        self, state: jax.Array, command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[jax.Array, Delivery]:
        """Deliver the nearest allowed rate, and the bolus as far as it is allowed."""
        command = jnp.where(jnp.isnan(command_mU_min), self.limits.min_mU_min, command_mU_min)
        delivered = self.limits.clip(command, state)
        bolus = None if bolus_mU is None else self.bolus.allowed(bolus_mU)
        return delivered, Delivery(
            insulin_mU_min=delivered, reported_mU_min=delivered, bolus_mU=bolus, reported_bolus_mU=bolus
        )


class PumpAround(PumpComponent):
    """A pump around another one, its ``inner``, by default one that keeps the limits."""

    _: KW_ONLY
    inner: Pump = wired(DATA, default=None)

    @classmethod
    def resolved(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes, with a pump inside that keeps the limits of the settings."""
        result = super().resolved(values)
        if result.get("inner") is None:
            limits, bolus = cls._limits(values)
            result["inner"] = LimitedPump(limits=limits, bolus=bolus)
        return result
