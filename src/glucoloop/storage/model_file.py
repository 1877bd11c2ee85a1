"""``model.json``: an identified step-response model and its origin."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import jax.numpy as jnp
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

import glucoloop
from glucoloop.component.setting import shown
from glucoloop.identification import Identification, Reliability, doubts
from glucoloop.models.step_response import Realisation, StepResponseModel, refuse_other_response
from glucoloop.refusal import Refusal
from glucoloop.situations.situation import LONGEST_SAMPLE_TIME_MIN, SHORTEST_SAMPLE_TIME_MIN
from glucoloop.situations.toml import deeper_than
from glucoloop.storage.files import json_text, read_text

_ROUNDING: Final = 1e-9
_DEEPEST: Final = 10
_MOST_STATES: Final = 100
_LARGEST_RESPONSE: Final = 1e6
"""Largest response of glucose to insulin, mg/dl per mU/min; that of a person is below 100."""

Response = Annotated[list[float], Field(min_length=1, max_length=10_000)]


class Strict(BaseModel):
    """Part of a file that holds exactly these keys, of exactly these types."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class RestingPoint(Strict):
    """Steady state around which the model holds."""

    name: str | None
    """Name of the simulated patient's operating point; None for a record."""
    basal_insulin_mU_min: Annotated[float, Field(ge=0.0)]
    glucose_mg_dl: float


class Provenance(Strict):
    """Origin of the model."""

    glucoloop: str
    """Version of glucoloop."""
    source: str
    """Sentence on the source of the record."""
    method: str
    dead_time_min: Annotated[float, Field(ge=0.0)] = 0.0
    """Dead time of the readings in the record, which the model contains."""
    settings: dict[str, Any] = Field(default_factory=dict)
    notes: tuple[str, ...] = ()
    """Sentences on the processing of the record."""


class Quality(Strict):
    """Quality of the model according to the record; see `identification.Reliability`."""

    gain_margin: Annotated[float, Field(ge=0.0)]
    """Half the width of the 95 % confidence interval of the gain, mg/dl per mU/min."""
    explained_percent: Annotated[float, Field(le=100.0)]
    """Share of the variance of readings left out of the fit that is predicted."""


class Recursion(Strict):
    """Linear system that generates the impulse response; see `models.step_response.Realisation`."""

    transition: Annotated[list[Response], Field(min_length=1, max_length=_MOST_STATES)]
    start: Response
    output: Response
    """Output of each state, mg/dl per mU/min."""
    after: Annotated[int, Field(ge=0)]

    @model_validator(mode="after")
    def _square(self) -> Self:
        if {len(self.start), len(self.output), *map(len, self.transition)} != {len(self.transition)}:
            raise Refusal("a realisation whose transition, start and output do not have the same number of states")
        return self

    def value(self) -> Realisation:
        """Realisation for a model."""
        transition, start, output = map(jnp.asarray, (self.transition, self.start, self.output))
        return Realisation(transition=transition, start=start, output=output, after=self.after)

    @classmethod
    def of(cls, realisation: Realisation) -> Self:
        """Contents of the file for a realisation."""
        return cls(**{part: np.asarray(getattr(realisation, part)).tolist() for part in cls.model_fields})


class ModelFile(Strict):
    """Contents of a model file."""

    format: Literal["glucoloop-model"] = "glucoloop-model"
    version: Literal[1] = 1
    sample_time_min: Annotated[float, Field(ge=SHORTEST_SAMPLE_TIME_MIN, le=LONGEST_SAMPLE_TIME_MIN)]
    step_response: Response
    """S_1 .. S_M, mg/dl per mU/min."""
    impulse_response: Response
    """h_1 .. h_M, its increments."""
    realisation: Recursion | None = None
    """The response beyond its memory; None for one that ends there."""
    operating_point: RestingPoint
    quality: Quality | None = None
    """Quality of the model; None in a file from another program."""
    provenance: Provenance

    @model_validator(mode="after")
    def _agree(self) -> Self:
        step, impulse = np.array(self.step_response), np.array(self.impulse_response)
        if step.size != impulse.size:
            raise Refusal(f"{step.size} values of the step response and {impulse.size} of the impulse response")
        if deeper_than(self.provenance.settings, _DEEPEST):
            raise Refusal(f"settings in its provenance that are nested more than {_DEEPEST} times")
        try:
            json.dumps(self.provenance.settings, allow_nan=False)
        except ValueError:
            raise Refusal("a setting in its provenance that is not finite, which JSON does not have") from None
        largest = np.abs(step).max()
        if largest > _LARGEST_RESPONSE:
            raise Refusal(f"a step response of {largest:g} mg/dl per mU/min, above {_LARGEST_RESPONSE:g}")
        with np.errstate(over="ignore"):
            total = np.cumsum(impulse)
        if not np.allclose(total, step, rtol=0.0, atol=_ROUNDING * largest):
            raise Refusal("a step response that is not the running sum of the impulse response")
        if self.realisation is not None:
            refuse_other_response(self.realisation.value(), impulse)
        return self

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
            None if self.quality is None else Reliability(**dict(self.quality)),
            basal_insulin_mU_min=resting.basal_insulin_mU_min,
            glucose_mg_dl=resting.glucose_mg_dl,
        )

    def text(self) -> str:
        """JSON from which the same model is read, to the last bit."""
        return json_text(self.model_dump(mode="json")) + "\n"


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
        realisation=None if model.realisation is None else Recursion.of(model.realisation),
        operating_point=RestingPoint(
            name=operating_point,
            basal_insulin_mU_min=identification.basal_insulin_mU_min,
            glucose_mg_dl=identification.baseline_glucose_mg_dl,
        ),
        quality=Quality(**vars(identification.reliability)),
        provenance=Provenance(
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
        return ModelFile.model_validate_json(text)
    except ValidationError as error:
        raise Refusal(f"{path} is not a model that can be used: {_sentence(error)}") from None


def _sentence(error: ValidationError) -> str:
    """The first fault of a file: the key, its value, and what it should be in Pydantic's words."""
    first = error.errors(include_url=False)[0]
    kind, value, message = first["type"], first["input"], first["msg"]
    name = ".".join(map(str, first["loc"])) or "it"
    match kind, first["loc"]:
        case "value_error", _:
            return f"it has {first['ctx']['error']}; identify it again"
        case "literal_error", ("version",):
            return f"its format version is {shown(value)}, but this glucoloop reads version 1; identify it again"
        case "literal_error", ("format",):
            return f"its format is {shown(value)} and not 'glucoloop-model'; write one with glucoloop identify"
        case "missing", _:
            return f"{name} is missing; add it"
        case "extra_forbidden", _:
            return f"{name} is not a known key; leave it out"
        case "json_invalid", _:
            return f"this is not JSON: {first['ctx']['error']}"
    return f"{name} is {shown(value)}; {message.replace('Input', 'it', 1).replace('List', 'it', 1)}"
