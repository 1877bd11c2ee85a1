"""Interval in which the steady-state gain of a person lies according to a record, whatever model is fitted to it.

The response to insulin is taken as a sum of responses with time constants from 8 min to .3 times the length of the
record, unlike a model, whose few functions may end before it. Its weights have a Gaussian prior that is smooth over the
logarithm of the time constant. Where the slowest response ends, how large the gain is and how the errors of the
readings go on in time (white noise, or a disturbance that lasts for minutes to days beside it) are not known: each
combination on a grid counts by its marginal likelihood, so that the interval is as wide as what the record leaves open.
A person responds less, or more, the farther glucose is from rest: beside the responses stands the square of the
likeliest one, with a prior of its own. A response that is slower than the record can show is not seen.

G. Pillonetto, F. Dinuzzo, T. Chen, G. De Nicolao, L. Ljung, "Kernel methods in system identification, machine learning
and function estimation: a survey", Automatica 50(3), 657-682, 2014. J. A. Hoeting, D. Madigan, A. E. Raftery, C. T.
Volinsky, "Bayesian model averaging: a tutorial", Statistical Science 14(4), 382-417, 1999. G. E. P. Box, G. M. Jenkins,
G. C. Reinsel, G. M. Ljung, Time Series Analysis, 5th ed., 2015, ch. 3, on the errors.
"""

from __future__ import annotations

import itertools
from typing import Final

import numpy as np
import numpy.typing as npt

from glucoloop._lazy_jax import scipy
from glucoloop.identification.impulse_response import from_rest

Floats = npt.NDArray[np.float64]

CONFIDENCE: Final = 0.95
_FASTEST_MIN: Final = 8.0
_SLOWEST: Final = 0.3
"""Longest time constant, in lengths of the record."""
_SLOWEST_MIN: Final = 1500.0
"""Longest time constant of any record, twice the slowest of Hovorka's patient."""
_PER_DOUBLING: Final = 2
"""Number of time constants in a doubling."""
_LENGTH_LOG: Final = 0.5
"""Distance of logarithms of time constants over which the weights are alike."""
_COMMON: Final = (0.0, 0.8)
"""Correlation of all weights with each other: that of responses of either sign, and of responses of mostly one."""
_GAINS: Final[Floats] = 2.0 ** np.arange(-1.0, 5.0)
"""Standard deviations of the prior of the gain, in units of mean glucose for the mean rate of insulin."""
_NOISES: Final = (
    (0.0, 0.0),
    *(
        (ar, ar * (1.0 - share))
        for ar, share in itertools.product((0.8, 0.95, 0.99, 1.0), (0.01, 0.03, 0.1, 0.3, 0.6, 1.0, 1.4, 1.8))
    ),
)
"""Coefficients of autoregressive moving averages of the first order: white noise, beside what decays by `ar` a sample.
"""
_SLOWER: Final = 0.25
"""Power of the slowest time constant to which a shape is likely before the record: 0 would be uniform over logarithms,
by which a slow end of the response is missed too often, and 1 uniform over times.
"""
_BEND: Final = 0.25
"""Standard deviation of the prior of the square, in parts of the response, where the response is largest; the gain then
changes by twice that."""
_LEAST_NOISE_MG_DL: Final = 1e-6
"""Least standard deviation of the errors; rounding makes less."""
_NEGLIGIBLE: Final = 1e-9
"""Share of the largest singular value, or of all weight, below which others are left out."""
_ITERATIONS: Final = 4
"""Iterations for the variance of the noise, each of which improves it."""


def gain_interval(
    insulin_deviation: Floats,
    readings_mg_dl: Floats,
    other_columns: Floats,
    *,
    sample_time_min: float,
    gain_scale: float,
    starts_at_rest: bool,
) -> tuple[float, float]:
    """Ends of the 95 % interval of the gain [mg/dl per mU/min].

    Insulin ``(N,)`` is of the whole record, and the readings ``(n,)`` are its last ones; `other_columns` ``(n, K)`` is
    what moves them besides, like meals. `gain_scale` is a usual gain, mean glucose for the mean rate of insulin. Where
    the record is too short for any interval, or the response probably is slower than the readings can show, as few
    are left of a record that does not start at rest, it is from minus to plus the largest gain that is thought of.
    """
    from scipy.optimize import brentq

    taus_min = _time_constants(insulin_deviation.size * sample_time_min)
    responses = _responses(insulin_deviation, sample_time_min, taus_min)[-readings_mg_dl.size :]
    unknown = np.column_stack([other_columns, np.ones(readings_mg_dl.size)])
    deviations = _GAINS * gain_scale
    nothing_known = -float(deviations[-1]), float(deviations[-1])
    if not starts_at_rest:  # what is left of insulin before the record
        t_min = sample_time_min * np.arange(readings_mg_dl.size)
        unknown = np.column_stack([unknown, np.exp(-t_min / taus_min[-1])])
    if readings_mg_dl.size <= unknown.shape[1] + 1:
        return nothing_known
    priors, slowest_min = _priors(taus_min)
    likely = np.tile(np.repeat(_SLOWER * np.log(slowest_min), deviations.size), len(_NOISES))
    shares, _, logs = _posteriors(readings_mg_dl, unknown, responses, priors, deviations, taus_min.size)
    weights = np.exp(logs - logs.max())
    shown_min = _SLOWEST * readings_mg_dl.size * sample_time_min
    too_slow = np.tile(np.repeat(slowest_min > shown_min, deviations.size), len(_NOISES))
    if weights[too_slow].sum() > 0.5 * weights.sum():
        return nothing_known
    likeliest = int(np.argmax(logs + likely))
    bend = _squared(responses @ shares[likeliest]) / deviations[likeliest % deviations.size]
    responses, priors = np.column_stack([responses, bend]), _with_one_more(priors)
    shares, errors, logs = _posteriors(readings_mg_dl, unknown, responses, priors, deviations, taus_min.size)
    logs += likely
    means, weights = shares[:, : taus_min.size].sum(axis=1), np.exp(logs - logs.max())
    counted = weights > _NEGLIGIBLE * weights.sum()
    means, errors, weights = means[counted], errors[counted], weights[counted] / weights[counted].sum()
    freedom = readings_mg_dl.size - unknown.shape[1]

    def end(share: float) -> float:
        ends, beyond = means + scipy.special.stdtrit(freedom, share) * errors, 0.01 * errors.max()
        return float(
            brentq(
                lambda x: float(weights @ scipy.special.stdtr(freedom, (x - means) / errors)) - share,
                ends.min() - beyond,
                ends.max() + beyond,
            )
        )

    return end((1.0 - CONFIDENCE) / 2.0), end((1.0 + CONFIDENCE) / 2.0)


def _time_constants(length_min: float) -> Floats:
    slowest_min = min(_SLOWEST * length_min, _SLOWEST_MIN)
    halvings = max(_PER_DOUBLING * 2, int(_PER_DOUBLING * np.log2(max(slowest_min / _FASTEST_MIN, 1.0))))
    taus: Floats = slowest_min * 2.0 ** (-np.arange(halvings, -1, -1) / _PER_DOUBLING)
    return taus


def _responses(insulin: Floats, sample_time_min: float, taus_min: Floats) -> Floats:
    """Responses ``(N + 1, taus)`` of two lags one after the other, with a gain of 1, to insulin from rest."""
    t = sample_time_min * np.arange(insulin.size + 1) / taus_min[:, None]
    return from_rest(insulin, np.diff(1.0 - (1.0 + t) * np.exp(-t), axis=1))


def _priors(taus_min: Floats) -> tuple[Floats, Floats]:
    """Factors ``(shapes, taus, taus)`` of covariances of the weights, and the slowest time constant of each shape.

    The variance of the gain is 1.
    """
    logs = np.log(taus_min)
    near = np.exp(-0.5 * ((logs[:, None] - logs) / _LENGTH_LOG) ** 2) + 1e-6 * np.eye(logs.size)
    factors, slowest_min = [], []
    for common, last in itertools.product(_COMMON, range(2, logs.size + 1)):
        factor = np.zeros_like(near)
        factor[:last, :last] = np.linalg.cholesky(common + (1.0 - common) * near[:last, :last])
        factors.append(factor / np.linalg.norm(factor.sum(axis=0)))
        slowest_min.append(taus_min[last - 1])
    return np.array(factors), np.array(slowest_min)


def _squared(response: Floats) -> Floats:
    """Square of a response, as large as the prior has it where the response is largest."""
    largest = np.abs(response).max()
    return np.zeros_like(response) if largest == 0.0 else _BEND * response**2 / largest


def _with_one_more(priors: Floats) -> Floats:
    """Priors with one more weight, whose variance is 1."""
    factors = np.pad(priors, ((0, 0), (0, 1), (0, 1)))
    factors[:, -1, -1] = 1.0
    return factors


def _posteriors(
    readings_mg_dl: Floats, unknown: Floats, responses: Floats, priors: Floats, deviations: Floats, of_insulin: int
) -> tuple[Floats, Floats, Floats]:
    """Shares of the responses, standard error of the gain and log marginal likelihood, of each combination.

    The gain is the sum of the first shares, of which there are `of_insulin`.
    """
    from scipy.signal import lfilter

    table = np.column_stack([readings_mg_dl - readings_mg_dl[0], unknown, responses])
    parts = []
    for ar, ma in _NOISES:
        white = lfilter([1.0, -ar], [1.0, -ma], table, axis=0)
        readings, others, responding = np.split(white, [1, 1 + unknown.shape[1]], axis=1)
        parts.append(_posterior(readings[:, 0], others, responding, priors, deviations, of_insulin))
    shares, errors, logs = (np.concatenate(part) for part in zip(*parts, strict=True))
    return shares, errors, logs


def _posterior(
    readings: Floats, unknown: Floats, responses: Floats, priors: Floats, deviations: Floats, of_insulin: int
) -> tuple[Floats, Floats, Floats]:
    """Mean shares of the responses, error of the gain and log marginal likelihood, of each prior, for white errors.

    What is `unknown` has coefficients of any size. The variance of the errors is where the likelihood is greatest.
    """
    left, sizes, _ = np.linalg.svd(unknown, full_matrices=False)
    left, sizes = left[:, sizes > _NEGLIGIBLE * sizes[0]], sizes[sizes > _NEGLIGIBLE * sizes[0]]
    readings = readings - left @ (left.T @ readings)
    responses = responses - left @ (left.T @ responses)
    freedom, transposed = readings.size - sizes.size, np.swapaxes(priors, 1, 2)
    squares, directions = np.linalg.eigh(transposed @ (responses.T @ responses) @ priors)
    rotated = np.swapaxes(directions, 1, 2) @ transposed
    squares = np.maximum(squares, 0.0)[:, None]
    projected = (rotated @ (responses.T @ readings))[:, None]
    of_gain = rotated[..., :of_insulin].sum(axis=-1)[:, None]
    prior, total = deviations[:, None] ** 2, float(readings @ readings)
    variance = np.full((len(priors), deviations.size), max(total / freedom, _LEAST_NOISE_MG_DL**2))
    for _ in range(_ITERATIONS):
        shares = 1.0 / (variance[..., None] / prior + squares)
        variance = np.maximum((total - (projected**2 * shares).sum(axis=-1)) / freedom, _LEAST_NOISE_MG_DL**2)
    shares = 1.0 / (variance[..., None] / prior + squares)
    misfit = total - (projected**2 * shares).sum(axis=-1)
    log = (
        -0.5 * np.log1p(squares * prior / variance[..., None]).sum(axis=-1)
        - 0.5 * (freedom * np.log(variance) + misfit / variance)
        - np.log(sizes).sum()
    )
    mean = (projected * shares) @ rotated
    error = np.sqrt(variance * (of_gain**2 * shares).sum(axis=-1))
    return mean.reshape(-1, mean.shape[-1]), error.ravel(), log.ravel()
