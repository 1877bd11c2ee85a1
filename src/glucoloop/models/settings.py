"""Models on which a controller may be designed: one that is identified for the run, or one from a file."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.grammar import NAME, Leaf, Tree
from glucoloop.component.setting import About
from glucoloop.unit_guess import NOISE_VARIANCE

MEMORY: Final = About(
    "Number of samples after which the effect of a dose has died out, M; by default three hours, or a day "
    "for subcutaneous insulin.",
    at_least=2,
    at_most=2000,
)
LAGUERRE_POLE: Final = About(
    "Pole of the Laguerre functions that smooth the impulse response; by default 0.84 at 5-min samples, or that of the "
    "route of insulin.",
    above=0.0,
    below=1.0,
)
LAGUERRE_FUNCTIONS: Final = About(
    "Number of Laguerre functions; 0 leaves the impulse response as it was estimated; by default 2, or that of the "
    "route of insulin.",
    at_least=0,
    at_most=50,
)


class ModelComponent(Component):
    """Declaration of a model on which a controller is designed."""

    kind: ClassVar = "model"


class IdentifiedComponent(ModelComponent, name="identified"):
    """A model identified from the patient by the pulse experiment."""

    noise_variance: Annotated[
        float | None,
        About(
            "Variance of the noise on the record; by default that of the readings of the run.",
            at_least=0.0,
            at_most=10_000.0,
            quantity=NOISE_VARIANCE,
        ),
    ] = None
    memory: Annotated[int | None, MEMORY] = None
    laguerre_pole: Annotated[float | None, LAGUERRE_POLE] = None
    laguerre_functions: Annotated[int | None, LAGUERRE_FUNCTIONS] = None


class FileComponent(ModelComponent, name="file"):
    """A model from a file that `glucoloop identify` wrote."""

    path: Annotated[str, About("The file, model.json.")] = "model.json"


class _Models(Catalogue[ModelComponent]):
    """The models; a text that names none is the path of a file."""

    def tree(self, text: str, source: str = "") -> Tree:
        """Tree of a model from its text, or from the path of a file."""
        path = text.strip()
        if path and "=" not in path.partition(",")[0] and path.partition(",")[0].strip() not in self:
            return {NAME: Leaf(FileComponent.name, source), "path": Leaf(path, source, text=False)}
        return super().tree(text, source)


MODELS: Final = _Models(
    ModelComponent,
    {
        "identified": "glucoloop.models.settings:IdentifiedComponent",
        "file": "glucoloop.models.settings:FileComponent",
    },
    example="identified, memory=48",
    unnamed=True,
)
