"""The experiments of the paper, at one operating point."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, Final, cast

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import sensor_of, surroundings_of
from glucoloop.component.request import Request
from glucoloop.control import Controller
from glucoloop.identification import Identification, Record, Validation, best_pole, laguerre_functions
from glucoloop.meals import Scenario
from glucoloop.metrics import Metrics, summarise
from glucoloop.models.step_response import StepResponseModel
from glucoloop.patients import SemilinearPatient
from glucoloop.pumps import PARKER_1999_LIMITS
from glucoloop.reproduction.parker1999 import PAPER_CONTROLLERS
from glucoloop.sensors import DeadTime, WhiteNoise, white_noise
from glucoloop.simulation import Trace, fit_step, identify, validate_on
from glucoloop.situations.case import Case, completed_case, default_case
from glucoloop.situations.situation import Situation, default_situation
from glucoloop.tuning.search import paper_tuning_surface, stack
from glucoloop.tuning.surface import TuningSurface

Progress = Callable[[str], None]

SAMPLE_TIME_MIN: Final = 5
NOISE_VARIANCE: Final = 1.45
DEAD_TIMES_MIN: Final = (0, 5, 10, 15)
_SMALL_STEP_MU_MIN: Final = 0.01
_BINARY_SEQUENCE_SEED: Final = 0
_NOISE_DRAWS: Final = 200_000

NOISE_FREE: Final = "noise-free"
LoopRuns = tuple[str, str]
"""Controller and situation: ``"noise-free"``, or with noise a dead time in min, ``"10M"`` where it is known."""
Experiment = str | LoopRuns
"""``"model"``, Section III, identification and its validation; ``"noise-free"``, Table I and Fig. 5; ``"tunings"``,
searches around the printed tunings; or a row of Table II, of which Fig. 4 and 6 show some.
"""


def noisy_runs(dead_times_min: Sequence[int] = DEAD_TIMES_MIN) -> frozenset[LoopRuns]:
    """The rows of Table II with these dead times."""
    times = [f"{minutes}{known}" for minutes in dead_times_min for known in ("", "M") if minutes or not known]
    return frozenset((name, time) for name in ("mpc", "mpc-se") for time in times)


def all_experiments(dead_times_min: Sequence[int] = DEAD_TIMES_MIN, *, tunings: bool = True) -> frozenset[Experiment]:
    """All experiments of the paper, with the given dead times in Table II."""
    return frozenset({"model", NOISE_FREE, *(["tunings"] if tunings else []), *noisy_runs(dead_times_min)})


@dataclass(frozen=True)
class _SeededRuns:
    """Runs of one controller under several seeds."""

    metrics: Metrics
    """Metrics of the runs, each field `(seeds,)`."""
    example: Trace
    """Trace of the first seed."""


@dataclass(frozen=True)
class _ModelResults:
    """Results of identification, Section III."""

    noise_free: Identification
    noisy: Identification
    """Model identified from the noisy record of the first seed."""
    validation_record: Record
    validation: Validation
    """Validation of the first seed's Laguerre model."""
    numbers: Mapping[str, Any]
    """Numbers, or arrays over the seeds, by the names with which entries call them."""


@dataclass(frozen=True)
class PointResults:
    """All results at one operating point; experiments that were not carried out are empty."""

    operating_point: str
    patient: SemilinearPatient
    seeds: int
    model: _ModelResults | None
    runs: dict[LoopRuns, _SeededRuns]
    """Tables I and II, Fig. 4 to 6."""
    identified_anew: dict[str, _SeededRuns]
    """Linear MPC with known dead times, its models identified from delayed records."""
    tuning: dict[str, TuningSurface]
    """Searches around the printed tunings, by controller; empty if none was made."""


def _noisy(situation: Situation, dead_time_min: int) -> Situation:
    """The situation with the paper's noise, and a dead time."""
    late = (DeadTime(minutes=dead_time_min),) if dead_time_min else ()
    return dataclasses.replace(situation, sensor=(WhiteNoise(variance=NOISE_VARIANCE), *late))


def _noisy_loops(situation: Situation, controllers: Controller | Sequence[Controller], keys: jax.Array) -> _SeededRuns:
    """One run per key, each with its own controller if there are several."""
    surroundings = surroundings_of(situation)

    def run(controller: Controller, key: jax.Array) -> tuple[Metrics, Trace]:
        trace = close_loop(situation, controller, Scenario(), surroundings=surroundings, key=key)
        return summarise(trace), trace

    if isinstance(controllers, Sequence):
        metrics, traces = jax.vmap(run)(stack(controllers), keys)
    else:
        metrics, traces = jax.vmap(run, in_axes=(None, 0))(controllers, keys)
    return _SeededRuns(metrics=metrics, example=jax.tree.map(lambda leaf: leaf[0], traces))


def _study_model(
    person: SemilinearPatient, noise_free: Identification, records: Sequence[Identification]
) -> _ModelResults:
    smooth = noise_free.laguerre_coefficients @ laguerre_functions(noise_free.laguerre_pole, 2, 1000)
    memory = noise_free.model.memory
    slow = fit_step(person, step_mU_min=_SMALL_STEP_MU_MIN, horizon_min=memory * SAMPLE_TIME_MIN, delay_min=None)

    def residuals(models: Iterable[StepResponseModel]) -> npt.NDArray[np.float64]:
        validations = (validate_on(person, model, seed=_BINARY_SEQUENCE_SEED)[1] for model in models)
        return np.array([float(one.sum_absolute_residual_mg_dl) for one in validations])

    reading = white_noise(NOISE_VARIANCE)
    keys = jax.random.split(jax.random.key(0), _NOISE_DRAWS)
    noise = jax.vmap(lambda key: reading.read((), jnp.zeros(()), key)[1].glucose_mg_dl)(keys)
    most = person.driven_derivative(jnp.zeros(7), jnp.asarray(PARKER_1999_LIMITS.max_mU_min))
    transport = jax.jacfwd(lambda z: person.driven_derivative(z, jnp.zeros(())))(jnp.zeros(7))
    record, validation = validate_on(person, records[0].model, seed=_BINARY_SEQUENCE_SEED)
    return _ModelResults(
        noise_free=noise_free,
        noisy=records[0],
        validation_record=record,
        validation=validation,
        numbers={
            "basal_insulin_mU_min": person.basal_insulin_mU_min,
            "setpoint_mg_dl": person.setpoint_mg_dl,
            "time_constant_min": slow.tau_min,
            "left_after_memory_pct": 100.0 * (1.0 - float(jnp.sum(smooth[:memory]) / jnp.sum(smooth))),
            "best_pole": best_pole(noise_free.impulse_response, 2).pole,
            "laguerre_residuals_mg_dl": residuals(one.model for one in records),
            "least_squares_residuals_mg_dl": residuals(
                StepResponseModel.from_impulse_response(one.impulse_response, SAMPLE_TIME_MIN) for one in records
            ),
            "noise_variance": jnp.var(noise),
            "arterial_insulin_mU_l": -jnp.linalg.solve(transport, most)[1],
        },
    )


def _noise_free_runs(
    situation: Situation, noise_free: Identification, own: Mapping[str, Request[Case]]
) -> dict[str, _SeededRuns]:
    results = {}
    cases = {name: default_case(name, situation) for name in PAPER_CONTROLLERS}
    for name, case in {**cases, **{label: completed_case(case, situation) for label, case in own.items()}}.items():
        controller = controller_of(situation, case, model=noise_free.model)
        trace = close_loop(situation, controller, Scenario())
        results[name] = _SeededRuns(metrics=jax.tree.map(lambda leaf: leaf[None], summarise(trace)), example=trace)
    return results


def study(
    operating_point: str,
    experiments: Set[Experiment],
    *,
    seeds: int,
    seed: int,
    progress: Progress,
    own: Mapping[str, Request[Case]] | None = None,
) -> PointResults:
    """Carry out experiments at an operating point, noisy ones in `seeds` runs, whose seeds are derived from `seed`.

    Controllers of one's `own`, by label, are tried in the situations of Tables I and II that are among the
    experiments, those with a model on the models of linear MPC. A run is the same, whatever is carried out beside it;
    `progress` is called with the name of each step that is done.
    """
    noisy = {run for run in experiments if isinstance(run, tuple)}
    situation = default_situation(operating_point=operating_point)
    person = cast(SemilinearPatient, situation.nominal)
    # Records and loops draw from different keys.
    record_keys, loop_keys = (jax.random.split(key, seeds) for key in jax.random.split(jax.random.key(seed)))

    def records(dead_time_min: int) -> list[Identification]:
        results = [identify(person, sensor_of(_noisy(situation, dead_time_min)), key) for key in record_keys]
        progress(f"{operating_point}: {seeds} models identified, dead time {dead_time_min} min")
        return results

    @functools.cache
    def noise_free() -> Identification:
        return identify(person)

    own = own or {}
    modelled = {label for label, case in own.items() if case.value("controller").component.uses_model}
    identified = records(0) if "model" in experiments or any(name == "mpc" or modelled for name, _ in noisy) else []
    model = None
    if "model" in experiments:
        model = _study_model(person, noise_free(), identified)
        progress(f"{operating_point}: models validated")
    runs: dict[LoopRuns, _SeededRuns] = {}
    if NOISE_FREE in experiments:
        for name, one in _noise_free_runs(situation, noise_free(), own).items():
            runs[name, NOISE_FREE] = one
        progress(f"{operating_point}: Table I")

    identified_anew: dict[str, _SeededRuns] = {}
    for minutes in sorted({_dead_time_min(run) for run in noisy}):
        late = _noisy(situation, minutes)
        for name, time in sorted(run for run in noisy if _dead_time_min(run) == minutes):
            compensated = time.endswith("M")
            case = dataclasses.replace(default_case(name, late), known_dead_time=compensated)
            if name == "mpc-se":
                runs[name, time] = _noisy_loops(late, controller_of(late, case), loop_keys)
                continue
            controllers = [controller_of(late, case, model=one.model) for one in identified]
            runs[name, time] = _noisy_loops(late, controllers, loop_keys)
            if compensated:
                anew = [controller_of(late, case, model=one.model, model_is_late=True) for one in records(minutes)]
                identified_anew[time] = _noisy_loops(late, anew, loop_keys)
        for label, request in own.items():
            complete = completed_case(request, late)
            models = [one.model for one in identified] if label in modelled else [None]
            controllers = [controller_of(late, complete, model=model) for model in models]
            several = controllers if label in modelled else controllers[0]
            runs[label, f"{minutes}"] = _noisy_loops(late, several, loop_keys)
        progress(f"{operating_point}: runs with noise, dead time {minutes} min")
    searched: dict[str, TuningSurface] = {}
    for name in ("mpc", "mpc-se", "nlqdmc-se") if "tunings" in experiments else ():
        searched[name] = paper_tuning_surface(operating_point, name, model=noise_free().model)
        progress(f"{operating_point}: tunings of {name} searched")
    return PointResults(operating_point, person, seeds, model, runs, identified_anew, searched)


def _dead_time_min(run: LoopRuns) -> int:
    return int(run[1].removesuffix("M"))
