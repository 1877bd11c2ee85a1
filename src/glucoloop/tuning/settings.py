"""Samplers of tunings for `glucoloop robust`: name and settings of each, and the place of the function that makes it.

A sampler joins the command by one class, entered in `SAMPLERS` or by the entry point of another package in the group
``glucoloop.samplers``.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.component.part import MadePart
from glucoloop.component.setting import About
from glucoloop.limits import LARGEST_SEED


class SamplerPart(MadePart):
    """Declaration of a sampler, a `tuning.samplers.Sampler`.

    Its function is also given, if it has parameters of these names, ``space`` (a `component.ranges.Tuned` for each
    number), ``batch`` (the number of tunings in a round) and ``start`` (the tuning to be tried first, or None).
    """

    kind: ClassVar = "sampler"
    seed: Annotated[int, About("Seed of what it draws.", at_least=0, at_most=LARGEST_SEED)] = 0


class _TPESettings(SamplerPart, name="tpe"):
    """Parzen estimators of good and of other tunings, by Optuna."""

    make: ClassVar = "glucoloop.tuning.samplers:tpe"


class _NSGA2Settings(SamplerPart, name="nsga2"):
    """The evolutionary algorithm NSGA-II, by Optuna."""

    make: ClassVar = "glucoloop.tuning.samplers:nsga2"


class _RandomSettings(SamplerPart, name="random"):
    """Random draws, uniform between the bounds or in the logarithm."""

    make: ClassVar = "glucoloop.tuning.samplers:RandomDraws"


SAMPLERS: Final = Catalogue(
    SamplerPart, (_TPESettings, _NSGA2Settings, _RandomSettings), example="tpe, seed=3", unnamed=True
)
