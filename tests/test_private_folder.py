"""What is run or accepted lies where nobody else can write, nor put another folder in its place."""

import os
import tempfile
from pathlib import Path

import pytest

from glucoloop import Refusal, private_folder
from glucoloop.cli import jax_cache
from glucoloop.private_folder import private_temporary_folder, refuse_of_others

pytestmark = pytest.mark.skipif(os.name == "nt", reason="modes of files")


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "a/b/c/compiled"
    place.mkdir(parents=True, mode=0o700)
    for above in ("a", "a/b", "a/b/c"):
        (tmp_path / above).chmod(0o755)
    return place


def above(folder, levels):
    return folder.parents[levels - 1]


@pytest.mark.parametrize("levels", [1, 2, 3])
@pytest.mark.parametrize("mode", [0o777, 0o757])
def test_a_folder_above_that_others_may_write_to_is_refused(folder, levels, mode):
    refuse_of_others(folder)
    above(folder, levels).chmod(mode)
    with pytest.raises(Refusal, match=f"since they can write to {above(folder, levels)}$"):
        refuse_of_others(folder)
    above(folder, levels).chmod(mode | 0o1000)  # as /tmp: what others own there, nobody renames
    refuse_of_others(folder)


@pytest.mark.parametrize("own", [True, False])
def test_a_group_of_one_is_nobody_else(folder, monkeypatch, own):
    monkeypatch.setattr(private_folder, "_is_own_group", lambda group: own)
    above(folder, 2).chmod(0o775)
    if own:
        refuse_of_others(folder)
    else:
        with pytest.raises(Refusal, match="others can put another folder in the place of"):
            refuse_of_others(folder)


def test_a_folder_above_that_is_somebody_elses_is_refused(folder, monkeypatch):
    status, other = os.lstat, above(folder, 2)

    def lstat(place):
        found = status(place)
        return os.stat_result((*found[:4], 12345, *found[5:])) if Path(place) == other else found

    monkeypatch.setattr(private_folder.os, "lstat", lstat)
    with pytest.raises(Refusal, match=f"since {other} is theirs"):
        refuse_of_others(folder)


def test_the_way_of_a_link_is_checked_too(folder, tmp_path):
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    (tmp_path / "link").symlink_to(tmp_path / "open/hop")
    (tmp_path / "open/hop").symlink_to(folder.parent)
    with pytest.raises(Refusal, match=f"since they can write to {tmp_path}/open$"):
        refuse_of_others(tmp_path / "link/compiled")
    (tmp_path / "open").chmod(0o755)
    refuse_of_others(tmp_path / "link/compiled")


def test_a_link_to_a_folder_of_all_is_refused(folder, tmp_path):
    (tmp_path / "link").symlink_to(folder)
    refuse_of_others(tmp_path / "link")
    folder.chmod(0o1777)
    with pytest.raises(Refusal, match="others can write to"):
        refuse_of_others(tmp_path / "link")


def test_a_ring_of_links_is_refused(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises((OSError, Refusal)):
        refuse_of_others(tmp_path / "a/compiled")


def test_a_folder_that_does_not_exist_yet_is_judged_by_those_above(folder):
    refuse_of_others(folder / "new/compiled")
    above(folder, 3).chmod(0o777)
    with pytest.raises(Refusal, match="others can put another folder"):
        refuse_of_others(folder / "new/compiled")


def test_results_are_not_kept_below_a_folder_of_all_and_a_note_says_so(folder, capsys):
    above(folder, 3).chmod(0o777)
    assert not jax_cache._usable(folder)
    assert not jax_cache._usable(folder)
    [note] = capsys.readouterr().err.splitlines()
    assert note.startswith(f"Compiled programs are not kept: others can put another folder in the place of {folder}")
    assert list(folder.iterdir()) == []


def test_programs_are_not_made_in_a_temporary_folder_that_others_can_replace(folder, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with private_temporary_folder("made-") as made:
        assert made.is_dir()
    folder.chmod(0o777)
    with pytest.raises(Refusal, match="set TMPDIR to a folder of yours"), private_temporary_folder("made-"):
        pytest.fail("it was made")
    assert list(folder.iterdir()) == []
