"""Settings of a run or a trial in words, for the head of its page."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import jax

from glucoloop.cohorts.trial import Trial
from glucoloop.meals import Meal
from glucoloop.parts.faults import FaultPart
from glucoloop.parts.part import Part
from glucoloop.parts.pumps import PUMPS, PumpPart
from glucoloop.parts.sensors import DeadTimeSettings, IdealSettings, WhiteNoiseSettings
from glucoloop.parts.setting import Value, value_text
from glucoloop.printable import the_first
from glucoloop.report.fault_words import setting_in_words, settings_in_words, when_in_words
from glucoloop.situations.case import Case
from glucoloop.situations.run import Run
from glucoloop.situations.situation import Situation
from glucoloop.units import MIN_PER_DAY, MIN_PER_H, MU_PER_U, u_h_from_mu_min


def run_facts(run: Run, case: Case, settled: Mapping[str, float] | None = None) -> dict[str, str]:
    """Settings of a run, and those that were settled when its controller was designed."""
    return {"Controller": case_in_words(case), **_settled("", settled or {}), **_of_run(run)}


def _settled(label: str, settled: Mapping[str, float]) -> dict[str, str]:
    numbers = {key: float(f"{value:.4g}") for key, value in settled.items()}
    return {f"As designed{label}": _settings(numbers)} if settled else {}


def comparison_facts(asked: Run, settled: Mapping[str, Mapping[str, float]] | None = None) -> dict[str, str]:
    """Settings of a comparison, and those that were settled when its controllers were designed, by label."""
    told: dict[str, str] = {}
    for case in asked.cases:
        told |= {
            f"Case {case.label}": case_in_words(case),
            **_settled(f", {case.label}", (settled or {}).get(case.label, {})),
        }
    return {**told, **_of_run(asked)}


def trial_facts(trial: Trial) -> dict[str, str]:
    """Settings of a trial."""
    plan = trial.plan
    meals = ", ".join(map(_meal, plan.meals)) or "none"
    if plan.varies:
        meals += f"; varied by {plan.size_spread_pct:g} % and {plan.time_spread_min:g} min"
    told = {
        "Population": f"{trial.population.name}: {trial.population.summary}".removesuffix(": "),
        "Length": _length(plan.horizon_min),
        **_of_situation(trial, meals),
        "Designed for": "the nominal patient" if trial.design == "nominal" else "each person",
        "Arithmetic": f"{trial.precision}, {trial.arithmetic}, JAX {jax.__version__}",
    }
    if trial.first_person:
        told["First person"] = str(trial.first_person)
    return told


def controllers_facts(cases: Iterable[Case]) -> dict[str, str]:
    """Controllers with their settings, by label."""
    return {f"Controller {case.label}": case_in_words(case) for case in cases}


def engine_facts(engines: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """The engines that run the loops of controllers, by their labels, and what native code lacks for the others."""
    of: dict[str, list[str]] = {}
    for label, told in engines.items():
        lacking = told.get("not_native", "it was asked for")
        of.setdefault("native code" if told["engine"] == "native" else f"JAX (xla): {lacking}", []).append(label)
    if len(of) == 1:
        return {"Engine": next(iter(of))}
    return {"Engine": "; ".join(f"{the_first(labels)}: {text}" for text, labels in of.items())}


def engine_notes(engines: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Notes on loops that native code could not take, by the labels of their controllers."""
    of: dict[str, list[str]] = {}
    for label, told in engines.items():
        if told.get("not_native") is not None:
            of.setdefault(told["not_native"], []).append(label)
    for lacking, labels in of.items():
        which = "this loop, which has" if len(labels) == 1 else "these loops, which have"
        yield (
            f"{the_first(labels)}: native code cannot take {which} {lacking}; JAX ran "
            f"{'it' if len(labels) == 1 else 'them'}, to the same result but for rounding, and more slowly."
        )


def case_in_words(case: Case) -> str:
    """A controller with its settings, guard and faults."""
    told = [f"{case.controller.called}, {case.controller.summary}"]
    if case.tuning:
        told.append(_settings(case.tuning))
    if case.known_dead_time:
        told.append("knows the dead time")
    if case.guard is not None:
        told.append("with the guard")
    told += map(fault_in_words, case.faults)
    return "; ".join(told)


def fault_in_words(fault: FaultPart) -> str:
    """A fault with its settings and times."""
    return ", ".join(part for part in (fault.name, settings_in_words(fault), when_in_words(fault)) if part)


def _of_run(run: Run) -> dict[str, str]:
    meals = ", ".join(map(_meal, run.eaten())) or "none"
    told = _of_situation(run, meals)
    if run.initial_glucose_mg_dl is not None:
        told["Glucose at the start"] = f"{run.initial_glucose_mg_dl:g} mg/dl"
    integrator = "exponential integrator" if run.integrator == "fast" else "adaptive Runge-Kutta integrator"
    return {**told, "Length": _length(run.duration_min), "Arithmetic": f"float64, JAX {jax.__version__}, {integrator}"}


def _per_hour(situation: Situation) -> str:
    """Rates of the pump in the unit of pumps, where insulin is given under the skin."""
    if not situation.patient.under_the_skin:
        return ""
    least, most = (u_h_from_mu_min(float(rate)) for rate in (situation.limits.min_mU_min, situation.limits.max_mU_min))
    return f" ({least:.3g} to {most:.3g} U/h)"


def _of_situation(situation: Situation, meals: str) -> dict[str, str]:
    own = (IdealSettings, WhiteNoiseSettings, DeadTimeSettings)
    sensor = [
        *(part.text for part in situation.sensor if not isinstance(part, own)),
        f"noise of variance {situation.noise_variance:g} (mg/dl)², at most {situation.noise_bound_mg_dl:g} mg/dl"
        if situation.noise_variance
        else "no noise",
        f"dead time {situation.dead_time_samples * situation.sample_time_min:g} min",
        f"a reading every {situation.sample_time_min:g} min",
        *([f"at the site {situation.site}"] if situation.site else []),
    ]
    limits, bolus = situation.limits, situation.bolus
    pump = [
        *([_own_text(situation.pump)] if situation.pump.called != PUMPS.usual else []),
        f"{float(limits.min_mU_min):g} to {float(limits.max_mU_min):g} mU/min{_per_hour(situation)}",
        f"a change of at most {float(limits.max_change_mU_min):g} mU/min in a sample",
        *([f"steps of {situation.pump.resolution_mU_min:g} mU/min"] if situation.pump.resolution_mU_min else []),
        *([f"boluses of at most {float(bolus.max_mU) / MU_PER_U:g} U"] if situation.patient.under_the_skin else []),
    ]
    if situation.announce_meals and meals != "none":
        meals += ", announced"
        if situation.miscounts:
            meals += f" with an error of {situation.carb_error_pct:g} % and a bias of {situation.carb_bias_pct:g} %"
    return {
        "Patient": f"{situation.patient.called} at {situation.patient.rests_at}",
        "Setpoint": f"{situation.target_mg_dl:.4g} mg/dl",
        "Meals": meals,
        "Digestion": str(situation.meal_model or "the patient's own model"),
        "Sensor": ", ".join(sensor),
        "Pump": ", ".join(pump),
        "Faults": "; ".join(map(fault_in_words, situation.faults)) or "none",
        "Seed": str(situation.seed),
    }


def _own_text(pump: Part) -> str:
    """A pump with its settings, apart from the limits that every pump has."""
    own = {name: value for name, value in pump.values().items() if name not in PumpPart.settings()}
    return ", ".join([pump.called, *(f"{name}={value_text(value)}" for name, value in own.items())])


def _settings(tuning: Mapping[str, Value]) -> str:
    return ", ".join(setting_in_words(key, value) for key, value in tuning.items())


def _length(horizon_min: float) -> str:
    days, rest = divmod(horizon_min, MIN_PER_DAY)
    if rest or not days:
        return f"{horizon_min:g} min"
    return "a day" if days == 1.0 else f"{days:g} days"


def _clock(t_min: float) -> str:
    return f"{t_min:g} min" if t_min % 15.0 else f"{t_min / MIN_PER_H:g} h"


def _meal(meal: Meal) -> str:
    eaten = f", eaten for {meal.eating_min:g} min" if meal.eating_min else ""
    return f"{meal.carbs_g:g} g at {_clock(meal.t_min)}{eaten}"
