"""The folder of a trial loses nothing: shards are whole or absent, and what is damaged or foreign is refused."""

import contextlib
import errno
import json
import os
import subprocess
import sys

import pytest

from glucoloop.storage.folder import SUMS
from glucoloop.trials.computing import run_here
from glucoloop.trials.folder import trial_folder
from glucoloop.trials.trial import fingerprint

FINAL = {"summary.json": b"{}", "report.html": b"<html>"}


def run(path, trial, pretend, *, overwrite=False, final=FINAL):
    with trial_folder(path, trial, overwrite=overwrite) as folder:
        run_here(folder, pretend(trial))
        folder.finish(final)


def contents(path):
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


@pytest.fixture
def whole(tmp_path, make_trial, pretend):
    """The contents of a folder that nothing happened to."""
    run(tmp_path / "whole", make_trial(), pretend)
    return contents(tmp_path / "whole")


def test_whole_folder_holds_what_it_says(whole, tmp_path, make_trial):
    names = (SUMS, "bands.parquet", "people.parquet", "shard.json")
    shards = [f"shards/{index:05d}/{name}" for index in range(5) for name in names]
    assert sorted(whole) == sorted([SUMS, "trial.json", "trial.toml", *FINAL, *shards])
    header = json.loads(whole["trial.json"])
    assert header["fingerprint"] == fingerprint(make_trial())
    assert header["shards"] == 5
    checked = subprocess.run(["sha256sum", "-c", SUMS], cwd=tmp_path / "whole", capture_output=True, text=True)
    assert checked.returncode == 0
    assert checked.stdout.count("OK") == len(whole) - 1 - 5  # all but the lists themselves


@pytest.mark.long
@pytest.mark.parametrize("stop_after", range(1, 10))
def test_run_that_is_cut_short_goes_on_to_the_same_bits(tmp_path, make_trial, pretend, whole, stop_after):
    trial, calls = make_trial(), []

    def cut_short(label, person, traces):
        calls.append(person)
        if len(calls) > stop_after:
            raise KeyboardInterrupt
        return pretend(trial)(label, person, traces)

    with contextlib.suppress(KeyboardInterrupt), trial_folder(tmp_path / "cut", trial) as folder:
        run_here(folder, cut_short)
    done = stop_after // 2
    assert folder.done == done
    assert (tmp_path / "cut").exists() == bool(done)  # a folder in which nothing was done is gone again
    calls.clear()
    with trial_folder(tmp_path / "cut", trial) as folder:
        assert folder.done == done
        assert folder.people_done() == 64 * done
        run_here(folder, lambda *of: calls.append(of) or pretend(trial)(*of))
        folder.finish(FINAL)
    assert len(calls) == 2 * (5 - done)
    assert contents(tmp_path / "cut") == whole


def test_what_a_killed_run_left_is_removed(tmp_path, make_trial, pretend, whole):
    trial = make_trial()
    with trial_folder(tmp_path / "cut", trial) as folder:
        folder.put(
            0,
            {
                "people.parquet": whole["shards/00000/people.parquet"],
                "bands.parquet": whole["shards/00000/bands.parquet"],
            },
        )
    left = tmp_path / "cut/shards/.00001.part"
    left.mkdir()
    (left / "people.parquet").write_bytes(b"half")
    (tmp_path / "cut/.summary.json.part").write_bytes(b"half")
    (tmp_path / "cut/lock").write_text("99999999\n")  # of a process that is no more
    run(tmp_path / "cut", trial, pretend)
    assert contents(tmp_path / "cut") == whole


def test_finished_trial_is_not_computed_again(tmp_path, make_trial, pretend):
    trial = make_trial()
    run(tmp_path / "out", trial, pretend)
    before = {file: file.stat().st_mtime_ns for file in (tmp_path / "out").rglob("*")}
    before = {file: stamp for file, stamp in before.items() if file.is_file()}
    with trial_folder(tmp_path / "out", trial) as folder:
        assert folder.finished
        assert folder.missing() == []
    assert {file: file.stat().st_mtime_ns for file in before} == before


def test_shard_and_summary_that_were_taken_away_are_made_again(tmp_path, make_trial, pretend, whole):
    import shutil

    run(tmp_path / "out", make_trial(), pretend)
    shutil.rmtree(tmp_path / "out/shards/00002")
    (tmp_path / "out/summary.json").unlink()
    with trial_folder(tmp_path / "out", make_trial()) as folder:
        assert not folder.finished
        assert folder.missing() == [2]
    run(tmp_path / "out", make_trial(), pretend)
    assert contents(tmp_path / "out") == whole


@pytest.mark.long
@pytest.mark.parametrize(
    ("file", "told"),
    [
        ("shards/00003/people.parquet", "shard 00003 of .* is damaged: people.parquet .*delete .*shards/00003 and run"),
        (f"shards/00003/{SUMS}", "shard 00003 of .* is damaged"),
        ("summary.json", "summary.json was changed .* move it away"),
        ("trial.toml", "trial.toml was changed .* move it away"),
        ("trial.json", "trial.json is damaged"),
    ],
)
@pytest.mark.parametrize("change", ["flip", "truncate", "empty"])
def test_damage_is_told_and_changes_nothing(tmp_path, make_trial, pretend, file, told, change):
    run(tmp_path / "out", make_trial(), pretend)
    place = tmp_path / "out" / file
    data = place.read_bytes()
    flipped = bytes([data[0] ^ 1]) + data[1:]
    place.write_bytes({"flip": flipped, "truncate": data[: len(data) // 2], "empty": b""}[change])
    before = contents(tmp_path / "out")
    with pytest.raises(ValueError, match=told), trial_folder(tmp_path / "out", make_trial()):
        pass
    assert contents(tmp_path / "out") == before


def test_damaged_shard_that_was_deleted_is_made_again(tmp_path, make_trial, pretend, whole):
    import shutil

    run(tmp_path / "out", make_trial(), pretend)
    (tmp_path / "out/shards/00003/people.parquet").unlink()
    with pytest.raises(ValueError, match="damaged"), trial_folder(tmp_path / "out", make_trial()):
        pass
    shutil.rmtree(tmp_path / "out/shards/00003")
    run(tmp_path / "out", make_trial(), pretend)
    assert contents(tmp_path / "out") == whole


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"people": 301}, "people is 300 there and 301 here"),
        ({"seed": 5}, "seed is 4 there and 5 here"),
        ({"population": "lognormal"}, "population is parker2000 there and lognormal here"),
        ({"pump": "max_insulin_mU_min=50"}, "pump.max_insulin_mU_min is 66.9 there and 50.0 here"),
        ({"setpoint_mg_dl": 90.0}, "setpoint_mg_dl is not given there and 90.0 here"),
        ({"controller": ["mpc", "imc"]}, "the list of cases is mpc, pid there and mpc, imc here"),
        (
            {"controller": ["mpc, move_weight=3, label=mpc", "pid"]},
            "move_weight of case 'mpc' is 0.0 there and 3.0 here",
        ),
        ({"shard_people": 32}, "shard_people is 64 there and 32 here"),
        ({"traces": "all"}, "traces is none there and all here"),
        ({"precision": "float32"}, "precision is float64 there and float32 here"),
    ],
)
def test_another_configuration_is_refused_by_its_first_difference(tmp_path, make_trial, keys, told):
    with trial_folder(tmp_path / "out", make_trial()):
        pass
    before = contents(tmp_path / "out")
    other = make_trial(**keys)
    with pytest.raises(ValueError, match="holds another trial") as refused, trial_folder(tmp_path / "out", other):
        pass
    assert told in str(refused.value)
    assert contents(tmp_path / "out") == before


def test_another_version_is_refused(tmp_path, make_trial, monkeypatch):
    with trial_folder(tmp_path / "out", make_trial()):
        pass
    monkeypatch.setattr("glucoloop.__version__", "99.0")
    told = r"was begun by glucoloop .*, and this is 99\.0"
    with pytest.raises(ValueError, match=told), trial_folder(tmp_path / "out", make_trial()):
        pass


def edit_origin(path, **changes):
    found = json.loads((path / "trial.json").read_text())
    arithmetic = {**found["arithmetic"], **changes.pop("arithmetic", {})}
    (path / "trial.json").write_text(json.dumps({**found, "arithmetic": arithmetic, **changes}))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("jax", "0.0.1"),
        ("scipy", "0.0.1"),
        ("llvmlite", "0.0.1"),
        ("processor", "8086"),
        ("XLA_FLAGS", "--xla_cpu_enable_fast_math=true"),
        ("jax_enable_x64", "0"),
    ],
)
def test_shards_of_other_arithmetic_are_not_mixed(tmp_path, tiny, name, value):
    tiny, _ = tiny
    with trial_folder(tmp_path / "out", tiny.trial) as folder:
        folder.put(0, tiny.shards[0])
    edit_origin(tmp_path / "out", arithmetic={name: value})
    before = contents(tmp_path / "out")
    with pytest.raises(ValueError, match=r"shard 00000 of .* belongs to something else: its arithmetic"):
        tiny.run(tmp_path / "out")
    (tmp_path / "out/shards/00000").rename(tmp_path / "00000")
    with pytest.raises(ValueError, match=rf"was computed with {name} {value}, and here it is .* the same bits"):
        tiny.run(tmp_path / "out")
    (tmp_path / "00000").rename(tmp_path / "out/shards/00000")
    assert contents(tmp_path / "out") == before
    tiny.run(tmp_path / "out", overwrite=True)
    assert json.loads((tmp_path / "out/trial.json").read_text())["arithmetic"][name] != value


def test_other_tables_are_noted(tmp_path, tiny):
    tiny, _ = tiny
    with trial_folder(tmp_path / "out", tiny.trial) as folder:
        folder.put(0, tiny.shards[0])
    edit_origin(tmp_path / "out", polars="0.0.1")
    with trial_folder(tmp_path / "out", tiny.trial) as folder:
        assert any("polars 0.0.1" in note for note in folder.notes)


def test_overwriting_begins_again_but_spares_what_others_put_there(tmp_path, make_trial, pretend, whole):
    run(tmp_path / "out", make_trial(seed=9), pretend)
    run(tmp_path / "out", make_trial(), pretend, overwrite=True)
    assert contents(tmp_path / "out") == whole
    for file in ("shards/mine.txt", "mine.txt"):
        (tmp_path / "out" / file).write_text("mine")
        with pytest.raises(ValueError, match=r"mine.txt, which is no part of a trial"):
            run(tmp_path / "out", make_trial(seed=9), pretend, overwrite=True)
        (tmp_path / "out" / file).unlink()
    (tmp_path / "out/report.html").write_text("mine")
    with pytest.raises(ValueError, match=r"report\.html, which was changed"):
        run(tmp_path / "out", make_trial(seed=9), pretend, overwrite=True)
    (tmp_path / "out/report.html").write_bytes(FINAL["report.html"])
    assert contents(tmp_path / "out") == whole


@pytest.mark.long
@pytest.mark.parametrize("there", ["nothing", "other", "finished"])
def test_overwriting_run_that_was_cut_short_goes_on(tmp_path, make_trial, pretend, whole, there):
    """The same command, with --overwrite again, keeps what the one before has done."""
    trial, calls = make_trial(), []
    if there != "nothing":
        run(tmp_path / "out", make_trial(seed=9) if there == "other" else trial, pretend)

    def cut_short(label, person, traces):
        calls.append(person)
        if len(calls) > 5:
            raise KeyboardInterrupt
        return pretend(trial)(label, person, traces)

    with contextlib.suppress(KeyboardInterrupt), trial_folder(tmp_path / "out", trial, overwrite=True) as folder:
        run_here(folder, cut_short)
    with trial_folder(tmp_path / "out", trial, overwrite=True) as folder:
        assert folder.missing() == [2, 3, 4]
        run_here(folder, pretend(trial))
        folder.finish(FINAL)
    assert contents(tmp_path / "out") == whole


def test_overwriting_begins_again_where_what_is_there_is_damaged(tmp_path, make_trial, pretend, whole):
    trial = make_trial()
    with trial_folder(tmp_path / "out", trial) as folder:
        folder.put(0, {name: whole[f"shards/00000/{name}"] for name in ("people.parquet", "bands.parquet")})
    (tmp_path / "out/shards/00000/people.parquet").write_bytes(b"nothing")
    run(tmp_path / "out", trial, pretend, overwrite=True)
    assert contents(tmp_path / "out") == whole


def test_place_that_is_taken_is_refused(tmp_path, make_trial):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "other").mkdir()
    (tmp_path / "other/run.toml").write_text("")
    for place, told in (
        ("file", "is not a folder"),
        ("file/out", "is not a folder"),
        ("other", "run.toml, which is no part"),
    ):
        with pytest.raises(ValueError, match=told), trial_folder(tmp_path / place, make_trial()):
            pass
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "other"]


@pytest.mark.skipif(os.name == "nt", reason="flock")
def test_two_runs_at_once_are_refused_and_the_lock_of_a_dead_one_is_free(tmp_path, make_trial):
    hold = (
        "import pathlib, sys, time\n"
        "from glucoloop.storage.disk import locked\n"
        f"folder = pathlib.Path({str(tmp_path)!r})\n"
        "with locked(folder / 'lock', folder):\n"
        "    print('held', flush=True)\n"
        "    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", hold], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        told = rf"another run writes to .* \(process {other.pid}\); wait for it"
        with pytest.raises(ValueError, match=told), trial_folder(tmp_path, make_trial()):
            pass
        other.kill()
    assert (tmp_path / "lock").exists()
    with trial_folder(tmp_path, make_trial()):
        assert (tmp_path / "lock").read_text() == f"{os.getpid()}\n"
    assert not (tmp_path / "lock").exists()


def full_after(monkeypatch, writes):
    """A disk that is full after so many files."""
    fsync, seen = os.fsync, []

    def full(descriptor):
        seen.append(descriptor)
        if len(seen) > writes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", full)


@pytest.mark.long
@pytest.mark.parametrize("writes", range(0, 35, 3))
def test_full_disk_keeps_what_is_done(tmp_path, make_trial, pretend, whole, monkeypatch, writes):
    full_after(monkeypatch, writes)
    with contextlib.suppress(ValueError):
        run(tmp_path / "out", make_trial(), pretend)
        pytest.fail("the disk was not full")
    monkeypatch.undo()
    here = contents(tmp_path / "out") if (tmp_path / "out").exists() else {}
    assert {name: whole[name] for name in here} == here  # what is there is whole
    run(tmp_path / "out", make_trial(), pretend)
    assert contents(tmp_path / "out") == whole


def test_full_disk_is_told_in_a_sentence(tmp_path, make_trial, pretend, monkeypatch):
    full_after(monkeypatch, 24)
    with pytest.raises(ValueError, match="cannot be written to") as told:
        run(tmp_path / "out", make_trial(), pretend)
    assert "No space left on device; 3 of 5 shards are done and kept, free some space and run the same" in str(
        told.value
    )


MENDS = {
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space",
    errno.EACCES: "change its permissions",
    errno.EROFS: "mount the disk for writing",
    errno.EIO: "check the disk",
}


@pytest.mark.parametrize("reason", [*MENDS, errno.EBADF])
def test_an_error_of_the_disk_has_its_own_mend(tmp_path, make_trial, pretend, monkeypatch, reason):
    def refuse(*_):
        raise OSError(reason, os.strerror(reason))

    monkeypatch.setattr("glucoloop.storage.disk.put_folder", refuse)
    own = f"{MENDS[reason]} and " if reason in MENDS else ""
    with pytest.raises(ValueError, match="cannot be written to") as told:
        run(tmp_path / "out", make_trial(), pretend)
    assert str(told.value).endswith(
        f"{os.strerror(reason)}; 0 of 5 shards are done and kept, {own}run the same command again"
    )


@pytest.mark.parametrize("reason", [*MENDS, errno.EBADF])
def test_a_folder_that_cannot_be_made_has_a_mend(tmp_path, make_trial, pretend, monkeypatch, reason):
    def refuse(*_):
        raise OSError(reason, os.strerror(reason))

    monkeypatch.setattr("glucoloop.storage.disk.made_folders", refuse)
    with pytest.raises(ValueError, match="cannot be written") as told:
        run(tmp_path / "out", make_trial(), pretend)
    own = f"{MENDS[reason]} and run the same command again, or " if reason in MENDS else ""
    assert str(told.value).endswith(f"{os.strerror(reason)}; {own}choose another with --out")


def test_disk_that_is_too_small_for_a_shard(tmp_path, make_trial, pretend):
    """A limit of the system on the size of a file: writing fails in the middle of it."""
    import resource
    import signal

    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with trial_folder(tmp_path / "out", make_trial()) as folder:
            run_one = iter(folder.missing())
            from glucoloop.trials.shard import compute_shard

            folder.put(0, compute_shard(folder.trial, next(run_one), pretend(folder.trial)))
            resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
            with pytest.raises(ValueError, match="File too large; 1 of 5 shards are done and kept"):
                run_here(folder, pretend(folder.trial))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert sorted(entry.name for entry in (tmp_path / "out/shards").iterdir()) == ["00000"]
