"""Measure how much linear MPC on people depends on the noisy record from which its model was identified.

    python docs/records.py         # minutes; rewrites docs/guide/records_figures.md

The people, meals and sensor noise are those of the situation "People, with noise" of ``docs/claims.py``. Only the
noise of the identification's record differs.
"""

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "validation"))

import jax
import jax.numpy as jnp
import numpy as np
from made import made

from glucoloop.build.designs import controller_of, identified_model
from glucoloop.situations.situation import configured
from glucoloop.trials import engine
from glucoloop.trials.trial import Trial
from meal_aware.situations import SITUATIONS

RECORDS = range(1000, 1030)
PEOPLE, PEOPLE_SEED = 300, 2000
LOW_MG_DL = 60.0


class OfOneRecord:
    """Controllers of people, all designed on the record that is chosen; so one compiled loop serves every record."""

    def __init__(self, controllers):
        self._controllers, self.chosen = controllers, 0

    def __call__(self, people):
        count = np.size(people.basal_insulin_mU_min)
        return jax.tree.map(
            lambda leaf: jnp.broadcast_to(jnp.asarray(leaf)[..., None], (*jnp.shape(leaf), count)),
            self._controllers[self.chosen],
        )


def loops():
    """A prepared trial of linear MPC whose record can be chosen, and the gain of each model, mg/dl per mU/min."""
    situation = next(situation for situation in SITUATIONS if situation.name == "people")
    trial = configured(Trial, situation.trial_of("mpc", PEOPLE_SEED, PEOPLE))
    [case], prepared = trial.cases, engine.prepare(trial)
    result = [identified_model(dataclasses.replace(trial, seed=seed), case, trial.nominal) for seed in RECORDS]
    own = OfOneRecord([controller_of(trial, case, model=identified.model) for identified in result])
    of_case = prepared.cases["mpc"]
    loop = engine.loop_of(trial, of_case.controller, prepared.accumulator, controllers_of=own)
    cases = {"mpc": dataclasses.replace(of_case, loop=loop)}
    gains = [float(np.sum(identified.model.impulse_response)) for identified in result]
    return dataclasses.replace(prepared, cases=cases), own, gains


def rows():
    """Share of people ever below 60 mg/dl, in %, and the median undershoot, by record."""
    prepared, own, gains = loops()
    for number, gain in enumerate(gains):
        own.chosen = number
        result = engine.run_people(prepared, "mpc", np.arange(PEOPLE), traces=True, threads=1)
        lowest = np.asarray(result.glucose_mg_dl)[:, result.feasible].min(axis=0)
        undershoot = np.median(np.asarray(result.metrics["undershoot_mg_dl"])[result.feasible])
        yield gain, 100.0 * float(np.mean(lowest < LOW_MG_DL)), float(undershoot)


def main():
    measured = np.array(list(rows()))
    lines = [
        "| Of 30 records | Minimum | 5 % | Median | 95 % | Largest |",
        "| :--- | ---: | ---: | ---: | ---: | ---: |",
    ]
    names = ("Gain of the model, mg/dl per mU/min", "People below 60 mg/dl, %", "Median undershoot, mg/dl")
    for name, values, digits in zip(names, measured.T, (2, 1, 1), strict=True):
        shares = np.percentile(values, [0, 5, 50, 95, 100])
        lines.append(f"| {name} | {' | '.join(f'{share:.{digits}f}' for share in shares)} |")
    text = "\n".join(lines) + f"\n\nThe table was {made()}.\n"
    (Path(__file__).resolve().parent / "guide" / "records_figures.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
