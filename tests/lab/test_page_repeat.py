"""What the page prints to repeat a run - a command, a file, a program - is run, and gives the page's trace."""

import html
import re
import shlex
import tomllib

import numpy as np
import polars as pl
import pytest

from glucoloop.cli.app import main
from glucoloop.config.run import read_run
from glucoloop.config.toml import toml_text
from glucoloop.report import Repeat
from glucoloop.report.template import render
from glucoloop.units import MG_DL_PER_MMOL_L, u_h_from_mu_min

LINK = "#controller=mpc&guard=true&move_weight=2&meals=60g%4045min+20g%40300min&noise_variance=1.45&seed=3"


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
    "link", ["#controller=pid&closed_loop_min=100&guard=true", "#patient=wilinska-2010&controller=pid"]
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


def test_the_program_and_the_file_hold_the_same_keys(in_node, corpus):
    for answer in in_node(corpus[:20]):
        names = {}
        program, _, _ = answer["python"].partition("outcome = ")
        exec(compile(program, "printed", "exec"), names)
        keys = tomllib.loads(answer["toml"])
        del keys["glucoloop"]
        assert names["keys"] == keys
        assert read_run(names["keys"]) == read_run(keys)


def test_a_complete_configuration_brings_back_its_situation(in_node, corpus):
    answers = in_node(corpus[:40])
    written = []
    for answer in answers:
        keys = tomllib.loads(answer["toml"])
        del keys["glucoloop"]
        written.append({"toml": toml_text(read_run(keys).keys(), "run --config run.toml")})
    for loaded, answer in zip(in_node(written), answers, strict=True):
        assert loaded["unlike"] == []
        assert loaded["situation"]["tuning"].items() <= answer["situation"]["tuning"].items()
        assert loaded["here"] == answer["trace"]


def test_a_page_of_results_opens_the_laboratory_with_its_configuration(in_node, corpus, tmp_path):
    keys = {**tomllib.loads(in_node(corpus[:1])[0]["toml"]), "announce_meals": True, "metrics": []}
    template = tmp_path / "page.html"
    template.write_text('{% extends "base.html" %}')
    written = render(template, "Run", repeat=Repeat("run --config run.toml", keys))
    [link] = re.findall(r'href="lab\.html(#[^"]+)"', written)
    [opened, plain] = in_node([html.unescape(link), corpus[0]])
    assert opened["trace"] == plain["trace"]
    assert opened["unlike"] == ["announce_meals = true"]


def test_what_the_page_leaves_out_of_a_configuration_is_told(in_node):
    text = 'controller = "pid"\nintegrator = "adaptive"\nmeals = [\n    "30g@20min",\n]\nannounce_meals = true\n'
    told, other, unread = in_node([{"toml": text}, {"toml": 'patient = "sorensen"\n'}, {"toml": "meals = 3 g\n"}])
    assert told["unlike"] == ['integrator = "adaptive"', "announce_meals = true"]
    assert told["situation"]["meals"] == [{"carbs_g": 30, "t_min": 20}]
    assert "the patient is 'sorensen'; the known ones are: parker-1999, hovorka" in other["refused"]
    assert unread["refused"] == "the configuration has the line 'meals = 3 g', which this page cannot read"


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
