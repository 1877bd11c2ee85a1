"""A sampler of another package: one class, and the search for a tuning takes it."""

import pytest

from glucoloop.situations.situation import configured
from glucoloop.studies.robust import Search
from glucoloop.tuning.samplers import SAMPLERS

NAME = "your_own_sampler:Sobol"


@pytest.fixture
def outside(install, tmp_path):
    """A folder with the module, and an entry point that names it."""
    install("your_own_sampler", "samplers", "sobol", "Sobol")
    return tmp_path


@pytest.mark.parametrize("name", ["sobol", NAME])
def test_it_is_found_and_samples_within_the_ranges(outside, name):
    assert "sobol" in SAMPLERS.names()
    asked = configured(Search, sampler=f"{name}, seed=2")
    assert asked.tree(whole=True)["sampler"] == {"name": name, "seed": 2}
    tunings = asked.sampler.made(space=asked.space, batch=8, start=asked.initial).ask(8)
    assert all(of.holds(tuning[of.name]) for tuning in tunings for of in asked.space)
    assert len({tuning["move_weight"] for tuning in tunings}) == 8


def test_a_setting_that_it_lacks_is_refused(outside):
    with pytest.raises(ValueError, match="has no setting 'population'"):
        configured(Search, sampler=f"{NAME}, population=3")
