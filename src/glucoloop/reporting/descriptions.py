"""Descriptions in words: settings of runs, trials and controllers by name, faults, engines, and virtual people."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import jax

from glucoloop.component.setting import Value, value_text
from glucoloop.faults import DURATION, FAULTS, LATEST, PER_DAY, START, TIMING, FaultComponent
from glucoloop.meals import Meal
from glucoloop.patients.catalogue import patient_entry
from glucoloop.patients.population import Population
from glucoloop.pumps import PUMPS, PumpComponent
from glucoloop.reporting.labelled_traces import moment_text
from glucoloop.sensors import DeadTime, IdealSensor, WhiteNoise
from glucoloop.simulation.user_objects import goes_fast
from glucoloop.situations.case import Case
from glucoloop.situations.run import FedSituation, Run
from glucoloop.text import the_first
from glucoloop.trials.trial import Trial
from glucoloop.units import MIN_PER_DAY, MIN_PER_H, MU_PER_U, UNIT_BY_ENDING, ending_of, u_h_from_mu_min

# What changes nothing, if it is not 0.
_NEUTRAL: Final = {"gain": 1.0}
_REMARKABLE: Final = 3
_MAX_MEALS: Final = 20
"""Largest number of meals of a run that are named."""


# ---------------------------------------------------------------------------------- runs, comparisons and trials


def run_facts(run: Run, case: Case, designed: Mapping[str, float] | None = None) -> dict[str, str]:
    """Settings of a run, and those that followed from the design of its controller."""
    return {**_case_facts("Controller", "As designed", case, designed, run.start_min or 0.0), **_run_facts(run)}


def comparison_facts(config: Run, designed: Mapping[str, Mapping[str, float]]) -> dict[str, str]:
    """Settings of a comparison, and those that followed from the designs of its controllers, by label."""
    return {**controllers_facts(config.cases, designed, config.start_min or 0.0), **_run_facts(config)}


def _case_facts(
    name: str, as_designed: str, case: Case, designed: Mapping[str, float] | None, start_min: float
) -> dict[str, str]:
    numbers = {key: float(f"{value:.4g}") for key, value in (designed or {}).items()}
    return {name: _case_in_words(case, numbers, start_min), **({as_designed: _settings(numbers)} if numbers else {})}


def trial_facts(trial: Trial) -> dict[str, str]:
    """Settings of a trial."""
    plan = trial.plan
    meals = ", ".join(_meal(meal, trial.start_min if plan.days > 1 else None) for meal in plan.meals) or "none"
    if plan.own is not None:
        meals = f"each person's own day, on average {meals}"
    if plan.size_spread_pct or plan.time_spread_min:
        meals += f"; varied by {plan.size_spread_pct:g} % and {plan.time_spread_min:g} min"
    return {
        "Population": f"{trial.population.name}: {trial.population.summary}".removesuffix(": "),
        "Length": _length(plan.horizon_min),
        **({"Over time": "all days together, by the time of day"} if trial.one_day_of_counts else {}),
        **_situation_facts(trial, meals),
        "Designed for": "the nominal patient" if trial.design == "nominal" else "each person",
        "Arithmetic": f"{trial.precision}, {trial.arithmetic}, JAX {jax.__version__}",
        **({"First person": str(trial.first_person)} if trial.first_person else {}),
    }


def controllers_facts(
    cases: Iterable[Case], designed: Mapping[str, Mapping[str, float]], start_min: float = 0.0
) -> dict[str, str]:
    """Controllers with their settings, and those that followed from their designs, by label."""
    facts: dict[str, str] = {}
    for case in cases:
        names = f"Controller {case.label}", f"As designed, {case.label}"
        facts |= _case_facts(*names, case, designed.get(case.label), start_min)
    return facts


def _case_in_words(case: Case, distinguished: Iterable[str] = (), start_min: float = 0.0) -> str:
    """A controller with its guard, its faults, and its settings but those that are told apart."""
    parts = [
        f"{case.controller.display_name}, {case.controller.summary}",
        _settings({key: value for key, value in case.tuning.items() if key not in distinguished and value != ""}),
        f"acts every {case.every_min:g} min" if case.every_min is not None else "",
        "knows the dead time" if case.known_dead_time else "",
        "with the guard" if case.guard is not None else "",
        *(fault_in_words(fault, start_min) for fault in case.faults),
    ]
    return "; ".join(filter(None, parts))


def _run_facts(run: Run) -> dict[str, str]:
    start = run.initial_glucose_mg_dl
    constant_by_minute = bool(run.exercise or run.rhythm) or run.glucagon is not None
    fast = "exponential" if goes_fast(run.nominal) and not constant_by_minute else "explicit Runge-Kutta"
    integrator = f"{fast if run.integrator == 'fast' else 'adaptive Runge-Kutta'} integrator"
    return {
        **_situation_facts(
            run,
            the_first([_run_meal(meal, run) for meal in sorted(run.eaten(), key=lambda meal: meal.t_min)], _MAX_MEALS)
            or "none",
        ),
        **({} if start is None else {"Glucose at the start": f"{start:g} mg/dl"}),
        "Length": _length(run.horizon_min),
        "Arithmetic": f"float64, JAX {jax.__version__}, {integrator}",
    }


def _exercise(situation: FedSituation) -> str:
    """Exercise of a situation, as it is given."""
    spreads = f"{situation.exercise_spread_pct:g} % and {situation.exercise_time_spread_min:g} min"
    varied = situation.exercise_spread_pct or situation.exercise_time_spread_min
    return ", ".join(situation.exercise) + (f"; varied by {spreads}" if situation.exercise and varied else "")


def _situation_facts(situation: FedSituation, meals: str) -> dict[str, str]:
    limits, pump, subcutaneous = situation.limits, situation.pump, situation.patient.subcutaneous
    usual = (IdealSensor, WhiteNoise, DeadTime)
    least, most = float(limits.min_mU_min), float(limits.max_mU_min)
    noise = f"noise of variance {situation.noise_variance:g} (mg/dl)², at most {situation.noise_bound_mg_dl:g} mg/dl"
    per_hour = f" ({u_h_from_mu_min(least):.3g} to {u_h_from_mu_min(most):.3g} U/h)"
    beside_limits = [
        f"{name}={value_text(value)}" for name, value in pump.values().items() if name not in PumpComponent.settings()
    ]
    sensor_parts = [
        *(part.text for part in situation.sensor if not isinstance(part, usual)),
        noise if situation.noise_variance else "no noise",
        f"dead time {situation.dead_time_samples * situation.sample_time_min:g} min",
        f"a reading every {situation.sample_time_min:g} min",
        f"at the site {situation.site}" if situation.site else "",
    ]
    pump_parts = [
        *([] if pump.display_name == PUMPS.default else [pump.display_name, *beside_limits]),
        f"{least:g} to {most:g} mU/min{per_hour if subcutaneous else ''}",
        f"a change of at most {float(limits.max_change_mU_min):g} mU/min in a sample",
        f"steps of {pump.resolution_mU_min:g} mU/min" if pump.resolution_mU_min else "",
        f"boluses of at most {float(situation.bolus.max_mU) / MU_PER_U:g} U" if subcutaneous else "",
    ]
    if situation.announce_meals and meals != "none":
        meals += ", announced"
        if situation.announce_before_min:
            meals += f" {situation.announce_before_min:g} min before eating"
        if situation.miscounts:
            meals += f" with an error of {situation.carb_error_pct:g} % and a bias of {situation.carb_bias_pct:g} %"
    return {
        "Patient": f"{situation.patient.display_name} at {situation.patient.rests_at}",
        "Setpoint": f"{situation.target_mg_dl:.4g} mg/dl",
        "Meals": meals,
        **({"Habits": "; ".join(habit.text for habit in situation.habits)} if situation.habits else {}),
        **({"Exercise": _exercise(situation)} if situation.exercise else {}),
        **({} if situation.rescue is None else {"Rescue carbohydrate": situation.rescue.text}),
        **({} if situation.glucagon is None else {"Glucagon": situation.glucagon.text}),
        **({"Rhythm": "; ".join(part.text for part in situation.rhythm)} if situation.rhythm else {}),
        **({"Warm-up": _length(situation.warm_up_min)} if situation.warm_up_min else {}),
        "Digestion": "the patient's own model" if situation.meal_model is None else situation.meal_model.text,
        "Sensor": ", ".join(filter(None, sensor_parts)),
        "Pump": ", ".join(filter(None, pump_parts)),
        "Faults": "; ".join(fault_in_words(fault, situation.start_min or 0.0) for fault in situation.faults) or "none",
        "Seed": str(situation.seed),
    }


def _settings(tuning: Mapping[str, Value]) -> str:
    return ", ".join(_setting_in_words(key, value) for key, value in tuning.items())


def _length(horizon_min: float) -> str:
    days, rest = divmod(horizon_min, MIN_PER_DAY)
    if not days:
        return f"{horizon_min:g} min"
    return ("a day" if days == 1.0 else f"{days:g} days") + (f" and {rest:g} min" if rest else "")


def _meal(meal: Meal, start_min: float | None) -> str:
    """A meal of each day, by the clock if the run has one, or by the time from the start."""
    if start_min is not None:
        return _eaten(meal, moment_text(meal.t_min, math.inf, start_min).partition(", ")[2])
    in_hours = meal.t_min <= MIN_PER_DAY and not meal.t_min % 15.0
    return _eaten(meal, f"{meal.t_min / MIN_PER_H:g} h" if in_hours else moment_text(meal.t_min))


def _run_meal(meal: Meal, run: Run) -> str:
    """A meal of a run, by day and clock if it is longer than a day."""
    if run.horizon_min <= MIN_PER_DAY:
        return _meal(meal, None)
    return _eaten(meal, moment_text(meal.t_min, run.horizon_min, run.start_min or 0.0))


def _eaten(meal: Meal, when: str) -> str:
    return f"{meal.carbs_g:.4g} g at {when}" + (f", eaten for {meal.eating_min:g} min" if meal.eating_min else "")


# ---------------------------------------------------------------------------------------------- engines


def engine_facts(engines: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """The engines that run the loops of controllers, by their labels, and what native code lacks for the others."""
    labels: dict[str, list[str]] = {}
    for label, engine in engines.items():
        lacking = engine.get("not_native", "it was asked for")
        labels.setdefault("native code" if engine["engine"] == "native" else f"JAX (xla): {lacking}", []).append(label)
    if len(labels) == 1:
        return {"Engine": next(iter(labels))}
    return {"Engine": "; ".join(f"{the_first(alike)}: {text}" for text, alike in labels.items())}


def engine_notes(engines: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Notes on loops that native code could not take, by the labels of their controllers."""
    labels: dict[str, list[str]] = {}
    for label, engine in engines.items():
        if engine.get("not_native") is not None:
            labels.setdefault(engine["not_native"], []).append(label)
    for lacking, alike in labels.items():
        which, them = ("this loop, which has", "it") if len(alike) == 1 else ("these loops, which have", "them")
        yield (
            f"{the_first(alike)}: native code cannot take {which} {lacking}; JAX ran {them}, to the same result but "
            "for rounding, and more slowly."
        )


# ---------------------------------------------------------------------------------------------- faults


def fault_in_words(fault: FaultComponent, start_min: float = 0.0) -> str:
    """A fault with its settings and times, in a run that starts `start_min` after midnight."""
    return ", ".join(filter(None, (fault.name, settings_in_words(fault), when_in_words(fault, start_min))))


def short_names(faults: Sequence[str]) -> dict[str, str]:
    """Short name of each fault: its kind, and the settings that distinguish it from others of its kind.

    Settings that are the same for all faults of a kind are left out, and so are settings without effect. Two faults
    never have the same name: if necessary it is the full text of the fault.
    """
    parsed = {fault: FAULTS.choose(fault) for fault in faults}
    names = {text: _short_name(fault, parsed.values()) for text, fault in parsed.items()}
    taken = list(names.values())
    return {fault: fault if taken.count(name) > 1 else name for fault, name in names.items()}


def _short_name(fault: FaultComponent, among: Iterable[FaultComponent]) -> str:
    kind = [other for other in among if other.name == fault.name]

    def differ(keys: Iterable[str]) -> int:
        # compared as text, since what is not a number is not equal to itself
        return len({tuple(repr(other.values().get(key)) for key in keys) for other in kind})

    keys = [key for key in fault.settings() if differ([key]) > 1]
    # what it is comes before when it is, and of the times the duration first
    what = [key for key in keys if key not in TIMING]
    candidates = [what, *([*what, key] for key in (DURATION, PER_DAY, START, LATEST)), keys]
    chosen = next((some for some in candidates if differ(some) == len(kind)), keys)
    values = {key: fault.values()[key] for key in chosen if key in fault.values()}
    matter = {key: value for key, value in values.items() if isinstance(value, bool) or value != _NEUTRAL.get(key, 0.0)}
    return f"{fault.name} {_settings(matter or values)}".rstrip()


def _setting_in_words(key: str, value: Value) -> str:
    """A setting with its unit: ``size 60 mg/dl``, ``not noticed``."""
    end = ending_of(key)
    name, unit = f"_{key}".removesuffix(end).strip("_").replace("_", " "), UNIT_BY_ENDING.get(end, "")
    if isinstance(value, bool):
        return name if value else f"not {name}"
    name = {DURATION: "", PER_DAY: "", START: "from", LATEST: "up to"}.get(key, name)
    number = f"{value:g}" if isinstance(value, int | float) else str(value)
    return " ".join(filter(None, (name, number, "a day" if key == PER_DAY else unit)))


def settings_in_words(fault: FaultComponent) -> str:
    """Settings of a fault apart from its times; empty if it has none."""
    return _settings({key: value for key, value in fault.values().items() if key not in TIMING})


def when_in_words(fault: FaultComponent, start_min: float = 0.0) -> str:
    """Times of a fault, in a phrase."""
    times = {key: f"{float(value):g}" for key, value in fault.values().items() if key in TIMING}
    if not fault.timed:
        return "at random, at any time" if fault.comes_and_goes else "always"
    if PER_DAY in times:
        lasting = f"for {times[DURATION]} min" if DURATION in times else "for one sample"
        return f"at random, {times[PER_DAY]} times a day, {lasting}"
    if not times:
        return "always"
    start = times.get(START, "0")
    latest = times.get(LATEST, start)
    ends = [float(start), float(latest)]
    first, last = (moment_text(t_min, ends[1], start_min) for t_min in ends)
    begins = f"from {first}" if latest == start else f"from a moment between {first.removesuffix(' min')} and {last}"
    return f"{begins}, for {times[DURATION]} min" if DURATION in times else f"{begins} to the end"


def _window_of(fault: FaultComponent, end_min: float) -> tuple[float, float] | None:
    """Time within which a fault is present, by its settings; None if it comes at random at any time."""
    times = fault.values()
    if not fault.timed or PER_DAY in times:
        return None
    start = float(times.get(START, 0.0))
    latest = float(times.get(LATEST, start))
    stop = min(end_min, latest + float(times.get(DURATION, end_min)))
    return (start, stop) if start < end_min else None


def windows(faults: Iterable[FaultComponent], end_min: float) -> Iterator[tuple[FaultComponent, tuple[float, float]]]:
    """Faults that have a time before the end, with these times."""
    for fault in faults:
        window = _window_of(fault, end_min)
        if window is not None:
            yield fault, window


# ---------------------------------------------------------------------------------------------- people


def person_in_words(population: Population, person: Mapping[str, Any], seed: int = 0) -> str:
    """Name and basal rate of a person, who is a row of a summary, and the parameters farthest from the middle."""
    distributions, meanings = population.distributions(), patient_entry(population.patient).meanings
    parameters: Mapping[str, float] = person["parameters"]
    spans = {name: distributions[name].upper - distributions[name].lower for name in parameters}
    apart = {name: (value - distributions[name].centre) / (spans[name] or 1.0) for name, value in parameters.items()}
    basal = person["basal_insulin_mU_min"]
    per_hour = f" ({u_h_from_mu_min(basal):.2f} U/h)" if patient_entry(population.patient).subcutaneous else ""
    names = population.names(seed, [person["person"]]) if population.table else None
    phrases = [f"{f'{names[0]}: ' if names else ''}basal rate {basal:.1f} mU/min{per_hour}"]
    for name in sorted(parameters, key=lambda name: -abs(apart[name]))[:_REMARKABLE]:
        centre, way = distributions[name].centre, "above" if apart[name] > 0.0 else "below"
        far = f"{abs(parameters[name] / centre - 1.0):.0%} {way}".replace("%", " %") if centre else way
        phrases.append(f"{meanings.get(name, name)} {parameters[name]:.3g}, {far} the usual {centre:.3g}")
    return "; ".join(phrases)
