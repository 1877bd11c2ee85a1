"""Glucagon: a second hormone around any controller of insulin, each way of dosing it one class.

A way joins every command that has the option by one class, entered in `GLUCAGON` or by the entry point of another
package in the group ``glucoloop.glucagon_controllers``. It is put inside the guard, if there is one, which bounds it.

No published controller of both hormones was found whose equations and numbers can be read. `ThresholdGlucagon` has the
form of most of them, proportional and derivative below a threshold, with gains of our own; `MiniDoseGlucagon` is the
dose that adults give themselves.

References
----------
F. H. El-Khatib, J. Jiang, E. R. Damiano, "A feasibility study of bihormonal closed-loop blood glucose control using
dual subcutaneous infusion of insulin and glucagon in ambulatory diabetic swine", J. Diabetes Sci. Technol. 3(4), 2009,
789-803: glucagon by proportional-derivative control.
M. W. Haymond et al., "Nonaqueous, mini-dose glucagon for treatment of mild hypoglycemia in
adults with type 1 diabetes: a dose-seeking study", Diabetes Care 39(3), 2016, 465-468.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import READINGS, Need
from glucoloop.component.pytree_component import DATA, HOST, derived, wired
from glucoloop.component.setting import About
from glucoloop.control.around import ControllerAround
from glucoloop.control.decision import announced_carbs, delivered_since, is_known
from glucoloop.control.protocol import Decision, DoseForecast, Observation, forecast_of
from glucoloop.pumps.limits import DoseLimits
from glucoloop.unit_guess import GLUCOSE_BOUND

_LONG_MIN: Final = 1e5
"""Time since a dose that was never given."""
_GAIN_UG_PER_MG_DL: Final = {True: 0.5, False: 0.02}
"""Gain by whether glucagon is subcutaneous. Intravenously it acts at once, and more: 10 ug raise glucose of
`parker-1999` by 27 mg/dl, and 75 ug subcutaneously that of `wilinska-2010-glucagon` by 39 mg/dl."""


@pytree
class _GlucagonState:
    """State of the inner controller, and the memory of the doses."""

    inner: Any
    memory: Any


class GlucagonComponent(ControllerAround):
    """Declaration of a way of dosing glucagon: a controller around one of insulin.

    One has the methods `remember`, for its memory before the first sample, and `amount`. Where it gives glucagon, no
    insulin is given but the bolus of an announced meal.
    """

    kind: ClassVar = "glucagon controller"
    subcutaneous: bool = wired(HOST, default=True)
    """Whether glucagon is subcutaneous, as insulin is."""
    limits: DoseLimits | None = wired(DATA, default=None)
    """Limits of the rate of the pump, which bound by how much it falls where glucagon is given; None for no bound."""

    @property
    def gives_glucagon(self) -> bool:
        """Whether it gives glucagon, which it does."""
        return True

    def uses(self) -> frozenset[Need]:
        """Needs that it meets by itself."""
        return frozenset({READINGS})

    def init(self, observation: Observation) -> _GlucagonState:
        """State before the first sample."""
        return _GlucagonState(inner=self.inner.init(observation), memory=self.remember(observation))

    def step(self, state: _GlucagonState, observation: Observation) -> tuple[_GlucagonState, Decision]:
        """Let the inner controller decide on insulin, and replace it by glucagon where glucose is low."""
        inner, decision = self.inner.step(state.inner, observation)
        memory, glucagon = self.amount(state.memory, observation)
        gives, bolus = glucagon > 0.0, decision.bolus_mU
        if bolus is not None:
            bolus = jnp.where(gives & ~(announced_carbs(observation) > 0.0), 0.0, bolus)
        rate = decision.insulin_mU_min
        none = jnp.zeros_like(rate)
        if self.limits is not None:
            none = self.limits.clip(none, delivered_since(observation, rate))
        insulin = jnp.where(gives, none, rate)
        decision = dataclasses.replace(decision, insulin_mU_min=insulin, bolus_mU=bolus, glucagon_ug=glucagon)
        return _GlucagonState(inner=inner, memory=memory), decision

    def forecast(self, state: _GlucagonState, observation: Observation) -> DoseForecast | None:
        """Forecast of the inner controller, which knows of no glucagon."""
        return forecast_of(self.inner, state.inner, observation)

    def remember(self, observation: Observation) -> Any:
        """Memory before the first sample."""
        raise NotImplementedError

    def amount(self, memory: Any, observation: Observation) -> tuple[Any, jax.Array]:
        """Memory after a sample, and glucagon at it [ug]."""
        raise NotImplementedError


@pytree
class _Trend:
    """Last known reading, the time since it, and the filtered rate of change of readings."""

    glucose_mg_dl: jax.Array
    since_min: jax.Array
    rate_mg_dl_min: jax.Array


class ThresholdGlucagon(GlucagonComponent, name="threshold"):
    """Glucagon in proportion to how far a prediction is below a threshold.

    At each sample ``gain (below - y - ahead y')`` where the reading y is below the threshold and that is above 0; the
    rate y' is that of the readings, filtered over 15 min, and counts where glucose falls alone. With 0 min ahead it
    is proportional and nothing else. A reading that is missing gets none.
    """

    below_mg_dl: Annotated[
        float,
        About("Reading below which glucagon is given, in mg/dl.", above=0.0, at_most=400.0, quantity=GLUCOSE_BOUND),
    ] = 80.0
    gain_ug_per_mg_dl: Annotated[
        float | None,
        About(
            "Glucagon of a sample for each mg/dl; 0.5 subcutaneously and 0.02 intravenously.",
            at_least=0.0,
            at_most=100.0,
        ),
        HOST,
    ] = None
    ahead_min: Annotated[float, About("Time over which a fall of glucose counts.", at_least=0.0, at_most=120.0)] = 15.0
    filter_min: Annotated[
        float, About("Time constant with which the rate of change of readings is filtered.", above=0.0, at_most=120.0)
    ] = 15.0

    @derived
    def gain(self) -> float:
        """Gain of a sample."""
        default = _GAIN_UG_PER_MG_DL[self.subcutaneous]
        return default if self.gain_ug_per_mg_dl is None else self.gain_ug_per_mg_dl

    def remember(self, observation: Observation) -> _Trend:
        """The first reading, and no change."""
        y = jnp.where(is_known(observation), observation.glucose_mg_dl, observation.setpoint_mg_dl)
        return _Trend(glucose_mg_dl=y, since_min=jnp.zeros_like(y), rate_mg_dl_min=jnp.zeros_like(y))

    def amount(self, memory: _Trend, observation: Observation) -> tuple[_Trend, jax.Array]:
        """Trend after the reading, and the amount at it."""
        known = is_known(observation)
        y = jnp.where(known, observation.glucose_mg_dl, memory.glucose_mg_dl)
        passed = jnp.where(memory.since_min > 0.0, memory.since_min, self.sample_time_min)
        kept = jnp.exp(-passed / self.filter_min)
        rate = kept * memory.rate_mg_dl_min + (1.0 - kept) * (y - memory.glucose_mg_dl) / passed
        rate = jnp.where(known, rate, memory.rate_mg_dl_min)
        missing = jnp.maximum(self.below_mg_dl - y - self.ahead_min * jnp.minimum(rate, 0.0), 0.0)
        amount = jnp.where(known & (y < self.below_mg_dl), self.gain * missing, 0.0)
        since = jnp.minimum(jnp.where(known, 0.0, memory.since_min) + self.sample_time_min, _LONG_MIN)
        return _Trend(glucose_mg_dl=y, since_min=since, rate_mg_dl_min=rate), amount


class MiniDoseGlucagon(GlucagonComponent, name="mini-dose"):
    """One dose at low glucose, and the same again if glucose is still low 30 min later.

    Haymond et al. (2016) gave adults 75, 150 and 300 ug; glucose rose most within 60 min, by 33, 64 and 95 mg/dl in
    the mean where it was 110 before, and by 19, 24 and 43 where insulin had brought it to 70.
    """

    sources = ("haymond2016",)
    dose_ug: Annotated[float, About("Dose.", above=0.0, at_most=10_000.0)] = 150.0
    below_mg_dl: Annotated[
        float,
        About("Reading below which it is given, in mg/dl.", above=0.0, at_most=400.0, quantity=GLUCOSE_BOUND),
    ] = 70.0
    again_min: Annotated[
        float, About("Time after which it is given again if the reading is still low.", above=0.0, at_most=1440.0)
    ] = 30.0

    def remember(self, observation: Observation) -> jax.Array:
        """Time since a dose long ago."""
        return jnp.full_like(observation.glucose_mg_dl, _LONG_MIN)

    def amount(self, memory: jax.Array, observation: Observation) -> tuple[jax.Array, jax.Array]:
        """Time since the last dose after a sample, and the dose at it."""
        low = is_known(observation) & (observation.glucose_mg_dl < self.below_mg_dl)
        gives = low & ~(memory < self.again_min)
        since = jnp.minimum(jnp.where(gives, 0.0, memory) + self.sample_time_min, _LONG_MIN)
        return since, jnp.where(gives, self.dose_ug, 0.0)


GLUCAGON: Final = Catalogue(
    GlucagonComponent,
    {
        "threshold": "glucoloop.control.glucagon:ThresholdGlucagon",
        "mini-dose": "glucoloop.control.glucagon:MiniDoseGlucagon",
    },
    example="threshold, below_mg_dl=75",
    unnamed=True,
)
