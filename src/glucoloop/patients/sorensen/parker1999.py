"""The constants of the diabetic patient of Parker, Doyle and Peppas (1999).

The paper does not print them; it rests on Sorensen (1985) with the changes set out in Parker et al. (2000).
Published implementations disagree on several; the choices below are self-consistent: at N = 1 and the healthy
basal state every multiplier is 1 to within 0.1 %. Where another choice is in circulation the meaning says so.
"""

from __future__ import annotations

from typing import Final

from glucoloop.patients.component import Constant
from glucoloop.patients.sorensen.equations import Sigmoid, SorensenParameters

SORENSEN: Final = "Sorensen 1985, Sc.D. thesis, MIT"
PARKER_2000: Final = "Sorensen 1985; printed in this form in Parker, Doyle, Ward, Peppas 2000, AIChE J. 46(12)"
DALLA_MAN_2014: Final = "Dalla Man et al. 2014, J. Diabetes Sci. Technol. 8(1), Fig. 5, as LoopInsighT1 has it"

# fmt: off
# ruff: noqa: E501 (a table reads best with one value on each line)
CONSTANTS: Final = (
    Constant("q_B", 5.9, "dl/min", "glucose flow, brain", SORENSEN),
    Constant("q_A", 2.5, "dl/min", "glucose flow, hepatic artery", SORENSEN),
    Constant("q_G", 10.1, "dl/min", "glucose flow, gut", SORENSEN),
    Constant("q_L", 12.6, "dl/min", "glucose flow, liver", SORENSEN),
    Constant("q_K", 10.1, "dl/min", "glucose flow, kidney", SORENSEN),
    Constant("q_P", 15.1, "dl/min", "glucose flow, periphery", SORENSEN),
    Constant("v_BV", 3.5, "dl", "glucose volume, brain, vascular", SORENSEN),
    Constant("v_BI", 4.5, "dl", "glucose volume, brain, interstitial", SORENSEN),
    Constant("v_H", 13.8, "dl", "glucose volume, heart and lungs", SORENSEN),
    Constant("v_G", 11.2, "dl", "glucose volume, gut", SORENSEN),
    Constant("v_L", 25.1, "dl", "glucose volume, liver", SORENSEN),
    Constant("v_K", 6.6, "dl", "glucose volume, kidney", SORENSEN),
    Constant("v_PV", 10.4, "dl", "glucose volume, periphery, vascular", SORENSEN),
    Constant("v_PI", 67.4, "dl", "glucose volume, periphery, interstitial; 63 in other implementations", SORENSEN),
    Constant("T_B", 2.1, "min", "glucose exchange time, brain", SORENSEN),
    Constant("T_P", 5.0, "min", "glucose exchange time, periphery", SORENSEN),
    Constant("Q_B", 0.45, "l/min", "insulin flow, brain", SORENSEN),
    Constant("Q_A", 0.18, "l/min", "insulin flow, hepatic artery", SORENSEN),
    Constant("Q_G", 0.72, "l/min", "insulin flow, gut", SORENSEN),
    Constant("Q_L", 0.9, "l/min", "insulin flow, liver", SORENSEN),
    Constant("Q_K", 0.72, "l/min", "insulin flow, kidney", SORENSEN),
    Constant("Q_P", 1.05, "l/min", "insulin flow, periphery", SORENSEN),
    Constant("V_B", 0.26, "l", "insulin volume, brain", SORENSEN),
    Constant("V_H", 0.99, "l", "insulin volume, heart and lungs", SORENSEN),
    Constant("V_G", 0.94, "l", "insulin volume, gut", SORENSEN),
    Constant("V_L", 1.14, "l", "insulin volume, liver", SORENSEN),
    Constant("V_K", 0.51, "l", "insulin volume, kidney", SORENSEN),
    Constant("V_PV", 0.74, "l", "insulin volume, periphery, vascular", SORENSEN),
    Constant("V_PI", 6.74, "l", "insulin volume, periphery, interstitial", SORENSEN),
    Constant("T_PI", 20.0, "min", "insulin exchange time, periphery", SORENSEN),
    Constant("F_LC", 0.4, "1", "fraction of insulin cleared by the liver", SORENSEN),
    Constant("F_KC", 0.3, "1", "fraction of insulin cleared by the kidney, of the arterial supply; of I_K in other implementations", SORENSEN),
    Constant("F_PC", 0.15, "1", "fraction of insulin cleared by the periphery", SORENSEN),
    Constant("brain_uptake", 70.0, "mg/min", "glucose uptake of the brain, constant", SORENSEN),
    Constant("red_cell_uptake", 10.0, "mg/min", "glucose uptake of red blood cells, constant", SORENSEN),
    Constant("gut_uptake", 20.0, "mg/min", "glucose uptake of the gut, constant", SORENSEN),
    Constant("basal_hepatic_production", 155.0, "mg/min", "hepatic glucose production of the healthy basal state", SORENSEN),
    Constant("basal_hepatic_uptake", 20.0, "mg/min", "hepatic glucose uptake of the healthy basal state", SORENSEN),
    Constant("basal_peripheral_uptake", 35.0, "mg/min", "peripheral glucose uptake of the healthy basal state", SORENSEN),
    Constant("ref_G_H", 91.89, "mg/dl", "healthy basal arterial glucose", SORENSEN),
    Constant("ref_G_L", 101.0, "mg/dl", "healthy basal liver glucose", SORENSEN),
    Constant("ref_G_PI", 86.81, "mg/dl", "healthy basal interstitial glucose, periphery", SORENSEN),
    Constant("ref_I_H", 15.15, "mU/l", "healthy basal arterial insulin", SORENSEN),
    Constant("ref_I_L", 21.43, "mU/l", "healthy basal liver insulin", SORENSEN),
    Constant("ref_I_PI", 5.304, "mU/l", "healthy basal interstitial insulin, periphery", SORENSEN),
    Constant("ref_N", 60.0, "pg/ml", "healthy basal glucagon, in whose multiples N is; read off a figure", DALLA_MAN_2014),
    Constant("M_IHGP.offset", 1.2088, "1", "insulin on hepatic production: offset", PARKER_2000),
    Constant("M_IHGP.scale", -1.138, "1", "insulin on hepatic production: scale", PARKER_2000),
    Constant("M_IHGP.slope", 1.669, "1", "insulin on hepatic production: slope", PARKER_2000),
    Constant("M_IHGP.inflection", 0.8885, "1", "insulin on hepatic production: inflection", PARKER_2000),
    Constant("M_IHGU.offset", 0.0, "1", "insulin on hepatic uptake: offset", PARKER_2000),
    Constant("M_IHGU.scale", 2.0, "1", "insulin on hepatic uptake: scale", PARKER_2000),
    Constant("M_IHGU.slope", 0.549, "1", "insulin on hepatic uptake: slope", PARKER_2000),
    Constant("M_IHGU.inflection", 0.0, "1", "insulin on hepatic uptake: inflection", PARKER_2000),
    Constant("M_GHGP.offset", 1.425, "1", "glucose on hepatic production: offset", PARKER_2000),
    Constant("M_GHGP.scale", -1.406, "1", "glucose on hepatic production: scale", PARKER_2000),
    Constant("M_GHGP.slope", 0.6199, "1", "glucose on hepatic production: slope", PARKER_2000),
    Constant("M_GHGP.inflection", 0.4969, "1", "glucose on hepatic production: inflection", PARKER_2000),
    Constant("M_GHGU.offset", 5.6648, "1", "glucose on hepatic uptake: offset", PARKER_2000),
    Constant("M_GHGU.scale", 5.6589, "1", "glucose on hepatic uptake: scale", PARKER_2000),
    Constant("M_GHGU.slope", 2.4375, "1", "glucose on hepatic uptake: slope", PARKER_2000),
    Constant("M_GHGU.inflection", 1.48, "1", "glucose on hepatic uptake: inflection", PARKER_2000),
    Constant("M_IPGU.offset", 7.035, "1", "insulin on peripheral uptake: offset", PARKER_2000),
    Constant("M_IPGU.scale", 6.51623, "1", "insulin on peripheral uptake: scale", PARKER_2000),
    Constant("M_IPGU.slope", 0.33827, "1", "insulin on peripheral uptake: slope", PARKER_2000),
    Constant("M_IPGU.inflection", 5.82113, "1", "insulin on peripheral uptake: inflection", PARKER_2000),
    Constant("M_NHGP.offset", 0.0, "1", "glucagon on hepatic production: offset", SORENSEN),
    Constant("M_NHGP.scale", 2.7, "1", "glucagon on hepatic production: scale", SORENSEN),
    Constant("M_NHGP.slope", 0.388, "1", "glucagon on hepatic production: slope", SORENSEN),
    Constant("M_NHGP.inflection", 0.0, "1", "glucagon on hepatic production: inflection", SORENSEN),
    Constant("M_IPNR.offset", 1.3102, "1", "insulin on glucagon release: offset", SORENSEN),
    Constant("M_IPNR.scale", -0.61016, "1", "insulin on glucagon release: scale", SORENSEN),
    Constant("M_IPNR.slope", 1.0571, "1", "insulin on glucagon release: slope", SORENSEN),
    Constant("M_IPNR.inflection", 0.46981, "1", "insulin on glucagon release: inflection", SORENSEN),
    Constant("M_GPNR.offset", 2.9285, "1", "glucose on glucagon release: offset", SORENSEN),
    Constant("M_GPNR.scale", -2.095, "1", "glucose on glucagon release: scale", SORENSEN),
    Constant("M_GPNR.slope", 4.18, "1", "glucose on glucagon release: slope", SORENSEN),
    Constant("M_GPNR.inflection", 0.6191, "1", "glucose on glucagon release: inflection", SORENSEN),
    Constant("tau_I", 25.0, "min", "lag of the insulin effects on the liver", SORENSEN),
    Constant("tau_N", 65.0, "min", "lag of the second glucagon effect on the liver", SORENSEN),
    Constant("k_N", 0.0916, "1/min", "clearance of glucagon by its volume", SORENSEN),
    Constant("V_N", 9.93, "l", "glucagon volume, of a clearance of 0.91 l/min", SORENSEN),
    Constant("excretion.offset", 71.0, "mg/min", "renal excretion below the threshold: offset", SORENSEN),
    Constant("excretion.scale", 71.0, "mg/min", "renal excretion below the threshold: scale", SORENSEN),
    Constant("excretion.slope", 0.011, "dl/mg", "renal excretion below the threshold: slope", SORENSEN),
    Constant("excretion.inflection", 460.0, "mg/dl", "renal excretion below the threshold: inflection", SORENSEN),
    Constant("excretion_threshold", 460.0, "mg/dl", "kidney glucose above which excretion is linear", SORENSEN),
    Constant("excretion_offset", -330.0, "mg/min", "renal excretion above the threshold, intercept; +330 in other implementations", SORENSEN),
    Constant("excretion_clearance", 0.872, "dl/min", "renal excretion above the threshold, slope", SORENSEN),
)
# fmt: on


def _parameters() -> SorensenParameters:
    """Assemble the record; dotted names are the fields of a sigmoid."""
    plain: dict[str, float] = {}
    sigmoids: dict[str, dict[str, float]] = {}
    for constant in CONSTANTS:
        name, dot, part = constant.name.partition(".")
        if dot:
            sigmoids.setdefault(name, {})[part] = constant.value
        else:
            plain[name] = constant.value
    return SorensenParameters(**plain, **{name: Sigmoid(**parts) for name, parts in sigmoids.items()})  # type: ignore[arg-type]


PARKER_1999: Final = _parameters()
