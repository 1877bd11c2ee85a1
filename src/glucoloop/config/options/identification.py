"""Keys of an identification: experiment on the simulated patient or record of a real one, and the fit."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final, Literal

from glucoloop.config.key import Key
from glucoloop.config.options.case import LAGUERRE_FUNCTIONS, LAGUERRE_POLE, MEMORY, MODEL_PANEL
from glucoloop.config.options.situation import (
    PAPER_SAMPLE_TIME_MIN,
    AllowUnusualKey,
    DeadTimeKey,
    NoiseBoundKey,
    OperatingPointKey,
    PatientKey,
    SampleTimeKey,
    SeedKey,
    VarianceKey,
    place_of,
    situation_of,
    whole_samples,
)
from glucoloop.parts.patients import USUAL_PATIENT
from glucoloop.plausible import INSULIN_RATE, RATE_CHANGE

if TYPE_CHECKING:
    from glucoloop.situations.situation import Situation

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
_experiment = functools.partial(Key, panel="Experiment on the virtual patient")
_record = functools.partial(Key, panel="Record")


@dataclass(frozen=True, kw_only=True)
class IdentificationKeys:
    """Complete configuration of an identification."""

    patient: PatientKey = USUAL_PATIENT.name
    operating_point: OperatingPointKey = USUAL_PATIENT.usual_point
    noise_variance: VarianceKey = 0.0
    noise_bound_mg_dl: NoiseBoundKey = 5.0
    dead_time_min: DeadTimeKey = 0.0
    amplitude_mU_min: Annotated[
        float,
        _experiment("Height of the pulses, at most the basal rate.", above=0.0, at_most=10_000.0, quantity=RATE_CHANGE),
    ] = USUAL_PATIENT.pulse_mU_min
    samples: Annotated[
        int | None, _experiment("Length of the experiment.", told="2 M", at_least=4, at_most=100_000)
    ] = None
    data: Annotated[str | None, _record("Record to identify from.", metavar="FILE.csv")] = None
    method: Annotated[
        Literal["auto", "csrs", "least-squares"],
        _record(
            "csrs: cross-correlation, for balanced pulses from rest; least-squares: for any input that varies enough."
        ),
    ] = "auto"
    max_gap_min: Annotated[float, _record("Longest gap that is interpolated.", above=0.0, at_most=1440.0)] = 15.0
    basal_insulin_mU_min: Annotated[
        float | None,
        _record(
            "Rate before the record; its median by default.", at_least=0.0, at_most=10_000.0, quantity=INSULIN_RATE
        ),
    ] = None
    starts_at_rest: Annotated[
        bool,
        _record(
            "Whether insulin was at the basal rate for the memory before the record, and nothing was eaten for six "
            "hours.",
            flag="--from-rest/--not-from-rest",
            told="from rest",
        ),
    ] = True
    sample_time_min: SampleTimeKey = PAPER_SAMPLE_TIME_MIN
    seed: SeedKey = 0
    allow_unusual: AllowUnusualKey = False
    memory: Annotated[int | None, MEMORY] = None
    laguerre_pole: Annotated[float | None, LAGUERRE_POLE] = None
    best_pole: Annotated[bool, Key("Search for the pole that fits best.", panel=MODEL_PANEL)] = False
    laguerre_functions: Annotated[int | None, LAGUERRE_FUNCTIONS] = None

    @property
    def place(self) -> str:
        """The operating point, with the patient's name where it is another than the usual one."""
        return place_of(self.patient, self.operating_point)

    @property
    def all_given(self) -> bool:
        """Whether the memory and the Laguerre functions are given, so that nothing of them is chosen by the record."""
        pole_given = self.laguerre_pole is not None or self.best_pole or self.laguerre_functions == 0
        return self.memory is not None and self.laguerre_functions is not None and pole_given

    @property
    def dead_time_samples(self) -> int:
        """Dead time of the experiment's readings."""
        return whole_samples(self.dead_time_min, self.sample_time_min)

    def situation(self) -> Situation:
        """The patient and the sensor of the experiment."""
        return situation_of(self)
