"""Who is in a campaign, and what they eat: each a function of a seed and his number alone."""

from __future__ import annotations

from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.patients.operating_point import SorensenPatient
from glucoloop.patients.population import PRESETS, VirtualPeople, virtual_people
from glucoloop.simulation.engines import one_at_a_time
from glucoloop.threefry import LARGEST_COUNTER, uniforms

POPULATIONS: Final = ("parker2000", "lognormal")
"""Of which people are, by turns."""
LIGHTEST_KG: Final = PRESETS["lognormal"].distributions()["weight_kg"].lower
"""Nobody of either weighs less."""
MOST_MEALS: Final = 4
_CHUNK: Final = 1024

Array = npt.NDArray[Any]


def draw_people(seed: int, person: npt.ArrayLike) -> VirtualPeople:
    """People of the two populations by turns, by their numbers; what was drawn is that of the second."""
    number = np.asarray(person, np.int64)
    first, second = (virtual_people(PRESETS[name], seed, number) for name in POPULATIONS)
    turn = number % 2 == 0

    def choose(one: Any, other: Any) -> Any:
        return jnp.where(turn, one, other) if jnp.ndim(one) or jnp.ndim(other) else one

    chosen: SorensenPatient = jax.tree.map(choose, first.patient, second.patient)
    return VirtualPeople(
        draw=second.draw,
        patient=chosen,
        basal_insulin_mU_min=np.where(turn, first.basal_insulin_mU_min, second.basal_insulin_mU_min),
        rest=np.where(turn, first.rest, second.rest),
        able=np.where(turn, first.able, second.able),
    )


def able_people(seed: int, wanted: int) -> npt.NDArray[np.int64]:
    """Numbers of the first people who have a basal rate.

    Raises
    ------
    ValueError
        If there are not as many.
    """
    found: list[npt.NDArray[np.int64]] = []
    for start in range(0, LARGEST_COUNTER, _CHUNK):
        if sum(map(len, found)) >= wanted:
            return np.concatenate(found)[:wanted]
        with one_at_a_time:
            able = draw_people(seed, np.arange(start, min(start + _CHUNK, LARGEST_COUNTER))).able
        found.append(start + np.flatnonzero(able))
    raise ValueError(f"seed {seed} has fewer than {wanted} people; give fewer loops")


def draw_random_meals(seed: int, person: npt.ArrayLike, horizon_min: float) -> tuple[Array, Array]:
    """Up to four meals of 5 to 120 g at any time, ``(4, n)`` times and grams; one of 0 g is none."""
    many = np.floor((MOST_MEALS + 1) * uniforms(seed, "meals", person))
    which = np.arange(MOST_MEALS)
    t_min = np.stack([horizon_min * uniforms(seed, "when", person, int(i)) for i in which])
    carbs_g = np.stack([5.0 + 115.0 * uniforms(seed, "how much", person, int(i)) for i in which])
    return t_min, np.where(which[:, None] < many, carbs_g, 0.0)
