"""Percentiles, fates and points of people are what NumPy makes of their glucose."""

import json
import shutil
import subprocess

import numpy as np
import pytest

from glucoloop.build.designs import controller_of
from glucoloop.lab.pack import DATA, MODULE, PAGE
from glucoloop.lab.patient_functions import people_of, situation
from glucoloop.lab.people import with_people
from glucoloop.patients import virtual_people
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.patients.population import draw, of_people
from glucoloop.refusal import Refusal
from glucoloop.simulation import simulate
from glucoloop.situations.case import default_case
from glucoloop.situations.population import named_population
from glucoloop.therapy import given_profile
from glucoloop.threefry import name_word, uniforms

NODE = shutil.which("node")
DRAWN = ("parker-1999", "hovorka-2004", "wilinska-2010")
"""Families around whom the page draws people: those that are given by more than their equations."""
SCRIPT = """
import { readFileSync } from "node:fs";
const { Crowd, RULE } = await import(process.argv[1]);
const { inside, insulin } = JSON.parse(readFileSync(0, "utf8"));
const [samples, people] = [insulin.length, insulin[0].length];
const crowd = new Crowd(people, samples, 5);
for (let p = 0; p < people; p++)
  for (let k = 0; k < samples; k++) {
    const before = k === 0 ? 100 : inside[k - 1][p][4];
    crowd.add(p, k, before, inside[k][p], insulin[k][p]);
  }
const fates = Array.from({ length: people }, (_, p) => crowd.fate(p));
const found = { RULE, fates, percentiles: crowd.percentiles("pid"), worst: crowd.worst(3), score: crowd.score() };
console.log(JSON.stringify(found));
"""


@pytest.mark.skipif(NODE is None, reason="needs node")
def test_what_happened_to_people(tmp_path):
    rng = np.random.default_rng(5)
    samples, people = 30, 17
    inside = 100.0 + np.cumsum(rng.normal(0.0, 8.0, (samples, people, 5)), axis=0)
    insulin = rng.uniform(0.0, 60.0, (samples, people))
    done = subprocess.run(
        [NODE, "--input-type=module", "-e", SCRIPT, (PAGE / "crowd.mjs").as_uri()],
        input=json.dumps({"inside": inside.tolist(), "insulin": insulin.tolist()}),
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    found = json.loads(done.stdout)
    fine = np.concatenate([np.full((1, people), 100.0), inside.transpose(0, 2, 1).reshape(-1, people)])
    expected = {
        "lowest_mg_dl": fine.min(axis=0),
        "highest_mg_dl": fine.max(axis=0),
        "in_range_pct": 100.0 * np.mean((fine >= 70.0) & (fine <= 180.0), axis=0),
        "below_70_pct": 100.0 * np.mean(fine < 70.0, axis=0),
        "change_mU_min": np.mean(np.abs(np.diff(insulin, axis=0)), axis=0),
    }
    for name, values in expected.items():
        np.testing.assert_allclose([fate[name] for fate in found["fates"]], values, rtol=1e-12, err_msg=name)
    at_samples = np.concatenate([np.full((1, people), 100.0), inside[:, :, 4]])
    levels = np.percentile(at_samples, [5, 25, 50, 75, 95], axis=1)
    np.testing.assert_allclose(found["percentiles"]["levels"], levels, rtol=1e-6)
    assert found["percentiles"]["t_min"] == [5.0 * k for k in range(samples + 1)]
    order = np.argsort(expected["lowest_mg_dl"])[:3]
    assert [fate["person"] for fate in found["worst"]] == order.tolist()
    mean = {name: float(np.mean(values)) for name, values in expected.items()}
    rule, score = found["RULE"], found["score"]
    lost = sum(weight * mean[name] for name, weight in rule.items())
    assert score["points"] == pytest.approx(mean["in_range_pct"] - lost)
    assert score["people_below_70"] == np.sum(expected["lowest_mg_dl"] < 70.0)
    assert score["people_below_54"] == np.sum(expected["lowest_mg_dl"] < 54.0)


JOINED = """
const { Crowd } = await import(process.argv[1]);
const { uniform } = await import(process.argv[2]);
const [whole, part] = [new Crowd(5, 3, 5), new Crowd(2, 3, 5)];
const glucose = (person, k) => 60 + 7 * person + 20 * k;
for (const [crowd, first] of [[whole, 0], [part, 2]])
  for (let person = 0; person < crowd.people; person++)
    for (let k = 0; k < 3; k++) {
      const [now, next] = [glucose(first + person, k), glucose(first + person, k + 1)];
      crowd.add(person, k, now, [next], k * (first + person));
    }
const joined = new Crowd(5, 3, 5);
joined.join(part, 2);
const fates = (crowd) => [2, 3].map((person) => crowd.fate(person));
const of = (crowd) => ({ fates: fates(crowd), glucose: [2, 3, 12, 13, 17].map((i) => crowd.glucose[i]) });
const words = [[0, 2320734002, 0], [7, 10598100, 4294967295], [4294967295, 3625609037, 999]];
console.log(JSON.stringify({ whole: of(whole), joined: of(joined), drawn: words.map((of) => uniform(...of)) }));
"""


@pytest.mark.skipif(NODE is None, reason="needs node")
def test_parts_join_and_people_are_drawn_as_in_python():
    modules = [(PAGE / name).as_uri() for name in ("crowd.mjs", "threefry.mjs")]
    command = [NODE, "--input-type=module", "-e", JOINED, *modules]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout)
    assert found["joined"] == found["whole"]
    names = {name_word(f"parameter {name}"): name for name in people_of(DRAWN[0]).distributions()}
    asked = ((0, 2320734002, 0), (7, 10598100, 4294967295), (4294967295, 3625609037, 999))
    expected = [uniforms(seed, f"parameter {names[word]}", [person])[0] for seed, word, person in asked]
    assert found["drawn"] == expected


@pytest.mark.long
@pytest.mark.parametrize("controller", ["pid", "mpc-se"])
@pytest.mark.parametrize("family", DRAWN)
def test_the_people_of_the_page_are_those_of_a_trial(in_node, family, controller):
    chosen = [3, 18, 9997]
    link = f"#patient={family}&controller={controller}&duration_min=600"
    found = in_node([{"link": link, "person": person} for person in chosen])
    people = virtual_people(people_of(family), 0, chosen)
    around = situation(family, PATIENTS[family].default_operating_point)
    designed = controller_of(around, default_case(controller, around))
    for place, answer in enumerate(found):
        basal = float(people.basal_insulin_mU_min[place])
        assert answer["basal_insulin_mU_min"] == pytest.approx(basal, rel=1e-9)
        assert answer["glucose_mg_dl"] == pytest.approx(float(around.nominal.setpoint_mg_dl), abs=1e-9)
        np.testing.assert_allclose(answer["x"], people.rest[:, place], rtol=1e-9, atol=1e-9)
        trace = simulate(of_people(people.patient, place), given_profile(designed, of_people(people.profile, place)))
        expected = np.asarray(trace.fine_glucose_mg_dl)
        np.testing.assert_allclose(answer["trace"]["fine_glucose_mg_dl"], expected, rtol=0.0, atol=0.02)


@pytest.mark.long
@pytest.mark.skipif(NODE is None, reason="needs node")
@pytest.mark.parametrize("family", DRAWN)
def test_whom_no_rate_holds_is_left_out(in_node, family):
    drawn = 200
    feasible = virtual_people(people_of(family), 0, range(drawn)).feasible
    link = f"#patient={family}&controller=pid&duration_min=60"
    one_by_one = in_node([{"link": link, "person": person} for person in range(drawn)])
    assert [not answer.get("absent", False) for answer in one_by_one] == feasible.tolist()
    [crowd] = in_node([{"link": link, "people": drawn}])
    assert crowd["score"]["people"] == feasible.sum()
    lowest = [min(answer["trace"]["fine_glucose_mg_dl"]) for answer in one_by_one if not answer.get("absent")]
    assert crowd["worst"][0]["lowest_mg_dl"] == min(lowest)
    at_end = [answer["trace"]["fine_glucose_mg_dl"][-1] for answer in one_by_one if not answer.get("absent")]
    levels = np.percentile(at_end, [5, 25, 50, 75, 95])
    np.testing.assert_allclose([level[-1] for level in crowd["percentiles"]["levels"]], levels, rtol=1e-6)


def test_people_are_drawn_around_families_that_are_more_than_equations(data):
    assert tuple(data["people"]) == DRAWN


@pytest.mark.skipif(NODE is None, reason="needs node")
def test_people_of_a_file_are_those_of_a_trial_with_that_file(in_node, tmp_path):
    names = list(people_of("hovorka-2004").distributions())
    drawn = draw(people_of("hovorka-2004"), 5, [1, 2, 3]).values
    rows = [f"P{i}," + ",".join(repr(float(drawn[name][i])) for name in names) for i in range(3)]
    file = tmp_path / "three.csv"
    file.write_text("\n".join(["name," + ",".join(names), *rows]))
    data = with_people(json.loads(DATA.read_text()), "hovorka-2004", str(file))
    (tmp_path / DATA.name).write_text(json.dumps(data))
    shutil.copy(MODULE, tmp_path)
    link = "#patient=hovorka-2004&controller=pid&duration_min=60"
    asked = [{"link": link, "person": person} for person in range(3)]
    *found, crowd = in_node([*asked, {"link": link, "people": 3}], tmp_path)
    people = virtual_people(named_population(str(file), "hovorka-2004"), 0, range(3))
    for place, answer in enumerate(found):
        assert answer["basal_insulin_mU_min"] == pytest.approx(float(people.basal_insulin_mU_min[place]), rel=1e-9)
        np.testing.assert_allclose(answer["x"], people.rest[:, place], rtol=1e-9, atol=1e-9)
    assert "--population three.csv" in crowd["command"]
    assert str(tmp_path) not in json.dumps(data)
    assert data["open"].endswith("patient=hovorka-2004")


def test_people_whom_the_page_cannot_have_are_refused(tmp_path):
    data = json.loads(DATA.read_text())
    with pytest.raises(Refusal, match=r"the page has no people around kanderian-2009; give --patient parker-1999, "):
        with_people(data, "kanderian-2009", "nominal")
    (tmp_path / "heavy.csv").write_text("name,weight_kg\nA,70\n")
    with pytest.raises(Refusal, match=r"differ in weight_kg; people of the page differ in weight_kg, A_G, "):
        with_people(data, "hovorka-2004", str(tmp_path / "heavy.csv"))
