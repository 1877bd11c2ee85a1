"""Abbott FreeStyle Navigator, its errors of Breton and Kovatchev (2008).

A first-order process with the correlation 0.7 from one reference to the next, which lie 15 min apart, and a
transformation that gives it the distribution found, with more large errors than a normal one::

    e(k) = 0.7 (e(k-1) + n(k)),    error = xi + lambda sinh((e - gamma) / delta)

The paper prints a mean error of 0.76 and a standard deviation of 11 mg/dl. With a normal variable of variance 1 these
constants have the mean 0.76, as they were fitted to the distribution alone; with the process, whose variance is 0.96,
0.72 and 11.7 mg/dl. Its first point is drawn as the later ones are distributed, as of a sensor that has been worn.

Between the points, 15 min apart, the error is on the straight line from one to the next; others have put cubic
polynomials there. Sensor and skin together were found to be late by a lag of 5 min.

M. Breton, B. Kovatchev, "Analysis, modeling, and simulation of the accuracy of continuous glucose sensors", J. Diabetes
Sci. Technol. 2(5), 853-862, 2008.
"""

from typing import ClassVar, Final

from glucoloop.sensors.cgm.model import ErrorModel, Johnson, Process
from glucoloop.sensors.cgm.monitor import Monitor
from glucoloop.units import MIN_PER_DAY

_PARTIAL_CORRELATION: Final = 0.7


class Breton2008(Monitor, name="breton-2008"):
    """FreeStyle Navigator, with the errors of Breton and Kovatchev (2008)."""

    sources = ("breton2008",)
    model: ClassVar = ErrorModel(
        processes=(Process(alpha1=_PARTIAL_CORRELATION, alpha2=0.0, variance=_PARTIAL_CORRELATION**2),),
        shape=Johnson(xi=-5.471, scale=15.9574, gamma=-0.5444, delta=1.6898),
        step_min=15.0,
        lag_min=5.0,
    )
    warm_up_min: float = 600.0
    wear_min: float = 5.0 * MIN_PER_DAY
