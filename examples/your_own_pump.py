"""A pump of your own, with a soft tube: ``glucoloop run --pump 'your_own_pump:TubePump, lag_min=15'``."""

import dataclasses
from typing import Annotated, Any, ClassVar

import jax
import jax.numpy as jnp

import glucoloop as gl
from glucoloop.plugin import STATIC, About, PumpAround, deliver, wired


class TubePump(PumpAround, name="soft-tube"):
    """A tube that passes changes of the rate on slowly; a bolus passes at once."""

    own_limits: ClassVar = {"max_insulin_mU_min": 50, "max_change_mU_min": 10, "max_bolus_U": 10, "bolus_step_U": 0.1}
    lag_min: Annotated[float, About("Time constant of the tube.", above=0.0)] = 10.0
    sample_time_min: float = wired(STATIC, default=5.0)

    def init(self, insulin_mU_min: jax.Array, key: jax.Array) -> Any:
        """State of a pump that has delivered this rate for a long time: of the pump inside, and the rate behind."""
        return self.inner.init(insulin_mU_min, key), insulin_mU_min

    def deliver(self, state: Any, command_mU_min: jax.Array, key: jax.Array, bolus_mU: Any = None) -> Any:
        """Deliver until the next command; the pump reports the rate that it drives, not the one behind the lag."""
        inner, driven = deliver(self.inner, state[0], command_mU_min, key, bolus_mU)
        left, rate = jnp.exp(-self.sample_time_min / self.lag_min), driven.insulin_mU_min
        behind = rate + left * (state[1] - rate)
        return (inner, behind), dataclasses.replace(driven, insulin_mU_min=behind)


if __name__ == "__main__":
    trace = gl.simulate(gl.patient(), gl.design_pid(gl.internal_model_tuning(-3.45, 89.1, 5.0, 30.0)), pump=TubePump())
    behind = abs(trace.reported_mU_min - trace.insulin_mU_min).max()
    print(f"delivery is behind the driven rate by up to {behind:.1f} mU/min")
