"""Sensitivity to insulin over the day and from day to day, as Visentin et al. (2015) find it.

In each of three periods, from 04:00, 11:00 and 17:00, a person's sensitivity is high, which is the person's own, or
low, 0.4 times that. Which of seven patterns people have, they find from measurements at three meals of the day. From
day to day the factor of each period is multiplied by a normal number of mean 1 and standard deviation 0.2, which is
drawn within three standard deviations here. The period after midnight is still that of the evening before.

In the simulator of the paper the factor acts on the constants kp3 and Vmx, by which insulin acts on the liver and on
tissue. Which constants they are in another model is what its patient declares as ``insulin_sensitivity``.

References
----------
R. Visentin, C. Dalla Man, Y. C. Kudva, A. Basu, C. Cobelli, "Circadian variability of insulin sensitivity:
physiological input for in silico artificial pancreas", Diabetes Technol. Ther. 17(1), 2015, 1-7.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from glucoloop._lazy_jax import np, npt, scipy
from glucoloop.component.setting import About
from glucoloop.physiology.rhythm import Changes, Floats, RhythmComponent
from glucoloop.threefry import uniforms
from glucoloop.units import MIN_PER_DAY

PERIODS_MIN: Final = (240.0, 660.0, 1020.0)
"""Time of day at which each period begins."""
PROBABILITIES: Final = {"hhh": 0.10, "hhl": 0.05, "hlh": 0.05, "hll": 0.10, "lhh": 0.20, "lhl": 0.20, "llh": 0.30}
FACTORS: Final = {"h": 1.0, "l": 0.4}
_WITHIN_SD: Final = 3.0


class Visentin2015(RhythmComponent, name="visentin-2015"):
    """Sensitivity to insulin in one of seven patterns over the day, of Visentin et al. (2015), and daily noise."""

    sources = ("visentin2015",)
    pattern: Annotated[
        Literal["drawn", "hhh", "hhl", "hlh", "hll", "lhh", "lhl", "llh"],
        About(
            "Sensitivity in the morning, the afternoon and the evening, high or low; drawn: by the published "
            "probabilities for each person."
        ),
    ] = "drawn"
    day_spread_pct: Annotated[
        float,
        About("Standard deviation of sensitivity from day to day, drawn for each period.", at_least=0.0, at_most=30.0),
    ] = 20.0

    def changes(self, clock_min: Floats, seed: int, person: npt.NDArray[np.int64]) -> Changes:
        """Factors on sensitivity ``(n, people)``."""
        # the periods since that of the evening before the first midnight
        day, minute = np.divmod(np.asarray(clock_min, float), MIN_PER_DAY)
        number = 3 * day.astype(int) + np.searchsorted(PERIODS_MIN, minute, side="right")
        highs = np.array([[FACTORS[letter] for letter in pattern] for pattern in PROBABILITIES])
        levels = highs[patterns_of(self.pattern, seed, person)]
        periods, which = np.unique(number, return_inverse=True)
        factors = levels[:, (periods - 1) % 3].T
        if self.day_spread_pct > 0.0:
            below = scipy.special.ndtr(-_WITHIN_SD)
            for row, period in enumerate(periods):
                uniform = uniforms(seed, "sensitivity of a period", person, int(period))
                deviation = scipy.special.ndtri(below + (1.0 - 2.0 * below) * uniform)
                factors[row] *= 1.0 + self.day_spread_pct / 100.0 * deviation
        return Changes(sensitivity=factors[which])


def patterns_of(pattern: str, seed: int, person: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
    """Place of each person's pattern ``(people,)`` among `PROBABILITIES`."""
    if pattern != "drawn":
        return np.full(person.size, list(PROBABILITIES).index(pattern))
    least = np.cumsum(list(PROBABILITIES.values()))[:-1]
    return np.searchsorted(least, uniforms(seed, "pattern of sensitivity", person), side="right")
