"""Traces in a store: the same bits as in the folder, whatever happens, and nothing of anybody else is touched."""

import importlib
import json
import sys
from contextlib import nullcontext
from typing import ClassVar

import polars as pl
import pytest

import glucoloop
from glucoloop import arithmetic
from glucoloop.refusal import MissingExtraError, Refusal
from glucoloop.studies.record_report.sources import _simulated_trajectories
from glucoloop.trials import computing, engine
from glucoloop.trials.computing import run_here, shard_on_worker
from glucoloop.trials.folder import trial_folder
from glucoloop.trials.shard import TRACES, compute_shard
from glucoloop.trials.trace_store import store_address
from naming import naming

fsspec = pytest.importorskip("fsspec", reason="needs the extra store")
memory = importlib.import_module("fsspec.implementations.memory")
FINAL = {"report.html": b"<html>"}


class Bucket(memory.MemoryFileSystem):
    """Objects of ``s3://`` in memory; `errors` are what writing raises, by the end of a name."""

    protocol = "s3"
    store: ClassVar = {}
    pseudo_dirs: ClassVar = [""]
    errors: ClassVar = {}

    @classmethod
    def _strip_protocol(cls, path):
        return memory.MemoryFileSystem._strip_protocol(path.removeprefix("s3://"))

    def pipe_file(self, path, value, **options):
        for name, error in self.errors.items():
            if path.endswith(name):
                raise error
        super().pipe_file(path, value, **options)


@pytest.fixture
def bucket(monkeypatch):
    """Contents of an empty bucket by the names of its objects."""
    monkeypatch.setitem(importlib.import_module("fsspec.registry")._registry, "s3", Bucket)
    monkeypatch.setattr(Bucket, "store", {})
    return Bucket


def objects(bucket):
    return {name.removeprefix("/b/t/"): file.getvalue() for name, file in bucket.store.items()}


def files(path):
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


def run(path, trial, pretend, address=None, *, overwrite=False):
    with trial_folder(path, trial, overwrite=overwrite, traces_at=address) as folder:
        run_here(folder, pretend(trial))
        folder.finish(FINAL)


@pytest.fixture
def trial(make_trial):
    """Three shards of four people, of whom all but the last two have traces: the third shard has none."""
    return make_trial(people=10, shard_people=4, traces=8)


@pytest.fixture
def here(tmp_path, trial, pretend):
    """Contents of a folder with its traces."""
    run(tmp_path / "here", trial, pretend)
    return files(tmp_path / "here")


def traces(contents):
    return {name: data for name, data in contents.items() if name.endswith(TRACES)}


def test_traces_are_in_the_store_and_all_else_is_in_the_folder(tmp_path, trial, pretend, here, bucket):
    shared = tmp_path / "shared"
    for address, stored in (
        ("s3://b/t", lambda: objects(bucket)),
        (f"file://{shared}", lambda: files(shared)),
    ):
        with naming(address):
            out = tmp_path / address.partition(":")[0]
            run(out, trial, pretend, address)
            written = stored()
            record = json.loads(written.pop("trial.json"))
            assert record["fingerprint"] == json.loads(here["trial.json"])["fingerprint"]
            assert written == traces(here)
            assert len(written) == 2
            kept = files(out)
            assert here.keys() - kept.keys() == traces(here).keys()
            own = (f"shards/0000{shard}/{name}" for shard in range(2) for name in ("SHA256SUMS", "shard.json"))
            assert {name for name, data in kept.items() if data != here[name]} == {"SHA256SUMS", "trial.json", *own}


def test_run_that_the_store_stops_goes_on_to_the_same_bits(tmp_path, trial, pretend, here, bucket, monkeypatch):
    errors = (OSError("the connection was reset"), PermissionError("Access Denied"), KeyboardInterrupt())
    for number, error in enumerate(errors):
        with naming(repr(error)):
            monkeypatch.setattr(Bucket, "store", {})
            monkeypatch.setattr(Bucket, "errors", {f"00001/{TRACES}": error})
            out, simulate = tmp_path / str(number), pretend(trial)

            with (
                pytest.raises((Refusal, KeyboardInterrupt)) as stopped,
                trial_folder(out, trial, traces_at="s3://b/t") as folder,
            ):
                run_here(folder, simulate)
            if isinstance(error, OSError):
                told = (
                    f"shard 1: s3://b/t/shards/00001/{TRACES} cannot be written: {error}; check .*; 1 of 3 shards are"
                )
                stopped.match(told)
            monkeypatch.setattr(Bucket, "errors", {})
            assert sorted(objects(bucket)) == [f"shards/00000/{TRACES}", "trial.json"]
            with trial_folder(out, trial, traces_at="s3://b/t") as folder:
                assert folder.missing() == [1, 2]
                run_here(folder, simulate)
                folder.finish(FINAL)
            assert traces(objects(bucket)) == traces(here)


def test_store_that_cannot_be_used_leaves_no_folder(tmp_path, trial, bucket, monkeypatch):
    monkeypatch.setattr(Bucket, "errors", {"trial.json": PermissionError("Access Denied")})
    with (
        pytest.raises(Refusal, match="s3://b/t cannot be written: Access Denied; check the address, the credentials"),
        trial_folder(tmp_path / "out", trial, traces_at="s3://b/t"),
    ):
        pass
    assert not (tmp_path / "out").exists()


def test_store_of_others_is_refused_and_stays(tmp_path, make_trial, trial, pretend, bucket):
    out, other = tmp_path / "out", make_trial(people=4, shard_people=4, traces=4, seed=5)
    run(tmp_path / "other", other, pretend, "s3://b/t")
    run(out, trial, pretend)
    bucket.pipe_file(Bucket(), "s3://b/foreign/a.txt", b"1")
    before, stored = files(out), dict(bucket.store)
    for address, overwrite, told in (
        ("s3://b/t", True, "s3://b/t holds the traces of another trial; give another address"),
        ("s3://b/foreign", True, "s3://b/foreign holds a.txt and no traces of a trial"),
        (f"file://{out}/traces", False, "is within .*; give a place beside it"),
        ("s3://b/new", False, "the traces of .* are in that folder, and not in s3://b/new; leave --traces-at out"),
    ):
        with naming(address):
            with (
                pytest.raises(Refusal, match=told),
                trial_folder(out, trial, traces_at=address, overwrite=overwrite),
            ):
                pass
            assert (files(out), bucket.store) == (before, stored)
    with (
        pytest.raises(Refusal, match=r"are in s3://b/t, and not in the folder; give --traces-at s3://b/t"),
        trial_folder(tmp_path / "other", other),
    ):
        pass


def test_trial_begins_again_at_its_own_address(tmp_path, trial, pretend, bucket):
    run(tmp_path / "out", trial, pretend, "s3://b/t")
    before = objects(bucket)
    run(tmp_path / "out", trial, pretend, "s3://b/t", overwrite=True)
    run(tmp_path / "again", trial, pretend, "s3://b/t")
    assert objects(bucket) == before


def test_objects_that_are_gone_or_changed_are_told(tmp_path, trial, pretend, bucket):
    out, name = tmp_path / "out", f"/b/t/shards/00001/{TRACES}"
    run(out, trial, pretend, "s3://b/t")
    whole, sums = bucket.store[name].getvalue(), (out / "SHA256SUMS").read_bytes()
    for change in (None, whole[:-1], whole[:-1] + bytes([whole[-1] ^ 1])):
        with naming(change and len(change)):
            Bucket().rm_file(name)
            if change is not None:
                Bucket().pipe_file(name, change)
            told = f"s3://b{name[2:]} is gone or was changed since glucoloop wrote it; delete its shard"
            with trial_folder(out, trial, traces_at="s3://b/t") as folder:
                assert folder.finished  # which asks nothing of the store
            with pytest.raises(Refusal, match=told):
                _simulated_trajectories(out)
            (out / "shards/00002").rename(tmp_path / "2")
            known_by_size = change is None or len(change) != len(whole)
            with (
                pytest.raises(Refusal, match=told) if known_by_size else nullcontext(),
                trial_folder(out, trial, traces_at="s3://b/t"),
            ):
                pass
            (tmp_path / "2").rename(out / "shards/00002")
            (out / "SHA256SUMS").write_bytes(sums)
            Bucket().pipe_file(name, whole)


def test_store_is_not_asked_where_no_shard_is_missing(tmp_path, trial, pretend, bucket):
    run(tmp_path / "out", trial, pretend, "s3://b/t")
    bucket.store.clear()
    (tmp_path / "out/report.html").unlink()
    with trial_folder(tmp_path / "out", trial, traces_at="s3://b/t") as folder:
        assert not folder.finished
        folder.finish(FINAL)
        assert folder.finished
    assert objects(bucket) == {}


def test_stored_traces_are_reported_and_asked_for_as_those_of_the_folder(tmp_path, trial, pretend, here, bucket):
    duckdb_query = pytest.importorskip("glucoloop.trials.query", reason="needs the extra query")
    question = "select count(*), sum(glucose_mg_dl), max(person) from traces"

    def answer(folder, sql=question):
        with duckdb_query.trial_tables(folder) as tables:
            return list(tables.query(sql).rows), tables.notes

    expected = [(of.name, of.readings.glucose_mg_dl.tolist()) for of in _simulated_trajectories(tmp_path / "here")]
    for address in ("s3://b/t", f"file://{tmp_path}/shared"):
        with naming(address):
            out = tmp_path / address.partition(":")[0]
            run(out, trial, pretend, address)
            courses = _simulated_trajectories(out)
            assert [(of.name, of.readings.glucose_mg_dl.tolist()) for of in courses] == expected
            assert answer(out) == answer(tmp_path / "here")
    Bucket().pipe_file("s3://b/t/shards/00003/traces.parquet", traces(here)[f"shards/00000/{TRACES}"])
    with pytest.raises(Refusal, match="file system operations are disabled"):
        answer(tmp_path / "s3", "from read_parquet('s3://b/t/shards/00003/traces.parquet')")
    Bucket().rm_file(f"/b/t/shards/00000/{TRACES}")
    rows, notes = answer(tmp_path / "s3", "select count(*) from people")
    assert rows == [(20,)]
    assert [note.partition(" is gone")[0] for note in notes] == [
        f"The traces are left out: s3://b/t/shards/00000/{TRACES}"
    ]


def test_worker_writes_its_traces_and_returns_their_digest(tmp_path, trial, pretend, here, bucket, monkeypatch):
    monkeypatch.setattr(engine, "prepare", lambda trial: None)
    monkeypatch.setattr(
        computing, "compute_shard", lambda trial, index, of: compute_shard(trial, index, pretend(trial))
    )
    work = trial, 1, glucoloop.__version__, arithmetic.identity()
    with trial_folder(tmp_path / "out", trial, traces_at="s3://b/t") as folder:
        computed = shard_on_worker(*work, folder.store)
        assert TRACES not in computed.files
        assert traces(objects(bucket)) == {f"shards/00001/{TRACES}": here[f"shards/00001/{TRACES}"]}
        folder.put(1, computed.files, computed.processor, computed.stored)
        assert folder.missing() == [0, 2]
        Bucket().rm_file("/b/t/trial.json")
        Bucket().rm_file(f"/b/t/shards/00001/{TRACES}")
        with pytest.raises(
            Refusal, match=r"s3://b/t does not hold trial\.json, .*; give a place that all machines see"
        ):
            shard_on_worker(*work, folder.store)  # of a worker that has another disk
        assert objects(bucket) == {}


def test_traces_that_are_not_those_of_the_shard_are_refused(tmp_path, trial, pretend, bucket):
    with trial_folder(tmp_path / "out", trial, traces_at="s3://b/t") as folder:
        others = compute_shard(trial, 0, pretend(trial))
        table = pl.DataFrame({"a": [1]})
        table.write_parquet(tmp_path / "a.parquet")
        with pytest.raises(Refusal, match=f"{TRACES} of shard 0 is not as it must be: it has 1 rows"):
            folder.put(0, {**others, TRACES: (tmp_path / "a.parquet").read_bytes()})
        assert [*objects(bucket)] == ["trial.json"]


def test_what_is_no_address_of_a_store_is_refused_without_a_word_of_it():
    for text in (
        *("", "traces", "s3://", "s3:///", "file://traces", "https://b/t", "simplecache::s3://b/t", "memory://t"),
        *("s3://key:s3cret@b/t", "s3://b/t?sig=s3cret", "s3://b/*", "s3://b/a b", "s3://b/t#s3cret"),
    ):
        with naming(text):
            with pytest.raises(Refusal, match="no address of a store; give one like s3://bucket/folder") as refused:
                store_address(text)
            assert "s3cret" not in str(refused.value)
    assert store_address("file:///shared/t/") == "file:///shared/t"


def test_packages_that_a_store_needs_are_named(monkeypatch):
    for name, package in (("gs", "gcsfs"), ("az", "adlfs"), ("s3", "s3fs")):
        with naming(name):
            monkeypatch.setitem(sys.modules, package, None)
            importlib.import_module("fsspec.registry")._registry.pop(name, None)
            with pytest.raises(Refusal, match=f"{name}://b/t needs {package}; install it with: pip install {package}$"):
                store_address(f"{name}://b/t")
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(MissingExtraError, match=r"a store of traces needs fsspec; .*'glucoloop\[store\]'"):
        store_address("s3://b/t")
