"""Every controller of the catalogue, bare and guarded, in both precisions: C gives the bits of its definition."""

import dataclasses
import itertools
import platform

import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.build.designs import controller_of
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.control.glucagon import GLUCAGON
from glucoloop.control.guard_settings import GuardSettings
from glucoloop.control.protocol import Observation
from glucoloop.firmware.exported import export
from glucoloop.firmware.samples import arithmetic, decision_of, equal, leaves_of
from glucoloop.native.targets.c.host import Library, compiler
from glucoloop.situations.case import default_case
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured, default_situation

QUICK = ("pid", "mpc")
SETTINGS = ("-O0", "-O2", "-O3")
if platform.machine() == "x86_64":
    SETTINGS += ("-O3 -march=native", "-O3 -march=native -mtune=skylake-avx512")

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler: install gcc")

SEEN = Observation(
    glucose_mg_dl=jnp.asarray(110.0),
    valid=jnp.asarray(True),
    setpoint_mg_dl=jnp.asarray(81.1),
    delivered_mU_min=jnp.asarray(22.3),
    announced_carbs_g=jnp.asarray(0.0),
)
READINGS = (110.0, 140.0, np.nan, 60.0, 3e38)
ANNOUNCED_G = (0.0, 45.0, 0.0, 3e38, np.nan)
"""Carbohydrate that is announced at each of them, of which some give boluses."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if entry.slow else ()) for name, entry in CONTROLLERS.items()]
)
def test_c_gives_the_bits_of_its_definition(name):
    situation = default_situation()
    case = default_case(name, situation)
    guards, precisions = (None, GuardSettings()), ("float64", "float32")
    # What takes seconds a sample is computed in two of the four ways, which have each guard and each precision once.
    ways = zip(guards, precisions, strict=True) if CONTROLLERS[name].slow else itertools.product(guards, precisions)
    for guard, precision in ways:
        controller = controller_of(situation, dataclasses.replace(case, guard=guard))
        exported = export(controller, situation.limits, SEEN, [name], precision=precision)
        library, (init, step) = Library(exported.source, precision), arithmetic(exported)
        state = None
        for reading, carbs_g in zip(READINGS, ANNOUNCED_G, strict=True):
            seen = dataclasses.replace(SEEN, glucose_mg_dl=jnp.asarray(reading), announced_carbs_g=jnp.asarray(carbs_g))
            leaves = leaves_of(seen, exported)
            if state is None:
                state = init(leaves)
                assert equal(library.init(leaves), state), (guard, precision)
            in_c = library.step(state, leaves)
            state, decided = step(state, leaves)
            assert equal((*in_c[0], *in_c[1]), (*state, *decided)), (guard, precision, reading)
            decision = decision_of(decided, exported)
            assert 0.0 <= decision.insulin_mU_min <= situation.limits.max_mU_min
            assert (decision.bolus_mU is not None) == CONTROLLERS[name].gives_boluses
        if CONTROLLERS[name].slow and precision == "float32":
            compare_settings(exported, library, (SETTINGS[0], SETTINGS[-1]))


def test_c_of_a_controller_with_a_sample_time_of_its_own_gives_the_bits_of_its_definition():
    run = configured(Run, controller=["pid, every=3min"], sample_time_min=1.0)
    exported = export(controller_of(run, run.case), run.limits, SEEN, ["pid"], precision="float32")
    library, (init, step) = Library(exported.source, "float32"), arithmetic(exported)
    state, doses = None, []
    for reading in 110.0 + 0.3 * np.arange(10.0):
        leaves = leaves_of(dataclasses.replace(SEEN, glucose_mg_dl=jnp.asarray(reading)), exported)
        state = init(leaves) if state is None else state
        in_c = library.step(state, leaves)
        state, decided = step(state, leaves)
        assert equal((*in_c[0], *in_c[1]), (*state, *decided)), reading
        doses.append(float(decided[0]))
    changes = np.flatnonzero(np.diff(doses)) + 1
    assert changes.tolist() == [3, 6, 9]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.long)
        for name, entry in CONTROLLERS.items()
        if not entry.slow  # whose settings are compared where its bits are, as each export takes long
    ],
)
def test_the_settings_of_the_compiler_change_no_bit(name):
    situation = default_situation()
    exported = export(
        controller_of(situation, default_case(name, situation)), situation.limits, SEEN, [name], precision="float32"
    )
    compare_settings(exported, Library(exported.source, "float32"), SETTINGS)


def compare_settings(exported, first, settings):
    """Check that C in float32 gives the bits of a library with each setting of the compiler."""
    libraries = {setting: Library(exported.source, "float32", setting) for setting in settings}
    glucose_mg_dl = 110.0 + 60.0 * np.sin(np.arange(40.0) / 5.0)
    state = None
    for reading in (*glucose_mg_dl, *READINGS):
        leaves = leaves_of(dataclasses.replace(SEEN, glucose_mg_dl=jnp.asarray(reading)), exported)
        before = first.init(leaves) if state is None else state
        state, decided = first.step(before, leaves)
        for setting, library in libraries.items():
            after = library.step(before, leaves)
            assert equal((*after[0], *after[1]), (*state, *decided)), (setting, reading)


@pytest.mark.parametrize("guard", [None, "usual"])
@pytest.mark.parametrize("way", list(GLUCAGON))
def test_c_of_a_controller_with_glucagon_gives_the_bits_of_its_definition(way, guard):
    settings = {"controller": ["mpc"], "glucagon": way, "guard": guard, "pump": "max_glucagon_ug=100"}
    run = configured(Run, settings)
    for precision in ("float64", "float32"):
        exported = export(
            controller_of(run, run.case), run.limits, SEEN, [way], precision=precision, glucagon=run.glucagon_limits
        )
        library, (init, step) = Library(exported.source, precision), arithmetic(exported)
        state, decisions, delivered = None, [], 22.3
        for reading in (110.0, 90.0, 69.0, 55.0, np.nan, 40.0, 40.0, 3e38, 60.0, 62.0, 120.0):
            seen = dataclasses.replace(
                SEEN, glucose_mg_dl=jnp.asarray(reading), delivered_mU_min=jnp.asarray(delivered)
            )
            leaves = leaves_of(seen, exported)
            state = init(leaves) if state is None else state
            in_c = library.step(state, leaves)
            state, decided = step(state, leaves)
            assert equal((*in_c[0], *in_c[1]), (*state, *decided)), (precision, reading)
            decisions.append(decision_of(decided, exported))
            fall = delivered - float(decisions[-1].insulin_mU_min)
            assert fall <= float(run.limits.max_change_mU_min) * (1.0 + 1e-6)
            delivered = float(decisions[-1].insulin_mU_min)
        glucagon_ug = [float(decision.glucagon_ug) for decision in decisions]
        assert 0.0 < max(glucagon_ug) <= 100.0
        assert glucagon_ug[0] == glucagon_ug[-1] == 0.0


@pytest.mark.long
def test_c_of_the_guard_by_forecast_gives_the_bits_of_its_definition():
    run = configured(
        Run, patient="hovorka-2004", controller=["basal-bolus"], guard="forecast", meals=["60g@7h"], announce_meals=True
    )
    exported = export(controller_of(run, run.case), run.limits, SEEN, ["forecast"], precision="float32")
    library, (init, step) = Library(exported.source, "float32"), arithmetic(exported)
    state, decisions, delivered = None, [], 14.0
    for reading, carbs_g in ((110.0, 0.0), (90.0, 60.0), (64.0, 60.0), (np.nan, 0.0), (110.0, 0.0), (3e38, np.nan)):
        seen = dataclasses.replace(
            SEEN,
            glucose_mg_dl=jnp.asarray(reading),
            announced_carbs_g=jnp.asarray(carbs_g),
            delivered_mU_min=jnp.asarray(delivered),
        )
        leaves = leaves_of(seen, exported)
        state = init(leaves) if state is None else state
        in_c = library.step(state, leaves)
        state, decided = step(state, leaves)
        assert equal((*in_c[0], *in_c[1]), (*state, *decided)), reading
        decisions.append(decision_of(decided, exported))
        delivered = float(decisions[-1].insulin_mU_min)
    boluses = [float(decision.bolus_mU) for decision in decisions]
    assert boluses[1] > 0.0
    assert boluses[2] == 0.0
