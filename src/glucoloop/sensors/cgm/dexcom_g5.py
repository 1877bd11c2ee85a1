"""Dexcom G5, its errors of Vettoretti et al. (2018), of the form of Facchinetti et al. (2014) with one process.

The model holds between two calibrations, 12 h apart, and its process advances every 5 min: see `facchinetti_2014`.

M. Vettoretti et al., IEEE Trans. Biomed. Eng. 65(6), 2018, doi:10.1109/tbme.2017.2746340.
"""

from typing import ClassVar

from glucoloop.sensors.cgm.model import ErrorModel, Process
from glucoloop.sensors.cgm.monitor import Monitor
from glucoloop.units import MIN_PER_DAY


class DexcomG5(Monitor, name="dexcom-g5"):
    """Dexcom G5, with the errors of Vettoretti et al. (2018)."""

    sources = ("vettoretti2018", "facchinetti2014")
    model: ClassVar = ErrorModel(
        gain=(1.04, 0.02, 0.0),
        offset_mg_dl=(-8.75, 0.0, 0.0),
        processes=(Process(alpha1=1.27, alpha2=-0.42, variance=7.64),),
        calibrated_every_min=720.0,
    )
    wear_min: float = 7.0 * MIN_PER_DAY
