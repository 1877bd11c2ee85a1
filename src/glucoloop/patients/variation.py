"""Variation of one parameter from person to person.

Every distribution is bounded, so that the possible values of a population are known before it is drawn: uniform between
two values; normal and lognormal within three standard deviations of their median. Bounds given by the user narrow it
further. Values come from the inverse of the truncated distribution function, so that one uniform number makes one
value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

from glucoloop._lazy_jax import np, npt, scipy
from glucoloop.refusal import Refusal

Values: TypeAlias = "npt.NDArray[np.float64]"

DISTRIBUTIONS: Final = ("uniform", "normal", "lognormal")
TRUNCATION_SD: Final = 3.0
"""Number of standard deviations from the median within which a normal or lognormal value lies."""
LARGEST_SPREAD_PCT: Final = 1000.0


@dataclass(frozen=True, kw_only=True)
class Variation:
    """One parameter, varied independently of the others.

    Parameters
    ----------
    parameter : str
        A constant of the patient such as ``"F_LC"`` or ``"M_IHGP.inflection"``; ``"M_IHGP.strength"``, the factor on a
        whole effect, nominally 1; or ``"weight_kg"``, nominally 70.
    distribution : str
        ``"uniform"``: between centre - spread and centre + spread. ``"normal"``: the spread is the standard deviation.
        ``"lognormal"``: the centre is the median and the spread the coefficient of variation, in percent.
    spread_pct : float, optional
        Spread relative to the centre; this or `spread`.
    spread : float, optional
        Spread in the unit of the parameter; not for a lognormal.
    centre : float, optional
        Centre of the distribution; the nominal value by default.
    lower, upper : float, optional
        Bounds in the unit of the parameter, beyond which no value is drawn.

    Raises
    ------
    ValueError
        For an unknown distribution, a spread that is missing, given twice or not positive, or a bound that is not
        finite.
    """

    parameter: str
    distribution: str
    spread_pct: float | None = None
    spread: float | None = None
    centre: float | None = None
    lower: float | None = None
    upper: float | None = None

    def __post_init__(self) -> None:
        name = self.parameter
        if self.distribution not in DISTRIBUTIONS:
            known = ", ".join(DISTRIBUTIONS)
            raise Refusal(f"unknown distribution {self.distribution!r} of {name}; the known ones are: {known}")
        if (self.spread_pct is None) == (self.spread is None):
            raise Refusal(f"{name} needs one spread; give spread_pct, in percent of its centre, or spread")
        if self.distribution == "lognormal" and self.spread_pct is None:
            raise Refusal(f"{name} is lognormal; give its coefficient of variation as spread_pct instead of spread")
        if self.spread_pct is not None and not 0.0 < self.spread_pct <= LARGEST_SPREAD_PCT:
            raise Refusal(
                f"spread_pct of {name} is {self.spread_pct:g}; give more than 0 and at most {LARGEST_SPREAD_PCT:g}"
            )
        if self.spread is not None and not 0.0 < self.spread < math.inf:
            raise Refusal(f"spread of {name} is {self.spread:g}; give a finite value above 0")
        for what in ("centre", "lower", "upper"):
            value = getattr(self, what)
            if value is not None and not math.isfinite(value):
                raise Refusal(f"{what} of {name} is {value:g}; give a finite value, or leave it out")

    def around(self, nominal: float) -> Distribution:
        """Distribution of the values about a nominal one, or about the centre if that is given.

        Raises
        ------
        ValueError
            For a spread relative to a centre of 0, a lognormal whose centre is not positive, or bounds between which
            nothing can be drawn.
        """
        centre = nominal if self.centre is None else self.centre
        name, relative = self.parameter, self.spread_pct or 0.0
        if self.distribution == "lognormal":
            if not centre > 0.0:
                raise Refusal(f"{name} is lognormal about {centre:g}; give a centre above 0, or another distribution")
            scale = math.sqrt(math.log1p((relative / 100.0) ** 2))
            low, high = (centre * math.exp(sign * TRUNCATION_SD * scale) for sign in (-1.0, 1.0))
        else:
            if self.spread is None and centre == 0.0:
                raise Refusal(f"{name} varies about 0, of which a percentage is nothing; give spread instead")
            scale = self.spread if self.spread is not None else abs(centre) * relative / 100.0
            reach = scale if self.distribution == "uniform" else TRUNCATION_SD * scale
            low, high = centre - reach, centre + reach
        lower = low if self.lower is None else max(low, self.lower)
        upper = high if self.upper is None else min(high, self.upper)
        if not lower < upper:
            raise Refusal(
                f"{name} varies from {low:g} to {high:g}, of which its bounds leave nothing; move lower or upper"
            )
        return Distribution(self.distribution, centre, scale, lower, upper)


@dataclass(frozen=True)
class Distribution:
    """A bounded distribution of one parameter, as `Variation.around` makes it."""

    kind: str
    centre: float
    scale: float
    """Half width, standard deviation, or standard deviation of the logarithm."""
    lower: float
    upper: float

    @property
    def in_words(self) -> str:
        """The values that are possible, after the name of the parameter."""
        one = self.lower == self.upper
        return f"is {self.lower:g}" if one else f"can vary from {self.lower:g} to {self.upper:g}"

    @property
    def mend(self) -> str:
        """Remedy for a value that is not possible."""
        one = self.lower == self.upper
        return "give another value" if one else "narrow its spread, or give lower and upper"

    def values(self, uniform: Values) -> Values:
        """Values ``(n,)`` for uniform numbers ``(n,)`` between 0 and 1: the inverse of the distribution function."""
        if self.kind == "uniform":
            drawn = self.lower + (self.upper - self.lower) * uniform
        else:
            below, above = self.probabilities
            score = scipy.special.ndtri(below + (above - below) * uniform)
            deviation = self.scale * score
            drawn = self.centre * np.exp(deviation) if self.kind == "lognormal" else self.centre + deviation
        return np.clip(drawn, self.lower, self.upper)

    @property
    def probabilities(self) -> tuple[float, float]:
        """Probabilities of a value below the two bounds, for a normal or lognormal distribution without bounds."""
        return float(scipy.special.ndtr(self._score(self.lower))), float(scipy.special.ndtr(self._score(self.upper)))

    def _score(self, value: float) -> float:
        """Distance of a value from the median in standard deviations."""
        if self.kind == "lognormal":
            return math.log(value / self.centre) / self.scale
        return (value - self.centre) / self.scale


def refuse_not_positive(varied: Mapping[str, Distribution]) -> None:
    """Refuse distributions of parameters that have to stay above 0."""
    for name, distribution in varied.items():
        if not distribution.lower > 0.0:
            raise Refusal(f"{name} {distribution.in_words} but must stay above 0; {distribution.mend}")
