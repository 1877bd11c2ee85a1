"""Numbers that the page starts from: patients at steady state with their models, default settings, and random noise."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any, Final, cast

import numpy as np

from glucoloop.component.base import Component
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.component.setting import Value
from glucoloop.control.catalogue import controller_entry
from glucoloop.control.guard_settings import GuardSettings, guard_of
from glucoloop.control.protocol import Status
from glucoloop.faults import FAULTS, FaultComponent
from glucoloop.lab.controllers import (
    LOOPED,
    controllers_of,
    default_mpc,
    default_mpc_se,
    default_tuning,
    guard_program_of,
    horizon_suits_model,
    longest_horizon,
    of_profile,
    program_of,
    shortest_horizon,
)
from glucoloop.lab.device_functions import MONITORS, errors_of
from glucoloop.lab.lowered_function import by_name
from glucoloop.lab.patient_functions import (
    FAMILIES,
    GRID,
    SAMPLE_TIME_MIN,
    by_equations,
    gut_numbers,
    inside,
    patient_id,
    patients,
    people_of,
    plant_numbers,
    portable_glucose_mg_dl,
    situation,
    steps_of,
)
from glucoloop.lab.people import people_numbers
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.capabilities import process_noise
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.patients.component import PatientComponent
from glucoloop.patients.table import REPLACED
from glucoloop.pumps import PumpComponent
from glucoloop.refusal import Refusal
from glucoloop.sensors import SENSORS
from glucoloop.sensors.cgm import Display, Monitor
from glucoloop.simulation import fit_step
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured

_SEEDS: Final = 10
_LONGEST_MIN: Final = 1440.0
"""Longest run of the page."""
_SLIDERS: Final[dict[str, dict[str, Any]]] = tomllib.loads(
    files("glucoloop.lab").joinpath("sliders.toml").read_text(encoding="utf-8")
)
"""Settings that can be changed on the page, with minimum, maximum and step of their sliders."""
_OF_ZERO: Final = re.compile(r";? 0: .*")
"""Sentence on a value of 0, where the page does not offer it."""
_OF_DEFAULT: Final = re.compile(r"; that of the patient's pump\.|; by default .*|: true or false\.")
"""Sentences on the default, which the page shows, and on how to write it."""
_CHAIN: Final = ("ideal", "white-noise", *MONITORS, "dead-time")
"""Sensors that a chain on the page can have, from the innermost outwards."""


def numbers(families: Sequence[str] = FAMILIES) -> dict[str, Any]:
    """All numbers of the page, as plain data."""
    return {
        "sample_time_min": SAMPLE_TIME_MIN,
        "inside_min": GRID.inside_min.tolist(),
        "longest_min": _LONGEST_MIN,
        "families": {family: _family(PATIENTS.find(family)) for family in families},
        "patients": {
            patient_id(family, point): _patient(PATIENTS.find(family), point, patient)
            for family in families
            for point, patient in patients(family).items()
        },
        "sensors": {name: SENSORS[name]().values() for name in _CHAIN},
        "faults": {name: _fault(entry) for name, entry in FAULTS.items()},
        "monitors": {name: _monitor(name) for name in MONITORS},
        "display": Display().values(),
        "seeds": _SEEDS,
        "statuses": {status.value: status.text for status in Status},
        "status_names": {status.value: status.name.lower().replace("_", " ") for status in Status},
        "people": {family: people_numbers(family) for family in families if not by_equations(family)},
    }


def _family(entry: type[PatientComponent]) -> dict[str, Any]:
    """Values that all patients of a family share: ways of insulin, controllers, limits and defaults."""
    return {
        "summary": entry.summary,
        "points": {point.name: point.summary for point in entry.operating_points},
        "route": entry.insulin_route,
        "population": _population(entry.name),
        "step_min": SAMPLE_TIME_MIN / steps_of(entry.name),
        "inside": [list(place) for place in inside(entry.name)],
        "guard_limits": _offered(GuardSettings, _SLIDERS["guard"], guard_of(entry).values()),
        "pump_limits": _offered(
            PumpComponent, _SLIDERS["pump"], {name: getattr(entry, name) for name in _SLIDERS["pump"]}
        ),
        "controllers": {name: _controller(name, entry) for name in controllers_of(entry.name)},
        "configuration": _configuration(entry),
    }


def _population(family: str) -> str:
    """The default population of a family, as a command takes it for any number of people."""
    people = people_of(family)
    return people.name if people.most_people is None else f"{people.name}, draw={REPLACED}"


def _configuration(entry: type[PatientComponent]) -> dict[str, Any]:
    """Values of a run without options, with a guard: the page compares with them those of a file that it loads."""
    used = configured(Run, patient=entry.name, guard="usual").tree(whole=True)
    [controller] = used.pop("controller")
    return {**used, "guard": controller["guard"], "model": controller["model"]}


def _offered(
    part: type[Component], bounds: Mapping[str, tuple[float, float, float]], defaults: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Settings of a component with their bounds on the page, and their defaults."""
    result = {}
    for name, bound in bounds.items():
        setting = part.setting(name)
        result[name] = {
            "summary": _OF_DEFAULT.sub("", _OF_ZERO.sub("", setting.summary) if bound[0] > 0 else setting.summary),
            "whole": setting.kind in (int, bool),
            **dict(zip(("least", "most", "step"), bound, strict=True)),
            **({} if defaults is None else {"usual": defaults[name]}),
        }
    return result


def _fault(entry: type[FaultComponent]) -> dict[str, Any]:
    """A fault with its settings."""
    defaults = {name: setting.default.noise_free for name, setting in entry.effect_settings().items()}
    bounds = {name: _slider(entry, name) for name in defaults}
    return {
        "part": entry.part,
        "summary": entry.summary,
        "timed": entry.timed,
        "settings": _offered(entry, bounds, defaults),
    }


def _slider(entry: type[FaultComponent], name: str) -> tuple[float, float, float]:
    """Minimum, maximum and step of a fault's setting on the page, by default hundredths from bound to bound."""
    if name in _SLIDERS["faults"]:
        return cast(tuple[float, float, float], _SLIDERS["faults"][name])
    setting = entry.setting(name)
    about = setting.about
    low, high = max(about.at_least, about.above), min(about.at_most, about.below)
    if not math.isfinite(high - low):
        raise Refusal(
            f"the setting {name} of the fault {entry.name} has no bounds; give it some, or a line under [faults] in "
            "lab/sliders.toml"
        )
    step = (high - low) / 100.0 if setting.kind is float else max(1, round((high - low) / 100.0))
    return low + step * (about.above == low), high - step * (about.below == high), step


def _monitor(name: str) -> dict[str, Any]:
    """A monitor: the numbers of its errors, the processes of its noise, and its settings."""
    entry = cast(type[Monitor], SENSORS[name])
    model, values = entry.model, entry().values()
    defaults = {
        **{setting: values[setting] for setting in _SLIDERS["monitor"]},
        "lag_min": model.lag_min,
        "worn_min": None,
    }
    worn_min = (0.0, values["wear_min"] - SAMPLE_TIME_MIN, SAMPLE_TIME_MIN)
    random_or_unused = ("worn", "inner.valid")
    return {
        "summary": entry.summary,
        "numbers": {of: number for of, number in by_name(errors_of(name)).items() if of not in random_or_unused},
        "processes": len(model.processes),
        "settings": _offered(entry, {**_SLIDERS["monitor"], "worn_min": worn_min}, defaults),
    }


def _patient(entry: type[PatientComponent], point: str, patient: SemilinearPatient) -> dict[str, Any]:
    """A patient at steady state, and the models on which controllers are designed."""
    x = patient.steady_state(patient.basal_insulin_mU_min)
    return {
        "family": entry.name,
        "operating_point": point,
        **plant_numbers(entry.name, point),
        "gut": [float(number) for number in gut_numbers(patient, entry.name)],
        "x": np.asarray(x).tolist(),
        "basal_insulin_mU_min": float(patient.basal_insulin_mU_min),
        "setpoint_mg_dl": float(patient.setpoint_mg_dl),
        "glucose_mg_dl": portable_glucose_mg_dl(entry.name, point, x),
        "profile": _profile(entry, point),
        "of_profile": {
            name: of_profile(name, entry.name, point) for name in controllers_of(entry.name) if name in LOOPED
        },
        "first_order": {
            name: _first_order(patient, default_tuning(name, entry.name, point)) for name in ("pid", "imc")
        },
        "response": _response(entry.name, point),
        "response_behind_lag": _response(entry.name, point, *MONITORS[:1]),
        "linear": _linear(entry.name, point, patient),
    }


def _profile(entry: type[PatientComponent], point: str) -> dict[str, float]:
    """The person's carbohydrate ratio and correction factor, where the profile knows them or by its rules."""
    profile = situation(entry.name, point).profile
    return {
        "carb_ratio_g_U": float(profile.carb_ratio()),
        "correction_mg_dl_U": float(profile.correction_factor()),
    }


def _response(family: str, point: str, *sensor: str) -> dict[str, list[float]]:
    """The identified response as linear MPC keeps it: coefficients, and a realisation of what comes after them."""
    mpc = default_mpc(family, point, *sensor)
    result = {"step_response": np.asarray(mpc.step_response).tolist()}
    if mpc.realisation is not None:
        for name in ("transition", "start", "output"):
            result[f"realisation.{name}"] = np.ravel(np.asarray(getattr(mpc.realisation, name))).tolist()
    return result


def _linear(family: str, point: str, patient: SemilinearPatient) -> dict[str, Any]:
    """The linearised patient as MPC/SE keeps it, with the state of a disturbance of the output if it has one."""
    mpc_se, offset_free = default_mpc_se(family, point), default_tuning("mpc-se", family, point)["offset_free"]
    unit = np.stack([process_noise(patient, *unit) for unit in np.eye(3)])
    kinds, factors = np.argmax(unit, axis=0).tolist(), unit.max(axis=0).tolist()
    if offset_free == "output-disturbance":
        kinds, factors = [*kinds, unit.shape[0]], [*factors, 1.0]
    elif offset_free != "held-innovation":
        raise Refusal(f"MPC/SE of {family} has the prediction {offset_free!r}, which the page cannot design")
    return {
        "Phi": np.asarray(mpc_se.Phi).tolist(),
        **{name: np.asarray(getattr(mpc_se, name)).tolist() for name in ("Gamma", "C", "rest")},
        "insulin_mU_min": float(mpc_se.basal_mU_min),
        "glucose_mg_dl": float(mpc_se.basal_glucose_mg_dl),
        "noise_kinds": kinds,
        "noise_factors": factors,
        "held": offset_free == "held-innovation",
    }


def _first_order(patient: SemilinearPatient, tuning: Mapping[str, Value]) -> dict[str, float]:
    step_mU_min, delay_min = float(tuning["step_mU_min"]), tuning.get("delay_min")
    fitted = fit_step(
        patient,
        step_mU_min=step_mU_min or None,  # 0: the default
        delay_min=None if delay_min is None else float(delay_min),
        sample_time_min=SAMPLE_TIME_MIN,
    )
    return {name: float(getattr(fitted, name)) for name in ("gain", "tau_min", "delay_min")}


def _controller(name: str, of_patient: type[PatientComponent]) -> dict[str, Any]:
    """A controller's settings on the page, and the defaults of all of its settings."""
    entry = controller_entry(name)
    bounds = dict(_SLIDERS["controllers"][name])
    if of_patient.insulin_route == SUBCUTANEOUS:
        bounds |= _SLIDERS["subcutaneous"].get(name, {})
    if "prediction_horizon" in bounds:
        minimum = shortest_horizon(name, of_patient.name)
        bounds["prediction_horizon"] = (minimum, longest_horizon(of_patient.name), 1)
    defaults: dict[str, Any] = {}
    for point in of_patient.operating_points:
        defaults[point.name] = {
            kind: default_tuning(name, of_patient.name, point.name, *sensor)
            for kind, sensor in (("noise_free", ()), ("noisy", ("white-noise",)), ("behind_lag", MONITORS[:1]))
        }
    result: dict[str, Any] = {
        "program": program_of(name, of_patient.name),
        **({"guard_program": guard_program_of(of_patient.name)} if name in LOOPED else {}),
        "gives_boluses": entry.gives_boluses,
        "summary": entry.summary,
        "settings": _offered(entry, bounds),
        "usual": defaults,
        "horizon_suits_model": horizon_suits_model(name, of_patient.name),
    }
    if name == "mpc":
        result["least_behind_lag"] = shortest_horizon(name, of_patient.name, *MONITORS[:1])
    return result
