"""Model of Wilinska et al. (2010), the Cambridge simulator: two laws that differ from the model of 2004, and constants.

The uptake that needs no insulin saturates with glucose, and production by the liver falls exponentially with the effect
of insulin, so that it never stops::

    F_01^c = F_01 / 0.85 * G / (G + 1 mmol/l),    EGP = EGP_0 exp(-x3)

What is known of the paper here are two restatements in code: the artificial pancreas simulator of the McGill Diabetes
Lab, which also gives the volume of glucose and the bioavailability, and tir-tuner, which also gives the distributions.
They agree on every constant but the volume of glucose and the bioavailability, and on the uptake; tir-tuner takes 0.15
l/kg, the median of the distribution of that volume, and a bioavailability of 1. They say that the paper prints the
production as ``EGP_0 [1 + x3]``, which rises with insulin and must be a misprint; one reads it as the exponential
above, which is taken here, since both describe EGP_0 as the production extrapolated to no insulin. Neither has the
second channel of absorption that an earlier model of the same group has: insulin passes two depots in a row, as in
2004. The constants are those of the paper's Tables 1 and 2 for a person of 74.9 kg.

Not known from them, and so not here: the distributions of the three sensitivities to insulin, of k_12, k_a1 to k_a3,
EGP_0 and F_01; the way in which a ceiling on the appearance of glucose from the gut, of 0.02 to 0.035 mmol/kg/min, acts
on what a meal holds; and the oscillations of constants within a person.

References
----------
M. E. Wilinska, L. J. Chassin, C. L. Acerini, J. M. Allen, D. B. Dunger, R. Hovorka, "Simulation environment to evaluate
closed-loop insulin delivery systems in type 1 diabetes", J. Diabetes Sci. Technol. 4(1), 2010, 132-144.
"""

from __future__ import annotations

import math
from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.patients.component import Constant
from glucoloop.patients.hovorka.equations import HovorkaConstants
from glucoloop.patients.hovorka.varying import Lognormal, Normal, Uniform

_STEPS: Final = 60
"""Newton steps, which double the correct digits once they are near; far off they halve the distance or do better."""


@pytree
class WilinskaParameters(HovorkaConstants):
    """The constants of Wilinska et al. (2010)."""

    uptake_half: jax.Array | float
    """Glucose at which the uptake that needs no insulin is half of its maximum, mmol/l."""
    uptake_share: jax.Array | float
    """Share that `F_01` is of the maximum uptake."""

    @property
    def greatest_uptake(self) -> jax.Array | float:
        """Uptake that needs no insulin, at high glucose, mmol/min."""
        return self.F_01 * self.weight_kg / self.uptake_share

    def uptake_without_insulin(self, G: jax.Array) -> jax.Array:
        """Uptake that needs no insulin, F_01^c, mmol/min."""
        return self.greatest_uptake * G / (G + self.uptake_half)

    def hepatic_production(self, x3: jax.Array) -> jax.Array:
        """Production by the liver, EGP, mmol/min."""
        return self.EGP_0 * self.weight_kg * jnp.exp(-x3)

    def glucose_at_rest(self, made: jax.Array, disposal: jax.Array) -> jax.Array:
        """Q1 at steady state: the balance is one quadratic in glucose below the renal threshold and another above."""
        V_G, k_R, threshold = self.glucose_volume_l, self.renal_clearance, self.renal_threshold
        sparing = self._glucose(made, disposal * V_G)
        excreting = self._glucose(made + k_R * V_G * threshold, (disposal + k_R) * V_G)
        return jnp.where(excreting >= threshold, excreting, sparing) * V_G

    def _glucose(self, made: jax.Array, per_glucose: jax.Array) -> jax.Array:
        """Root above 0 of ``made = greatest uptake * G / (G + half) + per_glucose * G``, mmol/l; any number if none."""
        b, c = self.greatest_uptake + per_glucose * self.uptake_half - made, made * self.uptake_half
        root = jnp.sqrt(b * b + 4.0 * per_glucose * c)
        falling, some = b > 0.0, per_glucose > 0.0
        of_rising = (jnp.abs(b) + root) / jnp.where(some, 2.0 * per_glucose, 1.0)
        return jnp.where(falling, 2.0 * c / jnp.where(falling, b + root, 1.0), of_rising)

    def insulin_at_rest(self, Q1: jax.Array, loss: jax.Array) -> jax.Array:
        """Plasma insulin at which Q1 rests.

        There is no closed form. The balance divided by ``exp(-S_IE I)`` is::

            (L + Q1 S_IT S_ID I^2 / (k_12 + S_ID I)) exp(S_IE I) = EGP_0

        whose left side is a product of rising convex functions, so rising and convex: from where it is at least EGP_0,
        as at ``log(EGP_0 / L) / S_IE``, Newton's method comes down to the root without passing it.
        """
        E = self.production_without_insulin
        s, k, d = self.S_IE, self.k_12, self.S_ID
        most = jnp.log(jnp.maximum(E / loss, 1.0)) / s

        def nearer(_: int, I: jax.Array) -> jax.Array:
            disposed = Q1 * self.S_IT * d * I * I / (k + d * I)
            slope = Q1 * self.S_IT * d * I * (2.0 * k + d * I) / (k + d * I) ** 2
            leaving = loss + disposed
            return jnp.maximum(I - (leaving - E * jnp.exp(-s * I)) / (slope + s * leaving), 0.0)

        result: jax.Array = jax.lax.fori_loop(0, _STEPS, nearer, most + 0.0 * Q1)
        return result

    def infusion_without_production_mU_min(self) -> jax.Array:
        """Infinite, since no infusion stops production."""
        return jnp.asarray(jnp.inf)


WILINSKA: Final = "Wilinska et al. 2010, J. Diabetes Sci. Technol. 4(1)"
MCGILL: Final = f"{WILINSKA}, as the simulator of the McGill Diabetes Lab has it"

# fmt: off
# ruff: noqa: E501 (a table reads best with one value on each line)
CONSTANTS: Final = (
    Constant("weight_kg", 74.9, "kg", "body weight, mean", WILINSKA),
    Constant("t_maxI", 1.0 / 0.018, "min", "time to the maximum of insulin absorption, of the absorption rate 0.018 1/min", WILINSKA),
    Constant("k_e", 0.14, "1/min", "elimination of insulin from plasma", WILINSKA),
    Constant("V_I", 0.12, "l/kg", "volume of insulin", WILINSKA),
    Constant("k_a1", 0.0034, "1/min", "rate at which the effect of insulin on transport follows insulin", WILINSKA),
    Constant("k_a2", 0.056, "1/min", "rate at which the effect of insulin on disposal follows insulin", WILINSKA),
    Constant("k_a3", 0.024, "1/min", "rate at which the effect of insulin on production follows insulin", WILINSKA),
    Constant("S_IT", 18.41e-4, "1/min per mU/l", "sensitivity of glucose transport to insulin", WILINSKA),
    Constant("S_ID", 5.05e-4, "1/min per mU/l", "sensitivity of glucose disposal to insulin", WILINSKA),
    Constant("S_IE", 190e-4, "l/mU", "sensitivity of glucose production to insulin", WILINSKA),
    Constant("V_G", 0.16, "l/kg", "volume of the accessible glucose compartment", MCGILL),
    Constant("k_12", 0.060, "1/min", "transfer of glucose from the non-accessible to the accessible compartment", WILINSKA),
    Constant("EGP_0", 0.0169, "mmol/kg/min", "production of glucose by the liver, extrapolated to no insulin", WILINSKA),
    Constant("F_01", 0.0111, "mmol/kg/min", "uptake of glucose that does not depend on insulin", WILINSKA),
    Constant("uptake_half", 1.0, "mmol/l", "glucose at which this uptake is half of its maximum", WILINSKA),
    Constant("uptake_share", 0.85, "1", "share that F_01 is of the maximum uptake", WILINSKA),
    Constant("renal_threshold", 9.0, "mmol/l", "glucose above which the kidney excretes glucose", WILINSKA),
    Constant("renal_clearance", 0.01, "1/min", "excreted fraction of what exceeds the renal threshold", WILINSKA),
    Constant("t_IG", math.exp(2.372), "min", "delay of interstitial glucose behind plasma glucose", WILINSKA),
    Constant("A_G", 0.8, "1", "fraction of eaten carbohydrate that appears as glucose", MCGILL),
    Constant("t_maxG", 40.0, "min", "time to the maximum of the appearance of glucose after a meal", WILINSKA),
)
# fmt: on

WILINSKA_2010: Final = WilinskaParameters(**{constant.name: constant.value for constant in CONSTANTS})

DISTRIBUTIONS: Final[tuple[Normal | Uniform | Lognormal, ...]] = (
    Normal("weight_kg", 74.9, 14.4, WILINSKA),
    Lognormal("V_G", math.exp(-1.897), 0.23, WILINSKA),
    Normal("V_I", 0.12, 0.012, WILINSKA),
    Normal("k_e", 0.14, 0.035, WILINSKA),
    Normal("absorption_rate", 0.018, 0.0045, WILINSKA),
    Normal("renal_threshold", 9.0, 1.5, WILINSKA),
    Normal("renal_clearance", 0.01, 0.025, WILINSKA),
    Uniform("A_G", 0.7, 1.2, WILINSKA),
    Lognormal("t_maxG", math.exp(3.689), 0.25, WILINSKA),
    Lognormal("t_IG", math.exp(2.372), 1.09, WILINSKA),
)
"""Distributions that are known; each constant is drawn independently."""
