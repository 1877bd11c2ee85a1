"""The loops of every controller in every situation, with the same sensor keys and the same people for all."""

from __future__ import annotations

import functools
from collections.abc import Collection, Iterator, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.bounds import OptimalDoses, bound_of_situation
from glucoloop.build.assemble import close_loop
from glucoloop.build.designs import controller_of, identified_model
from glucoloop.build.surroundings import Surroundings, pump_of
from glucoloop.control import Controller
from glucoloop.meals import Meal, Scenario
from glucoloop.meals.lehmann_deutsch import LehmannDeutsch
from glucoloop.metrics import Metrics, summarise
from glucoloop.models.step_response import StepResponseModel
from glucoloop.sensors import Sensor, dead_time
from glucoloop.sensors.noise import WhiteNoise
from glucoloop.simulation import Trace
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.situations.run import Run
from glucoloop.situations.situation import Situation, configured
from glucoloop.studies.bound.study import bound_of_run
from glucoloop.trials import engine
from glucoloop.trials.people import in_blocks
from glucoloop.trials.trial import Trial
from glucoloop.tuning.oscillation import Oscillation, oscillation
from glucoloop.tuning.search import stack
from meal_aware.measures import Runs, numbers_by_minute
from meal_aware.mismatched_loops import MismatchedLoops, designer
from meal_aware.situations import (
    CONTROLLERS,
    HORIZON_MIN,
    OURS,
    SITUATIONS,
    Extent,
    Meals,
    Mismatch,
    NamedSituation,
)

_MAX_TOGETHER: Final = 50


def close_loops(
    extent: Extent,
    situations: Sequence[NamedSituation],
    mismatches: Sequence[Mismatch] = (),
    *,
    controllers: Sequence[str] = CONTROLLERS,
    done: Collection[tuple[str, str]] = (),
) -> Iterator[tuple[str, str, Runs]]:
    """Simulate the loops of the comparison: the names of situation and controller, and their runs, one by one.

    Parameters
    ----------
    extent : Extent
    situations : sequence of NamedSituation
    mismatches : sequence of Mismatch
        Situations in which the controller's model is wrong.
    controllers : sequence of str
        Names of controllers, each with its defaults for the situation.
    done : collection
        Names of situations and controllers whose loops are not simulated again.
    """
    models = _Models()
    for situation in situations:
        for name in controllers:
            if (situation.name, name) not in done:
                people = situation.runs == "people"
                runs = _of_people(situation, name, extent) if people else _of_seeds(situation, name, extent, models)
                yield situation.name, name, runs
    for guarded in (False, True):
        loops: dict[tuple[str, ...], MismatchedLoops] = {}
        for name in controllers:
            rows = [row for row in mismatches if row.guarded is guarded and (row.name, name) not in done]
            key = tuple(row.name for row in rows)
            if rows and key not in loops:
                loops[key] = MismatchedLoops(rows, [row.runs_of(extent) for row in rows], extent.seed)
            if rows:
                for situation_name, runs in loops[key].run(designer(name)).items():
                    yield situation_name, name, runs


class _Models:
    """Step responses identified from the record of a seed, as ``glucoloop run`` does; situations share them."""

    def __init__(self) -> None:
        self._found: dict[tuple[int, float], StepResponseModel] = {}

    def controller(self, run: Run) -> Controller:
        """The controller that ``glucoloop run`` designs."""
        case = run.case
        if not case.controller.uses_model:
            return controller_of(run, case)
        key = run.seed, case.identified.noise_variance or 0.0
        if key not in self._found:
            self._found[key] = identified_model(run, case, run.nominal).model
        return controller_of(run, case, model=self._found[key])


def _surroundings(made: Situation, variance: jax.Array) -> Surroundings:
    """Sensor and pump without faults; a variance of 0 adds no noise, so that one program serves both cases."""
    sensor: Sensor = WhiteNoise(bound_mg_dl=made.noise_bound_mg_dl).replaced(variance=variance)
    if made.dead_time_samples:
        sensor = dead_time(made.dead_time_samples, sensor)
    return Surroundings(sensor=sensor, pump=pump_of(made))


def _together(extent: Extent) -> int:
    """Number of runs that are simulated together; it is compiled in, so it is the same in every situation."""
    runs = extent.seeds + 1  # one without noise
    blocks = -(-runs // _MAX_TOGETHER)
    return -(-runs // blocks)


def _of_seeds(situation: NamedSituation, name: str, extent: Extent, models: _Models) -> Runs:
    """One run per seed, equal to that of ``glucoloop run`` with the seed."""
    seeds = np.asarray(extent.sensor_seeds if situation.runs == "seeds" else [extent.seed])
    runs = [configured(Run, situation.run_of(name, int(seed))) for seed in seeds]
    made, scenario = runs[0], runs[0].as_scenario()
    controllers = [models.controller(run) for run in (runs if made.case.controller.uses_model else runs[:1])]
    stacked = stack(controllers)
    variance, drawn = np.full(seeds.size, made.noise_variance), seeds.astype(np.uint32)
    if situation.oscillation:  # one more run, of the first controller without noise
        variance, drawn = np.append(variance, 0.0), np.append(drawn, drawn[0])

    def run(controller: Controller, variance: jax.Array, key: jax.Array) -> tuple[Metrics, Oscillation, Trace]:
        trace = close_loop(made, controller, scenario, surroundings=_surroundings(made, variance), key=key)
        return summarise(trace, made.limits), oscillation(trace), trace

    def block(places: npt.NDArray[np.intp], asked: int) -> Any:
        keys = jax.vmap(jax.random.key)(jnp.asarray(drawn[places]))
        which = np.where(places < len(controllers), places, 0)
        of_each = jax.tree.map(lambda leaf: leaf[which], stacked)
        metrics, turning, trace = jax.vmap(run)(of_each, jnp.asarray(variance[places]), keys)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[:asked], (metrics, turning, trace.fine_glucose_mg_dl))

    parts = in_blocks(block, np.arange(drawn.size), _together(extent), threads=1)
    metrics, turning, glucose = jax.tree.map(lambda *blocks: np.concatenate(blocks), *parts)
    noisy = slice(seeds.size)
    found = {name: np.asarray(values, float)[noisy] for name, values in metrics.by_name().items()}
    fine_t_min = sample_grid(scenario.horizon_min, made.sample_time_min).fine_t_min
    numbers = numbers_by_minute(found, fine_t_min, glucose[noisy].T, made.target_mg_dl)
    if situation.oscillation:
        numbers |= {f"quiet_{what}": np.asarray(getattr(turning, what)[-1:], float) for what in ("crossings", "turns")}
    return Runs(run=seeds.astype(np.int64), numbers=numbers)


def _of_people(situation: NamedSituation, name: str, extent: Extent) -> Runs:
    """One run per person, equal to that of ``glucoloop trial`` with the seed."""
    trial = configured(Trial, situation.trial_of(name, extent.seed, extent.people))
    prepared = engine.prepare(trial)
    result = engine.run_people(prepared, name, np.arange(extent.people), traces=True)
    found = {key: np.asarray(values, float)[result.feasible] for key, values in result.metrics.items()}
    glucose = np.asarray(result.glucose_mg_dl, float)[:, result.feasible]
    t_min = np.append(prepared.trial.grid.t_min, trial.plan.horizon_min)
    return Runs(
        run=result.person[result.feasible],
        numbers=numbers_by_minute(found, t_min, glucose, prepared.trial.target_mg_dl),
        infeasible=int((~result.feasible).sum()),
    )


def bound_of(row: NamedSituation | Mismatch) -> OptimalDoses | None:
    """Best possible doses in a situation; None for people, who would each need their own.

    Faults of the sensor, noise and the guard make no plan possible that was not before, so they do not count.
    """
    if isinstance(row, NamedSituation):
        return bound_of_run(configured(Run, row.run_of(OURS, 0))) if row.bounded else None
    if row.people != "nominal" or row.late or row.blocked or row.flat_battery:
        return None
    return _best_doses(row.setpoint_mg_dl, row.meals, tuple(row.stomach.items()))


@functools.cache
def _best_doses(setpoint_mg_dl: float, meals: Meals, stomach: tuple[tuple[str, float], ...]) -> OptimalDoses:
    scenario = Scenario(
        [Meal(t_min=t_min, carbs_g=carbs_g, eating_min=eating_min) for carbs_g, t_min, eating_min in meals],
        horizon_min=HORIZON_MIN,
        setpoint_mg_dl=setpoint_mg_dl,
        initial_glucose_mg_dl=setpoint_mg_dl,
        meal_model=LehmannDeutsch(**dict(stomach)),
    )
    made = configured(Run, SITUATIONS[0].run_of(OURS, 0))
    return bound_of_situation(made.nominal, scenario, made.limits)
