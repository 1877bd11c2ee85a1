"""Guarded controllers that are told nonsense in masses, and the caps counted a second time."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import GuardSettings, guard
from glucoloop.metrics.promises import CAPS, OF_CONTROLLER, Caps
from glucoloop.studies.verification import NONSENSE_SAMPLES, Verification, nonsense
from verified import results_of_verification

SETTINGS = GuardSettings(max_hour=2.0, max_on_board=0.8, on_board_tau_min=90.0)
BASAL = 20.0


def kept(asked, told=None):
    """Whether the caps hold at each sample; the pump does as it is asked, if nothing else is told."""
    caps = Caps(settings=SETTINGS)
    counted, word, held = caps.init(jnp.asarray(BASAL)), BASAL, []
    for k, rate in enumerate(asked):
        counted, holds = caps.step(counted, jnp.asarray(word if told is None else told[k]), jnp.asarray(float(rate)))
        held.append(bool(holds))
        word = rate
    return np.array(held)


def test_a_cap_on_board_is_passed_when_it_is():
    """At three times the basal rate, 2 (1 - exp(-t / 90 min)) is on board; an hour may hold 24 basal samples."""
    of_hour = dataclasses.replace(SETTINGS, max_hour=100.0)
    caps, counted = Caps(settings=of_hour), Caps(settings=of_hour).init(jnp.asarray(BASAL))
    word, held = BASAL, []
    for _ in range(14):
        counted, holds = caps.step(counted, jnp.asarray(word), jnp.asarray(3.0 * BASAL))
        held.append(bool(holds))
        word = 3.0 * BASAL
    after_min = 5.0 * np.arange(1, 15)
    np.testing.assert_array_equal(held, 2.0 * (1.0 - np.exp(-after_min / 90.0)) <= 0.8)


def test_a_cap_of_the_hour_is_passed_when_it_is():
    np.testing.assert_array_equal(kept([2.5 * BASAL] * 9), [True] * 8 + [False])
    # a rate below the basal rate counts as the basal rate
    np.testing.assert_array_equal(kept([0.0, *[2.5 * BASAL] * 9]), [True] * 9 + [False])


def test_after_a_pump_that_gave_more_than_asked_the_caps_bind_again_at_the_basal_rate():
    asked = [BASAL] * 20 + [60.0] * 4
    told = [BASAL] + [60.0] * 12 + [BASAL] * 8 + [60.0] * 3
    held = kept(asked, told)
    # what was reported beyond the request breaks no promise, and counts later
    assert held[:21].all()
    assert not held[21:].all()
    assert kept(asked).all()
    # what is no rate is taken for what was asked
    assert not kept([60.0] * 14, [np.nan] * 14).all()


@pytest.mark.parametrize("part", [0.0, 0.5, 2.0])
def test_a_false_report_excuses_no_request(part):
    """A pump that gives what it is asked for reports a part of it, or twice as much."""
    asked = [60.0] * 14
    told = [BASAL, *[part * rate for rate in asked[:-1]]]
    np.testing.assert_array_equal(kept(asked, told), kept(asked))
    assert not kept(asked, told).all()


def test_a_rate_counts_as_falling_no_faster_than_the_pump_can():
    """A request of nothing after 60 mU/min, on a report of nothing, leaves 43.3 mU/min in the pump."""
    caps = Caps(settings=GuardSettings(max_hour=100.0, max_on_board=1.0))
    counted = caps.init(jnp.asarray(BASAL))
    for told, asked in ((BASAL, 60.0), (0.0, 0.0), (0.0, 0.0)):
        counted, _ = caps.step(counted, jnp.asarray(told), jnp.asarray(asked))
    assert float(counted.rate_mU_min) == pytest.approx(60.0 - 16.7)


def found(progress=lambda loops: None, **given):
    """What a nonsense test found, as it is read back."""
    return results_of_verification(progress, **given)


@pytest.mark.parametrize("patient", ["parker-1999", "hovorka-2004"])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_nothing_is_broken_by_false_reports(patient, precision):
    """A sample of the search of ten million at five sample times that the guide to verification reports."""
    given = {"controllers": ("basal-bolus",), "sample_times_min": (5.0,), "precisions": (precision,)}
    result = found(nonsense=50_000, patient=patient, **given)
    assert result["violations"] == dict.fromkeys(OF_CONTROLLER, 0)
    assert result["samples"] >= 50_000


@pytest.mark.long
@pytest.mark.parametrize("patient", ["parker-1999", "hovorka-2004"])
def test_nothing_is_broken_by_false_reports_at_any_sample_time(patient):
    given = {"controllers": ("basal-bolus", "pid"), "sample_times_min": (1.0, 3.0, 10.0, 15.0)}
    result = found(nonsense=200_000, patient=patient, precisions=("float64", "float32"), **given)
    assert result["violations"] == dict.fromkeys(OF_CONTROLLER, 0)
    assert {(arm["sample_time_min"], arm["precision"]) for arm in result["arms"]} == {
        (every, precision) for every in (1.0, 3.0, 10.0, 15.0) for precision in ("float64", "float32")
    }


def test_a_guard_that_believes_a_report_of_too_little_is_found(monkeypatch):
    monkeypatch.setattr(guard, "largest_possible_rate", lambda doses, requested, reported, change: reported)
    result = found(nonsense=20_000, controllers=("basal-bolus",), patient="hovorka-2004")
    assert result["violations"][CAPS] > 0
    [arm] = result["arms"]
    alone = found(nonsense=1, controllers=("basal-bolus",), patient="hovorka-2004", person=arm["examples"][CAPS][0])
    assert alone["violations"][CAPS] == 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sample_times_min": (1.0,)}, "add --nonsense"),
        ({"precisions": ("float32",)}, "add --nonsense"),
        ({"nonsense": 1, "sample_times_min": (1.0, 1.0)}, "--sample-time names the same value twice"),
    ],
)
def test_sample_times_and_precisions_are_those_of_a_nonsense_test(given, message):
    with pytest.raises(ValueError, match=message):
        Verification(**given)


@pytest.mark.long
def test_nothing_is_broken_by_nonsense():
    result = found(nonsense=50_000, controllers=("imc",))
    assert result["holds"]
    assert result["samples"] >= 50_000
    assert result["violations"] == dict.fromkeys(OF_CONTROLLER, 0)


def test_a_guard_that_allows_more_than_it_should_is_found(monkeypatch):
    monkeypatch.setattr(
        nonsense, "Caps", lambda settings, **others: Caps(settings=GuardSettings(max_hour=1.2), **others)
    )
    told = []
    result = found(told.append, nonsense=20_000, controllers=("basal",))
    [arm] = result["arms"]
    assert {promise for promise, count in result["violations"].items() if count} == {CAPS}
    assert not result["holds"]
    assert sum(told) == arm["loops"] == -(-20_000 // NONSENSE_SAMPLES)
    # the same loop alone breaks the same promise
    [first, *_] = arm["examples"][CAPS]
    alone = found(nonsense=1, controllers=("basal",), person=first)
    assert (alone["samples"], alone["violations"][CAPS]) == (NONSENSE_SAMPLES, 1)
