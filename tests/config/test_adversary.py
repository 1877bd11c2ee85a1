"""A search for the worst errors from flat keys."""

import pytest

from glucoloop.studies.adversary.keys import read_adversary
from glucoloop.studies.adversary.options import USUAL


def test_without_keys_it_is_five_guarded_controllers_under_three_sizes_of_errors():
    asked = read_adversary({})
    assert [cell.name for cell in asked.cells()][:3] == [
        "imc, guarded, ±10 %",
        "imc, guarded, ±20 %",
        "imc, guarded, ±30 %",
    ]
    assert len(asked.cells()) == 3 * len(tuple(USUAL["controllers"]))
    space = asked.cells()[0].space
    assert (space.samples, space.hold_samples, space.stretches, space.stretch_samples) == (120, 3, 3, 6)


def test_its_own_keys_give_the_same_search():
    asked = read_adversary(
        {"errors_pct": [15.0], "guards": "both", "person": 7, "guard_low_mg_dl": 70.0, "stuck_times": 0}
    )
    again = read_adversary({key: of for key, of in asked.keys().items() if key not in ("case",)}, asked.keys()["case"])
    assert again == asked
    assert [cell.guarded for cell in again.cells()][:2] == [False, True]


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
