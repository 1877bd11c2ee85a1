"""What `cohort.py` measures, in a process of its own: on one core if it was started on one.

It reads requests from its standard input, one JSON object a line, and answers each by a line.
"""

from __future__ import annotations

import contextlib
import functools
import json
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))

import jax
import jax.numpy as jnp
import numpy as np
from ceiling import ceilings, most_gflops, request_from
from closed_loop import MEALS

from glucoloop._pytree import pytree
from glucoloop.build.surroundings import surroundings_of
from glucoloop.meals import Meal, Scenario, eaten
from glucoloop.native.targets.llvm import kernel
from glucoloop.simulation import Adaptive, cohort, people_plant
from glucoloop.simulation.cohort import People
from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials.people import block_size
from glucoloop.trials.trial import Trial

kernel.MANY_ROUNDS = 0  # code for speed, as of large populations
NOISE = ["white-noise, variance=1.45"]
OWN_MEALS = {"meal_size_spread_pct": 30.0, "meal_time_spread_min": 45.0}
STRAIGHT = ("basal", "mpc", "mpc-se")
"""Cases whose program has no loops, so that its operations can be counted."""
CASES = (*STRAIGHT, "nlqdmc-se")
SITUATIONS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "plain": (CASES, {}),
    "noise": (("mpc",), {"sensor": NOISE}),
    "own meals": (("mpc",), OWN_MEALS),
    "noise and own meals": (("mpc", "mpc-se"), {"sensor": NOISE, **OWN_MEALS}),
    "under the skin": (("mpc",), {"patient": "hovorka-2004", "sensor": NOISE}),
}
COMPARED = ("undershoot", "peak", "mean")
KEYS = {"people": 1000, "seed": 1, "meals": [f"{grams:g}g@{minutes:g}min" for grams, minutes in MEALS]}


@functools.lru_cache
def trial(situation: str, precision: str) -> engine.PreparedTrial:
    """A trial made ready: designed and compiled."""
    cases, keys = SITUATIONS[situation]
    return engine.prepare(configured(Trial, {**KEYS, **keys}, precision=precision, controller=list(cases)))


def about(situation: str, precision: str, case: str) -> dict[str, Any]:
    """By which engine, and how many people at a time."""
    made = trial(situation, precision).cases[case].loop.cohort
    return {"engine": made.engine, "block": block_size(made.engine)}


@functools.lru_cache
def blocks_of(situation: str, precision: str, case: str, people: int) -> tuple[Any, list[People]]:
    """The people of a trial as its loop is given them, block by block."""
    prepared = trial(situation, precision)
    made, caught = prepared.cases[case].loop.cohort, []
    follow = made.follow

    def catch(given: People, take: Callable[..., None], **options: Any) -> tuple[Any, Any, Any]:
        caught.append(given)
        return follow(given, take, **options)

    made.follow = catch  # type: ignore[method-assign]
    try:
        engine.run_people(prepared, case, np.arange(people), threads=1)
    finally:
        del made.follow
    return made, caught


def speed(situation: str, precision: str, case: str, people: int, threads: int) -> dict[str, float]:
    """Patient-days a second: of the whole path of a trial, and of its loop alone."""
    prepared = trial(situation, precision)
    made, blocks = blocks_of(situation, precision, case, people)
    start = time.perf_counter()
    engine.run_people(prepared, case, np.arange(people), threads=threads)
    path = time.perf_counter() - start
    with ThreadPoolExecutor(threads) as pool:
        start = time.perf_counter()
        list(pool.map(made.run, blocks))
        loop = time.perf_counter() - start
    return {"trial": people / path, "loop": people / loop}


@contextlib.contextmanager
def timed(seconds: dict[str, float], name: str, of: Any, function: str) -> Iterator[None]:
    """Add the time spent in a function that is an attribute of something."""
    inner: Callable[..., Any] = getattr(of, function)

    def outer(*given: Any, **options: Any) -> Any:
        start = time.perf_counter()
        result = jax.block_until_ready(inner(*given, **options))
        seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start
        return result

    setattr(of, function, outer)
    try:
        yield
    finally:
        setattr(of, function, inner)


def parts(situation: str, precision: str, people: int) -> dict[str, float]:
    """Where the time of a trial with linear MPC goes, microseconds a person."""
    prepared = trial(situation, precision)
    made, seconds = prepared.cases["mpc"].loop.cohort, dict[str, float]()
    watched = [
        ("drawing people, basal rates", engine, "virtual_people"),
        ("drawing meals", Trial, "drawn_days"),
        ("random keys", engine, "keys_of_people"),
        ("kernel", made._engine._kernel, "run"),
        ("matrices of insulin", people_plant, "driven_matrices"),
        ("histograms", engine._Counts, "_count"),
        ("loop", made, "follow"),
    ]
    if made._engine._draw is not None:
        watched.append(("random numbers", made._engine, "_draw"))
    start = time.perf_counter()
    with contextlib.ExitStack() as stack:
        for watch in watched:
            stack.enter_context(timed(seconds, *watch))
        engine.run_people(prepared, "mpc", np.arange(people), threads=1)
    total = time.perf_counter() - start
    inside = sum(seconds.get(name, 0.0) for name in ("kernel", "matrices of insulin", "random numbers", "histograms"))
    seconds["rest of the loop"] = seconds.pop("loop") - inside
    seconds["metrics, and the rest"] = total - sum(seconds.values())
    return {name: 1e6 * value / people for name, value in seconds.items()}


@pytree
class Nothing:
    """Keeps nothing of a loop."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> Any:
        del glucose_mg_dl, insulin_mU_min
        return ()

    def step(self, state: Any, happened: Any, t_min: jax.Array) -> Any:
        del happened, t_min
        return state


@functools.lru_cache
def without_metrics(precision: str) -> cohort.Cohort:
    """The loop of linear MPC that keeps nothing."""
    prepared = trial("plain", precision)
    given = prepared.trial
    example = engine.people_of(given, [0])
    around = surroundings_of(given)
    return cohort.Cohort(
        given.nominal,
        example.patient,
        prepared.cases["mpc"].controller,
        around.sensor,
        around.pump,
        prepared.trial.grid,
        Nothing(),
        setpoint_mg_dl=prepared.trial.target_mg_dl,
        meals=eaten(given.plan.meals),
        precision=precision,
    )


def kernels(precision: str, repeats: int) -> dict[str, Any]:
    """What each loop asks of the processor, and the ceiling that follows."""
    gflops = most_gflops(precision, repeats)
    prepared = trial("plain", precision)
    loops = {name: prepared.cases[name].loop.cohort for name in STRAIGHT}
    loops["mpc, no metrics"] = without_metrics(precision)
    asked = {name: request_from(loop._engine._kernel) for name, loop in loops.items()}
    reach = {name: ceilings(numbers, gflops) for name, numbers in asked.items()}
    return {"gflops": gflops, "asked": asked, "ceilings": reach}


def kernel_speed(precision: str, case: str, people: int) -> dict[str, float]:
    """Patient-days a second of the vector code alone."""
    made, blocks = blocks_of("plain", precision, case if case in CASES else "mpc", people)
    made = made if case in CASES else without_metrics(precision)
    seconds: dict[str, float] = {}
    with timed(seconds, "kernel", made._engine._kernel, "run"):
        for block in blocks:
            made.run(block)
    return {"kernel": sum(block.insulin_mU_min.size for block in blocks) / seconds["kernel"]}


def accuracy(people: int, tolerance: float) -> dict[str, float]:
    """Glucose of the batch against the adaptive integrator under the same insulin, mg/dl at all samples."""
    prepared = trial("plain", "float64")
    made, blocks = blocks_of("plain", "float64", "mpc", people)
    runs = [made.run(block) for block in blocks]
    glucose = np.concatenate([run.glucose_mg_dl for run in runs], axis=1)[:, :people]
    insulin = np.concatenate([run.insulin_mU_min for run in runs], axis=1)[:, :people]
    x = np.concatenate([np.asarray(block.x) for block in blocks], axis=1)[:, :people]
    day = Scenario([Meal(*meal) for meal in MEALS], 1440.0)

    @jax.jit
    def replay(patient: Any, x: jax.Array, insulin: jax.Array) -> jax.Array:
        plant, times = Adaptive(tolerance).prepare(patient, day.absorbed_by(patient), prepared.trial.grid)

        def sample(x: jax.Array, entry: Any) -> tuple[jax.Array, jax.Array]:
            x, _ = plant.advance(x, *entry)
            return x, patient.glucose_mg_dl(x)

        return jax.lax.scan(sample, x, (insulin, times))[1]

    nominal = prepared.trial.nominal
    patients = [block.patient for block in blocks]

    def error(person: int) -> float:
        block, place = divmod(person, blocks[0].insulin_mU_min.size)
        one = jax.tree.map(
            lambda many, single: many[..., place] if jnp.ndim(many) > jnp.ndim(single) else many,
            patients[block],
            nominal,
        )
        return float(np.abs(replay(one, x[:, person], insulin[:, person]) - glucose[1:, person]).max())

    errors = []
    for number in range(people):
        errors.append(error(number))
        if (number + 1) % 50 == 0:
            print(f"    {number + 1} people of {people} by the adaptive integrator", file=sys.stderr)
    return {
        "people": people,
        "largest": float(np.max(errors)),
        "p95": float(np.percentile(errors, 95)),
        "median": float(np.median(errors)),
    }


def single_against_double(people: int) -> dict[str, dict[str, float]]:
    """Differences between the metrics of the two precisions, mg/dl, and for how many people one is above 0.1."""
    result = {}
    for case in STRAIGHT:
        double, single = (
            engine.run_people(trial("plain", precision), case, np.arange(people)).metrics
            for precision in ("float64", "float32")
        )
        apart = {name: np.abs(double[f"{name}_mg_dl"] - single[f"{name}_mg_dl"]) for name in COMPARED}
        worst = np.max(list(apart.values()), axis=0)
        result[case] = {
            **{name: float(np.nanmax(of)) for name, of in apart.items()},
            "median": float(np.nanmedian(worst)),
            "beyond": int((worst > 0.1).sum()),
            "people": people,
        }
    return result


ANSWERS: dict[str, Callable[..., Any]] = {
    function.__name__: function
    for function in (about, speed, parts, kernels, kernel_speed, accuracy, single_against_double)
}


def main() -> None:
    for line in sys.stdin:
        request = json.loads(line)
        answer = ANSWERS[request.pop("do")](**request)
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
