"""The experiments of the paper, at one operating point."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.control import Controller, design_imc, design_linear_mpc, design_mpc_se, design_nlqdmc_se
from glucoloop.control.parker1999 import IMC_DELAY_MIN, IMC_FILTER_MIN, IMC_STEP_MU_MIN, PARKER_1999
from glucoloop.identification import FirstOrderModel, Identification, Record, Validation, best_pole, laguerre_functions
from glucoloop.metrics import Metrics, summarise
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients import SorensenPatient, patient
from glucoloop.sensors import Sensor, dead_time, white_noise
from glucoloop.simulation import Trace, fit_step, identify, linear_model, nonlinear_model, simulate, validate_on
from glucoloop.trials.tuning import TuningSurface, paper_tuning_surface

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]

SAMPLE_TIME_MIN: Final = 5
NOISE_VARIANCE: Final = 1.45
DEAD_TIMES_MIN: Final = (0, 5, 10, 15)
CONTROLLERS_WITHOUT_NOISE: Final = ("mpc", "mpc-se", "nlqdmc-se", "imc")
_SMALL_STEP_MU_MIN: Final = 0.01
_BINARY_SEQUENCE_SEED: Final = 0


@dataclass(frozen=True)
class Loops:
    """Runs of one controller under several seeds."""

    metrics: Metrics
    """Each field `(seeds,)`."""
    example: Trace
    """The first seed."""


@dataclass(frozen=True)
class ModelStudy:
    """Section III: what identification gives."""

    noise_free: Identification
    noisy: Identification
    """Of the first seed."""
    best_pole: float
    left_after_memory_pct: float
    time_constant_min: float
    validation_record: Record
    validation: Validation
    """Of the first seed's Laguerre model."""
    laguerre_residuals: Floats
    """(seeds,) sum of residuals of the Laguerre models."""
    least_squares_residuals: Floats
    """(seeds,) of the models that were not smoothed."""
    first_order: FirstOrderModel
    """What IMC is designed on."""


@dataclass(frozen=True)
class Study:
    """Everything measured at one operating point."""

    operating_point: str
    patient: SorensenPatient
    seeds: int
    model: ModelStudy
    without_noise: dict[str, Loops]
    """Table I and Fig. 5, by controller."""
    with_noise: dict[tuple[str, str], Loops]
    """Table II, Fig. 4 and 6, by controller and dead time; "10M" is a known one of 10 min."""
    identified_anew: dict[str, Loops]
    """Linear MPC with known dead times, its models identified from delayed records."""
    tuning: dict[str, TuningSurface]
    """Searches about the printed tunings, by controller; empty if none was made."""


@dataclass(frozen=True)
class _Keys:
    """Random keys of the seeds: records and loops draw from different ones."""

    records: jax.Array
    loops: jax.Array

    @classmethod
    def of(cls, seed: int, seeds: int) -> _Keys:
        records, loops = jax.random.split(jax.random.key(seed))
        return cls(records=jax.random.split(records, seeds), loops=jax.random.split(loops, seeds))


def _sensor(dead_time_min: int) -> Sensor:
    noisy = white_noise(NOISE_VARIANCE)
    return dead_time(dead_time_min // SAMPLE_TIME_MIN, noisy) if dead_time_min else noisy


def _stack(controllers: Sequence[Controller]) -> Controller:
    """Controllers of one kind as one, whose arrays have a leading axis."""
    stacked: Controller = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *controllers)
    return stacked


def _noisy_loops(
    person: SorensenPatient, controllers: Controller | Sequence[Controller], dead_time_min: int, keys: jax.Array
) -> Loops:
    """One run a key, each with its own controller if there are several."""
    sensor = _sensor(dead_time_min)

    def run(controller: Controller, key: jax.Array) -> tuple[Metrics, Trace]:
        trace = simulate(person, controller, sensor, key=key)
        return summarise(trace), trace

    if isinstance(controllers, Sequence):
        metrics, traces = jax.vmap(run)(_stack(controllers), keys)
    else:
        metrics, traces = jax.vmap(run, in_axes=(None, 0))(controllers, keys)
    return Loops(metrics=metrics, example=jax.tree.map(lambda leaf: leaf[0], traces))


def _study_model(person: SorensenPatient, records: Sequence[Identification]) -> ModelStudy:
    noise_free = identify(person)
    search = best_pole(noise_free.impulse_response, 2)
    smooth = noise_free.laguerre_coefficients @ laguerre_functions(noise_free.laguerre_pole, 2, 1000)
    memory = noise_free.model.memory
    left = 100.0 * (1.0 - float(jnp.sum(smooth[:memory]) / jnp.sum(smooth)))
    slow = fit_step(person, step_mU_min=_SMALL_STEP_MU_MIN, horizon_min=memory * SAMPLE_TIME_MIN, delay_min=None)

    def residuals(model: StepResponseModel) -> tuple[Record, Validation]:
        return validate_on(person, model, seed=_BINARY_SEQUENCE_SEED)

    record, validation = residuals(records[0].model)
    raw = [StepResponseModel.from_impulse_response(one.impulse_response, SAMPLE_TIME_MIN) for one in records]
    return ModelStudy(
        noise_free=noise_free,
        noisy=records[0],
        best_pole=float(search.pole),
        left_after_memory_pct=left,
        time_constant_min=float(slow.tau_min),
        validation_record=record,
        validation=validation,
        laguerre_residuals=np.array([float(residuals(one.model)[1].sum_absolute_residual_mg_dl) for one in records]),
        least_squares_residuals=np.array([float(residuals(one)[1].sum_absolute_residual_mg_dl) for one in raw]),
        first_order=fit_step(person, step_mU_min=IMC_STEP_MU_MIN, delay_min=IMC_DELAY_MIN),
    )


def _without_noise(person: SorensenPatient, operating_point: str, model: ModelStudy) -> dict[str, Loops]:
    tuning = PARKER_1999[operating_point, False]
    first_order = model.first_order
    controllers: dict[str, Controller] = {
        "mpc": design_linear_mpc(model.noise_free.model, tuning.mpc),
        "mpc-se": design_mpc_se(linear_model(person), tuning.process_noise(), tuning.mpc_se),
        "nlqdmc-se": design_nlqdmc_se(nonlinear_model(person), tuning.process_noise(), tuning.nlqdmc_se),
        "imc": design_imc(first_order.gain, first_order.tau_min, first_order.delay_min, filter_min=IMC_FILTER_MIN),
    }
    loops = {}
    for name, controller in controllers.items():
        trace = simulate(person, controller)
        loops[name] = Loops(metrics=jax.tree.map(lambda leaf: leaf[None], summarise(trace)), example=trace)
    return loops


def _searches(
    person: SorensenPatient, operating_point: str, model: ModelStudy, progress: Progress
) -> dict[str, TuningSurface]:
    surfaces = {}
    for name in ("mpc", "mpc-se", "nlqdmc-se"):
        surfaces[name] = paper_tuning_surface(person, operating_point, name, model=model.noise_free.model)
        progress(f"{operating_point}: tunings of {name} searched")
    return surfaces


def study(
    operating_point: str,
    *,
    seeds: int,
    seed: int,
    progress: Progress,
    dead_times_min: Sequence[int] = DEAD_TIMES_MIN,
    tunings: bool = True,
) -> Study:
    """Carry out every experiment at an operating point.

    Parameters
    ----------
    operating_point : str
    seeds : int
        Runs of each noisy experiment.
    seed : int
        Where the seeds come from.
    progress : callable
        Told what has just been done.
    dead_times_min : sequence of int
        Of Table II; 0 must be among them.
    tunings : bool
        Whether the tunings are searched.
    """
    person = patient(operating_point)
    keys = _Keys.of(seed, seeds)

    def records(dead_time_min: int) -> list[Identification]:
        found = [identify(person, _sensor(dead_time_min), key) for key in keys.records]
        progress(f"{operating_point}: {seeds} models identified, dead time {dead_time_min} min")
        return found

    identified = records(0)
    model = _study_model(person, identified)
    progress(f"{operating_point}: models validated")
    without_noise = _without_noise(person, operating_point, model)
    progress(f"{operating_point}: Table I")

    tuning = PARKER_1999[operating_point, True]
    linear, Q = linear_model(person), tuning.process_noise()
    with_noise, identified_anew = {}, {}
    for minutes in dead_times_min:
        samples = minutes // SAMPLE_TIME_MIN
        longer = dataclasses.replace(tuning.mpc, prediction_horizon=tuning.mpc.prediction_horizon + samples)
        unaware = [design_linear_mpc(one.model, tuning.mpc) for one in identified]
        with_noise["mpc", f"{minutes}"] = _noisy_loops(person, unaware, minutes, keys.loops)
        estimator = design_mpc_se(linear, Q, tuning.mpc_se)
        with_noise["mpc-se", f"{minutes}"] = _noisy_loops(person, estimator, minutes, keys.loops)
        if minutes:
            told = [design_linear_mpc(one.model.delayed(samples), longer) for one in identified]
            with_noise["mpc", f"{minutes}M"] = _noisy_loops(person, told, minutes, keys.loops)
            estimator = design_mpc_se(linear, Q, tuning.mpc_se, dead_time_samples=samples)
            with_noise["mpc-se", f"{minutes}M"] = _noisy_loops(person, estimator, minutes, keys.loops)
            anew = [design_linear_mpc(one.model, longer) for one in records(minutes)]
            identified_anew[f"{minutes}M"] = _noisy_loops(person, anew, minutes, keys.loops)
        progress(f"{operating_point}: Table II, dead time {minutes} min")
    return Study(
        operating_point=operating_point,
        patient=person,
        seeds=seeds,
        model=model,
        without_noise=without_noise,
        with_noise=with_noise,
        identified_anew=identified_anew,
        tuning=_searches(person, operating_point, model, progress) if tunings else {},
    )
