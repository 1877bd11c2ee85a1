"""Numbers that the page starts from: patients at rest with their models, usual settings, and drawn noise."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from glucoloop.config.run import read_run
from glucoloop.control.protocol import Status
from glucoloop.experiments.case import usual_case
from glucoloop.experiments.designs import identified_model
from glucoloop.lab.body import (
    FAMILIES,
    GRID,
    SAMPLE_TIME_MIN,
    STEP_MIN,
    entry_of,
    inside,
    patients,
    plant_numbers,
    situation,
)
from glucoloop.lab.devices import normals, offered
from glucoloop.lab.parts import CONTROLLERS, FREE_LIMITS, LONGEST_HORIZON
from glucoloop.lab.people import people_numbers
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.capabilities import process_noise
from glucoloop.registry.controllers import complete, controller_entry
from glucoloop.registry.guard import GUARD, PREFIX, usual_limit
from glucoloop.registry.patients import USUAL_PATIENT, PatientEntry
from glucoloop.simulation import fit_step, linear_model

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
        "prediction_horizon": (1, LONGEST_HORIZON, 1),
        "output_weight": (0.1, 10.0, 0.1),
        "move_weight": (0.0, 10.0, 0.1),
    },
    "mpc-se": {
        "move_horizon": (1, 8, 1),
        "prediction_horizon": (1, LONGEST_HORIZON, 1),
        "output_weight": (0.1, 10.0, 0.1),
        "move_weight": (0.0, 10.0, 0.1),
        "reference_filter": (0.0, 0.95, 0.01),
        "glucose_process_noise": (0.0, 100.0, 0.1),
        "measurement_variance": (0.05, 20.0, 0.05),
    },
}
"""Settings of each controller on the page, with least and largest value and step of their sliders."""
OFFERED_LIMITS: Final = {
    "max_change_mU_min": ("Largest change of the rate from one sample to the next.", (1.0, 100.0, 0.1)),
    "min_insulin_mU_min": ("Least rate of the pump.", (0.0, 20.0, 0.1)),
    "max_insulin_mU_min": ("Greatest rate of the pump.", (21.0, 200.0, 0.1)),
}
"""Limits of the pump on the page, by the keys of a configuration: meaning, and bounds and step likewise."""


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


def numbers() -> dict[str, Any]:
    """All numbers of the page, as plain data."""
    return {
        "patient": USUAL_PATIENT.name,
        "sample_time_min": SAMPLE_TIME_MIN,
        "step_min": STEP_MIN,
        "inside_min": GRID.inside_min.tolist(),
        "inside": {family: [list(place) for place in inside(family)] for family in FAMILIES},
        "longest_min": LONGEST_MIN,
        "limits": {
            "max_change_mU_min": USUAL_PATIENT.max_change_mU_min,
            "min_mU_min": USUAL_PATIENT.min_insulin_mU_min,
            "max_mU_min": USUAL_PATIENT.max_insulin_mU_min,
        },
        "patients": {
            point.name: _patient(entry_of(family), point.name, patients(family)[point.name])
            for family in FAMILIES
            for point in entry_of(family).operating_points
        },
        "summaries": {point.name: point.summary for point in USUAL_PATIENT.operating_points},
        "guard_limits": _guard_limits(),
        "pump_limits": _pump_limits(),
        "faults": _faults(),
        "controllers": {name: _controller(name) for name in CONTROLLERS},
        "normals": [normals(seed, round(LONGEST_MIN / SAMPLE_TIME_MIN)).tolist() for seed in range(SEEDS)],
        "statuses": {status.value: status.text for status in Status},
        "status_names": {status.value: status.name.lower().replace("_", " ") for status in Status},
        "configuration": _configuration(),
        "people": people_numbers(),
    }


def _configuration() -> dict[str, Any]:
    """Keys of a run without options, and of the guard: with what the page compares a file that it loads."""
    return read_run({"guard": True}).keys()


def _guard_limits() -> dict[str, Any]:
    """Limits of the guard by the keys of a configuration, with their bounds on the page."""
    return {
        f"{PREFIX}{name}": {
            **_offered(GUARD[f"{PREFIX}{name}"].summary, False, OFFERED_GUARD[name]),
            "usual": usual_limit(f"{PREFIX}{name}", USUAL_PATIENT),
        }
        for name in FREE_LIMITS
    }


def _pump_limits() -> dict[str, Any]:
    """Limits of the pump by the keys of a configuration, with their bounds on the page."""
    return {
        name: {**_offered(summary, False, bounds), "usual": getattr(USUAL_PATIENT, name)}
        for name, (summary, bounds) in OFFERED_LIMITS.items()
    }


def _faults() -> dict[str, Any]:
    """Faults of the page with their settings."""
    return {
        entry.name: {
            "part": entry.part,
            "summary": entry.summary,
            "timed": entry.timed,
            "settings": {
                setting.name: {
                    **_offered(setting.summary, setting.type in (int, bool), OFFERED_FAULTS[setting.name]),
                    "usual": setting.default.noise_free,
                }
                for setting in entry.settings
            },
        }
        for entry in offered()
    }


def _offered(summary: str, whole: bool, bounds: tuple[float, float, float]) -> dict[str, Any]:
    """A setting with its bounds on the page."""
    return {"summary": summary, "whole": whole, **dict(zip(("least", "most", "step"), bounds, strict=True))}


def _patient(entry: PatientEntry, operating_point: str, patient: SemilinearPatient) -> dict[str, Any]:
    """A patient at rest, and the models on which controllers are designed."""
    x, around = patient.steady_state(patient.basal_insulin_mU_min), situation(entry.name, operating_point)
    linear = linear_model(patient, sample_time_min=SAMPLE_TIME_MIN)
    Phi, Gamma = np.asarray(linear.Phi), np.asarray(linear.Gamma)
    model = identified_model(around, usual_case("mpc", around), patient).model
    if model.realisation is not None:
        raise ValueError(
            f"the model of {operating_point} outlasts its memory, which the controller of the page does not know"
        )
    delay_min = float(complete("imc", {}, entry, operating_point, noisy=False)["delay_min"])
    return {
        "family": entry.name,
        "operating_point": operating_point,
        **plant_numbers(entry.name, operating_point),
        "x": np.asarray(x).tolist(),
        "basal_insulin_mU_min": float(patient.basal_insulin_mU_min),
        "setpoint_mg_dl": float(patient.setpoint_mg_dl),
        "glucose_mg_dl": float(patient.glucose_mg_dl(x)),
        "first_order": {"pid": _first_order(patient, None), "imc": _first_order(patient, delay_min)},
        "step_response": np.asarray(model.step_response).tolist(),
        "linear": {
            "Phi": Phi.tolist(),
            "Gamma": Gamma.tolist(),
            "C": np.asarray(linear.C).tolist(),
            "rest": np.linalg.solve(np.eye(Gamma.size) - Phi, Gamma).tolist(),
            "insulin_mU_min": float(linear.insulin_mU_min),
            "glucose_mg_dl": float(linear.glucose_mg_dl),
            "noise_kinds": np.argmax(np.stack([process_noise(patient, *unit) for unit in np.eye(3)]), axis=0).tolist(),
        },
    }


def _first_order(patient: SemilinearPatient, delay_min: float | None) -> dict[str, float]:
    fitted = fit_step(patient, step_mU_min=None, delay_min=delay_min, sample_time_min=SAMPLE_TIME_MIN)
    return {name: float(getattr(fitted, name)) for name in ("gain", "tau_min", "delay_min")}


def _controller(name: str) -> dict[str, Any]:
    """A controller's settings on the page, and the usual values of all of its settings."""
    entry = controller_entry(name)
    offered = {
        setting.name: _offered(setting.summary, setting.type is int, OFFERED[name][setting.name])
        for setting in entry.settings
        if setting.name in OFFERED[name]
    }
    usual: dict[str, Any] = {}
    for point in (point.name for point in USUAL_PATIENT.operating_points):
        of_point = [complete(name, {}, USUAL_PATIENT, point, noisy=noisy) for noisy in (False, True)]
        usual[point] = dict(zip(("noise_free", "noisy"), of_point, strict=True))
    return {"summary": entry.summary, "settings": offered, "usual": usual}
