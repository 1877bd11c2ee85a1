"""Rest of a patient under a constant infusion, with the checks and the sentences that all families share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from glucoloop._lazy_jax import jax, jnp, np, npt
from glucoloop.arguments import at_once, is_traced
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from jax.typing import ArrayLike

Constants: TypeAlias = Any
"""Parameters of a family, of one person or of many, who trail."""


@dataclass(frozen=True)
class Rest:
    """Functions by which a family rests. Each takes constants first, and none of them raises."""

    under: Callable[[Constants, jax.Array], jax.Array]
    """Steady state ``(states, ...)`` under a rate in mU/min."""
    holding: Callable[[Constants, jax.Array], jax.Array]
    """Rate in mU/min that holds a glucose in mg/dl; NaN where none of 0 or more does."""
    glucose_mg_dl: Callable[[Constants, Any], Any]
    """Glucose that is controlled, from the state."""
    largest_mU_min: Callable[[Constants], ArrayLike]
    """Rate under which glucose would rest at 0 mg/dl."""
    highest_mg_dl: Callable[[Constants], ArrayLike]
    """Glucose at steady state without insulin."""
    beyond: str
    """Reason why no greater rate has a steady state, for messages."""

    def state(self, p: Constants, insulin_mU_min: jax.Array | float) -> jax.Array:
        """Steady state under a constant infusion; refuse a rate under which glucose would not stay above 0 mg/dl."""
        if is_traced(p, insulin_mU_min):
            return self.under(p, jnp.asarray(insulin_mU_min, float))
        with at_once():
            u = np.asarray(insulin_mU_min, float)
            possible = np.isfinite(u) & (u >= 0.0)
            if not np.all(possible):
                raise Refusal(
                    f"an insulin infusion of {u[~possible].flat[0]:g} mU/min is not possible; "
                    "give a finite rate of 0 or more"
                )
            x = _kept(self.under, p, jnp.asarray(u))
            above = np.asarray(self.glucose_mg_dl(p, np.asarray(x))) > 0.0
            if not np.all(above):
                raise Refusal(
                    f"no physiological steady state exists at {_first(u, ~above):g} mU/min: {self.beyond}; "
                    f"give less than {np.min(np.asarray(self.largest_mU_min(p))):.2f} mU/min"
                )
            return x

    def insulin(self, p: Constants, glucose_mg_dl: jax.Array | float) -> jax.Array:
        """Infusion that holds a glucose; refuse a glucose that no infusion of 0 or more holds."""
        if is_traced(p, glucose_mg_dl):
            return self.holding(p, jnp.asarray(glucose_mg_dl, float))
        with at_once():
            glucose = np.asarray(glucose_mg_dl, float)
            u = _kept(self.holding, p, jnp.asarray(glucose))
            feasible = np.isfinite(np.asarray(u)) & (glucose > 0.0)
            if not np.all(feasible):
                raise Refusal(
                    f"no insulin infusion holds glucose at {_first(glucose, ~feasible):g} mg/dl; give a value above 0 "
                    f"and at most {np.min(np.asarray(self.highest_mg_dl(p))):.2f} mg/dl, where this patient rests "
                    "without insulin"
                )
            return u

    def at_basal(self, p: Constants, insulin_mU_min: jax.Array | float) -> dict[str, Any]:
        """Fields of the patient whose setpoint is the steady glucose under an infusion; raises as `state` does."""
        with at_once(p, insulin_mU_min):
            x = self.state(p, insulin_mU_min)
            basal = jnp.asarray(insulin_mU_min, float)
            return {"parameters": p, "basal_insulin_mU_min": basal, "setpoint_mg_dl": self.glucose_mg_dl(p, x)}

    def at_setpoint(self, p: Constants, glucose_mg_dl: jax.Array | float) -> dict[str, Any]:
        """Fields of the patient whose basal rate holds a glucose; raises as `insulin` does."""
        with at_once(p, glucose_mg_dl):
            u = self.insulin(p, glucose_mg_dl)
            setpoint = jnp.broadcast_to(jnp.asarray(glucose_mg_dl, float), u.shape)
            return {"parameters": p, "basal_insulin_mU_min": u, "setpoint_mg_dl": setpoint}


def _kept(function: Callable[..., jax.Array], *arguments: Any) -> jax.Array:
    from glucoloop._disk_cache import kept_result  # what only help needs computes nothing

    return kept_result(function, *arguments)


def _first(values: npt.NDArray[np.float64], which: npt.NDArray[np.bool_]) -> float:
    return float(np.broadcast_to(values, which.shape)[which].flat[0])


def shape_of_people(p: Constants, given: ArrayLike) -> tuple[int, ...]:
    """Shape of the people in the constants that vary, and in a rate or a glucose."""
    return jnp.broadcast_shapes(jnp.shape(given), *(jnp.shape(constant) for constant in jax.tree.leaves(p)))
