"""A published study of glucagon, carried out on virtual people beside what it measured.

    python validation/glucagon_study.py
    python validation/glucagon_study.py --people 1000 --fasting 7.5 --lowest 3.2

Ranjan et al. (2016) lowered the glucose of eight fasting people by a bolus of insulin under the skin, and gave saline
or 100, 200 or 300 ug of glucagon where plasma glucose had reached 3.4 mmol/l. Their primary endpoint is the highest
plasma glucose after it; the mean and its interval of 95 % are printed.

Here people of the population of `wilinska-2010-glucagon` rest at a fasting glucose, which is not printed and is 120
mg/dl unless another one is given. Each gets the bolus after which glucose is lowest at 3.4 mmol/l, since after saline
it hardly fell or rose in the study, or lower where ``--lowest`` says so, and the dose when glucose comes to 3.4 mmol/l,
and is followed for three hours. The basal rate goes on. The table has the means over the people, with an interval of 95
% of the mean of eight of them.

A. Ranjan, S. Schmidt, S. Madsbad, J. J. Holst, K. Nørgaard, "Effects of subcutaneous, low-dose glucagon on
insulin-induced mild hypoglycaemia in patients with insulin pump treated type 1 diabetes", Diabetes Obes. Metab. 18(4),
2016, 410-418.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from glucoloop.patients import Inputs
from glucoloop.patients.hovorka.equations import MG_DL_PER_MMOL_L, STATE_NAMES
from glucoloop.patients.hovorka.patient import HovorkaPatient, WilinskaGlucagon
from glucoloop.patients.population import VirtualPeople, population, virtual_people
from glucoloop.units import MU_PER_U

Values = npt.NDArray[np.float64]


class Printed(NamedTuple):
    """A mean and its interval of 95 %, mmol/l."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean} ({self.low} to {self.high})"


AT_MMOL_L: Final = 3.4
"""Plasma glucose at which glucagon was given."""
PEAKS: Final = {
    0.0: Printed(3.6, 3.4, 3.9),
    100.0: Printed(6.1, 4.9, 7.4),
    200.0: Printed(7.9, 6.4, 9.3),
    300.0: Printed(8.7, 7.8, 9.5),
}
"""Highest plasma glucose after each dose of glucagon [ug]."""
RISES: Final = {100.0: Printed(2.3, 1.7, 3.0), 200.0: Printed(4.2, 3.5, 4.8), 300.0: Printed(5.0, 4.3, 5.6)}
"""Increase of plasma glucose after each dose [ug]."""

INSULIN_DEPOT: Final = STATE_NAMES.index("S1")
GLUCAGON_DEPOT: Final = len(STATE_NAMES)
STEP_MIN: Final = 0.5
FALL_MIN: Final = 480.0
FOLLOWED_MIN: Final = 180.0
MOST_U: Final = 60.0
IN_THE_STUDY: Final = 8


class Study(NamedTuple):
    """What the people of a study had."""

    bolus_U: Values
    """``(n,)`` insulin that lowered glucose."""
    waited_min: Values
    """``(n,)`` time from the bolus to that glucose."""
    peak_mmol_l: dict[float, Values]
    """Highest plasma glucose ``(n,)`` after each dose of glucagon [ug]."""


def courses(patient: HovorkaPatient, x: jax.Array, insulin_mU_min: jax.Array, minutes: float) -> jax.Array:
    """States ``(times, states, n)`` under a constant rate, by the classical method of fourth order."""
    inputs = Inputs(insulin_mU_min=insulin_mU_min, meal_mg_min=jnp.zeros_like(insulin_mU_min))

    def rate(x: jax.Array) -> jax.Array:
        return patient.derivative(jnp.asarray(0.0), x, inputs)

    def step(x: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        first = rate(x)
        second = rate(x + STEP_MIN / 2.0 * first)
        third = rate(x + STEP_MIN / 2.0 * second)
        last = rate(x + STEP_MIN * third)
        later = x + STEP_MIN / 6.0 * (first + 2.0 * second + 2.0 * third + last)
        return later, later

    _, states = jax.lax.scan(step, x, None, length=int(minutes / STEP_MIN))
    return jnp.concatenate([x[None], states])


def carried_out(people: VirtualPeople, lowest_mmol_l: float = AT_MMOL_L) -> Study:
    """The study on people who rest, after a bolus that alone would lower glucose to the given one."""
    patient, rest = people.patient, jnp.asarray(people.rest)
    if not isinstance(patient, WilinskaGlucagon):
        raise TypeError(f"the study needs people of {WilinskaGlucagon.name}, not of {people.name}")
    basal = jnp.asarray(people.basal_insulin_mU_min)
    volume_l = jnp.asarray(patient.parameters.glucose_volume_l)

    def followed(minutes: float) -> Callable[[jax.Array], jax.Array]:
        return jax.jit(lambda x: courses(patient, x, basal, minutes))

    fall, after = followed(FALL_MIN), followed(FOLLOWED_MIN)

    def fallen(bolus_mU: Values) -> jax.Array:
        return fall(rest.at[INSULIN_DEPOT].add(bolus_mU))

    low, high = np.zeros(rest.shape[1]), np.full(rest.shape[1], MOST_U * MU_PER_U)
    for _ in range(40):
        middle = (low + high) / 2.0
        enough = np.asarray((fallen(middle)[:, 0] / volume_l).min(axis=0)) <= lowest_mmol_l
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    states = np.asarray(fallen(high))
    glucose = states[:, 0] / np.asarray(volume_l)
    when = (glucose <= max(AT_MMOL_L, lowest_mmol_l + 1e-9)).argmax(axis=0)
    x = jnp.asarray(np.take_along_axis(states, when[None, None], axis=0)[0])
    peaks = {dose: np.asarray((after(x.at[GLUCAGON_DEPOT].add(dose))[:, 0] / volume_l).max(axis=0)) for dose in PEAKS}
    return Study(high / MU_PER_U, when * STEP_MIN, peaks)


def people_of_study(n: int, seed: int, fasting_mmol_l: float) -> VirtualPeople:
    """People of the population whom a rate holds at the fasting glucose."""
    of = population("wilinska2010", patient="wilinska-2010-glucagon")
    people = virtual_people(of, seed, np.arange(n), setpoint_mg_dl=fasting_mmol_l * MG_DL_PER_MMOL_L)
    return people.at(np.flatnonzero(people.feasible))


def of_eight(values: Values, seed: int = 0) -> tuple[float, float]:
    """Interval of 95 % of the mean of eight people."""
    means = np.random.default_rng(seed).choice(values, (10_000, IN_THE_STUDY)).mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def rows(study: Study) -> list[str]:
    """Lines of the table, one for each dose."""
    lines = ["| Glucagon (ug) | Highest glucose, measured (mmol/l) | Model | Rise, measured | Model |"]
    lines.append("| ---: | ---: | ---: | ---: | ---: |")
    for dose, peak in study.peak_mmol_l.items():
        low, high = of_eight(peak)
        rise = str(RISES[dose]) if dose in RISES else ""
        model = f"{peak.mean():.1f} ({low:.1f} to {high:.1f})"
        lines.append(f"| {dose:.0f} | {PEAKS[dose]} | {model} | {rise} | {peak.mean() - AT_MMOL_L:.1f} |")
    return lines


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=200)
    parser.add_argument("--seed", type=int, default=4100)
    parser.add_argument("--fasting", type=float, default=120.0 / MG_DL_PER_MMOL_L, help="fasting glucose, mmol/l")
    parser.add_argument("--lowest", type=float, default=AT_MMOL_L, help="lowest glucose after saline, mmol/l")
    given = parser.parse_args()
    people = people_of_study(given.people, given.seed, given.fasting)
    study = carried_out(people, given.lowest)
    print(f"{study.bolus_U.size} of {given.people} people rest at {given.fasting:.1f} mmol/l.", end=" ")
    print(f"{study.bolus_U.mean():.1f} U lower it to {AT_MMOL_L} within {study.waited_min.mean():.0f} min (means).\n")
    print("\n".join(rows(study)))


if __name__ == "__main__":
    main()
