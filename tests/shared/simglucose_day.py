"""Days of people of simglucose, run by a Python that can import it: inputs as JSON to stdin, courses as JSON to stdout.

An input is, by the name of the person, what is given in each minute: ``insulin_U_min``, and ``carbs_g`` that is
announced, which simglucose has eaten at 5 g/min. A course is plasma and interstitial glucose at each minute.
"""

import json
import logging
import sys
import types
import warnings

warnings.filterwarnings("ignore")  # gym asks to be replaced
logging.disable(logging.CRITICAL)

from simglucose.patient.t1dpatient import Action, T1DPatient  # noqa: E402


def course(name, insulin_U_min, carbs_g):
    """Glucose at each minute, from the start on."""
    person = T1DPatient.withName(name)
    volume = person._params.Vg
    person._params = types.SimpleNamespace(
        **person._params.to_dict()
    )  # the same numbers, looked up a hundred times faster
    rows = [(person.state[3] / volume, person.state[12] / volume)]
    for insulin, carbs in zip(insulin_U_min, carbs_g, strict=True):
        person.step(Action(CHO=carbs, insulin=insulin))
        rows.append((person.state[3] / volume, person.state[12] / volume))
    return rows


if __name__ == "__main__":
    json.dump({name: course(name, **given) for name, given in json.load(sys.stdin).items()}, sys.stdout)
