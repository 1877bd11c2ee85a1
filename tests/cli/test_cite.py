"""``glucoloop cite``: publications of what a run was made of."""

import pytest

from glucoloop.component.catalogue import catalogues


def keys(answer):
    return [entry["key"] for entry in answer.json["references"]]


def test_the_program_alone_is_cited_without_a_name(glucoloop):
    told = glucoloop("cite")
    assert told.out.startswith("% the program\n@software{glucoloop,\n")
    assert told.out.count("@") == 1


def test_parts_are_cited_by_name_each_publication_once(glucoloop):
    assert keys(glucoloop("cite", "hovorka-2004", "wilinska-2010", "boiroux2017", "--json")) == [
        "glucoloop",
        "hovorka2004",
        "wilinska2010",
        "boiroux2017",
    ]


@pytest.mark.long
def test_what_a_run_used_is_cited_from_its_folder_and_from_its_file(glucoloop):
    glucoloop("run", "--controller", "mpc-se", "--sensor", "dexcom-g6", "--duration", 60, "--out", "made")
    told = glucoloop("cite", "made", "--json")
    assert {"glucoloop", "parker1999", "ricker1990", "vettoretti2019g6", "battelino2019"} <= set(keys(told))
    assert told.json == glucoloop("cite", "made/run.toml", "--json").json
    assert "patient parker-1999; controller mpc-se" in glucoloop("cite", "made").out


def test_what_names_no_publication_is_said(glucoloop, install):
    assert glucoloop("cite", "stuck").err == "The fault stuck names no publication.\n"
    install("your_own_sensor", "sensors", "late-steps", "LateSteps")
    assert glucoloop("cite", "late-steps").err == "The sensor late-steps names no publication.\n"


def test_a_source_may_be_a_whole_reference(glucoloop, install, monkeypatch):
    install("your_own_sensor", "sensors", "late-steps", "LateSteps")
    monkeypatch.setattr(catalogues()["sensor"].find("late-steps"), "sources", ("A. Nobody, A paper, 2030",))
    assert "note = {A. Nobody, A paper, 2030}" in glucoloop("cite", "late-steps").out


MISTAKES = {
    "hovorka2005": "did you mean 'hovorka-2004'?",
    ".": "holds no configuration that a command wrote",
    "given.toml": "does not say what was used",
}


@pytest.mark.parametrize("asked", MISTAKES)
def test_what_cannot_be_cited_is_refused_in_a_sentence(glucoloop, tmp_path, asked):
    (tmp_path / "given.toml").write_text("seed = 1\n", encoding="utf-8")
    told = glucoloop("cite", asked)
    assert told.code == 2
    assert MISTAKES[asked] in told.err
    assert told.out == ""
