"""Configuration of an identification: experiment on the simulated patient or record of a real one, and the fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal

from pydantic import BaseModel, Field

from glucoloop.config.run import (
    LONGEST_SAMPLE_TIME_MIN,
    PAPER_SAMPLE_TIME_MIN,
    SHORTEST_SAMPLE_TIME_MIN,
    STRICT,
    DeadTime,
    Functions,
    Memory,
    NoiseBound,
    Pole,
    SampleTime,
    Seed,
    Variance,
    checked,
    patient_of,
    whole_samples,
)
from glucoloop.config.unusual import ask_about
from glucoloop.experiments.situation import Situation
from glucoloop.plausible import INSULIN_RATE, RATE_CHANGE
from glucoloop.registry.patients import USUAL_PATIENT
from glucoloop.registry.settings import refuse_unknown_keys

EXPERIMENT_KEYS: Final = (
    "patient",
    "operating_point",
    "noise_variance",
    "noise_bound_mg_dl",
    "dead_time_min",
    "amplitude_mU_min",
    "samples",
)
"""Keys of the simulated experiment, which a record replaces."""
RECORD_KEYS: Final = ("method", "max_gap_min", "basal_insulin_mU_min", "starts_at_rest")
"""Keys that describe a record."""


class IdentificationConfig(BaseModel):
    """Complete configuration of an identification."""

    model_config = STRICT

    data: str | None = None
    """Path of a record, or None for an experiment on the simulated patient."""
    patient: str = USUAL_PATIENT.name
    operating_point: str = USUAL_PATIENT.usual_point
    noise_variance: Variance = 0.0
    noise_bound_mg_dl: NoiseBound = 5.0
    dead_time_min: DeadTime = 0.0
    amplitude_mU_min: Annotated[float, Field(gt=0.0, le=10_000.0), RATE_CHANGE] = USUAL_PATIENT.pulse_mU_min
    samples: Annotated[int, Field(ge=4, le=100_000)] | None = None
    """Length of the simulated record, or None for the shortest: twice the memory."""

    method: Literal["auto", "csrs", "least-squares"] = "auto"
    max_gap_min: Annotated[float, Field(gt=0.0, le=1440.0)] = 15.0
    basal_insulin_mU_min: Annotated[float, Field(ge=0.0, le=10_000.0), INSULIN_RATE] | None = None
    """Rate before the record, or None for the rate that the method finds."""
    starts_at_rest: bool = True

    sample_time_min: SampleTime = PAPER_SAMPLE_TIME_MIN
    memory: Memory = 36
    laguerre_pole: Pole = 0.84
    best_pole: bool = False
    """Whether the pole is searched for, in place of `laguerre_pole`."""
    laguerre_functions: Functions = 2
    seed: Seed = 0
    allow_unusual: bool = False
    """Whether unusual values are accepted."""

    @property
    def dead_time_samples(self) -> int:
        """Dead time of the experiment's readings."""
        return whole_samples(self.dead_time_min, self.sample_time_min)

    def situation(self) -> Situation:
        """The patient and the sensor of the experiment."""
        return Situation(
            patient=self.patient,
            operating_point=self.operating_point,
            noise_variance=self.noise_variance,
            noise_bound_mg_dl=self.noise_bound_mg_dl,
            dead_time_samples=self.dead_time_samples,
            sample_time_min=self.sample_time_min,
            seed=self.seed,
        )


def read_identification(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> IdentificationConfig:
    """Read the configuration of an identification from flat keys, and complete it.

    Raises
    ------
    ValueError
        For an unknown key, a value of the wrong type or out of bounds, or keys that exclude one another.
    """
    known = IdentificationConfig.model_fields
    refuse_unknown_keys(keys, known)
    called = {key: (names or {}).get(key, key) for key in keys}
    if "data" in keys:
        for key in called.keys() & set(EXPERIMENT_KEYS):
            raise ValueError(f"{called[key]} is about the simulated patient, but there is a record; leave one out")
    else:
        for key in called.keys() & set(RECORD_KEYS):
            raise ValueError(f"{called[key]} is about a record; give one with --data, or leave it out")
    if keys.get("best_pole") and "laguerre_pole" in keys:
        raise ValueError("a Laguerre pole is given and is also to be searched for; leave one out")
    if keys.get("best_pole") and keys.get("laguerre_functions") == 0:
        raise ValueError("0 Laguerre functions have no pole to search for; give more, or leave out the search")
    sample_time = keys.get("sample_time_min", PAPER_SAMPLE_TIME_MIN)
    entry = patient_of(keys)
    derived: dict[str, object] = {"operating_point": entry.usual_point, "amplitude_mU_min": entry.pulse_mU_min}
    # A sample time that is wrong is refused by name with the other keys, and nothing follows from it.
    if isinstance(sample_time, int | float) and SHORTEST_SAMPLE_TIME_MIN <= sample_time <= LONGEST_SAMPLE_TIME_MIN:
        derived |= entry.identification(float(sample_time))
    asked = checked(IdentificationConfig, {**derived, **keys}, names)
    entry.operating_point(asked.operating_point)
    if not asked.allow_unusual:
        ask_about(asked, names)
    return asked


def overlay_identification(lower: Mapping[str, object], upper: Mapping[str, object]) -> dict[str, object]:
    """Merge flat keys of two layers. The upper one wins; each of its keys removes those below that it excludes."""
    excluded: set[str] = set()
    if "data" in upper:
        excluded.update(EXPERIMENT_KEYS)
    elif any(key in upper for key in EXPERIMENT_KEYS):
        excluded.update(("data", *RECORD_KEYS))
    if upper.get("best_pole"):
        excluded.add("laguerre_pole")
    elif "laguerre_pole" in upper:
        excluded.add("best_pole")
    return {**{key: value for key, value in lower.items() if key not in excluded}, **upper}


def identification_keys(config: IdentificationConfig) -> dict[str, object]:
    """The flat keys from which the same identification is read."""
    unused = EXPERIMENT_KEYS if config.data is not None else RECORD_KEYS
    left_out = {*unused, *(("laguerre_pole",) if config.best_pole else ())}
    return {key: value for key, value in config.model_dump(mode="json").items() if key not in left_out}
