"""The thirty people of the simulator of 2008, read from an installed simglucose.

Their constants come with the package simglucose 0.2.11, and none of them is in this one. Each rests at a glucose of
their own under a basal rate of their own; the package also has the carbohydrate that a unit covers, the glucose that it
lowers, and the total of a day.
"""

from __future__ import annotations

import csv
import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.patients.dalla_man.patient import DallaManPatient
from glucoloop.refusal import Refusal
from glucoloop.units import MU_MIN_PER_PMOL_MIN

Values = npt.NDArray[np.float64]

COLUMNS: Final = {
    "BW": "BW", "V_G": "Vg", "k_1": "k1", "k_2": "k2", "V_I": "Vi", "m_1": "m1", "m_2": "m2", "m_4": "m4",
    "HE_b": "HEb", "k_p1": "kp1", "k_p2": "kp2", "k_p3": "kp3", "k_i": "ki", "F_cns": "Fsnc", "V_m0": "Vm0",
    "V_mx": "Vmx", "K_m0": "Km0", "p_2U": "p2u", "I_b": "Ib", "k_e1": "ke1", "k_e2": "ke2", "k_a1": "ka1",
    "k_a2": "ka2", "k_d": "kd", "k_sc": "ksc", "k_max": "kmax", "k_min": "kmin", "k_abs": "kabs", "b": "b", "d": "d",
    "f": "f",
}  # fmt: skip
"""Column of the package's table for each constant of the patient."""


@dataclass(frozen=True)
class NamedPeople:
    """People of a table, in its order."""

    name: tuple[str, ...]
    constants: dict[str, Values]
    """(people,) each constant of `DallaManPatient`."""
    basal_insulin_mU_min: Values
    setpoint_mg_dl: Values
    carbs_ratio_g_U: Values
    """Carbohydrate that a unit of insulin covers."""
    correction_factor_mg_dl_U: Values
    """Glucose that a unit of insulin lowers."""
    daily_insulin_U: Values

    def patient(self, *names: str) -> DallaManPatient:
        """One person as a patient, or several, all by default, who trail.

        Raises
        ------
        Refusal
            For a name that is not in the table.
        """
        for name in names:
            if name not in self.name:
                raise Refusal(f"simglucose has nobody called {name!r}; its people are: {', '.join(self.name)}")
        rows = [self.name.index(name) for name in names or self.name]
        at = rows[0] if len(names) == 1 else rows
        return DallaManPatient(
            parameters={name: jnp.asarray(values[at]) for name, values in self.constants.items()},
            basal_insulin_mU_min=jnp.asarray(self.basal_insulin_mU_min[at]),
            setpoint_mg_dl=jnp.asarray(self.setpoint_mg_dl[at]),
        )


def people_of_simglucose(folder: Path | None = None) -> NamedPeople:
    """The thirty people of simglucose, ten adolescents, ten adults and ten children.

    Parameters
    ----------
    folder : Path, optional
        Folder of the package simglucose; by default that of the installed one.

    Raises
    ------
    Refusal
        If simglucose is not installed.
    """
    if folder is None:
        found = importlib.util.find_spec("simglucose")
        if found is None or not found.submodule_search_locations:
            raise Refusal(
                "the people of the UVA/Padova simulator of 2008 are read from simglucose, which is not installed; "
                "install it with: pip install --no-deps simglucose==0.2.11"
            )
        folder = Path(found.submodule_search_locations[0])
    people, quest = (_rows(folder / "params" / name) for name in ("vpatient_params.csv", "Quest.csv"))
    names = tuple(people)

    def column(rows: dict[str, dict[str, str]], name: str) -> Values:
        return np.array([float(rows[person][name]) for person in names])

    # u2ss is in pmol/kg/min
    basal = column(people, "u2ss") * column(people, "BW") * MU_MIN_PER_PMOL_MIN
    return NamedPeople(
        name=names,
        constants={constant: column(people, name) for constant, name in COLUMNS.items()},
        basal_insulin_mU_min=basal,
        setpoint_mg_dl=column(people, "Gb"),
        carbs_ratio_g_U=column(quest, "CR"),
        correction_factor_mg_dl_U=column(quest, "CF"),
        daily_insulin_U=column(quest, "TDI"),
    )


def _rows(path: Path) -> dict[str, dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return {row["Name"]: row for row in csv.DictReader(file)}
