"""Reading of the configuration of an identification."""

from __future__ import annotations

from collections.abc import Mapping

from glucoloop.config.checked import checked
from glucoloop.config.key import declared, plain
from glucoloop.config.options.identification import EXPERIMENT_KEYS, RECORD_KEYS, IdentificationKeys
from glucoloop.config.options.situation import (
    LONGEST_SAMPLE_TIME_MIN,
    PAPER_SAMPLE_TIME_MIN,
    SHORTEST_SAMPLE_TIME_MIN,
)
from glucoloop.config.run import patient_of
from glucoloop.config.unusual import ask_about
from glucoloop.parts.setting import refuse_unknown_keys
from glucoloop.refusal import Refusal


def read_identification(keys: Mapping[str, object], names: Mapping[str, str] | None = None) -> IdentificationKeys:
    """Read the configuration of an identification from flat keys, and complete it.

    Raises
    ------
    ValueError
        For an unknown key, a value of the wrong type or out of bounds, or keys that exclude one another.
    """
    known = declared(IdentificationKeys)
    refuse_unknown_keys(keys, known)
    called = {key: (names or {}).get(key, key) for key in keys}
    if "data" in keys:
        for key in called.keys() & set(EXPERIMENT_KEYS):
            raise Refusal(f"{called[key]} is about the simulated patient, but there is a record; leave one out")
    else:
        for key in called.keys() & set(RECORD_KEYS):
            raise Refusal(f"{called[key]} is about a record; give one with --data, or leave it out")
    if keys.get("best_pole") and "laguerre_pole" in keys:
        raise Refusal("a Laguerre pole is given and is also to be searched for; leave one out")
    if keys.get("best_pole") and keys.get("laguerre_functions") == 0:
        raise Refusal("0 Laguerre functions have no pole to search for; give more, or leave out the search")
    sample_time = keys.get("sample_time_min", PAPER_SAMPLE_TIME_MIN)
    entry = patient_of(keys)
    derived: dict[str, object] = {"operating_point": entry.usual_point, "amplitude_mU_min": entry.pulse_mU_min}
    # A sample time that is wrong is refused by name with the other keys, and nothing follows from it; what suits a
    # record is chosen by the record.
    if (
        "data" not in keys
        and isinstance(sample_time, int | float)
        and SHORTEST_SAMPLE_TIME_MIN <= sample_time <= LONGEST_SAMPLE_TIME_MIN
    ):
        derived |= entry.identification(float(sample_time))
    asked = checked(IdentificationKeys, {**derived, **keys}, names)
    entry.operating_point(asked.operating_point)
    if not asked.allow_unusual:
        ask_about(asked, names)
    return asked


def overlay_identification(lower: Mapping[str, object], upper: Mapping[str, object]) -> dict[str, object]:
    """Merge flat keys of two layers. The upper one wins; each of its keys removes those below that it excludes."""
    excluded: set[str] = set()
    if "data" in upper:
        excluded.update(EXPERIMENT_KEYS)
    elif any(key in upper for key in EXPERIMENT_KEYS):
        excluded.update(("data", *RECORD_KEYS))
    if upper.get("best_pole"):
        excluded.add("laguerre_pole")
    elif "laguerre_pole" in upper:
        excluded.add("best_pole")
    return {**{key: value for key, value in lower.items() if key not in excluded}, **upper}


def identification_keys(config: IdentificationKeys) -> dict[str, object]:
    """The flat keys from which the same identification is read."""
    unused = EXPERIMENT_KEYS if config.data is not None else RECORD_KEYS
    left_out = {*unused, *(("laguerre_pole",) if config.best_pole else ())}
    return {key: value for key, value in plain(config).items() if key not in left_out}
