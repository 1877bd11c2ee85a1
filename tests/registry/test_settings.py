"""What is said of a setting that is out of its bounds."""

from typing import Annotated

import pytest

from glucoloop.registry.settings import About, settings_record

SAID = {
    "move_weight": "a move weight of -1 is",
    "output_weights": "output weights of -1 are",
    "carb_ratio_g_U": "a carb ratio of -1 g/U is",
    "correction_mg_dl_U": "a correction of -1 mg/dl per U is",
    "largest_disturbance_mg_min": "a largest disturbance of -1 mg/min is",
    "failures_per_h": "failures of -1 per hour are",
    "insulin_on_board_min": "insulin_on_board_min of -1 min is",
    "cr_g_u": "cr_g_u of -1 is",
    "isf_mmol_l": "isf_mmol_l of -1 is",
}


@pytest.mark.parametrize("name", SAID)
def test_a_setting_is_named_in_words_or_as_it_was_given(name):
    record = type("Own", (), {"__annotations__": {name: Annotated[float, About("A number.", above=0.0)]}, name: 1.0})
    with pytest.raises(ValueError, match="not possible") as refused:
        settings_record(record)(**{name: -1.0})
    assert str(refused.value) == f"{SAID[name]} not possible; give a finite value above 0"


@pytest.mark.parametrize("value", [1e300, -1e31])
def test_a_number_whose_square_overflows_is_refused(value):
    record = type("Own", (), {"__annotations__": {"size": Annotated[float, About("A number.")]}, "size": 1.0})
    of = settings_record(record)
    with pytest.raises(ValueError, match="give a number of a size up to 1e\\+30"):
        of(size=value)
    assert of(size=1e-300).size == 1e-300
    assert of(size=1e30).size == 1e30
