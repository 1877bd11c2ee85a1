"""The loops of every controller in every situation, with the same sensor keys and the same people for all."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.bounds import OptimalDoses, bound_of_situation
from glucoloop.cohorts import engine
from glucoloop.cohorts.blocks import block_size, in_blocks
from glucoloop.config.run import Run, read_run
from glucoloop.config.trial import read_trial
from glucoloop.control import Controller, Observation
from glucoloop.control.catalogue import controller_entry
from glucoloop.experiments import situation as experiments
from glucoloop.experiments.assemble import close_loop
from glucoloop.experiments.designs import controller_of, identified_model
from glucoloop.experiments.surroundings import Surroundings, pump_of
from glucoloop.meals import Scenario
from glucoloop.metrics import Metrics, summarise
from glucoloop.models.step_response import StepResponseModel
from glucoloop.papers.meal_aware.claims import Runs
from glucoloop.papers.meal_aware.measures import Floats, numbers_of
from glucoloop.papers.meal_aware.mismatched_loops import MismatchedLoops, MismatchRuns, bounds_of_mismatches, designer
from glucoloop.papers.meal_aware.mismatches import Mismatch
from glucoloop.papers.meal_aware.options import ClaimsKeys
from glucoloop.papers.meal_aware.situations import CONTROLLERS, OURS, SITUATIONS, NamedSituation
from glucoloop.sensors import IdealSensor, Sensor, dead_time
from glucoloop.sensors.white_noise import WhiteNoise
from glucoloop.simulation import Trace
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.tuning.oscillation import Oscillation, oscillation

Progress = Callable[[int], None]
Case = tuple[str, str]
"""A situation and a controller, by their names."""

_MOST_TOGETHER: Final = 50  # few enough that Ctrl-C is heeded soon
_STEPS_TIMED: Final = 200


@dataclass(frozen=True)
class ControllerRuns:
    """Runs of one controller in one situation; runs are the trailing axis."""

    run: npt.NDArray[np.int64]
    """(runs,) seeds of the sensor, or numbers of people."""
    numbers: Mapping[str, Floats]
    """(runs,) values of each measure, by its name."""
    t_min: Floats
    """(points,) times of glucose."""
    glucose_mg_dl: Floats
    """(points, runs) glucose free of noise."""
    insulin_t_min: Floats
    """(samples,) times from which each rate is delivered."""
    insulin_mU_min: Floats
    """(samples, runs) rates delivered from each sample to the next."""
    setpoint_mg_dl: float
    infeasible: int = 0
    """Number of people without a basal rate for the setpoint, who are not among the runs."""
    quiet: Oscillation | None = None
    """Oscillation of the same controller without noise, where it is evaluated."""


@dataclass(frozen=True)
class ComparisonRuns:
    """All runs of the comparison."""

    asked: ClaimsKeys
    loops: Mapping[str, Mapping[str, ControllerRuns]]
    """Loops by situation and controller."""
    situations: tuple[NamedSituation, ...]
    bounds: Mapping[str, OptimalDoses]
    """Best possible doses, by situation."""
    step_ms: Mapping[str, float]
    """Median time of one sample of one patient, by controller, as measured on this machine."""
    ours: str = OURS
    """The controller that the claims are about."""
    rows: tuple[Mismatch, ...] = ()
    """Situations in which the controller's model is wrong."""
    of_rows: Mapping[str, Mapping[str, MismatchRuns]] = field(default_factory=dict)
    """Runs by name of such a situation, and by controller."""

    @property
    def runs(self) -> Mapping[str, Mapping[str, Runs]]:
        """Runs of all situations by name, and by controller."""
        return {**self.loops, **self.of_rows}


def loops_to_close(
    asked: ClaimsKeys,
    situations: Sequence[NamedSituation],
    controllers: Sequence[str] = CONTROLLERS,
    rows: Sequence[Mismatch] = (),
) -> int:
    """Number of loops in a study."""
    of_each = {"one": 1, "seeds": asked.seeds, "people": asked.people}
    alone = sum(of_each[situation.runs] for situation in situations)
    return len(controllers) * (alone + sum(row.runs_of(asked) for row in rows))


def study(
    asked: ClaimsKeys,
    situations: Sequence[NamedSituation],
    *,
    progress: Progress,
    controllers: Sequence[str] = CONTROLLERS,
    ours: str = OURS,
    rows: Sequence[Mismatch] = (),
    timed: bool = True,
    kept: Mapping[Case, Any] | None = None,
    keep: Callable[[str, str, Any], None] = lambda situation, controller, runs: None,
) -> ComparisonRuns:
    """Simulate every loop of the comparison.

    Parameters
    ----------
    asked : ClaimsKeys
    situations : sequence of NamedSituation
    progress : callable
        Called with the number of loops that have just been simulated.
    controllers : sequence of str
        Names of controllers, each with its defaults for the situation.
    ours : str
        The controller among them that the claims are about.
    rows : sequence of Mismatch
        Situations in which the controller's model is wrong.
    timed : bool
        Whether one sample of one patient is timed.
    kept : mapping, optional
        Runs that are not simulated again, by situation and controller.
    keep : callable
        Called with the names of situation and controller, and their runs, as soon as they are simulated.
    """
    models, together, kept = _Models(), _together(asked), kept or {}
    loops: dict[str, dict[str, ControllerRuns]] = {}
    for situation in situations:
        loops[situation.name] = {}
        for name in controllers:
            of_case = kept.get((situation.name, name))
            if of_case is None:
                if situation.runs == "people":
                    of_case = _loops_of_people(situation, name, asked, progress)
                else:
                    seeds = asked.sensor_seeds if situation.runs == "seeds" else asked.sensor_seeds[:1]
                    of_case = _loops_of_seeds(situation, name, seeds, models, together, progress)
                keep(situation.name, name, of_case)
            loops[situation.name][name] = of_case
    of_rows = _mismatched(asked, rows, controllers, progress, kept, keep)
    bounds = _bounds([situation for situation in situations if situation.bounded])
    if asked.bounds:
        bounds |= bounds_of_mismatches(rows)
    return ComparisonRuns(
        asked=asked,
        loops=loops,
        situations=tuple(situations),
        bounds=bounds,
        step_ms={name: _time_of_step_ms(name, asked.seed, models) for name in controllers} if timed else {},
        ours=ours,
        rows=tuple(rows),
        of_rows=of_rows,
    )


def _mismatched(
    asked: ClaimsKeys,
    rows: Sequence[Mismatch],
    controllers: Sequence[str],
    progress: Progress,
    kept: Mapping[Case, Any],
    keep: Callable[[str, str, Any], None],
) -> dict[str, dict[str, MismatchRuns]]:
    """Runs of the situations in which the model is wrong, by name and controller."""
    found: dict[str, dict[str, MismatchRuns]] = {row.name: {} for row in rows}
    for guarded in (False, True):
        part = [row for row in rows if row.guarded is guarded]
        made: dict[tuple[str, ...], MismatchedLoops] = {}
        for controller in controllers:
            missing = [row for row in part if (row.name, controller) not in kept]
            for row in part:
                if row not in missing:
                    found[row.name][controller] = kept[row.name, controller]
            if missing:
                names = tuple(row.name for row in missing)
                if names not in made:
                    made[names] = MismatchedLoops(missing, [row.runs_of(asked) for row in missing], asked.seed)
                for name, runs in made[names].run(designer(controller), progress=progress).items():
                    found[name][controller] = runs
                    keep(name, controller, runs)
    return found


class _Models:
    """Step responses identified from the record of a seed, as ``glucoloop run`` does; situations share them."""

    def __init__(self) -> None:
        self._found: dict[tuple[int, float], StepResponseModel] = {}

    def controller(self, run: Run) -> Controller:
        """The controller that ``glucoloop run`` designs."""
        made, case = run.situation.situation(), run.case.case()
        if not controller_entry(case.controller).uses_model:
            return controller_of(made, case)
        key = made.seed, case.model_noise_variance or 0.0
        if key not in self._found:
            self._found[key] = identified_model(made, case, made.nominal).model
        return controller_of(made, case, model=self._found[key])


def _scenario(run: Run) -> Scenario:
    return run.situation.scenario()


def _around(made: experiments.Situation, variance: jax.Array) -> Surroundings:
    """Sensor and pump without faults; a variance of 0 adds no noise, so that one program serves both cases."""
    sensor: Sensor = WhiteNoise(inner=IdealSensor(), variance=variance, bound_mg_dl=made.noise_bound_mg_dl)
    if made.dead_time_samples:
        sensor = dead_time(made.dead_time_samples, sensor)
    return Surroundings(sensor=sensor, pump=pump_of(made))


def _together(asked: ClaimsKeys) -> int:
    """Number of runs that are simulated together; it is the same in every situation, since it is compiled in."""
    runs = asked.seeds + 1  # one without noise
    blocks = -(-runs // _MOST_TOGETHER)
    return -(-runs // blocks)


def _loops_of_seeds(
    situation: NamedSituation, name: str, seeds: Sequence[int], models: _Models, together: int, progress: Progress
) -> ControllerRuns:
    """One run per seed, equal to that of ``glucoloop run`` with the seed."""
    runs = [read_run(situation.of(name, seed)) for seed in seeds]
    made, scenario = runs[0].situation.situation(), _scenario(runs[0])
    own = controller_entry(name).uses_model
    controllers = [models.controller(run) for run in (runs if own else runs[:1])]
    # Controllers of one kind as one, whose arrays have a leading axis.
    stacked = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *controllers)
    variance, drawn = np.full(len(seeds), runs[0].situation.noise_variance), np.asarray(seeds, np.uint32)
    if situation.oscillation:  # one more run, of the first controller without noise
        variance, drawn = np.append(variance, 0.0), np.append(drawn, drawn[0])

    def run(controller: Controller, variance: jax.Array, key: jax.Array) -> tuple[Metrics, Oscillation, Trace]:
        trace = close_loop(made, controller, scenario, around=_around(made, variance), key=key)
        return summarise(trace, made.limits), oscillation(trace), trace

    def block(places: npt.NDArray[np.intp], asked: int) -> Any:
        keys = jax.vmap(jax.random.key)(jnp.asarray(drawn[places]))
        which = np.where(places < len(controllers), places, 0)
        of_each = jax.tree.map(lambda leaf: leaf[which], stacked)
        metrics, turning, trace = jax.vmap(run)(of_each, jnp.asarray(variance[places]), keys)
        kept = jax.tree.map(np.asarray, (metrics, turning, trace.fine_glucose_mg_dl, trace.insulin_mU_min))
        progress(int((places[:asked] < len(seeds)).sum()))
        return jax.tree.map(lambda values: values[:asked], kept)

    parts = in_blocks(block, np.arange(drawn.size), together, threads=1)
    metrics, turning, glucose, insulin = jax.tree.map(lambda *of_blocks: np.concatenate(of_blocks), *parts)
    kept = slice(len(seeds))
    found = {name: np.asarray(values, float)[kept] for name, values in metrics.by_name().items()}
    grid = sample_grid(scenario.horizon_min, made.sample_time_min)
    setpoint = made.target_mg_dl
    return ControllerRuns(
        run=np.asarray(seeds, np.int64),
        numbers=numbers_of(found, grid.fine_t_min, glucose[kept].T, setpoint),
        t_min=grid.fine_t_min,
        glucose_mg_dl=glucose[kept].T,
        insulin_t_min=grid.t_min,
        insulin_mU_min=insulin[kept].T,
        setpoint_mg_dl=setpoint,
        quiet=jax.tree.map(lambda values: values[-1], turning) if situation.oscillation else None,
    )


def _loops_of_people(situation: NamedSituation, name: str, asked: ClaimsKeys, progress: Progress) -> ControllerRuns:
    """One run per person, equal to that of ``glucoloop trial`` with the seed."""
    trial = read_trial(situation.of_people(name, asked.seed, asked.people))
    prepared = engine.prepare(trial)
    together = block_size(prepared.cases[name].loop.engine)
    parts = []
    for start in range(0, asked.people, together):
        person = np.arange(start, min(start + together, asked.people))
        parts.append(engine.run_people(prepared, name, person, traces=True))
        progress(person.size)
    feasible = np.concatenate([part.feasible for part in parts])
    glucose, insulin = (
        np.concatenate([np.asarray(getattr(part, what), float) for part in parts], axis=1)[:, feasible]
        for what in ("glucose_mg_dl", "insulin_mU_min")
    )
    found = {
        key: np.concatenate([part.metrics[key] for part in parts])[feasible].astype(float) for key in parts[0].metrics
    }
    grid, setpoint = prepared.grid, prepared.setpoint_mg_dl
    t_min = np.append(grid.t_min, trial.plan.horizon_min)
    return ControllerRuns(
        run=np.concatenate([part.person for part in parts])[feasible],
        numbers=numbers_of(found, t_min, glucose, setpoint),
        t_min=t_min,
        glucose_mg_dl=glucose,
        insulin_t_min=grid.t_min,
        insulin_mU_min=insulin,
        setpoint_mg_dl=setpoint,
        infeasible=int((~feasible).sum()),
    )


def _bounds(situations: Sequence[NamedSituation]) -> dict[str, OptimalDoses]:
    """Best possible doses with any noise; they depend on whether the meal is announced, and on the dead time."""
    found: dict[tuple[bool, float], OptimalDoses] = {}
    bounds = {}
    for situation in situations:
        run = read_run(situation.of(OURS, 0))
        made, dead_time_min = run.situation.situation(), run.situation.dead_time_min
        known = run.situation.announce_meals, dead_time_min
        if known not in found:
            found[known] = bound_of_situation(
                made.nominal,
                _scenario(run),
                made.limits,
                dead_time_min=dead_time_min,
                sample_time_min=made.sample_time_min,
            )
        bounds[situation.name] = found[known]
    return bounds


def _time_of_step_ms(name: str, seed: int, models: _Models) -> float:
    """Median time of one sample of one patient on this machine, compiled, with noise."""
    run = read_run(next(situation for situation in SITUATIONS if situation.name == "noise").of(name, seed))
    person, controller = run.situation.situation().nominal, models.controller(run)
    observation = Observation(
        glucose_mg_dl=person.setpoint_mg_dl + 3.0,
        valid=jnp.asarray(True),
        setpoint_mg_dl=person.setpoint_mg_dl,
        delivered_mU_min=person.basal_insulin_mU_min,
        announced_carbs_g=jnp.zeros(()),
    )
    step = jax.jit(lambda controller, state, observation: controller.step(state, observation))
    state, taken = controller.init(observation), []
    for _ in range(_STEPS_TIMED + 1):
        before = time.perf_counter()
        state, decision = step(controller, state, observation)
        decision.insulin_mU_min.block_until_ready()
        taken.append(time.perf_counter() - before)
        observation = dataclasses.replace(observation, delivered_mU_min=decision.insulin_mU_min)
    return float(1000.0 * np.median(taken[1:]))  # the first one compiles
