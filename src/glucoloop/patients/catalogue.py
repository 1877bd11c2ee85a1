"""The patients by name, and the nominal person of each."""

from __future__ import annotations

from typing import Final

from glucoloop.arguments import checked
from glucoloop.component.catalogue import Catalogue
from glucoloop.patients.component import PatientComponent
from glucoloop.patients.protocol import Patient
from glucoloop.refusal import Refusal


class _Patients(Catalogue[PatientComponent]):
    """The patients; one that is named by its operating point is refused with the mend."""

    def find(self, name: str) -> type[PatientComponent]:
        try:
            entry = super().find(name)
        except Refusal:
            for other in self.values():
                if name in [point.name for point in other.operating_points]:
                    raise Refusal(
                        f"{name!r} is an operating point of {other.name} and no patient; write "
                        f"'{other.name}, operating_point={name}'"
                    ) from None
            raise
        entry.refuse_incomplete()
        return entry


PATIENTS: Final = _Patients(
    PatientComponent,
    {
        "parker-1999": "glucoloop.patients.sorensen.patient:SorensenPatient",
        "hovorka-2004": "glucoloop.patients.hovorka.patient:Hovorka2004",
        "wilinska-2010": "glucoloop.patients.hovorka.patient:Wilinska2010",
        "uva-padova-2008": "glucoloop.patients.dalla_man:DallaManPatient",
        "kanderian-2009": "glucoloop.patients.kanderian:KanderianPatient",
        "roy-parker-2007": "glucoloop.patients.roy_parker2007:RoyParkerPatient",
        "mcgill-2020": "glucoloop.patients.mcgill2020:McGillPatient",
        "wilinska-2010-glucagon": "glucoloop.patients.hovorka.patient:WilinskaGlucagon",
    },
    example="parker-1999, operating_point=nominal-22",
    unnamed=True,
)
DEFAULT_PATIENT: Final = PATIENTS[PATIENTS.default]
patient_entry: Final = PATIENTS.find


@checked
def patient(name: str = "parker-1999", operating_point: str | None = None) -> Patient:
    """A nominal patient at an operating point.

    Parameters
    ----------
    name : str
        ``"parker-1999"`` or another of ``glucoloop list patients``; or ``"module:Class"`` of a `PatientComponent`.
    operating_point : str, optional
        The default one by default. Of ``"parker-1999"``: ``"setpoint-81"``: 81.1 mg/dl, held by 25.606 mU/min;
        ``"nominal-22"``: 22.33 mU/min, holding 92.099 mg/dl; ``"fasting-81"``: 22.33 mU/min, holding 81.153 mg/dl in
        a person whose effects are normalised at a fasting glucose of 81 mg/dl.
    """
    entry = patient_entry(name)
    return entry.at_operating_point(entry.default_operating_point if operating_point is None else operating_point)
