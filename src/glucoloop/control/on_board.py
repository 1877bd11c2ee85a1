"""Insulin and carbohydrate on board: the parts of doses that have not acted, and of meals that are not absorbed.

There is one definition, by curves as LoopKit has them: rapid-acting insulin of adults acts from 10 to 370 min after a
dose, with a peak at 85 min (`therapy.INSULINS`), and a meal is absorbed from 10 to 190 min after eating
(`control.loop_like.part_absorbed`). Insulin counts above the basal rate, so that suspended insulin is below 0.
"""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop.control.loop_like import part_absorbed
from glucoloop.therapy import INSULINS, insulin_left

Values = npt.NDArray[np.float64]

_INSULIN: Final = INSULINS["rapid-adult"]
_ABSORPTION_MIN: Final = 180.0
_CARB_DELAY_MIN: Final = 10.0
_LONGEST_MIN: Final = _INSULIN.delay_min + _INSULIN.action_min
"""Time after which nothing is on board, longer for insulin than for a meal."""


def curves(sample_time_min: float) -> tuple[Values, Values]:
    """Parts of a dose and of a meal that are on board at whole samples after them, ``(samples,)``, the last ones 0."""
    t_min = sample_time_min * np.arange(np.ceil(_LONGEST_MIN / sample_time_min) + 1)
    with jax.ensure_compile_time_eval():
        insulin = insulin_left(t_min - _INSULIN.delay_min, _INSULIN.action_min, _INSULIN.peak_min)
        carbs = 1.0 - part_absorbed(jnp.asarray((t_min - _CARB_DELAY_MIN) / _ABSORPTION_MIN))
        return np.asarray(insulin, np.float64), np.asarray(carbs, np.float64)


def on_board(amounts: npt.ArrayLike, curve: Values) -> Values:
    """Amount on board at each sample ``(samples, ...)``, of what was given at the samples before, without its own."""
    given = np.asarray(amounts, np.float64)
    later = np.append(0.0, curve[1:])
    columns = given.reshape(len(given), -1).T
    each = [np.convolve(column, later)[: len(given)] for column in columns]
    result: Values = np.stack(each, axis=-1).reshape(given.shape)
    return result
