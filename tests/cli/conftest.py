"""The command line in this process: what it prints and how it leaves."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from glucoloop.cli import main


@dataclass(frozen=True)
class Answer:
    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


Command = Callable[..., Answer]


@pytest.fixture(scope="session", autouse=True)
def _no_cache_of_mine():
    """Compiled code goes where that of all other tests goes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GLUCOLOOP_CACHE_DIR", "off")
        yield


@pytest.fixture
def glucoloop(capsys, monkeypatch, tmp_path) -> Command:
    """Run a command in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def command(*arguments: object) -> Answer:
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return Answer(code=left.value.code or 0, out=captured.out, err=captured.err)

    return command


@pytest.fixture
def refused(glucoloop) -> Callable[..., str]:
    """Run a command that must be refused in one sentence, and nothing else; returns the sentence."""

    def command(*arguments: object) -> str:
        answer = glucoloop(*arguments)
        assert answer.code == 2
        assert answer.out == ""
        assert answer.err.startswith("glucoloop: ")
        assert answer.err.count("\n") == 1
        return answer.err.removeprefix("glucoloop: ").strip()

    return command
