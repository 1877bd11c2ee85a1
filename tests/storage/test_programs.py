"""Nothing that JAX keeps in the folder of compiled programs is run that is not as it was written."""

import os

import pytest

from glucoloop.storage.disk import SUMS
from glucoloop.storage.programs import check_programs, seal_programs


@pytest.mark.skipif(os.name == "nt", reason="pipes and links")
def test_entries_that_are_not_as_they_were_written_are_removed(tmp_path):
    folder = tmp_path / "compiled"
    folder.mkdir()
    for name in ("whole", "edited", "cut", "relabelled"):
        (folder / f"{name}-cache").write_bytes(name.encode())
    seal_programs(folder)
    (folder / "edited-cache").write_bytes(b"edite!")
    (folder / "cut-cache").write_bytes(b"cu")
    (folder / "relabelled-cache").write_bytes((folder / "whole-cache").read_bytes())
    (folder / "unlisted-cache").write_bytes(b"of somebody")
    (tmp_path / "mine").write_text("mine")
    (folder / "link-cache").symlink_to(tmp_path / "mine")
    os.mkfifo(folder / "pipe-cache")
    (folder / "other").write_text("none of ours")
    check_programs(folder)
    assert sorted(entry.name for entry in folder.iterdir()) == [SUMS, "other", "whole-cache"]
    assert (tmp_path / "mine").read_text() == "mine"
