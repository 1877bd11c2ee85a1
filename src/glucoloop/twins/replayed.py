"""People of a replay: a twin, both ends of its sensitivity, and people whom the record and the model leave open.

What other doses do is not what forecasts of a record tell: where half of the meals are not entered, a twin explains by
an unexplained appearance what its equations lack. So in a replay the sensitivity to insulin is a part of that of the
twin, and the time constant of what returns glucose to its mean (`r` of `twins.extended`) the geometric mean of the one
that was found and one that is assumed. Each person drawn has another factor on both, beside the posterior of the twin::

    sensitivity = .7 exp(.6 z_1),    time constant = sqrt(120 min * that of the draw) exp(.6 z_2)

The four numbers were chosen on simulated people of two other families, whose true changes are known
(``validation/replay_truth.py``, seeds 101 to 108). People of another family answered more, so that the twin as it was
found, with all of its sensitivity and no return, is there too. The scores `z` are stratified (Latin
hypercube), so that few people reach as far as many.

References
----------
M. D. McKay, R. J. Beckman, W. J. Conover, "A comparison of three methods for selecting values of input variables in the
analysis of output from a computer code", Technometrics 21(2), 1979, 239-245: the stratified scores.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from glucoloop.forecasts.grid import GriddedRecord
from glucoloop.refusal import Refusal
from glucoloop.twins.extended import ExtendedPatient
from glucoloop.twins.stored import StoredTwin
from glucoloop.twins.unexplained import Explained, explained

Values = npt.NDArray[np.float64]

SENSITIVITIES: Final = (0.5, 1.5)
"""Factors on the sensitivity to insulin, whose replays are shown."""
_SENSITIVITY: Final = 0.7
_SENSITIVITY_LOG_SD: Final = 0.6
_RETURN_MIN: Final = 120.0
_RETURN_LOG_SD: Final = 0.6
_NEVER_MIN: Final = 1e5
_RANGE_PCT: Final = (5.0, 95.0)


class ReplayPerson(NamedTuple):
    """Person of a replay."""

    patient: ExtendedPatient
    p: Values
    end: float | None = None
    """Factor on the sensitivity of the first person; None for others than the ends."""
    drawn: bool = False


class ExplainedPerson(NamedTuple):
    """Person of a replay who gives the record."""

    patient: ExtendedPatient
    p: Values
    end: float | None
    drawn: bool
    explained: Explained


def replay_people(twin: StoredTwin, draws: int, seed: int) -> Iterator[ReplayPerson]:
    """The twin of a replay, both ends of its sensitivity where its patient declares one, the twin as found, drawn ones.

    The last but the drawn has all of the twin's sensitivity, and nothing returns its glucose.
    """
    scores = _normal_scores(np.random.default_rng(seed), draws, twin.p.size + 2)

    def person(p: Values, factor: float, time_factor: float, *kind: Any) -> ReplayPerson:
        return_min = time_factor * math.sqrt(_RETURN_MIN * float(twin.patient.noises(p)["return_min"]))
        patient = twin.patient.with_sensitivity(_SENSITIVITY * factor)
        return ReplayPerson(patient, patient.with_return(p, return_min), *kind)

    yield person(twin.p, 1.0, 1.0)
    for end in SENSITIVITIES if twin.patient.sensitive.any() else ():
        yield person(twin.p, end, 1.0, end)
    yield ReplayPerson(twin.patient, twin.patient.with_return(twin.p, _NEVER_MIN))
    for row in scores:
        factors = np.exp(row[-2:] * (_SENSITIVITY_LOG_SD, _RETURN_LOG_SD))
        yield person(twin.p + twin.factor @ row[:-2], *map(float, factors), None, True)


def explained_people(
    people: Sequence[ReplayPerson],
    record: GriddedRecord,
    mean_mg_dl: float,
    tell: Callable[[int], None] = lambda number: None,
) -> list[ExplainedPerson]:
    """People of a replay who give a record, the twin first; who cannot is left out.

    `mean_mg_dl` is that of the twin, and `tell` is called with the number of people who were tried. Refusal where the
    twin itself cannot.
    """
    result = list[ExplainedPerson]()
    for number, person in enumerate(people):
        try:
            result.append(ExplainedPerson(*person, explained(person.patient, person.p, record, mean_mg_dl)))
        except Refusal:
            if not number:
                raise
        tell(number + 1)
    return result


def change_range(values: Values, drawn: Sequence[bool]) -> tuple[Values, Values]:
    """Lowest and highest of values ``(people, ...)``: of all who are not drawn, and of nine of ten who are."""
    is_drawn = np.asarray(drawn, bool)
    first, drawn_values = values[~is_drawn], values[is_drawn]
    low, high = np.percentile(drawn_values, _RANGE_PCT, axis=0) if is_drawn.any() else (values[0], values[0])
    return np.minimum(low, first.min(axis=0)), np.maximum(high, first.max(axis=0))


def _normal_scores(rng: np.random.Generator, draws: int, number: int) -> Values:
    """Standard normal scores ``(draws, number)``, each column one from each of as many parts of equal probability."""
    ranks = rng.permuted(np.tile(np.arange(draws)[:, None], (1, number)), axis=0)
    result: Values = ndtri((ranks + 0.5) / max(draws, 1))
    return result
