"""The last reading and how fast glucose changes (``glucose-get-last.js``)."""

from __future__ import annotations

from typing import Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop.control.oref0.records import GlucoseStatus
from glucoloop.control.oref0.rounding import rounded

LAST_MIN: Final = 5.0
"""Time between two readings."""
_SHORT, _LONG = (1, 2, 3), (4, 5, 6, 7, 8)
"""Readings of the short and the long average, 5 to 15 and 20 to 40 min before the last one."""
_OLDEST: Final = 2
"""Samples after which the last reading is too old to dose by; rates of change do not matter then."""
READINGS: Final = _OLDEST + _LONG[-1] + 1
"""Number of readings that are looked at."""
_MIN_MG_DL: Final = 38.0


def glucose_get_last(readings_mg_dl: jax.Array) -> GlucoseStatus:
    """Status of glucose from readings every 5 min ``(readings,)``, of which the first is now; 0 where there is none."""
    known = readings_mg_dl > 0.0
    age = jnp.where(known[0], 0, jnp.where(known[1], 1, _OLDEST))
    row = readings_mg_dl[_OLDEST:]
    for late in range(_OLDEST - 1, -1, -1):
        row = jnp.where(age == late, readings_mg_dl[late : READINGS - _OLDEST + late], row)
    minutes_ago = jnp.where(jnp.any(known[: _OLDEST + 1], axis=0), LAST_MIN * age, 1e3)

    def mean(which: tuple[int, ...]) -> jax.Array:
        total = count = jnp.zeros_like(row[0])
        for i in which:
            there = row[i] > _MIN_MG_DL
            total = total + jnp.where(there, (row[0] - row[i]) / (LAST_MIN * i) * 5.0, 0.0)
            count = count + there
        return rounded(total / jnp.maximum(count, 1.0), 2)

    return GlucoseStatus(
        glucose_mg_dl=rounded(row[0], 2),
        delta=mean(_SHORT[:1]),
        short_avgdelta=mean(_SHORT),
        long_avgdelta=mean(_LONG),
        minutes_ago=minutes_ago,
    )
