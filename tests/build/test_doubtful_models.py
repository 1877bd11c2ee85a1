"""A controller is not designed on a model whose gain is in doubt, unless that is allowed."""

import dataclasses

import pytest

from glucoloop.build.designs import controller_of, nominal_model
from glucoloop.sensors import SENSORS, CorrelatedNoise, WhiteNoise
from glucoloop.situations.case import default_case
from glucoloop.situations.situation import Situation, default_situation

NOISY = Situation(sensor=(WhiteNoise(variance=25.0, bound_mg_dl=30.0),), seed=1)


@pytest.mark.long
def test_a_gain_that_noise_has_made_doubtful_is_refused_with_the_mend():
    case = default_case("mpc", NOISY)
    with pytest.raises(
        ValueError, match=r"identified with noise of variance 25\. The gain is .*--model 'noise_variance=0'"
    ):
        controller_of(NOISY, case)
    assert nominal_model(dataclasses.replace(NOISY, allow_unusual=True), case).doubts()


def test_without_noise_there_is_no_doubt():
    quiet = NOISY.without_noise()
    assert not nominal_model(quiet, default_case("mpc", quiet)).doubts()


def test_a_record_has_its_own_noise_and_none_of_the_sensor():
    assert Situation(sensor=(CorrelatedNoise(),)).record_sensor(0.0) == ()
    assert Situation(sensor=(CorrelatedNoise(),)).record_sensor(1.45) == (WhiteNoise(variance=1.45),)


@pytest.mark.long
def test_no_sensor_of_the_package_leaves_the_nominal_model_in_doubt():
    for name in SENSORS:
        skin = dataclasses.replace(default_situation("hovorka-2004"), sensor=(SENSORS[name](),), seed=1)
        quiet = dataclasses.replace(
            default_case("mpc", skin), model=default_case("mpc", default_situation("hovorka-2004")).model
        )
        assert not nominal_model(skin, quiet).doubts(), name


@pytest.mark.long
def test_a_memory_that_is_too_short_is_named_as_the_reason():
    skin = default_situation("hovorka-2004")
    case = default_case("mpc", skin)
    case = dataclasses.replace(case, model=dataclasses.replace(case.model, memory=10))
    with pytest.raises(ValueError, match=r"A memory of 10 samples is short for hovorka-2004 \(\d+ are usual\)"):
        nominal_model(skin, case)
