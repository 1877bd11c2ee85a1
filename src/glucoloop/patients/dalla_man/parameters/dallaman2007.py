"""Constants of the average normal subject of Dalla Man et al. (2007), as a person of 78 kg who makes no insulin.

- Table I of the paper lists a normal and a type 2 diabetic subject. Constants are those of the normal one; b and d are
  those of meals in that table (0.82 and 0.010), not those of the group's paper of 2006 on glucose alone.
- Body weight and basal insulin of that subject are not in the table; 78 kg and 25 pmol/l are those of the curated
  encoding of the paper at BioModels, whose other constants are those of the table.
- The paper has no subcutaneous insulin. Its kinetics are those of the group's simulation software GIM, with the
  values that the open simulator LoopInsighT1 takes from there. The delay of interstitial glucose, 10 min, is that of
  LoopInsighT1 too.
- It is our own choice to make of the normal subject a person with type 1 diabetes: the pancreas is left out, and with
  it the effect of portal insulin on the liver (k_p4), as in the simulator of 2008. No such person is published, and
  this one needs less insulin (I_b is 25 pmol/l) than the simulator's thirty people.
"""

from __future__ import annotations

from typing import Final

from glucoloop.patients.provenance import Constant

DALLA_MAN_2007: Final = "Dalla Man et al. 2007, IEEE Trans. Biomed. Eng. 54(10), Table I, normal subject"
GIM: Final = "Dalla Man et al. 2007 (GIM), J. Diabetes Sci. Technol. 1(3), as LoopInsighT1 has it"
LOOPINSIGHT: Final = "LoopInsighT1 (hpeuscher/loopinsight1), UVA/Padova model"
BIOMODELS: Final = f"BioModels BIOMD0000000379, after {DALLA_MAN_2007}"

# fmt: off
# ruff: noqa: E501 (a table reads best with one value on each line)
CONSTANTS: Final = (
    Constant("weight_kg", 78.0, "kg", "body weight", BIOMODELS),
    Constant("V_G", 1.88, "dl/kg", "volume of glucose", DALLA_MAN_2007),
    Constant("k_1", 0.065, "1/min", "transfer of glucose from plasma to slow tissues", DALLA_MAN_2007),
    Constant("k_2", 0.079, "1/min", "transfer of glucose from slow tissues to plasma", DALLA_MAN_2007),
    Constant("V_I", 0.05, "l/kg", "volume of insulin", DALLA_MAN_2007),
    Constant("m_1", 0.190, "1/min", "transfer of insulin from the liver to plasma", DALLA_MAN_2007),
    Constant("m_2", 0.484, "1/min", "transfer of insulin from plasma to the liver", DALLA_MAN_2007),
    Constant("m_4", 0.194, "1/min", "degradation of insulin in the periphery", DALLA_MAN_2007),
    Constant("HE_b", 0.6, "1", "share of insulin that the liver extracts", DALLA_MAN_2007),
    Constant("k_p1", 2.70, "mg/kg/min", "production of glucose by the liver, extrapolated to no glucose and no insulin", DALLA_MAN_2007),
    Constant("k_p2", 0.0021, "1/min", "effectiveness of glucose on production", DALLA_MAN_2007),
    Constant("k_p3", 0.009, "mg/kg/min per pmol/l", "effect of insulin on production", DALLA_MAN_2007),
    Constant("k_i", 0.0079, "1/min", "rate at which the effect of insulin on production follows insulin", DALLA_MAN_2007),
    Constant("F_cns", 1.0, "mg/kg/min", "uptake of glucose by brain and erythrocytes", DALLA_MAN_2007),
    Constant("V_m0", 2.50, "mg/kg/min", "maximum uptake by slow tissues under basal insulin", DALLA_MAN_2007),
    Constant("V_mx", 0.047, "mg/kg/min per pmol/l", "effect of insulin on this uptake", DALLA_MAN_2007),
    Constant("K_m0", 225.59, "mg/kg", "glucose in slow tissues at which uptake is half of its maximum", DALLA_MAN_2007),
    Constant("p_2U", 0.0331, "1/min", "rate at which the effect of insulin on uptake follows insulin", DALLA_MAN_2007),
    Constant("I_b", 25.0, "pmol/l", "basal insulin, from which the effect on uptake is counted", BIOMODELS),
    Constant("k_e1", 0.0005, "1/min", "excreted fraction of what exceeds the renal threshold", DALLA_MAN_2007),
    Constant("k_e2", 339.0, "mg/kg", "renal threshold of glucose in plasma", DALLA_MAN_2007),
    Constant("k_a1", 0.0018, "1/min", "absorption of insulin that is not yet monomeric", GIM),
    Constant("k_a2", 0.0182, "1/min", "absorption of monomeric insulin", GIM),
    Constant("k_d", 0.0164, "1/min", "dissociation of subcutaneous insulin", GIM),
    Constant("k_sc", 0.1, "1/min", "rate at which interstitial glucose follows plasma glucose, of a delay of 10 min", LOOPINSIGHT),
    Constant("k_max", 0.0558, "1/min", "largest rate of emptying of the stomach, and rate of trituration", DALLA_MAN_2007),
    Constant("k_min", 0.0080, "1/min", "smallest rate of emptying of the stomach", DALLA_MAN_2007),
    Constant("k_abs", 0.057, "1/min", "rate of absorption from the gut", DALLA_MAN_2007),
    Constant("b", 0.82, "1", "share of the meal in the stomach at which emptying is slower by half", DALLA_MAN_2007),
    Constant("d", 0.010, "1", "share of the meal in the stomach at which emptying is faster by half", DALLA_MAN_2007),
    Constant("f", 0.90, "1", "share of absorbed glucose that appears in plasma", DALLA_MAN_2007),
)
# fmt: on
