"""``glucoloop cache``: what is kept is counted and removed, and nothing else."""

import pytest


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "kept"
    monkeypatch.setenv("GLUCOLOOP_CACHE_DIR", str(place))
    return place


def test_what_is_kept_is_counted_and_removed(glucoloop, folder):
    assert glucoloop("cache").out == f"{folder}: 0 files of 0.0 MB.\n"
    folder.mkdir(0o700)
    for name in ("a.kept", "jit_b-cache", "letter"):
        (folder / name).write_bytes(bytes(100_000))
    answer = glucoloop("cache", "--json").json
    assert (answer["folder"], answer["files"], answer["size_bytes"]) == (str(folder), 2, 200_000)
    assert glucoloop("cache", "--clear").out == f"{folder}: 2 files of 0.2 MB removed.\n"
    assert [place.name for place in folder.iterdir()] == ["letter"]


def test_a_folder_of_others_is_left_alone(glucoloop, folder):
    folder.mkdir()
    folder.chmod(0o777)
    (folder / "a.kept").write_bytes(b"of somebody")
    answer = glucoloop("cache", "--clear")
    assert answer.code == 2
    assert "others can write to" in answer.err
    assert (folder / "a.kept").exists()


def test_nothing_is_kept_where_it_is_off(glucoloop, monkeypatch):
    monkeypatch.setenv("GLUCOLOOP_CACHE_DIR", "off")
    answer = glucoloop("cache")
    assert answer.code == 2
    assert "GLUCOLOOP_CACHE_DIR is off" in answer.err
