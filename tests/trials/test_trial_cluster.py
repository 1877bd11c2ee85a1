"""A trial on a Dask cluster: workers die and come, and the bits are those of this process."""

import contextlib
import importlib.util
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time

import pytest

import glucoloop
from glucoloop import arithmetic
from glucoloop.refusal import Refusal
from glucoloop.trials import computing, engine
from glucoloop.trials.computing import ComputedShard, Workers, connected, run_here, run_on_cluster, shard_on_worker
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


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # dask-jobqueue leaves pipes open
@pytest.mark.long
def test_trial_on_jobs_of_a_queue(tmp_path, make_trial):
    local = pytest.importorskip("dask_jobqueue.local", reason="needs dask-jobqueue, which starts workers as jobs")
    trial, place = make_trial(controller=["basal"], people=2, shard_people=1), tmp_path / "scheduler.json"
    options = {"scheduler_file": str(place), "host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    places = {"local_directory": str(tmp_path), "log_directory": str(tmp_path)}
    with local.LocalCluster(
        cores=1, processes=1, memory="2GB", python=sys.executable, scheduler_options=options, **places
    ) as cluster:
        cluster.scale(jobs=1)
        with connected(str(place)) as client, trial_folder(tmp_path / "out", trial) as folder:
            run_on_cluster(folder, client, lambda people: None)
            assert folder.missing() == []
            assert folder.other_processors == ()


class Refusing:
    """A cluster whose workers fail, at each try of a shard with the next error of its list."""

    def __init__(self, client, errors, pretend, processor=None):
        self.client, self.errors, self.pretend, self.processor = client, list(errors), pretend, processor
        self.loop, self.nthreads = client.loop, client.nthreads

    def submit(self, function, *arguments, **options):
        errors, pretend, processor = self.errors.pop(0) if self.errors else [], self.pretend, self.processor

        def fails(trial, index, *arguments):
            if errors:
                raise errors.pop(0)
            return ComputedShard(compute_shard(trial, index, pretend(trial)), processor, {})

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


def test_workers_write_traces_to_the_store_and_send_the_rest(tmp_path, make_trial, client, pretend, monkeypatch):
    trial = make_trial(traces=100)
    monkeypatch.setattr(engine, "prepare", lambda trial: None)
    monkeypatch.setattr(
        computing, "compute_shard", lambda trial, index, of: compute_shard(trial, index, pretend(trial))
    )
    sent, store = [], tmp_path / "store"
    with (
        trial_folder(tmp_path / "here", trial) as here,
        trial_folder(tmp_path / "out", trial, traces_at=f"file://{store}") as folder,
    ):
        run_here(here, pretend(trial))
        put = folder.put
        monkeypatch.setattr(folder, "put", lambda index, files, *of: sent.append({*files}) or put(index, files, *of))
        run_on_cluster(folder, client, lambda people: None)
        assert folder.missing() == []
    assert sent == [{"people.parquet", "bands.parquet"}] * 5
    in_the_folder = {
        name: data for name, data in contents(tmp_path / "here").items() if name.endswith("traces.parquet")
    }
    assert len(in_the_folder) == 2
    in_the_store = contents(store)
    assert json.loads(in_the_store.pop("trial.json"))["people"] == 300
    assert in_the_store == in_the_folder


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


def test_process_of_a_cluster_without_glucoloop_is_told(tmp_path, make_trial, client, pretend):
    errors = [[RuntimeError("Error during deserialization of the task graph")] * 30] * 5
    with (
        trial_folder(tmp_path / "out", make_trial()) as folder,
        pytest.raises(Refusal, match=r"failed on the cluster: .* install the same glucoloop for all of them; 0 of 5"),
    ):
        run_on_cluster(folder, Refusing(client, errors, pretend), lambda people: None)


class NotSentError(Exception):
    """An error that no process can send to another one, nor show."""

    def __init__(self, *, code):
        super().__init__(f"code {code}")
        self.lock = threading.Lock()

    def __reduce__(self):
        return os._exit, (9,)


class NotShownError(Exception):
    def __str__(self):
        raise RuntimeError


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (NotSentError(code=1), r"test_trial_cluster\.NotSentError: code 1$"),
        (NotShownError(), r"NotShownError: <exception str"),
        (
            RuntimeError("a callback failed\n  File 1\n  File 2\nKeyError: 'b'\n"),
            r"^RuntimeError: a callback failed \.\.\. KeyError: 'b'$",
        ),
        (Refusal("a is 1, and must be 2", "give 2"), "^a is 1, and must be 2; give 2$"),
    ],
    ids=["not-sent", "not-shown", "long", "refusal"],
)
def test_every_error_of_a_worker_can_be_sent(monkeypatch, make_trial, error, message):
    def fails(trial):
        raise error

    monkeypatch.setattr(engine, "prepare", fails)
    with pytest.raises(Refusal, match=message) as failed:
        shard_on_worker(make_trial(), 0, glucoloop.__version__, arithmetic.identity())
    assert type(pickle.loads(pickle.dumps(failed.value))) is Refusal
    assert failed.value.__cause__ is None
    assert failed.value.__context__ is None  # Dask sends it as well


def test_another_processor_is_taken_in_portable_arithmetic_alone(monkeypatch, make_trial):
    here = arithmetic.identity()
    monkeypatch.setattr(arithmetic, "identity", lambda: {**here, arithmetic.PROCESSOR: "another"})
    monkeypatch.setattr(engine, "prepare", lambda trial: None)
    monkeypatch.setattr("glucoloop.trials.computing.compute_shard", lambda *of: {})
    remedy = "have workers of one kind.*, or begin another folder with --arithmetic portable$"
    with pytest.raises(Refusal, match=f"a worker has processor another, .*; {remedy}"):
        shard_on_worker(make_trial(), 0, glucoloop.__version__, here)
    portable = make_trial(arithmetic="portable")
    assert shard_on_worker(portable, 0, glucoloop.__version__, here) == ComputedShard({}, "another", {})
    with pytest.raises(Refusal, match=r"a worker has numpy .* and here it is 1,.*run the same command again$"):
        shard_on_worker(portable, 0, glucoloop.__version__, {**here, "numpy": "1"})


def test_folder_says_which_shards_are_of_another_processor(tmp_path, make_trial, client, pretend):
    for kind, others in (("another", ("another",)), (arithmetic.identity()[arithmetic.PROCESSOR], ())):
        with trial_folder(tmp_path / kind, make_trial(arithmetic="portable")) as folder:
            run_on_cluster(folder, Refusing(client, [], pretend, kind), lambda people: None)
            assert folder.other_processors == others
        with trial_folder(tmp_path / kind, make_trial(arithmetic="portable")) as folder:
            assert folder.done == 5
            assert folder.other_processors == others
        place = folder.shard(0) / "shard.json"
        assert json.loads(place.read_text()).get("processor") == (kind if others else None)


def test_shard_of_another_processor_in_fused_arithmetic_is_refused(tmp_path, make_trial, client, pretend):
    with trial_folder(tmp_path / "out", make_trial()) as folder:
        run_on_cluster(folder, Refusing(client, [], pretend, "another"), lambda people: None)
    with (
        pytest.raises(Refusal, match=r"computed by another processor \(another\), without portable"),
        trial_folder(tmp_path / "out", make_trial()),
    ):
        pass


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


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """A certificate and its key in one file, which signs itself."""
    if shutil.which("openssl") is None:
        pytest.skip("needs the program openssl, which makes certificates")
    place = tmp_path_factory.mktemp("certificate")
    key, certificate, both = place / "key.pem", place / "certificate.pem", place / "both.pem"
    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "1", "-subj", "/CN=test")
    command = ["openssl", "req", "-x509", *curve, "-keyout", key, "-out", certificate]
    subprocess.run(command, check=True, capture_output=True)
    both.write_bytes(key.read_bytes() + certificate.read_bytes())
    return str(both)


def configured_by(**keys):
    """Configuration of Dask with these values of ``distributed.comm.tls``."""
    dask = importlib.import_module("dask")
    return dask.config.set({f"distributed.comm.tls.{name.replace('__', '.')}": value for name, value in keys.items()})


def test_trial_on_a_cluster_with_certificates(tmp_path, make_trial, pretend, certificate):
    distributed = importlib.import_module("distributed")
    roles = {f"{role}__cert": certificate for role in ("scheduler", "worker", "client")}
    with (
        configured_by(ca_file=certificate, **roles),
        distributed.LocalCluster(
            processes=False,
            n_workers=1,
            protocol="tls://",
            security=distributed.Security(),
            dashboard_address="127.0.0.1:0",
        ) as cluster,
        connected(cluster.scheduler_address) as client,
        trial_folder(tmp_path / "out", make_trial()) as folder,
    ):
        assert cluster.scheduler_address.startswith("tls://")
        run_on_cluster(folder, Refusing(client, [], pretend), lambda people: None)
        assert folder.done == 5


@pytest.mark.parametrize("address", ["tls://10.0.0.1:8786", "wss://10.0.0.1:8786"])
def test_missing_certificates_are_told_before_anything_is_designed(tmp_path, address, certificate):
    own = "DASK_DISTRIBUTED__COMM__TLS__CA_FILE, DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT and .*CLIENT__KEY name files"
    with pytest.raises(Refusal, match=f"{address} asks for certificates, and Dask's configuration names none; .*{own}"):
        Workers.of(dask=address)
    (tmp_path / "empty.pem").touch()
    for file in ("gone.pem", "empty.pem"):
        place = str(tmp_path / file)
        with (
            configured_by(ca_file=certificate, client__cert=place),
            pytest.raises(Refusal, match=f"cannot be read from {certificate}, {place}"),
        ):
            Workers.of(dask=address)


def test_an_address_without_encryption_is_refused_where_it_is_required():
    dask = importlib.import_module("dask")
    with (
        dask.config.set({"distributed.comm.require-encryption": True}),
        pytest.raises(Refusal, match=r"requires encryption, and tcp://10\.0\.0\.1:8786 .* like tls://"),
    ):
        Workers.of(dask="tcp://10.0.0.1:8786")


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
