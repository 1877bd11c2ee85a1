"""Controllers of different horizons as one: padded to the longest, so that a batch of them is one program."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.control import MPCSE, NLQDMC, Controller, LinearMPC
from glucoloop.control.planning import GlucoseFloor, MovePlan

C = TypeVar("C", bound=Controller)

_SOLVED_EXACTLY: Final = 2


def move_slots(moves: int, most: int) -> int:
    """How many moves a controller is padded to.

    Programs of one and two moves are solved in closed form and longer ones by iteration, so they stay apart.
    """
    return min(_SOLVED_EXACTLY, most) if moves <= _SOLVED_EXACTLY else most


def horizons(controller: Controller) -> tuple[int, int]:
    """Moves that are planned and samples that are looked ahead, as the controller's arrays have them.

    Raises
    ------
    TypeError
        For a controller that cannot be padded.
    """
    if isinstance(controller, LinearMPC | MPCSE):
        return controller.plan.hessian.shape[0], controller.plan.gain.shape[0]
    if isinstance(controller, NLQDMC):
        return controller.move_horizon, controller.reference.shape[0]
    raise TypeError(f"{type(controller).__name__} has no horizons that can be padded; search MPC, MPC/SE or NLQDMC/SE")


def padded(controller: C, moves: int, horizon: int) -> C:
    """The same controller with room for more moves and more samples, none of which has any weight.

    Parameters
    ----------
    controller : LinearMPC, MPCSE or NLQDMC
    moves, horizon : int
        At least the controller's own.

    Returns
    -------
    Controller
        It decides as the given one does, up to rounding.
    """
    own_moves, own_horizon = horizons(controller)
    more_moves, more_samples = moves - own_moves, horizon - own_horizon
    if more_moves < 0 or more_samples < 0:
        raise ValueError(
            f"a controller of {own_moves} moves and {own_horizon} samples does not fit into {moves} and {horizon}"
        )
    if isinstance(controller, LinearMPC):
        S = controller.step_response
        # Where the model ends, its answer stays, and so do the samples that the controller now looks at in vain.
        longer = jnp.pad(S, (0, max(0, horizon + 1 - S.shape[0])), mode="edge")
        return dataclasses.replace(controller, step_response=longer, plan=_padded_plan(controller.plan, moves, horizon))
    if isinstance(controller, MPCSE):
        return dataclasses.replace(
            controller,
            free_state=jnp.pad(controller.free_state, ((0, more_samples), (0, 0))),
            free_input=jnp.pad(controller.free_input, (0, more_samples)),
            free_innovation=jnp.pad(controller.free_innovation, (0, more_samples)),
            reference=jnp.pad(controller.reference, (0, more_samples)),
            plan=_padded_plan(controller.plan, moves, horizon),
        )
    if isinstance(controller, NLQDMC):
        return dataclasses.replace(
            controller,
            reference=jnp.pad(controller.reference, (0, more_samples)),
            output_weight=jnp.pad(
                jnp.broadcast_to(jnp.asarray(controller.output_weight, float), (own_horizon,)), (0, more_samples)
            ),
            planned=jnp.pad(jnp.broadcast_to(jnp.asarray(controller.planned, float), (own_moves,)), (0, more_moves)),
            floor=_padded_floor(controller.floor, own_horizon, horizon),
            move_horizon=moves,
        )
    raise TypeError(f"{type(controller).__name__} cannot be padded")


def _padded_plan(plan: MovePlan, moves: int, horizon: int) -> MovePlan:
    own_moves, own_horizon = plan.gradient.shape
    more_moves, more_samples = moves - own_moves, horizon - own_horizon
    idle = np.diag(np.repeat([0.0, 1.0], [own_moves, more_moves]))
    return dataclasses.replace(
        plan,
        gain=jnp.pad(plan.gain, (0, more_samples)),
        # An idle move has curvature but no slope and no part in the others' cost: the best it can do is nothing.
        hessian=jnp.pad(plan.hessian, (0, more_moves)) + idle,
        gradient=jnp.pad(plan.gradient, ((0, more_moves), (0, more_samples))),
        floor=_padded_floor(plan.floor, own_horizon, horizon),
        response=None if plan.response is None else jnp.pad(plan.response, ((0, more_samples), (0, more_moves))),
    )


def _padded_floor(floor: GlucoseFloor | None, own_horizon: int, horizon: int) -> GlucoseFloor | None:
    if floor is None:
        return None
    weight = jnp.broadcast_to(jnp.asarray(floor.weight, float), (own_horizon,))
    return dataclasses.replace(floor, weight=jnp.pad(weight, (0, horizon - own_horizon)))


def stack(controllers: Sequence[C]) -> C:
    """Controllers of one kind and shape as one whose arrays have a leading axis, for `jax.vmap`."""
    # on the host, since a hundred small arrays cost more to dispatch than to copy
    stacked: C = jax.tree.map(
        lambda *leaves: jnp.asarray(np.stack([np.asarray(leaf) for leaf in leaves])), *controllers
    )
    return stacked
