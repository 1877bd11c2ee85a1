"""The glucose and insulin balances of Hovorka et al., for a person with type 1 diabetes, and their steady states.

Insulin is infused under the skin, passes two depots, and reaches plasma, from where it acts on glucose in three ways:
on transport into tissue (x1), on disposal there (x2) and on production by the liver (x3). Glucose is held in an
accessible compartment, which contains plasma, and a non-accessible one; the interstitial space, where sensors measure,
follows plasma with a delay. Meals enter as the rate at which glucose appears; the gut is a model of its own.

Two laws differ between the publications: the uptake of glucose that needs no insulin, and how insulin suppresses the
production by the liver. A record of constants holds its own two laws, and how glucose and insulin rest under them:
`HovorkaParameters` those of 2004, `wilinska.WilinskaParameters` those of 2010. All else is the same.

Amounts of glucose are in mmol, concentrations in mmol/l; amounts of insulin in mU, concentrations in mU/l; time in min.
Glucose in mg/dl, and meals in mg/min, are converted here, at the border.

Two points in which published implementations of the model of 2004 differ:

- The renal excretion is ``0.003 (G - 9) V_G`` as in the paper; one implementation in circulation lacks the volume.
- Production by the liver, ``EGP_0 (1 - x3)``, is kept at 0 or above. The paper lets it become negative.

At steady state insulin and its effects are in proportion to the infusion. With them the glucose which a rate holds is a
closed form, by pieces. Conversely, at a given glucose the balance is an equation in plasma insulin::

    (EGP(S_IE I) - L(G)) (k_12 + S_ID I) - Q1 S_IT S_ID I^2 = 0

where L is what leaves without insulin, ``F_01^c + F_R``. Production falls as insulin rises, so there is one root of 0
or more where production without insulin is at least that loss, and none otherwise. Each record of constants has both.

References
----------
R. Hovorka, V. Canonico, L. J. Chassin, U. Haueter, M. Massi-Benedetti, M. Orsini Federici, T. R. Pieber,
H. C. Schaller, L. Schaupp, T. Vering, M. E. Wilinska, "Nonlinear model predictive control of glucose
concentration in subjects with type 1 diabetes", Physiol. Meas. 25(4), 2004, 905-920.
D. Boiroux, A. K. Duun-Henriksen, S. Schmidt, K. Nørgaard, N. K. Poulsen, H. Madsen, J. B. Jørgensen, "Adaptive control
in an artificial pancreas for people with type 1 diabetes", Control Eng. Pract. 58, 2017 (the interstitial space).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Final

from glucoloop._lazy_jax import jax, jit, jnp
from glucoloop._pytree import pytree
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.resting import shape_of_people

STATE_NAMES: Final = (
    *("Q1", "Q2"),  # mmol
    "IG",  # mmol/l
    *("S1", "S2"),  # mU
    "I",  # mU/l
    *("x1", "x2", "x3"),  # 1/min, 1/min, 1
)
GLUCOSE: Final = slice(0, 3)
INSULIN: Final = slice(3, 9)

GLUCOSE_G_MOL: Final = 180.16
"""Molar mass of glucose as implementations of this model round it, so that results can be compared digit by digit."""
MG_PER_MMOL: Final = GLUCOSE_G_MOL
MG_DL_PER_MMOL_L: Final = GLUCOSE_G_MOL / 10.0


@pytree
class HovorkaConstants:
    """The constants that all publications share; scalars for one person, arrays `(people,)` for a cohort.

    Volumes, production and uptake are per kg of body weight, as the papers give them. The two constants of the gut,
    `A_G` and `t_maxG`, are among a person's constants but enter the person's meal model, not the balances.
    `hovorka2004` and `wilinska` hold published sets with the unit, meaning and provenance of every value.
    """

    weight_kg: jax.Array | float
    # insulin
    t_maxI: jax.Array | float
    k_e: jax.Array | float
    V_I: jax.Array | float
    k_a1: jax.Array | float
    k_a2: jax.Array | float
    k_a3: jax.Array | float
    S_IT: jax.Array | float
    S_ID: jax.Array | float
    S_IE: jax.Array | float
    # glucose
    V_G: jax.Array | float
    k_12: jax.Array | float
    EGP_0: jax.Array | float
    F_01: jax.Array | float
    renal_threshold: jax.Array | float
    renal_clearance: jax.Array | float
    t_IG: jax.Array | float
    # gut
    A_G: jax.Array | float
    t_maxG: jax.Array | float

    @property
    def glucose_volume_l(self) -> jax.Array | float:
        """Glucose volume V_G of the whole person."""
        return self.V_G * self.weight_kg

    @property
    def insulin_volume_l(self) -> jax.Array | float:
        """Insulin volume V_I of the whole person."""
        return self.V_I * self.weight_kg

    @property
    def production_without_insulin(self) -> jax.Array | float:
        """Production by the liver without insulin, mmol/min."""
        return self.EGP_0 * self.weight_kg

    @abstractmethod
    def uptake_without_insulin(self, G: jax.Array) -> jax.Array:
        """F_01^c, uptake of brain and other tissue that needs no insulin, mmol/min, at a glucose in mmol/l."""

    @abstractmethod
    def hepatic_production(self, x3: jax.Array) -> jax.Array:
        """EGP, glucose made by the liver, mmol/min."""

    @abstractmethod
    def glucose_at_rest(self, made: jax.Array, disposal: jax.Array) -> jax.Array:
        """Q1 at steady state [mmol], for a production [mmol/min] and what insulin disposes of per Q1 [1/min]."""

    @abstractmethod
    def insulin_at_rest(self, Q1: jax.Array, loss: jax.Array) -> jax.Array:
        """Plasma insulin [mU/l] at which Q1 [mmol] rests; `loss` is what leaves without insulin, at most production."""

    @abstractmethod
    def infusion_without_production_mU_min(self) -> jax.Array:
        """Minimum constant infusion under which the liver ends up making no glucose, so that glucose falls to zero."""


@pytree
class HovorkaParameters(HovorkaConstants):
    """The constants of Hovorka et al. (2004).

    The uptake that needs no insulin is F_01 above a threshold of glucose and in proportion to glucose below it;
    production falls in a straight line with the effect of insulin, ``EGP_0 (1 - x3)``, to 0 where x3 is 1.
    """

    uptake_threshold: jax.Array | float
    """Glucose below which `F_01` falls in proportion, mmol/l."""

    def uptake_without_insulin(self, G: jax.Array) -> jax.Array:
        """Uptake that needs no insulin, F_01^c, mmol/min."""
        return self.F_01 * self.weight_kg * jnp.minimum(G / self.uptake_threshold, 1.0)

    def hepatic_production(self, x3: jax.Array) -> jax.Array:
        """EGP, mmol/min; 0 where insulin suppresses it fully."""
        return self.EGP_0 * self.weight_kg * jnp.maximum(1.0 - x3, 0.0)

    def glucose_at_rest(self, made: jax.Array, disposal: jax.Array) -> jax.Array:
        """Q1 at steady state: the balance is linear below, between and above the two thresholds."""
        V_G, uptake, k_R = self.glucose_volume_l, self.F_01 * self.weight_kg, self.renal_clearance
        scarce = made / (uptake / (self.uptake_threshold * V_G) + disposal)
        plentiful = (made - uptake + k_R * self.renal_threshold * V_G) / (k_R + disposal)
        disposed = disposal > 0.0
        between = (made - uptake) / jnp.where(disposed, disposal, 1.0)
        excreting = plentiful >= self.renal_threshold * V_G
        return jnp.where(scarce <= self.uptake_threshold * V_G, scarce, jnp.where(excreting, plentiful, between))

    def insulin_at_rest(self, Q1: jax.Array, loss: jax.Array) -> jax.Array:
        """Plasma insulin at which Q1 rests: the root of 0 or more of ``a I^2 + b I - c = 0``, without cancellation.

        At the root ``1 - S_IE I`` is positive, so production need not be kept at 0 or above there.
        """
        E = self.production_without_insulin
        surplus = jnp.maximum(E - loss, 0.0)
        a = self.S_ID * (Q1 * self.S_IT + E * self.S_IE)
        b = E * self.k_12 * self.S_IE - surplus * self.S_ID
        c = surplus * self.k_12
        root = jnp.sqrt(b * b + 4.0 * a * c)
        return jnp.where(b > 0.0, 2.0 * c / (jnp.abs(b) + root), (jnp.abs(b) + root) / (2.0 * a))

    def infusion_without_production_mU_min(self) -> jax.Array:
        """Infusion under which x3 rests at 1."""
        return jnp.asarray(self.k_e * self.insulin_volume_l / self.S_IE)


def renal_excretion(p: HovorkaConstants, G: jax.Array) -> jax.Array:
    """F_R, glucose lost in urine, mmol/min, at a glucose in mmol/l."""
    return p.renal_clearance * p.glucose_volume_l * jnp.maximum(G - p.renal_threshold, 0.0)


def insulin_balances(p: HovorkaConstants, z: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
    """Rates of change per minute of S1, S2, I, x1, x2, x3: linear, closed in themselves; S1 takes the insulin."""
    S1, S2, I, x1, x2, x3 = z
    return jnp.stack(
        [
            insulin_mU_min - S1 / p.t_maxI,
            (S1 - S2) / p.t_maxI,
            S2 / (p.t_maxI * p.insulin_volume_l) - p.k_e * I,
            p.k_a1 * (p.S_IT * I - x1),
            p.k_a2 * (p.S_ID * I - x2),
            p.k_a3 * (p.S_IE * I - x3),
        ]
    )


def glucose_transport(p: HovorkaConstants, y: jax.Array) -> jax.Array:
    """Rates of change per minute of Q1, Q2, IG by glucose that moves without insulin: linear in y."""
    Q1, Q2, IG = y
    back = p.k_12 * Q2
    return jnp.stack([back, -back, (Q1 / p.glucose_volume_l - IG) / p.t_IG])


def glucose_kinetics(p: HovorkaConstants, y: jax.Array, effects: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
    """Production, uptake, excretion and intake of glucose, and transport by insulin: the rest of the balances.

    The effects are x1, x2, x3. Meals appear in plasma.
    """
    Q1, Q2, _ = y
    x1, x2, x3 = effects
    G = Q1 / p.glucose_volume_l
    into_tissue = x1 * Q1
    appearing = meal_mg_min / MG_PER_MMOL + p.hepatic_production(x3)
    Q1_change = appearing - p.uptake_without_insulin(G) - renal_excretion(p, G) - into_tissue
    return jnp.stack([Q1_change, into_tissue - x2 * Q2, jnp.zeros_like(Q1_change)])


def plasma_glucose_mg_dl(p: HovorkaConstants, x: jax.Array) -> jax.Array:
    """Glucose in plasma, G."""
    return x[0] / p.glucose_volume_l * MG_DL_PER_MMOL_L


def interstitial_glucose_mg_dl(x: jax.Array) -> jax.Array:
    """Glucose in the interstitial space, IG."""
    return x[2] * MG_DL_PER_MMOL_L


def derivative(p: HovorkaConstants, x: jax.Array, inputs: Inputs) -> jax.Array:
    """Right-hand side of the model, per minute, for a state ``(9, ...)`` in the order of `STATE_NAMES`."""
    y, z = x[GLUCOSE], x[INSULIN]
    glucose = glucose_transport(p, y) + glucose_kinetics(p, y, z[3:], inputs.meal_mg_min)
    return jnp.concatenate([glucose, insulin_balances(p, z, inputs.insulin_mU_min)])


_ROUNDING: Final = 1e-12
"""Fraction of production by which it may seem to fall short of the loss where a person rests without insulin."""


def _insulin_at_rest(p: HovorkaConstants, insulin_mU_min: jax.Array) -> jax.Array:
    """S1, S2, I, x1, x2, x3 `(6, ...)` under a constant infusion."""
    depot = insulin_mU_min * p.t_maxI
    I = insulin_mU_min / (p.k_e * p.insulin_volume_l)
    return jnp.stack(jnp.broadcast_arrays(depot, depot, I, p.S_IT * I, p.S_ID * I, p.S_IE * I))


def _state(p: HovorkaConstants, Q1: jax.Array, insulin: jax.Array) -> jax.Array:
    """Steady state, with Q1 and insulin at steady state."""
    Q2 = insulin[3] * Q1 / (p.k_12 + insulin[4])
    return jnp.concatenate([jnp.stack([Q1, Q2, Q1 / p.glucose_volume_l]), insulin])


@jit()
def rest_under(p: HovorkaConstants, insulin_mU_min: jax.Array) -> jax.Array:
    """Steady state `(9, ...)` under a constant infusion `(...)` of 0 or more."""
    u = jnp.broadcast_to(jnp.asarray(insulin_mU_min, float), shape_of_people(p, insulin_mU_min))
    insulin = _insulin_at_rest(p, u)
    x1, x2, x3 = insulin[3:]
    return _state(p, p.glucose_at_rest(p.hepatic_production(x3), x1 * x2 / (p.k_12 + x2)), insulin)


@jit()
def infusion_for(p: HovorkaConstants, glucose_mg_dl: jax.Array) -> jax.Array:
    """Constant infusion `(...)` in mU/min under which plasma glucose rests at the given value, or NaN."""
    shape = shape_of_people(p, glucose_mg_dl)
    G = jnp.broadcast_to(jnp.asarray(glucose_mg_dl, float), shape) / MG_DL_PER_MMOL_L
    E, loss = p.production_without_insulin, p.uptake_without_insulin(G) + renal_excretion(p, G)
    possible = (G > 0.0) & (E - loss >= -_ROUNDING * E)
    I = p.insulin_at_rest(jnp.where(possible, G, 1.0) * p.glucose_volume_l, jnp.where(possible, loss, E))
    return jnp.where(possible, p.k_e * p.insulin_volume_l * I, jnp.nan)


@jit()
def rest_at(p: HovorkaConstants, glucose_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Constant infusion `(...)` under which plasma glucose rests at the given value, and the state `(9, ...)` there.

    Both are NaN where no infusion of 0 or more does.
    """
    u: jax.Array = infusion_for(p, glucose_mg_dl)
    Q1 = jnp.asarray(glucose_mg_dl, float) / MG_DL_PER_MMOL_L * p.glucose_volume_l + 0.0 * u
    return u, _state(p, Q1, _insulin_at_rest(p, u))


def glucose_without_insulin_mg_dl(p: HovorkaConstants) -> jax.Array:
    """Plasma glucose `(...)` at steady state without insulin: the highest that an infusion can hold."""
    x: jax.Array = rest_under(p, jnp.asarray(0.0))
    return x[2] * MG_DL_PER_MMOL_L
