"""How what is fuzzed may answer: with what it read, or with a sentence of its own. Nothing is simulated here."""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from glucoloop.cli import main
from glucoloop.refusal import Refusal

_STOPS = (
    "glucoloop.studies.bound.study.optimal_doses",
    "glucoloop.studies.bound.study.hedged_doses",
    "glucoloop.studies.closed_loop.nominal_model",
    "glucoloop.studies.closed_loop.controller_of",
    "glucoloop.studies.identification.study._method",
    "glucoloop.studies.identification.study._from_patient",
    "glucoloop.studies.tuning.study.model_for",
    "glucoloop.trials.engine.prepare",
    "glucoloop.trials.folder.trial_folder",
    "glucoloop.reproduction.parker1999.study.study",
)
"""Where reading ends and computing begins."""


def refusal(function: Callable[..., object], *arguments: object) -> str | None:
    """The sentence with which a reader refuses, or None; whatever else it raises is its failure."""
    try:
        function(*arguments)
    except Refusal as error:
        told = str(error)
    else:
        return None
    assert told.strip()
    return told


@dataclass(frozen=True)
class Answer:
    code: int
    out: str
    err: str


def _stop(*arguments, **named):
    del arguments, named
    raise KeyboardInterrupt


@pytest.fixture(scope="session", name="refusal")
def _refusal():
    return refusal


@pytest.fixture(scope="session")
def workplace(tmp_path_factory):
    """An empty folder."""
    return tmp_path_factory.mktemp("workplace")


@pytest.fixture
def stopped(workplace, monkeypatch):
    """In an empty folder, with a program that leaves as if interrupted where it would begin to compute."""
    monkeypatch.chdir(workplace)
    monkeypatch.setenv("GLUCOLOOP_CACHE_DIR", "off")
    for place in _STOPS:
        monkeypatch.setattr(place, _stop)


@pytest.fixture
def asked(stopped, workplace) -> Callable[..., Answer]:
    """Ask the program; it must refuse in one sentence, or come to where it computes, and write nothing."""
    del stopped

    def ask(*arguments: str) -> Answer:
        before = sorted(workplace.iterdir())
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as left:
            main(list(arguments))
        answer = Answer(left.value.code or 0, out.getvalue(), err.getvalue())
        assert answer.code in (0, 2, 130), answer
        assert "Traceback" not in answer.err
        if answer.code == 2:
            *notes, told = answer.err.splitlines()
            assert told.startswith("glucoloop: "), answer
            assert told.endswith((".", "?")), answer
            assert told.isascii() or told.encode("utf-8")
            assert len(told) < 2200
            assert all(note.endswith(".") for note in notes), answer
            assert answer.out == ""
        assert sorted(workplace.iterdir()) == before
        return answer

    return ask
