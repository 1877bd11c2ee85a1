"""Named people and joint distributions in files, and one person by name."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.meals import Meal
from glucoloop.patients import JointVariation, PeopleTable, Population
from glucoloop.situations.population import named_population, person_of, population_keys, read_population
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.situations.toml import read_toml, toml_text
from glucoloop.trials.trial import Trial, fingerprint

HOVORKA = "hovorka-2004"
CSV = """name, weight_kg, S_IT, carb_ratio_g_U, meals
anna, 61, 40e-4, 9.5, 45g@7h 60g@12h
ben, 82, 50e-4, , 80g@12h/20min
"""
TOML = """
draw = "with-replacement"

[[person]]
name = "anna"
weight_kg = 61
S_IT = 40e-4
carb_ratio_g_U = 9.5
meals = ["45g@7h", "60g@12h"]

[[person]]
name = "ben"
weight_kg = 82
S_IT = 50e-4
meals = ["80g@12h/20min"]

[[joint]]
parameters = ["k_e", "V_I"]
covariance = [[0.04, 0.01], [0.01, 0.01]]
scale = "log"
"""
TWO = PeopleTable(
    names=("anna", "ben"),
    values={"weight_kg": (61.0, 82.0), "S_IT": (40e-4, 50e-4)},
    profile={"carb_ratio_g_U": (9.5, None)},
    meals=((Meal(45.0, 420.0), Meal(60.0, 720.0)), (Meal(80.0, 720.0, 20.0),)),
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two.csv").write_text(CSV, encoding="utf-8")
    (tmp_path / "two.toml").write_text(TOML, encoding="utf-8")
    return tmp_path


def test_a_table_is_read_from_csv(folder):
    assert named_population("two.csv", HOVORKA) == Population("two", (), "", HOVORKA, TWO)
    assert named_population("two.csv, draw=with-replacement", HOVORKA).most_people is None


def test_a_table_and_a_joint_distribution_are_read_from_toml(folder):
    read = named_population("two.toml", HOVORKA)
    joint = JointVariation(parameters=("k_e", "V_I"), covariance=((0.04, 0.01), (0.01, 0.01)), scale="log")
    assert read.variations == (joint,)
    assert read.table == PeopleTable(**{**vars(TWO), "draws": "with-replacement"})
    assert read_population(read_toml(toml_text(population_keys(read), ""), "p.toml").keys, HOVORKA, "two") == read


numbers = st.floats(1e-3, 1e3)


@pytest.mark.long
@given(
    st.lists(st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1), unique=True, min_size=1)
    .flatmap(
        lambda names: st.fixed_dictionaries(
            {
                "names": st.just(tuple(names)),
                "values": st.fixed_dictionaries({}, optional={"S_IT": st.tuples(*[numbers] * len(names))}),
                "profile": st.fixed_dictionaries(
                    {}, optional={"correction_mg_dl_U": st.tuples(*[st.none() | numbers] * len(names))}
                ),
                "draws": st.sampled_from(["once", "with-replacement"]),
            }
        )
    )
    .map(lambda keys: PeopleTable(**keys))
)  # fmt: skip
def test_any_table_comes_back_from_its_file(table):
    made = Population("made", (), "", HOVORKA, table)
    again = read_population(read_toml(toml_text(population_keys(made), ""), "p.toml").keys, HOVORKA)
    assert again.table.names == table.names
    assert again.table.draws == table.draws
    assert dict(again.table.values) == dict(table.values)
    # a column in which nothing is known is not there
    known = {name: values for name, values in table.profile.items() if any(value is not None for value in values)}
    assert dict(again.table.profile) == known


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("name,S_IT\nanna,x\n", r"S_IT of 'anna' is 'x'"),
        ("name,S_IT\nanna,\n", "S_IT of 'anna' is missing; give it, or leave the column out"),
        ("name,S_IT\nanna,1e-3\nanna,1e-3\n", "two people are called 'anna'; give each a name of its own"),
        ("name,S_IT\nanna,-1\n", "person 'anna': S_IT is -1 but must stay above 0; give another value"),
        ("name,weight_kg\nanna,-61\n", "person 'anna': weight_kg is -61 but must stay above 0; give another value"),
        ("name,total_daily_dose_U\nanna,-4\n", "total_daily_dose_U of 'anna' is -4; give a finite value above 0, or"),
        ("name,carb_ratio_g_U\nanna,inf\n", "carb_ratio_g_U of 'anna' is inf; give a finite value above 0"),
        (
            "name,carb_ratio\nanna,9\n",
            r"column 'carb_ratio' is no part of a profile \(basal_mU_min, .*unknown parameter",
        ),
        ("S_IT\n1e-3\n", "person number 1 has no name; add it, like name = 'anna'"),
        ("name,S_IT,S_IT\nanna,1,1\n", "the column 'S_IT' is there twice; rename it"),
        ("name,,S_IT\nanna,1,1\n", "the column '' is without a name; rename it"),
        ("name,S_IT\nanna,1,1\n", "person number 1 has 3 values for 2 columns; mend the line"),
        ('name,S_IT\n"anna,1\n', "is not CSV: "),
        ("name,meals\nanna,lunch\n", "meals of 'anna': 'lunch' is not a meal; write grams and a time"),
        ("name,meals\nanna,own\n", "meals of 'anna': 'own' is not a meal"),
        ("", r"has no \[\[vary\]\] table, no \[\[joint\]\] and no \[\[person\]\]"),
        ("name,S_IT\n", r"so all people would be the same; add one"),
    ],
)
def test_what_is_no_table_in_csv_is_refused(folder, text, told):
    (folder / "people.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=rf"^people\.csv.*{told}"):
        named_population("people.csv", HOVORKA)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"person": [{"name": "a"}], "draw": "twice"}, "draw is 'twice'; give once or with-replacement"),
        ({"draw": "once"}, r"draw says how named people are drawn, but there is no \[\[person\]\]; leave it out"),
        ({"draw": 1}, "draw is 1; give a text"),
        ({"person": "anna"}, r"person is 'anna'; give a table for each person, under \[\[person\]\]"),
        ({"joint": [{"parameters": ["k_e"]}]}, r"\[\[joint\]\] number 1: covariance is missing; add it"),
        ({"joint": [{"parameters": "k_e", "covariance": [[1]]}]}, "parameters is 'k_e'; give a list"),
        ({"joint": [{"parameters": ["k_e"], "covariance": [1]}]}, "a row of the covariance is 1; give a list"),
        ({"joint": [{"parameters": ["k_e"], "covariance": [["x"]]}]}, "number 1: "),
        ({"joint": [{"parameters": ["k_e"], "covariance": [[-1.0]]}]}, "the variance of k_e is -1; give a finite"),
        ({"joint": [{"parameters": ["k_e"], "covariance": [[1.0]], "sd": 1}]}, "unknown key 'sd' of a variation"),
        ({"person": [{"name": True}]}, "person number 1 has no name"),
        ({"person": [{"name": "a", "meals": 5}]}, "meals of 'a' are 5; give a list, like"),
    ],
)
def test_what_is_no_population_is_refused(keys, told):
    with pytest.raises(ValueError, match=told):
        read_population(keys, HOVORKA)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("two.csv, draw=often", "draw is 'often'; give once or with-replacement"),
        ("two.csv, seed=3", "'two.csv, seed=3' is no population; give its name, and at most draw, like 'people.csv,"),
        ("draw=once", "'draw=once' is no population; give its name"),
        ("", "'' is no population; give its name"),
    ],
)
def test_text_of_a_population_that_cannot_be_meant_is_refused(folder, text, told):
    with pytest.raises(ValueError, match=told):
        named_population(text, HOVORKA)


def test_one_person_by_name_of_a_file_in_run_and_trial(folder):
    assert person_of("two.csv:ben", HOVORKA, 0).table.names == ("ben",)
    run = configured(Run, patient=f"{HOVORKA}, person=two.csv:anna", meals=["own"], duration_min="24h")
    assert run.profile.carb_ratio_g_U == 9.5
    assert [meal.carbs_g for meal in run.eaten()] == [45.0, 60.0]
    trial = configured(Trial, patient=f"{HOVORKA}, person=two.csv:anna", people=20)
    assert float(trial.nominal.parameters.S_IT) == 40e-4
    assert trial.population.most_people is None
    again = configured(Trial, read_toml(toml_text(trial.tree(whole=True), "", trial.tree()), "t.toml").keys)
    assert fingerprint(again) == fingerprint(trial)


def test_all_who_are_in_a_table_are_usual(folder):
    assert configured(Trial, patient=HOVORKA, population="two.csv").people == 2
    assert configured(Trial, patient=HOVORKA, population="two.csv", first_person=1).people == 1
    assert configured(Trial, patient=HOVORKA, population="two.csv, draw=with-replacement").people == 1000


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        (
            {"patient": "kanderian-2009", "people": 11},
            "population kanderian2009: person 10 is asked for, but the table has",
        ),
        ({"patient": "kanderian-2009, person=11"}, "there is no person '11'; "),
        (
            {"patient": "kanderian-2009, person=1", "population": "nominal"},
            "the patient is one person, '1', and a popu",
        ),
        ({"patient": {"name": "kanderian-2009", "person": 1.5}}, "give a name or a number, like person=3"),
        ({"patient": "kanderian-2009", "meals": ["own", "45g@7h"]}, "the meals are each person's own day, and others"),
        ({"meals": ["own"]}, "the people of parker2000 have no days of their own; give meals, like --meal 45g@7h"),
        (
            {"patient": "kanderian-2009", "meals": ["own"], "duration_min": "10h"},
            "the own day of '1': the meal at 720 min",
        ),
        ({"profile_by": "titration"}, "parker-1999 gets intravenous insulin, where a bolus acts for minutes"),
    ],
)
def test_a_trial_that_cannot_be_is_refused(keys, told):
    with pytest.raises(ValueError, match=told):
        _ = configured(Trial, keys).plan
