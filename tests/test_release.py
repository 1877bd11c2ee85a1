"""The script that makes a release: what it refuses, and that it gives the same bytes again."""

import hashlib
import importlib
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason=".ci/run is a shell script"),
    pytest.mark.skipif(shutil.which("git") is None, reason="needs git"),
]
PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "glucoloop"
dynamic = ["version"]
requires-python = ">=3.11"
[tool.hatch.version]
path = "src/glucoloop/__init__.py"
"""
CHECKS = '#!/bin/sh\necho "checked in $PWD"\nexit 0\n'


@pytest.fixture(scope="module")
def dev_release():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "dev")
        yield importlib.import_module("release")


class Project:
    """A small repository with the files that a release reads, and a tag."""

    def __init__(self, dev_release, folder):
        self.module, self.folder = dev_release, folder
        folder.mkdir()
        self.write("pyproject.toml", PROJECT)
        self.write("src/glucoloop/__init__.py", '__version__ = "1.2.0"\n')
        self.write("CITATION.cff", "cff-version: 1.2.0\nversion: 1.2.0\n")
        self.write("CHANGELOG.md", "# Changelog\n\n## [1.2.0] - 2026-11-27\n")
        self.write(".gitignore", "/dist/\n")
        self.write(".ci/run", CHECKS).chmod(0o755)
        self.git("init", "--quiet")
        self.tag("v1.2.0")

    def write(self, name, text):
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    def git(self, *words):
        who = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false")
        subprocess.run(["git", *who, *words], cwd=self.folder, check=True, capture_output=True)

    def tag(self, name):
        self.git("add", "--all")
        self.git("commit", "--quiet", "--message", "all")
        self.git("tag", "--force", "--annotate", "--message", name, name)

    def release(self, tag="v1.2.0", ran=None):
        self.module.release(tag, sys.executable, ran, self.folder)

    @property
    def dist(self):
        return self.folder / "dist"

    def log(self):
        [log] = self.dist.glob("ci-run-*.log")
        return log


@pytest.fixture
def project(dev_release, tmp_path):
    return Project(dev_release, tmp_path / "project")


@pytest.mark.long
def test_a_release_is_made_twice_with_the_same_bytes(project, capsys):
    project.release()
    names = {"glucoloop-1.2.0-py3-none-any.whl", "glucoloop-1.2.0.tar.gz"}
    first = {name: (project.dist / name).read_bytes() for name in names}
    told = capsys.readouterr().out
    for name, held in first.items():
        assert f"{hashlib.sha256(held).hexdigest()}  {name}\n" in told
    assert re.search(r"^checked in .*glucoloop-release-", project.log().read_text(), re.M)
    log = project.log().rename(project.folder.parent / "kept.log")
    shutil.rmtree(project.dist)
    project.release(ran=log)
    assert {name: (project.dist / name).read_bytes() for name in names} == first
    assert not list(project.dist.glob("*.log")), "checks whose log was given were carried out again"
    (project.dist / "glucoloop-1.2.0.tar.gz").write_bytes(b"published")
    with pytest.raises(SystemExit):
        project.release(ran=log)
    assert "is there with other bytes" in capsys.readouterr().err
    assert (project.dist / "glucoloop-1.2.0.tar.gz").read_bytes() == b"published"


def spoil(project, what):
    """Spoil one thing of a project that could be released."""
    match what:
        case "changed":
            project.write("CITATION.cff", "changed")
        case "new file":
            project.write("left.py", "")
        case "elsewhere":
            project.write("left.py", "")
            project.git("add", "--all")
            project.git("commit", "--quiet", "--message", "later")
        case "no tag":
            project.git("tag", "--delete", "v1.2.0")
        case "version":
            project.write("src/glucoloop/__init__.py", '__version__ = "1.3.0"\n')
        case "citation":
            project.write("CITATION.cff", "cff-version: 1.2.0\n")
        case "no section":
            project.write("CHANGELOG.md", "## [1.2.0] - Unreleased\n")
        case "red":
            project.write(".ci/run", "#!/bin/sh\necho wrong\nexit 3\n")
    if what in ("version", "citation", "no section", "red"):
        project.tag("v1.2.0")


@pytest.mark.parametrize(
    ("what", "told"),
    [
        ("changed", "the tree is not clean; 1 files differ from v1.2.0 or are new, as CITATION.cff."),
        ("new file", "the tree is not clean; 1 files differ from v1.2.0 or are new, as left.py."),
        ("elsewhere", "which is not checked out. Do that with: git checkout v1.2.0"),
        ("no tag", "there is no tag 'v1.2.0' (there is: none)"),
        ("version", "src/glucoloop/__init__.py has version 1.3.0 and the tag is 'v1.2.0', which wants 1.2.0."),
        ("citation", "CITATION.cff has no version and the tag is 'v1.2.0', which wants 1.2.0."),
        ("no section", "CHANGELOG.md has no section '## [1.2.0] - ' with the date of the release."),
        ("red", "ends with 'exit status 3' and not with 'exit status 0'."),
    ],
)
def test_what_is_not_right_is_refused(project, capsys, what, told):
    spoil(project, what)
    with pytest.raises(SystemExit) as left:
        project.release()
    assert left.value.code == 2
    assert told in capsys.readouterr().err
    assert not list(project.dist.glob("glucoloop-*"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "cannot be read"),
        ("", "is not of this commit"),
        ("commit 0123\nexit status 0\n", "is not of this commit"),
        ("COMMIT\nall passed\n", "ends with 'all passed' and not with 'exit status 0'"),
    ],
    ids=["absent", "empty", "another commit", "broken off"],
)
def test_a_log_that_does_not_say_green_is_refused(project, capsys, text, told):
    log = project.folder.parent / "given.log"
    if text is not None:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=project.folder, capture_output=True, text=True).stdout
        log.write_text(text.replace("COMMIT", f"commit {head.strip()}"))
    with pytest.raises(SystemExit) as left:
        project.release(ran=log)
    assert left.value.code == 2
    assert told in capsys.readouterr().err
    assert not list(project.dist.glob("glucoloop-*"))


def test_the_words_of_the_command(dev_release, capsys):
    assert dev_release.release_arguments(["v1.2.0"]) == ("v1.2.0", None)
    assert dev_release.release_arguments(["v1.2.0", "--ran", "a.log"]) == ("v1.2.0", Path("a.log"))
    assert dev_release.release_arguments(["--ran", "a.log", "v1.2.0"]) == ("v1.2.0", Path("a.log"))
    for words in ([], ["--ran", "a.log"], ["v1", "v2"], ["--all"]):
        with pytest.raises(SystemExit, match="2"):
            dev_release.release_arguments(words)
        assert "release takes a tag" in capsys.readouterr().err
