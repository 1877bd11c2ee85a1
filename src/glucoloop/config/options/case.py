"""Keys of a case: a controller, its guard, and the model that it is designed on."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Final

from glucoloop.config.key import Key, plain
from glucoloop.control.catalogue import CONTROLLERS, USUAL_CONTROLLER
from glucoloop.parts.setting import Value
from glucoloop.plausible import NOISE_VARIANCE

if TYPE_CHECKING:
    from glucoloop.situations.case import Case

CONTROLLER_PANEL: Final = "Controller"
MODEL_PANEL: Final = "Model"
GUARD_PANEL: Final = "Guard"
OF_OTHERS: Final = "or one of another package, or module:attribute, whose settings are given by --setting"
"""Text for help on controllers of other packages."""
CONTROLLERS_TOLD: Final = "; ".join(f"{entry.name}: {entry.summary}" for entry in CONTROLLERS.values())
IDENTIFICATION_KEYS: Final = ("model_noise_variance", "memory", "laguerre_pole", "laguerre_functions")
"""Keys of the identification of a model for the run; `model`, which names a file, replaces them."""

_model = functools.partial(Key, panel=MODEL_PANEL)
MEMORY: Final = _model(
    "Number of samples after which the effect of a dose has died out, M.",
    metavar="M",
    told="3 hours",
    at_least=2,
    at_most=2000,
)
LAGUERRE_POLE: Final = _model(
    "Pole of the Laguerre functions that smooth the impulse response.",
    metavar="POLE",
    told="0.84 at 5-min samples",
    above=0.0,
    below=1.0,
)
LAGUERRE_FUNCTIONS: Final = _model(
    "Number of Laguerre functions; 0 leaves the impulse response as it was estimated.",
    metavar="L",
    told="2",
    at_least=0,
    at_most=50,
)


@dataclass(frozen=True, kw_only=True)
class CaseKeys:
    """A controller, its tuning, and the model it is designed on."""

    controller: Annotated[str, Key(f"{CONTROLLERS_TOLD}; {OF_OTHERS}.", panel=CONTROLLER_PANEL)] = USUAL_CONTROLLER
    tuning: Mapping[str, Value] = field(default_factory=dict)
    """Settings of the controller, which `control.settings` declares."""
    known_dead_time: Annotated[
        bool,
        Key(
            "Whether the controller knows the dead time: its model is then delayed and its prediction horizon longer.",
            panel=CONTROLLER_PANEL,
            flag="--known-dead-time/--unknown-dead-time",
            told="unknown",
        ),
    ] = False
    guard: Annotated[
        bool,
        Key(
            "Put a guard around the controller: it rejects impossible readings, falls back to the basal rate without "
            "readings, suspends insulin on predicted low glucose, and bounds the dose.",
            panel=GUARD_PANEL,
            flag="--guard/--no-guard",
            told="no guard",
        ),
    ] = False
    guard_limits: Mapping[str, Value] = field(default_factory=dict)
    """Limits of the guard, which `parts.guard` declares; empty without a guard."""
    model: Annotated[
        str | None,
        _model("Model from `glucoloop identify`; by default one is identified from the patient.", metavar="FILE"),
    ] = None
    model_noise_variance: Annotated[
        float | None,
        _model(
            "Variance of the noise on the record that the model is identified from.",
            flag="--model-noise",
            told="as --noise",
            at_least=0.0,
            at_most=10_000.0,
            quantity=NOISE_VARIANCE,
        ),
    ] = None
    memory: Annotated[int | None, MEMORY] = None
    laguerre_pole: Annotated[float | None, LAGUERRE_POLE] = None
    laguerre_functions: Annotated[int | None, LAGUERRE_FUNCTIONS] = None

    def case(self, label: str | None = None) -> Case:
        """Case of an experiment; its controller's name is its label unless another one is given."""
        from glucoloop.situations.case import Case

        return Case(
            label=self.controller if label is None else label,
            controller=self.controller,
            tuning=dict(self.tuning),
            known_dead_time=self.known_dead_time,
            guard=dict(self.guard_limits) if self.guard else None,
            **{key: getattr(self, key) for key in IDENTIFICATION_KEYS},
        )


def case_keys(case: CaseKeys) -> dict[str, Any]:
    """Flat keys of a case; those of its tuning stand among the others."""
    keys = plain(case)
    limits = keys.pop("guard_limits")
    return {"controller": keys.pop("controller"), **keys.pop("tuning"), **keys, **limits}
