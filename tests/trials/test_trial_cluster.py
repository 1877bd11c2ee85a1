"""A trial on a Dask cluster: workers die and come, and the bits are those of this process."""

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from glucoloop.refusal import Refusal
from glucoloop.trials import engine
from glucoloop.trials.computing import connected, run_here, run_on_cluster
from glucoloop.trials.folder import trial_folder
from glucoloop.trials.shard import compute_shard

pytestmark = pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="needs the extra dask")
PATIENCE_S = 300.0


def contents(path):
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


@contextlib.contextmanager
def dask(*arguments, log):
    """A process of the cluster, as one starts it by hand."""
    with (
        log.open("w") as file,
        subprocess.Popen([sys.executable, "-m", "dask", *map(str, arguments)], stdout=file, stderr=file) as process,
    ):
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.long
def test_worker_that_is_killed_costs_nothing(tmp_path, make_trial):
    trial = make_trial(controller=["basal"], people=12, shard_people=1, traces=2)
    place = tmp_path / "scheduler.json"
    to_scheduler = ("--scheduler-file", place, "--no-dashboard")
    worker = ("worker", *to_scheduler, "--nworkers", 1, "--nthreads", 1, "--no-nanny", "--local-directory", tmp_path)
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask("scheduler", "--host", "127.0.0.1", "--port", 0, *to_scheduler, log=tmp_path / "s"))
        first = stack.enter_context(dask(*worker, "--name", "first", log=tmp_path / "1"))
        stack.enter_context(dask(*worker, "--name", "second", log=tmp_path / "2"))
        until = time.monotonic() + PATIENCE_S
        while not (place.exists() and place.read_text().endswith("\n}")) and time.monotonic() < until:
            time.sleep(0.05)
        client = stack.enter_context(connected(str(place)))
        client.wait_for_workers(2, timeout=PATIENCE_S)
        done, told = [], []

        def progress(people):
            done.append(people)
            if len(done) == 5:
                first.send_signal(signal.SIGKILL)

        with trial_folder(tmp_path / "cluster", trial) as folder:
            run_on_cluster(folder, client, progress, told.append)
            assert folder.missing() == []
        assert first.wait(PATIENCE_S) == -signal.SIGKILL
        assert len(client.nthreads()) == 1
    assert done == [1] * 12
    assert told == ["1 worker was lost; 1 is left, and others may come."]
    prepared = engine.prepare(trial)
    with trial_folder(tmp_path / "here", trial) as folder:
        run_here(folder, lambda label, person, traces: engine.run_people(prepared, label, person, traces=traces))
    assert contents(tmp_path / "cluster") == contents(tmp_path / "here")


class Refusing:
    """A cluster whose workers fail, at each try of a shard with the next error of its list."""

    def __init__(self, client, errors, pretend):
        self.client, self.errors, self.pretend = client, list(errors), pretend
        self.loop, self.nthreads = client.loop, client.nthreads

    def submit(self, function, *arguments, **options):
        errors, pretend = self.errors.pop(0) if self.errors else [], self.pretend

        def fails(trial, index, *arguments):
            if errors:
                raise errors.pop(0)
            return compute_shard(trial, index, pretend(trial))

        return self.client.submit(fails, *arguments, **options)


@pytest.fixture(scope="module")
def client():
    distributed = importlib.import_module("distributed")
    with distributed.Client(
        processes=False, n_workers=1, dashboard_address="127.0.0.1:0", set_as_default=False
    ) as client:
        yield client


def test_shard_that_fails_is_tried_again(tmp_path, make_trial, client, pretend):
    with trial_folder(tmp_path / "out", make_trial()) as folder:
        run_on_cluster(folder, Refusing(client, [[RuntimeError("a"), RuntimeError("b")]], pretend), lambda people: None)
        assert folder.done == 5


@pytest.mark.parametrize(
    ("errors", "told"),
    [
        ([[RuntimeError("out of\n luck")] * 30] * 5, "failed on the cluster: out of luck; "),
        ([[], [Refusal("a worker has glucoloop 9, and this is 0")] * 30], "a worker has glucoloop 9"),
    ],
)
def test_shard_that_always_fails_is_told_and_the_others_are_kept(tmp_path, make_trial, client, pretend, errors, told):
    with trial_folder(tmp_path / "out", make_trial()) as folder:
        with pytest.raises(ValueError, match=r"shard \d failed") as failed:
            run_on_cluster(folder, Refusing(client, errors, pretend), lambda people: None)
        assert told in str(failed.value)
        assert f"{folder.done} of 5 shards are done and kept" in str(failed.value)


def test_nobody_at_the_address(monkeypatch):
    monkeypatch.setattr("glucoloop.trials.computing._CONNECT_S", 1)
    with (
        pytest.raises(ValueError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"),
        connected("tcp://127.0.0.1:9"),
    ):
        pass


def test_a_file_that_is_no_schedulers_is_refused(tmp_path):
    place = tmp_path / "s.json"
    for text in (None, "{", "{}", "[]", "\xff"):
        if text is not None:
            place.write_text(text)
        with pytest.raises(Refusal, match="is no file of a Dask scheduler"), connected(str(place)):
            pass
    place.write_text(json.dumps({"address": "tcp://ann:s3cret@10.0.0.1:8786"}))
    with pytest.raises(Refusal, match="no address of a scheduler") as refused, connected(str(place)):
        pass
    assert "s3cret" not in str(refused.value)


@pytest.mark.parametrize(
    "address", ["tcp://ann:s3cret@10.0.0.1:8786", "tcp://10.0.0.1:8786?token=s3cret", "tcp:// s3cret"]
)
def test_an_address_with_a_secret_is_refused_without_it(address):
    with pytest.raises(ValueError, match="no address of a scheduler") as refused, connected(address):
        pass
    assert "s3cret" not in str(refused.value)


def test_workers_of_this_machine_are_processes():
    with connected("local", 1) as client:
        assert client.submit(os.getpid).result() != os.getpid()


def test_dask_that_is_not_installed_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"pip install 'glucoloop\[dask\]'"), connected("local"):
        pass
