"""Sensors with the errors that papers print: a class each, with the source of its constants and what it leaves open."""

from typing import ClassVar, Final

from glucoloop.sensors.cgm.model import ErrorModel, Johnson, Process, Spread
from glucoloop.sensors.cgm.monitor import Monitor
from glucoloop.units import MIN_PER_DAY


class Facchinetti2014(Monitor, name="facchinetti-2014"):
    """Dexcom SEVEN Plus, with the errors of Facchinetti et al. (2014).

    Noise is the sum of a process of each sensor and one that sensors on the same person have in common, eqs. (13) and
    (14), and the error of calibration changes with the time since the last calibration, eqs. (5) and (6), Table 1. The
    model holds for the 12 h between two calibrations, as Vettoretti et al. (Sensors 19, 5320, 2019) say of it and of
    those that followed, so that the days begin again every 12 h.

    The processes advance every 5 min, the time between two readings of the sensor. The paper does not settle it in the
    parts that we could read, and a simulator advances them every minute. But of the Dexcom G6 there are two models of
    the same group, one whose process is used every 5 min (`Vettoretti2019`), and one of this form (`DexcomG6`); from
    point to point both have the correlation 0.90, and this one 0.83 and 0.88. If the points lay a minute apart, an
    error would last a few minutes in one and half an hour in the other.

    A. Facchinetti, S. Del Favero, G. Sparacino, J. R. Castle, W. K. Ward, C. Cobelli, "Modeling the glucose sensor
    error", IEEE Trans. Biomed. Eng. 61(3), 2014, doi:10.1109/TBME.2013.2284023.
    """

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


class DexcomG5(Monitor, name="dexcom-g5"):
    """Dexcom G5, with the errors of Vettoretti et al. (2018).

    The model holds between two calibrations, 12 h apart, and its process advances every 5 min: see `Facchinetti2014`.

    M. Vettoretti et al., IEEE Trans. Biomed. Eng. 65(6), 2018, doi:10.1109/tbme.2017.2746340.
    """

    sources = ("vettoretti2018", "facchinetti2014")
    model: ClassVar = ErrorModel(
        gain=(1.04, 0.02, 0.0),
        offset_mg_dl=(-8.75, 0.0, 0.0),
        processes=(Process(alpha1=1.27, alpha2=-0.42, variance=7.64),),
        calibrated_every_min=720.0,
    )
    wear_min: float = 7.0 * MIN_PER_DAY


class DexcomG6(Monitor, name="dexcom-g6"):
    """Dexcom G6, with the mean errors of Vettoretti et al. (EMBC 2019).

    Table 1 and 2 of the paper, with a process of each sensor and one that sensors on the same person have in common. It
    was found with 11 people who wore two sensors each. The processes advance every 5 min: see `Facchinetti2014`. How
    sensors differ from one another is in `Vettoretti2019`.

    M. Vettoretti, S. Del Favero, G. Sparacino, A. Facchinetti, "Modeling the error of factory-calibrated continuous
    glucose monitoring sensors: application to Dexcom G6 sensor data", 41st Conf. IEEE EMBC, 2019,
    doi:10.1109/embc.2019.8856790.
    """

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
    """Factory-calibrated sensors that differ, drawn for each person and wear, of Vettoretti et al. (Sensors 2019).

    Each sensor has its gain over ten days of wear, its offset, and its process, which advances every 5 min. The seven
    numbers are normal, with a covariance 0.9 times that found, so that none is too far off; a sensor whose process is
    not stable, with a margin of 0.02, or whose noise has a standard deviation above 10 mg/dl, is drawn again. 73 % are
    taken.

    M. Vettoretti, C. Battocchio, G. Sparacino, A. Facchinetti, "Development of an error model for a factory-calibrated
    continuous glucose monitoring sensor with 10-day lifetime", Sensors 19(23), 5320, 2019, doi:10.3390/s19235320: mean
    and covariance of a0, a1, a2, b0, alpha1, alpha2, sigma. The factor and the bounds are those of the simulator
    ReplayBG.
    """

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


_PARTIAL_CORRELATION: Final = 0.7


class Breton2008(Monitor, name="breton-2008"):
    """FreeStyle Navigator, with the errors of Breton and Kovatchev (2008).

    A first-order process with the correlation 0.7 from one reference to the next, which lie 15 min apart, and a
    transformation that gives it the distribution found, with more large errors than a normal one::

        e(k) = 0.7 (e(k-1) + n(k)),    error = xi + lambda sinh((e - gamma) / delta)

    The paper prints a mean error of 0.76 and a standard deviation of 11 mg/dl. With a normal variable of variance 1
    these constants have the mean 0.76, as they were fitted to the distribution alone; with the process, whose variance
    is 0.96, 0.72 and 11.7 mg/dl. Its first point is drawn as the later ones are distributed, as of a sensor that has
    been worn.

    Between the points, 15 min apart, the error is on the straight line from one to the next; others have put cubic
    polynomials there. Sensor and skin together were found to be late by a lag of 5 min.

    M. Breton, B. Kovatchev, "Analysis, modeling, and simulation of the accuracy of continuous glucose sensors", J.
    Diabetes Sci. Technol. 2(5), 853-862, 2008.
    """

    sources = ("breton2008",)
    model: ClassVar = ErrorModel(
        processes=(Process(alpha1=_PARTIAL_CORRELATION, alpha2=0.0, variance=_PARTIAL_CORRELATION**2),),
        shape=Johnson(xi=-5.471, scale=15.9574, gamma=-0.5444, delta=1.6898),
        step_min=15.0,
        lag_min=5.0,
    )
    warm_up_min: float = 600.0
    wear_min: float = 5.0 * MIN_PER_DAY
