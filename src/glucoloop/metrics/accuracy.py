"""Accuracy of readings against the patient's glucose: mean absolute relative difference, bias and error grid.

References
----------
W. L. Clarke, D. Cox, L. A. Gonder-Frederick, W. Carter, S. L. Pohl, "Evaluating clinical accuracy of systems for
self-monitoring of blood glucose", Diabetes Care 10(5), 622-628, 1987: the zones of the error grid.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.metrics.metric import Ended, Metric, Result, Trajectory, count

if TYPE_CHECKING:
    from glucoloop.simulation.loop import Sampled

ZONES = ("a", "b", "c", "d", "e")


def clarke_zones(glucose_mg_dl: jax.Array, reading_mg_dl: jax.Array) -> dict[str, jax.Array]:
    """Whether a reading lies in each zone of Clarke's error grid; it lies in one of them. Lines go on beyond 400 mg/dl.

    Packages that have the grid branch on one pair of Python numbers; this is traced into the loop, for any number of
    people.

    ====  ================================================================================
    zone  readings
    ====  ================================================================================
    a     within 20 % of glucose, or of 70 mg/dl or less as glucose is
    b     others, which would lead to no treatment or a harmless one
    c     that would have glucose within the target range treated too much
    d     of 70 to 180 mg/dl while glucose is not, so that it would not be treated
    e     low while glucose is high, or high while it is low: treated the wrong way
    ====  ================================================================================
    """
    g, r = glucose_mg_dl, reading_mg_dl
    a = ((g <= 70.0) & (r <= 70.0)) | ((r <= 1.2 * g) & (r >= 0.8 * g))
    e = ((g >= 180.0) & (r <= 70.0)) | ((g <= 70.0) & (r >= 180.0))
    c = ((g >= 70.0) & (r >= g + 110.0)) | ((g >= 130.0) & (g <= 180.0) & (r <= 1.4 * g - 182.0))
    d = (r >= 70.0) & (r <= 180.0) & ((g >= 240.0) | (g <= 70.0))
    result, left = {"a": a}, ~a
    for zone, within in (("e", e), ("c", c), ("d", d)):
        result[zone], left = left & within, left & ~within
    result["b"] = left
    return {zone: result[zone] for zone in ZONES}


_CLARKE: Final = {
    "A": "accurate",
    "B": "off with little consequence",
    "C": "which would lead to a treatment that is not needed",
    "D": "which would hide low or high glucose",
    "E": "which would lead to the opposite treatment",
}


@pytree
class _Sums:
    readings: jax.Array
    difference_mg_dl: jax.Array
    relative: jax.Array
    """Sum of absolute differences, each relative to glucose."""
    zones: dict[str, jax.Array]


class SensorAccuracy(Metric, name="sensor-accuracy"):
    """Accuracy of the readings: mean absolute relative difference, bias and error grid.

    Differences of the readings from glucose of the patient at the samples; samples without a reading do not count.

    Glucose is that which is controlled, so that the lag of tissue under the skin is part of the difference, as in
    trials of sensors against samples of blood.
    """

    section = "Sensor"
    sources = ("clarke1987",)
    numbers = (
        Result(
            "mard_pct",
            "Mean absolute relative difference of the readings from the patient's glucose at the samples.",
            "Mean absolute relative difference",
            "%",
        ),
        Result("reading_bias_mg_dl", "Mean difference of the readings from it.", "Bias of the readings", "mg/dl"),
        *(
            Result(
                f"clarke_{zone.lower()}_pct",
                f"Percentage of the readings in zone {zone} of Clarke's error grid, {what}.",
                f"Error grid, zone {zone}",
                "%",
            )
            for zone, what in _CLARKE.items()
        ),
    )

    def init(self, trajectory: Trajectory, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> _Sums:
        zero = jnp.zeros_like(glucose_mg_dl)
        return _Sums(readings=zero, difference_mg_dl=zero, relative=zero, zones=dict.fromkeys(ZONES, zero))

    def sample(self, trajectory: Trajectory, state: _Sums, happened: Sampled, t_min: jax.Array) -> _Sums:
        glucose, reading = happened.glucose_mg_dl, happened.reading.glucose_mg_dl
        there = happened.reading.valid & jnp.isfinite(reading)
        difference = jnp.where(there, reading - glucose, 0.0)
        zones = clarke_zones(glucose, reading)
        return _Sums(
            readings=state.readings + count(there, state.readings),
            difference_mg_dl=state.difference_mg_dl + difference,
            relative=state.relative + jnp.abs(difference) / glucose,
            zones={zone: n + count(there & zones[zone], n) for zone, n in state.zones.items()},
        )

    def finish(self, trajectory: Trajectory, state: _Sums, ended: Ended) -> dict[str, Any]:
        xp = ended.xp
        readings = xp.where(state.readings > 0.0, state.readings, xp.nan)
        result = {
            "mard_pct": 100.0 * state.relative / readings,
            "reading_bias_mg_dl": state.difference_mg_dl / readings,
            **{f"clarke_{zone}_pct": 100.0 * n / readings for zone, n in state.zones.items()},
        }
        return {name: ended.of_glucose(value) for name, value in result.items()}
