"""The page in a browser: numbers as in node, nothing that axe-core finds, every control by keyboard, files to save."""

import csv
import io
import re
from pathlib import Path

import numpy as np
import pytest

from browser import in_browser, needs_browser
from glucoloop import __version__
from glucoloop.lab.pack import page
from glucoloop.reporting import Repeat
from glucoloop.reporting.charts import GLUCOSE, Panel, Plot
from glucoloop.reporting.template import render
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.toml import toml_text

pytestmark = [pytest.mark.long, needs_browser]
COLUMNS = {"t_min", "glucose_mg_dl", "reading_mg_dl", "command_mU_min", "insulin_mU_min", "status"}


def trial_page(folder):
    """A page with the percentiles of people, as that of a trial has them."""
    t = np.arange(0.0, 300.0, 5.0)
    panel = Panel(GLUCOSE, (60.0, 200.0), 100)
    for low, high, name in ((-20.0, 30.0, "90 % of the people"), (-10.0, 12.0, "50 % of the people")):
        panel.area(t, 100.0 + low + 0.0 * t, 100.0 + high + t / 10.0, 0, name)
    panel.line(t, 100.0 + t / 20.0, 0, name="median")
    keys = {"population": "parker2000", "people": 9, "days": 1, "meals": ["40g@60min"], "controller": [{"name": "imc"}]}
    template = folder / "page.html"
    body = "{% block body %}{{ charts.plot(plot) }}{% endblock %}"
    template.write_text('{% extends "base.html" %}{% import "charts.html" as charts %}' + body)
    repeat = Repeat("trial --config trial.toml", keys)
    return render(template, "Trial", repeat=repeat, plot=Plot("imc", 300.0, [panel]))


@pytest.fixture(scope="module")
def shown(in_node, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    [answer] = in_node(["#controller=imc&meals=30g%4020min"])
    names = {0: "ok", 1: "dose limited"}
    trace = answer["trace"]
    columns = ["t_min", "glucose_mg_dl", "reading_mg_dl", "command_mU_min", "insulin_mU_min"]
    lines = [
        ",".join([*map(str, values), names[status]])
        for *values, status in zip(*(trace[name] for name in columns), trace["status"], strict=True)
    ]
    files = {
        "lab.html": page(),
        "trace.csv": "\n".join([",".join([*columns, "status"]), *lines]) + "\n",
        "run.toml": toml_text(
            configured(Run, controller="imc", meals=["30g@20min"]).tree(whole=True), "run --config run.toml"
        ),
        "report.html": trial_page(tmp_path_factory.mktemp("template")),
    }
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return in_browser(Path(__file__).with_name("use.mjs"), *(folder / name for name in files))


def test_nobody_is_kept_out_and_nothing_is_loaded(shown):
    assert len(shown["views"]) == 4
    looked = {(view["width"], view["colorScheme"]) for view in shown["views"] if view["looked"]}
    assert looked == {(1280, "light"), (390, "dark")}  # by axe-core, which takes long
    for view in (*shown["views"], {**shown["used"]["seen"], "violations": [], "wide": 0, "width": 0}):
        assert view["violations"] == []
        assert view["errors"] == []
        assert [load.rpartition("/")[2].partition("#")[0] for load in view["loads"]] == ["lab.html"]
        assert view["wide"] <= view["width"]


def test_the_lesson_that_was_chosen_is_seen_in_its_row(shown):
    assert {view["chosen"] for view in shown["views"] if view["colorScheme"] == "dark"} == {"seen"}


def test_every_control_is_reached_by_the_keyboard(shown):
    assert shown["used"]["reached"] == shown["used"]["controls"] > 20


def test_meals_are_moved_by_keys_and_by_hand_and_moved_back(shown):
    used = shown["used"]
    assert used["byKeys"] == ["55g@55min", "Meal 1: 55 g at 55 min"]
    carbs, _, time = used["dragged"].removesuffix("min").partition("g@")
    assert int(carbs) == 75
    assert 120 <= int(time) <= 150
    assert used["undone"] == "55g@55min"


def test_a_moment_is_explained_in_the_units_that_were_chosen(shown):
    used = shown["used"]
    assert used["moment"].startswith("70 min: glucose ")
    assert used["why"].startswith("At 70 min: glucose ")
    assert "Its model expects" in used["why"]
    table, why, link = used["units"]
    assert "mmol/l" in table
    assert "mg/dl" not in table
    assert "mmol/l" in why
    assert "U/h" in why
    assert "mU/min" not in why
    assert link.endswith("&shown_glucose=mmol%2Fl&shown_insulin=U%2Fh")


def test_numbers_picture_and_program_are_taken_along(shown):
    saved = shown["used"]["saved"]
    assert set(saved) == {"glucoloop-lab.csv", "glucoloop-lab.svg", "glucoloop-lab.png"}
    table = saved["glucoloop-lab.csv"].split("\n")
    assert table[0] == "t_min,glucose_mg_dl,reading_mg_dl,command_mU_min,insulin_mU_min,status"
    assert len(table) == 122
    assert saved["glucoloop-lab.svg"].startswith("<svg xmlns=")
    assert "glucoloop run --patient parker-1999" in saved["glucoloop-lab.svg"]
    assert saved["glucoloop-lab.png"].startswith("\x89PNG")
    assert "outcome = close_the_loop(run, run.case)" in shown["used"]["python"]


def test_a_tuning_is_tried_on_people_and_one_of_them_is_followed(shown):
    told, points, harmed, rows = shown["used"]["people"]
    assert re.match(r"Of 100 people \d+ come below 70 mg/dl", told)
    assert re.match(r"-?\d+\.\d\d points\. The rule: ", points)
    assert harmed == 10
    [person] = re.findall(r"Person (\d+)", rows)
    assert shown["used"]["followed"].endswith(f"&follow={person}")
    assert shown["used"]["peopleViolations"] == []
    there, elsewhere, again = shown["used"]["bands"]  # with another controller the people are not those of the picture
    assert there == again > elsewhere == 0


def test_insulin_under_the_skin_has_its_unit_and_people(shown):
    title, hint, said = shown["used"]["skin"]
    assert title == "Insulin, U/h"
    assert "people around hovorka-2004 at fasting-120 as the population boiroux2017 draws them" in hint
    assert re.match(r"Of 100 people \d+ come below 70 mg/dl", said)
    assert shown["used"]["gone"].endswith("The people are taken away, since they were drawn around the patient before.")


def test_people_are_drawn_around_the_usual_operating_point_alone(shown):
    hint, said = shown["used"]["elsewhere"]
    assert hint.startswith("Of this family, the page draws people around parker-1999 at setpoint-81 only; ")
    assert hint.endswith("or copy the command below that tries it on people around the present one")
    assert said.startswith(f"{hint}. The picture is still that ")


@pytest.mark.parametrize(
    ("family", "population"),
    [("uva-padova-2008", "lognormal"), ("kanderian-2009", "'kanderian2009, draw=with-replacement'")],
)
def test_families_of_equations_are_chosen_by_keys_and_name_their_people(shown, family, population):
    chosen, title, legend, hint, command, wide = shown["used"][family]
    assert chosen == family
    assert title == "Insulin, U/h"
    assert "maximum rate of the pump, 30.000, is above the range shown" in legend
    assert hint.startswith(f"The page draws nobody around {family}; copy the command for people below")
    assert command.startswith(f"glucoloop trial --people 100 --patient {family} ")
    assert command.endswith(f"--population {population}")
    assert wide <= 0


def test_results_are_loaded(shown):
    told, rows = shown["used"]["run"]
    assert "differs by 0.0000 mmol/l at most" in told
    assert rows == 2
    told, cases = shown["used"]["trial"]
    assert told.startswith("Behind the picture are the people of the trial under imc")
    assert cases == []
    assert shown["used"]["parquet"].startswith(
        "Nothing was loaded: This page does not read Parquet; give the whole folder"
    )
    assert shown["used"]["foreign"].startswith("Nothing was loaded: the page tells no configuration")


def test_nonsense_is_refused_in_a_sentence_and_the_page_works(shown):
    assert shown["used"]["nonsense"].startswith(
        "The link was not used: the controller is 'fuzzy'; the known ones are: "
    )
    assert shown["used"]["after"] == "Change anything; the picture follows at once."


def test_links_give_the_numbers_of_node_and_say_what_they_are(in_node, corpus, tmp_path):
    place = tmp_path / "lab.html"
    place.write_text(page(), encoding="utf-8")
    links = [
        f"#glucoloop={__version__}&controller=mpc-se&guard=usual&sensor=white-noise,+variance=1.45&seed=3&meals=60g@45min",
        "#glucoloop=0.0.1&controller=imc",
        "#controller=fuzzy",
        "",
    ]
    by_hand = "#controller=imc&meals=60g@60min"
    answers = in_node([*links[:2], "#", "#", *corpus[::19], by_hand])
    links += [*(answer["hash"].replace("1.2.3", __version__) for answer in answers[4:-1]), by_hand]
    assert len(links) >= 15
    shown = in_browser(Path(__file__).with_name("open.mjs"), *(f"file://{place}{link}" for link in links))
    for link, there, answer in zip(links, shown, answers, strict=True):
        assert (there["errors"], there["requests"], there["pictures"]) == ([], [f"file://{place}"], 2)
        summary = answer["summary"]
        expected = [f"{summary[name]:.1f}" for name in ("mean_mg_dl", "minimum_mg_dl", "peak_mg_dl")]
        assert there["cells"][:3] == expected
        assert there["command"] == answer["command"]
        assert there["hash"] == answer["hash"].replace("1.2.3", __version__)
        rows = list(csv.DictReader(io.StringIO(there["table"])))
        assert set(rows[0]) == COLUMNS
        for name in COLUMNS:
            in_browser_too = [None if row[name] == "NaN" else float(row[name]) for row in rows]
            assert in_browser_too == answer["trace"][name], (link, name)
    assert [there["said"] for there in shown[:4]] == [
        "This is the situation of the link.",
        f"The link was made by glucoloop 0.0.1, and this page is {__version__}; numbers may differ.",
        "The link was not used: the controller is 'fuzzy'; the known ones are: pid, imc, mpc, mpc-se. "
        "This is the default situation.",
        "Change anything; the picture follows at once.",
    ]
    assert shown[-1]["said"] == "This is the situation of the link."
