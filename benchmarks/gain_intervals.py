"""Measure how often the interval of an identified gain holds the person's gain, and how many models are refused.

    python benchmarks/gain_intervals.py                         every case with 100 seeds, some minutes
    python benchmarks/gain_intervals.py --seeds 500 600 wilinska     the cases of one patient, with other seeds

Records of 48 h in open loop, from rest. The truth is the gain of the linearised patient, or that of a known response.
A model is refused if it has any doubt; `close` of those refused are within a quarter of the truth. `wrong` of those
accepted are off by more than twofold.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Iterator

import jax.numpy as jnp
import numpy as np

import glucoloop as gl
from glucoloop.identification import Record, design_csrs, identify_record, random_binary_sequence
from glucoloop.patients import PATIENTS
from glucoloop.sensors import Sensor, cgm, white_noise

SAMPLE_TIME_MIN, SAMPLES = 5.0, 576
BASAL_MU_MIN, GAIN = 25.0, -5.0
VARIANCE = 1.45
PEOPLE = ("parker-1999", "hovorka-2004", "wilinska-2010", "uva-padova-2008", "kanderian-2009", "mcgill-2020")


def white(amplitude: float, seed: int) -> np.ndarray:
    """A new rate in each sample."""
    return np.random.default_rng(1000 + seed).uniform(-amplitude, amplitude, SAMPLES)


def steps(amplitude: float, seed: int) -> np.ndarray:
    """Up or down for half an hour."""
    return np.asarray(random_binary_sequence(SAMPLES, amplitude, seed, hold_samples=6))


def pulses(amplitude: float, seed: int) -> np.ndarray:
    """One pulse up and one down."""
    return np.asarray(design_csrs(SAMPLES // 2, amplitude))


def lags(tau_min: float) -> np.ndarray:
    """Step response of two depots of 50 min and a lag."""
    t_min, taus = SAMPLE_TIME_MIN * np.arange(SAMPLES + 1), np.array([50.0, 50.01, tau_min])
    return 1.0 - sum(
        np.exp(-t_min / tau) * np.prod([tau / (tau - other) for other in taus if other != tau]) for tau in taus
    )


def of_response(
    step: np.ndarray, inputs: Callable[[float, int], np.ndarray], amplitude: float, variance: float
) -> Callable[[int], Record]:
    """Record of a known response with a gain of -5, by its seed."""

    def record(seed: int) -> Record:
        insulin = inputs(amplitude, seed)
        glucose = 120.0 + np.append(0.0, np.convolve(insulin, GAIN * np.diff(step))[:SAMPLES])
        glucose += np.sqrt(variance) * np.random.default_rng(seed).standard_normal(SAMPLES + 1)
        rates = jnp.asarray(BASAL_MU_MIN + insulin)
        return Record(insulin_mU_min=rates, glucose_mg_dl=jnp.asarray(glucose), sample_time_min=SAMPLE_TIME_MIN)

    return record


def of_patient(
    patient: gl.patients.Patient, inputs: Callable[[float, int], np.ndarray], amplitude: float, sensor: Sensor
) -> Callable[[int], Record]:
    """Record of a patient by its seed; missing readings are interpolated."""

    def record(seed: int) -> Record:
        basal = float(patient.basal_insulin_mU_min)
        result = gl.excite(patient, basal + inputs(amplitude, seed), sensor, seed)
        readings = np.asarray(result.glucose_mg_dl)
        read = np.flatnonzero(np.isfinite(readings))
        glucose = np.interp(np.arange(readings.size), read, readings[read])
        return dataclasses.replace(result, glucose_mg_dl=jnp.asarray(glucose))

    return record


def gain_of(patient: gl.patients.Patient) -> float:
    """Steady-state gain of the linearised patient."""
    model = gl.linear_model(patient, sample_time_min=SAMPLE_TIME_MIN)
    return float((model.C @ jnp.linalg.solve(jnp.eye(model.Gamma.size) - model.Phi, model.Gamma)).squeeze())


def cases() -> Iterator[tuple[str, float, float, Callable[[int], Record], bool]]:
    """Name, gain, basal rate, record by seed, and whether the experiment is one of pulses."""
    single, two = lags(173.0), 0.6 * lags(80.0) + 0.4 * lags(400.0)
    far = 0.6 * lags(80.0) + 0.4 * lags(1000.0)
    known = (
        ("half in 210 min, white input", single, white, 5.0, VARIANCE),
        ("half in 210 min, steps", single, steps, 5.0, VARIANCE),
        ("half in 210 min, pulses", single, pulses, 20.0, VARIANCE),
        ("two fifths at 400 min, steps, variance 9", two, steps, 5.0, 9.0),
        ("two fifths at 1000 min, steps", far, steps, 5.0, VARIANCE),
    )
    for name, step, inputs, amplitude, variance in known:
        yield name, GAIN, BASAL_MU_MIN, of_response(step, inputs, amplitude, variance), inputs is pulses
    noise = white_noise(VARIANCE)
    for name in PEOPLE:
        patient = gl.patient(name)
        basal = float(patient.basal_insulin_mU_min)
        experiments = (
            ("white input of 50 %", white, 0.5 * basal, noise),
            ("steps of 10 %", steps, 0.1 * basal, noise),
            ("steps of 20 %", steps, 0.2 * basal, noise),
            ("steps of 50 %, white noise", steps, 0.5 * basal, noise),
            ("pulses", pulses, min(22.33, basal), noise),
            ("steps of 20 %, Dexcom G6", steps, 0.2 * basal, cgm.DexcomG6()),
            ("steps of 50 %, Dexcom G6", steps, 0.5 * basal, cgm.DexcomG6()),
            ("pulses, Dexcom G6", pulses, min(22.33, basal), cgm.DexcomG6()),
        )
        for experiment, inputs, amplitude, sensor in experiments:
            if PATIENTS.find(name).subcutaneous or inputs is not pulses:
                record = of_patient(patient, inputs, amplitude, sensor)
                yield f"{name}, {experiment}", gain_of(patient), basal, record, inputs is pulses


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="parts of the names of cases; all by default")
    parser.add_argument("--seeds", nargs=2, type=int, default=(1000, 1100), metavar=("FIRST", "END"))
    request = parser.parse_args()
    print(f"{'case':46s} refused (close)  cover/accepted  wrong  half/gain")
    for name, gain, basal, record, by_pulses in cases():
        if request.names and not any(part in name for part in request.names):
            continue
        keywords = {"subcutaneous": True, "memory": SAMPLES // 2, "laguerre_pole": 0.96, "laguerre_functions": 8}
        rows = []
        for seed in range(*request.seeds):
            method, given = ("csrs", keywords) if by_pulses else ("least-squares", {})
            model = identify_record(record(seed), method, basal_insulin_mU_min=basal, **given)
            ends = model.reliability.gain_from, model.reliability.gain_to
            covered, half = ends[0] <= gain <= ends[1], 0.5 * (ends[1] - ends[0]) / -gain
            rows.append((float(model.model.gain) / gain, half, covered, bool(model.doubts())))
        share, half_width, covered, doubtful = np.array(rows).T
        refused, accepted = doubtful == 1.0, doubtful == 0.0
        close = int(np.sum(refused & (np.abs(share - 1.0) < 0.25)))
        wrong = (share > 2.0) | (share < 0.5)
        width = f"{np.median(half_width[accepted]):.2f}" if accepted.any() else "-"
        counts = f"{refused.sum():7d} ({close:5d})  {int(covered[accepted].sum()):5d}/{accepted.sum():<8d}"
        print(f"{name:46s} {counts}  {int(wrong[accepted].sum()):5d}  {width:>11s}", flush=True)


if __name__ == "__main__":
    main()
