"""``model.json``: an identified step-response model and its origin."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import jax.numpy as jnp
import numpy as np

import glucoloop
from glucoloop.identification import Identification, Reliability, doubts
from glucoloop.models.step_response import Realisation, StepResponseModel, refuse_other_response
from glucoloop.refusal import Refusal
from glucoloop.schema.values import ValueBounds, checked, json_value
from glucoloop.situations.situation import LONGEST_SAMPLE_TIME_MIN, SHORTEST_SAMPLE_TIME_MIN
from glucoloop.storage.files import json_text, read_text

_ROUNDING: Final = 1e-9
_LARGEST_RESPONSE: Final = 1e6
"""Largest response of glucose to insulin, mg/dl per mU/min; that of a person is below 100."""

Response = Annotated[list[float], ValueBounds(shortest=1, longest=10_000)]
_FromZero = Annotated[float, ValueBounds(at_least=0.0)]


@dataclass(frozen=True, kw_only=True)
class _RestingPoint:
    """Steady state around which the model holds."""

    name: str | None
    """Name of the simulated patient's operating point; None for a record."""
    basal_insulin_mU_min: _FromZero
    glucose_mg_dl: float


@dataclass(frozen=True, kw_only=True)
class _Provenance:
    """Origin of the model."""

    glucoloop: str
    """Version of glucoloop."""
    source: str
    """Sentence on the source of the record."""
    method: str
    dead_time_min: _FromZero = 0.0
    """Dead time of the readings in the record, which the model contains."""
    settings: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    """Sentences on the processing of the record."""


@dataclass(frozen=True, kw_only=True)
class _Recursion:
    """Linear system that generates the impulse response; see `models.step_response.Realisation`."""

    transition: Annotated[list[Response], ValueBounds(shortest=1, longest=100)]
    start: Response
    output: Response
    """Output of each state, mg/dl per mU/min."""
    after: Annotated[int, ValueBounds(at_least=0)]

    def __post_init__(self) -> None:
        if {len(self.start), len(self.output), *map(len, self.transition)} != {len(self.transition)}:
            raise Refusal("a realisation whose transition, start and output do not have the same number of states")

    def value(self) -> Realisation:
        """Realisation for a model."""
        transition, start, output = map(jnp.asarray, (self.transition, self.start, self.output))
        return Realisation(transition=transition, start=start, output=output, after=self.after)

    @classmethod
    def of(cls, realisation: Realisation) -> Self:
        """Contents of the file for a realisation."""
        return cls(**{part.name: np.asarray(getattr(realisation, part.name)).tolist() for part in fields(cls)})


@dataclass(frozen=True, kw_only=True)
class ModelFile:
    """Contents of a model file."""

    format: Literal["glucoloop-model"] = "glucoloop-model"
    version: Literal[1] = 1
    sample_time_min: Annotated[float, ValueBounds(at_least=SHORTEST_SAMPLE_TIME_MIN, at_most=LONGEST_SAMPLE_TIME_MIN)]
    step_response: Response
    """S_1 .. S_M, mg/dl per mU/min."""
    impulse_response: Response
    """h_1 .. h_M, its increments."""
    realisation: _Recursion | None = None
    """The response beyond its memory; None for one that ends there."""
    operating_point: _RestingPoint
    quality: Reliability | None = None
    """Quality of the model; None in a file from another program."""
    provenance: _Provenance

    def __post_init__(self) -> None:
        step, impulse = np.array(self.step_response), np.array(self.impulse_response)
        if step.size != impulse.size:
            raise Refusal(f"{step.size} values of the step response and {impulse.size} of the impulse response")
        largest = np.abs(step).max()
        if largest > _LARGEST_RESPONSE:
            raise Refusal(f"a step response of {largest:g} mg/dl per mU/min, above {_LARGEST_RESPONSE:g}")
        with np.errstate(over="ignore"):
            total = np.cumsum(impulse)
        if not np.allclose(total, step, rtol=0.0, atol=_ROUNDING * largest):
            raise Refusal("a step response that is not the running sum of the impulse response")
        if self.realisation is not None:
            refuse_other_response(self.realisation.value(), impulse)

    def step_response_model(self) -> StepResponseModel:
        """Step-response model for a controller."""
        return StepResponseModel(
            step_response=jnp.asarray(self.step_response),
            sample_time_min=self.sample_time_min,
            realisation=None if self.realisation is None else self.realisation.value(),
        )

    @property
    def gain(self) -> float:
        """Steady change of glucose for a lasting change of insulin, mg/dl per mU/min."""
        return float(self.step_response_model().gain)

    def doubts(self) -> tuple[str, ...]:
        """Reasons why no controller should be designed on the model, one sentence each; empty for a sound model."""
        resting = self.operating_point
        return doubts(
            self.gain,
            self.quality,
            basal_insulin_mU_min=resting.basal_insulin_mU_min,
            glucose_mg_dl=resting.glucose_mg_dl,
        )

    def plain(self) -> dict[str, Any]:
        """The model as plain values."""
        return asdict(self)

    def text(self) -> str:
        """JSON from which the same model is read, to the last bit."""
        return json_text(self.plain()) + "\n"


def model_file(
    identification: Identification,
    *,
    operating_point: str | None,
    source: str,
    dead_time_min: float,
    settings: dict[str, Any],
    notes: tuple[str, ...] = (),
) -> ModelFile:
    """Model file of an identification."""
    model = identification.model
    return ModelFile(
        sample_time_min=model.sample_time_min,
        step_response=np.asarray(model.step_response).tolist(),
        impulse_response=np.asarray(model.impulse_response).tolist(),
        realisation=None if model.realisation is None else _Recursion.of(model.realisation),
        operating_point=_RestingPoint(
            name=operating_point,
            basal_insulin_mU_min=identification.basal_insulin_mU_min,
            glucose_mg_dl=identification.baseline_glucose_mg_dl,
        ),
        quality=identification.reliability,
        provenance=_Provenance(
            glucoloop=glucoloop.__version__,
            source=source,
            method=identification.method,
            dead_time_min=dead_time_min,
            settings=settings,
            notes=notes,
        ),
    )


def read_model(path: Path) -> ModelFile:
    """Model from its file; ValueError for values that are missing, wrong, not finite or at odds with each other."""
    text = read_text(path, "a model")
    try:
        return checked(ModelFile, json_value(text))
    except Refusal as error:
        raise Refusal(f"{path} is not a model that can be used: {error}; write one with glucoloop identify") from None
