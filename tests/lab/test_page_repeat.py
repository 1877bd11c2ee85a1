"""What the page prints to repeat a run - a command, a file, a program - is run, and gives the page's trace."""

import html
import re
import shlex
import tomllib

import numpy as np
import polars as pl
import pytest

from glucoloop.cli.app import command_of, main
from glucoloop.cli.request import command_request
from glucoloop.component.request import configuration_from
from glucoloop.reporting import Repeat
from glucoloop.reporting.template import render
from glucoloop.situations.run import Run
from glucoloop.situations.toml import toml_text
from glucoloop.units import MG_DL_PER_MMOL_L, u_h_from_mu_min
from page_loops import run_of

LINK = (
    "#controller=mpc,+move_weight=2&guard=usual&meals=60g@45min&meals=20g@5h&sensor=white-noise,+variance=1.45&seed=3"
)


@pytest.fixture(scope="module")
def answer(in_node):
    [answer] = in_node([LINK])
    return answer


def same(found, answer):
    for name, tolerance in {"t_min": 0.0, "glucose_mg_dl": 0.02, "insulin_mU_min": 0.02}.items():
        expected = np.asarray(answer["trace"][name], float)
        np.testing.assert_allclose(np.asarray(found[name], float), expected, rtol=0.0, atol=tolerance, err_msg=name)


def run(*words):
    with pytest.raises(SystemExit) as left:
        main([*words])
    assert not left.value.code


def table(place):
    return np.genfromtxt(place, delimiter=",", names=True)


@pytest.mark.long
def test_the_printed_command_file_and_program_give_the_trace_of_the_page(
    answer, in_node, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    program, *words = shlex.split(answer["command"])
    assert program == "glucoloop"
    run(*words, "--out", "by-command")
    same(table(tmp_path / "by-command" / "trace.csv"), answer)

    (tmp_path / "lab.toml").write_text(answer["toml"], encoding="utf-8")
    run("run", "--config", "lab.toml", "--out", "by-file")
    same(table(tmp_path / "by-file" / "trace.csv"), answer)

    folder = tmp_path / "by-command"
    files = {"toml": (folder / "run.toml").read_text(), "csv": (folder / "trace.csv").read_text()}
    [loaded] = in_node([files])
    assert loaded["situation"] == answer["situation"]
    assert loaded["here"] == answer["trace"]
    same(loaded["table"], answer)
    assert loaded["table"]["status"] == answer["trace"]["status"]

    names = {}
    exec(compile(answer["python"], "printed", "exec"), names)
    same(vars(names["outcome"].trace), answer)
    assert "Insulin delivered" in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.parametrize(
    "link", ["#controller=pid,+closed_loop_min=100&guard=usual", "#patient=wilinska-2010&controller=pid"]
)
def test_the_printed_command_for_people_gives_those_of_the_page(link, in_node, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    [crowd] = in_node([{"link": link, "people": 60}])
    program, *words = shlex.split(crowd["command"])
    assert program == "glucoloop"
    run(*words, "--out", "people")
    people = pl.read_parquet(tmp_path / "people" / "shards" / "*" / "people.parquet").filter(
        pl.col("minimum_mg_dl").is_finite()
    )
    assert crowd["score"]["people"] == people.height
    for fate, found in zip(crowd["worst"], people.sort("minimum_mg_dl").iter_rows(named=True), strict=False):
        assert fate["person"] == found["person"]
        assert fate["lowest_mg_dl"] == pytest.approx(found["minimum_mg_dl"], abs=0.02)
        assert fate["highest_mg_dl"] == pytest.approx(found["peak_mg_dl"], abs=0.02)


@pytest.mark.long
def test_the_program_the_file_and_the_command_tell_the_same_run(in_node, corpus):
    for answer in in_node(corpus[:20]):
        names = {}
        program, _, _ = answer["python"].partition("outcome = ")
        exec(compile(program, "printed", "exec"), names)
        whole = run_of(answer["toml"]).tree(whole=True)
        assert names["run"].tree(whole=True) == whole
        _, _, *words = shlex.split(answer["command"])
        request = command_request(command_of("run").given(words), command_of("run").options)
        assert configuration_from(Run, request.tree).tree(whole=True) == whole


@pytest.mark.long
def test_a_complete_configuration_brings_back_its_situation(in_node, corpus):
    answers = in_node(corpus[:40])
    written = []
    for answer in answers:
        run = run_of(answer["toml"])
        written.append({"toml": toml_text(run.tree(whole=True), "run --config run.toml", run.tree())})
    for loaded, answer in zip(in_node(written), answers, strict=True):
        assert loaded["unlike"] == []
        assert loaded["situation"]["tuning"].items() <= answer["situation"]["tuning"].items()
        assert loaded["here"] == answer["trace"]


def test_a_page_of_results_opens_the_laboratory_with_its_configuration(in_node, corpus, tmp_path):
    keys = {**tomllib.loads(in_node(corpus[:1])[0]["toml"]), "warm_up_min": 60.0, "metrics": []}
    template = tmp_path / "page.html"
    template.write_text('{% extends "base.html" %}')
    written = render(template, "Run", repeat=Repeat("run --config run.toml", keys))
    [link] = re.findall(r'href="lab\.html(#[^"]+)"', written)
    [opened, plain] = in_node([html.unescape(link), corpus[0]])
    assert opened["trace"] == plain["trace"]
    assert opened["unlike"] == ["warm_up_min = 60"]


def test_what_the_page_leaves_out_of_a_configuration_is_told(in_node):
    text = 'controller = "pid"\nintegrator = "adaptive"\nmeals = [\n    "30g@20min",\n]\nwarm_up_min = 60\n'
    told, other, unread = in_node([{"toml": text}, {"toml": 'patient = "sorensen"\n'}, {"toml": "meals = 3 g\n"}])
    assert told["unlike"] == ['integrator = "adaptive"', "warm_up_min = 60"]
    assert told["situation"]["meals"] == [{"carbs_g": 30, "t_min": 20}]
    assert "the patient is 'sorensen'; the known ones are: parker-1999, hovorka" in other["refused"]
    assert unread["refused"] == "the configuration has the line 'meals = 3 g', which this page cannot read"


def test_a_configuration_is_read_whether_its_parts_are_tables_or_texts(in_node):
    texts = """patient = "hovorka-2004"
controller = ["pid, closed_loop_min=100, guard=(usual, max_hour=2), label=careful", "imc"]
sensor = ["white-noise, variance=2", "dead-time"]
pump = "max_insulin_mU_min=50"
faults = ["occlusion, start_min=60, noticed=true"]
"""
    tables = """sensor = [{name = "white-noise", variance = 2.0}, "dead-time, minutes=5"]
# a comment
[patient]
name = "hovorka-2004"
[pump]
name = "limited"
max_insulin_mU_min = 50
[[controller]]
name = "pid"
label = "a = {b}, c"
closed_loop_min = 100
[controller.guard]
max_hour = 2
[[controller]]
name = "imc"
[[faults]]
name = "occlusion"
start_min = 60
open_fraction = 0
noticed = true
"""
    of_texts, of_tables = in_node([{"toml": texts}, {"toml": tables}])
    assert of_texts["unlike"] == of_tables["unlike"] == []
    assert of_texts["situation"] == of_tables["situation"]
    assert of_texts["situation"] == {
        "patient": "hovorka-2004/fasting-120",
        "controller": "pid",
        "tuning": {"closed_loop_min": 100},
        "guard": True,
        "guard_limits": {"max_hour": 2},
        "pump_limits": {"max_insulin_mU_min": 50},
        "faults": [{"name": "occlusion", "start_min": 60, "duration_min": None, "settings": {"noticed": True}}],
        "meals": [{"carbs_g": 50, "t_min": 50}],
        "noise_variance": 2,
        "monitor": None,
        "dead_time_min": 5,
        "seed": 0,
        "duration_min": 600,
        "announce": False,
        "announce_before_min": 0,
        "announced_late_min": 0,
    }


def test_parts_that_the_page_has_not_are_told_and_left_out(in_node):
    text = """sensor = ["ideal, site=interstitial", "lag, lag_min=8", "white-noise, variance=2, bound_mg_dl=9"]
controller = "mpc, known_dead_time=true, constraints=qp, faults=stuck"
guard = "on_board_tau_min=60"
pump = "expiring, samples=3"
faults = ["missing, per_day=2"]
"""
    [told] = in_node([{"toml": text}])
    assert told["unlike"] == [
        'sensor.site = "interstitial"',
        "the sensor lag, lag_min=8",
        "sensor.bound_mg_dl = 9",
        "the fault missing, per_day=2",
        'pump.name = "expiring"',
        "pump.samples = 3",
        "controller.known_dead_time = true",
        'controller.constraints = "qp"',
        "guard.on_board_tau_min = 60",
        "model.noise_variance = 2",
    ]
    assert [fault["name"] for fault in told["situation"]["faults"]] == ["stuck"]


def test_units_are_remembered_by_the_link_and_change_no_number(in_node):
    asked = "#controller=imc&shown_glucose=mmol%2Fl&shown_insulin=U%2Fh"
    shown, plain, unknown = in_node([asked, "#controller=imc", "#shown_glucose=g%2Fl"])
    assert shown["trace"] == plain["trace"]
    assert shown["command"] == plain["command"]
    assert shown["link"] == plain["link"] + "&shown_glucose=mmol%2Fl&shown_insulin=U%2Fh"
    assert [unit["name"] for unit in shown["units"].values()] == ["mmol/l", "U/h"]
    assert shown["units"]["glucose"]["factor"] == 1.0 / MG_DL_PER_MMOL_L
    assert shown["units"]["insulin"]["factor"] == u_h_from_mu_min(1.0)
    assert unknown["refused"] == "the unit of glucose is 'g/l'; the known ones are: mg/dl, mmol/l"
