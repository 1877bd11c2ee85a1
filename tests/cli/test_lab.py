"""``glucoloop lab`` writes the page, and nothing over another file."""

import errno
import os

import pytest

from glucoloop.lab.pack import page


@pytest.mark.long
def test_the_page_is_written_and_not_over_another_file(glucoloop, refused, tmp_path):
    place = tmp_path / "lab.html"
    done = glucoloop("lab", "--out", place)
    told = "Open it in a browser: it needs neither a server nor the network."
    assert (done.code, done.out) == (0, f"Wrote {place}, {len(page().encode()) / 1000:.0f} kB. {told}\n")
    assert place.read_text(encoding="utf-8") == page()
    place.write_text("mine", encoding="utf-8")
    assert "is there already; choose another file with --out, or add --overwrite" in refused("lab", "--out", place)
    assert place.read_text(encoding="utf-8") == "mine"
    assert glucoloop("lab", "--out", place, "--overwrite").code == 0
    assert place.read_text(encoding="utf-8") == page()


def test_a_place_that_cannot_be_written_is_refused(refused, tmp_path):
    assert "--out is missing; name the file, like --out lab.html" in refused("lab")
    assert "is a folder, not a file; move it away" in refused("lab", "--out", tmp_path)
    assert "No such file or directory; choose another place" in refused(
        "lab", "--out", tmp_path / "absent" / "lab.html"
    )


@pytest.mark.parametrize(
    ("reason", "mend"),
    [
        (errno.ENOSPC, "free some space or choose"),
        (errno.EACCES, "change its permissions or choose"),
        (errno.EROFS, "mount the disk for writing or choose"),
        (errno.EIO, "check the disk or choose"),
        (errno.EBADF, "choose"),
    ],
)
def test_a_page_that_cannot_be_written_has_a_mend(refused, tmp_path, monkeypatch, reason, mend):
    def refuse(*_):
        raise OSError(reason, os.strerror(reason))

    monkeypatch.setattr("glucoloop.storage.disk.put_file", refuse)
    told = refused("lab", "--out", tmp_path / "page.html")
    assert f"cannot be written: {os.strerror(reason)}; {mend} another place with --out" in told
