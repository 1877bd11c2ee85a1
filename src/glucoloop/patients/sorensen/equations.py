"""The 19-state diabetic patient of Sorensen (1985), as Parker, Doyle and Peppas (1999) use it.

Mass balances around the organs: glucose in eight spaces, insulin in seven, two slow effects of insulin
on the liver, glucagon and its slow effect. A prime in a comment is a derivative by time in minutes;
symbols are those of the papers: B brain, H heart and lungs, G gut, L liver, K kidney, P periphery;
V vascular, I interstitial; A hepatic artery.

References
----------
J. T. Sorensen, "A physiologic model of glucose metabolism in man and its use to design and assess
improved insulin therapies for diabetes", Sc.D. thesis, MIT, 1985.
R. S. Parker, F. J. Doyle III, N. A. Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999, Sec. II.
R. S. Parker, F. J. Doyle III, J. H. Ward, N. A. Peppas, AIChE J. 46(12), 2000.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.patients.protocol import Inputs
from glucoloop.units import PG_ML_PER_UG_L

STATE_NAMES: Final = (
    *("G_BV", "G_BI", "G_H", "G_G", "G_L", "G_K", "G_PV", "G_PI"),  # mg/dl
    *("I_B", "I_H", "I_G", "I_L", "I_K", "I_PV", "I_PI"),  # mU/l
    *("A_IHGP", "A_IHGU", "N", "A_NHGP"),  # normalised
)
GLUCOSE: Final = slice(0, 8)
INSULIN: Final = slice(8, 15)
REGULATION: Final = slice(15, 19)
REGULATED: Final = len(STATE_NAMES[GLUCOSE]) + len(STATE_NAMES[REGULATION])
"""States of the slow block: glucose and regulation."""
ARTERIAL_GLUCOSE: Final = STATE_NAMES.index("G_H")
GLUCAGON: Final = STATE_NAMES.index("N")


@pytree
class Sigmoid:
    """``offset + scale tanh(slope (x - inflection))``: every saturating effect of the model."""

    offset: jax.Array | float
    scale: jax.Array | float
    slope: jax.Array | float
    inflection: jax.Array | float

    def __call__(self, x: jax.Array) -> jax.Array:
        """Value of the sigmoid at x, elementwise."""
        return self.offset + self.scale * jnp.tanh(self.slope * (x - self.inflection))


@pytree
class SorensenParameters:
    """The constants of the model; scalars for one person, arrays `(people,)` for a cohort.

    Units: glucose volumes dl, flows dl/min, rates mg/min; insulin volumes l, flows l/min; glucagon pg/ml, its volume l;
    times min.
    `glucoloop.patients.sorensen.parker1999` holds the published set with the provenance of every value.
    """

    # glucose transport
    q_B: jax.Array | float
    q_A: jax.Array | float
    q_G: jax.Array | float
    q_L: jax.Array | float
    q_K: jax.Array | float
    q_P: jax.Array | float
    v_BV: jax.Array | float
    v_BI: jax.Array | float
    v_H: jax.Array | float
    v_G: jax.Array | float
    v_L: jax.Array | float
    v_K: jax.Array | float
    v_PV: jax.Array | float
    v_PI: jax.Array | float
    T_B: jax.Array | float
    T_P: jax.Array | float
    # insulin transport and clearance
    Q_B: jax.Array | float
    Q_A: jax.Array | float
    Q_G: jax.Array | float
    Q_L: jax.Array | float
    Q_K: jax.Array | float
    Q_P: jax.Array | float
    V_B: jax.Array | float
    V_H: jax.Array | float
    V_G: jax.Array | float
    V_L: jax.Array | float
    V_K: jax.Array | float
    V_PV: jax.Array | float
    V_PI: jax.Array | float
    T_PI: jax.Array | float
    F_LC: jax.Array | float
    F_KC: jax.Array | float
    F_PC: jax.Array | float
    # constant uptakes and basal rates
    brain_uptake: jax.Array | float
    red_cell_uptake: jax.Array | float
    gut_uptake: jax.Array | float
    basal_hepatic_production: jax.Array | float
    basal_hepatic_uptake: jax.Array | float
    basal_peripheral_uptake: jax.Array | float
    # concentrations of the healthy basal state, by which the effects are normalised
    ref_G_H: jax.Array | float
    ref_G_L: jax.Array | float
    ref_G_PI: jax.Array | float
    ref_I_H: jax.Array | float
    ref_I_L: jax.Array | float
    ref_I_PI: jax.Array | float
    ref_N: jax.Array | float
    # effects: insulin or glucose (first letter) on a rate
    M_IHGP: Sigmoid
    M_IHGU: Sigmoid
    M_GHGP: Sigmoid
    M_GHGU: Sigmoid
    M_IPGU: Sigmoid
    M_NHGP: Sigmoid
    M_IPNR: Sigmoid
    M_GPNR: Sigmoid
    tau_I: jax.Array | float
    tau_N: jax.Array | float
    k_N: jax.Array | float
    V_N: jax.Array | float
    # renal excretion, mg/min, below and above the threshold of kidney glucose
    excretion: Sigmoid
    excretion_threshold: jax.Array | float
    excretion_offset: jax.Array | float
    excretion_clearance: jax.Array | float

    @property
    def q_H(self) -> jax.Array | float:
        """Glucose flow through heart and lungs, dl/min."""
        return self.q_B + self.q_L + self.q_K + self.q_P

    @property
    def Q_H(self) -> jax.Array | float:
        """Insulin flow through heart and lungs, l/min."""
        return self.Q_B + self.Q_L + self.Q_K + self.Q_P

    @property
    def peripheral_clearance(self) -> jax.Array | float:
        """Interstitial insulin clearance PIC / I_PI, l/min."""
        return 1.0 / ((1.0 - self.F_PC) / (self.F_PC * self.Q_P) - self.T_PI / self.V_PI)


def renal_excretion(p: SorensenParameters, G_K: jax.Array) -> jax.Array:
    """Glucose lost in urine, mg/min."""
    spill = p.excretion_offset + p.excretion_clearance * G_K
    return jnp.where(G_K < p.excretion_threshold, p.excretion(G_K), spill)


def _peripheral_uptake(p: SorensenParameters, G_PI: jax.Array, insulin_effect: jax.Array) -> jax.Array:
    """Glucose taken up by muscle and fat, mg/min."""
    return p.basal_peripheral_uptake * (G_PI / p.ref_G_PI) * insulin_effect


def lowest_valid_glucose(p: SorensenParameters) -> jax.Array | float:
    """Arterial glucose below which the balances contradict themselves, mg/dl.

    The brain takes glucose up at a constant rate, out of an interstitial space that at steady state holds::

        G_BI = G_H - r_BGU (1 / q_B + T_B / v_BI)

    At the arterial glucose that is returned it holds none, 44.5 mg/dl for the constants of Parker et al. (1999). Below,
    the model takes up glucose that is not there. A person would take up less, and lose consciousness: such a value
    means severe hypoglycemia, and its depth means nothing.
    """
    return p.brain_uptake * (1.0 / p.q_B + p.T_B / p.v_BI)


def hepatic_balance(
    p: SorensenParameters, G_L: jax.Array, A_IHGP: jax.Array, A_IHGU: jax.Array, N: jax.Array, A_NHGP: jax.Array
) -> jax.Array:
    """Glucose made less glucose taken up by the liver, HGP - HGU, mg/min."""
    g_L = G_L / p.ref_G_L
    HGP = p.basal_hepatic_production * A_IHGP * (p.M_NHGP(N) - A_NHGP) * p.M_GHGP(g_L)
    HGU = p.basal_hepatic_uptake * A_IHGU * p.M_GHGU(g_L)
    return HGP - HGU


def insulin_balances(p: SorensenParameters, insulin: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
    """Rates of change [mU/l/min] of I_B .. I_PI: linear, and closed in themselves; insulin enters heart and lungs."""
    I_B, I_H, I_G, I_L, I_K, I_PV, I_PI = insulin
    u = insulin_mU_min
    PIC = I_PI * p.peripheral_clearance
    return jnp.stack(
        [
            p.Q_B * (I_H - I_B) / p.V_B,
            (p.Q_B * I_B + p.Q_L * I_L + p.Q_K * I_K + p.Q_P * I_PV - p.Q_H * I_H + u) / p.V_H,
            p.Q_G * (I_H - I_G) / p.V_G,
            ((1.0 - p.F_LC) * (p.Q_A * I_H + p.Q_G * I_G) - p.Q_L * I_L) / p.V_L,
            (p.Q_K * (I_H - I_K) - p.F_KC * p.Q_K * I_H) / p.V_K,
            p.Q_P * (I_H - I_PV) / p.V_PV - (I_PV - I_PI) * p.V_PI / (p.T_PI * p.V_PV),
            (I_PV - I_PI) / p.T_PI - PIC / p.V_PI,
        ]
    )


def insulin_effects(p: SorensenParameters, insulin: jax.Array) -> jax.Array:
    """Effects ``(4, ...)`` of insulin on hepatic production, hepatic uptake, peripheral uptake and glucagon release."""
    _, I_H, _, I_L, _, _, I_PI = insulin
    return jnp.stack(
        [
            p.M_IHGP(I_L / p.ref_I_L),
            p.M_IHGU(I_L / p.ref_I_L),
            p.M_IPGU(I_PI / p.ref_I_PI),
            p.M_IPNR(I_H / p.ref_I_H),
        ]
    )


def glucose_transport(p: SorensenParameters, y: jax.Array) -> jax.Array:
    """Transport by blood and across capillaries, and decay of the regulation: rates per minute, linear in y.

    The slow block ``(12, ...)`` is G_BV .. G_PI, A_IHGP, A_IHGU, N, A_NHGP.
    """
    G_BV, G_BI, G_H, G_G, G_L, G_K, G_PV, G_PI, A_IHGP, A_IHGU, N, A_NHGP = y
    return jnp.stack(
        [
            p.q_B * (G_H - G_BV) / p.v_BV - (G_BV - G_BI) * p.v_BI / (p.T_B * p.v_BV),
            (G_BV - G_BI) / p.T_B,
            (p.q_B * G_BV + p.q_L * G_L + p.q_K * G_K + p.q_P * G_PV - p.q_H * G_H) / p.v_H,
            p.q_G * (G_H - G_G) / p.v_G,
            (p.q_A * G_H + p.q_G * G_G - p.q_L * G_L) / p.v_L,
            p.q_K * (G_H - G_K) / p.v_K,
            p.q_P * (G_H - G_PV) / p.v_PV - (G_PV - G_PI) * p.v_PI / (p.T_P * p.v_PV),
            (G_PV - G_PI) / p.T_P,
            -A_IHGP / p.tau_I,
            -A_IHGU / p.tau_I,
            -p.k_N * N,
            -A_NHGP / p.tau_N,
        ]
    )


def glucose_kinetics(p: SorensenParameters, y: jax.Array, effects: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
    """Production, uptake and intake of glucose, and the drives of its regulation: the rest of the balances, per minute.

    The effects ``(4, ...)`` are those of `insulin_effects`. Meals appear in the gut.
    """
    _, _, G_H, _, G_L, G_K, _, G_PI, A_IHGP, A_IHGU, N, A_NHGP = y
    on_production, on_uptake, on_periphery, on_glucagon = effects
    none = jnp.zeros_like(G_H)
    return jnp.stack(
        [
            none,
            none - p.brain_uptake / p.v_BI,
            none - p.red_cell_uptake / p.v_H,
            (meal_mg_min - p.gut_uptake) / p.v_G + none,
            hepatic_balance(p, G_L, A_IHGP, A_IHGU, N, A_NHGP) / p.v_L,
            -renal_excretion(p, G_K) / p.v_K,
            none,
            -_peripheral_uptake(p, G_PI, on_periphery) / p.v_PI,
            on_production / p.tau_I + none,
            on_uptake / p.tau_I + none,
            p.k_N * on_glucagon * p.M_GPNR(G_H / p.ref_G_H),
            (p.M_NHGP(N) - 1.0) / (2.0 * p.tau_N),
        ]
    )


def glucose_balances(p: SorensenParameters, y: jax.Array, effects: jax.Array, meal_mg_min: jax.Array) -> jax.Array:
    """Glucose and regulation equations, given the effects of insulin; arguments as for `glucose_kinetics`."""
    return glucose_transport(p, y) + glucose_kinetics(p, y, effects, meal_mg_min)


def split(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """State `(19, ...)` to glucose and regulation `(12, ...)`, and insulin `(7, ...)`."""
    return jnp.concatenate([x[GLUCOSE], x[REGULATION]]), x[INSULIN]


def join(y: jax.Array, insulin: jax.Array) -> jax.Array:
    """Glucose and regulation `(12, ...)`, and insulin `(7, ...)`, to the state `(19, ...)`."""
    return jnp.concatenate([y[GLUCOSE], insulin, y[GLUCOSE.stop :]])


def derivative(p: SorensenParameters, x: jax.Array, inputs: Inputs) -> jax.Array:
    """Right-hand side of the model, per minute, for a state ``(19, ...)`` in the order of `STATE_NAMES`.

    Glucagon that is infused enters the one space that it has, ``V_N N' = ... + u_N / ref_N``; 1 ug/l is 1000 pg/ml.
    """
    y, insulin = split(x)
    rates = join(
        glucose_balances(p, y, insulin_effects(p, insulin), inputs.meal_mg_min),
        insulin_balances(p, insulin, inputs.insulin_mU_min),
    )
    if inputs.glucagon_ug_min is None:
        return rates
    infused = PG_ML_PER_UG_L * inputs.glucagon_ug_min / (p.V_N * p.ref_N)
    return jnp.concatenate([rates[:GLUCAGON], (rates[GLUCAGON] + infused)[None], rates[GLUCAGON + 1 :]])
