"""Memory of long runs, as the operating system counts it, of a process of its own."""

import subprocess
import sys

import pytest

PEAK = """
import resource, sys
from glucoloop.cli import program
try:
    program()
except SystemExit as exit:
    print("", file=sys.stderr)
    print(exit.code or 0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, file=sys.stderr)
"""
STARTS_DIFFER_BY_MIB = 150.0
"""Room for what differs from start to start; a table of samples by jumps of 120 days would take 30 GB."""


def peak_mib(*arguments):
    done = subprocess.run([sys.executable, "-c", PEAK, *arguments], capture_output=True, text=True, check=True)
    code, peak = done.stderr.split()[-2:]
    assert code == "0"
    return float(peak)


@pytest.mark.long
@pytest.mark.parametrize(
    "arguments", [["run", "--controller", "pid"], ["trial", "--people", "2", "--controller", "pid"]]
)
def test_the_memory_of_a_run_grows_with_its_days_and_not_with_their_square(tmp_path, arguments):
    short, long = (peak_mib(*arguments, "--days", str(days), "--out", str(tmp_path / str(days))) for days in (30, 120))
    assert long < 1500.0
    assert long - short < STARTS_DIFFER_BY_MIB
