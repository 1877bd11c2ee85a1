"""Controllers of glucoloop in the environment of simglucose 0.2.11, beside its own basal-bolus controller.

People, sensor (GuardianRT, 5 min), pump (Insulet) and random meals are simglucose's; of this package there is nothing
in the loop but the controller, which is handed readings, announced carbohydrate and what the pump gave. See README.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import itertools
import json
import logging
import types
import warnings
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.build.designs import controller_of
from glucoloop.control import Controller, Observation
from glucoloop.control.protocol import gives_boluses
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured
from glucoloop.therapy import Profile, given_profile
from glucoloop.units import MIN_PER_DAY, MU_PER_U

OWN: Final = "simglucose's basal-bolus"
CONTROLLERS: Final = ("basal-bolus", "oref0", "loop-like", "profile-mpc")
GROUPS: Final = ("adult", "adolescent")
SEEDS: Final = (100, 300, 400)
PEOPLE: Final = 10
_PMOL_PER_U: Final = 6000.0
_SENSOR: Final = "GuardianRT"
_PUMP: Final = "Insulet"


@dataclasses.dataclass(frozen=True)
class Day:
    """Result of one person under one controller: percentages of the time, and extreme glucose."""

    controller: str
    person: str
    seed: int
    in_range_pct: float
    below_70_pct: float
    lowest_mg_dl: float
    highest_mg_dl: float
    insulin_U_day: float


def _of(module: str, name: str) -> Any:
    return getattr(importlib.import_module(f"simglucose.{module}"), name)


def environment(person: str, seed: int) -> Any:
    """Environment of a person, begun; its numbers are plain ones, with which it is several times faster."""
    patient = _of("patient.t1dpatient", "T1DPatient").withName(person)
    equations = patient.model
    patient.model = lambda t, x, *inputs: equations(t, x.tolist(), *inputs)
    sensor = _of("sensor.cgm", "CGMSensor").withName(_SENSOR, seed=seed)
    pump = _of("actuator.pump", "InsulinPump").withName(_PUMP)
    scenario = _of("simulation.scenario_gen", "RandomScenario")(start_time=datetime(2024, 1, 1), seed=seed)
    result = _of("simulation.env", "T1DSimEnv")(patient, sensor, pump, scenario)
    result.reset()
    patient._params = types.SimpleNamespace(**patient._params.to_dict())
    sensor._params, pump._params = sensor._params.to_dict(), pump._params.to_dict()
    return result


def profile(person: str, target_mg_dl: float) -> Profile:
    """Profile of a person from simglucose's tables, with the basal rate of its own controller."""
    own = _of("controller.basal_bolus_ctrller", "BBController")()
    quest = own.quest[own.quest.Name == person].squeeze()
    params = own.patient_params[own.patient_params.Name == person].squeeze()
    return Profile(
        basal_mU_min=MU_PER_U * float(params.u2ss) * float(params.BW) / _PMOL_PER_U,
        setpoint_mg_dl=target_mg_dl,
        carb_ratio_g_U=float(quest.CR),
        correction_mg_dl_U=float(quest.CF),
        weight_kg=float(params.BW),
        total_daily_dose_U=float(quest.TDI),
    )


class Adapter:
    """A controller of this package with the protocol of simglucose: readings to insulin in U/min."""

    def __init__(self, controller: Controller, target_mg_dl: float, basal_mU_min: float, *, announced: bool) -> None:
        self._controller, self._target, self._announced = controller, target_mg_dl, announced
        self._rate, self._bolus, self._state = basal_mU_min, 0.0, None

    def policy(self, env: Any, reading: float, meal_g: float) -> Any:
        """Action at a sample; the rates that the pump makes of it are reported at the next."""
        observation = Observation(
            glucose_mg_dl=jnp.asarray(float(reading)),
            valid=jnp.asarray(True),
            setpoint_mg_dl=jnp.asarray(self._target),
            delivered_mU_min=jnp.asarray(self._rate),
            announced_carbs_g=jnp.asarray(meal_g if self._announced else 0.0),
            delivered_bolus_mU=jnp.asarray(self._bolus) if gives_boluses(self._controller) else None,
        )
        if self._state is None:
            self._state = _init(self._controller, observation)
        self._state, decision = _step(self._controller, self._state, observation)
        every = float(env.sample_time)
        bolus = 0.0 if decision.bolus_mU is None else float(decision.bolus_mU)
        basal, extra = float(decision.insulin_mU_min) / MU_PER_U, bolus / MU_PER_U / every
        self._rate = MU_PER_U * float(env.pump.basal(basal))
        self._bolus = MU_PER_U * every * float(env.pump.bolus(extra))
        return _of("controller.base", "Action")(basal=basal, bolus=extra)


@jax.jit
def _init(controller: Controller, observation: Observation) -> Any:
    return controller.init(observation)


@jax.jit
def _step(controller: Controller, state: Any, observation: Observation) -> Any:
    return controller.step(state, observation)


def _no_reward(glucose_mg_dl: list[float]) -> float:
    """Reward of which nobody asks; simglucose's own takes a third of its time."""
    return 0.0


def lived(env: Any, days: float, policy: Any) -> Iterator[float]:
    """Insulin [U] of each sample of some days; they end early where simglucose calls them done."""
    reading, info = env.CGM_hist[-1], {"meal": 0.0, "sample_time": env.sample_time, "patient_name": env.patient.name}
    for _ in range(round(days * MIN_PER_DAY / env.sample_time)):
        step = env.step(policy(env, reading, info), reward_fun=_no_reward)
        reading, info = step.observation.CGM, step.info
        yield env.insulin_hist[-1] * env.sample_time
        if step.done:
            return


def result_of(controller: str, person: str, seed: int, days: float, options: argparse.Namespace) -> Day:
    """Days of a person under a controller of this package, or simglucose's own."""
    env = environment(person, seed)
    if controller == OWN:
        own = _of("controller.basal_bolus_ctrller", "BBController")()
        observation = _of("simulation.env", "Observation")

        def policy(env: Any, reading: float, info: Any) -> Any:
            return own.policy(observation(CGM=reading), 0.0, False, **info)

    else:
        person_profile = profile(person, options.target)
        designed = options.designed[controller]
        adapter = Adapter(
            given_profile(designed, jax.tree.map(jnp.asarray, person_profile)),
            options.target,
            float(person_profile.basal_mU_min),
            announced=not options.unannounced,
        )

        def policy(env: Any, reading: float, info: Any) -> Any:
            return adapter.policy(env, reading, float(info["meal"]) * float(env.sample_time))

    insulin = sum(lived(env, days, policy))
    glucose = np.asarray(env.BG_hist[1:], float)
    return Day(
        controller=controller,
        person=person,
        seed=seed,
        in_range_pct=100.0 * float(np.mean((glucose >= 70.0) & (glucose <= 180.0))),
        below_70_pct=100.0 * float(np.mean(glucose < 70.0)),
        lowest_mg_dl=float(glucose.min()),
        highest_mg_dl=float(glucose.max()),
        insulin_U_day=float(insulin) / days,
    )


def table(rows: list[Day], groups: list[str], seeds: list[int]) -> Iterator[str]:
    """Lines of a table in Markdown: mean over people of each seed, and the mean over seeds."""
    yield "| Group | Controller | 70 to 180 % | Below 70 % | Ever below 54, of 10 | U a day | Lowest |"
    yield "| :--- | :--- | ---: | ---: | ---: | ---: | ---: |"
    for group in groups:
        for controller in dict.fromkeys(row.controller for row in rows):
            chosen = [row for row in rows if row.controller == controller and row.person.startswith(group)]
            if not chosen:
                continue
            below = [sum(row.lowest_mg_dl < 54.0 for row in chosen if row.seed == seed) for seed in seeds]
            numbers = [np.mean([getattr(row, name) for row in chosen]) for name in ("in_range_pct", "below_70_pct")]
            insulin = np.mean([row.insulin_U_day for row in chosen])
            lowest = min(row.lowest_mg_dl for row in chosen)
            yield (
                f"| {group} | {controller} | {numbers[0]:.1f} | {numbers[1]:.1f} | {', '.join(map(str, below))} | "
                f"{insulin:.1f} | {lowest:.0f} |"
            )


def main() -> None:
    """Run the comparison, and print its table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--controller", action="append", help="controller as in --controller of glucoloop run")
    parser.add_argument("--patient", default="hovorka-2004", help="patient on whose equations controllers are designed")
    parser.add_argument("--group", action="append", choices=("adult", "adolescent", "child"))
    parser.add_argument("--seed", action="append", type=int)
    parser.add_argument("--people", type=int, default=PEOPLE)
    parser.add_argument("--days", type=float, default=3.0)
    parser.add_argument("--target", type=float, default=120.0, help="setpoint of the controllers, mg/dl")
    parser.add_argument("--unannounced", action="store_true", help="tell the controllers of this package of no meal")
    parser.add_argument("--json", type=Path, help="file of the results of each person, one in a line")
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    warnings.filterwarnings("ignore")
    controllers = options.controller or list(CONTROLLERS)
    groups, seeds = options.group or list(GROUPS), options.seed or list(SEEDS)
    options.designed = {}
    for text in controllers:
        run = configured(Run, patient=options.patient, controller=text, announce_meals=not options.unannounced)
        options.designed[text] = controller_of(run, run.case)
    rows = []
    for seed, controller, group, number in itertools.product(
        seeds, (OWN, *controllers), groups, range(1, options.people + 1)
    ):
        rows.append(result_of(controller, f"{group}#{number:03d}", seed, options.days, options))
        if options.json is not None:
            with options.json.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(dataclasses.asdict(rows[-1])) + "\n")
    print("\n".join(table(rows, groups, seeds)))


if __name__ == "__main__":
    main()
