"""Guarded controllers that are told nonsense in masses, and the caps counted a second time."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.control import GuardSettings
from glucoloop.metrics.promises import CAPS, OF_CONTROLLER, Caps
from glucoloop.studies.verification import NONSENSE_SAMPLES, Verification, study

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
    asked = [BASAL] * 2 + [60.0] * 12 + [BASAL] * 30 + [60.0] * 12
    told = [BASAL] * 2 + [BASAL + 1.0] + [60.0] * 11 + [60.0] + [BASAL] * 30 + [60.0] * 11
    held = kept(asked, told)
    assert held[:44].all()
    assert not held[44:].all()
    # what is no rate is taken for what was asked
    assert not kept([60.0] * 14, [np.nan] * 14).all()


def found(progress=lambda loops: None, **given):
    """What a nonsense test found, as it is read back."""
    return study.found(Verification(**given), progress).plain


@pytest.mark.long
def test_nothing_is_broken_by_nonsense():
    result = found(nonsense=50_000, controllers=("imc",))
    assert result["holds"]
    assert result["samples"] >= 50_000
    assert result["violations"] == dict.fromkeys(OF_CONTROLLER, 0)


def test_a_guard_that_allows_more_than_it_should_is_found(monkeypatch):
    monkeypatch.setattr(study, "Caps", lambda settings, **others: Caps(settings=GuardSettings(max_hour=1.2), **others))
    told = []
    result = found(told.append, nonsense=20_000, controllers=("basal",))
    [arm] = result["arms"]
    assert {promise for promise, count in result["violations"].items() if count} == {CAPS}
    assert not result["holds"]
    assert sum(told) == arm["loops"] == -(-20_000 // NONSENSE_SAMPLES)
    # the same loop alone breaks the same promise
    [first, *_] = arm["told"][CAPS]
    alone = found(nonsense=1, controllers=("basal",), person=first)
    assert (alone["samples"], alone["violations"][CAPS]) == (NONSENSE_SAMPLES, 1)
