"""Measure how accurate the integrators are, against SciPy, and write the figures for ``guide/integrator.md``.

    python docs/accuracy.py        # minutes; rewrites docs/guide/accuracy.md and docs/guide/accuracy_rough.md

One day with three meals under linear MPC. The insulin of the loop is fixed first; then glucose at every sample is
compared with SciPy's DOP853 at a relative tolerance of 1e-12, started again at every sample and every kink of a meal.
A second day has insulin that varies smoothly, which shows the order of convergence. In further days insulin jumps at
every sample by as much as the paper's pump can: so the steps of a sample are chosen.
"""

import itertools
import platform
import sys
from datetime import date
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))

import jax
import jax.numpy as jnp
import numpy as np
import scipy.integrate

from glucoloop import design_linear_mpc, identify, patient, simulate
from glucoloop.meals import Meal, Scenario, appearance_mg_min
from glucoloop.patients import Inputs
from glucoloop.pumps.limits import PARKER_1999_LIMITS
from glucoloop.simulation import Adaptive, Exponential
from glucoloop.simulation.exponential import DEFAULT_ACCURACY_MG_DL, substeps_for
from glucoloop.simulation.plant import SampleGrid

T = 5.0
DAY = Scenario([Meal(45.0, 407.3), Meal(70.0, 733.1), Meal(60.0, 1080.7)], 1440.0)
METHODS = {
    "exponential, 1 step a sample (default)": Exponential(),
    "exponential, 2 steps": Exponential(substeps=2),
    "exponential, 4 steps": Exponential(substeps=4),
    "exponential, 8 steps": Exponential(substeps=8),
    "adaptive, tolerance 1e-9 (default)": Adaptive(),
}
SAMPLE_TIMES_MIN = (1.0, 2.5, 5.0, 10.0, 15.0, 30.0)
ROUGH_SEEDS = range(3)


def run(person, integrator, insulin, sample_time_min=T):
    """Glucose at each sample and at the end."""
    grid = SampleGrid(sample_time_min=sample_time_min, samples=insulin.size)
    plant, meals = integrator.prepare(person, DAY.absorbed_by(person), grid)

    def sample(x, entry):
        x, _ = plant.advance(x, *entry)
        return x, person.glucose_mg_dl(x)

    x = person.steady_state(person.basal_insulin_mU_min)
    _, glucose = jax.jit(lambda x, entries: jax.lax.scan(sample, x, entries))(x, (jnp.asarray(insulin), meals))
    return np.asarray(glucose)


def reference(person, insulin):
    """The same by SciPy."""
    eaten = DAY.absorbed_by(person)
    rates = jax.jit(
        lambda t, x, u: person.derivative(t, x, Inputs(insulin_mU_min=u, meal_mg_min=appearance_mg_min(t, eaten)))
    )
    stops = np.unique(np.r_[np.arange(insulin.size + 1) * T, np.asarray(eaten.jumps.t_min)])
    x = np.asarray(person.steady_state(person.basal_insulin_mU_min))
    glucose = []
    for start, end in itertools.pairwise(stops[stops <= insulin.size * T]):
        u = insulin[int(start // T)]
        x = scipy.integrate.solve_ivp(
            lambda t, x, u=u: np.asarray(rates(t, x, u)), (start, end), x, method="DOP853", rtol=1e-12, atol=1e-12
        ).y[:, -1]
        if end % T == 0.0:
            glucose.append(float(person.glucose_mg_dl(x)))
    return np.array(glucose)


def errors(person, insulin):
    """Largest error of each method, mg/dl."""
    truth = reference(person, insulin)
    return {name: float(np.abs(run(person, method, insulin) - truth).max()) for name, method in METHODS.items()}


def rough_insulin(person, sample_time_min, seed):
    """Insulin that goes up or down by the largest step of the pump at every sample, at random."""
    rng, limits = np.random.default_rng(seed), PARKER_1999_LIMITS
    rates = [float(person.basal_insulin_mU_min)]
    for change in rng.choice([-1.0, 1.0], round(DAY.horizon_min / sample_time_min)):
        wanted = rates[-1] + change * float(limits.max_change_mU_min)
        rates.append(float(np.clip(wanted, float(limits.min_mU_min), float(limits.max_mU_min))))
    return np.array(rates[1:])


def rough(person):
    """Lines of the table of errors under rough insulin, by sample time."""
    lines = [
        "| Sample time, min | One step, mg/dl | Steps by default | With them, mg/dl | Model of the error, mg/dl |",
        "| ---: | ---: | ---: | ---: | ---: |",
    ]
    for sample_time_min in SAMPLE_TIMES_MIN:
        one, usual = [], []
        for seed in ROUGH_SEEDS:
            insulin = rough_insulin(person, sample_time_min, seed)
            truth = run(person, Adaptive(1e-10), insulin, sample_time_min)
            for errors_of, integrator in ((one, Exponential(substeps=1)), (usual, Exponential())):
                result = run(person, integrator, insulin, sample_time_min)
                errors_of.append(float(np.abs(result - truth).max()))
        steps = substeps_for(sample_time_min)
        model = DEFAULT_ACCURACY_MG_DL * (sample_time_min / steps / 5.0) ** 2.4
        lines.append(f"| {sample_time_min:g} | {max(one):.1e} | {steps} | {max(usual):.1e} | {model:.1e} |")
    return lines


def main():
    person = patient()
    controller = design_linear_mpc(identify(person).model)
    loop = errors(person, np.asarray(simulate(person, controller, scenario=DAY).insulin_mU_min))
    smooth = errors(person, 25.6 + 5.0 * np.sin(np.arange(288) / 12.0))
    lines = [
        "| Method | Largest error under control, mg/dl | Insulin varying smoothly, mg/dl | Order |",
        "| :--- | ---: | ---: | ---: |",
    ]
    before = None
    for name in METHODS:
        exponential = name.startswith("exponential")
        order = f"{np.log2(before / smooth[name]):.1f}" if exponential and before else ""
        before = smooth[name] if exponential else None
        lines.append(f"| {name} | {loop[name]:.1e} | {smooth[name]:.1e} | {order} |")
    lines.append(
        f"\nMeasured on {date.today().isoformat()} in float64 with JAX {jax.__version__} and SciPy {scipy.__version__} "
        f"on {platform.machine()}."
    )
    text = "\n".join(lines) + "\n"
    (Path(__file__).resolve().parent / "guide" / "accuracy.md").write_text(text, encoding="utf-8")
    print(text)
    text = "\n".join(rough(person)) + "\n"
    (Path(__file__).resolve().parent / "guide" / "accuracy_rough.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
