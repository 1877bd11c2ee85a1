"""The experiments of the paper, at one operating point."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.control import Controller, design_imc, design_linear_mpc, design_mpc_se, design_nlqdmc_se
from glucoloop.control.parker1999 import IMC_DELAY_MIN, IMC_FILTER_MIN, IMC_STEP_MU_MIN, PARKER_1999
from glucoloop.experiments.assemble import close_loop
from glucoloop.experiments.surroundings import sensor_of, surroundings_of
from glucoloop.identification import FirstOrderModel, Identification, Record, Validation, best_pole, laguerre_functions
from glucoloop.meals import Scenario
from glucoloop.metrics import Metrics, summarise
from glucoloop.models.step_response import StepResponseModel
from glucoloop.parts.sensors import DeadTimeSettings, WhiteNoiseSettings
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.capabilities import process_noise
from glucoloop.simulation import Trace, fit_step, identify, linear_model, nonlinear_model, validate_on
from glucoloop.situations.situation import Situation, usual_situation
from glucoloop.tuning.paper import paper_tuning_surface
from glucoloop.tuning.search import stack
from glucoloop.tuning.surface import TuningSurface

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]

SAMPLE_TIME_MIN: Final = 5
NOISE_VARIANCE: Final = 1.45
DEAD_TIMES_MIN: Final = (0, 5, 10, 15)
_SMALL_STEP_MU_MIN: Final = 0.01
_BINARY_SEQUENCE_SEED: Final = 0


NoisyRun = tuple[str, str]
"""A row of Table II: a controller and its dead time in minutes, "10M" for one of 10 min that the controller knows."""


def noisy_runs(dead_times_min: Sequence[int] = DEAD_TIMES_MIN) -> frozenset[NoisyRun]:
    """The rows of Table II with these dead times."""
    times = [f"{minutes}{known}" for minutes in dead_times_min for known in ("", "M") if minutes or not known]
    return frozenset((name, time) for name in ("mpc", "mpc-se") for time in times)


def _dead_time_min(run: NoisyRun) -> int:
    return int(run[1].removesuffix("M"))


Experiment = str | NoisyRun
"""``"model"``, Section III, identification and its validation; ``"without-noise"``, Table I and Fig. 5; ``"tunings"``,
searches around the printed tunings; or a row of Table II, of which Fig. 4 and 6 show some.
"""


def of_paper(dead_times_min: Sequence[int] = DEAD_TIMES_MIN, *, tunings: bool = True) -> frozenset[Experiment]:
    """All experiments, with the given dead times in Table II."""
    return frozenset({"model", "without-noise", *(["tunings"] if tunings else []), *noisy_runs(dead_times_min)})


@dataclass(frozen=True)
class SeededRuns:
    """Runs of one controller under several seeds."""

    metrics: Metrics
    """Metrics of the runs, each field `(seeds,)`."""
    example: Trace
    """Trace of the first seed."""


@dataclass(frozen=True)
class ModelResults:
    """Results of identification, Section III."""

    noise_free: Identification
    noisy: Identification
    """Model identified from the noisy record of the first seed."""
    best_pole: float
    left_after_memory_pct: float
    time_constant_min: float
    validation_record: Record
    validation: Validation
    """Validation of the first seed's Laguerre model."""
    laguerre_residuals: Floats
    """(seeds,) sum of residuals of the Laguerre models."""
    least_squares_residuals: Floats
    """(seeds,) sum of residuals of the models that were not smoothed."""


@dataclass(frozen=True)
class PointResults:
    """All results at one operating point; experiments that were not carried out are empty."""

    operating_point: str
    patient: SemilinearPatient
    seeds: int
    model: ModelResults | None
    without_noise: dict[str, SeededRuns]
    """Table I and Fig. 5, by controller."""
    with_noise: dict[NoisyRun, SeededRuns]
    """Table II, Fig. 4 and 6, by controller and dead time."""
    identified_anew: dict[str, SeededRuns]
    """Linear MPC with known dead times, its models identified from delayed records."""
    tuning: dict[str, TuningSurface]
    """Searches around the printed tunings, by controller; empty if none was made."""


@dataclass(frozen=True)
class _Keys:
    """Random keys of the seeds: records and loops draw from different ones."""

    records: jax.Array
    loops: jax.Array

    @classmethod
    def of(cls, seed: int, seeds: int) -> _Keys:
        records, loops = jax.random.split(jax.random.key(seed))
        return cls(records=jax.random.split(records, seeds), loops=jax.random.split(loops, seeds))


def _noisy(situation: Situation, dead_time_min: int) -> Situation:
    """The situation with the paper's noise, and a dead time."""
    late = (DeadTimeSettings(minutes=dead_time_min),) if dead_time_min else ()
    return dataclasses.replace(situation, sensor=(WhiteNoiseSettings(variance=NOISE_VARIANCE), *late))


def _noisy_loops(situation: Situation, controllers: Controller | Sequence[Controller], keys: jax.Array) -> SeededRuns:
    """One run per key, each with its own controller if there are several."""
    around = surroundings_of(situation)

    def run(controller: Controller, key: jax.Array) -> tuple[Metrics, Trace]:
        trace = close_loop(situation, controller, Scenario(), around=around, key=key)
        return summarise(trace), trace

    if isinstance(controllers, Sequence):
        metrics, traces = jax.vmap(run)(stack(controllers), keys)
    else:
        metrics, traces = jax.vmap(run, in_axes=(None, 0))(controllers, keys)
    return SeededRuns(metrics=metrics, example=jax.tree.map(lambda leaf: leaf[0], traces))


def _study_model(
    person: SemilinearPatient, noise_free: Identification, records: Sequence[Identification]
) -> ModelResults:
    search = best_pole(noise_free.impulse_response, 2)
    smooth = noise_free.laguerre_coefficients @ laguerre_functions(noise_free.laguerre_pole, 2, 1000)
    memory = noise_free.model.memory
    left = 100.0 * (1.0 - float(jnp.sum(smooth[:memory]) / jnp.sum(smooth)))
    slow = fit_step(person, step_mU_min=_SMALL_STEP_MU_MIN, horizon_min=memory * SAMPLE_TIME_MIN, delay_min=None)

    def residuals(model: StepResponseModel) -> tuple[Record, Validation]:
        return validate_on(person, model, seed=_BINARY_SEQUENCE_SEED)

    record, validation = residuals(records[0].model)
    raw = [StepResponseModel.from_impulse_response(one.impulse_response, SAMPLE_TIME_MIN) for one in records]
    return ModelResults(
        noise_free=noise_free,
        noisy=records[0],
        best_pole=float(search.pole),
        left_after_memory_pct=left,
        time_constant_min=float(slow.tau_min),
        validation_record=record,
        validation=validation,
        laguerre_residuals=np.array([float(residuals(one.model)[1].sum_absolute_residual_mg_dl) for one in records]),
        least_squares_residuals=np.array([float(residuals(one)[1].sum_absolute_residual_mg_dl) for one in raw]),
    )


def _without_noise(situation: Situation, operating_point: str, noise_free: Identification) -> dict[str, SeededRuns]:
    person, tuning = situation.nominal, PARKER_1999[operating_point, False]
    first_order: FirstOrderModel = fit_step(person, step_mU_min=IMC_STEP_MU_MIN, delay_min=IMC_DELAY_MIN)
    controllers: dict[str, Controller] = {
        "mpc": design_linear_mpc(noise_free.model, tuning.mpc),
        "mpc-se": design_mpc_se(linear_model(person), process_noise(person, *tuning.noise), tuning.mpc_se),
        "nlqdmc-se": design_nlqdmc_se(nonlinear_model(person), process_noise(person, *tuning.noise), tuning.nlqdmc_se),
        "imc": design_imc(first_order.gain, first_order.tau_min, first_order.delay_min, filter_min=IMC_FILTER_MIN),
    }
    loops = {}
    for name, controller in controllers.items():
        trace = close_loop(situation, controller, Scenario())
        loops[name] = SeededRuns(metrics=jax.tree.map(lambda leaf: leaf[None], summarise(trace)), example=trace)
    return loops


def _searches(operating_point: str, noise_free: Identification, progress: Progress) -> dict[str, TuningSurface]:
    surfaces = {}
    for name in ("mpc", "mpc-se", "nlqdmc-se"):
        surfaces[name] = paper_tuning_surface(operating_point, name, model=noise_free.model)
        progress(f"{operating_point}: tunings of {name} searched")
    return surfaces


def study(
    operating_point: str,
    experiments: frozenset[Experiment] | None = None,
    *,
    seeds: int,
    seed: int,
    progress: Progress,
) -> PointResults:
    """Carry out experiments at an operating point.

    Parameters
    ----------
    operating_point : str
    experiments : frozenset, optional
        All of the paper by default. A run is the same, whatever is carried out beside it.
    seeds : int
        Runs of each noisy experiment.
    seed : int
        Seed from which the seeds of the runs are derived.
    progress : callable
        Called with the name of the step that has just been done.
    """
    wanted = of_paper() if experiments is None else experiments
    noisy_wanted = {run for run in wanted if isinstance(run, tuple)}
    situation = usual_situation(operating_point=operating_point)
    person = situation.nominal
    keys = _Keys.of(seed, seeds)

    def records(dead_time_min: int) -> list[Identification]:
        found = [identify(person, sensor_of(_noisy(situation, dead_time_min)), key) for key in keys.records]
        progress(f"{operating_point}: {seeds} models identified, dead time {dead_time_min} min")
        return found

    @functools.cache
    def noise_free() -> Identification:
        return identify(person)

    of_records = "model" in wanted or any(name == "mpc" for name, _ in noisy_wanted)
    identified = records(0) if of_records else []
    model = None
    if "model" in wanted:
        model = _study_model(person, noise_free(), identified)
        progress(f"{operating_point}: models validated")
    without_noise: dict[str, SeededRuns] = {}
    if "without-noise" in wanted:
        without_noise = _without_noise(situation, operating_point, noise_free())
        progress(f"{operating_point}: Table I")

    tuning = PARKER_1999[operating_point, True]
    linear, Q = linear_model(person), process_noise(person, *tuning.noise)
    with_noise: dict[NoisyRun, SeededRuns] = {}
    identified_anew: dict[str, SeededRuns] = {}
    for minutes in sorted({_dead_time_min(run) for run in noisy_wanted}):
        late, samples = _noisy(situation, minutes), minutes // SAMPLE_TIME_MIN
        longer = dataclasses.replace(tuning.mpc, prediction_horizon=tuning.mpc.prediction_horizon + samples)
        for name, time in sorted(run for run in noisy_wanted if _dead_time_min(run) == minutes):
            known = time.endswith("M")
            controllers: Controller | list[Controller]
            if name == "mpc-se":
                controllers = design_mpc_se(linear, Q, tuning.mpc_se, dead_time_samples=samples if known else 0)
            elif known:
                controllers = [design_linear_mpc(one.model.delayed(samples), longer) for one in identified]
                anew = [design_linear_mpc(one.model, longer) for one in records(minutes)]
                identified_anew[time] = _noisy_loops(late, anew, keys.loops)
            else:
                controllers = [design_linear_mpc(one.model, tuning.mpc) for one in identified]
            with_noise[name, time] = _noisy_loops(late, controllers, keys.loops)
        progress(f"{operating_point}: runs with noise, dead time {minutes} min")
    return PointResults(
        operating_point=operating_point,
        patient=person,
        seeds=seeds,
        model=model,
        without_noise=without_noise,
        with_noise=with_noise,
        identified_anew=identified_anew,
        tuning=_searches(operating_point, noise_free(), progress) if "tunings" in wanted else {},
    )
