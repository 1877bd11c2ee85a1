"""A trial that is killed, again and again, ends as one that nothing happened to."""

import os
import signal
import subprocess
import sys
import time

import pytest

TRIAL = (
    *("trial", "--people", "16", "--shard-people", "1", "--seed", "2", "--traces", "3"),
    *("--controller", "basal", "--duration", "300", "--meal", "50g@50min"),
)
PATIENCE_S = 120.0


def digests(folder):
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file.name != "lock"
    }


@pytest.mark.long
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_kill_at_any_moment_loses_nothing(glucoloop, tmp_path):
    killed = tmp_path / "killed"
    done = [0]
    for moment in (0, 16):
        with subprocess.Popen(
            [sys.executable, "-m", "glucoloop", *TRIAL, "--out", str(killed)], stderr=subprocess.PIPE, text=True
        ) as running:
            until = time.monotonic() + PATIENCE_S
            while running.poll() is None and time.monotonic() < until:
                shards = killed / "shards"
                if shards.is_dir() and len([name for name in os.listdir(shards) if name[0] != "."]) >= moment:
                    break
                time.sleep(0.005)
            running.send_signal(signal.SIGKILL)
            running.communicate()
        assert running.returncode == -signal.SIGKILL  # it was not done yet
        assert not (killed / "SHA256SUMS").exists()
        done.append(sum(name[0] != "." for name in os.listdir(killed / "shards")))
        assert done[-1] >= moment
    assert done == sorted(done)  # nothing was begun again
    # What a kill in the middle of a shard leaves, whichever moment the kills above met.
    (killed / "shards/.00015.part").mkdir(exist_ok=True)
    answer = glucoloop(*TRIAL, "--out", "killed")
    assert answer.code == 0
    assert "16 of 16 shards of killed are there already; going on." in answer.err
    assert glucoloop(*TRIAL, "--out", "whole").code == 0
    assert digests(killed) == digests(tmp_path / "whole")
    assert not (killed / "lock").exists()
