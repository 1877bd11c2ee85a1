"""Rewards of the literature, by name: functions of glucose before and after a step, for any number of people."""

from __future__ import annotations

import math
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
    each_step_left: float = 0.0
    """Loss for each step that was left, as if the person stayed where the reward is least."""
    bounds_mg_dl: tuple[float, float] = (10.0, 600.0)
    """Default bounds of glucose beyond which an episode is terminated."""


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


def _less_bounded_risk(before: Array, after: Array) -> Array:
    del before
    return np.asarray(-np.minimum(magni_risk(after) / _LARGEST_RISK, 1.0))


def _less_magni_risk(before: Array, after: Array) -> Array:
    del before
    return -magni_risk(after)


def _risk_change(before: Array, after: Array) -> Array:
    return kovatchev_risk(before) - kovatchev_risk(after)


def _in_range(before: Array, after: Array) -> Array:
    del before
    return ((after >= 70.0) & (after <= 180.0)).astype(float)


_LARGEST_RISK: Final = 100.0
"""Risk of Magni et al. from which on a step is as bad as can be: that of 36 and of 573 mg/dl."""
REWARDS: Final[dict[str, Reward]] = {
    # Everybody stays to the end, since a large loss in one step would outweigh all others in what an agent learns.
    # With bounds, an episode that ends early costs what it would if glucose stayed there: ending it is never worth it.
    "bounded-risk": Reward(_less_bounded_risk, each_step_left=1.0, bounds_mg_dl=(-math.inf, math.inf)),
    # The penalty is a day of 5-min steps at the largest risk, so that ending early is never worth it.
    "magni-risk": Reward(_less_magni_risk, termination=1e5),
    "risk-change": Reward(_risk_change),
    "time-in-range": Reward(_in_range),
}
"""Rewards by name.

``bounded-risk``
    Less the risk of Magni et al. after the step, divided by 100 and at most 1, so that every step has a reward from -1
    to 0. No episode is terminated; with bounds of glucose of one's own, less 1 for each step that was left.
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
