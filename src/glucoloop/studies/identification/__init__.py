"""Request of an identification: an experiment on the simulated patient or the record of a real one, and the fit."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from glucoloop.component.grammar import Tree
from glucoloop.component.request import Request, completed, request_of
from glucoloop.component.setting import About, Option
from glucoloop.models.settings import LAGUERRE_FUNCTIONS, LAGUERRE_POLE, MEMORY
from glucoloop.refusal import Refusal
from glucoloop.situations.situation import Situation, alone_at_rest, one_person_of
from glucoloop.studies.study import PlainStudy
from glucoloop.unit_guess import INSULIN_RATE, RATE_CHANGE

_EXPERIMENT: Final = ("patient", "sensor", "amplitude_mU_min", "samples")
"""Settings of the simulated experiment, which a record replaces."""
_RECORD: Final = ("method", "max_gap_min", "basal_insulin_mU_min", "not_from_rest")
"""Settings that describe a record."""
_experiment = functools.partial(Option, panel="Experiment on the virtual patient")
_record = functools.partial(Option, panel="Record")
_FLAGS: Final = {
    "amplitude_mU_min": "--amplitude",
    "max_gap_min": "--max-gap",
    "basal_insulin_mU_min": "--basal-insulin",
}


def _of_model(about: About) -> Option:
    return Option(**{**dataclasses.asdict(about), "panel": "Model"})


class ModelRequest(Situation):
    """A model that is to be identified, from an experiment in a situation or from a record."""

    kind: ClassVar = "identification"
    refused: ClassVar = (
        "setpoint_mg_dl",
        "meal_model",
        "rhythm",
        "announce_meals",
        "announce_before_min",
        "rescue",
        "glucagon",
        "events",
        "actions",
        "carb_error_pct",
        "carb_bias_pct",
        "start",
        "pump",
        "faults",
        "metrics",
        "warm_up_min",
    )

    amplitude_mU_min: Annotated[
        float | None,
        _experiment(
            "Height of the pulses, at most the basal rate; by default that of the patient.",
            above=0.0,
            at_most=10_000.0,
            quantity=RATE_CHANGE,
        ),
    ] = None
    samples: Annotated[
        int | None, _experiment("Length of the experiment.", default="2 M", at_least=4, at_most=100_000)
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
    not_from_rest: Annotated[
        bool,
        _record(
            "Insulin was not at the basal rate for the memory before the record, or something was eaten in the six "
            "hours before it."
        ),
    ] = False
    memory: Annotated[int | None, _of_model(MEMORY)] = None
    laguerre_pole: Annotated[float | None, _of_model(LAGUERRE_POLE)] = None
    best_pole: Annotated[bool, Option("Search for the pole that fits best.", panel="Model")] = False
    laguerre_functions: Annotated[int | None, _of_model(LAGUERRE_FUNCTIONS)] = None

    @classmethod
    def defaults_of(cls, request: Request[Self], defaults: Mapping[str, Any]) -> Mapping[str, Any]:
        """Defaults of the patient; what suits a record is chosen by the record."""
        explicit = request.explicit
        unused, what = (
            (_EXPERIMENT, "is about the simulated patient, but there is a record; leave one out")
            if "data" in explicit
            else (_RECORD, "is about a record; give one with --data, or leave it out")
        )
        for name in unused:
            if name in explicit:
                raise Refusal(f"{_FLAGS.get(name, f'--{name}'.replace('_', '-'))} {what}")
        if explicit.get("best_pole") and "laguerre_pole" in explicit:
            raise Refusal("a Laguerre pole is given and is also to be searched for; leave one out")
        if explicit.get("best_pole") and explicit.get("laguerre_functions") == 0:
            raise Refusal("0 Laguerre functions have no pole to search for; give more, or leave out the search")
        if "data" not in explicit:
            patient = completed(request_of(request.value("patient")))
            pulse = patient.pulse_mU_min
            person = one_person_of(patient, request.value("seed"))
            if person is not None:  # insulin cannot be taken back from one who needs less
                pulse = min(pulse, float(alone_at_rest(patient, person)[0].basal_insulin_mU_min))
            identification = patient.identification(request.value("sample_time_min"))
            defaults = {**defaults, "amplitude_mU_min": pulse, **identification}
        return super().defaults_of(request, defaults)

    def tree(self, *, whole: bool = False) -> Tree:
        """Given settings, or all that are used."""
        results: dict[str, Any] = super().tree(whole=whole)
        if whole:
            unused = _EXPERIMENT if self.data is not None else _RECORD
            for name in (*unused, *(("laguerre_pole",) if self.best_pole else ())):
                results.pop(name, None)
        return results

    @property
    def all_given(self) -> bool:
        """Whether the memory and the Laguerre functions are given, so that nothing of them is chosen by the record."""
        pole_given = self.laguerre_pole is not None or self.best_pole or self.laguerre_functions == 0
        return self.memory is not None and self.laguerre_functions is not None and pole_given


IDENTIFY: Final = PlainStudy(
    name="identify",
    what="an identification",
    help=(
        "Identify a step-response model, which `glucoloop run --model` uses.\n\n"
        "Without --data the virtual patient gets the paper's insulin test, a pulse up and a pulse down, and the model "
        "is checked on a random binary sequence. With --data the model comes from your record: a CSV file whose first "
        "line names t_min, insulin_mU_min, glucose_mg_dl and, where something was eaten, carbs_g. A rate lasts until "
        "the next row (1 U/h is 16.67 mU/min; a bolus of 1 U over a row of 5 min is 200 mU/min more); an empty reading "
        "is missing. If the record does not say enough about insulin for a model to be used, the answer says so, and "
        "why.\n\n"
        "  glucoloop identify --noise 1.45 --out model\n\n"
        "  glucoloop identify --data record.csv --out model\n\n"
        "  glucoloop run --model model/model.json"
    ),
    module="glucoloop.studies.identification.study",
    request=ModelRequest,
    summary="fit.json",
)
