"""What holds whatever fails: balances, limits, and that a loop finds back when a fault is over."""

import functools
import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from glucoloop.build.designs import with_guard
from glucoloop.build.random_keys import keys_of_people
from glucoloop.build.surroundings import faulty_pump, faulty_sensor
from glucoloop.control import GuardSettings, Status, design_pid, guarded, internal_model_tuning
from glucoloop.faults import FAULTS, Episodes, Missing, Nonsense
from glucoloop.meals import Meal, Scenario, eaten
from glucoloop.metrics.running import RunningMetrics
from glucoloop.patients import patient
from glucoloop.patients.population import population, virtual_people
from glucoloop.pumps import PARKER_1999_LIMITS, LimitedPump
from glucoloop.sensors import white_noise
from glucoloop.simulation import Adaptive, simulate
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.cohort import Cohort, People
from glucoloop.studies.verification.campaign import (
    KINDS,
    PUMP_KINDS,
    _random_faults,
    _random_order,
    catalogue_controller,
)
from glucoloop.therapy import given_profile

LEAST, MOST, CHANGE = 0.0, 66.9, 16.7
PID = design_pid(internal_model_tuning(-3.0, 80.0, 5.0, 30.0))


# balances


def test_glucose_and_insulin_are_conserved_whatever_fails(ledger, conserved):
    scenario = Scenario([Meal(60.0, 31.7)], 200.0)
    faults = _random_faults(_random_order(4, 0), 4, np.arange(400), 40)
    of_pump = sum(faults.there[kind].astype(int) for kind in PUMP_KINDS)
    both = np.flatnonzero((of_pump >= 1) & (sum(faults.there[kind].astype(int) for kind in KINDS) == 3))
    lost = []
    for person in both[:4]:
        pump = faults.pump(PARKER_1999_LIMITS, person=person)
        trace = simulate(
            ledger(patient()), PID, faults.sensor(person=person), pump, scenario, int(person), integrator=Adaptive(1e-9)
        )
        states, dose = np.asarray(trace.states), np.asarray(trace.insulin_mU_min)
        conserved(states)
        # what is booked as given is what the pump delivered, not what it was asked for or reported
        np.testing.assert_allclose(np.diff(states[:, 21]), 5.0 * dose, rtol=1e-9, atol=1e-7)
        lost.append(np.abs(np.asarray(trace.command_mU_min) - dose).max())
    assert max(lost) > 5.0


# limits


def timing():
    """Onset and length, in minutes."""
    return st.tuples(st.integers(0, 30).map(lambda k: 5 * k), st.none() | st.integers(1, 48).map(lambda k: 5 * k))


def number(kind, about):
    """Text of a possible value of a setting."""
    if kind is bool:
        return st.sampled_from(["true", "false"])
    if kind is int:
        return st.integers(int(max(about.at_least, -50)), int(min(about.at_most, 50))).map(str)
    least, most = max(about.at_least, about.above, -1e6), min(about.at_most, about.below, 1e6)
    some = st.floats(least, most, allow_nan=False).filter(about.allows).map(repr)
    return some if about.finite else some | st.sampled_from(["nan", "inf", "-inf", "0", "2000", "1e300", "-1e300"])


SETTINGS = {
    entry.name: {name: number(setting.kind, setting.about) for name, setting in entry.effect_settings().items()}
    for entry in FAULTS.values()
    if entry.timed and not entry.shared
}
"""Strategies of the settings of every fault that comes and goes, but of those whose settings change the program."""


@st.composite
def fault_texts(draw):
    """Every fault, each with numbers of its own; most of them begin too late to be seen."""
    texts = []
    for name, own in SETTINGS.items():
        start, lasts = draw(timing())
        parts = [name, f"start_min={start if draw(st.booleans()) else 10_000}"]
        parts += [] if lasts is None else [f"duration_min={lasts}"]
        given = {key: draw(value) for key, value in own.items()}
        if name == "saturation":
            low, high = sorted(given, key=lambda end: float(given[end]))
            assume(given[low] != given[high])
            given = {"low_mg_dl": given[low], "high_mg_dl": given[high]}
        if "noticed" in given:  # part of the program
            given["noticed"] = "false"
        texts.append(", ".join([*parts, *(f"{key}={value}" for key, value in given.items())]))
    return texts


@pytest.mark.parametrize("controller", [PID, guarded(PID)], ids=["bare", "guarded"])
@settings(max_examples=40)
@given(texts=fault_texts(), key=st.integers(0, 2**31))
def test_doses_keep_the_limits_whatever_fails(controller, texts, key):
    told = [FAULTS.choose(text) for text in texts]
    trace = simulate(
        patient(),
        controller,
        faulty_sensor(white_noise(), told, 5.0),
        faulty_pump(LimitedPump(), told, 5.0, PARKER_1999_LIMITS),
        Scenario([Meal(60.0, 31.7)], 150.0),
        key,
    )
    command, dose, word = (np.asarray(of) for of in (trace.command_mU_min, trace.insulin_mU_min, trace.reported_mU_min))
    assert np.all((command >= LEAST) & (command <= MOST))
    assert np.all((dose >= LEAST) & (dose <= MOST))
    before = np.r_[float(trace.basal_insulin_mU_min), word[:-1]]
    # what no pump can give is no rate to keep to; a report beyond the request may be wrong, and lifts no dose
    meant = np.isfinite(before) & (before <= MOST)
    start = np.minimum(before, np.r_[float(trace.basal_insulin_mU_min), command[:-1]])
    assert np.all((command - before)[meant] <= CHANGE + 1e-9)
    assert np.all((start - command)[meant] <= CHANGE + 1e-9)
    assert np.all(np.isin(trace.status, list(Status)))
    states = np.asarray(trace.states)
    assert np.all(np.isfinite(states))
    assert states[:, 8:15].min() >= 0.0  # insulin
    assert states[:, 17].min() >= 0.0  # glucagon
    silent = ~np.asarray(trace.reading_valid) | ~np.isfinite(np.asarray(trace.reading_mg_dl))
    assert np.all(np.asarray(trace.status)[silent] != Status.OK)


# finding back

BACK_MG_DL = 5.0


@functools.cache
def two_people():
    return virtual_people(population("nominal"), 0, np.zeros(2, int))


@dataclass(frozen=True)
class Gaps:
    """The loops of many gaps, of a controller on the nominal patient and the oral glucose test of 50 g."""

    cohort: Cohort
    controller: object
    accumulator: RunningMetrics
    samples: int

    def run(self, onset, samples, value):
        """With a gap from a sample on, during which the sensor tells a number; nothing where that is NaN."""
        n = len(onset)
        people = virtual_people(population("nominal"), 0, np.zeros(n, int))
        return self.cohort.run(
            People(
                patient=people.patient,
                x=people.rest,
                insulin_mU_min=people.basal_insulin_mU_min,
                key=keys_of_people(0, np.arange(n)),
                controller=given_profile(self.controller, people.profile),
                sensor=sensor_with_gap(np.asarray(onset, float), np.asarray(samples, float), value),
            )
        )

    def late_min(self, onset, samples, value):
        """For each gap, by how much more than the settling time the loop takes to find back; below 0: it is in time."""
        onset, samples = np.r_[np.inf, onset], np.r_[1.0, samples]
        run = self.run(onset, samples, value)
        metrics = self.accumulator.finish(run.accumulator, samples=self.samples, sample_time_min=5.0, meal_t_min=50.0)
        assert metrics.settled_2pct[0]
        glucose = run.glucose_mg_dl[:, 1:]
        away = np.abs(glucose - run.glucose_mg_dl[:, :1]) > BACK_MG_DL
        t_min = 5.0 * np.arange(1, away.shape[0] + 1)
        back = np.max(np.where(away, t_min[:, None], 0.0), axis=0)
        assert np.all((run.insulin_mU_min >= LEAST) & (run.insulin_mU_min <= MOST))
        return back - 5.0 * (onset + samples)[1:] - metrics.settling_2pct_min[0]


def sensor_with_gap(onset, samples, value):
    lost = Missing(schedule=gap(onset, samples, np.isnan(value)))
    nonsense = Nonsense(schedule=gap(onset, samples, not np.isnan(value)), inner=lost)
    return nonsense.replaced(value=np.full_like(onset, value)[()])


def gap(onset, samples, there):
    first = onset if there else np.full_like(onset, np.inf)[()]
    return Episodes(earliest=first, latest=first, length=samples)


def gaps(name, guard, horizon_min):
    grid = sample_grid(horizon_min, 5.0)
    controller = with_guard(catalogue_controller(name), GuardSettings() if guard else None, PARKER_1999_LIMITS)
    nominal = patient()
    accumulator = RunningMetrics(
        setpoint_mg_dl=float(nominal.setpoint_mg_dl), inside_min=tuple(grid.inside_min.tolist())
    )
    cohort = Cohort(
        nominal,
        two_people().patient,
        controller,
        sensor_with_gap(np.float64(1.0), np.float64(1.0), 0.0),
        LimitedPump(),
        grid,
        accumulator,
        setpoint_mg_dl=float(nominal.setpoint_mg_dl),
        meals=eaten([Meal(50.0, 50.0)]),
        varied_controller=given_profile(controller, two_people().profile),
        varied_sensor=sensor_with_gap(np.ones(2), np.ones(2), 0.0),
    )
    return Gaps(cohort=cohort, controller=controller, accumulator=accumulator, samples=grid.samples)


EVERY_LENGTH, EVERY_ONSET = (of.ravel() for of in np.meshgrid(np.arange(1, 49), np.arange(72)))


@pytest.mark.parametrize("name", ["imc", "mpc", "mpc-se"])
@pytest.mark.parametrize("guard", [False, True], ids=["bare", "guarded"])
def test_a_loop_finds_back_after_every_gap_in_the_time_in_which_it_settles(name, guard):
    loops = gaps(name, guard, 1440.0)
    assert loops.late_min(EVERY_ONSET, EVERY_LENGTH, math.nan).max() <= 0.0
    for value in (0.0, 2000.0):
        late = loops.late_min(EVERY_ONSET, EVERY_LENGTH, value)
        if guard or name != "mpc":
            assert late.max() <= 0.0
        else:  # one of 3456, by 20 min: zeros for 130 min from 130 min on
            assert (late > 0.0).sum() <= 1
            assert late.max() <= 20.0
