"""Cases from a file and the command line; those given on the command line take precedence."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any, Final

from glucoloop.config.case_text import parse_case
from glucoloop.config.run import case_key_names, controllers_of, overlay, refuse_limits_without_guard
from glucoloop.control import catalogue
from glucoloop.parts.guard import GUARD
from glucoloop.parts.setting import AMONG_OPTIONS, known_names
from glucoloop.printable import is_printable
from glucoloop.refusal import Refusal

CASES_KEY: Final = "case"
"""Key of the tables of cases in a file: ``[[case]]``."""
CONTROLLERS_KEY: Final = "controllers"
"""Key of a list of controllers, each a case with its usual tuning."""
_GIVEN_CASES: Final = "cases"


def take_cases(given: dict[str, Any], of_file: dict[str, Any]) -> list[dict[str, Any]]:
    """Take the cases out of what was given and out of the file.

    Cases and controllers that are given take the place of the file's. Without any, the file's cases are taken, and a
    setting that is given holds for each of them that has it, whatever the file says of it.

    Parameters
    ----------
    given, of_file : dict
        Flat keys of the command line and of the file; the cases are removed from both.

    Raises
    ------
    ValueError
        For cases that are no tables, or a given controller that makes different cases of the file alike.
    """
    of_file_cases = of_file.pop(CASES_KEY, [])
    if not isinstance(of_file_cases, list) or not all(isinstance(case, dict) for case in of_file_cases):
        raise Refusal("'case' in the configuration is not a list of tables; write each under [[case]]")
    named = given.pop(CONTROLLERS_KEY, None) or []
    own = [
        *({"label": name, "controller": name} for name in named),
        *(parse_case(text) for text in given.pop(_GIVEN_CASES, None) or ()),
    ]
    if own:
        of_file.pop(CONTROLLERS_KEY, None)
        return own
    cases = [_with(given, case, of_file) for case in of_file_cases]
    _refuse_alike(of_file_cases, cases, given)
    return cases


def given_with(keys: Mapping[str, Any], cases: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Keys that were given with a table for each case, as they stand in a file."""
    tables = [dict(case) for case in cases]
    return {**keys, **({CASES_KEY: tables} if tables else {})}


def under_shared(shared: Mapping[str, object], case: Mapping[str, object]) -> dict[str, object]:
    """The keys of a case over those that all cases share; limits of a guard hold where there is one."""
    keys = overlay(shared, {"controller": catalogue.USUAL_CONTROLLER, **case})
    if keys.get("guard") is True:
        return keys
    return {key: value for key, value in keys.items() if key not in GUARD or key in case}


def label_of(case: Mapping[str, object]) -> str:
    """Label of a case.

    Raises
    ------
    ValueError
        For one that is missing or cannot be printed in a line.
    """
    label = case.get("label")
    if not isinstance(label, str) or not label.strip():
        raise Refusal(f"the case {dict(case)!r} has no label; give it one, like label = 'careful'")
    if not is_printable(label):
        raise Refusal(f"the label {label!r} cannot be printed in a line; leave out its control characters")
    return label


def refuse_foreign(case: Mapping[str, object], shared: Container[str], of: str, known: Sequence[str]) -> None:
    """Refuse a key of a case that all cases share, or that no case has; `of` names what they share."""
    for key in case:
        if key in shared:
            raise Refusal(f"{key} belongs to the {of}, which all cases share; give it outside the cases")
        if key not in known:
            raise Refusal(f"unknown key {key!r}; {known_names(key, known, where=AMONG_OPTIONS)}")


def refuse_idle(
    keys: Mapping[str, object],
    controllers: Iterable[str],
    *,
    guarded: bool,
    names: Mapping[str, str] | None = None,
) -> None:
    """Refuse a setting beside the cases that none of them has."""
    refuse_limits_without_guard(keys, guarded=guarded, names=names)
    used = list(dict.fromkeys(controllers))
    idle = catalogue.setting_names() - {
        setting for name in used for setting in catalogue.controller_entry(name).settings()
    }
    for key in keys:
        if key in idle:
            raise Refusal(
                f"{(names or {}).get(key, key)} is a setting of none of these controllers: {', '.join(used)}; "
                "leave it out, or add a controller that has it"
            )


def _with(given: Mapping[str, Any], case: Mapping[str, Any], of_file: Mapping[str, Any]) -> dict[str, Any]:
    """A case of the file with those given keys that its controller and its guard have."""
    told = {**of_file, **case, **given}
    controllers = [catalogue.USUAL_CONTROLLER, *controllers_of(of_file, [told])]
    upper = {key: value for key, value in given.items() if key in case_key_names(*controllers)}
    own = set(catalogue.controller_entry(controllers[-1]).settings())
    foreign = {*(catalogue.setting_names(*controllers) - own), *(() if told.get("guard") is True else GUARD)}
    return overlay(case, {key: value for key, value in upper.items() if key not in foreign})


def _refuse_alike(before: list[dict[str, Any]], after: list[dict[str, Any]], given: Mapping[str, Any]) -> None:
    if "controller" not in given:
        return
    for later in range(len(after)):
        for earlier in range(later):
            if _unlike(before[earlier], before[later]) and not _unlike(after[earlier], after[later]):
                first, second = after[earlier].get("label"), after[later].get("label")
                raise Refusal(
                    f"--controller {given['controller']} makes the cases {first!r} and {second!r} of the file alike; "
                    "leave it out, or give the cases with --case"
                )


def _unlike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return {**one, "label": ""} != {**other, "label": ""}
