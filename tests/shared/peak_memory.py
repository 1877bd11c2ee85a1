"""Largest memory of a command, as the operating system counts it, in a process of its own."""

import subprocess
import sys

import pytest

needs_peak = pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from Linux")
# The kernel's count by `getrusage` would begin with the peak of the process that starts this one.
_PEAK = """
import atexit, sys
from pathlib import Path
def peak():
    status = Path("/proc/self/status").read_text()
    print(int(status.partition("VmHWM:")[2].split()[0]) / 1024, file=sys.stderr)
atexit.register(peak)
from glucoloop.cli import program
program()
"""


def command_and_peak_mib(*arguments):
    """The completed command, and its largest memory."""
    done = subprocess.run([sys.executable, "-c", _PEAK, *map(str, arguments)], capture_output=True, text=True)
    return done, float(done.stderr.splitlines()[-1])
