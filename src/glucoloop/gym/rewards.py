"""Rewards of the literature, by name: functions of glucose before and after a step, for any number of people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glucoloop.refusal import Refusal

Array = npt.NDArray[np.float64]
RewardFunction = Callable[[Array, Array], Any]
"""Function of glucose before and after a step, ``(people,)`` each [mg/dl], that gives the reward ``(people,)``."""


@dataclass(frozen=True)
class Reward:
    """A reward, and what is taken from it where glucose leaves its bounds and the episode is terminated."""

    of_step: RewardFunction
    termination: float = 0.0


def magni_risk(glucose_mg_dl: Array) -> Array:
    """Risk of Magni et al., ``10 (3.5506 (ln(glucose)^0.8353 - 3.7932))^2``, 0 at 139 and 25 at 70 and 280 mg/dl.

    Glucose below 10 mg/dl counts as 10, since the logarithm has a power only above 1 mg/dl.

    References
    ----------
    L. Magni et al., "Model predictive control of type 1 diabetes: an in silico trial", J. Diabetes Sci. Technol. 1(6),
    804-812, 2007; with the first constant as the program of Fox et al. (2020) has it, by which the risk is the same at
    70 and at 280 mg/dl.
    """
    return np.asarray(10.0 * (3.5506 * (np.log(np.maximum(glucose_mg_dl, 10.0)) ** 0.8353 - 3.7932)) ** 2)


def kovatchev_risk(glucose_mg_dl: Array) -> Array:
    """Risk of Kovatchev et al., ``10 f^2`` with ``f = 1.509 (ln(glucose)^1.084 - 5.381)``, 0 at 112.5 mg/dl.

    Glucose below 10 mg/dl counts as 10. For the source see `metrics.glycemia.RiskIndices`.
    """
    return np.asarray(10.0 * (1.509 * (np.log(np.maximum(glucose_mg_dl, 10.0)) ** 1.084 - 5.381)) ** 2)


def _less_magni_risk(before: Array, after: Array) -> Array:
    del before
    return -magni_risk(after)


def _risk_change(before: Array, after: Array) -> Array:
    return kovatchev_risk(before) - kovatchev_risk(after)


def _in_range(before: Array, after: Array) -> Array:
    del before
    return ((after >= 70.0) & (after <= 180.0)).astype(float)


REWARDS: Final[dict[str, Reward]] = {
    # The penalty is a day of 5-min steps at the largest risk, so that ending early is never worth it.
    "magni-risk": Reward(_less_magni_risk, termination=1e5),
    "risk-change": Reward(_risk_change),
    "time-in-range": Reward(_in_range),
}
"""Rewards by name.

``magni-risk``
    Less the risk after the step, and 1e5 where the episode is terminated, since an agent could otherwise end its
    losses. I. Fox, J. Lee, R. Pop-Busui, J. Wiens, "Deep reinforcement learning for closed-loop blood glucose control",
    Machine Learning for Healthcare 2020, arXiv:2009.09051.
``risk-change``
    Fall of the risk of Kovatchev et al. during the step, the reward of simglucose (J. Xie, 2018); there by readings,
    here by glucose.
``time-in-range``
    1 in the range of 70 to 180 mg/dl of the consensus on time in range, else 0. T. Battelino et al., Diabetes Care
    42(8), 1593-1603, 2019.
"""


def reward_of(given: str | RewardFunction) -> Reward:
    """A reward by its name, or of a function; Refusal for an unknown name."""
    if callable(given):
        return Reward(given)
    if given in REWARDS:
        return REWARDS[given]
    raise Refusal(f"unknown reward {given!r}; the known ones are: {', '.join(REWARDS)}, or give a function")
