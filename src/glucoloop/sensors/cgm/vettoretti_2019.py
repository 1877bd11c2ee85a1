"""Factory-calibrated sensors that differ from one another: 79 Dexcom G6 sensors of Vettoretti et al. (2019).

Each sensor has its gain over ten days of wear, its offset, and its process, which advances every 5 min. The seven
numbers are normal, with a covariance 0.9 times that found, so that none is too far off; a sensor whose process is not
stable, with a margin of 0.02, or whose noise has a standard deviation above 10 mg/dl, is drawn again. 73 % are taken.

M. Vettoretti, C. Battocchio, G. Sparacino, A. Facchinetti, "Development of an error model for a factory-calibrated
continuous glucose monitoring sensor with 10-day lifetime", Sensors 19(23), 5320, 2019, doi:10.3390/s19235320: mean and
covariance of a0, a1, a2, b0, alpha1, alpha2, sigma. The factor and the bounds are those of the simulator ReplayBG.
"""

from typing import ClassVar, Final

from glucoloop.sensors.cgm.model import ErrorModel, Spread
from glucoloop.sensors.cgm.monitor import Monitor
from glucoloop.units import MIN_PER_DAY

_FACTOR: Final = 0.9
# Upper triangle by rows.
_COVARIANCE: Final = (
    (0.01324583, -0.003951303, 0.0003127674, 0.1571791, 0.002687656, -0.002890463, -0.003180171),
    (0.001852798, -0.0001558033, -0.1028801, -0.001390233, 0.001159185, -0.002728493),
    (1.374596e-05, 0.008068586, 0.0001207497, -0.0001004214, 0.0001113029),
    (29.00584, 0.1240834, -0.1019364, 0.6007538),
    (0.02079353, -0.01843111, -0.01572185),
    (0.01870087, 0.01552334),
    (0.7235684,),
)


class Vettoretti2019(Monitor, name="vettoretti-2019"):
    """Factory-calibrated sensors that differ, drawn for each person and wear, of Vettoretti et al. (Sensors 2019)."""

    sources = ("vettoretti2019",)
    model: ClassVar = ErrorModel(
        spread=Spread(
            mean=(0.9422877, 0.004939882, -0.0005848749, 6.382602, 1.260407, -0.4022229, 3.251636),
            covariance=tuple(
                tuple(_FACTOR * _COVARIANCE[min(i, j)][abs(i - j)] for j in range(len(_COVARIANCE)))
                for i in range(len(_COVARIANCE))
            ),
            stability_margin=0.02,
            largest_sd_mg_dl=10.0,
        ),
        longest_wear_min=10.0 * MIN_PER_DAY,
    )
