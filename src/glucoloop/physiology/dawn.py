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

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from glucoloop.physiology.protocol import Changes, Floats
from glucoloop.units import MIN_PER_DAY


@dataclass(frozen=True)
class Dawn:
    """Production that rises and falls back every morning, the same in all people; implements `Rhythm`.

    Parameters
    ----------
    rise_mg_kg_min : float
        Production that is added at the end of the rise.
    from_min, to_min : float
        Times of day at which it begins and stops rising.
    fall_min : float
        Time in which it falls back.
    """

    rise_mg_kg_min: float = 1.5
    from_min: float = 180.0
    to_min: float = 420.0
    fall_min: float = 120.0

    def changes(self, clock_min: Floats, seed: int, person: npt.NDArray[np.int64]) -> Changes:
        """Added production ``(n, people)``."""
        del seed  # every morning is the same
        times = (self.from_min, self.to_min, self.to_min + self.fall_min)
        added = np.interp(np.asarray(clock_min, float) % MIN_PER_DAY, times, (0.0, self.rise_mg_kg_min, 0.0))
        return Changes(production_mg_kg_min=np.repeat(added[:, None], person.size, axis=1))
