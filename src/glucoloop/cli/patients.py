"""``glucoloop patients``: the known patients with their usual settings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from glucoloop.cli.options import Given, Option, with_options
from glucoloop.parts.patients import NOMINAL, PatientEntry, patient_entry, patient_names

HELP: Final = (
    "List the patients, with their operating points, their populations, and what is usual for each.\n\n"
    "A name goes with --patient of the other commands. Patients of other packages are listed too.\n\n"
    "  glucoloop patients\n\n"
    "  glucoloop run --patient hovorka-2004"
)
_OPTIONS: Final = (Option("json", "--json", bool, "Print one JSON object.", "Output"),)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Print a description of each patient."""
    entries = [patient_entry(name) for name in patient_names()]
    if given.get("json"):
        from glucoloop.storage.strict_json import json_text, with_version

        print(json_text(with_version({"patients": [_plain(entry) for entry in entries]})))
        return
    print("\n\n".join("\n".join(_lines(entry)) for entry in entries))


def _plain(entry: PatientEntry) -> dict[str, Any]:
    return {
        "name": entry.name,
        "summary": entry.summary,
        "operating_points": {point.name: point.summary for point in entry.operating_points},
        "populations": {NOMINAL: "the nominal patient, whoever is drawn", **entry.populations},
        "max_change_mU_min": entry.max_change_mU_min,
        "min_insulin_mU_min": entry.min_insulin_mU_min,
        "max_insulin_mU_min": entry.max_insulin_mU_min,
        "pulse_mU_min": entry.pulse_mU_min,
        "memory_min": entry.memory_min,
        "laguerre_pole": entry.laguerre_pole,
        "laguerre_functions": entry.laguerre_functions,
    }


def _lines(entry: PatientEntry) -> Iterator[str]:
    told = _plain(entry)
    yield f"{entry.name}: {entry.summary}"
    for key, what in (("operating_points", "Operating point"), ("populations", "Population")):
        for name, summary in told[key].items():
            yield f"  {what} {name}: {summary}"
    yield (
        f"  Usual pump: {entry.min_insulin_mU_min:g} to {entry.max_insulin_mU_min:g} mU/min, changed by at most "
        f"{entry.max_change_mU_min:g} mU/min from one sample to the next"
    )
    yield (
        f"  Usual identification: pulses of {entry.pulse_mU_min:g} mU/min, a memory of {entry.memory_min:g} min, "
        f"{entry.laguerre_functions} Laguerre functions with a pole of {entry.laguerre_pole:g} at 5-min samples"
    )
