"""Padding of controllers with different horizons to the longest, so that a batch of them is one program."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.control import Controller
from glucoloop.refusal import Refusal

C = TypeVar("C", bound=Controller)

_SOLVED_EXACTLY: Final = 2


def move_slots(moves: int, most: int) -> int:
    """Number of moves to which a controller is padded: one and two, solved in closed form, stay apart from more."""
    return min(_SOLVED_EXACTLY, most) if moves <= _SOLVED_EXACTLY else most


def horizons(controller: Controller) -> tuple[int, int]:
    """Number of planned moves and of predicted samples, as the arrays of a controller have them."""
    found: tuple[int, int] | None = getattr(controller, "horizons", None)
    if found is None or not hasattr(controller, "padded"):
        raise TypeError(
            f"{type(controller).__name__} has no horizons that can be padded; search MPC, MPC/SE or NLQDMC/SE, or give "
            "it `horizons` and `padded` as these have them"
        )
    return found


def padded(controller: C, moves: int, horizon: int) -> C:
    """The same controller with room for more moves and more samples, none of which has any weight.

    Its decisions are the same up to rounding. It has `horizons` and `padded`, as LinearMPC, MPCSE and NLQDMC have them.
    """
    own_moves, own_horizon = horizons(controller)
    if moves < own_moves or horizon < own_horizon:
        raise Refusal(
            f"a controller of {own_moves} moves and {own_horizon} samples does not fit into {moves} and {horizon}"
        )
    longer: C = controller.padded(moves, horizon)  # type: ignore[attr-defined]
    return longer


def stack(controllers: Sequence[C]) -> C:
    """Controllers of one kind and shape stacked along a leading axis, for `jax.vmap`."""
    # on the host, since a hundred small arrays cost more to dispatch than to copy
    stacked: C = jax.tree.map(
        lambda *leaves: jnp.asarray(np.stack([np.asarray(leaf) for leaf in leaves])), *controllers
    )
    return stacked
