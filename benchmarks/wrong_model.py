"""Control where the controller's model is wrong: every situation of the table in one compiled loop.

    python benchmarks/wrong_model.py                            the table, of the seeds that are reported
    python benchmarks/wrong_model.py --tuning                   the same of the seeds on which defaults are chosen
    python benchmarks/wrong_model.py --controller mpc-se        of another controller
    python benchmarks/wrong_model.py --set mean_carbs_g=20 --set noise_pace=0    of other settings, one table for each

Situations differ in the person, the meal, the stomach, the sensor, the pump and the setpoint. All of these are numbers,
so that one loop is compiled and all runs are its people. Undershoot is that below the setpoint of noise-free glucose at
the samples.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop._pytree import pytree
from glucoloop.config.trial import read_trial
from glucoloop.control.protocol import Decision, Observation
from glucoloop.episodes import once
from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.random_keys import keys_of_people
from glucoloop.meals import Eaten
from glucoloop.meals.lehmann_deutsch import LehmannDeutsch
from glucoloop.patients import SemilinearPatient
from glucoloop.patients.capabilities import rest_at
from glucoloop.patients.model import patient_model
from glucoloop.patients.population import Draw, VirtualPeople, population, virtual_people
from glucoloop.patients.sorensen.patient import SorensenPatient
from glucoloop.pumps import LimitedPump
from glucoloop.pumps.faults import battery_gap, occlusion
from glucoloop.sensors import CorrelatedNoise, IdealSensor, late, missing
from glucoloop.simulation.closed_loop import sample_grid
from glucoloop.simulation.cohort import Cohort, People

HORIZON_MIN, SAMPLE_MIN = 600.0, 5.0
MEALS = 3
"""Most meals of a run."""
NEVER = math.inf


@dataclass(frozen=True)
class Row:
    """A situation of the table."""

    name: str
    runs: int = 30
    people: str = "nominal"
    """The nominal person, people of ``parker2000``, or random ``corners`` of its ranges."""
    setpoint: float = 81.0
    meals: tuple[tuple[float, float, float], ...] = ((50.0, 50.0, 0.0),)
    """Carbohydrate in g, time in min, and time over which it is eaten, of each meal."""
    stomach: LehmannDeutsch = field(default_factory=LehmannDeutsch)
    variance: float = 0.0
    correlation: float = 0.0
    late: bool = False
    gap_min: tuple[float, float] | None = None
    """Beginning and length of a time without readings."""
    blocked: bool = False
    flat_battery: bool = False

    @property
    def told(self) -> tuple[float, float]:
        """Setpoint and noise variance for which the controller is designed: nobody tells of correlated noise."""
        return self.setpoint, 0.0 if self.variance == 0.0 else 1.45


_FIFTY, _NOTHING = ((50.0, 50.0, 0.0),), ()
_WHITE: dict[str, Any] = {"variance": 1.45}
_COLOURED: dict[str, Any] = {"variance": 9.0, "correlation": 0.7}
_STOMACHS = (
    ("slow", 180.0, 30.0, 60.0, _FIFTY),
    ("fast", 500.0, 10.0, 30.0, _FIFTY),
    ("slow gut", 360.0, 30.0, 120.0, _FIFTY),
    ("long ramp", 300.0, 60.0, 60.0, ((75.0, 50.0, 0.0),)),
    ("fast gut", 360.0, 30.0, 30.0, ((75.0, 50.0, 0.0),)),
    ("small", 250.0, 20.0, 40.0, ((5.0, 50.0, 0.0),)),
    ("large", 450.0, 45.0, 90.0, ((120.0, 50.0, 0.0),)),
    ("eaten slowly", 360.0, 30.0, 60.0, ((60.0, 50.0, 60.0),)),
    ("interrupted", 360.0, 30.0, 60.0, ((25.0, 50.0, 0.0), (35.0, 150.0, 0.0))),
    ("three courses", 500.0, 15.0, 45.0, ((15.0, 50.0, 0.0), (40.0, 80.0, 0.0), (20.0, 125.0, 0.0))),
)
"""Name; rate of emptying in mg/min, ramp in min and time constant of the gut in min; meals."""
_JUICE = LehmannDeutsch(ramp_min=15.0, gut_time_constant_min=30.0)


def rows() -> list[Row]:
    """The situations of the table."""
    setpoints = (80.0, 95.0, 110.0, 125.0, 140.0)
    people: dict[str, Any] = {"runs": 100, "people": "parker2000", **_WHITE}
    return [
        Row("50 g, no noise", 1),
        Row("fasting, no noise", 1, meals=_NOTHING),
        Row("50 g, white", **_WHITE),
        Row("fasting, white", meals=_NOTHING, **_WHITE),
        Row("50 g, correlated", **_COLOURED),
        Row("fasting, correlated", meals=_NOTHING, **_COLOURED),
        Row("15 g of juice, white", meals=((15.0, 50.0, 0.0),), stomach=_JUICE, **_WHITE),
        Row("hour without readings as a meal begins", gap_min=(60.0, 60.0), **_WHITE),
        Row("hour without readings within a meal", gap_min=(100.0, 60.0), **_WHITE),
        Row("hour without readings as a meal ends", gap_min=(190.0, 60.0), **_WHITE),
        Row("people, no fault", **people),
        Row("people, blocked line", blocked=True, **people),
        Row("people, battery gap", flat_battery=True, **people),
        Row("people, hour without readings", gap_min=(-1.0, 60.0), **people),
        Row("people, late 10 min, correlated", people="parker2000", late=True, **_COLOURED),
        Row("corners, late 10 min, correlated", people="corners", late=True, **_COLOURED),
        *(Row(f"setpoint {r:g}, fasting, no noise", 1, meals=_NOTHING, setpoint=r) for r in setpoints),
        *(Row(f"setpoint {r:g}, 50 g, no noise", 1, setpoint=r) for r in setpoints),
        *(
            Row(f"setpoint {r:g}, people fasting, no noise", 10, people="parker2000", meals=_NOTHING, setpoint=r)
            for r in (110.0, 140.0)
        ),
        *(Row(f"setpoint {r:g}, 50 g, white", 10, setpoint=r, **_WHITE) for r in (110.0, 140.0)),
        *(
            Row(
                f"stomach: {name}",
                10,
                meals=meals,
                stomach=LehmannDeutsch(plateau_mg_min=plateau, ramp_min=ramp, gut_time_constant_min=gut),
                **_WHITE,
            )
            for name, plateau, ramp, gut, meals in _STOMACHS
        ),
    ]


@pytree
class Digesting(SorensenPatient):
    """A person with a stomach and a gut of the person's own."""

    meal_model: LehmannDeutsch


@pytree
class Aiming:
    """A controller with a setpoint of its own, so that people of one loop may differ in it."""

    inner: Any
    setpoint_mg_dl: jax.Array

    def _at(self, observation: Observation) -> Observation:
        return dataclasses.replace(observation, setpoint_mg_dl=self.setpoint_mg_dl)

    def init(self, observation: Observation) -> Any:
        return self.inner.init(self._at(observation))

    def step(self, state: Any, observation: Observation) -> tuple[Any, Decision]:
        state, decision = self.inner.step(state, self._at(observation))
        return state, decision


@pytree
class NoFold:
    """A fold that computes nothing."""

    def init(self, glucose_mg_dl: jax.Array, insulin_mU_min: jax.Array) -> jax.Array:
        return jnp.zeros_like(glucose_mg_dl)

    def step(self, state: jax.Array, happened: Any, t_min: jax.Array) -> jax.Array:
        return state


def _nominal() -> Any:
    return read_trial({"controllers": ["mpc-se"], "operating_point": "setpoint-81"}).nominal


def drawn_people(row: Row, seed: int) -> VirtualPeople:
    """The people of a row, at rest at its setpoint."""
    table = population("parker2000")
    number = np.arange(row.runs)
    if row.people == "parker2000":
        return virtual_people(table, seed, number, setpoint_mg_dl=row.setpoint)
    model = patient_model("parker-1999")
    sides = np.random.default_rng(seed).choice([0.6, 1.4], size=(len(table.variations), row.runs))
    share = sides if row.people == "corners" else np.ones_like(sides)
    values = {v.parameter: model.nominal[v.parameter] * share[i] for i, v in enumerate(table.variations)}
    setpoint = np.full(row.runs, row.setpoint)
    basal, rest = map(np.asarray, rest_at(model.build(values, np.full(row.runs, np.nan), setpoint), setpoint))
    patient = model.build(values, basal, setpoint)
    return VirtualPeople("parker-1999", Draw(number, values), patient, basal, rest, np.isfinite(basal))


def _digesting(patient: SemilinearPatient, stomach: LehmannDeutsch, runs: int | None) -> Digesting:
    numbers = dataclasses.asdict(stomach)
    own = LehmannDeutsch(**{name: np.full(runs, n) if runs else n for name, n in numbers.items()})
    return Digesting(
        parameters=patient.parameters,
        basal_insulin_mU_min=patient.basal_insulin_mU_min,
        setpoint_mg_dl=patient.setpoint_mg_dl,
        meal_model=own,
    )


def _once(begin: np.ndarray, samples: float) -> Any:
    return dataclasses.replace(once(0, samples), earliest=jnp.asarray(begin), latest=jnp.asarray(begin))


def surroundings(variance: Any, correlation: Any, when: dict[str, Any]) -> tuple[Any, Any]:
    """Sensor and pump with every fault, each of which begins at its own sample or never."""
    sensor: Any = CorrelatedNoise(
        inner=IdealSensor(), variance=jnp.asarray(variance), correlation=jnp.asarray(correlation)
    )
    sensor = late(2, _once(when["late"], NEVER), sensor)
    sensor = missing(_once(when["gap"], 12.0), sensor)
    pump: Any = LimitedPump(limits=read_trial({"controllers": ["mpc-se"]}).limits)
    pump = battery_gap(_once(when["battery"], 12.0), pump)
    return sensor, occlusion(_once(when["blocked"], 24.0), pump)


def _joined(parts: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: np.concatenate([np.asarray(leaf) for leaf in leaves], axis=-1), *parts)


@dataclass
class Bench:
    """Loops of the rows, for any number of controllers of one structure."""

    table: list[Row]
    seed: int

    def __post_init__(self) -> None:
        drawn = [drawn_people(row, self.seed) for row in self.table]
        patients = []
        for row, people in zip(self.table, drawn, strict=True):
            whole = jax.tree.map(lambda leaf, n=row.runs: np.broadcast_to(leaf, n), people.patient)
            patients.append(_digesting(whole, row.stomach, row.runs))
        self.patient = _joined(patients)
        self.basal = np.concatenate([people.basal_insulin_mU_min for people in drawn])
        self.rest = np.concatenate([people.rest for people in drawn], axis=1)
        self.feasible = np.isfinite(self.basal)
        self.where = np.repeat(np.arange(len(self.table)), [row.runs for row in self.table])
        of = lambda name: np.asarray([getattr(self.table[i], name) for i in self.where])  # noqa: E731
        self.setpoint, self.variance, self.correlation = of("setpoint"), of("variance"), of("correlation")
        n = self.where.size
        onset = np.random.default_rng(self.seed + 1).integers(12, 61, n).astype(float)
        gaps = [self.table[i].gap_min for i in self.where]
        gap = [NEVER if g is None else (onset[k] if g[0] < 0.0 else g[0] / SAMPLE_MIN) for k, g in enumerate(gaps)]
        self.when = {
            "late": np.where(of("late"), 0.0, NEVER),
            "gap": np.asarray(gap),
            "battery": np.where(of("flat_battery"), onset, NEVER),
            "blocked": np.where(of("blocked"), onset, NEVER),
        }
        none = (0.0, 0.0, 0.0)
        plan = np.asarray([[*self.table[i].meals, *[none] * (MEALS - len(self.table[i].meals))] for i in self.where])
        self.meals = Eaten(t_min=plan[:, :, 1].T, carbs_g=plan[:, :, 0].T, eating_min=plan[:, :, 2].T)
        self.key = keys_of_people(self.seed, np.concatenate([np.arange(row.runs) for row in self.table]))

    @functools.cached_property
    def single(self) -> Any:
        return _digesting(_nominal(), LehmannDeutsch(), None)

    def controllers(self, design: Callable[[float, float], Any]) -> Any:
        """Controllers of all people, each designed for the setpoint and the noise of the row; numbers trail."""
        keys = sorted({row.told for row in self.table})
        each = [design(*key) for key in keys]
        which = np.asarray([keys.index(self.table[i].told) for i in self.where])

        def of_people(path: Any, *leaves: Any) -> Any:
            if ".plant" in jax.tree_util.keystr(path):  # the same for all, and a constant of the program
                return leaves[0]
            return jnp.asarray(np.moveaxis(np.stack([np.asarray(leaf) for leaf in leaves])[which], 0, -1))

        return with_basal(jax.tree_util.tree_map_with_path(of_people, *each), self.basal)

    def compiled(self, controller: Any, example: Any) -> Callable[[Any], Any]:
        """Function that runs all people under controllers of the same structure."""
        never = {name: NEVER for name in self.when}
        sensor, pump = surroundings(0.0, 0.0, never)
        many_sensor, many_pump = surroundings(self.variance, self.correlation, self.when)

        def aimed(inner: Any, setpoint: Any) -> Any:
            return Aiming(inner=inner, setpoint_mg_dl=jnp.asarray(setpoint))

        grid = sample_grid(HORIZON_MIN, SAMPLE_MIN)
        cohort = Cohort(
            self.single, self.patient, aimed(controller, 81.0), sensor, pump, grid, NoFold(),
            setpoint_mg_dl=81.0, meals=None,
            varied_controller=aimed(example, self.setpoint), varied_sensor=many_sensor, varied_pump=many_pump,
        )  # fmt: skip

        def run(own: Any) -> Any:
            basal, rest = np.where(self.feasible, self.basal, 20.0), np.where(self.feasible, self.rest, 1.0)
            people = People(
                patient=self.patient, x=rest, insulin_mU_min=basal, key=self.key,
                controller=aimed(own, self.setpoint), sensor=many_sensor, pump=many_pump, meals=self.meals,
            )  # fmt: skip
            return cohort.run(people, threads=2)

        return run

    def table_of(self, run: Any) -> dict[str, dict[str, float]]:
        """Numbers of each row."""
        glucose, insulin = np.asarray(run.glucose_mg_dl), np.asarray(run.insulin_mU_min)
        found = {}
        for i, row in enumerate(self.table):
            mine = (self.where == i) & self.feasible
            g, u = glucose[:, mine], insulin[:, mine]
            under = np.maximum(row.setpoint - g.min(axis=0), 0.0)
            late_g = g[-41:]
            found[row.name] = {
                "under": float(np.median(under)),
                "under95": float(np.percentile(under, 95)),
                "peak": float(np.median(g.max(axis=0)) - row.setpoint),
                "lowest": float(g.min()),
                "rest": float(np.mean(late_g) - row.setpoint),
                "swing": float(np.max(late_g.max(axis=0) - late_g.min(axis=0))),
                "variation": float(np.median(np.abs(np.diff(u[-41:], axis=0)).sum(axis=0))),
            }
        return found


_COLUMNS = {"under": "6.2f", "under95": "6.2f", "peak": "7.1f", "lowest": "7.1f", "rest": "7.2f", "swing": "7.2f"}
_COLUMNS["variation"] = "10.1f"


def show(found: dict[str, dict[str, float]], before: dict[str, dict[str, float]]) -> None:
    """Print the table, beside an earlier one if there is one."""
    head = " under  95 %   peak lowest   rest  swing variation"
    print(f"{'':40s}{head}{'   | before' if before else ''}")
    for name, numbers in found.items():
        told = [numbers, *([before[name]] if name in before else [])]
        line = "   |".join("".join(f"{of[key]:{form}}" for key, form in _COLUMNS.items()) for of in told)
        print(f"{name:40s}{line}")


def with_basal(controller: Any, basal: np.ndarray) -> Any:
    known = np.where(np.isfinite(basal), basal, 20.0)
    return controller.with_basal(jnp.asarray(known)) if hasattr(controller, "with_basal") else controller


def design_with(name: str, settings: dict[str, Any]) -> Callable[[float, float], Any]:
    """Function that designs a controller for a setpoint and a noise variance."""

    def design(setpoint: float, variance: float) -> Any:
        keys = {"controllers": [name], "operating_point": "setpoint-81", "noise_variance": variance, **settings}
        trial = read_trial(keys if setpoint == 81.0 else {**keys, "setpoint_mg_dl": setpoint})
        return controller_of(trial, trial.cases[0])

    return design


def alike(table: list[Row], design: Callable[[float, float], Any]) -> list[list[Row]]:
    """Rows in groups whose controllers have arrays of the same shapes; tunings differ where there is no noise."""
    groups: dict[Any, list[Row]] = {}
    for row in table:
        shapes = tuple(np.shape(leaf) for leaf in jax.tree_util.tree_leaves(design(*row.told)))
        groups.setdefault(shapes, []).append(row)
    return list(groups.values())


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


def _settings(text: str) -> dict[str, Any]:
    """Settings of a variant: ``noise_pace=0.2,doubt=1``."""
    return {key: _value(value) for key, value in (one.split("=", 1) for one in text.split(",") if one)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--controller", default="meal-mpc")
    parser.add_argument("--tuning", action="store_true", help="other people and noises, to choose defaults on")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE,...", help="a variant; may be repeated"
    )
    parser.add_argument("--rows", nargs="*", help="parts of the names of the rows")
    parser.add_argument("--out", type=Path, help="file for the numbers of the last variant")
    parser.add_argument("--beside", type=Path, help="file of earlier numbers")
    asked = parser.parse_args()
    start = time.perf_counter()
    table = [row for row in rows() if not asked.rows or any(part in row.name for part in asked.rows)]
    found: dict[str, dict[str, float]] = {}
    before = json.loads(asked.beside.read_text()) if asked.beside else {}
    runs: dict[tuple[str, ...], tuple[Bench, Callable[[Any], Any]]] = {}
    for text in asked.set or [""]:
        design = functools.cache(design_with(asked.controller, _settings(text)))
        found = {}
        for group in alike(table, design):
            names = tuple(row.name for row in group)
            bench = runs[names][0] if names in runs else Bench(group, 1000 if asked.tuning else 0)
            own = bench.controllers(design)
            if names not in runs:
                runs[names] = bench, bench.compiled(design(*group[0].told), own)
            found |= bench.table_of(runs[names][1](own))
        found = {row.name: found[row.name] for row in table}
        print(f"{text or 'defaults'}: {sum(row.runs for row in table)} loops, {time.perf_counter() - start:.0f} s")
        show(found, before)
        sys.stdout.flush()
        start = time.perf_counter()
    if asked.out:
        asked.out.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
