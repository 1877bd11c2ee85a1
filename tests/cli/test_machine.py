"""What the machine refuses or ends is told in a sentence and leaves no half of a result; a bug keeps its traceback."""

import errno
import os
import subprocess
import sys
from concurrent.futures import CancelledError
from pathlib import Path

import polars as pl
import pytest

from glucoloop.cli import main
from glucoloop.cli.errors import BUG
from glucoloop.situations import run as situation
from glucoloop.storage.results import Results


def test_folder_that_is_taken_is_refused_before_anything_is_computed(refused, tmp_path, monkeypatch):
    monkeypatch.setattr("glucoloop.studies.run.study.close_the_loop", lambda *_: pytest.fail("it was computed"))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    assert "is not empty" in refused("run", "--out", "out")
    assert "mine.txt, which glucoloop did not write" in refused("run", "--out", "out", "--overwrite")
    assert "is a file" in refused("run", "--out", "file", "--overwrite")
    assert "the folder you are in" in refused("run", "--out", ".")
    assert (tmp_path / "out" / "mine.txt").read_text() == "mine"


@pytest.mark.long
def test_full_disk_leaves_the_old_folder(glucoloop, refused, tmp_path, monkeypatch):
    assert glucoloop("run", "--duration", 100, "--out", "out").code == 0
    before = {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()}

    def full(descriptor):
        del descriptor
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    told = refused("run", "--duration", 200, "--out", "out", "--overwrite")
    assert "No space left on device" in told
    assert {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()} == before
    assert [file.name for file in tmp_path.iterdir()] == ["out"]


def test_interrupt_leaves_with_130_and_nothing_written(glucoloop, tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("glucoloop.studies.run.study.close_the_loop", interrupt)
    answer = glucoloop("run", "--out", "a/b")
    assert answer.code == 130
    assert answer.err == "glucoloop: interrupted, nothing was written.\n"
    assert list(tmp_path.iterdir()) == []


LONG_WORK = {
    "identify": "glucoloop.studies.identification.study._from_patient",
    "bound": "glucoloop.studies.bound.study._bounds",
    "tune": "glucoloop.studies.tuning.study.results_of",
    "detect": "glucoloop.studies.detection.study.results_of",
    "compare --controller mpc --controller pid": "glucoloop.studies.run.study.close_the_loop",
}


@pytest.mark.parametrize("line", LONG_WORK)
def test_interrupt_of_long_work_leaves_nothing_half_written(glucoloop, tmp_path, monkeypatch, line):
    monkeypatch.setattr(LONG_WORK[line], raising(KeyboardInterrupt()))
    answer = glucoloop(*line.split(), "--out", "out")
    assert (answer.code, answer.out, answer.err) == (130, "", "glucoloop: interrupted, nothing was written.\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_interrupt_of_a_search_keeps_what_was_tried(glucoloop, tmp_path, monkeypatch):
    monkeypatch.setattr("glucoloop.studies.robust.search.SearchEngine.missing", raising(KeyboardInterrupt()))
    answer = glucoloop("robust", "--people", "50", "--out", "out")
    assert (answer.code, answer.out) == (130, "")
    assert answer.err.startswith("glucoloop: interrupted; 0 of ")
    assert answer.err.endswith("candidates are kept, the same command goes on.\n")
    assert list(tmp_path.iterdir()) == []


def lost_scheduler():
    from distributed.comm import CommClosedError

    raise CommClosedError("in <TCP (closed)>: Stream is closed")


def loop_of_links():
    try:
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), "out")
    except OSError as error:
        raise error


def raising(error):
    def fail(*given, **named):
        raise error

    return fail


REFUSED_BY_THE_MACHINE = {
    "memory": (raising(MemoryError()), "there is not enough memory for this"),
    "memory of XLA": (
        raising(RuntimeError("RESOURCE_EXHAUSTED: Out of memory")),
        "there is not enough memory for this",
    ),
    "memory of XLA as it computes": (
        raising(RuntimeError("INTERNAL: Error dispatching computation: Out of memory allocating 30257971200 bytes.")),
        "there is not enough memory for this",
    ),
    "memory of the system": (
        raising(OSError(errno.ENOMEM, "Cannot allocate memory")),
        "there is not enough memory for this",
    ),
    "memory of Polars": (
        raising(pl.exceptions.ComputeError("out of memory")),
        "there is not enough memory for this",
    ),
    "platform": (
        raising(RuntimeError("Unable to initialize backend 'foo': Backend 'foo' is not in the list")),
        "JAX cannot start: Unable to initialize backend 'foo'",
    ),
    "scheduler": (lost_scheduler, "the connection to the Dask scheduler was lost (in <TCP (closed)>"),
    "cancelled": (raising(CancelledError()), "the connection to the Dask scheduler was lost (CancelledError)"),
    "full disk": (raising(OSError(errno.ENOSPC, "No space left on device")), "written; free some space or choose"),
    "no permission": (raising(OSError(errno.EACCES, "Permission denied")), "written; change its permissions or"),
    "read only": (raising(OSError(errno.EROFS, "Read-only file system")), "written; mount the disk for writing or"),
    "links": (loop_of_links, "out: Too many levels of symbolic links, nothing was written; choose another place"),
}


@pytest.mark.parametrize("what", REFUSED_BY_THE_MACHINE)
def test_what_the_machine_refuses_is_told_in_a_sentence(refused, tmp_path, monkeypatch, what):
    fail, told = REFUSED_BY_THE_MACHINE[what]
    monkeypatch.setattr("glucoloop.studies.run.study.close_the_loop", lambda *_: fail())
    assert told in refused("run", "--out", "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (
            OSError(errno.EIO, "Input/output error"),
            2,
            "Input/output error, the results are in out; check the disk or choose another place",
        ),
        (KeyboardInterrupt(), 130, "interrupted, the results are in out"),
    ],
)
def test_nothing_is_said_to_be_unwritten_that_was_written(glucoloop, tmp_path, monkeypatch, error, code, told):
    monkeypatch.setattr("glucoloop.studies.run.study.results_of", lambda *_: Results({"summary": {"sentences": []}}))
    monkeypatch.setattr("glucoloop.studies.run.study.files_of", lambda *_, **__: {"a.txt": b"a"})
    monkeypatch.setattr("glucoloop.studies.run.study.tables", lambda *_: ())
    monkeypatch.setattr("glucoloop.studies.run.study.sentences", raising(error))
    answer = glucoloop("run", "--out", "out")
    assert (answer.code, answer.err) == (code, f"glucoloop: {told}.\n")
    assert (tmp_path / "out/a.txt").read_text() == "a"


def test_folder_behind_links_that_lead_nowhere_is_refused(refused, tmp_path, monkeypatch):
    monkeypatch.setattr("glucoloop.studies.run.study.close_the_loop", lambda *_: pytest.fail("it was computed"))
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    for out in ("a", "a/out"):
        assert "a" in refused("run", "--out", out)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a", "b"]


@pytest.mark.long
def test_closed_streams_are_no_bug(tmp_path):
    """A shell's ``2>&-`` and ``>&-``."""
    for closed, code in (("2>&-", 2), (">&-", 2), (">&- 2>&-", 2)):
        line = f"{sys.executable} -m glucoloop run --meal 5x {closed}"
        done = subprocess.run(["sh", "-c", line], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == code
        assert "Traceback" not in done.stderr
        assert done.stdout == ""


def test_a_reader_that_leaves_ends_a_command_in_silence(tmp_path):
    line = f"{sys.executable} -m glucoloop list --json | head -c 10 >/dev/null; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("141\n", "")


@pytest.mark.long
def test_platform_that_jax_does_not_have_is_told(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "glucoloop", "run", "--duration", "60"],
        cwd=tmp_path,
        env={**os.environ, "JAX_PLATFORMS": "foo"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("glucoloop: JAX cannot start as JAX_PLATFORMS=foo asks:")
    assert done.stderr.count("\n") == 1


def test_bug_keeps_its_traceback(monkeypatch):
    """A ValueError from outside the library was not foreseen."""
    monkeypatch.setattr("glucoloop.studies.run.study.close_the_loop", lambda *_: int("bug"))
    with pytest.raises(ValueError, match="invalid literal"):
        main(["run"])


def test_bug_within_the_package_is_no_mistake_of_the_user(monkeypatch):
    made: dict = {}
    exec(compile("def bug(*_, **__):\n    return float('abc')\n", situation.__file__, "exec"), made)
    monkeypatch.setattr("glucoloop.cli.study_command.read_root", made["bug"])
    with pytest.raises(ValueError, match="could not convert") as raised:
        main(["run"])
    assert raised.value.__notes__ == [BUG]


def test_unwritable_place_is_told(refused, tmp_path):
    if os.geteuid() == 0:
        # For root no folder is closed; what is not a folder is.
        (tmp_path / "file").write_text("")
        assert "since a part of its path is a file" in refused("run", "--out", "file/out")
        return
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    assert "cannot be written" in refused("run", "--out", Path("closed") / "out")


LACKING = {
    "adversary --out out": ("cmaes", "the search for the worst errors needs cmaes"),
    "adversary": ("cmaes", "the search for the worst errors needs cmaes"),
    "robust --out out": ("optuna", "a sampler other than random needs optuna"),
    "trial --dask local --out out": ("distributed", "a cluster needs distributed"),
}


@pytest.mark.parametrize("line", LACKING)
def test_missing_extra_is_told_before_anything_is_computed(refused, tmp_path, monkeypatch, line):
    package, told = LACKING[line]
    for engine in (
        "studies.adversary.study.search",
        "studies.robust.study.search",
        "trials.engine.prepare",
    ):
        monkeypatch.setattr(f"glucoloop.{engine}", lambda *_, **__: pytest.fail("it was computed"))
    monkeypatch.setitem(sys.modules, package, None)
    assert told in refused(*line.split(" "))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("chip", "told"), [("host", "no C compiler"), ("cortex-m4f", "take --chip host")])
def test_missing_tool_of_a_chip_is_told_before_anything_is_computed(refused, monkeypatch, chip, told):
    monkeypatch.setattr("glucoloop.studies.hil.study.model_for", lambda *_: pytest.fail("it was computed"))
    monkeypatch.setattr("glucoloop.firmware.hil.build.compiler", lambda: None)
    monkeypatch.setattr("shutil.which", lambda _: None)
    assert told in refused("hil", "--chip", chip)
