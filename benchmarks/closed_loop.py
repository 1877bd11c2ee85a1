#!/usr/bin/env python3
"""Time one person-day of closed loop: three meals, linear MPC, 5-min samples.

    python benchmarks/closed_loop.py [--json] [--simglucose-python PYTHON]

Measured: a new process, with an empty and with a filled compilation cache; a run in a process that has run before; one
interactive step (controller, pump and patient, each call from Python); and, beside it, one person-day of simglucose
0.2.11 (its basal-bolus controller, 3-min samples) in the same session. simglucose needs ``setuptools<81``; give the
interpreter of an environment that has both, or install ``glucoloop[bench]`` here.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

MEALS = ((45.0, 407.3), (70.0, 733.1), (60.0, 1080.7))  # g, min
REPEATS = 30

SIMGLUCOSE = """
import json, time, warnings
warnings.simplefilter("ignore")
start = time.perf_counter()
try:
    import pandas
    from datetime import datetime, timedelta
    from simglucose.actuator.pump import InsulinPump
    from simglucose.controller.basal_bolus_ctrller import BBController
    from simglucose.patient.t1dpatient import T1DPatient
    from simglucose.sensor.cgm import CGMSensor
    from simglucose.simulation.env import T1DSimEnv
    from simglucose.simulation.scenario import CustomScenario
    from simglucose.simulation.sim_engine import SimObj
except ImportError as error:
    print(json.dumps({"absent": str(error)}))
    raise SystemExit
imported = time.perf_counter()
midnight = datetime(2024, 1, 1)
scenario = CustomScenario(start_time=midnight, scenario=MEALS)
env = T1DSimEnv(
    T1DPatient.withName("adult#001"),
    CGMSensor.withName("Dexcom", seed=1),
    InsulinPump.withName("Insulet"),
    scenario,
)
loop = SimObj(env, BBController(), timedelta(days=1), animate=False)
ready, spent = time.perf_counter(), time.process_time()
loop.simulate()
done = time.perf_counter()
print(json.dumps({
    "import_s": imported - start,
    "day_s": done - ready,
    "day_processor_s": time.process_time() - spent,
    "pandas": pandas.__version__,
    "samples": len(loop.results()) - 1,
}))
"""


def new_process(cache: str | None) -> dict[str, Any]:
    """One day in a process of its own: import, patient, identification, design, simulation."""
    variables = dict(os.environ)
    variables.pop("JAX_COMPILATION_CACHE_DIR", None)
    if cache is not None:
        variables["JAX_COMPILATION_CACHE_DIR"] = cache
        variables["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        variables["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, __file__, "--one-day"], env=variables, capture_output=True, text=True, check=False
    )
    total = time.perf_counter() - start
    if done.returncode != 0:
        sys.exit(f"a new process failed:\n{done.stderr}")
    return {"total_s": total, **json.loads(done.stdout)}


def prepare() -> tuple[Any, Any, Any]:
    """A patient, the controller designed on his identified model, and the day."""
    from glucoloop.control import MPCTuning, design_linear_mpc
    from glucoloop.meals import Meal, Scenario
    from glucoloop.patients import patient
    from glucoloop.simulation import identify

    person = patient()
    controller = design_linear_mpc(identify(person).model, MPCTuning(2, 10, 3.0, 1.0))
    return person, controller, Scenario([Meal(*meal) for meal in MEALS], 1440.0)


def one_day() -> dict[str, float]:
    """Durations in this new process, one stage after the other."""
    start = time.perf_counter()
    import jax

    from glucoloop.simulation import simulate

    imported = time.perf_counter()
    person, controller, scenario = prepare()
    designed = time.perf_counter()
    jax.block_until_ready(simulate(person, controller, scenario=scenario))
    done = time.perf_counter()
    return {"import_s": imported - start, "design_s": designed - imported, "day_s": done - designed}


def median_of(function: Any, repeats: int = REPEATS) -> float:
    durations = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        durations.append(time.perf_counter() - start)
    return statistics.median(durations)


def warm() -> dict[str, float]:
    """Medians once everything is compiled: a day, the part of it that JAX runs, and an interactive step."""
    import jax
    import jax.numpy as jnp

    from glucoloop.control import Observation
    from glucoloop.pumps import LimitedPump
    from glucoloop.sensors import IdealSensor
    from glucoloop.simulation import Exponential, closed_loop, simulate
    from glucoloop.simulation.loop import Loop
    from glucoloop.simulation.plant import SampleGrid
    from glucoloop.simulation.user_objects import apart

    person, controller, scenario = prepare()
    grid, integrator, pump = SampleGrid(sample_time_min=5.0, samples=288), Exponential(), LimitedPump()
    run = lambda: jax.block_until_ready(simulate(person, controller, scenario=scenario))  # noqa: E731
    run()
    day = median_of(run)

    plant, meals = integrator.prepare(person, scenario.absorbed_by(person), grid)
    start, key = closed_loop.start_of(person, scenario), jax.random.key(0)
    loop = Loop(
        plant=plant, controller=controller, sensor=IdealSensor(), pump=pump, setpoint_mg_dl=start.setpoint_mg_dl
    )
    arguments = (*apart(loop), start, meals, closed_loop.on_the_grid(scenario, grid), key)
    scan = lambda: jax.block_until_ready(closed_loop._run(*arguments))  # noqa: E731
    scan()
    looping = median_of(scan)
    ready = median_of(
        lambda: jax.block_until_ready(integrator.prepare(person, scenario.absorbed_by(person), grid)[1].moments)
    )

    @jax.jit
    def step(plant: Any, controller: Any, x: Any, state: Any, in_pump: Any, delivered: Any, meal: Any) -> Any:
        observation = Observation(
            glucose_mg_dl=plant.patient.glucose_mg_dl(x),
            valid=jnp.asarray(True),
            setpoint_mg_dl=plant.patient.setpoint_mg_dl,
            delivered_mU_min=delivered,
            announced_carbs_g=jnp.zeros(()),
        )
        state, decision = controller.step(state, observation)
        in_pump, delivery = pump.deliver(in_pump, decision.insulin_mU_min, key)
        x, inside = plant.advance(x, delivery.insulin_mU_min, meal)
        return x, state, in_pump, delivery.reported_mU_min, decision.status, inside

    def first() -> tuple[Any, Any, Any, Any]:
        delivered = person.basal_insulin_mU_min
        x = person.steady_state(delivered)
        observation = Observation(
            glucose_mg_dl=person.glucose_mg_dl(x),
            valid=jnp.asarray(True),
            setpoint_mg_dl=person.setpoint_mg_dl,
            delivered_mU_min=delivered,
            announced_carbs_g=jnp.zeros(()),
        )
        return x, controller.init(observation), pump.init(delivered, key), delivered

    each = [jax.tree.map(lambda part, k=k: part[k], meals) for k in range(288)]
    durations = []
    for _ in range(2):  # the first round compiles
        durations.clear()
        carry = first()
        for meal in each:
            start = time.perf_counter()
            *carry, _, inside = step(plant, controller, *carry, meal)
            jax.block_until_ready((carry, inside))
            durations.append(time.perf_counter() - start)
    return {"day_s": day, "loop_s": looping, "prepare_s": ready, "step_s": statistics.median(durations)}


def simglucose(python: str) -> dict[str, Any]:
    """One person-day of simglucose in a process of that interpreter."""
    meals = [(minutes / 60.0, grams) for grams, minutes in MEALS]
    program = SIMGLUCOSE.replace("MEALS", repr(meals))
    try:
        done = subprocess.run(
            [python, "-c", program], capture_output=True, text=True, check=False, cwd=tempfile.gettempdir()
        )
    except OSError as error:
        return {"absent": f"{python}: {error.strerror}"}
    if done.returncode != 0:
        return {"absent": done.stderr.strip().rsplit("\n", 1)[-1]}
    answer: dict[str, Any] = json.loads(done.stdout.strip().rsplit("\n", 1)[-1])
    return answer


def report(results: dict[str, Any]) -> str:
    first, cached, ready, other = (results[part] for part in ("new_process", "cached_process", "warm", "simglucose"))
    rows = [
        ("new process, nothing compiled before", first["total_s"]),
        ("new process, compilation cache filled", cached["total_s"]),
        *(
            (f"    {name}", cached[f"{part}_s"])
            for name, part in (("import", "import"), ("identify, design", "design"))
        ),
        ("    simulate", cached["day_s"]),
        ("one day again in the same process", ready["day_s"]),
        ("    of which the loop", ready["loop_s"]),
        ("    of which meals and matrices", ready["prepare_s"]),
        ("one interactive step", ready["step_s"]),
    ]
    lines = ["One person-day: 24 h, three meals, linear MPC every 5 min", ""]
    lines += [f"{name:42}{seconds * 1e3:12.2f} ms" for name, seconds in rows]
    lines.append("")
    if "absent" in other:
        lines.append(
            f"simglucose was not run ({other['absent']}). Install simglucose==0.2.11 and 'setuptools<81' in an "
            "environment and give its interpreter with --simglucose-python."
        )
    else:
        lines += [
            f"simglucose 0.2.11, pandas {other['pandas']}: one day of {other['samples']} samples, basal-bolus",
            f"{'one day':42}{other['day_s'] * 1e3:12.2f} ms",
            f"{'import':42}{other['import_s'] * 1e3:12.2f} ms",
            "",
            f"{'simglucose day / day here':42}{other['day_s'] / ready['day_s']:12.0f}",
            f"{'simglucose sample / step here':42}{other['day_s'] / other['samples'] / ready['step_s']:12.1f}",
            f"{'both from a new process, cache filled':42}"
            f"{(other['import_s'] + other['day_s']) / cached['total_s']:12.1f}",
        ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON, in seconds")
    parser.add_argument("--simglucose-python", default=sys.executable, help="interpreter that can import simglucose")
    parser.add_argument("--one-day", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one_day:
        print(json.dumps(one_day()))
        return
    with tempfile.TemporaryDirectory() as cache:
        first = new_process(None)
        new_process(cache)
        cached = new_process(cache)
    results = {
        "new_process": first,
        "cached_process": cached,
        "warm": warm(),
        "simglucose": simglucose(options.simglucose_python),
    }
    print(json.dumps(results, indent=2) if options.json else report(results))


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))
    main()
