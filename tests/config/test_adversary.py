"""A search for the worst errors from flat keys."""

import pytest

from glucoloop.studies.adversary import ADVERSARY
from glucoloop.studies.adversary.study import read as read_adversary


def test_without_keys_it_is_five_guarded_controllers_under_three_sizes_of_errors():
    asked = read_adversary({})
    assert list(asked.searches())[:3] == [
        "imc, guarded, ±10 %",
        "imc, guarded, ±20 %",
        "imc, guarded, ±30 %",
    ]
    assert len(asked.searches()) == 3 * len(ADVERSARY.usual["controllers"])
    space = asked.searches()["imc, guarded, ±10 %"].space
    assert (space.samples, space.hold_samples, space.stretches, space.stretch_samples) == (120, 3, 3, 6)


def test_its_own_keys_give_the_same_search():
    asked = read_adversary(
        {"errors_pct": [15.0], "guards": "both", "person": 7, "guard_low_mg_dl": 70.0, "stuck_times": 0}
    )
    again = read_adversary({key: of for key, of in asked.keys().items() if key not in ("case",)}, asked.keys()["case"])
    assert again == asked
    assert list(again.searches())[:2] == ["imc, ±15 %", "imc, guarded, ±15 %"]


@pytest.mark.parametrize("given", [{"duration_min": 1440.0}, {"days": 1}])
def test_length_of_whole_days_is_among_the_keys(given):
    assert read_adversary(given).keys()["days"] == 1


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"errors_pct": []}, "errors_pct is empty; give one largest error or more"),
        ({"errors_pct": [10.0, 10.0]}, "errors_pct is 10, 10; give one largest error or more, each once"),
        ({"errors_pct": [100.0]}, "errors_pct"),
        ({"hold_min": 7.0}, "a time for which an error holds of 7 min is not a whole number of 5-min samples"),
        ({"stuck_min": 12.0}, "a stuck stretch of 12 min is not a whole number of 5-min samples"),
        ({"guards": "some"}, "guards"),
        ({"design": "individual"}, "design is no part of a search"),
        ({"sequences": 3}, "sequences"),
        ({"wobble": 1}, "unknown key 'wobble'"),
    ],
)
def test_what_cannot_be_is_refused(keys, told):
    with pytest.raises(ValueError, match=told):
        read_adversary(keys)
