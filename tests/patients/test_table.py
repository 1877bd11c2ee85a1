"""Populations of named people: who is drawn, what is known of them, and what is refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glucoloop.meals import Meal
from glucoloop.patients import PeopleTable, Population, Variation, draw, population, virtual_people
from glucoloop.patients.population import alone
from glucoloop.text import is_printable

TABLE = PeopleTable(
    names=("anna", "ben", "cleo"),
    values={"weight_kg": (60.0, 80.0, 95.0), "S_IT": (40e-4, 50e-4, 60e-4)},
    profile={"carb_ratio_g_U": (9.0, None, 14.0), "total_daily_dose_U": (None, None, 50.0)},
)
THREE = Population("three", (), "", "hovorka-2004", TABLE)


def test_person_i_is_row_i():
    people = virtual_people(THREE, 5, [2, 0])
    assert people.draw.values["weight_kg"].tolist() == [95.0, 60.0]
    assert people.profile.carb_ratio_g_U.tolist() == [14.0, 9.0]
    assert people.profile.weight_kg.tolist() == [95.0, 60.0]
    assert THREE.names(5, [2, 0]) == ["cleo", "anna"]


def test_what_is_not_known_follows_from_the_rules():
    profile = virtual_people(THREE, 0, np.arange(3)).profile
    np.testing.assert_array_equal(np.isnan(profile.carb_ratio_g_U), [False, True, False])
    twice_basal_U = 2.0 * 1.44 * profile.basal_mU_min
    np.testing.assert_allclose(profile.daily_dose_U(), [twice_basal_U[0], twice_basal_U[1], 50.0])
    np.testing.assert_allclose(profile.carb_ratio(), [9.0, 500.0 / twice_basal_U[1], 14.0])
    np.testing.assert_allclose(profile.correction_factor(), 1800.0 / np.array([*twice_basal_U[:2], 50.0]))


def test_no_more_people_than_there_are():
    with pytest.raises(ValueError, match=r"^population three: person 3 is asked for, but the table has 3 people"):
        draw(THREE, 0, [1, 3])
    with pytest.raises(ValueError, match=r"like --population 'three, draw=with-replacement'$"):
        draw(THREE, 0, [3])


def test_with_replacement_each_is_drawn_as_often_as_another():
    many = THREE.drawn_as("with-replacement")
    weights = draw(many, 1, np.arange(30_000)).values["weight_kg"]
    counts = [int((weights == value).sum()) for value in TABLE.values["weight_kg"]]
    assert sum(counts) == 30_000
    assert max(abs(count - 10_000) for count in counts) < 4 * np.sqrt(30_000 * 2 / 9)
    assert draw(many, 1, [777]).values["weight_kg"] == weights[777]
    assert many.names(1, [777])[0] == TABLE.names[TABLE.values["weight_kg"].index(weights[777])]


@pytest.mark.parametrize(("person", "weight"), [("ben", 80.0), ("1", 80.0), ("cleo", 95.0)])
def test_one_alone_is_found_by_name_or_number(person, weight):
    one = THREE.alone(person)
    people = virtual_people(one, 9, [0, 4, 100])
    assert people.draw.values["weight_kg"].tolist() == [weight] * 3
    who, profile = alone(one, 120.0)
    assert float(who.parameters.weight_kg) == weight == float(profile.weight_kg)


def test_names_that_are_numbers_are_names():
    table = PeopleTable(names=("1", "0"), values={"weight_kg": (60.0, 80.0)})
    assert [table.row(name) for name in "10"] == [0, 1]
    with pytest.raises(ValueError, match="there is no person '2'; the known ones are: 1, 0"):
        table.row("2")


def test_one_who_is_drawn_is_the_one_of_a_trial():
    of = population("boiroux2017", patient="hovorka-2004")
    one = virtual_people(of.alone("17", 3), 0, [0])
    drawn = virtual_people(of, 3, [17])
    assert one.basal_insulin_mU_min == drawn.basal_insulin_mU_min
    assert {name: float(of_one[0]) for name, of_one in one.draw.values.items()} == {
        name: float(values[0]) for name, values in drawn.draw.values.items()
    }


def test_a_table_may_leave_the_rest_to_chance():
    weight = Variation(parameter="k_e", distribution="uniform", spread_pct=20.0)
    mixed = dataclasses.replace(THREE, variations=(weight,))
    assert mixed.parameters == ("k_e", "weight_kg", "S_IT")
    of_three = draw(mixed, 4, np.arange(3)).values
    assert of_three["weight_kg"].tolist() == [60.0, 80.0, 95.0]
    one = draw(mixed.alone("ben", 4), 0, [0]).values
    assert {name: value[0] for name, value in one.items()} == {name: value[1] for name, value in of_three.items()}


@pytest.mark.long
@given(st.lists(st.integers(0, 2), max_size=8))
def test_people_at_places_have_their_own_profiles(places):
    people = virtual_people(THREE, 0, np.arange(3))
    some = people.at(np.array(places, np.intp))
    np.testing.assert_array_equal(some.profile.carb_ratio_g_U, people.profile.carb_ratio_g_U[places])


@given(st.lists(st.floats(), min_size=1, max_size=4), st.sampled_from(["carb_ratio_g_U", "weight_kg", "basal_mU_min"]))
def test_a_profile_holds_finite_values_above_zero(values, column):
    names = tuple(map(str, range(len(values))))
    if all(0.0 < value < np.inf for value in values):
        PeopleTable(names=names, profile={column: tuple(values)})
    else:
        with pytest.raises(ValueError, match=rf"^{column} of '\d' is .*; give a finite value above 0, or"):
            PeopleTable(names=names, profile={column: tuple(values)})


@given(st.lists(st.text(max_size=3), min_size=1, max_size=5))
def test_names_can_be_printed_and_are_given_once(names):
    printed = all(name.strip() and is_printable(name) for name in names)
    if printed and len(set(names)) == len(names):
        assert PeopleTable(names=tuple(names)).row(names[-1]) == len(names) - 1
        return
    with pytest.raises(
        ValueError, match=r"(?s)two people are called .*; give each a|the name .* of a person cannot be"
    ):
        PeopleTable(names=tuple(names))


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"names": ()}, "a table of 0 people is not possible; give 1 to 100000"),
        ({"names": ("anna", "ben", "anna")}, "two people are called 'anna'; give each a name of its own"),
        ({"draws": "twice"}, "draw is 'twice'; give once or with-replacement"),
        ({"values": {"weight_kg": (60.0, 80.0)}}, "weight_kg has 2 values for 3 people; give one for each"),
        (
            {"values": {"weight_kg": (60.0, np.nan, 80.0)}},
            "weight_kg of 'ben' is nan; give a finite value, or leave the",
        ),
        (
            {"profile": {"height": (1.0, 1.0, 1.0)}},
            "unknown column 'height' of a profile; the known ones are: basal_mU_min",
        ),
        ({"meals": ((Meal(50.0, 60.0),),)}, "there are meals of 1 people for 3; give those of each"),
    ],
)
def test_what_is_no_table_is_refused(keys, told):
    with pytest.raises(ValueError, match=told):
        dataclasses.replace(TABLE, **keys)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (
            {"weight_kg": (60.0, -80.0, 95.0)},
            "person 'ben': weight_kg is -80 but must stay above 0; give another value",
        ),
        ({"S_XX": (1.0, 1.0, 1.0)}, "unknown parameter 'S_XX'; the known ones are: weight_kg"),
    ],
)
def test_who_cannot_be_is_refused(values, told):
    with pytest.raises(ValueError, match=told):
        Population("three", (), "", "hovorka-2004", dataclasses.replace(TABLE, values=values))


@pytest.mark.parametrize("person", ["x", "-1", "1.5", "99999999999", ""])
def test_people_who_are_drawn_have_numbers(person):
    with pytest.raises(ValueError, match="people of boiroux2017 have no names; give a number from 0, like person=17"):
        population("boiroux2017", patient="hovorka-2004").alone(person)


def test_who_is_drawn_anew_has_no_rows_to_be_drawn():
    with pytest.raises(ValueError, match="boiroux2017 has no table of people, and is drawn again; leave draw out"):
        population("boiroux2017", patient="hovorka-2004").drawn_as("once")
