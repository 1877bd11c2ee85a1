"""Configuration of a test of estimators of unknown meals: people, days, noise, estimators, and a controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from glucoloop.config.checked import checked
from glucoloop.config.key import declared, own_keys
from glucoloop.config.run import controllers_of, refuse_unknown_beside
from glucoloop.config.trial import overlay_trial, read_trial, trial_keys, with_people
from glucoloop.control import catalogue
from glucoloop.control.catalogue import ESTIMATING
from glucoloop.refusal import Refusal
from glucoloop.studies.detection.detection import Detection, check_estimators
from glucoloop.studies.detection.options import NO_SITUATION, TAKEN, USUAL, USUAL_DAYS, DetectionKeys


def detection_keys(detection: Detection) -> dict[str, Any]:
    """The flat keys from which the same test is read."""
    of_trial = trial_keys(detection.trial)
    case = detection.trial.cases[0]
    tuning = {key: value for key, value in case.tuning.items() if key != "estimator" and key not in detection.settings}
    return {
        **{key: of_trial[key] for key in TAKEN if key in of_trial},
        "known_dead_time": case.known_dead_time,
        "days": detection.days,
        "estimators": list(detection.estimators),
        "threshold": detection.threshold,
        **detection.settings,
        "controller": case.controller,
        **tuning,
    }


def read_detection(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> Detection:
    """Read the configuration of a test of estimators from flat keys.

    Parameters
    ----------
    keys : mapping
    names : mapping, optional
        Name under which the user gave each key, for messages.

    Raises
    ------
    ValueError
        For a key that is unknown, wrong or at odds with another.
    """
    _refuse_unknown(keys, names)
    own = checked(DetectionKeys, own_keys(keys, DetectionKeys), names)
    of_trial = {key: keys[key] for key in TAKEN if key in keys and key != "known_dead_time"}
    check_estimators(own.estimators, (names or {}).get("estimators", "estimators"))
    settings = {key: value for key, value in keys.items() if key in catalogue.setting_names(own.controller)}
    trial = read_trial({"days": 1, **overlay_trial(USUAL, of_trial, names)}, _cases(own, keys, settings), names)
    asked = {key: value for key, value in settings.items() if key in ESTIMATING.estimator_settings}
    complete = catalogue.complete(ESTIMATING.name, asked, *trial.whom, noisy=trial.noise_variance > 0.0)
    if asked:
        ESTIMATING(**complete)  # refuses before anything is designed
    return Detection(
        trial=trial,
        days=own.days or (USUAL_DAYS if trial.people == 1 else 1),
        estimators=own.estimators,
        settings={key: complete[key] for key in ESTIMATING.estimator_settings},
        threshold=own.threshold,
        given=with_people(keys, trial.population),
    )


def _cases(own: DetectionKeys, keys: Mapping[str, object], settings: Mapping[str, object]) -> list[dict[str, object]]:
    """A case for each estimator if the controller depends on it, otherwise one case."""
    known = {"known_dead_time": keys["known_dead_time"]} if "known_dead_time" in keys else {}
    if catalogue.controller_entry(own.controller).estimator_settings:
        if "estimator" in settings:
            raise Refusal(f"the controller {own.controller} is tried with each of the estimators; leave estimator out")
        return [
            {"label": name, "controller": own.controller, **settings, "estimator": name, **known}
            for name in own.estimators
        ]
    of_controller = {key: value for key, value in settings.items() if key not in ESTIMATING.estimator_settings}
    return [{"label": own.controller, "controller": own.controller, **of_controller, **known}]


def _refuse_unknown(keys: Mapping[str, object], names: Mapping[str, str] | None) -> None:
    known = [*declared(DetectionKeys), *TAKEN, *sorted(catalogue.setting_names(*controllers_of(keys)))]
    if NO_SITUATION in keys:
        called = (names or {}).get(NO_SITUATION, NO_SITUATION)
        raise Refusal(f"{called} is no part of a test of estimators, which are told of no meal; leave it out")
    refuse_unknown_beside(keys, known, " of a test of estimators")
