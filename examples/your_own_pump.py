"""A pump of your own: its soft tube passes a change of the rate on slowly.

A pump is a record with `init` and `deliver`. Its part tells its limits and makes it known to every command.

    python examples/your_own_pump.py
    glucoloop run --pump 'your_own_pump:TubePump, lag_min=15'
"""

import dataclasses
import functools
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import jax
import numpy as np

import glucoloop as gl
from glucoloop.component import About
from glucoloop.control import internal_model_tuning
from glucoloop.pumps import Delivery, Pump, PumpPart
from glucoloop.pumps.protocol import deliver


@functools.partial(jax.tree_util.register_dataclass, data_fields=["inner", "left"], meta_fields=[])
@dataclass(frozen=True)
class SoftTube:
    """Passes the rate of the pump inside on behind a first-order lag; a bolus passes at once."""

    inner: Pump
    left: float
    """Share of a difference that is left after a sample."""

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> tuple[Any, jax.Array]:
        """State of a pump that has delivered this rate for a long time: of the pump inside, and the rate behind."""
        return self.inner.init(insulin_mU_min, key), insulin_mU_min

    def deliver(
        self, state: tuple[Any, jax.Array], command_mU_min: jax.Array, key: jax.Array, bolus_mU: jax.Array | None = None
    ) -> tuple[tuple[Any, jax.Array], Delivery]:
        """Deliver until the next command; the pump reports the rate that it drives, not the one behind the lag."""
        inner, driven = deliver(self.inner, state[0], command_mU_min, key, bolus_mU)
        behind = driven.insulin_mU_min + self.left * (state[1] - driven.insulin_mU_min)
        return (inner, behind), dataclasses.replace(driven, insulin_mU_min=behind)


class TubePump(PumpPart, name="soft-tube"):
    """A tube that passes changes of the rate on slowly."""

    limits: ClassVar = {"max_insulin_mU_min": 50.0, "max_change_mU_min": 10.0, "max_bolus_U": 10.0, "bolus_step_U": 0.1}
    lag_min: Annotated[float, About("Time constant of the tube.", above=0.0)] = 10.0

    def made(self, *, inner: Pump, sample_time_min: float, **known: object) -> SoftTube:
        """The pump around one that keeps the limits, for the sample time of the loop."""
        return SoftTube(inner, float(np.exp(-sample_time_min / self.lag_min)))


if __name__ == "__main__":
    limited = gl.LimitedPump(limits=gl.dose_limits(max_change_mU_min=10.0, max_mU_min=50.0))
    pump = TubePump().made(inner=limited, sample_time_min=5.0)
    trace = gl.simulate(gl.patient(), gl.design_pid(internal_model_tuning(-3.45, 89.1, 5.0, 30.0)), pump=pump)
    behind = float(abs(trace.reported_mU_min - trace.insulin_mU_min).max())
    print(f"delivery is behind the driven rate by up to {behind:.1f} mU/min")
