"""The folder of compiled programs is its owner's alone, and nothing in it is run that is not as it was written."""

import os
import stat

import pytest

from glucoloop.storage.disk import SUMS
from glucoloop.storage.programs import check_programs, private_folder, seal_programs

pytestmark = pytest.mark.skipif(os.name == "nt", reason="modes of files")


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "a/compiled"
    private_folder(place)
    return place


def mode(place):
    return stat.S_IMODE(place.stat().st_mode)


def test_folder_is_private(folder):
    assert mode(folder) == 0o700
    folder.chmod(0o755)
    private_folder(folder)
    assert mode(folder) == 0o700


@pytest.mark.parametrize("others", [0o770, 0o707, 0o777, 0o1777])
def test_folder_that_others_can_write_to_is_refused(folder, others):
    folder.chmod(others)
    with pytest.raises(ValueError, match="others can write to"):
        private_folder(folder)


def test_folder_that_others_can_replace_is_refused(folder):
    folder.parent.chmod(0o777)
    with pytest.raises(ValueError, match="another folder in the place of"):
        private_folder(folder)
    folder.parent.chmod(0o1777)  # as /tmp
    private_folder(folder)


def test_folder_of_somebody_else_is_refused(folder, monkeypatch):
    monkeypatch.setattr(os, "getuid", lambda: os.stat(folder).st_uid + 1)
    with pytest.raises(ValueError, match="belongs to another user"):
        private_folder(folder)


def test_link_in_place_of_the_folder_is_refused(folder, tmp_path):
    (tmp_path / "link").symlink_to(folder)
    with pytest.raises(ValueError, match="is a symbolic link, not a folder"):
        private_folder(tmp_path / "link")


def entries(folder):
    return sorted(entry.name for entry in folder.iterdir())


def test_entries_that_are_not_as_they_were_written_are_removed(folder, tmp_path):
    for name in ("whole", "edited", "cut", "relabelled"):
        (folder / f"{name}-cache").write_bytes(name.encode())
    seal_programs(folder)
    (folder / "edited-cache").write_bytes(b"edite!")
    (folder / "cut-cache").write_bytes(b"cu")
    (folder / "relabelled-cache").write_bytes((folder / "whole-cache").read_bytes())
    (folder / "unlisted-cache").write_bytes(b"of somebody")
    (folder / "unlisted.kept").write_bytes(b"of somebody")
    (tmp_path / "mine").write_text("mine")
    (folder / "link-cache").symlink_to(tmp_path / "mine")
    os.mkfifo(folder / "pipe-cache")
    (folder / "other").write_text("none of ours")
    check_programs(folder)
    assert entries(folder) == [SUMS, "other", "whole-cache"]
    assert (tmp_path / "mine").read_text() == "mine"


def test_size_is_bounded_and_the_oldest_go_first(folder):
    for age, name in enumerate("abcd"):
        (folder / f"{name}-cache").write_bytes(b"x" * 100)
        seal_programs(folder)
        os.utime(folder / f"{name}-cache", (1e9 - age, 1e9 - age))
    check_programs(folder, most_bytes=250)
    assert entries(folder) == [SUMS, "a-cache", "b-cache"]
