"""A controller with its tuning, and the identification of its model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from glucoloop.control.catalogue import complete, controller_entry
from glucoloop.experiments.situation import Situation
from glucoloop.parts.setting import Value


@dataclass(frozen=True, kw_only=True)
class Case:
    """A controller with its tuning, and the identification of its model."""

    label: str
    controller: str
    tuning: Mapping[str, Value]
    """Every setting of the controller."""
    known_dead_time: bool = False
    model_noise_variance: float | None = None
    """Noise variance of the record from which the model is identified; None, like the next three, for a controller
    without a model.
    """
    memory: int | None = None
    laguerre_pole: float | None = None
    laguerre_functions: int | None = None
    guard: Mapping[str, Value] | None = None
    """All limits of the guard, or None for a controller without a guard."""
    faults: tuple[str, ...] = ()
    """Faults of the case, around those of the situation, each as its text."""


def usual_case(controller: str, situation: Situation) -> Case:
    """A controller with the settings that are usual in a situation, on a model identified from an equally noisy record.

    Raises
    ------
    ValueError
        For an unknown controller.
    """
    entry, point = situation.whom
    noisy = situation.noise_variance > 0.0
    identification = {}
    if controller_entry(controller).uses_model:
        identification = entry.identification(situation.sample_time_min)
        identification["model_noise_variance"] = situation.noise_variance
    tuning = complete(controller, {}, entry, point, noisy=noisy)
    return Case(label=controller, controller=controller, tuning=tuning, **identification)
