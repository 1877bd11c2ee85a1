"""Measure how accurate the integrators are, against SciPy, and write the figures for ``guide/integrator.md``.

    python docs/accuracy.py        # a minute; rewrites docs/guide/accuracy.md

One day with three meals under linear MPC. The insulin of the loop is fixed first; then glucose at every sample is
compared with SciPy's DOP853 at a relative tolerance of 1e-12, started anew at every sample and every kink of a meal.
A second day has insulin that varies smoothly, which shows the order of convergence.
"""

import itertools
import platform
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))

import jax
import jax.numpy as jnp
import numpy as np
import scipy.integrate

from glucoloop import design_linear_mpc, identify, patient, simulate
from glucoloop.meals import Meal, Scenario, appearance_mg_min
from glucoloop.patients import Inputs
from glucoloop.simulation import Adaptive, Exponential
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


def run(person, integrator, insulin):
    """Glucose at each sample and at the end."""
    grid = SampleGrid(sample_time_min=T, samples=insulin.size)
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
        f"\nMeasured in float64 with JAX {jax.__version__} and SciPy {scipy.__version__} on {platform.machine()}."
    )
    text = "\n".join(lines) + "\n"
    (Path(__file__).resolve().parent / "guide" / "accuracy.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
