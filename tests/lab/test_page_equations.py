"""A patient that is given by its equations alone, on the page: carried there by the explicit integrator."""

import json
from pathlib import Path

import numpy as np
import pytest

import glucoloop as gl
from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import surroundings_of
from glucoloop.lab import build
from glucoloop.lab.build import _functions
from glucoloop.lab.page_data import numbers
from glucoloop.lab.patient_functions import GRID
from glucoloop.native.interpreter import Interpreter
from glucoloop.native.targets.wasm import _linker_path
from glucoloop.simulation.plant import Exogenous
from page_loops import run_of

EXAMPLES = Path(__file__).parents[2] / "examples"
FAMILY = ("bergman:Minimal",)
LINKS = [
    "#controller=pid&meals=60g@47min",
    "#controller=mpc&guard=usual&sensor=dexcom-g6&seed=2",
    "#controller=mpc-se&sensor=white-noise,+variance=1.45&faults=occlusion,+start_min=100,+duration_min=60",
    "#controller=imc&meals=&sensor=dead-time,+minutes=5",
]
OF_THE_PAGE = [
    "#controller=pid&meals=60g@47min&meals=20g@2h&meals=30g@121min",
    "#controller=mpc&sensor=dexcom-g6&seed=2",
    "#controller=mpc-se&guard=usual&meals=90g@30min&duration_min=1440",
]
"""Loops of the families that are on the page: a meal within what is left of another one among them."""
CLOSE_MG_DL = 1e-4
"""A part in 10^6, to which the page's models are those of a fit on another processor."""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Functions and numbers of the page for the example, and the folder with them."""
    if _linker_path() is None:
        pytest.skip("needs wasm-ld (Debian: apt install lld)")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXAMPLES))
        of_page, data = _functions(FAMILY), numbers(FAMILY)
        folder = tmp_path_factory.mktemp("built")
        (folder / "lab.wasm").write_bytes(build._module(of_page))
        (folder / "lab.json").write_text(json.dumps({"functions": build._layout(of_page), **data}))
        yield folder, of_page, data


@pytest.mark.long
def test_a_run_of_equations_is_that_of_the_page(page, in_node):
    folder, _, data = page
    patient = f"patient={FAMILY[0]}"
    for answer in in_node([f"#{patient}&{link[1:]}" for link in LINKS], folder):
        assert "refused" not in answer, answer["refused"]
        run = run_of(answer["toml"])
        trace = close_loop(run, controller_of(run, run.case), run.as_scenario(), surroundings=surroundings_of(run))
        found = np.array(answer["trace"]["fine_glucose_mg_dl"])
        np.testing.assert_allclose(found, trace.fine_glucose_mg_dl, rtol=0.0, atol=CLOSE_MG_DL)
        assert np.ptp(found) > 1.0 or not answer["situation"]["meals"]
    assert data["people"] == {}


@pytest.mark.long
@pytest.mark.parametrize("link", OF_THE_PAGE)
@pytest.mark.parametrize("family", ["kanderian-2009", "uva-padova-2008"])
def test_a_run_of_a_family_of_the_page_is_that_of_glucoloop(family, link, in_node):
    [answer] = in_node([f"#patient={family}&{link[1:]}"])
    run = run_of(answer["toml"])
    trace = close_loop(run, controller_of(run, run.case), run.as_scenario(), surroundings=surroundings_of(run))
    found = np.array(answer["trace"]["fine_glucose_mg_dl"])
    np.testing.assert_allclose(found, trace.fine_glucose_mg_dl, rtol=0.0, atol=CLOSE_MG_DL)
    assert np.ptp(found) > 10.0
    assert f"--patient {family} " in answer["command"]
    assert answer["again"]["situation"] == answer["situation"]


@pytest.mark.long
def test_the_functions_of_equations_are_steps_of_the_explicit_integrator(page):
    _, of_page, data = page
    person = gl.patient(FAMILY[0])
    plant = of_page["bergman_Minimal_plant"]
    [family], steps = data["families"].values(), round(GRID.sample_time_min / data["families"][FAMILY[0]]["step_min"])
    x, step = np.asarray(person.steady_state(person.basal_insulin_mU_min))[:, None], Interpreter(plant.lowered)
    inside = []
    for number in range(steps):
        x, outputs = step(
            person=np.zeros((0, 1)), carry=x, own=np.array([[40.0], [0.0], [0.0], [0.0]]), shared=np.zeros((1, 1))
        )
        inside += [outputs[1 + place, 0] for at, place in family["inside"] if at == number]
    alone, _ = gl.Explicit().prepare(person, gl.meals.fasting(), GRID)
    there = Exogenous(t_min=np.zeros(()), moments=np.zeros((steps, 3)))
    end, expected = alone.advance(person.steady_state(person.basal_insulin_mU_min), np.asarray(40.0), there)
    np.testing.assert_allclose(x[:, 0], end, rtol=1e-12)
    np.testing.assert_allclose(inside, expected, rtol=1e-12)
