"""The thirty people of the simulator of 2008, read from an installed simglucose.

Their constants come with the package simglucose 0.2.11, and none of them is in this one. The package also has the
glucose at which each person rests with the basal rate that holds it, the carbohydrate that a unit covers, the glucose
that it lowers, and the total of a day, which are the profile of the person.
"""

from __future__ import annotations

import csv
import functools
import importlib.util
from pathlib import Path
from typing import Final

from glucoloop.patients.catalogue import PATIENTS
from glucoloop.patients.population import Population
from glucoloop.patients.table import PeopleTable
from glucoloop.refusal import missing
from glucoloop.units import MU_MIN_PER_PMOL_MIN

NAME: Final = "simglucose"
"""Name of the package and of the population."""
COLUMNS: Final = {
    "weight_kg": "BW", "V_G": "Vg", "k_1": "k1", "k_2": "k2", "V_I": "Vi", "m_1": "m1", "m_2": "m2", "m_4": "m4",
    "HE_b": "HEb", "k_p1": "kp1", "k_p2": "kp2", "k_p3": "kp3", "k_i": "ki", "F_cns": "Fsnc", "V_m0": "Vm0",
    "V_mx": "Vmx", "K_m0": "Km0", "p_2U": "p2u", "I_b": "Ib", "k_e1": "ke1", "k_e2": "ke2", "k_a1": "ka1",
    "k_a2": "ka2", "k_d": "kd", "k_sc": "ksc", "k_max": "kmax", "k_min": "kmin", "k_abs": "kabs", "b": "b", "d": "d",
    "f": "f",
}  # fmt: skip
"""Column of the package's table for each constant of the patient."""
_QUESTIONNAIRE: Final = {"carb_ratio_g_U": "CR", "correction_mg_dl_U": "CF", "total_daily_dose_U": "TDI"}


def people_of_simglucose(patient: str) -> Population:
    """Population of the thirty people around a patient of the family: ten adolescents, ten adults and ten children.

    Raises
    ------
    MissingExtraError
        If simglucose is not installed.
    """
    # it is found without being imported, which takes seconds and an old gym
    result = importlib.util.find_spec(NAME)
    if result is None or not result.submodule_search_locations:
        raise missing(f"the population {NAME} of {patient}", NAME)
    table = _table(Path(result.submodule_search_locations[0]) / "params")
    return Population(NAME, (), PATIENTS[patient].populations[NAME], patient, table)


@functools.cache
def _table(folder: Path) -> PeopleTable:
    people, questionnaire = (_rows(folder / name) for name in ("vpatient_params.csv", "Quest.csv"))

    def column(rows: dict[str, dict[str, str]], name: str) -> tuple[float, ...]:
        return tuple(float(rows[person][name]) for person in people)

    # u2ss is in pmol/kg/min
    per_kg, weight = column(people, "u2ss"), column(people, "BW")
    basal = tuple(rate * kg * MU_MIN_PER_PMOL_MIN for rate, kg in zip(per_kg, weight, strict=True))
    return PeopleTable(
        names=tuple(people),
        values={constant: column(people, name) for constant, name in COLUMNS.items()},
        profile={
            "basal_mU_min": basal,
            "setpoint_mg_dl": column(people, "Gb"),
            **{field: column(questionnaire, name) for field, name in _QUESTIONNAIRE.items()},
        },
    )


def _rows(path: Path) -> dict[str, dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return {row["Name"]: row for row in csv.DictReader(file)}
