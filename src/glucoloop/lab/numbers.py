"""Numbers that the page starts from: patients at rest with their models, usual settings, and drawn noise."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from glucoloop.control.catalogue import controller_entry
from glucoloop.control.protocol import Status
from glucoloop.lab.body import (
    FAMILIES,
    GRID,
    SAMPLE_TIME_MIN,
    STEP_MIN,
    gut_numbers,
    inside,
    patient_id,
    patients,
    plant_numbers,
    portable_glucose_mg_dl,
)
from glucoloop.lab.controllers import (
    CONTROLLERS,
    LONGEST_HORIZON,
    shortest_horizon,
    usual_mpc,
    usual_mpc_se,
    usual_tuning,
)
from glucoloop.lab.devices import normals
from glucoloop.lab.people import people_numbers
from glucoloop.parts.faults import FAULTS, FaultPart
from glucoloop.parts.guard import GuardSettings, guard_of
from glucoloop.parts.part import Part
from glucoloop.parts.patients import PATIENTS, PatientPart
from glucoloop.parts.pumps import PumpPart
from glucoloop.parts.routes import SUBCUTANEOUS
from glucoloop.parts.sensors import SENSORS
from glucoloop.parts.setting import Value
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.capabilities import process_noise
from glucoloop.refusal import Refusal
from glucoloop.simulation import fit_step
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured

SEEDS: Final = 10
LONGEST_MIN: Final = 1440.0
"""Longest run of the page."""
OFFERED: Final[dict[str, dict[str, tuple[float, float, float]]]] = {
    "pid": {
        "closed_loop_min": (5.0, 120.0, 1.0),
        "gain": (0.0, 4.0, 0.01),
        "integral_time_min": (0.0, 300.0, 1.0),
        "derivative_time_min": (-1.0, 60.0, 0.5),
    },
    "imc": {"filter_min": (0.5, 60.0, 0.5)},
    "mpc": {
        "move_horizon": (1, 8, 1),
        "prediction_horizon": (1, 24, 1),
        "output_weight": (0.1, 10.0, 0.1),
        "move_weight": (0.0, 10.0, 0.1),
    },
    "mpc-se": {
        "move_horizon": (1, 8, 1),
        "prediction_horizon": (1, 24, 1),
        "output_weight": (0.1, 10.0, 0.1),
        "move_weight": (0.0, 10.0, 0.1),
        "reference_filter": (0.0, 0.95, 0.01),
        "glucose_process_noise": (0.0, 100.0, 0.1),
        "measurement_variance": (0.05, 20.0, 0.05),
    },
}
"""Settings of each controller on the page, with least and largest value and step of their sliders."""
OFFERED_UNDER_THE_SKIN: Final[dict[str, dict[str, tuple[float, float, float]]]] = {
    "pid": {"closed_loop_min": (5.0, 600.0, 5.0), "integral_time_min": (0.0, 1200.0, 5.0)},
    "imc": {"filter_min": (5.0, 600.0, 5.0)},
}
"""Settings that have other bounds where insulin is given under the skin, beside the longer horizons."""
OFFERED_PUMP: Final = {
    "max_change_mU_min": (1.0, 100.0, 0.1),
    "min_insulin_mU_min": (0.0, 20.0, 0.1),
    "max_insulin_mU_min": (21.0, 200.0, 0.1),
}
"""Limits of the pump on the page, likewise."""
OFFERED_GUARD: Final = {
    "lowest_reading_mg_dl": (20.0, 60.0, 1.0),
    "highest_reading_mg_dl": (200.0, 1000.0, 10.0),
    "fastest_mg_dl_min": (0.5, 20.0, 0.1),
    "stuck_min": (5.0, 120.0, 5.0),
    "stuck_on_board": (0.0, 2.0, 0.05),
    "held_min": (0.0, 120.0, 5.0),
    "gap_min": (0.0, 60.0, 5.0),
    "long_gap_min": (60.0, 240.0, 5.0),
    "reduced_fraction": (0.0, 1.0, 0.05),
    "low_mg_dl": (40.0, 100.0, 1.0),
    "ahead_min": (0.0, 90.0, 5.0),
    "hysteresis_mg_dl": (0.0, 30.0, 1.0),
    "max_hour": (1.0, 12.0, 0.1),
    "max_on_board": (0.0, 6.0, 0.1),
    "fall_mg_dl": (10.0, 150.0, 5.0),
    "error_mg_dl": (0.0, 30.0, 1.0),
    "always_basal": (1.0, 3.0, 0.1),
}
"""Limits of the guard on the page, likewise."""
OFFERED_FAULTS: Final[dict[str, tuple[float, float, float]]] = {
    "delay_min": (5.0, 60.0, 5.0),
    "among": (2, 8, 1),
    "share": (0.0, 1.0, 0.05),
    "times": (2, 12, 1),
    "size_mg_dl": (-200.0, 200.0, 5.0),
    "mg_dl_h": (-60.0, 60.0, 1.0),
    "gain": (0.5, 2.0, 0.01),
    "offset_mg_dl": (-100.0, 100.0, 1.0),
    "depth": (0.05, 1.0, 0.05),
    "tau_min": (1.0, 60.0, 1.0),
    "low_mg_dl": (20.0, 100.0, 1.0),
    "high_mg_dl": (120.0, 600.0, 10.0),
    "value": (-100.0, 1000.0, 1.0),
    "step_mU_min": (0.1, 20.0, 0.1),
    "least_mU_min": (0.0, 20.0, 0.1),
    "open_fraction": (0.0, 0.95, 0.05),
    "noticed": (0, 1, 1),
}
"""Settings of faults on the page, likewise."""
_OF_DEFAULT: Final = re.compile(r" 0: .*|; that of the patient's pump\.")
"""Sentences on a value of 0, which the page does not offer, and on what is usual, which it shows."""
CHAIN: Final = ("ideal", "white-noise", "dead-time")
"""Sensors that a chain on the page can have, from the innermost outwards."""


def numbers() -> dict[str, Any]:
    """All numbers of the page, as plain data."""
    return {
        "sample_time_min": SAMPLE_TIME_MIN,
        "step_min": STEP_MIN,
        "inside_min": GRID.inside_min.tolist(),
        "longest_min": LONGEST_MIN,
        "families": {family: _family(PATIENTS[family]) for family in FAMILIES},
        "patients": {
            patient_id(family, point): _patient(PATIENTS[family], point, patient)
            for family in FAMILIES
            for point, patient in patients(family).items()
        },
        "sensors": {name: SENSORS[name]().values() for name in CHAIN},
        "faults": {name: _fault(entry) for name, entry in FAULTS.items()},
        "normals": [normals(seed, round(LONGEST_MIN / SAMPLE_TIME_MIN)).tolist() for seed in range(SEEDS)],
        "statuses": {status.value: status.text for status in Status},
        "status_names": {status.value: status.name.lower().replace("_", " ") for status in Status},
        "people": {family: people_numbers(family) for family in FAMILIES},
    }


def _family(entry: type[PatientPart]) -> dict[str, Any]:
    """Values that all patients of a family share: ways of insulin, controllers, limits and usual values."""
    return {
        "summary": entry.summary,
        "points": {point.name: point.summary for point in entry.operating_points},
        "route": entry.insulin_route,
        "inside": [list(place) for place in inside(entry.name)],
        "guard_limits": _offered(GuardSettings, OFFERED_GUARD, guard_of(entry).values()),
        "pump_limits": _offered(PumpPart, OFFERED_PUMP, {name: getattr(entry, name) for name in OFFERED_PUMP}),
        "controllers": {name: _controller(name, entry) for name in CONTROLLERS},
        "configuration": _configuration(entry),
    }


def _configuration(entry: type[PatientPart]) -> dict[str, Any]:
    """Values of a run without options, with a guard: the page compares with them those of a file that it loads."""
    used = configured(Run, patient=entry.name, guard="usual").tree(whole=True)
    [controller] = used.pop("controller")
    return {**used, "guard": controller["guard"], "model": controller["model"]}


def _offered(
    part: type[Part], bounds: Mapping[str, tuple[float, float, float]], usual: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Settings of a part with their bounds on the page, and their usual values."""
    found = {}
    for name, of in bounds.items():
        setting = part.setting(name)
        found[name] = {
            "summary": _OF_DEFAULT.sub("", setting.summary),
            "whole": setting.kind in (int, bool),
            **dict(zip(("least", "most", "step"), of, strict=True)),
            **({} if usual is None else {"usual": usual[name]}),
        }
    return found


def _fault(entry: type[FaultPart]) -> dict[str, Any]:
    """A fault with its settings."""
    usual = {name: setting.default.noise_free for name, setting in entry.effect_settings().items()}
    bounds = {name: OFFERED_FAULTS[name] for name in usual}
    return {
        "part": entry.part,
        "summary": entry.summary,
        "timed": entry.timed,
        "settings": _offered(entry, bounds, usual),
    }


def _patient(entry: type[PatientPart], point: str, patient: SemilinearPatient) -> dict[str, Any]:
    """A patient at rest, and the models on which controllers are designed."""
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
        "first_order": {name: _first_order(patient, usual_tuning(name, entry.name, point)) for name in ("pid", "imc")},
        "response": _response(entry.name, point),
        "linear": _linear(entry.name, point, patient),
    }


def _response(family: str, point: str) -> dict[str, list[float]]:
    """The identified response as linear MPC keeps it: coefficients, and a realisation of what comes after them."""
    mpc = usual_mpc(family, point)
    found = {"step_response": np.asarray(mpc.step_response).tolist()}
    if mpc.realisation is not None:
        for name in ("transition", "start", "output"):
            found[f"realisation.{name}"] = np.ravel(np.asarray(getattr(mpc.realisation, name))).tolist()
    return found


def _linear(family: str, point: str, patient: SemilinearPatient) -> dict[str, Any]:
    """The linearised patient as MPC/SE keeps it, with the state of a disturbance of the output if it has one."""
    mpc_se, offset_free = usual_mpc_se(family, point), usual_tuning("mpc-se", family, point)["offset_free"]
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
        step_mU_min=step_mU_min or None,  # 0: the usual one
        delay_min=None if delay_min is None else float(delay_min),
        sample_time_min=SAMPLE_TIME_MIN,
    )
    return {name: float(getattr(fitted, name)) for name in ("gain", "tau_min", "delay_min")}


def _controller(name: str, of_patient: type[PatientPart]) -> dict[str, Any]:
    """A controller's settings on the page, and the usual values of all of its settings."""
    entry = controller_entry(name)
    bounds = dict(OFFERED[name])
    if of_patient.insulin_route == SUBCUTANEOUS:
        bounds |= OFFERED_UNDER_THE_SKIN.get(name, {})
    if "prediction_horizon" in bounds:
        least = shortest_horizon(name, of_patient.name)
        bounds["prediction_horizon"] = (least, LONGEST_HORIZON[of_patient.insulin_route], 1)
    usual: dict[str, Any] = {}
    for point in of_patient.operating_points:
        of_point = [usual_tuning(name, of_patient.name, point.name, noisy=noisy) for noisy in (False, True)]
        usual[point.name] = dict(zip(("noise_free", "noisy"), of_point, strict=True))
    return {"summary": entry.summary, "settings": _offered(entry, bounds), "usual": usual}
