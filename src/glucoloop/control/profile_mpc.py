"""Nonlinear model predictive control by a person's profile, with announced meals, for subcutaneous insulin.

The idea of a forecast by the person's equations, a meal that is announced and costs that are dearer below the target
is that of R. Hovorka et al., Physiol. Meas. 25, 2004, 905-920, and D. Boiroux, J. B. Jørgensen, "Nonlinear model
predictive control and artificial pancreas technologies", IEEE CDC 2018. The linearisation along the last plan is the
real-time iteration of M. Diehl, H. G. Bock, J. P. Schloeder, SIAM J. Control Optim. 43(5), 2005.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import KW_ONLY
from typing import Annotated, Any, ClassVar, Final, NamedTuple, Self

from glucoloop._lazy_jax import jax, jnp, np
from glucoloop._pytree import pytree
from glucoloop.component.pytree_component import DATA, HOST, STATIC, wired
from glucoloop.component.setting import About
from glucoloop.control.decision import (
    MealsToCome,
    decide,
    delivered_since,
    hear,
    is_eating,
    is_known,
    is_of_a_person,
    no_meals_to_come,
    rate_at_start,
    target_mg_dl,
    with_rescue,
)
from glucoloop.control.design_case import DesignCase
from glucoloop.control.part import ByProfile, SensorLag
from glucoloop.control.protocol import Decision, DoseForecast, Observation
from glucoloop.estimation.fed_filter import SAMPLE_MIN, FedEstimate, FedFilter, Learning
from glucoloop.estimation.noise_level import CORRELATION
from glucoloop.models.nonlinear import Equations
from glucoloop.models.profiled import GutCompartments, ProfiledModel, Step, profiled_model
from glucoloop.models.state_space import LinearModel
from glucoloop.pumps.limits import DEFAULT_BOLUS_LIMITS, PARKER_1999_LIMITS, BolusLimits, DoseLimits
from glucoloop.qp.bounded_rates import OneSided, minimise_rates
from glucoloop.therapy import Profile
from glucoloop.unit_guess import GLUCOSE_BOUND
from glucoloop.units import MG_PER_G, MU_PER_U

_BLOCK_ENDS_MIN: Final = (15.0, 30.0, 60.0, 90.0, 120.0, 180.0, 240.0, 360.0, 480.0)
"""Ends of the blocks of the plan, in each of which the rate is held; the first one is a sample."""
_STEPS_MIN: Final = ((240.0, 30.0), (math.inf, 60.0))
"""Longest step of the forecast in blocks that end by a time."""
_ITERATIONS: Final = 2
"""Linearisations at each sample."""
_MIN_VARIANCE: Final = 0.25
"""(mg/dl)^2 that the filter expects of readings without noise."""


@pytree
class _ProfileMPCState:
    """State of the controller."""

    estimate: FedEstimate
    plan_mU_min: jax.Array
    """(m,) rates of the last plan, block by block."""
    requested_mU_min: jax.Array
    """Rate that was asked for at the last sample, used where the pump reports nothing."""
    requested_bolus_mU: jax.Array
    """Bolus that was asked for at the last sample, used likewise."""
    to_come: MealsToCome | None = None
    """Announced meals that are still to be eaten; None where observations tell no time of eating."""


@pytree
class _ForecastSteps:
    """Steps of a forecast over the blocks of a plan."""

    step: Step
    """Matrices of the steps ``(p, ...)``."""
    of_block: Any
    """(p, m) 1 where a step lies in a block."""
    block_min: Any
    """(m,) lengths of the blocks."""


class _Planned(NamedTuple):
    """Estimate at a sample, and the plan."""

    known: jax.Array
    delivered_mU_min: jax.Array
    estimate: FedEstimate
    to_come: MealsToCome | None
    eats: jax.Array
    """Whether a meal is announced at this sample."""
    plan_mU_min: jax.Array
    """(m,) rates of the blocks, the first of which takes a bolus."""
    sound: jax.Array
    """Whether the estimate can be that of a person, and there is a plan."""


class ProfileMPC(ByProfile, name="profile-mpc"):
    """Predictive control by the profile of a person, with boluses for announced meals; for subcutaneous insulin.

    A filter, `estimation.fed_filter`, estimates glucose, the content of the gut, an unexplained appearance and the
    error of the sensor; what insulin does is known from what was delivered. From there the equations forecast glucose
    twice: as expected, G, and cautiously, G_c, where the gut lacks `doubt` standard deviations of its content, and a
    part of the unexplained appearance is not there. The rates u of blocks over eight hours, not below zero and
    within the pump's limits, minimise::

        sum over t of  h(G - r) + b/2 max(0, r - G)^2 + f/2 max(0, floor - G_c)^2
            + sum over j of  w_j/2 (CF (u_j - u_b))^2

    where h is half the square of ``max(0, G - r)`` up to some distance above the target r and straight beyond, so that
    a high peak asks for no more insulin than a lower one that lasts as long. Rates are weighed by what they do to the
    glucose of this person, in mg/dl for each minute, so that one weight is right for people who need much or little
    insulin, whatever the equations of the model.
    What is wanted at once, beyond the rate that follows, is a bolus: with an announced meal, and at other times if the
    pump can give one so small and `automatic_boluses` allows it. The boluses that the pump reports are part of what was
    delivered.

    ============  ===========================================================  ======
    variable      meaning                                                      size
    ============  ===========================================================  ======
    ``G``         glucose expected at the steps ahead                          (14,)
    ``G_c``       the same with what is uncertain left out                     (14,)
    ``u``         rates of the blocks                                          (10,)
    ``w``         weight of each rate; none on a bolus for an announced meal   (10,)
    ``u_b``       basal rate of the person                                     ()
    ``CF``        correction factor of the person that the model believes      ()
    ============  ===========================================================  ======

    The program is solved in a fixed number of rounds (`qp.bounded_rates`), for two linearisations at each sample,
    the first along the plan of the sample before. A known dead time of the readings is not taken into account.
    """

    sources: ClassVar[tuple[str, ...]] = ("hovorka2004", "boiroux2018", "diehl2005")
    slow: ClassVar = True
    on_equations: ClassVar = True
    role_of_settings: ClassVar = HOST
    heals: ClassVar[bool] = True
    """Whether a step leaves a finite state after any state, so that a guard need not check it."""

    straight_beyond_mg_dl: Annotated[
        float, About("Distance above the target beyond which the cost grows no faster, in mg/dl.", above=0.0)
    ] = 5.0
    low_weight: Annotated[
        float, About("Cost of expected glucose below the target, as a multiple of that above it.", above=0.0)
    ] = 50.0
    glucose_floor_mg_dl: Annotated[
        float,
        About("Floor under the cautious forecast, in mg/dl, at most the target.", above=0.0, quantity=GLUCOSE_BOUND),
        DATA,
    ] = 90.0
    floor_weight: Annotated[
        float,
        About("Cost of the cautious forecast below the floor, as a multiple of that above the target.", at_least=0.0),
    ] = 20.0
    doubt: Annotated[
        float,
        About(
            "Standard deviations by which the cautious forecast takes the content of the gut to be less.", at_least=0.0
        ),
        DATA,
    ] = 1.0
    disturbance_doubt: Annotated[
        float,
        About(
            "Share of the appearance of glucose that no meal explains which the cautious forecast leaves out.",
            at_least=0.0,
            at_most=1.0,
        ),
        DATA,
    ] = 0.5
    move_weight: Annotated[
        float,
        About("Weight on planned rates away from the basal rate, by their effect in mg/dl/min.", at_least=0.0),
        DATA,
    ] = 180.0
    bolus_weight: Annotated[
        float,
        About(
            "Weight on the rate of the coming sample away from the basal rate, unless a meal is announced.",
            at_least=0.0,
        ),
        DATA,
    ] = 28.0
    automatic_boluses: Annotated[
        bool,
        About(
            "Whether insulin that is wanted at once is a bolus at any time, or with announced meals alone: true or "
            "false."
        ),
        STATIC,
    ] = True
    gut_min: Annotated[
        float,
        About("Longest time from eating to the largest appearance of glucose that is accepted, in minutes.", above=0.0),
    ] = 36.0
    gut_error_pct: Annotated[
        float,
        About(
            "Standard deviation of people's own times, which are learned from their meals, in percent; 0: gut_min is "
            "everybody's.",
            at_least=0.0,
        ),
    ] = 25.0
    counting_error_pct: Annotated[
        float, About("Standard deviation of the error of announced carbohydrate, in percent.", at_least=0.0)
    ] = 30.0
    meal_noise_g: Annotated[
        float, About("Standard deviation of the carbohydrate that is eaten unannounced in 5 min.", at_least=0.0)
    ] = 6.0
    disturbance_noise_mg_min: Annotated[
        float, About("Standard deviation of the change in 5 min of the appearance that no meal explains.", at_least=0.0)
    ] = 10.0
    disturbance_min: Annotated[
        float, About("Time constant with which the appearance that no meal explains fades.", above=0.0)
    ] = 60.0
    glucose_noise_mg_min: Annotated[
        float, About("Standard deviation of a part of that appearance which is new at each sample.", at_least=0.0)
    ] = 10.0
    measurement_variance: Annotated[
        float,
        About("Variance of white noise of a reading, R; 0: that of the sensor, at least 0.25.", at_least=0.0),
    ] = 0.0
    sensor_error_mg_dl: Annotated[
        float, About("Standard deviation of a correlated error of the sensor; 0: none.", at_least=0.0)
    ] = 9.0
    start_error_mg_dl: Annotated[
        float,
        About("Standard deviation of the distance of glucose from the target at the start, in mg/dl.", at_least=0.0),
    ] = 40.0
    sensor_lag_min: SensorLag = 10.0

    _: KW_ONLY
    model: ProfiledModel = wired(DATA, default=None)
    filter: FedFilter = wired(DATA, default=None)
    ahead: _ForecastSteps = wired(DATA, default=None)
    costs: OneSided = wired(DATA, default=None)
    limits: DoseLimits = wired(DATA, default=PARKER_1999_LIMITS)
    bolus: BolusLimits = wired(DATA, default=DEFAULT_BOLUS_LIMITS)
    sample_time_min: float = wired(STATIC, default=5.0)

    def designed(self, case: DesignCase) -> Self:
        """The controller on the equations of the patient, for a patient's profile."""
        case = case.behind_lag(self.sensor_lag_min)
        return self.of_model(
            case.nonlinear(),
            case.linearised(),
            case.profile,
            case.limits,
            case.bolus,
            nominal_weight_kg=case.profile.weight_kg,
            noise_variance=case.noise_variance,
        )

    def of_model(
        self,
        nominal: Equations,
        linear: LinearModel,
        profile: Profile,
        limits: DoseLimits,
        bolus: BolusLimits,
        *,
        nominal_weight_kg: float | None = None,
        noise_variance: float = 0.0,
    ) -> Self:
        """The controller on a model, for a person.

        Parameters
        ----------
        nominal : Equations
            Equations of the nominal person, at steady state.
        linear : LinearModel
            The same linearised at steady state, with the appearance of a meal as its disturbance.
        profile : Profile
            Profile of the person; see `models.profiled` for what is not known of the person.
        limits, bolus : DoseLimits, BolusLimits
            Limits of the pump.
        nominal_weight_kg : float, optional
            Weight of the nominal person.
        noise_variance : float
            Variance of white noise of the readings, (mg/dl)^2, where the settings give none.

        Raises
        ------
        ValueError
            For a linear model without a disturbance, or a model whose glucose insulin does not lower.
        """
        gut = GutCompartments(time_to_peak_min=self.gut_min)
        model = profiled_model(nominal, linear, gut, nominal_weight_kg)
        return self._of_profiled(model.with_profile(profile), gut, limits, bolus, noise_variance)

    def _of_profiled(
        self,
        model: ProfiledModel,
        gut: GutCompartments,
        limits: DoseLimits,
        bolus: BolusLimits,
        noise_variance: float,
        learning: Learning | None = None,
    ) -> Self:
        """The controller on a model of a person."""
        sample = model.nominal.sample_time_min
        ahead = steps_ahead(model, sample)
        minutes = np.asarray(ahead.step.minutes)
        controller: Self = self.made(
            model=model,
            filter=FedFilter(
                gut=gut,
                step=model.step_of(sample),
                meal_noise_mg=MG_PER_G * self.meal_noise_g,
                disturbance_noise_mg_min=self.disturbance_noise_mg_min,
                disturbance_min=self.disturbance_min,
                glucose_noise_mg_min=self.glucose_noise_mg_min,
                counting_error=self.counting_error_pct / 100.0,
                measurement_variance=self.measurement_variance or max(noise_variance, _MIN_VARIANCE),
                sensor_error_mg_dl=self.sensor_error_mg_dl,
                sensor_correlation=CORRELATION ** (sample / SAMPLE_MIN),
                gut_time_error=self.gut_error_pct / 100.0,
                start_error_mg_dl=self.start_error_mg_dl,
                fed=model.fed_states(),
                learning=learning,
            ),
            ahead=ahead,
            costs=OneSided(
                weight=jnp.asarray(minutes),
                straight_beyond=self.straight_beyond_mg_dl,
                below=self.low_weight,
                floor=self.floor_weight,
            ),
            limits=limits,
            bolus=bolus,
            sample_time_min=sample,
        )
        return controller

    def with_profile(self, profile: Profile) -> Self:
        """The same controller for a person, or for people, with a profile."""
        return self.replaced(model=self.model.with_profile(profile))

    def settled(self) -> dict[str, Any]:
        """Gains of insulin and of meals in the person, relative to the nominal person's, and what they come from.

        The factor and the ratio are those that the model believes, which may be more than the profile's.
        """
        return {
            "insulin_gain": self.model.insulin_gain,
            "meal_gain": self.model.meal_gain,
            "believed_correction_mg_dl_U": self.model.correction_mg_dl_U,
            "believed_carb_ratio_g_U": self.model.insulin_gain / self.model.meal_gain * self.model.own_carb_ratio_g_U,
        }

    def init(self, observation: Observation) -> _ProfileMPCState:
        """State of a controller whose person rests under the basal rate."""
        delivered = jnp.clip(
            rate_at_start(observation, self.model.basal_mU_min), self.limits.min_mU_min, self.limits.max_mU_min
        )
        return _ProfileMPCState(
            estimate=self.filter.init(self.model),
            plan_mU_min=jnp.ones(self.ahead.block_min.shape[0]) * self.model.basal_mU_min,
            requested_mU_min=delivered,
            requested_bolus_mU=jnp.zeros_like(delivered),
            to_come=no_meals_to_come(observation),
        )

    def step(self, state: _ProfileMPCState, observation: Observation) -> tuple[_ProfileMPCState, Decision]:
        """Carry the estimate to this sample, correct it by the reading, hear of a meal, plan, and dose."""
        planned = self._planned(state, observation)
        plan, eats, sound = planned.plan_mU_min, planned.eats, planned.sound
        # What the plan wants now and not later is a bolus, if the pump can give one so small.
        at_once = (plan[0] - plan[1]) * self.sample_time_min >= self.bolus.min_mU
        rate = jnp.where((eats | self.automatic_boluses) & at_once, jnp.minimum(plan[0], plan[1]), plan[0])
        decision = decide(jnp.where(sound, rate, jnp.nan), planned.delivered_mU_min, self.limits, planned.known)
        rest = (plan[0] - decision.insulin_mU_min) * self.sample_time_min
        wanted = jnp.clip(jnp.where((eats | self.automatic_boluses) & sound, rest, 0.0), 0.0, self.bolus.max_mU)
        state = _ProfileMPCState(
            estimate=planned.estimate,
            plan_mU_min=plan,
            requested_mU_min=decision.insulin_mU_min,
            requested_bolus_mU=wanted,
            to_come=planned.to_come,
        )
        return state, dataclasses.replace(decision, bolus_mU=wanted)

    def forecast(self, state: _ProfileMPCState, observation: Observation) -> DoseForecast:
        """Forecast over eight hours under the planned rates, the first with its bolus, and the cautious one."""
        planned = self._planned(state, observation)
        estimate, plan = planned.estimate, planned.plan_mU_min
        later, doubted_later = self._later(estimate, planned.to_come)
        now = self.model.glucose_mg_dl(estimate.x)
        rates = self.ahead.of_block @ plan
        return DoseForecast(
            ahead_min=jnp.append(0.0, jnp.cumsum(self.ahead.step.minutes)),
            glucose_mg_dl=jnp.append(now, self._glucose(estimate, later, plan)),
            insulin_mU_min=jnp.append(rates, rates[-1]),
            others_mg_dl={"cautious": jnp.append(now, self._glucose(self._doubted(estimate), doubted_later, plan))},
        )

    def _planned(self, state: _ProfileMPCState, observation: Observation) -> _Planned:
        """Carry the estimate to this sample, correct it by the reading, hear of a meal, and plan."""
        known = is_known(observation)
        delivered = delivered_since(observation, state.requested_mU_min)
        bolus = self._delivered_bolus(state, observation)
        eats = is_eating(observation)
        estimate, to_come, sound = self.estimated(
            state.estimate, state.to_come, observation, delivered + bolus / self.sample_time_min
        )
        fresh = self.init(observation)
        plan = jnp.where(jnp.all(jnp.isfinite(state.plan_mU_min)) & sound, state.plan_mU_min, fresh.plan_mU_min)

        plan = self._plan(estimate, to_come, plan, target_mg_dl(observation), delivered, eats)
        # An estimate may be finite and so far from any person, as after an absurd report of the pump, that no plan is.
        planned = jnp.all(jnp.isfinite(plan))
        estimate = jax.tree.map(lambda present, new: jnp.where(planned, present, new), estimate, fresh.estimate)
        plan = jnp.where(planned, plan, fresh.plan_mU_min)
        return _Planned(known, delivered, estimate, to_come, eats, plan, sound & planned)

    def estimated(
        self,
        estimate: FedEstimate,
        to_come: MealsToCome | None,
        observation: Observation,
        insulin_mU_min: jax.Array,
    ) -> tuple[FedEstimate, MealsToCome | None, jax.Array]:
        """Estimate of this sample, meals to come, and whether the estimate was sound or had to begin again.

        `insulin_mU_min` is all insulin since the last sample, as a rate.
        """
        estimate = self.filter.predict(self.model, estimate, insulin_mU_min)
        estimate = self.filter.update(self.model, estimate, observation.glucose_mg_dl, is_known(observation))
        carbs = jnp.where(is_eating(observation), observation.announced_carbs_g, 0.0)
        to_come, begins = hear(to_come, observation, carbs, self.sample_time_min)
        estimate = self.filter.announce(estimate, with_rescue(begins, observation))

        finite = jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(estimate)])
        sound = jnp.all(finite) & is_of_a_person(self.model.glucose_mg_dl(estimate.x))
        fresh = self.filter.init(self.model)
        return jax.tree.map(lambda present, new: jnp.where(sound, present, new), estimate, fresh), to_come, sound

    def expected(self, estimate: FedEstimate, to_come: MealsToCome | None, plan: jax.Array) -> jax.Array:
        """Glucose ``(p,)`` that is expected at the ends of the steps ahead, under a plan."""
        return self._glucose(estimate, self._later(estimate, to_come)[0], plan)

    def _delivered_bolus(self, state: _ProfileMPCState, observation: Observation) -> jax.Array:
        """Bolus since the last sample: the reported one, or the one asked for if the report is impossible."""
        word, requested = observation.delivered_bolus_mU, state.requested_bolus_mU
        return requested if word is None else jnp.where((word >= 0.0) & (word <= self.bolus.max_mU), word, requested)

    def _later(self, estimate: FedEstimate, to_come: MealsToCome | None) -> tuple[jax.Array | None, jax.Array | None]:
        """Mean appearance ``(p,)`` in the steps ahead of meals that are still to be eaten, expected and cautious."""
        if to_come is None:
            return None, None
        minutes = self.ahead.step.minutes
        ends = jnp.concatenate([jnp.zeros(1), jnp.cumsum(minutes)])
        eaten_for = jnp.maximum(ends[:, None] - to_come.in_min, 0.0)
        appeared = self.filter.gut_of(estimate).appeared(eaten_for) @ (MG_PER_G * to_come.carbs_g)
        flux: jax.Array = jnp.diff(appeared) / minutes
        sure = jnp.maximum(1.0 - self.doubt * self.filter.counting_error, 0.0)
        return flux, sure * flux

    def _glucose(self, estimate: FedEstimate, later_mg_min: jax.Array | None, plan: jax.Array) -> jax.Array:
        """Glucose ``(p,)`` at the ends of the steps ahead, under a plan, with the appearance of meals to come."""
        gut, fading = self.filter.gut_of(estimate), self.filter.disturbance_min
        meal_gain = self.filter.meal_gain_of(self.model, estimate)

        def one(carry: Any, entry: Any) -> Any:
            x, content, disturbance = carry
            step, in_block, later = entry
            h = step.minutes
            left = jnp.exp(-h / fading)
            appears = gut.appearance_mg_min(content, h)
            flux = meal_gain * (appears if later is None else appears + later)
            flux = flux + disturbance * (1.0 - left) * (fading / h)
            x = self.model.advance(x, in_block @ plan, flux, step)
            return (x, gut.after(content, h), left * disturbance), self.model.glucose_mg_dl(x)

        start = estimate.x, estimate.gut_mg, estimate.disturbance_mg_min
        glucose: jax.Array = jax.lax.scan(one, start, (self.ahead.step, self.ahead.of_block, later_mg_min))[1]
        return glucose

    def _doubted(self, estimate: FedEstimate) -> FedEstimate:
        """The estimate without what is uncertain of meals and of what no meal explains."""
        content = jnp.sum(estimate.gut_mg)
        there = jnp.maximum(content - self.doubt * estimate.gut_error_mg, 0.0) / jnp.maximum(content, 1e-6)
        gut = estimate.gut_mg * jnp.where(content > 0.0, there, 1.0)
        disturbance = estimate.disturbance_mg_min
        disturbance = disturbance - self.disturbance_doubt * jnp.maximum(disturbance, 0.0)
        return dataclasses.replace(estimate, gut_mg=gut, disturbance_mg_min=disturbance)

    def _plan(
        self,
        estimate: FedEstimate,
        to_come: MealsToCome | None,
        plan: jax.Array,
        setpoint: jax.Array,
        delivered: jax.Array,
        eats: jax.Array,
    ) -> jax.Array:
        """Rates ``(m,)`` of the blocks, the first of which takes a bolus with a meal."""
        doubted, basal = self._doubted(estimate), self.model.basal_mU_min
        later, doubted_later = self._later(estimate, to_come)
        blocks = self.ahead.block_min
        change, highest, lowest = self.limits.max_change_mU_min, self.limits.max_mU_min, self.limits.min_mU_min
        up = jnp.where(
            eats | self.automatic_boluses,
            highest + self.bolus.max_mU / self.sample_time_min,
            jnp.minimum(delivered + change, highest),
        )
        others = jnp.zeros_like(plan)[1:]
        least = jnp.append(jnp.maximum(delivered - change, lowest), others + lowest)
        most = jnp.append(up, others + highest)
        # a bolus for a meal costs nothing by its size
        first = jnp.where(eats, 0.0, self.bolus_weight if self.automatic_boluses else self.move_weight)
        effect_mg_dl_mU = self.model.correction_mg_dl_U / MU_PER_U
        preference = effect_mg_dl_mU**2 * blocks * jnp.append(first, others + self.move_weight)

        def expected(plan: jax.Array) -> tuple[jax.Array, jax.Array]:
            glucose = self._glucose(estimate, later, plan)
            return glucose, glucose

        for _ in range(_ITERATIONS):
            A, likely = jax.jacfwd(expected, has_aux=True)(plan)
            A = jnp.minimum(A, 0.0)  # insulin never raises glucose, whatever a forecast far from any person says
            careful = self._glucose(doubted, doubted_later, plan)
            plan = minimise_rates(
                self.costs,
                likely - setpoint,
                careful - jnp.minimum(self.glucose_floor_mg_dl, setpoint),
                A,
                plan,
                jnp.zeros_like(plan) + basal,
                preference,
                least,
                most,
            )
        return plan


def steps_ahead(model: ProfiledModel, sample_time_min: float) -> _ForecastSteps:
    """Steps over blocks that end with samples."""
    ends = [0.0]
    for wanted in (sample_time_min, *_BLOCK_ENDS_MIN):
        end = round(wanted / sample_time_min) * sample_time_min
        if end > ends[-1]:
            ends.append(end)
    lengths, of_block = [], []
    for block, (start, end) in enumerate(itertools.pairwise(ends)):
        longest = next(step for until, step in _STEPS_MIN if end <= until)
        number = math.ceil((end - start) / longest - 1e-9)
        lengths += [(end - start) / number] * number
        of_block += [block] * number
    return _ForecastSteps(
        step=model.steps_of(lengths),
        of_block=jnp.asarray(np.eye(len(ends) - 1)[of_block]),
        block_min=jnp.asarray(np.diff(ends)),
    )
