"""Dexcom G6, its mean errors of Vettoretti et al. (2019): no calibration, gain and offset over ten days of wear.

Table 1 and 2 of the paper, with a process of each sensor and one that sensors on the same person have in common. It was
found with 11 people who wore two sensors each. The processes advance every 5 min: see `facchinetti_2014`. How sensors
differ from one another is in `vettoretti_2019`.

M. Vettoretti, S. Del Favero, G. Sparacino, A. Facchinetti, "Modeling the error of factory-calibrated continuous glucose
monitoring sensors: application to Dexcom G6 sensor data", 41st Conf. IEEE EMBC, 2019, doi:10.1109/embc.2019.8856790.
"""

from typing import ClassVar

from glucoloop.sensors.cgm.model import ErrorModel, Process
from glucoloop.sensors.cgm.monitor import Monitor
from glucoloop.units import MIN_PER_DAY


class DexcomG6(Monitor, name="dexcom-g6"):
    """Dexcom G6, with the mean errors of Vettoretti et al. (EMBC 2019)."""

    sources = ("vettoretti2019g6",)
    model: ClassVar = ErrorModel(
        gain=(1.048, -0.033, 0.002),
        offset_mg_dl=(-6.398, 6.179, -0.448),
        processes=(
            Process(alpha1=1.220, alpha2=-0.331, variance=3.641),
            Process(alpha1=1.34, alpha2=-0.492, variance=5.538),
        ),
        longest_wear_min=10.0 * MIN_PER_DAY,
    )
