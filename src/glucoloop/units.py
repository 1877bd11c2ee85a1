"""The only conversion constants of the project: multiply to convert, divide to convert back."""

MOLAR_MASS_GLUCOSE_G_MOL = 180.156

MG_PER_G = 1000.0
MU_PER_U = 1000.0
PMOL_PER_U = 6000.0  # 1 U of human insulin is defined as 6 nmol
MIN_PER_H = 60.0
S_PER_MIN = 60.0
MIN_PER_DAY = 1440.0
HOURS_PER_DAY = 24.0
MG_DL_PER_MMOL_L = MOLAR_MASS_GLUCOSE_G_MOL / 10.0


def mmol_l_from_mg_dl(glucose_mg_dl: float) -> float:
    """Glucose concentration in mmol/l."""
    return glucose_mg_dl / MG_DL_PER_MMOL_L


def mg_dl_from_mmol_l(glucose_mmol_l: float) -> float:
    """Glucose concentration in mg/dl."""
    return glucose_mmol_l * MG_DL_PER_MMOL_L


def u_h_from_mu_min(insulin_mU_min: float) -> float:
    """Insulin rate in U/h, the unit of pump displays."""
    return insulin_mU_min * MIN_PER_H / MU_PER_U


def mu_min_from_u_h(insulin_U_h: float) -> float:
    """Insulin rate in mU/min, the unit of the equations."""
    return insulin_U_h * MU_PER_U / MIN_PER_H
