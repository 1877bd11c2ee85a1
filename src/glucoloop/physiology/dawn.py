"""Rise of the production of glucose before dawn.

In the simulator of Visentin et al. (2018) the constant kp1 rises in a straight line by 1.5 mg/kg/min from 03:00 to
07:00, after measurements by Mallad et al. (2015), and glucose by some 30 mg/dl. What follows is not known here from the
papers; production falls back in a straight line within two hours, a choice of this program.

References
----------
A. Mallad, L. Hinshaw, C. Dalla Man, C. Cobelli, R. Basu, R. Lingineni, R. E. Carter, Y. C. Kudva, A. Basu, "Nocturnal
glucose metabolism in type 1 diabetes: a study comparing single versus dual tracer approaches", Diabetes Technol. Ther.
17(8), 2015, 587-595.
R. Visentin, E. Campos-Náñez, M. Schiavon, D. Lv, M. Vettoretti, M. Breton, B. P. Kovatchev, C. Dalla Man, C. Cobelli,
"The UVA/Padova type 1 diabetes simulator goes from single meal to single day", J. Diabetes Sci. Technol. 12(2), 2018,
273-281.
"""

from __future__ import annotations

from typing import Annotated

from glucoloop._lazy_jax import np, npt
from glucoloop.component.setting import About
from glucoloop.physiology.rhythm import Changes, Floats, RhythmComponent
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_DAY


class Dawn(RhythmComponent, name="dawn"):
    """Production of glucose by the liver that rises before dawn, of Mallad et al. (2015).

    It falls back every morning, the same in all people.
    """

    sources = ("mallad2015", "visentin2018")
    rise_mg_kg_min: Annotated[float, About("Rise of production at its end, in mg/kg/min.", above=0.0, at_most=10.0)] = (
        1.5
    )
    from_min: Annotated[float, About("Time of day at which it begins to rise.", at_least=0.0, below=MIN_PER_DAY)] = (
        180.0
    )
    to_min: Annotated[float, About("Time of day at which it stops rising.", above=0.0, below=MIN_PER_DAY)] = 420.0
    fall_min: Annotated[float, About("Time in which it falls back afterwards.", at_least=1.0, at_most=720.0)] = 120.0

    def __post_init__(self) -> None:
        if not self.from_min < self.to_min or not self.to_min + self.fall_min <= MIN_PER_DAY:
            raise Refusal(
                f"a dawn from {self.from_min:g} to {self.to_min:g} min that falls for {self.fall_min:g} min is not "
                f"possible; give times in their order, of which the last is at most {MIN_PER_DAY:g} min"
            )

    def changes(self, clock_min: Floats, seed: int, person: npt.NDArray[np.int64]) -> Changes:
        """Added production ``(n, people)``."""
        del seed  # every morning is the same
        times = (self.from_min, self.to_min, self.to_min + self.fall_min)
        added = np.interp(np.asarray(clock_min, float) % MIN_PER_DAY, times, (0.0, self.rise_mg_kg_min, 0.0))
        return Changes(production_mg_kg_min=np.repeat(added[:, None], person.size, axis=1))
