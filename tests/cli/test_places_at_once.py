"""A place that results cannot have is refused by every command before anything is computed for it."""

import hashlib

import pytest

from glucoloop.cli.app import command_of, names
from glucoloop.storage.disk import SUMS

WRITING = [name for name in names() if any(option.key == "out" for option in command_of(name).options)]
FILES = {"lab", "records"}
"""Commands that write one file in place of a folder."""
NEEDED = {
    "records": ("a.csv",),
    "twin": ("a.csv",),
    "replay": ("a.csv",),
    "days": ("a.csv",),
    "report": ("a.csv",),
    "forecast": ("a.csv",),
}
FOLDERS = [name for name in WRITING if name not in FILES]


def result(folder, *names):
    """A folder as a command leaves it, with a list of digests that is right."""
    folder.mkdir()
    for name in names:
        (folder / name).write_text(name, encoding="utf-8")
    sums = (f"{hashlib.sha256(name.encode()).hexdigest()}  {name}\n" for name in sorted(names))
    (folder / SUMS).write_text("".join(sums), encoding="utf-8")
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.fixture
def computing(monkeypatch):
    """Fail at once where a request is completed, or a record or a page is made, which is the first work of all."""

    def computed(*_, **__):
        pytest.fail("it was computed")

    places = (
        "cli.study_command.configuration_of",
        "cli.export.configuration_of",
        "records.read_record",
        "lab.pack.page",
    )
    for place in places:
        monkeypatch.setattr(f"glucoloop.{place}", computed)


@pytest.mark.usefixtures("computing")
@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)], ids=["", "overwrite"])
@pytest.mark.parametrize("command", FOLDERS)
def test_results_of_another_command_are_refused_at_once_and_stay(refused, tmp_path, command, overwrite):
    other = ("robust.toml", "robust.json") if command == "compare" else ("compare.toml", "metrics.json")
    before = result(tmp_path / "out", *other)
    answer = refused(command, *NEEDED.get(command, ()), "--out", "out", *overwrite)
    assert answer.startswith("out holds "), answer
    assert answer.endswith("; choose another folder with --out."), answer
    assert {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()} == before


@pytest.mark.usefixtures("computing")
@pytest.mark.parametrize("command", ["run", "export"])
def test_a_run_and_an_exported_controller_do_not_replace_one_another(refused, tmp_path, command):
    before = result(tmp_path / "out", "run.toml", {"run": "controller.c", "export": "metrics.json"}[command])
    assert "out holds the results of another command" in refused(command, "--out", "out", "--overwrite")
    assert {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()} == before


@pytest.mark.usefixtures("computing")
@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)], ids=["", "overwrite"])
@pytest.mark.parametrize("command", WRITING)
def test_a_place_below_a_file_is_refused_at_once(refused, tmp_path, command, overwrite):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    answer = refused(command, *NEEDED.get(command, ()), "--out", "file/out", *overwrite)
    assert "choose another" in answer, answer
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.usefixtures("computing")
@pytest.mark.parametrize("command", WRITING)
def test_a_disk_that_refuses_is_told_at_once(refused, tmp_path, monkeypatch, command):
    def read_only(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("os.open", read_only)
    answer = refused(command, *NEEDED.get(command, ()), "--out", "out")
    assert "Permission denied" in answer, answer
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("computing")
@pytest.mark.parametrize("command", ["trial", "adversary"])
def test_a_changed_file_of_earlier_work_is_told_before_it_is_begun_again(refused, tmp_path, command):
    record = {"trial": "trial.json", "adversary": "origin.json"}[command]
    result(tmp_path / "out", record, f"{command}.toml")
    (tmp_path / "out" / f"{command}.toml").write_text("mine", encoding="utf-8")
    assert f"{command}.toml, which was changed" in refused(command, "--out", "out", "--overwrite")
