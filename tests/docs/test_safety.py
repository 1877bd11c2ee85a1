"""The safety file names tests, pages and requirements that exist, and its tables leave nothing out."""

import dataclasses
import re

import pytest

from glucoloop.firmware.safety import SafetyFile


@pytest.fixture
def script(docs_module):
    return docs_module("safety")


@pytest.fixture(scope="module")
def file():
    return SafetyFile.read()


def test_whatever_is_named_exists(script, file):
    assert list(script.problems(file)) == []


@pytest.mark.parametrize(
    ("kind", "name", "changed", "told"),
    [
        ("requirements", "stuck-readings", {"tests": ("tests/control/test_guard.py::test_of_nothing",)}, "is no test"),
        ("requirements", "stuck-readings", {"tests": ("tests/control/none.py::test_it",)}, "is no test"),
        ("requirements", "stuck-readings", {"tests": ("docs/safety.py::hazards",)}, "is no test"),
        ("requirements", "stuck-readings", {"tests": ()}, "has no test"),
        ("requirements", "stuck-readings", {"evidence": ("docs/guide/none.md",)}, "is no file"),
        ("requirements", "stuck-readings", {"checks": ("proof",)}, "has the check 'proof'"),
        ("requirements", "stuck-readings", {"command": "glucoloop guess"}, "is no command"),
        ("requirements", "stuck-readings", {"command": "glucoloop verify --nonsence 1"}, "is no command"),
        ("requirements", "stuck-readings", {"command": "python docs/none.py"}, "is no command"),
        ("requirements", "stuck-readings", {"of": "the pump"}, "has the place 'the pump'"),
        ("hazards", "stuck", {"cause": "weather"}, "has the cause 'weather'"),
        ("hazards", "stuck", {"delivery": "late"}, "has the delivery 'late'"),
        ("hazards", "stuck", {"measures": ("hope",)}, "has the measure 'hope'"),
        ("hazards", "reports-nonsense", {"measures": ()}, "requirement possible-inputs is a measure against no hazard"),
        ("hazards", "stuck", {"residual_risk": ""}, "does not say what is left"),
    ],
)
def test_what_does_not_exist_is_told(script, file, kind, name, changed, told):
    entries = dict(getattr(file, kind))
    entries[name] = dataclasses.replace(entries[name], **changed)
    [*problems] = script.problems(dataclasses.replace(file, **{kind: entries}))
    assert any(told in problem for problem in problems)


def test_a_cause_without_a_hazard_is_told(script, file):
    without = {name: hazard for name, hazard in file.hazards.items() if hazard.cause != "clock"}
    assert "there is no hazard by the cause clock" in list(script.problems(dataclasses.replace(file, hazards=without)))


def test_tables_hold_every_hazard_and_requirement(script, file):
    hazards, requirements = script.hazards(file), script.requirements(file)
    for hazard in file.hazards.values():
        assert hazard.what in hazards
        assert hazard.residual_risk in hazards
    assert re.findall(r"^### (.*)$", requirements, re.M) == list(file.requirements)
    for requirement in file.requirements.values():
        assert all(f"- Test: `{test}`" in requirements for test in requirement.tests)
    links = re.findall(r"\]\(\.\./guide/(\S+?)\)", hazards + requirements)
    assert links
    assert all((script.ROOT / "docs/guide" / link).is_file() for link in links)
