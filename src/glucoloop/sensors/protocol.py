"""Protocol of a glucose sensor in the loop, what all sensors of the package have, and one without error or delay."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY
from typing import Annotated, Any, ClassVar, Final, Protocol

from glucoloop._lazy_jax import jax, jnp
from glucoloop._pytree import pytree
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.effects import READINGS, Need
from glucoloop.component.pytree_component import DATA, HOST, PytreeComponent, wired
from glucoloop.component.setting import About
from glucoloop.refusal import Refusal


@pytree
class Reading:
    """One reading of a sensor, with its validity."""

    glucose_mg_dl: jax.Array
    valid: jax.Array
    """False where the sensor reports that it has no reading."""


class Sensor(Protocol):
    """Turns the patient's glucose into readings. The state is any pytree; randomness comes from the key alone."""

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> Any:
        """State of a sensor that has read the given glucose for a long time."""

    def read(self, state: Any, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[Any, Reading]:
        """Read once per sample, with a key of its own."""


def site_of(sensor: Sensor) -> str | None:
    """Site of a sensor, that of the innermost of nested sensors; None is where glucose is controlled."""
    inner: Any = sensor
    while hasattr(inner, "inner"):
        inner = inner.inner
    site: str | None = getattr(inner, "site", None)
    return site


def checked_sample_time(sample_time_min: float) -> float:
    """A sample time, refused unless it is positive and finite."""
    if not 0.0 < sample_time_min < math.inf:
        raise Refusal(f"a sample time of {sample_time_min:g} min is not possible; give a finite value above 0")
    return float(sample_time_min)


def whole_samples(minutes: float, sample_time_min: float, what: str) -> int:
    """Minutes as a number of samples; Refusal unless it is a whole one. `what` names the quantity in messages."""
    samples = round(minutes / sample_time_min)
    if abs(samples * sample_time_min - minutes) > 1e-9 * max(minutes, sample_time_min):
        below = int(minutes / sample_time_min) * sample_time_min
        raise Refusal(
            f"{what} of {minutes:g} min is not a whole number of {sample_time_min:g}-min samples; "
            f"give {below:g} or {below + sample_time_min:g} min"
        )
    return samples


class SensorComponent(PytreeComponent):
    """A sensor, with `init` and `read`; one around another extends `SensorAround`.

    One that can be at different sites of the patient has a field ``site``, as `IdealSensor` has.
    """

    kind: ClassVar = "sensor"

    _: KW_ONLY
    sample_time_min: float = wired(HOST, default=5.0)

    def __post_init__(self) -> None:
        checked_sample_time(self.sample_time_min)

    def needs(self) -> tuple[Need, ...]:
        """A sensor has an effect where something uses its readings."""
        return (READINGS,)

    def recorded(self) -> SensorComponent | None:
        """Sensor of a record from which a model is identified, by default this one; None where it is left out.

        Such a record has its own white noise, and no delay of the kind that is known to a controller.
        """
        return self


SENSORS: Final = Catalogue(
    SensorComponent,
    {
        "ideal": "glucoloop.sensors.protocol:IdealSensor",
        "white-noise": "glucoloop.sensors.noise:WhiteNoise",
        "correlated-noise": "glucoloop.sensors.noise:CorrelatedNoise",
        "lag": "glucoloop.sensors.delay:Lag",
        "dead-time": "glucoloop.sensors.delay:DeadTime",
        "breton-2008": "glucoloop.sensors.cgm.published:Breton2008",
        "facchinetti-2014": "glucoloop.sensors.cgm.published:Facchinetti2014",
        "dexcom-g5": "glucoloop.sensors.cgm.published:DexcomG5",
        "dexcom-g6": "glucoloop.sensors.cgm.published:DexcomG6",
        "vettoretti-2019": "glucoloop.sensors.cgm.published:Vettoretti2019",
        "cgm-display": "glucoloop.sensors.cgm.monitor:Display",
    },
    example="white-noise, variance=1.45",
)


class IdealSensor(SensorComponent, name="ideal"):
    """Readings without error or delay; the innermost of a chain, which says where glucose is read."""

    site: Annotated[
        str | None,
        About(
            "Site: arterial or interstitial, or plasma or interstitial, depending on the patient; by default that at "
            "which glucose is controlled."
        ),
    ] = None

    def init(self, glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[()]:
        """Empty state, since the sensor has no memory."""
        return ()

    def read(self, state: tuple[()], glucose_mg_dl: jax.Array, key: jax.Array) -> tuple[tuple[()], Reading]:
        """Read the true glucose of this moment."""
        return state, Reading(glucose_mg_dl=glucose_mg_dl, valid=jnp.isfinite(glucose_mg_dl))


class SensorAround(SensorComponent):
    """A sensor around another one, its ``inner``, by default an ideal one."""

    _: KW_ONLY
    inner: Sensor = wired(DATA, default_factory=IdealSensor)
