"""Memory of long runs, as the operating system counts it, of a process of its own."""

import pytest

from peak_memory import command_and_peak_mib, needs_peak

STARTS_DIFFER_BY_MIB = 150.0
"""Room for what differs from start to start; a table of samples by jumps of 120 days would take 30 GB."""


def peak_mib(*arguments):
    done, peak = command_and_peak_mib(*arguments)
    assert done.returncode == 0
    return peak


@needs_peak
@pytest.mark.long
@pytest.mark.parametrize("arguments", [["run", "--controller", "pid"], ["trial", "--people", 2, "--controller", "pid"]])
def test_the_memory_of_a_run_grows_with_its_days_and_not_with_their_square(tmp_path, arguments):
    short, long = (peak_mib(*arguments, "--days", days, "--out", tmp_path / str(days)) for days in (30, 120))
    assert long < 1500.0
    assert long - short < STARTS_DIFFER_BY_MIB
