"""Part of the safety file for an exported controller: its hazards, the measures in its folder, and what was run."""

import dataclasses

import pytest

from glucoloop.firmware.checks import BOUNDS, CHANGE, MISRA
from glucoloop.firmware.safety import SafetyFile, safety_report

RUNGS = [
    {"check": "C on this computer", "holds": True},
    {"check": MISRA, "holds": False},
    {"check": BOUNDS, "holds": None},
    {"check": CHANGE, "holds": True},
]
MISCOUNTED, UNGUARDED = "Carbohydrate is counted too high", "A controller is carried on without a guard"
UNMEASURED = "## Hazards against which this folder has no measure"


def part(text, heading):
    """Text below a heading, to the next one."""
    return text.split(f"{heading}\n")[1].split("\n## ")[0]


@pytest.fixture(scope="module")
def exported(on_chip):
    return on_chip.exported


@pytest.fixture(scope="module")
def giving_boluses(exported):
    return dataclasses.replace(exported, last=dataclasses.replace(exported.last, amounts={"bolus_mU": 25_000.0}))


def test_a_guard_is_a_measure_only_where_it_is(exported):
    guarded = safety_report(exported, "PID", RUNGS, guarded=True)
    bare = safety_report(exported, "PID", RUNGS, guarded=False)
    names = [one.name for one in SafetyFile.read().requirements.values() if one.of == "the guard"]
    here, not_here = "## Measures in this folder", "## Measures that are not in this folder"
    for name in set(names) - {"capped-boluses"}:
        assert f"**{name}**" in part(guarded, here)
        assert f"**{name}**" not in part(bare, here)
        assert f"`{name}`" in part(bare, not_here)
    assert UNGUARDED in bare
    assert UNGUARDED not in guarded
    drift = "The error of the readings grows slowly."
    assert drift in part(bare, UNMEASURED)
    assert drift not in part(guarded, UNMEASURED)


def test_hazards_of_boluses_concern_who_gives_them(exported, giving_boluses):
    assert MISCOUNTED not in safety_report(exported, "PID", RUNGS, guarded=True)
    assert MISCOUNTED in safety_report(giving_boluses, "PID", RUNGS, guarded=True)


def test_every_hazard_that_concerns_it_says_what_is_left(giving_boluses):
    text = safety_report(giving_boluses, "PID", RUNGS, guarded=False)
    for hazard in SafetyFile.read().hazards.values():
        assert f"**{hazard.what}**" in text
        assert f"- Left: {hazard.residual_risk}" in text


def test_checks_have_the_outcome_of_the_folder(exported):
    text = safety_report(exported, "PID", RUNGS, guarded=True)
    assert f"- For this folder, not run: {BOUNDS}" in text
    assert f"- For this folder, held: {CHANGE}" in text
    assert f"- For this folder, did not hold: {MISRA}" in text
    assert "- For this folder, held: C on this computer" in text
    assert "- For this folder, not run: C on an emulated chip" in text
    emulated = [*RUNGS, {"check": "C on an emulated cortex-m4f", "holds": True}]
    on_chip = safety_report(exported, "PID", emulated, guarded=True)
    assert "- For this folder, held: C on an emulated cortex-m4f" in on_chip
    assert "not run: C on an emulated chip" not in on_chip


def test_it_is_no_device(exported):
    text = safety_report(exported, "PID", RUNGS, guarded=True)
    assert "Research software, not a medical device." in text
    assert exported.source.design in text
    assert "{" not in text
