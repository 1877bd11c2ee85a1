"""Versions of the documentation lie side by side, a list names them, newest first, and no page is too long."""

import json

import pytest


@pytest.fixture
def site(docs_module):
    return docs_module("site_of_versions")


def test_versions_are_listed_newest_first(site, tmp_path):
    for version in ("0.9.0", "0.10.0", "0.10.0rc1"):
        (tmp_path / version).mkdir()
        (tmp_path / version / "index.html").write_text("")
    (tmp_path / "no-pages").mkdir()
    site.main([str(tmp_path), "--list"])
    listed = json.loads((tmp_path / "versions.json").read_text())
    assert [entry["version"] for entry in listed] == ["0.10.0", "0.10.0rc1", "0.9.0"]
    page = (tmp_path / "index.html").read_text()
    assert all(f'href="{entry["path"]}"' in page and (tmp_path / entry["path"]).exists() for entry in listed)


def test_a_site_without_a_folder_is_refused(site):
    with pytest.raises(SystemExit, match="folder of the site"):
        site.main([])


def test_a_page_that_is_too_long_is_found(docs_module, tmp_path):
    page_sizes = docs_module("page_sizes")
    (tmp_path / "_downloads").mkdir()
    for name, size in (("short.html", 300_000), ("long.html", 300_001), ("_downloads/lab.html", 10**6)):
        (tmp_path / name).write_bytes(b" " * size)
    assert list(page_sizes.too_long(tmp_path)) == [(tmp_path / "long.html", 300_001)]
