"""Search over a grid: every tuning is tried in the loop.

Parker, Doyle and Peppas, IEEE Trans. Biomed. Eng. 46(2), 1999, Sec. IV to VI: the smallest sum of squared errors
subject to the constraints (17) to (19) and to no oscillation.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import design_of
from glucoloop.build.surroundings import surroundings_of
from glucoloop.component.setting import Value
from glucoloop.control import Controller, MPCTuning, StateTuning
from glucoloop.control.catalogue import controller_entry, tunable
from glucoloop.meals import Scenario
from glucoloop.metrics import summarise
from glucoloop.models.step_response import StepResponseModel
from glucoloop.refusal import Refusal
from glucoloop.simulation.plant import Integrator
from glucoloop.situations.case import Case, default_case
from glucoloop.situations.situation import Situation, default_situation
from glucoloop.tuning.grid import parse_numbers, tuning_grid
from glucoloop.tuning.oscillation import oscillation
from glucoloop.tuning.surface import TuningSurface

Designer = Callable[[MPCTuning], Controller]
"""Function that makes the controller of a tuning."""


def kind_of_tuning(controller: str) -> type[MPCTuning]:
    """Kind of the tunings of a controller that can be tuned: `StateTuning` if it has a reference filter."""
    entry = controller_entry(controller)
    if not entry.tunable:
        raise Refusal(f"the controller {controller!r} cannot be tuned; the known ones are: {', '.join(tunable())}")
    return StateTuning if "reference_filter" in entry.settings() else MPCTuning


def default_filters(controller: str, tuning: Mapping[str, Value]) -> str | None:
    """Range of reference filters that a grid tries unless another one is given; None without such a setting."""
    if "reference_filter" not in tuning:
        return None
    return controller_entry(controller).reference_filters or f"{tuning['reference_filter']:g}"


def designer(
    situation: Situation, case: Case, model: StepResponseModel | None = None, *, model_is_late: bool = False
) -> Designer:
    """Make the design of a tuning in a situation; parameters and errors as for `build.designs.design_of`."""
    kind = kind_of_tuning(case.controller.display_name)
    design = design_of(situation, case, model=model, model_is_late=model_is_late)

    def tuned(tuning: MPCTuning) -> Controller:
        if not isinstance(tuning, kind):
            raise Refusal("the controller follows a filtered reference; give the grid reference filters")
        settings = {name: value for name, value in tuning.values().items() if name in case.tuning}
        return design(dataclasses.replace(case.controller, **settings))

    return tuned


C = TypeVar("C", bound=Controller)

_SOLVED_EXACTLY: Final = 2


def move_slots(moves: int, most: int) -> int:
    """Number of moves to which a controller is padded: one and two, solved in closed form, stay apart from more."""
    return min(_SOLVED_EXACTLY, most) if moves <= _SOLVED_EXACTLY else most


def _horizons(controller: Controller) -> tuple[int, int]:
    """Number of planned moves and of predicted samples, as the arrays of a controller have them."""
    result: tuple[int, int] | None = getattr(controller, "horizons", None)
    if result is None or not hasattr(controller, "padded"):
        raise TypeError(
            f"{type(controller).__name__} has no horizons that can be padded; search MPC, MPC/SE or NLQDMC/SE, or give "
            "it `horizons` and `padded` as these have them"
        )
    return result


def _padded(controller: C, moves: int, horizon: int) -> C:
    """The same controller with room for more moves and more samples, none of which has any weight.

    Its decisions are the same up to rounding. It has `horizons` and `padded`, as LinearMPC, MPCSE and NLQDMC do.
    """
    own_moves, own_horizon = _horizons(controller)
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


Progress = Callable[[int, int], None]
"""Callback with the number of finished runs and the number of all runs."""

_MAX_POINTS: Final = 20_000
_MAX_RUNS: Final = 200_000
_BLOCK: Final = 128
"""Number of runs at once: more are not faster, and their traces take memory."""
_ROUND: Final = 8
"""Divisor of the size of blocks, so that similar grids share a program."""


_NUMBERS: Final = (
    "sse",
    "undershoot_mg_dl",
    "minimum_mg_dl",
    "settling_2pct_min",
    "settling_5pct_min",
    "insulin_total_variation_mU_min",
)
_TRUTHS: Final = ("settled_2pct", "settled_5pct")
_Scores = dict[str, jax.Array]
"""Scores that are kept of a run, by name."""


def search(
    situation: Situation,
    design: Designer,
    grid: Sequence[MPCTuning],
    *,
    scenario: Scenario | None = None,
    seeds: Sequence[int] = (0,),
    integrator: Integrator | None = None,
    name: str = "controller",
    progress: Progress | None = None,
) -> TuningSurface:
    """Simulate the loop with every tuning of a grid, as one batch, and score each.

    Results are medians over the seeds of noise. With noise around the sensor, oscillation is judged in a loop of its
    own without that noise; otherwise in the run of the first seed. A tuning that the design refuses is listed in
    `TuningSurface.refused`; it is an error if all are refused. `progress` is called after each block with the numbers
    of finished runs and of all runs.
    """
    if not grid:
        raise Refusal("the grid has no tuning; give at least one")
    if not seeds:
        raise Refusal("there are no seeds; give at least one")
    if len(grid) > _MAX_POINTS or len(grid) * len(seeds) > _MAX_RUNS:
        raise Refusal(
            f"a grid of {len(grid)} tunings under {len(seeds)} seeds is too large; "
            f"give up to {_MAX_POINTS} tunings and {_MAX_RUNS} runs"
        )
    designed, refused = _designed(design, grid)
    grid = list(designed)
    controllers = list(designed.values())
    meals = Scenario() if scenario is None else scenario
    limits = situation.limits
    most_moves = max(_horizons(one)[0] for one in controllers)
    horizon = max(_horizons(one)[1] for one in controllers)

    def runs(situation: Situation, seeds: Sequence[int], done: int, total: int) -> _Scores:
        surroundings = surroundings_of(situation)

        def score(controller: Controller, key: jax.Array) -> _Scores:
            trace = close_loop(situation, controller, meals, surroundings=surroundings, key=key, integrator=integrator)
            metrics = summarise(trace, limits)
            scores = {name: getattr(metrics, name) for name in (*_NUMBERS, *_TRUTHS, "constraints_satisfied")}
            return {**scores, **vars(oscillation(trace))}

        return _in_blocks(score, controllers, seeds, most_moves, horizon, progress, done, total)

    noisy = situation.noise_variance > 0.0
    total = len(grid) * (len(seeds) + noisy)
    scores = runs(situation, seeds, 0, total)
    without_noise = situation.without_noise()
    quiet = runs(without_noise, [0], len(grid) * len(seeds), total) if noisy else scores
    return TuningSurface(
        controller=name,
        tunings=tuple(grid),
        refused=refused,
        seeds=len(seeds),
        **{name: np.median(np.asarray(scores[name], float), axis=1) for name in _NUMBERS},
        **{name: np.mean(scores[name], axis=1) > 0.5 for name in _TRUTHS},
        kept_share=np.mean(scores["constraints_satisfied"], axis=1),
        crossings=np.asarray(quiet["crossings"], np.int64)[:, 0],
        turns=np.asarray(quiet["turns"], np.int64)[:, 0],
        oscillates=np.asarray(quiet["oscillates"], bool)[:, 0],
    )


def _designed(
    design: Designer, grid: Sequence[MPCTuning]
) -> tuple[dict[MPCTuning, Controller], tuple[tuple[MPCTuning, str], ...]]:
    """Controllers by tuning, each once, and the tunings that were refused, with the reason."""
    designed: dict[MPCTuning, Controller] = {}
    refused: dict[MPCTuning, str] = {}
    for tuning in dict.fromkeys(grid):
        try:
            designed[tuning] = design(tuning)
        except Refusal as error:
            refused[tuning] = str(error)
    if not designed:
        reason = next(iter(refused.values()))
        raise Refusal(f"no controller can be designed for any tuning of the grid: {reason}")
    return designed, tuple(refused.items())


def _block(runs: int) -> int:
    """Number of runs in a block: as few blocks as the limit allows, of equal size."""
    even = -(-runs // -(-runs // _BLOCK))
    return _ROUND * -(-even // _ROUND)


def _in_blocks(
    score: Callable[[Controller, jax.Array], _Scores],
    designed: Sequence[Controller],
    seeds: Sequence[int],
    most_moves: int,
    horizon: int,
    progress: Progress | None,
    done: int,
    total: int,
) -> _Scores:
    """Scores `(points, seeds)`, computed in blocks of one shape, so that one program serves them."""
    jobs = list(itertools.product(range(len(designed)), range(len(seeds))))
    slots = [move_slots(_horizons(one)[0], most_moves) for one in designed]
    keys = [jax.random.key(seed) for seed in seeds]
    scores_of: dict[tuple[int, int], _Scores] = {}
    for moves in sorted(set(slots)):
        group = [job for job in jobs if slots[job[0]] == moves]
        block = _block(len(group))
        for start in range(0, len(group), block):
            jobs_of_block = group[start : start + block]
            full = jobs_of_block + [jobs_of_block[-1]] * (block - len(jobs_of_block))
            fitted = {
                point: _padded(designed[point], moves, horizon) for point in dict.fromkeys(job[0] for job in full)
            }
            batch = stack([fitted[point] for point, _ in full])
            scores = jax.vmap(score)(batch, jnp.stack([keys[seed] for _, seed in full]))
            host = jax.tree.map(np.asarray, scores)
            for place, job in enumerate(jobs_of_block):
                scores_of[job] = jax.tree.map(lambda leaf, place=place: leaf[place], host)
            done += len(jobs_of_block)
            if progress is not None:
                progress(done, total)
    ordered = [scores_of[job] for job in jobs]
    together: _Scores = jax.tree.map(lambda *leaves: np.stack(leaves).reshape(len(designed), len(seeds)), *ordered)
    return together


def default_tuning(situation: Situation, controller: str) -> MPCTuning:
    """Tuning of a controller that is usual in a situation; for the patient of 1999 it is the printed one."""
    kind = kind_of_tuning(controller)
    settings: Mapping[str, Any] = default_case(controller, situation).tuning
    return kind(**{field.name: settings[field.name] for field in dataclasses.fields(kind)})


def printed_tuning(operating_point: str, controller: str) -> MPCTuning:
    """Tuning that the paper prints for one of its controllers, without noise."""
    return default_tuning(default_situation(operating_point=operating_point), controller)


def paper_tuning_surface(
    operating_point: str, controller: str, *, model: StepResponseModel | None = None
) -> TuningSurface:
    """Search m from 1 to 4, p from m to 14 and phi_r from .3 to .8, without noise.

    The paper says that its tunings give the smallest sum of squared errors subject to the constraints and to no
    oscillation. In these loops the sum keeps falling with more moves and a faster reference, up to where the loop
    oscillates.
    """
    situation = default_situation(operating_point=operating_point)
    printed = default_tuning(situation, controller)
    case = default_case(controller, situation)
    filters = default_filters(controller, case.tuning)
    grid = tuning_grid(
        range(1, 5),
        range(1, 15),
        output_weights=[printed.output_weight],
        move_weights=[printed.move_weight],
        reference_filters=None if filters is None else parse_numbers(filters),
        reference_start=getattr(printed, "reference_start", 1),
    )
    design = designer(situation, case, model)
    points = grid if printed in grid else [*grid, printed]
    return search(situation, design, points, name=controller)
