"""Formulas that metrics of a loop and metrics of a record share; they take numbers and arrays, of NumPy and JAX too."""

from __future__ import annotations

from typing import Any


def gmi_pct(mean_mg_dl: Any) -> Any:
    """Glucose management indicator: ``3.31 + 0.02392 mean``, in percent.

    References
    ----------
    R. M. Bergenstal et al., "Glucose management indicator (GMI): a new term for estimating A1C from continuous glucose
    monitoring", Diabetes Care 41(11), 2275-2280, 2018.
    """
    return 3.31 + 0.02392 * mean_mg_dl


def glycemia_risk_index(xp: Any, very_low: Any, below_70: Any, very_high: Any, above_180: Any) -> Any:
    """Glycemia risk index ``min(100, 3 VLow + 2.4 Low + 1.6 VHigh + 0.8 High)``, from times in percent.

    Low and High are the times below 70 and above 180 mg/dl without those below 54 and above 250 mg/dl, which are VLow
    and VHigh.

    References
    ----------
    D. C. Klonoff et al., "A glycemia risk index (GRI) of hypoglycemia and hyperglycemia for continuous glucose
    monitoring validated by clinician ratings", J. Diabetes Sci. Technol. 17(5), 1226-1242, 2023.
    """
    risk = 3.0 * very_low + 2.4 * (below_70 - very_low) + 1.6 * very_high + 0.8 * (above_180 - very_high)
    return xp.minimum(risk, 100.0)


def symmetric_glucose(xp: Any, glucose_mg_dl: Any) -> Any:
    """Glucose on the scale on which risk is the same to both sides: ``f = 1.509 (ln(glucose)^1.084 - 5.381)``.

    The scale is made for 20 to 600 mg/dl, on which the risk ``10 f^2`` falls from 100 to 0 at 112.5 mg/dl and rises to
    100 again. Glucose beyond is taken at the nearer end, since the logarithm fails below 1 mg/dl.

    References
    ----------
    B. P. Kovatchev, D. J. Cox, L. A. Gonder-Frederick, W. Clarke, "Symmetrization of the blood glucose measurement
    scale and its applications", Diabetes Care 20(11), 1655-1658, 1997.
    """
    return 1.509 * (xp.log(xp.clip(glucose_mg_dl, 20.0, 600.0)) ** 1.084 - 5.381)
