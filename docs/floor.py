"""What a soft floor under predicted glucose does on the rows of Table II that break the constraint (19).

    python docs/floor.py

It closes the loops of these rows again, with the seeds of ``glucoloop reproduce parker1999``, and rewrites
``guide/floor.md``.
"""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from made import NAMES, made

from glucoloop._pytree import pytree
from glucoloop.control import Controller, design_linear_mpc, design_mpc_se
from glucoloop.control.tuning import DEFAULT_FLOOR_WEIGHT, PARKER_1999
from glucoloop.metrics import summarise
from glucoloop.patients import patient
from glucoloop.reproduction.parker1999.experiments import NOISE_VARIANCE, SAMPLE_TIME_MIN
from glucoloop.sensors import dead_time, white_noise
from glucoloop.simulation import identify, linear_model, simulate

OPERATING_POINT, SEED, SEEDS = "setpoint-81", 1, 60
LOWEST_MG_DL = 60.0
ROWS = {"mpc": ("10", "10M", "15", "15M"), "mpc-se": ("10", "15", "15M")}
WAYS = {
    "as in the paper": {},
    "`qp`, no floor": {"constraints": "qp"},
    "floor 60": {"glucose_floor_mg_dl": 60.0},
    "floor 65": {"glucose_floor_mg_dl": 65.0},
    "floor 70": {"glucose_floor_mg_dl": 70.0},
}
COLUMNS = (
    "Dead time",
    "Moves",
    "Runs ever below 60, %",
    "Time below 60, mean %",
    "Lowest glucose, mg/dl",
    "Undershoot, mg/dl",
    "Settling, min",
    "Decisions not converged, all runs",
)

WHEN = (
    "Dead time",
    "Glucose below 60, min",
    "Latest stop of insulin that keeps 60, min",
    *(f"Dose first changed by {way}, min" for way in list(WAYS)[2:]),
)
LONGEST_LEAD = 12
"""Samples before glucose crosses 60 that a stop is tried."""
MIN_CHANGE_MU_MIN = 0.1


class Experiment:
    """The rows' loops: one person, one identified model and one record of noise for each seed."""

    def __init__(self, seeds=SEEDS):
        self.person = patient(operating_point=OPERATING_POINT)
        self.tuning = PARKER_1999[OPERATING_POINT, True]
        self.linear = linear_model(self.person)
        records, loops = jax.random.split(jax.random.key(SEED))
        self.keys = jax.random.split(loops, seeds)
        noisy = white_noise(NOISE_VARIANCE)
        self.models = [identify(self.person, noisy, key).model for key in jax.random.split(records, seeds)]

    def controllers(self, name, dead_time, **settings):
        """The controller of each seed, and the axis of the seeds."""
        samples = int(dead_time.removesuffix("M")) // SAMPLE_TIME_MIN if dead_time.endswith("M") else 0
        if name == "mpc-se":
            noise = self.person.process_noise(*self.tuning.noise)
            tuning = self.tuning.mpc_se
            return design_mpc_se(self.linear, noise, tuning, dead_time_samples=samples, **settings), None
        tuning = self.tuning.mpc
        tuning = dataclasses.replace(tuning, prediction_horizon=tuning.prediction_horizon + samples)
        each = [design_linear_mpc(model.delayed(samples), tuning, **settings) for model in self.models]
        return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *each), 0

    def each(self, measure, name, dead_time_min, *more, **settings):
        """A measure of the loop of each seed; `more` has an entry for each seed."""
        sensor = dead_time(int(dead_time_min.removesuffix("M")) // SAMPLE_TIME_MIN, white_noise(NOISE_VARIANCE))
        controllers, axis = self.controllers(name, dead_time_min, **settings)

        def run(controller, key, *own):
            return measure(lambda given: simulate(self.person, given, sensor, key=key), controller, *own)

        return jax.vmap(run, in_axes=(axis, 0, *(0 for _ in more)))(controllers, self.keys, *more)

    def metrics(self, name, dead_time_min, **settings):
        """Of each seed."""
        return self.each(lambda loop, controller: summarise(loop(controller)), name, dead_time_min, **settings)


@pytree
class Stopped:
    """A controller that asks for no insulin from a sample on."""

    inner: Controller
    sample: jax.Array

    @property
    def sample_time_min(self):
        return self.inner.sample_time_min

    def init(self, observation):
        return self.inner.init(observation), jnp.zeros_like(observation.glucose_mg_dl)

    def step(self, state, observation):
        inner, decision = self.inner.step(state[0], observation)
        wanted = jnp.where(state[1] >= self.sample, 0.0, decision.insulin_mU_min)
        return (inner, state[1] + 1.0), dataclasses.replace(decision, insulin_mU_min=wanted)


def timing(experiment, name, row):
    """When glucose first goes below 60, by how much earlier insulin must stop, and when each floor first acts."""

    def trace(loop, controller):
        happened = loop(controller)
        return happened.glucose_mg_dl, happened.insulin_mU_min

    glucose, insulin = map(np.asarray, experiment.each(trace, name, row, constraints="qp"))
    low = glucose < LOWEST_MG_DL
    if not np.mean(low.any(axis=1)) > 0.5:
        return None
    crossing = np.argmax(low, axis=1)
    leads = np.arange(LONGEST_LEAD + 1)

    def lowest(loop, controller, samples):
        return jax.vmap(lambda sample: loop(Stopped(inner=controller, sample=sample)).glucose_mg_dl.min())(samples)

    stops = jnp.asarray(crossing[:, None] - leads)
    kept = np.asarray(experiment.each(lowest, name, row, stops, constraints="qp")) >= LOWEST_MG_DL
    needed = np.where(kept.any(axis=1), np.argmax(kept, axis=1), np.inf)
    cells = [f"{SAMPLE_TIME_MIN * np.median(crossing):.0f}", f"{SAMPLE_TIME_MIN * np.median(needed):g} before"]
    for settings in list(WAYS.values())[2:]:
        changed = np.abs(np.asarray(experiment.each(trace, name, row, **settings)[1]) - insulin) > MIN_CHANGE_MU_MIN
        lead = SAMPLE_TIME_MIN * np.median(
            np.where(changed.any(axis=1), crossing - np.argmax(changed, axis=1), -np.inf)
        )
        cells.append(
            "never" if np.isinf(lead) else f"{abs(lead):g} {'after' if lead < 0 else 'before'}" if lead else "at once"
        )
    return cells


def measures(name, metrics):
    """Numbers of one line of the table."""
    wide = name == "mpc"  # the band of settling as in the reproduction of Table II
    settling = metrics.settling_5pct_min if wide else metrics.settling_2pct_min
    settled = metrics.settled_5pct if wide else metrics.settled_2pct
    minimum = np.asarray(metrics.minimum_mg_dl)
    below = 100.0 * float(np.mean(minimum < LOWEST_MG_DL))
    return [
        f"{below:.0f}",
        f"{np.mean(metrics.time_below_60_pct):.2f}",
        f"{np.median(minimum):.1f}",
        f"{np.median(metrics.undershoot_mg_dl):.1f}",
        f"{np.median(settling):.0f}" if np.mean(settled) > 0.5 else "551+",
        f"{np.sum(metrics.samples_not_converged):.0f}",
    ]


def main():
    experiment = Experiment()
    lines = [f"| {' | '.join(WHEN)} |", f"| :--- |{' ---: |' * (len(WHEN) - 1)}"]
    for name, rows in ROWS.items():
        for row in rows:
            result = timing(experiment, name, row)
            if result is not None:
                lines.append(f"| {' | '.join([f'{NAMES[name]}, {row}', *result])} |")
                print(lines[-1], flush=True)
    lines += ["", f"| {' | '.join(COLUMNS)} |", f"| :--- | :--- |{' ---: |' * (len(COLUMNS) - 2)}"]
    for name, rows in ROWS.items():
        for row in rows:
            for way, settings in WAYS.items():
                result = measures(name, experiment.metrics(name, row, **settings))
                lines.append(f"| {' | '.join([f'{NAMES[name]}, {row}', way, *result])} |")
                print(lines[-1], flush=True)
    lines += [
        "",
        f"{SEEDS} seeds, floor weight {DEFAULT_FLOOR_WEIGHT:g}; {made()}.\n",
    ]
    (Path(__file__).resolve().parent / "guide" / "floor.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
