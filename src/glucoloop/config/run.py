"""Configuration of a run: the situation of a controller, and the controller with its tuning and model.

In files and on the command line both are given by flat keys; what is not given is filled in here, so that a
configuration that was read is complete. What was given is kept apart from it: only that is written to be read again.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Self

from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys, plain
from glucoloop.config.options.case import IDENTIFICATION_KEYS, CaseKeys, case_keys
from glucoloop.config.options.situation import (
    SituationKeys,
    refuse_parts_of_samples,
    whole_samples,
)
from glucoloop.config.unusual import (
    Names,
    ask_about,
    ask_about_clock,
    ask_about_meals,
    ask_about_part,
    ask_about_pump,
    ask_about_settings,
)
from glucoloop.control import catalogue
from glucoloop.experiments.surroundings import pump_of, sensor_of
from glucoloop.meals import meal_model_of
from glucoloop.parts.controllers import ControllerPart
from glucoloop.parts.faults import FAULTS, START
from glucoloop.parts.guard import GUARD, complete_guard
from glucoloop.parts.metrics import METRICS, metrics_with
from glucoloop.parts.part import Part
from glucoloop.parts.patients import USUAL_PATIENT, PatientEntry, patient_entry
from glucoloop.parts.pumps import PUMPS, USUAL_PUMP
from glucoloop.parts.sensors import SENSORS
from glucoloop.parts.setting import Value, refuse_unknown_keys
from glucoloop.patients import patient
from glucoloop.patients.capabilities import sites
from glucoloop.plausible import ANY_SETTING, LARGEST_RATE_UNDER_THE_SKIN
from glucoloop.refusal import Refusal
from glucoloop.situations.meal_text import meal_text

_OF_PATIENT: Final = ("max_change_mU_min", "min_insulin_mU_min", "max_insulin_mU_min")
"""Limits of the pump whose usual values are the patient's, unless the pump has its own."""


@dataclass(frozen=True)
class Run:
    """A controller in its situation."""

    situation: SituationKeys
    case: CaseKeys
    given: Mapping[str, Any] | None = field(default=None, compare=False)
    """Flat keys from which it was read, if it was."""

    def keys(self) -> dict[str, Any]:
        """The flat keys from which the same run is read."""
        return {**plain(self.situation), **case_keys(self.case)}

    def with_model(self, path: str) -> Self:
        """The same run, with its model from another file."""
        given = None if self.given is None else {**self.given, "model": path}
        return dataclasses.replace(self, case=dataclasses.replace(self.case, model=path), given=given)


def read_run(keys: Mapping[str, object], names: Mapping[str, str] | None = None, *, only_design: bool = False) -> Run:
    """Read the configuration of a run from flat keys.

    Parameters
    ----------
    keys : mapping
    names : mapping, optional
        Name under which the user gave each key, for messages.
    only_design : bool
        Whether the loop is never closed, so that its length does not count.

    Raises
    ------
    ValueError
        For an unknown key, or a value of the wrong type or out of bounds.
    """
    refuse_unknown(keys)
    situation = checked(SituationKeys, own_keys(completed(keys), SituationKeys), names)
    if not situation.allow_unusual:
        ask_about_surroundings(situation, situation.meals, names)
        ask_about_clock(situation.meals, situation.duration_min)
    refuse_impossible(situation)
    whole_samples(situation.dead_time_min, situation.sample_time_min)
    if not only_design:
        refuse_parts_of_samples(situation.duration_min, situation.sample_time_min, names)
    faults = faults_told(situation.faults, situation.duration_min, allow_unusual=situation.allow_unusual)
    meals = tuple(meal_text(meal) for meal in situation.eaten())
    situation = dataclasses.replace(situation, meals=meals, faults=faults, **parts_told(situation))
    return Run(situation=situation, case=read_case(keys, situation, names), given=dict(keys))


def completed(keys: Mapping[str, object]) -> dict[str, object]:
    """Flat keys completed with those that are usual for the patient and the pump.

    Raises
    ------
    ValueError
        For an unknown patient, operating point or pump.
    """
    entry = patient_of(keys)
    told = keys.get("operating_point")
    if isinstance(told, str):
        entry.operating_point(told)
    return {"operating_point": entry.usual_point, **_usual_limits(keys), **keys}


def _usual_limits(keys: Mapping[str, object]) -> dict[str, object]:
    """Limits of the pump that flat keys leave out: those usual for the patient, or the pump's own."""
    entry, pump = patient_of(keys), keys.get("pump", USUAL_PUMP)
    own = PUMPS.choose(pump).limits if isinstance(pump, str) else {}
    return {**{key: getattr(entry, key) for key in _OF_PATIENT}, **own}


def patient_of(keys: Mapping[str, object]) -> PatientEntry:
    """The patient that flat keys name; a value that is not a text is refused later with the other keys."""
    name = keys.get("patient", USUAL_PATIENT.name)
    return patient_entry(name) if isinstance(name, str) else USUAL_PATIENT


def refuse_impossible(situation: SituationKeys) -> None:
    """Refuse a site at which glucose of the patient cannot be read, and a meal model or metric that is not known.

    Raises
    ------
    ValueError
        For the first one.
    """
    for _ in metrics_with(situation.metrics):  # refuses one that is unknown, or at odds with another
        pass
    if situation.miscounts and not situation.announce_meals:
        raise Refusal(
            "an error of counting carbohydrate concerns announced meals only; announce the meals (--announce-meals), "
            "or leave the error and the bias out"
        )
    meal_model_of(patient(situation.patient, situation.operating_point), situation.situation().gut)
    known = sites(patient(situation.patient, situation.operating_point))
    if situation.site is not None and situation.site not in known:
        raise Refusal(
            f"glucose of {situation.patient} cannot be read at the site {situation.site!r}; give {' or '.join(known)}"
        )


def ask_about_surroundings(situation: SituationKeys, meals: Iterable[str], names: Names = None) -> None:
    """Ask for confirmation of unusual values.

    Raises
    ------
    ValueError
        For the first value outside its plausible range.
    """
    ask_about_pump(
        patient(situation.patient, situation.operating_point),
        situation.setpoint_mg_dl,
        min_insulin_mU_min=situation.min_insulin_mU_min,
        max_insulin_mU_min=situation.max_insulin_mU_min,
        names=names,
    )
    under_the_skin = patient_entry(situation.patient).under_the_skin
    ask_about(situation, names, {"max_insulin_mU_min": LARGEST_RATE_UNDER_THE_SKIN} if under_the_skin else None)
    ask_about_meals(meals)


def read_case(keys: Mapping[str, object], situation: SituationKeys, names: Mapping[str, str] | None = None) -> CaseKeys:
    """Read a case from flat keys, completed for its situation."""
    own = own_keys(keys, CaseKeys)
    controller = own.get("controller", catalogue.USUAL_CONTROLLER)
    if not isinstance(controller, str):
        raise Refusal(f"controller is {controller!r}; give a text, the name of one")
    _refuse_reserved(catalogue.controller_entry(controller))
    known = catalogue.setting_names(controller)
    settings = {key: value for key, value in keys.items() if key in known}
    entry = patient_entry(situation.patient)
    tuning = catalogue.complete(controller, settings, entry, situation.operating_point, noisy=situation.noisy)
    if catalogue.controller_entry(controller).uses_model and own.get("model") is None:
        own = {**_identification(situation), **own}
    guard = _guard_limits(keys, entry, bool(own.get("guard", False)), names)
    case = checked(CaseKeys, {**own, "tuning": tuning, "guard_limits": guard}, names)
    if settings:
        catalogue.controller_entry(controller)(**case.tuning)  # refuses before anything is designed
    if not situation.allow_unusual:
        ask_about(case, names)
        settings_of_case = (*catalogue.controller_entry(case.controller).settings().values(), *GUARD.values())
        ask_about_settings(settings_of_case, keys, names, otherwise=ANY_SETTING)
    return case


def _refuse_reserved(entry: type[ControllerPart]) -> None:
    """Refuse a controller of another package with a setting whose key means something else."""
    reserved = {*declared(SituationKeys), *declared(CaseKeys), *GUARD, "label"}
    for name in entry.settings():
        if name in reserved:
            raise Refusal(
                f"the controller {entry.name} has a setting {name!r}, which is a key of every run already; "
                "its author has to give it another name"
            )


def _guard_limits(keys: Mapping[str, object], entry: PatientEntry, guarded: bool, names: Names) -> dict[str, Value]:
    refuse_limits_without_guard(keys, guarded=guarded, names=names)
    return complete_guard({key: value for key, value in keys.items() if key in GUARD}, entry) if guarded else {}


def refuse_limits_without_guard(keys: Mapping[str, object], *, guarded: bool, names: Names = None) -> None:
    """Refuse a limit of a guard that is off.

    Raises
    ------
    ValueError
        For the first one.
    """
    for key in keys:
        if key in GUARD and not guarded:
            raise Refusal(
                f"{(names or {}).get(key, key)} is a limit of the guard, which is off; switch it on, or leave it out"
            )


def faults_told(texts: Iterable[str], duration_min: float, *, allow_unusual: bool = False) -> tuple[str, ...]:
    """Faults with all their settings.

    Raises
    ------
    ValueError
        For a text that is no fault, one that begins after the end of the run, or an unusual setting,
        unless that is allowed.
    """
    faults = [FAULTS.choose(text) for text in texts]
    for told in faults:
        if not allow_unusual:
            ask_about_part(told)
        start_min = float(told.values().get(START, 0.0))
        if start_min >= duration_min:
            raise Refusal(
                f"the fault {told.name} begins at {start_min:g} min, but the run ends at {duration_min:g} min; "
                "let it begin earlier, or leave it out"
            )
    return tuple(told.text for told in faults)


def parts_told(situation: SituationKeys) -> dict[str, Any]:
    """Sensor, pump and metrics of a situation by key, each with all its settings.

    Raises
    ------
    ValueError
        For a text that is no such part, one that is not possible here, or an unusual setting, unless that is allowed.
    """
    sensor, pump = SENSORS.choose(situation.sensor), PUMPS.choose(situation.pump)
    metrics = [METRICS.choose(text) for text in situation.metrics]
    parts: list[Part] = [sensor, pump, *metrics]
    if not situation.allow_unusual:
        for part in parts:
            ask_about_part(part)
    sensor_of(situation.situation())
    pump_of(situation.situation())
    return {"sensor": sensor.text, "pump": pump.text, "metrics": tuple(metric.text for metric in metrics)}


def _identification(situation: SituationKeys) -> dict[str, object]:
    """The identification that is usual for the patient, from a record as noisy as the run."""
    usual = patient_entry(situation.patient).identification(situation.sample_time_min)
    return {"model_noise_variance": situation.noise_variance, **usual}


def overlay(
    lower: Mapping[str, object], upper: Mapping[str, object], names: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Merge flat keys of two layers, of which the upper one wins.

    Each upper key removes those below that it excludes: a model file and the keys that identify a model, the settings
    of a controller that another one replaces, and the operating point of another patient.

    Raises
    ------
    ValueError
        If one layer holds keys that exclude one another.
    """
    for layer in (lower, upper):
        both = [key for key in IDENTIFICATION_KEYS if key in layer]
        if "model" in layer and both:
            called = (names or {}).get(both[0], both[0])
            raise Refusal(
                f"{called} tells how a model is identified, but the model comes from {layer['model']}; "
                "leave out one of them"
            )
    kept = dict(lower)
    if "model" in upper:
        kept = {key: value for key, value in kept.items() if key not in IDENTIFICATION_KEYS}
    elif any(key in upper for key in IDENTIFICATION_KEYS):
        kept.pop("model", None)
    if "controller" in upper:
        entry = catalogue.controller_entry(str(upper["controller"]))
        own = set(entry.settings())
        foreign = catalogue.setting_names(*controllers_of(lower)) - own
        kept = {key: value for key, value in kept.items() if key not in foreign}
    if "patient" in upper and upper["patient"] != lower.get("patient", USUAL_PATIENT.name):
        kept.pop("operating_point", None)
    if upper.get("guard") is False:
        kept = {key: value for key, value in kept.items() if key not in GUARD}
    return {**kept, **upper}


def controllers_of(keys: Mapping[str, object], cases: Iterable[Mapping[str, object]] = ()) -> list[str]:
    """Controllers that flat keys name, directly or in cases.

    Raises
    ------
    ValueError
        For an unknown one, with the label of its case.
    """
    named = []
    for table in (keys, *cases):
        name, label = table.get("controller"), table.get("label")
        if not isinstance(name, str):
            continue
        try:
            catalogue.controller_entry(name)
        except Refusal as error:
            raise Refusal(f"case {label!r}: {error}" if isinstance(label, str) else str(error)) from None
        named.append(name)
    return named


def refuse_unknown(keys: Mapping[str, object], cases: Iterable[Mapping[str, object]] = ()) -> None:
    """Refuse a key that belongs neither to a situation, a case nor a controller of this package or of the cases."""
    known = run_keys(*controllers_of(keys, cases))
    for key in keys:
        if key not in known and key in _KEY_OF_OPTION:
            raise Refusal(f"unknown key {key!r}; in a file it is {_KEY_OF_OPTION[key]!r}")
        if key == "case":
            raise Refusal(f"unknown key {key!r}; give a file with cases to glucoloop compare or glucoloop trial")
    refuse_unknown_keys(keys, known)


def refuse_unknown_beside(keys: Mapping[str, object], known: Sequence[str], of: str) -> None:
    """Refuse a key that is not known, with a sentence of its own if a run has it; `of` as for `refuse_unknown_keys`."""
    of_run = run_keys()
    for key in keys:
        if key not in known and key in of_run and not difflib.get_close_matches(key, known, cutoff=_NAMESAKE):
            raise Refusal(f"unknown key {key!r}{of}, though a run has it; leave it out")
    refuse_unknown_keys(keys, known, of)


_NAMESAKE: Final = 0.9
"""Similarity from which a key was hardly meant as it stands, such as controller for controllers."""

_KEY_OF_OPTION: Final = {
    key.flag.strip("-").replace("-", "_"): name
    for record in (SituationKeys, CaseKeys)
    for name, key in declared(record).items()
    if key.key is not None and "/" not in key.flag
}
"""Key by the name of its option, which leaves out the unit."""


def run_keys(*controllers: str) -> list[str]:
    """All flat keys of a run, with the settings of controllers of other packages that are named."""
    return [*declared(SituationKeys), *case_key_names(*controllers)]


def case_key_names(*controllers: str) -> list[str]:
    """All flat keys that a case of a comparison may set, with the settings of named controllers of other packages."""
    own = [key for key, of in declared(CaseKeys).items() if of.key is not None]
    return [*own, *sorted(catalogue.setting_names(*controllers)), *GUARD]
