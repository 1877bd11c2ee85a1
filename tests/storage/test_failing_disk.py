"""Every operation on the disk made to fail, and every one the last of its process: nothing is lost or left behind."""

import contextlib
import errno
import functools
import hashlib
import json
import os
import shutil

import pytest

from glucoloop.schema.tables import parquet_size
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.folder import output_folder
from glucoloop.trials.folder import TrialOrigin, done_shards

pytestmark = pytest.mark.usefixtures("_quick_disk")
OPERATIONS = (
    *("open", "close", "write", "fsync", "ftruncate", "fstat", "lstat", "listdir"),
    *("mkdir", "rmdir", "unlink", "rename", "replace"),
)
"""Of `os`, which the layer uses through one module."""
EXCHANGE = "exchange"


class DiedError(BaseException):
    """The process is no more: nothing that would follow happens."""


class FailingDisk:
    """`os`, of which the n-th operation fails, or is the last one."""

    def __init__(self, fails_at, error=None):
        self.calls, self.fails_at, self.error = 0, fails_at, error
        self.path = os.path
        self.died = False
        self.open_now = set()

    def __getattr__(self, name):
        real = getattr(os, name)
        if name not in OPERATIONS:
            return real

        def operation(*arguments):
            if self.died:
                raise DiedError
            self.calls += 1
            if self.calls == self.fails_at:
                self.fail(name, arguments)
            return self.note(name, arguments, real(*arguments))

        return operation

    def fail(self, name, arguments):
        if name == "close":  # the system takes the file back, whatever it says
            os.close(*arguments)
            self.open_now.discard(arguments[0])
        if name == "write":  # half of it arrives
            os.write(arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2])
        if self.error is not None:
            raise self.error
        self.died = True
        raise DiedError

    def note(self, name, arguments, result):
        if name == "open":
            self.open_now.add(result)
        elif name == "close":
            self.open_now.discard(arguments[0])
        return result

    def bury(self):
        """What the system does with the files of a process that died."""
        for descriptor in self.open_now:
            with contextlib.suppress(OSError):
                os.close(descriptor)


@contextlib.contextmanager
def failing(monkeypatch, fails_at, error=None, *, exchanges=True):
    """A disk that fails at an operation; yields it."""
    with monkeypatch.context() as patch:
        broken = FailingDisk(fails_at, error)
        patch.setattr(disk, "os", broken)
        exchange = disk.exchange

        def counted(one, other):
            if broken.died:
                raise DiedError
            broken.calls += 1
            if broken.calls == fails_at:
                broken.fail(EXCHANGE, ())
            return exchange(one, other) if exchanges else False

        patch.setattr(disk, "exchange", counted)
        try:
            yield broken
        finally:
            broken.bury()


def contents(folder):
    return {
        str(entry.relative_to(folder)): entry.read_bytes() if entry.is_file() else None
        for entry in sorted(folder.rglob("*"))
    }


ERRORS = {
    "dies": None,
    "full disk": OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)),
    "no memory": MemoryError(),
}
EXPECTED = (DiedError, ValueError, OSError, MemoryError)


def shards_of(folder):
    return {file: data for file, data in contents(folder).items() if "/0" in file and data is not None}


@pytest.mark.long
@pytest.mark.parametrize(
    ("begun", "error"),
    [
        *((begun, "dies") for begun in ("new", "begun", "finished", "other")),
        *((begun, "full disk") for begun in ("begun", "finished", "other")),
        ("begun", "no memory"),  # has no branch of its own
    ],
)
def test_each_operation_of_a_trial(tmp_path, tiny, monkeypatch, error, begun):
    """The same command ends in the same folder as one that nothing happened to; what was finished is never lost."""
    monkeypatch.setattr("glucoloop.schema.tables.parquet_size", functools.cache(parquet_size))
    tiny, other = tiny
    out, whole, start = tmp_path / "out", tmp_path / "whole", tmp_path / "start"
    tiny.run(whole)
    expected = contents(whole)
    overwrite = begun in ("finished", "other")
    if begun == "other":
        other.run(start)
    elif begun != "new":
        shutil.copytree(whole, start)
    if begun == "begun":
        shutil.rmtree(start / "shards/00001")
        (start / SUMS).unlink()
    for fails_at in range(1, 10_000):
        if out.exists():
            shutil.rmtree(out)
        if start.exists():
            shutil.copytree(start, out)
        with failing(monkeypatch, fails_at, ERRORS[error]) as broken, contextlib.suppress(*EXPECTED):
            tiny.run(out, overwrite=overwrite)
        if broken.calls < fails_at:
            break
        there = shards_of(out) if out.exists() else {}
        # What has its name is whole, and is of one trial.
        if (out / "trial.json").exists():
            for shard in done_shards(out, TrialOrigin.of_folder(out)):
                for name, value in disk.read_sums(shard.path).items():
                    assert hashlib.sha256((shard.path / name).read_bytes()).hexdigest() == value
        if begun == "begun":
            assert there.items() >= shards_of(start).items(), "a shard that was done is lost"
        tiny.run(out, overwrite=overwrite)
        assert contents(out) == expected, f"after operation {fails_at}"
    assert fails_at > 50


@pytest.mark.long
@pytest.mark.parametrize(
    ("begun", "error"),
    [("other", "dies"), *(("begun", error) for error in ERRORS)],
)
def test_each_operation_of_a_folder_of_rows(tmp_path, counting, monkeypatch, error, begun):
    """As of a trial, whose folder a search and every other study share."""
    count, other = counting(), counting(keys={"seed": 2})
    out, start = tmp_path / "out", tmp_path / "start"
    count.run(tmp_path / "whole")
    expected = contents(tmp_path / "whole")
    if begun == "other":
        other.run(start)
    else:
        with count.opened(start) as folder:
            folder.add(0)
    for fails_at in range(1, 10_000):
        if out.exists():
            shutil.rmtree(out)
        shutil.copytree(start, out)
        with failing(monkeypatch, fails_at, ERRORS[error]) as broken, contextlib.suppress(*EXPECTED):
            count.run(out, overwrite=begun == "other")
        if broken.calls < fails_at:
            break
        if begun == "begun":
            with count.opened(out) as folder:
                assert len(folder.rows) >= 1, "a row that was kept is lost"
        count.run(out, overwrite=begun == "other")
        assert contents(out) == expected, f"after operation {fails_at}"
    assert fails_at > 50


def test_rows_of_other_arithmetic_are_not_mixed(tmp_path, counting):
    count = counting()
    with count.opened(tmp_path / "out") as folder:
        folder.add(0)
    place = tmp_path / "out/origin.json"
    found = json.loads(place.read_text())
    other = {**found, "arithmetic": {**found["arithmetic"], "jax": "0.0.1"}}
    for text in (json.dumps(other), "nonsense", "[]"):
        place.write_text(text)
        with pytest.raises(ValueError, match=r"was computed with jax 0\.0\.1, and here it is|is damaged"):
            count.run(tmp_path / "out")
    count.run(tmp_path / "out", overwrite=True)
    assert json.loads(place.read_text()) == found


def old_and_new(path, *, overwrite=True):
    with output_folder(path, overwrite=overwrite) as made:
        made.write("a.txt", "new")
        made.write("b.txt", "new")


@pytest.mark.long
@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("exchanges", [True, False])
@pytest.mark.parametrize("begun", ["new", "finished"])
def test_each_operation_of_an_output_folder(tmp_path, monkeypatch, error, exchanges, begun):
    """There is the old result or the new one at any moment, and the same command leaves the new one alone."""
    start = tmp_path / "start"
    (start / "in").mkdir(parents=True)
    if begun == "finished":
        with output_folder(start / "in/out", overwrite=False) as made:
            made.write("a.txt", "old")
    old_and_new(tmp_path / "whole/in/out")
    old, new = contents(start), contents(tmp_path / "whole")
    place = tmp_path / "place"
    for fails_at in range(1, 10_000):
        if place.exists():
            shutil.rmtree(place)
        shutil.copytree(start, place)
        with (
            failing(monkeypatch, fails_at, ERRORS[error], exchanges=exchanges) as broken,
            contextlib.suppress(*EXPECTED),
        ):
            old_and_new(place / "in/out")
        if broken.calls < fails_at:
            break
        named = {name: data for name, data in contents(place).items() if "/." not in name}
        if exchanges or error != "dies":
            assert named in (old, new), f"after operation {fails_at}"
        old_and_new(place / "in/out")
        assert contents(place) == new, f"after operation {fails_at}"
    assert fails_at > 20


def test_system_that_cannot_exchange_folders(tmp_path, monkeypatch):
    monkeypatch.setattr(disk, "exchange", lambda one, other: False)
    for _ in range(2):
        old_and_new(tmp_path / "out")
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]
