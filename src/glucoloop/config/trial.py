"""Configuration of a trial: people, meals, sensor, and the controllers under test."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal

from glucoloop.cohorts.trial import Trial, usual_shard_people
from glucoloop.config.cases import (
    CASES_KEY,
    CONTROLLERS_KEY,
    given_with,
    label_of,
    refuse_foreign,
    refuse_idle,
    under_shared,
)
from glucoloop.config.checked import checked
from glucoloop.config.comparison import MOST_CASES
from glucoloop.config.key import declared, own_keys
from glucoloop.config.options.case import IDENTIFICATION_KEYS
from glucoloop.config.options.situation import SituationKeys, refuse_parts_of_samples
from glucoloop.config.options.trial import SITUATION_KEYS, TrialKeys
from glucoloop.config.run import (
    ask_about_surroundings,
    case_key_names,
    completed,
    controllers_of,
    faults_told,
    overlay,
    parts_told,
    read_case,
    refuse_impossible,
    refuse_unknown_beside,
)
from glucoloop.config.unusual import ALLOW_UNUSUAL, ask_about, ask_about_clock
from glucoloop.control.catalogue import USUAL_CONTROLLER, controller_entry
from glucoloop.meals.plan import MealPlan
from glucoloop.parts.clock_text import time_of_day_text
from glucoloop.parts.patients import patient_entry
from glucoloop.patients.population import Population, populations_of
from glucoloop.refusal import Refusal
from glucoloop.situations.case import Case
from glucoloop.situations.meal_text import meal_text, parse_meal
from glucoloop.situations.population import named_population, population_keys, read_population
from glucoloop.units import MIN_PER_DAY

_LENGTHS: Final = ("days", "duration_min")
_DIGITS: Final = 20


def trial_key_names() -> list[str]:
    """Flat keys of a trial, without those of its cases."""
    return [*declared(TrialKeys), *SITUATION_KEYS]


def read_trial(
    keys: Mapping[str, object], cases: Sequence[Mapping[str, object]] = (), names: Mapping[str, str] | None = None
) -> Trial:
    """Read the configuration of a trial from the shared keys and those of each case.

    Parameters
    ----------
    keys : mapping
    cases : sequence of mapping
        Cases with their labels; the controllers that `keys` names come before them. Without either it is linear MPC.
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For a key that is unknown, wrong or at odds with another, a meal that does not fit into its day, or a label
        that is missing or used twice.
    """
    tables = [*_controllers(keys), *cases]
    named = controllers_of({}, tables)
    _refuse_unknown(keys, named)
    called = {key: (names or {}).get(key, key) for key in keys}
    if all(key in keys for key in _LENGTHS):
        raise Refusal(f"{called['days']} and {called['duration_min']} both tell the length; leave one out")
    own = checked(TrialKeys, own_keys(keys, TrialKeys), names)
    situation = checked(SituationKeys, completed({key: keys[key] for key in SITUATION_KEYS if key in keys}), names)
    meals = [parse_meal(text) for text in own.meals]
    if not situation.allow_unusual:
        ask_about(own, names)
        ask_about_surroundings(situation, own.meals, names)
        ask_about_clock(own.meals, own.duration_min or (own.days or 1) * MIN_PER_DAY)
    refuse_impossible(situation)
    if "meals" not in keys and own.duration_min is not None:
        meals = [meal for meal in meals if meal.t_min < own.duration_min]
    plan = MealPlan(
        meals,
        own.days or 1,
        size_spread_pct=own.meal_size_spread_pct,
        time_spread_min=own.meal_time_spread_min,
        horizon_min=own.duration_min,
    )
    refuse_parts_of_samples(plan.horizon_min, situation.sample_time_min, names, has_duration="days" not in keys)
    traces = _traces(own.traces, called.get("traces", "traces"))
    faults = faults_told(situation.faults, plan.horizon_min, allow_unusual=situation.allow_unusual)
    surroundings = dataclasses.replace(situation.situation(), faults=faults, **parts_told(situation))
    read = _cases({key: keys[key] for key in _own_case_keys(named) if key in keys}, tables, situation, names)
    slow = any(controller_entry(case.controller).slow for case in read)
    population = _population(own.population, called.get("population", "population"), situation.patient)
    return Trial(
        **{field.name: getattr(surroundings, field.name) for field in dataclasses.fields(surroundings)},
        population=population,
        people=own.people,
        first_person=own.first_person,
        plan=plan,
        cases=read,
        precision=own.precision,
        arithmetic=own.arithmetic,
        design=own.design,
        traces=traces,
        shard_people=own.shard_people
        or usual_shard_people(own.people, plan.horizon_min, traced=own.people if traces == "all" else 0, slow=slow),
        given=given_with(with_people(keys, population), cases),
    )


def with_people(keys: Mapping[str, object], population: Population) -> dict[str, object]:
    """Keys with the people of a file themselves, since a path is one only beside its file."""
    told = keys.get("population")
    of_file = isinstance(told, str) and told not in populations_of(population.patient)
    return {**keys, "population": population_keys(population)} if of_file else dict(keys)


def overlay_trial(
    lower: Mapping[str, object], upper: Mapping[str, object], names: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Merge flat keys of two layers. The upper one wins; each of its keys removes those below that it excludes."""
    excluded: set[str] = set()
    if any(key in upper for key in _LENGTHS):
        excluded.update(_LENGTHS)
    if "patient" in upper and upper["patient"] != lower.get("patient"):
        excluded.add("population")
    return overlay({key: value for key, value in lower.items() if key not in excluded}, upper, names)


def trial_keys(trial: Trial) -> dict[str, Any]:
    """The flat keys from which the same trial is read."""
    plan, preset = trial.plan, populations_of(trial.patient).get(trial.population.name)
    whole_days = plan.horizon_min == plan.days * MIN_PER_DAY
    differing = {
        "operating_point": trial.whom[1],
        "announce_meals": trial.announced,
        "start": None if trial.start_min is None else time_of_day_text(trial.start_min),
        "dead_time_min": trial.dead_time_samples * trial.sample_time_min,
        "faults": list(trial.faults),
        "metrics": list(trial.metrics),
    }
    situation = {key: differing[key] if key in differing else getattr(trial, key) for key in SITUATION_KEYS}
    unusual = {ALLOW_UNUSUAL: True} if situation.pop(ALLOW_UNUSUAL) else {}
    return {
        "population": trial.population.name if trial.population == preset else population_keys(trial.population),
        "people": trial.people,
        "first_person": trial.first_person,
        "meals": [meal_text(meal) for meal in plan.meals],
        **({"days": plan.days} if whole_days else {"duration_min": plan.horizon_min}),
        "meal_size_spread_pct": plan.size_spread_pct,
        "meal_time_spread_min": plan.time_spread_min,
        **situation,
        "design": trial.design,
        "precision": trial.precision,
        "arithmetic": trial.arithmetic,
        "traces": trial.traces,
        "shard_people": trial.shard_people,
        **unusual,
        CASES_KEY: [_case_keys(case) for case in trial.cases],
    }


def _case_keys(case: Case) -> dict[str, Any]:
    keys = {
        "label": case.label,
        "controller": case.controller,
        **case.tuning,
        "known_dead_time": case.known_dead_time,
        **{key: getattr(case, key) for key in IDENTIFICATION_KEYS},
        "guard": None if case.guard is None else True,
        **(case.guard or {}),
        "faults": list(case.faults) or None,
    }
    return {key: value for key, value in keys.items() if value is not None}


def _own_case_keys(controllers: Sequence[str]) -> list[str]:
    """Keys of a case in a trial: without `model`, since models are identified from the people of the trial."""
    return [key for key in case_key_names(*controllers) if key != "model"]


def _refuse_unknown(keys: Mapping[str, object], controllers: Sequence[str]) -> None:
    known = [*trial_key_names(), *(key for key in _own_case_keys(controllers) if key != "controller")]
    refuse_unknown_beside(keys, known, " of a trial")


def _population(told: object, name: str, patient: str) -> Population:
    if told is None:
        return named_population(patient_entry(patient).usual_population, patient)
    if isinstance(told, Mapping):
        return read_population(told, patient)
    if isinstance(told, str):
        return named_population(told, patient)
    raise Refusal(f"{name} is {told!r}; give {', '.join(populations_of(patient))}, or a file like people.toml")


def _traces(told: object, name: str) -> Literal["none", "all"] | int:
    if told == "none" or told == "all":
        return told
    digits = isinstance(told, str) and told.isascii() and told.isdecimal() and len(told) < _DIGITS
    number = int(str(told)) if digits else told
    if isinstance(number, int) and not isinstance(number, bool) and number >= 1:
        return number
    raise Refusal(f"{name} is {told!r}; give none, all, or the number of people whose traces are kept")


def _controllers(keys: Mapping[str, object]) -> list[dict[str, object]]:
    """A case for each controller that is named without settings."""
    named = keys.get(CONTROLLERS_KEY, [])
    if not isinstance(named, list | tuple) or not all(isinstance(name, str) for name in named):
        raise Refusal(f"{CONTROLLERS_KEY} is {named!r}; give a list of names, like ['mpc', 'mpc-se']")
    return [{"label": name, "controller": name} for name in named]


def _cases(
    shared: Mapping[str, object],
    tables: Sequence[Mapping[str, object]],
    situation: SituationKeys,
    names: Mapping[str, str] | None,
) -> tuple[Case, ...]:
    if len(tables) > MOST_CASES:
        raise Refusal(f"a trial of {len(tables)} controllers is not possible; give at most {MOST_CASES}")
    read = [_read_case(table, shared, situation) for table in tables or [{"label": USUAL_CONTROLLER}]]
    guarded = any(case.guard is not None for case in read)
    refuse_idle(shared, [case.controller for case in read], guarded=guarded, names=names)
    return tuple(read)


def _read_case(table: Mapping[str, object], shared: Mapping[str, object], situation: SituationKeys) -> Case:
    label = label_of(table)
    own = {key: value for key, value in table.items() if key != "label"}
    try:
        refuse_foreign(own, trial_key_names(), "trial", _own_case_keys(controllers_of(own)))
        case = read_case(under_shared(shared, own), situation)
    except Refusal as error:
        raise Refusal(f"case {label!r}: {error}") from None
    return case.case(label)
