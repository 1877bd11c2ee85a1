"""The page as a file, its links, its texts and the types of its code."""

import base64
import gzip
import hashlib
import itertools
import json
import math
import re
import subprocess
import sys
import urllib.parse

import pytest

from browser import MODULES, NODE, needs_modules
from glucoloop.lab.pack import DATA, MODULE, PAGE, page
from glucoloop.lab.patient_functions import FAMILIES
from glucoloop.native.targets.wasm import _HOST
from glucoloop.pages import PAGES
from glucoloop.patients.catalogue import PATIENTS
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from page_loops import run_of

USUAL = {
    "patient": "parker-1999/setpoint-81",
    "controller": "mpc",
    "tuning": {},
    "guard": False,
    "guard_limits": {},
    "pump_limits": {},
    "faults": [],
    "meals": [{"t_min": 50.0, "carbs_g": 50.0}],
    "noise_variance": 0.0,
    "monitor": None,
    "dead_time_min": 0.0,
    "seed": 0,
    "duration_min": 600.0,
    "announce": False,
    "announce_before_min": 0.0,
    "announced_late_min": 0.0,
}


@pytest.fixture(scope="module")
def text():
    return page()


def packed(text, name):
    found = re.search(rf'<script type="application/octet-stream" id="{name}">([^<]*)</script>', text)
    return gzip.decompress(base64.b85decode(found[1].translate(str.maketrans(",.", "<{"))))


def test_the_file_holds_everything_and_is_the_same_again(text):
    assert packed(text, "module") == MODULE.read_bytes()
    assert packed(text, "data") == DATA.read_bytes()
    assert text == page()
    assert len(text.encode()) <= 500_000
    assert not re.search(r"\{\{[A-Z]+\}\}", text)


def test_every_module_is_in_the_file(text):
    program = packed(text, "code").decode()
    there = re.findall(r'^"([\w-]+)": \(\) => \{$', program, re.M)
    assert sorted(there) == sorted(
        path.stem
        for path in (_HOST, *PAGE.rglob("*.mjs"), *(PAGES / f"{name}.mjs" for name in ("axes", "chart", "csv", "data")))
    )
    assert set(re.findall(r' = need\("([\w-]+)"\);$', program, re.M)) <= set(there)


def test_the_page_has_its_patients_from_the_catalogue(data):
    assert list(data["families"]) == [name for name in PATIENTS if name in FAMILIES]
    assert len(data["families"]) == len(FAMILIES)
    for name, family in data["families"].items():
        assert list(family["points"]) == [point.name for point in PATIENTS[name].operating_points]


def test_every_text_that_the_page_names_is_there_once(text):
    texts = (PAGE / "texts.mjs").read_text(encoding="utf-8")
    of_page = re.search(r"^  page: \{$(.*?)^  \},$", texts, re.M | re.S)[1]
    known = re.findall(r"^    (\w+): ", of_page, re.M)
    named = re.findall(r'data-(?:text|label)="(\w+)"', (PAGE / "lab.html").read_text(encoding="utf-8"))
    assert set(named) == set(known)
    assert len(known) == len(set(known))


def test_nothing_in_the_file_can_reach_the_network(text):
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)[1]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert "connect-src" not in policy
    sources = dict(part.split(maxsplit=1) for part in policy.split("; "))
    ran = [*re.findall(r"<script>(.*?)</script>", text, re.S), packed(text, "code").decode()]
    hashes = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in ran]
    assert sources["script-src"].split() == [*(f"'sha256-{digest}'" for digest in hashes), "'wasm-unsafe-eval'"]
    [style] = re.findall(r"<style>(.*?)</style>", text, re.S)
    assert sources["style-src"] == f"'sha256-{base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()}'"
    assert not re.search(
        r'style\s*=\s*["\'`]|"style"|<style', text.replace("<style>", "", 1) + packed(text, "code").decode()
    )
    assert sources["worker-src"] == "blob:"
    assert not re.search(r'(?:src|href)="(?!data:)', text)
    program = packed(text, "code").decode()
    assert not re.search(r"\b(?:fetch|XMLHttpRequest|WebSocket|EventSource|sendBeacon|importScripts)\b", program)


def test_packing_imports_nothing_that_computes():
    code = (
        "import sys, glucoloop.lab.pack as p; p.page(); print(sorted({'jax', 'numpy', 'llvmlite'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.long
def test_a_link_brings_back_its_situation(in_node, corpus):
    answers = in_node(corpus[:40])
    for answer, again in zip(answers, in_node([answer["hash"] for answer in answers]), strict=True):
        assert answer["again"] == {"situation": again["situation"], "version": "1.2.3"}
        assert again["trace"] == answer["trace"]
        assert again["situation"]["tuning"].items() <= answer["situation"]["tuning"].items()


def test_the_usual_situation_is_that_of_a_run_without_options(in_node):
    [first, empty] = in_node([USUAL, "#"])
    assert first["trace"] == empty["trace"]
    assert run_of(first["toml"]).tree(whole=True) == configured(Run).tree(whole=True)


def low_and_peak(answer):
    return answer["summary"]["minimum_mg_dl"], answer["summary"]["peak_mg_dl"]


def moved(answer):
    rates = answer["trace"]["insulin_mU_min"]
    return sum(abs(b - a) for a, b in itertools.pairwise(rates))


def test_the_lessons_show_what_they_tell(in_node):
    [lessons] = in_node(["lessons"])
    slow, far, late, occluded, _, unannounced, monitored = in_node([lesson["hash"] for lesson in lessons[:7]])
    others = (
        "#controller=pid,+closed_loop_min=10",
        "#controller=prediction_horizon=3",
        "#controller=move_weight=5",
        "#",
    )
    quick, near, weighted, usual = in_node(others)
    [calmer] = in_node(["#controller=mpc,+move_weight=8&sensor=dead-time,+minutes=10"])
    assert [round(value) for value in low_and_peak(slow)] == [64, 119]
    assert low_and_peak(quick)[0] > 70.0
    assert low_and_peak(quick)[1] < 100.0
    assert low_and_peak(far)[1] > low_and_peak(near)[1]
    assert low_and_peak(weighted)[0] < 50.0
    [bare] = in_node([lessons[3]["beside"]["hash"]])
    assert [round(low_and_peak(answer)[1]) for answer in (bare, occluded)] == [237, 237]
    assert round(low_and_peak(bare)[0]) == 63
    assert low_and_peak(occluded)[0] > 79.0
    [people] = in_node([{"link": lessons[4]["hash"], "people": lessons[4]["people"]}])
    assert lessons[4]["people"] == 100
    assert people["score"]["people_below_70"] == 35
    assert low_and_peak(usual)[0] > 70.0
    assert moved(late) > 5.0 * moved(usual) > moved(calmer)
    assert low_and_peak(calmer)[0] < low_and_peak(late)[0]
    meal = "&meals=90g%4060min"
    state, guarded = in_node([f"#controller=mpc-se{meal}", f"#controller=pid,+closed_loop_min=60&guard=usual{meal}"])
    assert round(low_and_peak(unannounced)[0]) == 53
    assert low_and_peak(state)[0] > 77.0
    assert low_and_peak(guarded)[0] > 70.0
    assert round(low_and_peak(guarded)[1]) == 121
    of_monitor = lessons[6]["hash"]
    assert "dexcom-g6" in of_monitor
    [exact] = in_node([lessons[6]["beside"]["hash"]])
    parts_off = ("noise=false,+drift=false", "lag_min=0,+drift=false", "lag_min=0,+noise=false")
    links = [of_monitor.replace("worn_min", f"{off},+worn_min") for off in parts_off]
    lag, noise, drift, predictive = in_node([*links, of_monitor.replace("pid", "mpc")])
    assert low_and_peak(exact)[0] > 87.0
    assert [round(low_and_peak(answer)[0]) for answer in (monitored, lag, noise, drift)] == [72, 80, 78, 86]
    assert round(moved(noise) / moved(exact)) == 9
    assert moved(predictive) < 0.5 * moved(monitored)
    assert low_and_peak(predictive)[0] > 79.0


@pytest.mark.long
def test_the_lessons_on_boluses_show_what_they_tell(in_node):
    [lessons] = in_node(["lessons"])
    feedback, before, guarded = in_node([lesson["hash"] for lesson in lessons[7:]])
    at_once, with_meal, bare = in_node([lesson["beside"]["hash"] for lesson in lessons[7:]])
    assert low_and_peak(feedback)[1] > 240.0
    assert low_and_peak(at_once)[1] < 220.0
    by_others = [lessons[7]["hash"].replace("profile-mpc", name) for name in ("pid", "mpc")]
    assert all(low_and_peak(answer)[1] > 280.0 for answer in in_node(by_others))
    earlier = lessons[8]["hash"]
    late = earlier.replace("announce_before_min=15", "habits=announced-late,+minutes=20")
    after, missed = in_node([late, earlier.partition("&announce")[0] + earlier[earlier.index("&sensor") :]])
    peaks = [low_and_peak(answer)[1] for answer in (before, with_meal, after, missed)]
    assert [round(peak) for peak in peaks] == [194, 214, 240, 290]
    told = earlier.replace("basal-bolus", "profile-mpc")
    by_model = in_node([told, told.replace("announce_before_min=15", "habits=announced-late,+minutes=-15")])
    assert [round(low_and_peak(answer)[1]) for answer in by_model] == [172, 181]
    assert [round(low_and_peak(answer)[1]) for answer in (bare, guarded)] == [243, 257]
    assert [max(answer["trace"]["bolus_mU"]) for answer in (bare, guarded)] == pytest.approx([4600.0, 4000.0])
    smaller = [lesson.replace("120g", "60g") for lesson in (lessons[9]["hash"], lessons[9]["beside"]["hash"])]
    boluses = [answer["trace"]["bolus_mU"] for answer in in_node(smaller)]
    assert boluses[0] == boluses[1]


def test_each_preset_is_a_situation_of_its_own(in_node):
    [presets] = in_node(["presets"])
    answers = in_node([preset["hash"] for preset in presets])
    assert len({json.dumps(answer["situation"]) for answer in answers}) == len(presets) > 5
    for answer in answers:
        assert answer["summary"]["minimum_mg_dl"] > 60.0


CHOOSE = """
import { readFileSync } from "node:fs";
const { checked, usual, withPatient } = await import(process.argv[1]);
const data = JSON.parse(readFileSync(process.argv[2], "utf8"));
const set = { ...usual(data), controller: "imc", tuning: { filter_min: 3 }, pump_limits: { max_insulin_mU_min: 50 } };
const chosen = [
  withPatient(set, "hovorka-2004", undefined, data),
  withPatient(set, "parker-1999", "fasting-81", data),
  withPatient(usual(data), "wilinska-2010", "fasting-120", data),
];
for (const { situation } of chosen) checked(situation, data);
console.log(JSON.stringify(chosen));
"""


@pytest.mark.skipif(NODE is None, reason="needs node (Debian: apt install nodejs)")
def test_what_was_set_for_a_patient_of_another_model_does_not_stay():
    command = [NODE, "--input-type=module", "-e", CHOOSE, (PAGE / "situation.mjs").as_uri(), DATA]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    other, point, nothing_set = json.loads(done.stdout)
    assert other["reset"] == ["tuning", "pump_limits"]
    assert other["situation"] == {**USUAL, "patient": "hovorka-2004/fasting-120", "controller": "imc"}
    assert point["reset"] == nothing_set["reset"] == []
    assert point["situation"]["tuning"] == {"filter_min": 3}
    assert point["situation"]["patient"] == "parker-1999/fasting-81"
    assert nothing_set["situation"] == {**USUAL, "patient": "wilinska-2010/fasting-120"}


LINKS = {
    "#controller=fuzzy": "the controller is 'fuzzy'; the known ones are: pid, imc, mpc, mpc-se",
    "#patient=parker-1999,+operating_point=__proto__": (
        "the operating point of parker-1999 is '__proto__'; the known ones are: setpoint-81"
    ),
    "#patient=constructor": "the patient is 'constructor'; the known ones are: parker-1999, hovorka-2004, wilin",
    "#patient=hovorka-2004,+operating_point=setpoint-81": (
        "the operating point of hovorka-2004 is 'setpoint-81'; the known ones are: fasting-120"
    ),
    "#controller=mpc,+prediction_horizon=30": "prediction horizon is 30; give a whole number from 3 to 24",
    "#duration_min=12345": "the length is 12345 min; give a multiple of 5 min from 30 to 1440 min",
    "#duration_min=601": "the length is 601 min; give a multiple of 5 min",
    "#meals=50": "a meal is '50'; write it like 50g@60min",
    "#meals=1..5g@3min": "a meal is '1..5g@3min'; write it like 50g@60min",
    "#meals=50g@600min": "the time of a meal is 600 min; give from 0 to 599 min",
    "#" + "&".join(["meals=5g@5min"] * 13): "13 meals are too many; give at most 12",
    "#seed=1e400": "the seed is Infinity; give a whole number from 0 to 9",
    "#patient=3": "the patient is '3'; the known ones are: parker-1999",
    "#seed=0x1": "the seed is 0x1; give a whole number from 0 to 9",
    "#guard=yes": 'it has guard.name = "yes", which this page cannot simulate',
    "#controller=horizon=3": "it has controller.horizon = 3, which this page cannot simulate",
    "#constructor=3": "it has constructor = 3, which this page cannot simulate",
    "#controller=pid,+3": "'pid, 3' is no part; write it like 'mpc, move_weight=2'",
    "#sensor=lag": "it has the sensor lag, which this page cannot simulate",
    "#sensor=dead-time&sensor=white-noise": "it has the sensor white-noise, which this page cannot simulate",
    "#faults=missing,+per_day=3": "it has the fault missing, per_day=3, which this page cannot simulate",
    "#pump=resolution": 'it has pump.name = "resolution", which this page cannot simulate',
    "#guard=max_on_board=many": "max on board is many; give from 0 to 6",
    "#controller=move_horizon=9": "move horizon is 9; give a whole number from 1 to 8",
    "#controller=move_horizon=4,+prediction_horizon=3": (
        "a prediction horizon of 3 is not possible with a move horizon of 4"
    ),
    "#patient=hovorka-2004&controller=prediction_horizon=29": (
        "a prediction horizon of 29 samples sees less than 5 % of the gain of insulin; a controller that sees so "
        "little gives far too much or too little, so give a prediction horizon of 30 or more"
    ),
    "#patient=hovorka-2004&controller=prediction_horizon=29.5": (
        "prediction horizon is 29.5; give a whole number from 30 to 48"
    ),
    "#controller=pid,+derivative_time_min=-0.5": "a derivative time of -0.5 min is not possible; give 0 or more, or -1",
    "#sensor=white-noise,+variance=-1": "the variance of the noise is -1 (mg/dl)²; give from 0 to 900",
    "#sensor=dead-time,+minutes=7": "the dead time is 7 min; give a multiple of 5 min from 0 to 60 min",
    "#model=noise_variance=1.45": "it has model.noise_variance = 1.45, which this page cannot simulate",
}


VALUES = ("1", "-1", "1e999", "true", '"x"', "[]", "[[1]]", "{ a = 1 }", "[{ name = 1 }]", "null")
KEYS = ("patient", "controller", "guard", "sensor", "faults", "habits", "seed", "announce_meals", "used", "__proto__")


def test_any_configuration_in_a_link_is_read_or_refused_in_a_sentence(in_node):
    """An error of another kind ends the answers, and the page would stay empty."""
    forms = ("{key} = {value}", "[{key}]\nx = {value}", "{key} = 1\n[[{key}]]\nx = {value}", "[{key}.x]\na = {value}")
    texts = [form.format(key=key, value=value) for form in forms for key in KEYS for value in VALUES]
    links = [f"#configuration={urllib.parse.quote(text)}" for text in texts]
    answers = dict(zip(texts, in_node(links), strict=True))
    assert all("refused" in answer or answer["situation"]["announce"] in (True, False) for answer in answers.values())
    for text in ("patient = 1\n[[patient]]\nx = 1", "[__proto__]\nx = 1", "[__proto__.x]\na = 1", "seed = 1e999"):
        assert "which this page cannot read" in answers[text]["refused"]


def test_nonsense_in_a_link_is_refused_in_a_sentence(in_node):
    for (link, told), answer in zip(LINKS.items(), in_node(list(LINKS)), strict=True):
        assert told in answer.get("refused", "nothing was refused"), link


@pytest.mark.skipif(NODE is None, reason="needs node (Debian: apt install nodejs)")
def test_the_exponential_is_that_of_python():
    points = [0.0, *(-(1.07**k) for k in range(-200, 90)), 3.0, 700.0]
    code = (
        f'import {{ exponential, power }} from "{(PAGE / "exact.mjs").as_uri()}";'
        f"console.log(JSON.stringify([{points}.map(exponential), power(0.97, 24), power(0, 0)]));"
    )
    done = subprocess.run([NODE, "--input-type=module", "-e", code], capture_output=True, text=True, check=True)
    found, *powers = json.loads(done.stdout)
    assert found == pytest.approx([math.exp(x) for x in points], rel=2.3e-16)
    assert powers == [pytest.approx(0.97**24, rel=1e-15), 1.0]


def test_what_gives_numbers_calls_no_function_that_differs_between_browsers():
    found = re.compile(r"Math\.(?!abs|ceil|floor|fround|LN2|max|min|round|sign|sqrt|trunc)\w+|\*\* ?(?!2\b)\w+")
    for path in (*(PAGE / f"{name}.mjs" for name in ("design", "loop", "prediction", "exact")), _HOST):
        code = re.sub(r"/\*\*.*?\*/", "", path.read_text(), flags=re.DOTALL)
        assert found.findall(code) == [], path.name


@pytest.mark.long
@needs_modules
@pytest.mark.parametrize("folder", [PAGE, PAGES], ids=["lab", "pages"])
def test_the_types_of_the_code_hold(folder):
    command = [NODE, f"{MODULES}/typescript/bin/tsc", "--project", folder / "tsconfig.json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout) == (0, "")
