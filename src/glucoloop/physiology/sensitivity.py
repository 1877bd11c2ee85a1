"""Sensitivity to insulin that changes for a time of the day, as in exercise and in illness.

In exercise of moderate intensity insulin lowers glucose about twice as much (Schiavon et al., 2013, in healthy people
after a meal), and sensitivity stays higher for hours; muscle takes up more glucose without insulin too, by what is
left of it when the liver has given more. In a feverish infection people need more insulin for a day or longer. How fast
the change fades, and how far it goes, are choices of the user: no patient has these equations, and any family takes
the change.

References
----------
M. Schiavon, L. Hinshaw, A. Mallad, C. Dalla Man, G. Sparacino, M. Johnson, R. Carter, R. Basu, Y. Kudva, C. Cobelli, A.
Basu, "Postprandial glucose fluxes and insulin sensitivity during exercise: a study in healthy individuals", Am. J.
Physiol. Endocrinol. Metab. 305(4), 2013, E557-E566.
"""

from __future__ import annotations

from typing import Annotated

from glucoloop._lazy_jax import np, npt
from glucoloop.component.setting import About
from glucoloop.physiology.rhythm import Changes, Floats, RhythmComponent
from glucoloop.units import MIN_PER_DAY


class Sensitivity(RhythmComponent, name="sensitivity"):
    """Sensitivity to insulin that is multiplied by a factor for a time of each day, and then fades back.

    ``1 + (factor - 1) exp(-t / fade)`` at a time t after it ends. It is the same in all people.
    """

    sources = ("schiavon2013",)
    factor: Annotated[float, About("Factor on sensitivity; below 1 insulin acts less.", above=0.0, at_most=10.0)] = 2.0
    from_min: Annotated[float, About("Time of day at which it begins.", at_least=0.0, below=MIN_PER_DAY)] = 960.0
    duration_min: Annotated[float, About("Time for which it is whole.", above=0.0, at_most=MIN_PER_DAY)] = 45.0
    fade_min: Annotated[
        float, About("Time constant of its fading afterwards; 0: it ends at once.", at_least=0.0, at_most=MIN_PER_DAY)
    ] = 0.0
    uptake_mg_kg_min: Annotated[
        float,
        About(
            "Uptake of glucose without insulin beyond what the liver adds, while the factor is whole, in mg/kg/min.",
            at_least=0.0,
            at_most=10.0,
        ),
    ] = 0.0

    def changes(self, clock_min: Floats, seed: int, person: npt.NDArray[np.int64]) -> Changes:
        """Factor, and uptake as production below 0, ``(n, people)``; nothing lasts from before the first day."""
        del seed  # every day is the same
        clock = np.asarray(clock_min, float) - self.from_min
        since = np.where(clock >= 0.0, clock % MIN_PER_DAY, np.inf)
        whole = np.where(since < self.duration_min, 1.0, 0.0)
        left = whole
        if self.fade_min > 0.0:
            left = np.where(since < np.inf, np.exp(-np.maximum(since - self.duration_min, 0.0) / self.fade_min), 0.0)

        def of_people(values: Floats) -> Floats:
            return np.repeat(values[:, None], person.size, axis=1)

        return Changes(
            sensitivity=of_people(1.0 + (self.factor - 1.0) * left),
            production_mg_kg_min=of_people(-self.uptake_mg_kg_min * whole) if self.uptake_mg_kg_min else None,
        )
