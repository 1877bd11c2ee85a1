"""Routes of insulin, and the defaults of a patient with insulin by each, unless its own entry says otherwise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from glucoloop.component.setting import Default, Tunings, known_names
from glucoloop.refusal import Refusal

INTRAVENOUS: Final = "intravenous"
SUBCUTANEOUS: Final = "subcutaneous"


@dataclass(frozen=True, kw_only=True)
class PumpRange:
    """Rates that a pump can give."""

    max_change_mU_min: float
    """Largest change from one sample to the next."""
    min_mU_min: float = 0.0
    max_mU_min: float


PUMP_OF_1999: Final = PumpRange(max_change_mU_min=16.7, max_mU_min=66.9)
"""Limits of the pump of Parker, Doyle and Peppas (1999), their eqs. (17) and (18): the full range in four moves; 66.9
is three times the nominal rate and keeps plasma insulin below 100 mU/l."""
_PUMP_UNDER_THE_SKIN: Final = PumpRange(max_change_mU_min=500.0, max_mU_min=500.0)
"""Range of pumps in use, 30 U/h, any of it at once."""

# Subcutaneous insulin acts for hours, of each patient for others: horizons follow from the model. A step larger than
# 1 mU/min would be fitted to glucose so low that less of it is taken up.
_BY_THE_MODEL: Final = Default(0)
_SMALL_STEP: Final = Default(1.0)
_SLOW_TUNINGS: Final = {
    "mpc": {"prediction_horizon": _BY_THE_MODEL, "output_weight": Default(1.0), "move_weight": Default(3.0)},
    "mpc-se": {
        "prediction_horizon": _BY_THE_MODEL,
        "move_weight": Default(3.0),
        "reference_start": Default(1),
        "glucose_process_noise": Default(30.0),
        "other_process_noise": Default(1.0),
        "offset_free": Default("output-disturbance"),
    },
    "nlqdmc-se": {
        "prediction_horizon": _BY_THE_MODEL,
        "move_weight": Default(10.0),
        "glucose_process_noise": Default(0.01),
        "other_process_noise": Default(1e-6),
    },
    "meal-mpc": {"prediction_horizon": _BY_THE_MODEL, "move_weight": Default(3.0)},
    "imc": {"filter_min": Default(120.0), "delay_min": Default(100.0), "step_mU_min": _SMALL_STEP},
    "pid": {"closed_loop_min": Default(120.0), "step_mU_min": _SMALL_STEP},
}


@dataclass(frozen=True, kw_only=True)
class _Route:
    """Default values for insulin by one route."""

    pump: PumpRange
    memory_min: float
    """Time after which the effect of a dose has died out."""
    laguerre_pole: float
    """Pole of the Laguerre functions, at 5-min samples."""
    laguerre_functions: int
    tunings: Tunings = field(default_factory=dict)
    """Settings of controllers, where they differ from the controller's own, which are for a vein."""

    def identification(self, sample_time_min: float) -> dict[str, Any]:
        """Usual identification of a model at a sample time: memory in samples, and the Laguerre functions."""
        return {
            "memory": max(2, round(self.memory_min / sample_time_min)),
            # at another sample time than 5 min the pole falls as fast
            "laguerre_pole": float(self.laguerre_pole ** (sample_time_min / 5.0)),
            "laguerre_functions": self.laguerre_functions,
        }


ROUTES: Final[Mapping[str, _Route]] = {
    INTRAVENOUS: _Route(pump=PUMP_OF_1999, memory_min=180.0, laguerre_pole=0.84, laguerre_functions=2),
    # Subcutaneous insulin acts for hours and glucose near the setpoint hardly regulates itself: a shorter record
    # would hide half of the gain.
    SUBCUTANEOUS: _Route(
        pump=_PUMP_UNDER_THE_SKIN, memory_min=1440.0, laguerre_pole=0.96, laguerre_functions=8, tunings=_SLOW_TUNINGS
    ),
}


def route_of(name: str) -> _Route:
    """A route by name; Refusal for an unknown one."""
    if name not in ROUTES:
        raise Refusal(f"unknown route of insulin {name!r}; {known_names(name, ROUTES)}")
    return ROUTES[name]
