"""The command line in this process: what it prints and how it leaves."""

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from glucoloop.cli import main
from glucoloop.component.code import entry_point, entry_points

EXAMPLES = Path(__file__).parents[2] / "examples"


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
def install(tmp_path, monkeypatch) -> Callable[[str, str, str, str], None]:
    """Put a module of the examples into the current folder, as a package that adds one of its names to a group."""
    installed = []

    def installing(module: str, group: str, name: str, attribute: str) -> None:
        shutil.copy(EXAMPLES / f"{module}.py", tmp_path)
        package = tmp_path / f"{module}-1.0.dist-info"
        package.mkdir()
        (package / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (package / "entry_points.txt").write_text(f"[glucoloop.{group}]\n{name} = {module}:{attribute}\n")
        monkeypatch.syspath_prepend(str(tmp_path))
        monkeypatch.chdir(tmp_path)
        entry_point.cache_clear()
        entry_points.cache_clear()
        installed.append(module)

    yield installing
    entry_point.cache_clear()
    entry_points.cache_clear()
    for module in installed:
        sys.modules.pop(module, None)


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
