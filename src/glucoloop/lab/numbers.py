"""Numbers that the page starts from: patients at rest with their models, usual settings, and drawn noise."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from glucoloop.config.run import read_run
from glucoloop.control.protocol import Status
from glucoloop.experiments.case import usual_case
from glucoloop.experiments.designs import identified_model
from glucoloop.lab.parts import (
    CONTROLLERS,
    GRID,
    LONGEST_HORIZON,
    SAMPLE_TIME_MIN,
    normals,
    patients,
    plant_numbers,
    situation,
)
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.capabilities import process_noise
from glucoloop.registry.controllers import complete, controller_entry
from glucoloop.registry.patients import USUAL_PATIENT
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


def numbers() -> dict[str, Any]:
    """All numbers of the page, as plain data."""
    everybody = patients()
    return {
        "patient": USUAL_PATIENT.name,
        "sample_time_min": SAMPLE_TIME_MIN,
        "inside_min": GRID.inside_min.tolist(),
        "longest_min": LONGEST_MIN,
        "limits": {
            "max_change_mU_min": USUAL_PATIENT.max_change_mU_min,
            "min_mU_min": USUAL_PATIENT.min_insulin_mU_min,
            "max_mU_min": USUAL_PATIENT.max_insulin_mU_min,
        },
        "patients": {
            point.name: _patient(point.name, everybody[point.name]) for point in USUAL_PATIENT.operating_points
        },
        "summaries": {point.name: point.summary for point in USUAL_PATIENT.operating_points},
        "guard_limits": {},
        "pump_limits": _pump_limits(),
        "faults": {},
        "controllers": {name: _controller(name) for name in CONTROLLERS},
        "normals": [normals(seed, round(LONGEST_MIN / SAMPLE_TIME_MIN)).tolist() for seed in range(SEEDS)],
        "statuses": {status.value: status.text for status in Status},
        "status_names": {status.value: status.name.lower().replace("_", " ") for status in Status},
        "configuration": _configuration(),
    }


def _configuration() -> dict[str, Any]:
    """Keys of a run without options, and of the guard: with what the page compares a file that it loads."""
    return read_run({"guard": True}).keys()


def _pump_limits() -> dict[str, Any]:
    """Limits of the pump by the keys of a configuration, with their bounds on the page."""
    return {
        name: {**_offered(summary, False, bounds), "usual": getattr(USUAL_PATIENT, name)}
        for name, (summary, bounds) in OFFERED_LIMITS.items()
    }


def _offered(summary: str, whole: bool, bounds: tuple[float, float, float]) -> dict[str, Any]:
    """A setting with its bounds on the page."""
    return {"summary": summary, "whole": whole, **dict(zip(("least", "most", "step"), bounds, strict=True))}


def _patient(operating_point: str, patient: SemilinearPatient) -> dict[str, Any]:
    """A patient at rest, and the models on which controllers are designed."""
    x, around = patient.steady_state(patient.basal_insulin_mU_min), situation(operating_point)
    linear = linear_model(patient, sample_time_min=SAMPLE_TIME_MIN)
    Phi, Gamma = np.asarray(linear.Phi), np.asarray(linear.Gamma)
    model = identified_model(around, usual_case("mpc", around), patient).model
    if model.realisation is not None:
        raise ValueError(
            f"the model of {operating_point} outlasts its memory, which the controller of the page does not know"
        )
    return {
        **plant_numbers(operating_point),
        "x": np.asarray(x).tolist(),
        "basal_insulin_mU_min": float(patient.basal_insulin_mU_min),
        "setpoint_mg_dl": float(patient.setpoint_mg_dl),
        "glucose_mg_dl": float(patient.glucose_mg_dl(x)),
        "first_order": {"pid": _first_order(patient, None), "imc": _first_order(patient, _imc_delay(operating_point))},
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


def _first_order(patient: SemilinearPatient, delay_min: Any) -> dict[str, float]:
    fitted = fit_step(patient, step_mU_min=None, delay_min=delay_min, sample_time_min=SAMPLE_TIME_MIN)
    return {name: float(getattr(fitted, name)) for name in ("gain", "tau_min", "delay_min")}


def _imc_delay(operating_point: str) -> float:
    """Usual dead time of the model of internal model control, with which that model is fitted."""
    return float(complete("imc", {}, USUAL_PATIENT, operating_point, noisy=False)["delay_min"])


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
