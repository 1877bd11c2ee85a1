"""What many tests need: the patient written out by hand, scripted controllers, and the identified model."""

import contextlib
import ctypes
import gc
import os
import tempfile
from math import exp, tanh
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import settings

import glucoloop  # noqa: F401  (before JAX, which it sets to float64)
from glucoloop import _disk_cache
from glucoloop._pytree import pytree, static
from glucoloop.control import Decision, Status
from glucoloop.identification import Record, design_csrs, identify_record
from glucoloop.meals import Scenario
from glucoloop.patients import patient
from glucoloop.pumps import Delivery
from glucoloop.simulation import Adaptive, simulate
from quick_to_compile import CACHE, keep_compiled, set_flags, share_contexts


def pytest_configure(config):
    if CACHE not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="glucoloop-tests-")
        os.environ[CACHE] = folder.name  # workers are started with it
        config.add_cleanup(folder.cleanup)
        config.add_cleanup(lambda: os.environ.pop(CACHE))
    set_flags(os.environ[CACHE])  # workers are started with them
    share_contexts()
    keep_compiled(os.environ[CACHE])  # for commands that tests start, too
    _disk_cache._left = 0  # tests replace constants, of which the names of kept results do not tell
    gc.set_threshold(50_000, 20, 50)  # what JAX traces is many small objects, few of them garbage


_LARGEST_BYTES = 4 * 2**30
LONG = {
    "cli": ("test_adversary", "test_bound", "test_stress", "test_tune"),
    "bounds": ("test_hedging",),
    "examples": ("test_long_examples",),
    "build": ("test_individual", "test_individual_meal_mpc"),
    "firmware": ("test_every_controller",),
    "invariants": ("test_every_loop", "test_faults"),
    "qp": ("test_moves_qp", "test_soft_floor"),
    "simulation": ("test_beyond_the_model", "test_transformations"),
    "studies": ("test_adversary_attack", "test_robust_loop", "test_verification"),
    "trials": ("test_trial_cluster",),
    "tuning": ("test_oscillation", "test_search"),
    "validation": ("test_loops",),
}
"""Modules all of whose tests are `long`, by their folder."""


def pytest_ignore_collect(collection_path, config):
    """Modules in which no test has the mark that is asked for are not even imported, which every worker would do."""
    if not collection_path.match("test_*.py"):
        return None
    all_are_long = collection_path.stem in LONG.get(collection_path.parent.name, ())
    if config.option.markexpr == "not long" and all_are_long:
        return True
    if config.option.markexpr == "long" and not all_are_long and b"mark.long" not in collection_path.read_bytes():
        return True
    return None


def pytest_collection_finish():
    gc.freeze()  # modules stay


def pytest_unconfigure():
    gc.unfreeze()  # libraries that count what is left at the end find nothing


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.stem in LONG.get(item.path.parent.name, ()):
            item.add_marker(pytest.mark.long)


@pytest.fixture(autouse=True, scope="module")
def room_for_programs():
    """Each program that JAX holds takes memory, of which three workers have some gigabytes each on a small machine.

    It also takes places in the process's memory map, of which Linux allows 65 530.
    """
    yield
    maps, pages = Path("/proc/self/maps"), Path("/proc/self/statm")
    if not maps.exists():
        return
    resident = int(pages.read_text().split()[1]) * os.sysconf("SC_PAGESIZE")
    if resident > _LARGEST_BYTES or len(maps.read_bytes().splitlines()) > 40_000:
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(AttributeError, OSError):  # another C library than GNU's
            ctypes.CDLL(None).malloc_trim(0)  # which otherwise keeps most of what compilers freed


settings.register_profile("glucoloop", deadline=None, derandomize=True)
settings.load_profile("glucoloop")


def sorensen_by_hand(x, u, meal):
    """Right-hand side of the 19 balances, one scalar at a time, every constant typed where it is used."""
    G_BV, G_BI, G_H, G_G, G_L, G_K, G_PV, G_PI = x[:8]
    I_B, I_H, I_G, I_L, I_K, I_PV, I_PI = x[8:15]
    A_IHGP, A_IHGU, N, A_NHGP = x[15:]

    M_N = 2.7 * tanh(0.388 * N)
    HGP = 155 * A_IHGP * (M_N - A_NHGP) * (1.425 - 1.406 * tanh(0.6199 * (G_L / 101 - 0.4969)))
    HGU = 20 * A_IHGU * (5.6648 + 5.6589 * tanh(2.4375 * (G_L / 101 - 1.48)))
    PGU = 35 * (G_PI / 86.81) * (7.035 + 6.51623 * tanh(0.33827 * (I_PI / 5.304 - 5.82113)))
    KE = 71 + 71 * tanh(0.011 * (G_K - 460)) if G_K < 460 else -330 + 0.872 * G_K
    PNR = (1.3102 - 0.61016 * tanh(1.0571 * (I_H / 15.15 - 0.46981))) * (
        2.9285 - 2.095 * tanh(4.18 * (G_H / 91.89 - 0.6191))
    )
    PIC = I_PI / ((1 - 0.15) / (0.15 * 1.05) - 20 / 6.74)
    return np.array(
        [
            5.9 * (G_H - G_BV) / 3.5 - (G_BV - G_BI) * 4.5 / (2.1 * 3.5),
            (G_BV - G_BI) / 2.1 - 70 / 4.5,
            (5.9 * G_BV + 12.6 * G_L + 10.1 * G_K + 15.1 * G_PV - 43.7 * G_H - 10) / 13.8,
            (10.1 * (G_H - G_G) - 20 + meal) / 11.2,
            (2.5 * G_H + 10.1 * G_G - 12.6 * G_L + HGP - HGU) / 25.1,
            (10.1 * (G_H - G_K) - KE) / 6.6,
            15.1 * (G_H - G_PV) / 10.4 - (G_PV - G_PI) * 67.4 / (5.0 * 10.4),
            (G_PV - G_PI) / 5.0 - PGU / 67.4,
            0.45 * (I_H - I_B) / 0.26,
            (0.45 * I_B + 0.90 * I_L + 0.72 * I_K + 1.05 * I_PV - 3.12 * I_H + u) / 0.99,
            0.72 * (I_H - I_G) / 0.94,
            ((1 - 0.40) * (0.18 * I_H + 0.72 * I_G) - 0.90 * I_L) / 1.14,
            (0.72 * (I_H - I_K) - 0.30 * 0.72 * I_H) / 0.51,
            1.05 * (I_H - I_PV) / 0.74 - (I_PV - I_PI) * 6.74 / (20 * 0.74),
            (I_PV - I_PI) / 20 - PIC / 6.74,
            (1.2088 - 1.138 * tanh(1.669 * (I_L / 21.43 - 0.8885)) - A_IHGP) / 25,
            (2 * tanh(0.549 * I_L / 21.43) - A_IHGU) / 25,
            0.0916 * (PNR - N),
            ((M_N - 1) / 2 - A_NHGP) / 65,
        ]
    )


def meal_by_hand(t_min, carbs_g, start_min):
    """Appearance in mg/min of a meal of at least 10.8 g: four ramps of emptying through a gut of 60 min."""

    def R(z):
        return 60 * z - 3600 * (1 - exp(-z / 60)) if z > 0 else 0.0

    t, fall = t_min - start_min, carbs_g * 1000 / 360
    return 12 / 60 * (R(t) - R(t - 30) - R(t - fall) + R(t - fall - 30))


@pytree
class Script:
    """A controller that reads its doses from a list and then repeats the last one."""

    rates_mU_min: jax.Array
    sample_time_min: float = static(default=5.0)

    def init(self, observation):
        del observation
        return jnp.asarray(0)

    def step(self, state, observation):
        del observation
        rate = self.rates_mU_min[jnp.minimum(state, self.rates_mU_min.shape[0] - 1)]
        return state + 1, Decision(insulin_mU_min=rate, status=jnp.asarray(Status.OK))


@pytree
class OpenPump:
    """A pump without limits."""

    def init(self, insulin_mU_min, key):
        del insulin_mU_min, key
        return ()

    def deliver(self, state, command_mU_min, key):
        del key
        return state, Delivery(insulin_mU_min=command_mU_min, reported_mU_min=command_mU_min)


@pytest.fixture(scope="session", name="sorensen_by_hand")
def _sorensen_by_hand():
    return sorensen_by_hand


@pytest.fixture(scope="session", name="meal_by_hand")
def _meal_by_hand():
    return meal_by_hand


@pytest.fixture(scope="session")
def script():
    """Make a controller of a list of doses."""
    return lambda rates: Script(rates_mU_min=jnp.atleast_1d(jnp.asarray(rates, float)))


@pytest.fixture(scope="session")
def open_pump():
    return OpenPump()


@pytest.fixture(scope="session")
def patient_81():
    return patient()


@pytest.fixture(scope="session")
def patient_22():
    return patient(operating_point="nominal-22")


@pytest.fixture(scope="session")
def patient_fasting_81():
    return patient(operating_point="fasting-81")


@pytest.fixture(scope="session")
def insulin_test():
    """Record of a patient under one pulse up and one down, each 22.33 mU/min, free of noise."""

    def record(person):
        insulin = person.basal_insulin_mU_min + design_csrs(36, 22.33)
        trace = simulate(
            person,
            Script(rates_mU_min=insulin),
            pump=OpenPump(),
            scenario=Scenario([], 360.0),
            integrator=Adaptive(1e-11),
        )
        glucose = jnp.append(trace.glucose_mg_dl, person.glucose_mg_dl(trace.states[-1]))
        return Record(insulin_mU_min=insulin, glucose_mg_dl=glucose, sample_time_min=5.0)

    return record


@pytest.fixture(scope="session")
def record_81(patient_81, insulin_test):
    return insulin_test(patient_81)


@pytest.fixture(scope="session")
def identified_81(record_81):
    return identify_record(record_81)


@pytest.fixture(scope="session")
def identified_22(patient_22, insulin_test):
    return identify_record(insulin_test(patient_22))


@pytest.fixture(scope="session")
def undershoot_and_settling():
    """Undershoot in mg/dl, and minutes from the meal at 50 min to when glucose stays in a band about the setpoint."""

    def measure(fine_glucose, setpoint, band):
        glucose, setpoint = np.asarray(fine_glucose), float(setpoint)
        outside = np.flatnonzero(np.abs(glucose - setpoint) > band * setpoint)
        return setpoint - glucose.min(), outside[-1] + 1 - 50

    return measure
