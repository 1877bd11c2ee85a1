"""Variation of parameters from person to person, each by itself or several together.

Every distribution is bounded, so that the possible values of a population are known before it is drawn: uniform between
two values; normal and lognormal within three standard deviations of their median. Bounds given by the user narrow it
further. Values come from the inverse of the truncated distribution function, so that one uniform number makes one
value.

Several parameters have a joint normal distribution, as an identification of people gives it: a person's numbers are
drawn as one vector, ``mean + L z`` with the Cholesky factor L of the covariance and independent standard normal z, on
the linear scale or of the logarithms. A vector with a value beyond three standard deviations of its own, or beyond a
bound that is given, is drawn again as a whole, so that what is left keeps its shape within a box that is known
beforehand. Attempt k of a person is a function of seed, names, person and k alone. The factor is computed here and not
by LAPACK, whose result depends on the machine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

from glucoloop._lazy_jax import np, npt, scipy
from glucoloop.refusal import Refusal
from glucoloop.threefry import uniforms

Values: TypeAlias = "npt.NDArray[np.float64]"

DISTRIBUTIONS: Final = ("uniform", "normal", "lognormal")
TRUNCATION_SD: Final = 3.0
"""Number of standard deviations from the median within which a normal or lognormal value lies."""
LARGEST_SPREAD_PCT: Final = 1000.0


def _bounded(name: str, low: float, high: float, lower: float | None, upper: float | None) -> tuple[float, float]:
    """Ends of a distribution within bounds that may be given; Refusal where they leave nothing."""
    least = low if lower is None else max(low, lower)
    most = high if upper is None else min(high, upper)
    if not least < most:
        raise Refusal(f"{name} varies from {low:g} to {high:g}, of which its bounds leave nothing; move lower or upper")
    return least, most


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
        return Distribution(self.distribution, centre, scale, *_bounded(name, low, high, self.lower, self.upper))


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


SCALES: Final = ("linear", "log")
MAX_PARAMETERS: Final = 100
MAX_ATTEMPTS: Final = 1000
"""Number of vectors after which a distribution is refused whose box holds next to none."""
_SYMMETRIC: Final = 1e-9
"""Largest difference of two entries across the diagonal, as a share of their standard deviations."""
_MIN_PIVOT: Final = 1e-10
"""Minimum share of a variance that others may leave unexplained."""


@dataclass(frozen=True, kw_only=True)
class JointVariation:
    """Several parameters that vary together.

    Parameters
    ----------
    parameters : tuple of str
        Names of the parameters, as of a `Variation`.
    mean : tuple of float, optional
        Mean of each, in its own unit; on the scale ``"log"`` the median. The nominal values by default.
    covariance : tuple of tuple of float
        Covariance of the values in their units; on the scale ``"log"`` that of the natural logarithms.
    scale : {"linear", "log"}
        Whether the values or their logarithms are normal.
    lower, upper : tuple of float, optional
        Bounds of each in its own unit; a vector with a value beyond one is drawn again.

    Raises
    ------
    ValueError
        For parameters that are named twice, numbers that do not fit them, or a covariance that is not symmetric and
        positive definite.
    """

    parameters: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...]
    mean: tuple[float, ...] | None = None
    scale: str = "linear"
    lower: tuple[float, ...] | None = None
    upper: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        n = len(self.parameters)
        if not 1 <= n <= MAX_PARAMETERS:
            raise Refusal(f"{n} parameters cannot vary together; name 1 to {MAX_PARAMETERS}")
        for name in self.parameters:
            if self.parameters.count(name) > 1:
                raise Refusal(f"{name} is varied twice; leave one out")
        if self.scale not in SCALES:
            raise Refusal(f"unknown scale {self.scale!r}; the known ones are: {', '.join(SCALES)}")
        for what in ("mean", "lower", "upper"):
            values = getattr(self, what)
            if values is not None and not (len(values) == n and all(map(math.isfinite, values))):
                raise Refusal(f"{what} is {list(values)}; give a finite number for each of the {n} parameters")
        if [len(row) for row in self.covariance] != [n] * n:
            raise Refusal(f"the covariance of {n} parameters has {n} rows of {n} numbers; give as many")
        self.factor()

    def factor(self) -> tuple[tuple[float, ...], ...]:
        """Cholesky factor, lower rows; Refusal for a covariance that is not symmetric and positive definite."""
        C, names = self.covariance, self.parameters
        sd = []
        for i, name in enumerate(names):
            if not 0.0 < C[i][i] < math.inf:
                raise Refusal(f"the variance of {name} is {C[i][i]:g}; give a finite value above 0")
            sd.append(math.sqrt(C[i][i]))
        L: list[list[float]] = []
        for i, name in enumerate(names):
            row: list[float] = []
            for j in range(i):
                if not abs(C[i][j] - C[j][i]) <= _SYMMETRIC * sd[i] * sd[j]:
                    raise Refusal(
                        f"the covariance of {names[j]} and {name} is {C[j][i]:g} in one place and {C[i][j]:g} in "
                        "another; make the matrix symmetric"
                    )
                row.append((C[i][j] - math.fsum(a * b for a, b in zip(row, L[j][:j], strict=True))) / L[j][j])
            left = C[i][i] - math.fsum(a * a for a in row)
            if not left > _MIN_PIVOT * C[i][i]:
                raise Refusal(
                    f"the covariance is not positive definite: {name} would vary less than {', '.join(names[:i])} "
                    "make it; check its signs and the size of its correlations"
                )
            L.append([*row, math.sqrt(left)])
        return tuple(map(tuple, L))

    def distributions(self, nominal: Mapping[str, float]) -> dict[str, Distribution]:
        """Distribution of each parameter alone, within its bounds.

        Raises
        ------
        ValueError
            For a logarithm of a mean that is not positive, or bounds between which nothing lies.
        """
        result = {}
        for i, name in enumerate(self.parameters):
            centre = nominal[name] if self.mean is None else self.mean[i]
            sd = math.sqrt(self.covariance[i][i])
            reach = TRUNCATION_SD * sd
            if self.scale == "log":
                if not centre > 0.0:
                    raise Refusal(f"{name} varies on the scale log about {centre:g}; give a mean above 0")
                low, high = centre * math.exp(-reach), centre * math.exp(reach)
            else:
                low, high = centre - reach, centre + reach
            bounds = (None if ends is None else ends[i] for ends in (self.lower, self.upper))
            kind = "lognormal" if self.scale == "log" else "normal"
            result[name] = Distribution(kind, centre, sd, *_bounded(name, low, high, *bounds))
        return result

    def values(self, nominal: Mapping[str, float], seed: int, person: npt.NDArray[np.int64]) -> dict[str, Values]:
        """Values ``(n,)`` of each parameter for persons; Refusal if the bounds leave next to nothing of a vector."""
        within, L = self.distributions(nominal), self.factor()
        drawn = np.empty((len(self.parameters), person.size))
        left = np.arange(person.size)
        for attempt in range(MAX_ATTEMPTS):
            if not left.size:
                return dict(zip(self.parameters, drawn, strict=True))
            z = [
                scipy.special.ndtri(uniforms(seed, f"joint {name}", person[left], attempt)) for name in self.parameters
            ]
            accepted = np.ones(left.size, dtype=bool)
            for i, distribution in enumerate(within.values()):
                deviation = np.zeros(left.size)
                for factor, score in zip(L[i], z, strict=False):
                    deviation = deviation + factor * score
                centre = distribution.centre
                value = centre * np.exp(deviation) if self.scale == "log" else centre + deviation
                accepted &= (value >= distribution.lower) & (value <= distribution.upper)
                drawn[i, left] = value
            left = left[~accepted]
        raise Refusal(
            f"none of {MAX_ATTEMPTS} vectors of {', '.join(self.parameters)} lies within the bounds; widen them"
        )
