"""A fault of your own: a sensor that gives its readings in coarse steps while the fault is present.

A fault is a record around another sensor (or pump), whose field ``inner`` is that sensor; one that changes single
readings needs one method. Its part makes it known to every command.

    python examples/your_own_fault.py
    glucoloop run --fault 'your_own_fault:CoarseReadings, step_mg_dl=20, start_min=60'
"""

import functools
from dataclasses import dataclass
from typing import Annotated

import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.component import About
from glucoloop.control import internal_model_tuning
from glucoloop.episodes import Episodes, always
from glucoloop.faults import Timed
from glucoloop.sensors import Reading, Sensor
from glucoloop.sensors.faults.wrapping import AlteredReadings


@functools.partial(jax.tree_util.register_dataclass, data_fields=["inner", "episodes", "step_mg_dl"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Coarse(AlteredReadings):
    """Gives the reading of the inner sensor in whole steps."""

    step_mg_dl: float

    def altered(self, reading: Reading, age: jax.Array) -> Reading:
        """Reading that is given while the fault is present; ``age`` is the number of samples since it began."""
        coarse = self.step_mg_dl * jnp.round(reading.glucose_mg_dl / self.step_mg_dl)
        return Reading(glucose_mg_dl=coarse, valid=reading.valid)


class CoarseReadings(Timed, name="coarse"):
    """Readings are given in coarse steps."""

    step_mg_dl: Annotated[float, About("Step of the readings.", above=0.0)] = 10.0

    def made(self, *, inner: Sensor, episodes: Episodes, **known: object) -> Coarse:
        """The fault around a sensor, while its times say so."""
        return Coarse(inner=inner, episodes=episodes, step_mg_dl=self.step_mg_dl)


if __name__ == "__main__":
    sensor = CoarseReadings(step_mg_dl=20.0).made(inner=gl.white_noise(1.45), episodes=always())
    trace = gl.simulate(gl.patient(), gl.design_pid(internal_model_tuning(-3.45, 89.1, 5.0, 30.0)), sensor, key=1)
    print(
        f"readings: {', '.join(f'{float(reading):g}' for reading in sorted(set(trace.reading_mg_dl.tolist())))} mg/dl"
    )
