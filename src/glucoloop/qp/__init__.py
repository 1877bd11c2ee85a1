"""Small convex quadratic programs of predictive control: exact for two moves, interior point for more; soft floors."""

from glucoloop.qp.moves_qp import (
    MovesSolution,
    QPSolution,
    limit_moves,
    minimise_many_moves,
    minimise_moves,
    solve_qp,
)
from glucoloop.qp.soft_floor import minimise_moves_above_floor
from glucoloop.qp.two_moves import minimise_one_move, minimise_two_moves

__all__ = [
    "MovesSolution",
    "QPSolution",
    "limit_moves",
    "minimise_many_moves",
    "minimise_moves",
    "minimise_moves_above_floor",
    "minimise_one_move",
    "minimise_two_moves",
    "solve_qp",
]
