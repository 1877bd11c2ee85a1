"""Settings of a guard: readings that it believes, times that it waits, and doses that it allows."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Final

from glucoloop.arguments import ArgumentTypeError, checked, is_traced
from glucoloop.registry.guard import OF_ROUTE, PREFIX


@checked
@dataclass(frozen=True)
class GuardSettings:
    """Limits of a guard; see `guarded`. Values without a source were chosen by the experiments of the guide's page.

    The defaults are for insulin into a vein; `for_route` gives those for insulin under the skin.

    Raises
    ------
    ValueError
        For a value outside its bounds.
    """

    lowest_reading_mg_dl: float = 20.0
    """Lowest reading that is believed. Sensors give 40 to 400 mg/dl, meters 20 to 600."""
    highest_reading_mg_dl: float = 600.0
    """Highest reading that is believed."""
    fastest_mg_dl_min: float = 3.0
    """Fastest rise that is believed, of a reading against the last that was; a fall may be twice as fast. Healthy
    people pass 2 mg/dl/min in about 1 % of the time (doi:10.1177/15209156251390822)."""
    stuck_min: float = 20.0
    """Time after which a reading that stays the same to its last digit, though insulin on board is far from that of
    the basal rate, is not believed."""
    stuck_on_board: float = 0.25
    """Difference of insulin on board from that of the basal rate from which it counts as far, in basal rates."""
    held_min: float = 10.0
    """Time for which a reading may stay the same to its last digit; after it, at most the basal rate is given until the
    reading moves. A search for the worst errors makes a reading high and stuck."""
    gap_min: float = 20.0
    """Time without a believed reading after which the basal rate is given: 20 min in Control-IQ (Tandem)."""
    long_gap_min: float = 90.0
    """Time after which a part of the basal rate is given: as long as the MiniMed 670G (Medtronic) stays in its own
    fallback."""
    reduced_fraction: float = 0.5
    """Part of the basal rate that is given after that time."""
    low_mg_dl: float = 65.0
    """Predicted glucose below which insulin is suspended. Basal-IQ (Tandem) takes 80 mg/dl, too near to a setpoint of
    81, and 70 for glucose now.
    """
    ahead_min: float = 40.0
    """Time of the prediction along the trend. Basal-IQ looks 30 min ahead; with 40 fewer people went low after an
    occlusion.
    """
    hysteresis_mg_dl: float = 5.0
    """Distance above that bound from which insulin is given again."""
    max_hour: float = 2.4
    """Largest dose in an hour, in basal hours. OpenAPS allows 3 times the largest basal rate of the day; the paper's
    pump gives at most 2.6 times the nominal one."""
    max_on_board: float = 1.3
    """Largest insulin on board beyond the basal rate, as a multiple of it."""
    on_board_tau_min: float = 90.0
    """Time constant with which insulin on board decays: that of glucose after a step of insulin, 89 min."""
    fall_mg_dl: float = 60.0
    """Glucose above the setpoint, beyond the error, for which one basal rate may be on board. Glucose of the nominal
    patient falls by 77 mg/dl, in the end, under twice the basal rate."""
    error_mg_dl: float = 5.0
    """Error of the sensor: insulin is added only for the excess of a reading over the setpoint beyond it."""
    always_basal: float = 1.2
    """Multiple of the basal rate that is allowed at any reading, except at a predicted low."""
    doubt_tau_min: float = 480.0
    """Time constant with which the doubt about a jump of the reading, which is attributed to the sensor, decays."""

    @classmethod
    def for_route(cls, insulin_route: str) -> GuardSettings:
        """Usual limits for a route of insulin, ``"intravenous"`` or ``"subcutaneous"``; `registry.guard` has sources.

        Raises
        ------
        ValueError
            For an unknown route.
        """
        if insulin_route not in OF_ROUTE:
            raise ValueError(f"unknown route of insulin {insulin_route!r}; the known ones are: {', '.join(OF_ROUTE)}")
        return cls(**{key.removeprefix(PREFIX): value for key, value in OF_ROUTE[insulin_route].items()})

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if is_traced(value):
                raise ArgumentTypeError(
                    f"{field.name} is traced by JAX, but the settings of a guard are part of the compiled program; "
                    "give plain numbers, outside of the transformation"
                )
            if not math.isfinite(value):
                raise ValueError(f"a guard's {field.name} of {value!r} is not possible; give a finite number")
        for name, least, above in _LEAST:
            value = getattr(self, name)
            if value < least or (above and value == least):
                kind = f"a number above {least:g}" if above else f"{least:g} or more"
                raise ValueError(f"a guard's {name} of {value:g} is not possible; give {kind}")
            if value > _MOST:
                raise ValueError(f"a guard's {name} of {value:g} is not possible; give {_MOST:g} or less")
        if not self.lowest_reading_mg_dl < self.highest_reading_mg_dl:
            raise ValueError(
                f"readings from {self.lowest_reading_mg_dl:g} to {self.highest_reading_mg_dl:g} mg/dl are no range; "
                "give a highest_reading_mg_dl above lowest_reading_mg_dl"
            )
        if not self.gap_min <= self.long_gap_min:
            raise ValueError(
                f"a guard's long_gap_min of {self.long_gap_min:g} is less than its gap_min of {self.gap_min:g}; "
                "give as much or more"
            )
        if self.reduced_fraction > 1.0:
            raise ValueError(
                f"a guard's reduced_fraction of {self.reduced_fraction:g} is not possible; give a part from 0 to 1"
            )


_MOST: Final = 10_000.0
"""Largest value of any setting, so that no result of it overflows."""
_LEAST: Final = (
    ("highest_reading_mg_dl", 0.0, True),
    ("long_gap_min", 0.0, False),
    ("lowest_reading_mg_dl", 0.0, False),
    ("fastest_mg_dl_min", 0.0, True),
    ("stuck_min", 0.0, True),
    ("stuck_on_board", 0.0, False),
    ("held_min", 0.0, False),
    ("gap_min", 0.0, False),
    ("reduced_fraction", 0.0, False),
    ("low_mg_dl", 0.0, False),
    ("ahead_min", 0.0, False),
    ("hysteresis_mg_dl", 0.0, False),
    ("max_hour", 1.0, False),
    ("max_on_board", 0.0, False),
    ("on_board_tau_min", 1.0, False),
    ("fall_mg_dl", 1.0, False),
    ("error_mg_dl", 0.0, False),
    ("always_basal", 1.0, False),
    ("doubt_tau_min", 0.0, True),
)
"""Least value of each field, and whether that value itself is out of bounds."""
