"""Importing the simulator leaves alone what few runs need."""

import subprocess
import sys

import pytest


@pytest.mark.long
def test_the_adaptive_integrator_and_fits_are_imported_by_those_who_ask():
    program = (
        "import sys, glucoloop.studies.closed_loop\n"
        "seldom = ('diffrax._solver', 'equinox', 'scipy.signal', 'scipy.optimize')\n"
        "print([name for name in seldom if name in sys.modules])"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert told.stdout == "[]\n"
