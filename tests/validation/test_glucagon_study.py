"""A published study of glucagon on virtual people: the page's table, within what was printed, and its own means."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import glucagon_study as study
from glucoloop.patients import Inputs

PAGE = Path(__file__).parents[2] / "docs/guide/glucagon.md"


@pytest.mark.long
def test_the_table_of_the_page_is_within_what_was_printed():
    carried_out = study.carried_out(study.people_of_study(200, 4100, 120.0 / study.MG_DL_PER_MMOL_L))
    assert "\n".join(study.rows(carried_out)) in PAGE.read_text()
    for dose, printed in study.RISES.items():
        peak = carried_out.peak_mmol_l[dose].mean()
        assert study.PEAKS[dose].low <= peak <= study.PEAKS[dose].high
        assert printed.low <= peak - study.AT_MMOL_L <= printed.high


@pytest.mark.long
def test_a_person_of_the_study_is_the_solution_of_another_integrator():
    people = study.people_of_study(3, 11, 7.0)
    carried_out = study.carried_out(people, lowest_mmol_l=3.0)
    person, volume_l = 1, float(people.patient.parameters.glucose_volume_l[1])
    one = people.at(np.array([person]))

    def rate(t, x):
        inputs = Inputs(insulin_mU_min=one.basal_insulin_mU_min, meal_mg_min=np.zeros(1))
        return np.asarray(one.patient.derivative(0.0, x[:, None], inputs))[:, 0]

    def glucose(x, minutes):
        solution = solve_ivp(rate, (0.0, minutes), x, method="LSODA", rtol=1e-9, atol=1e-9, max_step=1.0)
        return solution.y[0] / volume_l, solution.y[:, -1]

    x = one.rest[:, 0].copy()
    x[study.INSULIN_DEPOT] += 1000.0 * carried_out.bolus_U[person]
    course, _ = glucose(x, study.FALL_MIN)
    assert course.min() == pytest.approx(3.0, abs=1e-3)
    _, x = glucose(x, carried_out.waited_min[person])
    assert x[0] / volume_l == pytest.approx(3.4, abs=0.05)  # the state is that of the next half minute
    x[study.GLUCAGON_DEPOT] += 200.0
    course, _ = glucose(x, study.FOLLOWED_MIN)
    assert carried_out.peak_mmol_l[200.0][person] == pytest.approx(course.max(), abs=1e-3)
