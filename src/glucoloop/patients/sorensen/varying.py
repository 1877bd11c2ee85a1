"""Constants that can vary from person to person, their bounds, and the parameters that result.

Varied are the constants of the patient by name; the strength of an effect, the factor on the whole of it; and body
weight. Blood is conserved: the flow through the liver is what its artery and the gut bring, so it follows from them.

A person of another weight has more or less blood and tissue and proportionally more or less flow, so the times in which
blood goes round stay the same. Insulin leaves in proportion to flow: the same infusion per kilogram gives the same
insulin concentrations, exactly. Rates of metabolism (production and uptake of glucose, its excretion) are not scaled,
so glucose differs a little less from organ to organ in a heavier person, and the basal rate is nearly in proportion to
weight: per kilogram it is 1.5 % below that at 70 kg for 50 kg, and 1.1 % above it for 100 kg.

The effects are normalised by a healthy basal state, which can be that of another fasting glucose. Sorensen (1985) finds
the basal state of a healthy person organ by organ. At rest after a night's fast every effect is 1, so that every rate
has its basal value, and each glucose balance gives one concentration from those upstream:

    G_BV = G_H - r_BGU / q_B          brain
    G_G  = G_H - r_GGU / q_G          gut
    G_K  = G_H                        kidney, which excretes nothing
    G_PV = G_H - r_PGU / q_P          periphery, vascular
    G_PI = G_PV - T_P r_PGU / v_PI    periphery, interstitial
    G_L  = G_H + (r_BGU + r_RBCU + r_PGU) / q_L    liver, from the balance of heart and lungs

The balance of the liver is then satisfied, because basal production less basal uptake by the liver, 155 - 20 mg/min, is
what the other organs take up, 70 + 10 + 20 + 35 mg/min. So arterial glucose is the only free concentration, and all
others move with it by the same amount. No split of the shift between organs is left open.

Parker, Doyle, Ward and Peppas (2000) characterise the uncertainty of the patient by a variation of up to 40 % in eight
parameters: two fractions of insulin clearance, and scale and inflection of three effects of insulin on glucose. Effects
are written there as ``E (A - B tanh(C (x - D)))``. The scale E multiplies the whole effect, here ``strength``; were B
alone varied, uptake would turn negative. The inflection is D. The printed inflection of the effect on hepatic uptake is
0, of which 40 % is nothing; here it is moved by up to 0.4 of the healthy basal concentration, by which these effects
are normalised. That is a reading, as is the uniform distribution: the abstract gives bounds only.

References
----------
J. T. Sorensen, "A physiologic model of glucose metabolism in man and its use to design and assess improved insulin
therapies for diabetes", Sc.D. thesis, MIT, 1985: a man of 70 kg.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from glucoloop._lazy_jax import jax
from glucoloop.patients.sorensen.equations import Sigmoid, SorensenParameters
from glucoloop.patients.sorensen.parker1999 import CONSTANTS, PARKER_1999
from glucoloop.patients.variation import Distribution, Variation
from glucoloop.refusal import Refusal


def basal_glucose(p: SorensenParameters, arterial_mg_dl: jax.Array | float) -> tuple[jax.Array | float, ...]:
    """Healthy basal `G_H`, `G_L` and `G_PI` in mg/dl from the balances, for a fasting arterial glucose."""
    liver = arterial_mg_dl + (p.brain_uptake + p.red_cell_uptake + p.basal_peripheral_uptake) / p.q_L
    vascular = arterial_mg_dl - p.basal_peripheral_uptake / p.q_P
    return arterial_mg_dl, liver, vascular - p.basal_peripheral_uptake * p.T_P / p.v_PI


def with_fasting_glucose(p: SorensenParameters, arterial_mg_dl: float) -> SorensenParameters:
    """Constants of a person whose healthy basal state has another fasting arterial glucose.

    The three references of the glucose effects move by as much as fasting glucose does, which is what the balances ask
    for (see above). The printed references are kept as the starting point: they differ from the balances by rounding,
    and in the periphery by .17 mg/dl.
    """
    lower = p.ref_G_H - arterial_mg_dl
    shifted = {name: getattr(p, name) - lower for name in ("ref_G_H", "ref_G_L", "ref_G_PI")}
    if not min(shifted.values()) > 0.0:
        raise Refusal(
            f"a fasting arterial glucose of {arterial_mg_dl:g} mg/dl leaves the peripheral tissue none; "
            f"give more than {p.ref_G_H - p.ref_G_PI:.3g} mg/dl"
        )
    return dataclasses.replace(p, **shifted)


REFERENCE_WEIGHT_KG: Final = 70.0
"""Weight of the man whose volumes and flows are printed."""

VOLUMES: Final = (
    *("v_BV", "v_BI", "v_H", "v_G", "v_L", "v_K", "v_PV", "v_PI"),
    *("V_B", "V_H", "V_G", "V_L", "V_K", "V_PV", "V_PI", "V_N"),
)
FLOWS: Final = (
    *("q_B", "q_A", "q_G", "q_L", "q_K", "q_P"),
    *("Q_B", "Q_A", "Q_G", "Q_L", "Q_K", "Q_P"),
)


def scaled_to_weight(p: SorensenParameters, weight_kg: jax.Array | float) -> SorensenParameters:
    """Constants with every volume and flow times ``weight_kg / 70``, from those at 70 kg."""
    factor = weight_kg / REFERENCE_WEIGHT_KG
    return dataclasses.replace(p, **{name: getattr(p, name) * factor for name in (*VOLUMES, *FLOWS)})


WEIGHT: Final = "weight_kg"
ADULTS: Final = Variation(parameter=WEIGHT, distribution="lognormal", spread_pct=15.0)
"""Variation of body weight in populations that vary it."""
STRENGTH: Final = "strength"

_EFFECTS: Final = tuple(
    field.name
    for field in dataclasses.fields(PARKER_1999)
    if field.name.startswith("M_") and isinstance(getattr(PARKER_1999, field.name), Sigmoid)
)
FOLLOWS: Final = {"q_L": ("q_A", "q_G"), "Q_L": ("Q_A", "Q_G")}
_FRACTIONS: Final = ("F_LC", "F_KC", "F_PC")
_FREE_PARTS: Final = ("offset", "scale", "inflection")

NOMINAL: Final[dict[str, float]] = {
    **{constant.name: constant.value for constant in CONSTANTS if constant.name not in FOLLOWS},
    **{f"{effect}.{STRENGTH}": 1.0 for effect in _EFFECTS},
    WEIGHT: REFERENCE_WEIGHT_KG,
}
"""All constants that can vary, with the value of the nominal patient."""

_MEANINGS: Final = {constant.name: constant.meaning.partition(";")[0] for constant in CONSTANTS}
MEANINGS: Final[dict[str, str]] = {
    **_MEANINGS,
    **{f"{effect}.{STRENGTH}": f"{_MEANINGS[f'{effect}.offset'].partition(':')[0]}: strength" for effect in _EFFECTS},
    WEIGHT: "body weight in kg",
}
"""Meaning of what can vary, in words."""


def refuse_impossible(varied: Mapping[str, Distribution]) -> None:
    """Refuse distributions that can make an impossible person, by a bound, a clearance or the sign of an effect."""
    for name, distribution in varied.items():
        lowest, highest = _possible(name)
        if not (lowest < distribution.lower and distribution.upper < highest):
            bound = f"above {lowest:g}" + (f" and below {highest:g}" if math.isfinite(highest) else "")
            raise Refusal(f"{name} {distribution.in_words} but must stay {bound}; {distribution.mend}")
    _refuse_no_clearance(varied)
    for effect in (*_EFFECTS, "excretion"):
        _refuse_change_of_sign(effect, varied)


def _possible(name: str) -> tuple[float, float]:
    """Open bounds of a parameter."""
    if name in _FRACTIONS:
        return 0.0, 1.0
    if name == "excretion_offset" or name.partition(".")[2] in _FREE_PARTS:
        return -math.inf, math.inf
    return 0.0, math.inf


def _reach(name: str, varied: Mapping[str, Distribution]) -> tuple[float, float]:
    """Minimum and largest value of a parameter, varied or not."""
    if name in varied:
        return varied[name].lower, varied[name].upper
    return NOMINAL[name], NOMINAL[name]


def _refuse_no_clearance(varied: Mapping[str, Distribution]) -> None:
    """Refuse distributions with a clearance 1 / ((1 - F_PC) / (F_PC Q_P) - T_PI / V_PI) that is not positive."""
    most = {name: _reach(name, varied)[1] for name in ("F_PC", "Q_P", "T_PI")}
    allowed = 1.0 / (1.0 + most["Q_P"] * most["T_PI"] / _reach("V_PI", varied)[0])
    if not most["F_PC"] < allowed:
        who = next(name for name in ("F_PC", "Q_P", "T_PI", "V_PI") if name in varied)
        raise Refusal(
            f"F_PC can be {most['F_PC']:g}, but with these flows and volumes no insulin would be left in the periphery "
            f"from {allowed:.4g} on; narrow the spread of {who}"
        )


def _refuse_change_of_sign(effect: str, varied: Mapping[str, Distribution]) -> None:
    """Refuse distributions in which an effect that is never negative can become so: its offset must reach its scale."""
    offset, scale = f"{effect}.offset", f"{effect}.scale"
    if NOMINAL[offset] < abs(NOMINAL[scale]) or not (offset in varied or scale in varied):
        return
    least, most = _reach(offset, varied)[0], max(abs(value) for value in _reach(scale, varied))
    if least < most:
        raise Refusal(
            f"{effect} would change its sign: its scale can be {most:g} and its offset {least:g}; "
            + (f"vary {effect}.{STRENGTH} instead" if effect in _EFFECTS else "vary excretion_clearance instead")
        )


def with_values(values: Mapping[str, Any]) -> SorensenParameters:
    """Constants of people with these values, volumes and flows as at 70 kg, and nominal ones otherwise."""
    constants: dict[str, Any] = {}
    for name, value in values.items():
        field, dot, part = name.partition(".")
        if not dot and name != WEIGHT:
            constants[field] = value
        elif dot and part != STRENGTH:
            constants[field] = dataclasses.replace(constants.get(field, getattr(PARKER_1999, field)), **{part: value})
    for effect in _EFFECTS:
        strength = values.get(f"{effect}.{STRENGTH}")
        if strength is not None:
            effective: Sigmoid = constants.get(effect, getattr(PARKER_1999, effect))
            constants[effect] = dataclasses.replace(
                effective, offset=effective.offset * strength, scale=effective.scale * strength
            )
    for flow, inflows in FOLLOWS.items():
        if any(inflow in values for inflow in inflows):
            artery, gut = (values.get(inflow, NOMINAL[inflow]) for inflow in inflows)
            constants[flow] = artery + gut
    p = dataclasses.replace(PARKER_1999, **constants)
    return scaled_to_weight(p, values[WEIGHT]) if WEIGHT in values else p


SOURCE: Final = "Parker, Doyle, Ward, Peppas 2000, AIChE J. 46(12)"
LARGEST_VARIATION_PCT: Final = 40.0


class _Uncertain(NamedTuple):
    """A parameter that the paper varies."""

    parameter: str
    """A constant of the patient, or ``strength``, the factor on a whole effect."""
    half_width: float | None
    """Largest change in the unit of the parameter, or None for 40 % of its nominal value."""
    meaning: str
    source: str


# fmt: off
# ruff: noqa: E501 (a table reads best with one value on each line)
UNCERTAIN: Final = (
    _Uncertain("F_LC", None, "fraction of insulin cleared by the liver", SOURCE),
    _Uncertain("F_PC", None, "fraction of insulin cleared by the periphery", SOURCE),
    _Uncertain("M_IHGP.strength", None, "insulin on hepatic production: scale E of the whole effect", SOURCE),
    _Uncertain("M_IHGP.inflection", None, "insulin on hepatic production: inflection D", SOURCE),
    _Uncertain("M_IHGU.strength", None, "insulin on hepatic uptake: scale E of the whole effect", SOURCE),
    _Uncertain("M_IHGU.inflection", 0.4, "insulin on hepatic uptake: inflection D; printed as 0, moved by 0.4 of the healthy basal concentration", f"reading of {SOURCE}"),
    _Uncertain("M_IPGU.strength", None, "insulin on peripheral uptake: scale E of the whole effect", SOURCE),
    _Uncertain("M_IPGU.inflection", None, "insulin on peripheral uptake: inflection D", SOURCE),
)
# fmt: on
