"""Populations in files come back as they were written, and are refused by name."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.patients.population import Population, populations_of
from glucoloop.patients.variation import Variation
from glucoloop.situations.population import named_population, population_keys, read_population
from glucoloop.situations.toml import read_toml, toml_text

TABLE = """
summary = "weight and insulin clearance"

[[vary]]
parameter = "weight_kg"
distribution = "lognormal"
centre = 75
spread_pct = 15.0

[[vary]]
parameter = "F_LC"
distribution = "uniform"
spread = 0.1
lower = 0.35
"""


def test_a_population_is_read_from_its_table(tmp_path):
    file = tmp_path / "clinic.toml"
    file.write_text(TABLE)
    assert named_population(str(file)) == Population(
        "clinic",
        (
            Variation(parameter="weight_kg", distribution="lognormal", centre=75.0, spread_pct=15.0),
            Variation(parameter="F_LC", distribution="uniform", spread=0.1, lower=0.35),
        ),
        "weight and insulin clearance",
    )


PRESETS = populations_of("parker-1999")


@pytest.mark.parametrize("name", PRESETS)
def test_presets_come_back_from_their_keys(name):
    assert named_population(name) == PRESETS[name]
    read, *_ = read_toml(toml_text(population_keys(PRESETS[name]), ""), "p.toml")
    assert read_population(read) == PRESETS[name]


@given(
    st.lists(
        st.builds(
            Variation,
            parameter=st.sampled_from(["F_LC", "tau_I", "weight_kg", "M_IHGP.strength"]),
            distribution=st.sampled_from(["uniform", "normal", "lognormal"]),
            spread_pct=st.floats(0.1, 20.0),
            upper=st.none() | st.just(1e6),
        ),
        unique_by=lambda v: v.parameter,
    ),
    st.text(min_size=1, max_size=20).filter(str.strip),
)
def test_any_population_comes_back_from_its_file(variations, summary):
    variations = [v if v.parameter != "F_LC" else Variation(**{**vars(v), "upper": 0.5}) for v in variations]
    made = Population("made", tuple(variations), summary)
    read, *_ = read_toml(toml_text(population_keys(made), ""), "p.toml")
    assert read_population(read) == made


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"varies": []}, "unknown key 'varies' of a population; did you mean 'vary'"),
        ({"name": 3}, "name is 3; give a text"),
        ({"vary": 3}, r"vary is 3; give a table for each parameter, under \[\[vary\]\]"),
        ({"vary": [3]}, r"vary is \[3\]; give a table"),
        (
            {"vary": [{"parametre": "F_LC"}]},
            r"\[\[vary\]\] number 1: unknown key 'parametre' of a variation; did you mean 'parameter'",
        ),
        ({"vary": [{"parameter": "F_LC"}]}, r"number 1: distribution is missing; add it"),
        (
            {"vary": [{"parameter": "F_LC", "distribution": "gamma", "spread": 0.1}]},
            "number 1: unknown distribution 'gamma' of F_LC; the known ones are: uniform, normal, lognormal",
        ),
        (
            {"vary": [{"parameter": "F_LC", "distribution": "normal", "spread": "0.1"}]},
            "number 1: spread is '0.1', a str; give a number, such as 0.1",
        ),
        ({"vary": [{"parameter": "F_LC", "distribution": "normal"}]}, "number 1: F_LC needs one spread"),
        ({"vary": [{"parameter": "F_XX", "distribution": "normal", "spread": 1}]}, "unknown parameter 'F_XX'"),
    ],
)
def test_a_wrong_table_is_refused_by_name(keys, told):
    with pytest.raises(ValueError, match=told):
        read_population(keys)


def test_what_is_no_population_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"unknown population 'parker200'; did you mean 'parker2000'\?.* give a file"):
        named_population("parker200")
    with pytest.raises(
        ValueError, match=r"none\.toml cannot be read: No such file or directory; give the path of a file"
    ):
        named_population(str(tmp_path / "none.toml"))
    file = tmp_path / "p.toml"
    for content, told in (
        (b"\xff", "not text in UTF-8"),
        (b"[", "is not TOML"),
        (b"a = 1", r"p\.toml: unknown key 'a'"),
    ):
        file.write_bytes(content)
        with pytest.raises(ValueError, match=told):
            named_population(str(file))


@pytest.mark.parametrize("text", ["", "name = 'everybody'\n", "vary = []\n"])
def test_a_file_in_which_nobody_varies_is_refused(tmp_path, text):
    path = tmp_path / "people.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"has no \[\[vary\]\] table"):
        named_population(str(path))
