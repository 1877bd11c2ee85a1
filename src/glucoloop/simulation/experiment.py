"""Experiments on a virtual patient without a controller: excitation, and identification from the response.

They are of one person, or the pulse experiment of the paper on many people at once.
"""

from __future__ import annotations

from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.typing import ArrayLike

from glucoloop._disk_cache import keeps_result
from glucoloop._kept_programs import kept_jit
from glucoloop._pytree import chosen, replaced
from glucoloop.arguments import checked, on_host, random_key
from glucoloop.component.routes import SUBCUTANEOUS
from glucoloop.control.design_case import check_sample_time
from glucoloop.identification import (
    FirstOrderModel,
    Identification,
    Record,
    Validation,
    design_csrs,
    fit_first_order,
    identify_record,
    random_binary_sequence,
    validate,
)
from glucoloop.identification.basis import usual_bases
from glucoloop.meals import fasting
from glucoloop.models.state_space import step_response
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients.capabilities import insulin_route, seen_mg_dl
from glucoloop.patients.protocol import Patient
from glucoloop.refusal import Refusal
from glucoloop.sensors import IdealSensor, Sensor
from glucoloop.sensors.protocol import site_of
from glucoloop.simulation.engines import make_engine
from glucoloop.simulation.exponential import Exponential
from glucoloop.simulation.integrators import default_integrator, plants_of_people
from glucoloop.simulation.internal_model import linear_model
from glucoloop.simulation.plant import Exogenous, Integrator, Plant, SampleGrid
from glucoloop.simulation.user_objects import goes_fast

LARGEST_PULSE_MU_MIN: Final = 22.33
"""Amplitude of the pulses in the paper, its nominal rate."""
SETTLED: Final = 0.7
"""Share of its gain that a response has at the end of a memory that is long enough for it: .8 and more of the paper's
patient at its operating points, at most .11 with subcutaneous insulin.
"""


@kept_jit
def _excite(
    plant: Plant, sensor: Sensor, x: jax.Array, insulin_mU_min: jax.Array, exogenous: Any, key: jax.Array
) -> jax.Array:
    """Readings at the start and after each sample."""
    patient = plant.patient
    sensor_key, reading_key = jax.random.split(key)
    site = site_of(sensor)
    in_sensor = sensor.init(seen_mg_dl(patient, x, site), sensor_key)

    def read(in_sensor: Any, x: jax.Array, index: jax.Array) -> tuple[Any, jax.Array]:
        in_sensor, reading = sensor.read(
            in_sensor, seen_mg_dl(patient, x, site), jax.random.fold_in(reading_key, index)
        )
        return in_sensor, jnp.where(reading.valid, reading.glucose_mg_dl, jnp.nan)

    def sample(carry: Any, entry: Any) -> Any:
        x, in_sensor = carry
        index, insulin, outside = entry
        in_sensor, reading = read(in_sensor, x, index)
        x, _ = plant.advance(x, insulin, outside)
        return (x, in_sensor), reading

    samples = insulin_mU_min.shape[0]
    (x, in_sensor), readings = jax.lax.scan(sample, (x, in_sensor), (jnp.arange(samples), insulin_mU_min, exogenous))
    _, last = read(in_sensor, x, jnp.asarray(samples))
    return jnp.concatenate([readings, last[None]])


_MIN_CHANGE_MG_DL: Final = 1e-6
"""Minimum change of glucose to which a model is fitted; rounding makes 1e-12 of it."""


@checked
def excite(
    patient: Patient,
    insulin_mU_min: ArrayLike,
    sensor: Sensor | None = None,
    key: jax.Array | int = 0,
    *,
    sample_time_min: float = 5.0,
    integrator: Integrator | None = None,
) -> Record:
    """Give a fasting patient at steady state a sequence of infusion rates and read glucose.

    Parameters
    ----------
    insulin_mU_min : (N,) array
        Rates, each held over one sample. The patient starts at steady state at the basal rate.
    sensor : Sensor, optional
        Sensor; an ideal one by default. One with dead time gives a record from which the dead time is identified too.
    integrator : Integrator, optional
        Eight exponential steps per sample by default, since the sequence may jump far.

    Returns
    -------
    Record
        N rates and N + 1 readings.

    Raises
    ------
    ValueError
        For a rate that is negative or not finite, or a sample time that is not positive.
    """
    rates = np.asarray(insulin_mU_min, float)
    if not np.all(np.isfinite(rates) & (rates >= 0.0)):
        worst = rates[~(np.isfinite(rates) & (rates >= 0.0))].flat[0]
        raise Refusal(f"an infusion of {worst:g} mU/min cannot be delivered; give finite rates of 0 or more")
    if integrator is None:
        fast = goes_fast(patient)
        integrator = Exponential(substeps=8, near_rest=True) if fast else default_integrator(patient)
    key = random_key(key)
    grid = SampleGrid(sample_time_min=sample_time_min, samples=rates.size)
    plant, exogenous = integrator.prepare(patient, fasting(), grid)
    x = patient.steady_state(patient.basal_insulin_mU_min)
    glucose = _excite(plant, sensor or IdealSensor(), x, jnp.asarray(rates), exogenous, key)
    return Record(insulin_mU_min=jnp.asarray(rates), glucose_mg_dl=glucose, sample_time_min=sample_time_min)


@checked
@on_host("a least-squares fit and its checks are made with NumPy")
@keeps_result
def identify(
    patient: Patient,
    sensor: Sensor | None = None,
    key: jax.Array | int = 0,
    *,
    memory: int | None = None,
    amplitude_mU_min: float | None = None,
    samples: int | None = None,
    laguerre_pole: float | None = None,
    laguerre_functions: int | str | None = "usual",
    subcutaneous: bool | None = None,
    sample_time_min: float = 5.0,
) -> Identification:
    """Identify a step-response model of a patient by the paper's pulse experiment (Sec. III): the result's ``model``.

    Parameters
    ----------
    sensor : Sensor, optional
        Sensor; an ideal one by default, while `white_noise` gives the paper's noisy record.
    memory, laguerre_pole, laguerre_functions, subcutaneous
        As for `identify_record`; by default 3 h, a pole of 0.84 at 5-min samples and 2 functions for a vein; 24 h, 0.96
        and 8 under the skin.
    amplitude_mU_min : float, optional
        Height of the pulses, at most the basal rate; by default the paper's 22.33 mU/min, or the basal rate where that
        is less.
    samples : int, optional
        Length of the record; the shortest, ``2 M``, by default.

    Notes
    -----
    Memory, pole, functions and route that are not given are those for subcutaneous insulin if the patient has it so,
    or if its response to a small step has less than `SETTLED` of its gain at the end of the paper's memory, and else
    the paper's.

    Raises
    ------
    ValueError
        For an amplitude above the basal rate, a record that is too short, or a setting out of bounds.
    """
    check_sample_time(sample_time_min)
    basal = float(patient.basal_insulin_mU_min)
    if amplitude_mU_min is None:
        amplitude_mU_min = min(LARGEST_PULSE_MU_MIN, basal)
    if not amplitude_mU_min <= basal:
        raise Refusal(
            f"pulses of {amplitude_mU_min:g} mU/min would take away more insulin than the basal rate; "
            f"give an amplitude of at most {basal:.2f} mU/min"
        )
    paper, *_, slow = usual_bases(sample_time_min)
    if subcutaneous is None:
        of_route = insulin_route(patient) == SUBCUTANEOUS
        subcutaneous = of_route or _is_slow(patient, sample_time_min, paper.memory)
    usual = slow if subcutaneous else paper
    memory = usual.memory if memory is None else memory
    sequence = design_csrs(memory, amplitude_mU_min, samples)
    record = excite(patient, basal + np.asarray(sequence), sensor, key, sample_time_min=sample_time_min)
    return identify_record(
        record,
        memory=memory,
        laguerre_pole=usual.pole if laguerre_pole is None else laguerre_pole,
        laguerre_functions=usual.functions if laguerre_functions == "usual" else laguerre_functions,
        subcutaneous=subcutaneous,
        basal_insulin_mU_min=basal,
    )


def _is_slow(patient: Patient, sample_time_min: float, memory: int) -> bool:
    """Whether the response of a patient to a small step of insulin is far from settled after a memory."""
    model = linear_model(patient, sample_time_min=sample_time_min)
    gain = model.C @ jnp.linalg.solve(jnp.eye(model.Gamma.size) - model.Phi, model.Gamma)
    return not float(step_response(model, memory)[-1] / gain) >= SETTLED


@checked
def validate_on(
    patient: Patient,
    model: StepResponseModel,
    *,
    samples: int = 100,
    amplitude_mU_min: float | None = None,
    seed: int = 0,
) -> tuple[Record, Validation]:
    """Drive a random binary sequence through the patient and the model, as the paper does for its Fig. 3.

    Parameters
    ----------
    amplitude_mU_min : float, optional
        Amplitude; a tenth of the basal rate by default.

    Returns
    -------
    record : Record
        The patient's noise-free answer.
    validation : Validation
        Prediction and residuals.
    """
    basal = float(patient.basal_insulin_mU_min)
    amplitude = 0.1 * basal if amplitude_mU_min is None else amplitude_mU_min
    sequence = np.asarray(random_binary_sequence(samples, amplitude, seed))
    record = excite(patient, basal + sequence, sample_time_min=model.sample_time_min)
    return record, validate(model, sequence, record.glucose_mg_dl - patient.setpoint_mg_dl)


@checked
@on_host("SciPy fits the model")
def fit_step(
    patient: Patient,
    *,
    step_mU_min: float | None = None,
    horizon_min: float = 600.0,
    delay_min: float | None = 5.0,
    sample_time_min: float = 5.0,
) -> FirstOrderModel:
    """First-order model with dead time, fitted to a patient's response to a lasting step of insulin.

    Parameters
    ----------
    step_mU_min : float, optional
        Height of the step above the basal rate; by default half the paper's nominal rate, 11.165 mU/min, or half the
        basal rate where that is less.
    delay_min : float or None
        Dead time of the model; None fits it too.

    Raises
    ------
    ValueError
        For a step that cannot be delivered or fitted, or a sample time that is not positive.
    """
    check_sample_time(sample_time_min)
    samples = round(horizon_min / sample_time_min)
    basal = float(patient.basal_insulin_mU_min)
    if step_mU_min is None:
        step_mU_min = min(LARGEST_PULSE_MU_MIN, basal) / 2.0
    record = excite(patient, np.full(samples, basal + step_mU_min), sample_time_min=sample_time_min)
    response = np.asarray(record.glucose_mg_dl - patient.setpoint_mg_dl)
    if not np.abs(response).max() >= _MIN_CHANGE_MG_DL:
        raise Refusal(
            f"a step of {step_mU_min:g} mU/min moves glucose by {np.abs(response).max():.2g} mg/dl, which is "
            "hardly more than rounding; give a larger step"
        )
    return fit_first_order(sample_time_min * np.arange(samples + 1), response, step_mU_min, delay_min)


Floats = npt.NDArray[np.float64]

SUBSTEPS: Final = 8
"""Number of substeps of a sample, as in `excite`, since pulses change insulin by much."""


class PulseExperiment:
    """Readings of fasting people under a sequence of infusion rates from steady state on; patients as for `Cohort`."""

    def __init__(self, nominal: Patient, varied: Patient, sensor: Sensor, *, sample_time_min: float) -> None:
        grid = SampleGrid(sample_time_min=sample_time_min, samples=1)
        self._plants, self._sensor = plants_of_people(nominal, varied, grid, SUBSTEPS), sensor
        self._sample_time_min = sample_time_min
        self._fasting = jnp.zeros((self._plants.substeps, 3))
        self._begin_people = jax.jit(jax.vmap(self._begin, in_axes=(-1, 0), out_axes=(-1, 0)))
        x = nominal.steady_state(nominal.basal_insulin_mU_min)
        carry, key = self._begin(x, jax.random.key(0))
        self._engine = make_engine(
            self._step,
            chosen(self._plants.single, self._plants.varies),
            carry,
            jnp.zeros(()),
            jnp.zeros(()),
            key,
            name=None,
            precision="float64",
        )

    def _begin(self, x: jax.Array, key: jax.Array) -> tuple[Any, jax.Array]:
        sensor_key, reading_key = jax.random.split(key)
        glucose = seen_mg_dl(self._plants.single.patient, x, site_of(self._sensor))
        return (x, self._sensor.init(glucose, sensor_key)), reading_key

    def _step(self, values: Any, carry: Any, insulin: Any, shared: Any, rng: Any) -> tuple[Any, jax.Array]:
        (x, in_sensor), (key, index) = carry, rng
        plant = replaced(self._plants.single, self._plants.varies, values)
        glucose = seen_mg_dl(plant.patient, x, site_of(self._sensor))
        in_sensor, reading = self._sensor.read(in_sensor, glucose, jax.random.fold_in(key, index))
        x, _ = plant.advance(x, insulin, Exogenous(t_min=shared, moments=self._fasting))
        return (x, in_sensor), jnp.where(reading.valid, reading.glucose_mg_dl, jnp.nan)

    def run(self, patient: Patient, x: Floats, insulin_mU_min: Floats, key: jax.Array) -> Floats:
        """Readings ``(samples + 1, people)``, as `excite` gives them for one person.

        The people rest in the states `x`, ``(states, people)``; each rate ``(samples, people)`` is held over one
        sample.
        """
        carry, keys = self._begin_people(jnp.asarray(x), key)
        rates = np.concatenate([insulin_mU_min, insulin_mU_min[-1:]])  # what follows the last reading is not looked at
        times = self._sample_time_min * np.arange(rates.shape[0])
        values = chosen(self._plants.of(patient), self._plants.varies)
        _, readings = self._engine.run(values, carry, rates, times, keys)
        return np.asarray(readings, np.float64)
