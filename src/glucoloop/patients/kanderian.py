"""The model of Kanderian et al. (2009), the Medtronic virtual patient: Bergman's effect of subcutaneous insulin.

With insulin in the subcutaneous depot and plasma ``I_sc``, ``I_p`` [uU/ml], its effect ``I_eff`` [1/min], glucose in
plasma and tissue ``G``, ``G_isf`` [mg/dl], and the appearance of glucose from meals ``R`` [mg/min]::

    I_sc'  = (ID / C_I - I_sc) / tau_1            ID: infusion in uU/min
    I_p'   = (I_sc - I_p) / tau_2
    I_eff' = p_2 (S_I I_p - I_eff)
    G'     = -(GEZI + I_eff) G + EGP + R / V_G
    G_isf' = (G - G_isf) / tau_sensor

Glucose is absorbed in two compartments with the person's own time to peak. The model has no renal loss and no
counter-regulation.

Constants, body weight and total daily insulin are those of the paper's table; each person is called as there. Meals are
those of its table of meals, each with a time to the peak of its appearance of its own.

Three things are not in the tables and are set here. A patient has one time to peak for all meals, which is the mean of
the person's own, weighted by their carbohydrate. A day is the first breakfast, lunch, dinner and supper at 7, 12, 18
and 22 h: the table has no times, the second breakfast is that of the next morning, and the extras that some had are
left out. The lag of the sensor behind plasma is 10 min.

References
----------
S. S. Kanderian, S. Weinzimer, G. Voskanyan, G. M. Steil, "Identification of intraday metabolic profiles during
closed-loop glucose control in individuals with type 1 diabetes", J. Diabetes Sci. Technol. 3(5), 2009, 1047-1057.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.meals.hovorka import HovorkaGut
from glucoloop.patients.component import Constant, OperatingPoint
from glucoloop.patients.ode import OdePatient
from glucoloop.patients.protocol import Inputs
from glucoloop.patients.variation import Distribution, refuse_not_positive
from glucoloop.refusal import Refusal
from glucoloop.units import MIN_PER_H

if TYPE_CHECKING:
    from glucoloop.meals.scenario import Meal
    from glucoloop.patients.population import Population
    from glucoloop.patients.table import PeopleTable

SOURCE: Final = "Kanderian et al. 2009, J. Diabetes Sci. Technol. 3(5), table of the ten people"
_TIMES_H: Final = {"breakfast": 7.0, "lunch": 12.0, "dinner": 18.0, "supper": 22.0}
_DAILY_DOSE: Final = "total_daily_dose_U"
_NAMES: Final = ("weight_kg", _DAILY_DOSE, "C_I", "tau_1", "tau_2", "V_G", "p_2", "EGP", "GEZI", "S_I")
# fmt: off
_PEOPLE: Final = {
    # kg, U/day,     C_I,   tau_1, tau_2, V_G,   p_2,     EGP,   GEZI,      S_I
    "1": (89.0, 50.0, 2010.0, 49.0, 47.0, 253.0, 0.0106, 1.33, 0.0022, 0.000811),
    "2": (63.0, 43.0, 1281.0, 41.0, 10.0, 261.0, 0.0116, 0.6, 0.00438, 0.0000964),
    "3": (65.0, 30.0, 909.0, 71.0, 70.0, 199.0, 0.0233, 1.07, 0.0035, 0.000463),
    "4": (116.0, 65.0, 1813.0, 91.0, 70.0, 337.0, 0.00814, 0.98, 0.0000164, 0.000377),
    "5": (64.0, 42.0, 1535.0, 46.0, 46.0, 188.0, 0.00963, 0.6, 0.00433, 0.000205),
    "6": (51.0, 21.0, 588.0, 68.0, 30.0, 104.0, 0.00915, 0.603, 0.00101, 0.000412),
    "7": (77.0, 40.0, 1806.0, 60.0, 60.0, 263.0, 0.0101, 1.11, 0.0023, 0.000816),
    "8": (65.0, 30.0, 540.0, 95.0, 37.0, 137.0, 0.0103, 1.3, 0.00000001, 0.000368),
    "9": (100.0, 50.0, 875.0, 131.0, 21.0, 193.0, 0.0103, 1.27, 0.00639, 0.000256),
    "10": (64.0, 34.0, 1309.0, 53.0, 53.0, 204.0, 0.0102, 0.611, 0.00104, 0.000603),
}
"""Body weight, total daily insulin, and the constants of each person."""
_COLUMNS: Final = dict(zip(_NAMES, zip(*_PEOPLE.values(), strict=True), strict=True))
_MEALS: Final = {
    # carbohydrate [g], time to peak [min]: breakfast, lunch, dinner, supper; then the second breakfast and the extras
    "1": ((72, 47), (131, 52), (51, 24), (70, 60), (72, 39), (36, 21)),
    "2": ((8, 107), (140, 84), (18, 231), None, (20, 12)),
    "3": ((55, 60), (84, 79), (90, 76), (44, 131), (54, 66), (36, 107), (16, 82)),
    "4": ((68, 45), (129, 30), (98, 65), (27, 144), (100, 103), (15, 16), (20, 14), (43, 45)),
    "5": ((49, 39), (51, 37), (56, 35), (70, 68), (49, 30), (5, 10)),
    "6": ((20, 27), (54, 62), (63, 68), (48, 150), (24, 27)),
    "7": ((81, 32), (102, 34), (101, 25), (73, 32), (81, 32), (15, 10), (15, 10)),
    "8": ((28, 27), (71, 73), (54, 72), (14, 47), (35, 66)),
    "9": ((76, 46), (37, 46), (101, 58), (54, 38), (76, 51)),
    "10": ((40, 31), (80, 57), (61, 83), (56, 31), (40, 44), (14, 16), (14, 10)),
}
# fmt: on


def _time_to_peak(name: str) -> float:
    eaten = [meal for meal in _MEALS[name] if meal is not None]
    return sum(carbs * minutes for carbs, minutes in eaten) / sum(carbs for carbs, _ in eaten)


_VALUES: Final = {
    **{name: _COLUMNS[name] for name in _COLUMNS if name != _DAILY_DOSE},
    "tau_m": tuple(map(_time_to_peak, _PEOPLE)),
}


@functools.cache
def people() -> PeopleTable:
    """The ten people; making the table imports JAX."""
    from glucoloop.meals.scenario import Meal
    from glucoloop.patients.table import PeopleTable

    def day(name: str) -> tuple[Meal, ...]:
        times = (MIN_PER_H * hours for hours in _TIMES_H.values())
        meals = zip(_MEALS[name], times, strict=False)
        return tuple(Meal(float(meal[0]), t_min) for meal, t_min in meals if meal is not None)

    return PeopleTable(
        names=tuple(_PEOPLE),
        values=_VALUES,
        profile={_DAILY_DOSE: _COLUMNS[_DAILY_DOSE]},
        meals=tuple(map(day, _PEOPLE)),
    )


NOMINAL: Final = "1"
"""Person who is the nominal patient."""
_UNITS: Final = {
    "weight_kg": ("kg", "body weight"),
    "C_I": ("ml/min", "clearance of insulin"),
    "tau_1": ("min", "time constant of subcutaneous insulin"),
    "tau_2": ("min", "time constant of insulin in plasma"),
    "V_G": ("dl", "volume of glucose"),
    "p_2": ("1/min", "rate at which the effect of insulin follows insulin"),
    "EGP": ("mg/dl/min", "production of glucose by the liver without insulin"),
    "GEZI": ("1/min", "effect of glucose on its uptake without insulin"),
    "S_I": ("ml/uU/min", "sensitivity to insulin"),
    "tau_m": ("min", "time to the peak of the appearance of glucose after a meal, mean of the person's meals"),
}
CONSTANTS: Final = (
    *(
        Constant(name, _VALUES[name][list(_PEOPLE).index(NOMINAL)], unit, meaning, SOURCE)
        for name, (unit, meaning) in _UNITS.items()
    ),
    Constant("tau_sensor", 10.0, "min", "lag of glucose in tissue behind plasma", SOURCE),
)
"""Constants of the nominal patient."""


_UU_PER_MU: Final = 1000.0
_ROUNDING: Final = 1e-9


class KanderianPatient(OdePatient, name="kanderian-2009"):
    """The ten people of Kanderian et al. (2009), the Medtronic virtual patient; subcutaneous insulin.

    States ``(I_sc, I_p, I_eff, G, G_isf)``.
    """

    timeless: ClassVar = True
    sources = ("kanderian2009",)
    operating_points = (
        OperatingPoint(
            "fasting-120", "person 1, held at 120 mg/dl by 22.0 mU/min, which is 1.32 U/h", glucose_mg_dl=120.0
        ),
    )
    populations: ClassVar = {"kanderian2009": "the ten people of Kanderian et al. (2009), by name 1 to 10"}
    pulse_mU_min = 20.0
    nominal: ClassVar = {constant.name: constant.value for constant in CONSTANTS}
    meanings: ClassVar = {constant.name: constant.meaning for constant in CONSTANTS}
    near_rest = (11.0, 11.0, 0.009, 120.0, 120.0)
    near_basal_mU_min = 22.0
    insulin_route: ClassVar[str] = SUBCUTANEOUS
    sites: ClassVar[tuple[str, ...]] = ("plasma", "interstitial")
    insulin_sensitivity: ClassVar[tuple[str, ...]] = ("S_I",)

    @classmethod
    def population(cls, name: str) -> Population:
        """The ten people."""
        from glucoloop.patients.population import Population

        return Population(name, (), cls.populations[name], cls.name, people())

    @classmethod
    def nominal_profile(cls) -> Mapping[str, float]:
        """Known fields of person 1."""
        return people().profile_of(NOMINAL)

    @classmethod
    def refuse_impossible(cls, varied: Mapping[str, Distribution]) -> None:
        """Refuse distributions of constants that are not above 0."""
        refuse_not_positive(varied)

    @classmethod
    def sound(cls, x: jax.Array, lowest_mg_dl: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Whether insulin and glucose of states ``(5, ...)`` are possible: none is below zero."""
        return jnp.all(x[:3] >= -_ROUNDING, axis=0), jnp.all(x[3:] >= -_ROUNDING, axis=0)

    @property
    def meal_model(self) -> HovorkaGut:
        """The gut: two compartments with the person's own time to peak, from which all carbohydrate is absorbed."""
        return HovorkaGut(time_to_maximum_min=self.parameters["tau_m"], bioavailability=1.0)

    @property
    def glucose_production(self) -> Mapping[str, jax.Array]:
        """Increase of EGP by 1 mg/kg/min of production."""
        c = self.parameters
        return {"EGP": c["weight_kg"] / c["V_G"]}

    def derivative(self, t_min: jax.Array, x: jax.Array, inputs: Inputs) -> jax.Array:
        """Right-hand side of the equations."""
        c, (I_sc, I_p, I_eff, G, G_isf) = self.parameters, x
        return jnp.stack(
            [
                (_UU_PER_MU * inputs.insulin_mU_min / c["C_I"] - I_sc) / c["tau_1"],
                (I_sc - I_p) / c["tau_2"],
                c["p_2"] * (c["S_I"] * I_p - I_eff),
                c["EGP"] - (c["GEZI"] + I_eff) * G + inputs.meal_mg_min / c["V_G"],
                (G - G_isf) / c["tau_sensor"],
            ]
        )

    def glucose_mg_dl(self, x: jax.Array) -> jax.Array:
        """Glucose concentration in plasma."""
        return x[3]

    def seen_mg_dl(self, x: jax.Array, site: str) -> jax.Array:
        """Glucose at one of the `sites`; ValueError for an unknown site."""
        if site not in self.sites:
            raise Refusal(f"glucose cannot be measured at {site!r}; the known sites are: {', '.join(self.sites)}")
        return x[3 + self.sites.index(site)]
