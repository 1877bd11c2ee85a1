"""An output folder is there whole, or everything is as it was."""

import contextlib
import os
from pathlib import Path

import pytest

from glucoloop.refusal import Refusal
from glucoloop.storage.folder import SUMS, output_folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def write(folder: Path, text: str, *, overwrite: bool = False) -> None:
    with output_folder(folder, overwrite=overwrite) as made:
        made.write("a.txt", text)


def test_folder_appears_with_its_parents_and_sums(tmp_path):
    write(tmp_path / "x" / "y", "one")
    assert contents(tmp_path / "x" / "y").keys() == {"a.txt", SUMS}
    assert not list((tmp_path / "x").glob(".*"))


def test_empty_folder_is_filled(tmp_path):
    (tmp_path / "out").mkdir()
    write(tmp_path / "out", "one")
    assert (tmp_path / "out" / "a.txt").read_text() == "one"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, OSError])
def test_failure_changes_nothing(tmp_path, error):
    write(tmp_path / "out", "one")
    before = contents(tmp_path)
    with contextlib.suppress(error), output_folder(tmp_path / "out", overwrite=True) as made:
        made.write("a.txt", "two")
        raise error
    with contextlib.suppress(error), output_folder(tmp_path / "new" / "out", overwrite=False) as made:
        raise error
    assert contents(tmp_path) == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_earlier_result_gives_way_only_when_asked(tmp_path):
    write(tmp_path / "out", "one")
    with pytest.raises(ValueError, match="holds an earlier result"):
        write(tmp_path / "out", "two")
    write(tmp_path / "out", "two", overwrite=True)
    assert (tmp_path / "out" / "a.txt").read_text() == "two"


def _add(folder: Path) -> None:
    (folder / "mine.txt").write_text("mine")


def _add_folder(folder: Path) -> None:
    (folder / "mine").mkdir()


def _edit(folder: Path) -> None:
    (folder / "a.txt").write_text("mine")


def _link(folder: Path) -> None:
    (folder / "a.txt").rename(folder.parent / "elsewhere.txt")
    (folder / "a.txt").symlink_to(folder.parent / "elsewhere.txt")


def _drop_sums(folder: Path) -> None:
    (folder / SUMS).unlink()


@pytest.mark.parametrize("change", [_add, _add_folder, _edit, _link, _drop_sums])
def test_what_somebody_changed_is_not_replaced(tmp_path, change):
    write(tmp_path / "out", "one")
    change(tmp_path / "out")
    before = contents(tmp_path)
    with pytest.raises(ValueError, match="so it is not replaced"):
        write(tmp_path / "out", "two", overwrite=True)
    assert contents(tmp_path) == before


def test_link_to_a_folder_is_followed(tmp_path):
    write(tmp_path / "real", "one")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write(tmp_path / "link", "two", overwrite=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "a.txt").read_text() == "two"


def test_root_is_refused(tmp_path):
    with pytest.raises(Refusal):
        write(Path("/"), "one", overwrite=True)


@pytest.mark.skipif(os.name == "nt", reason="flock")
def test_two_runs_at_once_are_refused(tmp_path):
    with output_folder(tmp_path / "out", overwrite=False) as made:
        made.write("a.txt", "one")
        with pytest.raises(Refusal, match=rf"another run writes to .*out \(process {os.getpid()}\); wait for it"):
            write(tmp_path / "out", "two")
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out/a.txt").read_text() == "one"


def test_what_a_killed_run_left_is_removed_or_put_back(tmp_path):
    write(tmp_path / "out", "one")
    (tmp_path / "out").rename(tmp_path / ".out.old.part")
    (tmp_path / ".out.part").mkdir()
    (tmp_path / ".out.part/a.txt").write_text("half")
    (tmp_path / ".out.lock").write_text("99999999\n")
    with pytest.raises(Refusal, match="holds an earlier result"):
        write(tmp_path / "out", "two")
    assert contents(tmp_path).keys() == {"out/a.txt", f"out/{SUMS}"}


def test_folder_is_as_open_as_others(tmp_path):
    write(tmp_path / "out", "one")
    (tmp_path / "plain").mkdir()
    assert (tmp_path / "out").stat().st_mode == (tmp_path / "plain").stat().st_mode
    os.listdir(tmp_path / "out")
