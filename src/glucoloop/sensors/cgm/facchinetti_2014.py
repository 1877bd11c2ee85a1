"""Dexcom SEVEN Plus, its errors of Facchinetti et al. (2014).

Noise is the sum of a process of each sensor and one that sensors on the same person have in common, eqs. (13) and (14),
and the error of calibration changes with the time since the last calibration, eqs. (5) and (6), Table 1. The model
holds for the 12 h between two calibrations, as Vettoretti et al. (Sensors 19, 5320, 2019) say of it and of those that
followed, so that the days begin again every 12 h.

The processes advance every 5 min, the time between two readings of the sensor. The paper does not settle it in the
parts that we could read, and a simulator advances them every minute. But of the Dexcom G6 there are two models of the
same group, one whose process is used every 5 min (`vettoretti_2019`), and one of this form (`dexcom_g6`); from point to
point both have the correlation 0.90, and this one 0.83 and 0.88. If the points lay a minute apart, an error would last
a few minutes in one and half an hour in the other.

A. Facchinetti, S. Del Favero, G. Sparacino, J. R. Castle, W. K. Ward, C. Cobelli, "Modeling the glucose sensor error",
IEEE Trans. Biomed. Eng. 61(3), 2014, doi:10.1109/TBME.2013.2284023.
"""

from typing import ClassVar

from glucoloop.sensors.cgm.model import ErrorModel, Process
from glucoloop.sensors.cgm.monitor import Monitor
from glucoloop.units import MIN_PER_DAY


class Facchinetti2014(Monitor, name="facchinetti-2014"):
    """Dexcom SEVEN Plus, with the errors of Facchinetti et al. (2014)."""

    sources = ("facchinetti2014",)
    model: ClassVar = ErrorModel(
        gain=(1.1, 2e-4, 0.0),
        offset_mg_dl=(-14.8, 0.04, 0.0),
        processes=(
            Process(alpha1=1.013, alpha2=-0.2135, variance=14.45),
            Process(alpha1=1.23, alpha2=-0.3995, variance=11.3),
        ),
        calibrated_every_min=720.0,
    )
    wear_min: float = 7.0 * MIN_PER_DAY
