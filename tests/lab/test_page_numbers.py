"""What the page simulates is what glucoloop simulates: to the bit with the same functions, and closely as it runs."""

import dataclasses
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from glucoloop.config.run import read_run
from glucoloop.control.guard import Guard
from glucoloop.experiments.assemble import close_loop
from glucoloop.experiments.designs import with_guard
from glucoloop.experiments.surroundings import Surroundings
from glucoloop.identification import FirstOrderModel
from glucoloop.lab import build
from glucoloop.lab.numbers import numbers
from glucoloop.lab.pack import MODULE
from glucoloop.lab.parts import GUARDED, LONGEST_HORIZON, parts
from glucoloop.metrics import summarise
from glucoloop.models.state_space import LinearModel
from glucoloop.models.step_response import StepResponseModel
from glucoloop.native.targets.llvm.kernel import compile_kernel
from glucoloop.native.targets.products import STRICT
from glucoloop.native.targets.wasm.module import linker
from glucoloop.pumps import LimitedPump
from glucoloop.pumps.limits import PARKER_1999_LIMITS, DoseLimits
from glucoloop.registry.controllers import controller_entry
from glucoloop.sensors import dead_time, white_noise

LINEAR = ("Phi", "Gamma", "C", "insulin_mU_min", "glucose_mg_dl")
SENTENCE = "the page's module is not made of these definitions; make it anew: python -m glucoloop.lab.build"


class Kernel:
    """A function of the page, compiled for this processor, for situations side by side."""

    def __init__(self, part, people, samples=1):
        self.part, self.people, self.samples = part, people, samples
        self.kernel = compile_kernel(part.lowered, products=STRICT)
        columns, sizes = self.kernel.padded(people), self.kernel.sizes
        self.person = np.zeros((sizes["person"], columns))
        self.carry = np.zeros((sizes["carry"], columns))
        self.own = np.zeros((samples, sizes["own"], columns))
        self.shared = np.zeros((samples, sizes["shared"]))
        self.outputs = np.zeros((samples, sizes["outputs"], columns))

    def run(self):
        self.kernel.run(self.person, self.carry, self.own, self.shared, self.outputs)
        return self.outputs[..., : self.people]

    def fill(self, numbers):
        """Numbers of each person by name."""
        for column, of in enumerate(numbers):
            row = 0
            for name, count in self.part.names["person"].items():
                given = np.ravel(np.asarray(of.get(name, 0.0), float))[:count]
                self.person[row : row + given.size, column] = given
                row += count
        self.person[:, self.people :] = self.person[:, :1]


def moments_of(part, situations, samples):
    """Moments of the meals of each situation, ``(samples, numbers, situations)``."""
    total = np.zeros((samples, part.lowered.layout.sizes["outputs"], len(situations)))
    for column, situation in enumerate(situations):
        meals = situation["meals"]
        if not meals:
            continue
        kernel = Kernel(part, len(meals), samples)
        kernel.fill([{**meal, "eating_min": 0.0} for meal in meals])
        kernel.shared[:, 0] = 5.0 * np.arange(samples)
        found = kernel.run()
        for i in range(len(meals)):
            total[:, :, column] += found[:, :, i]
    return total


def portable(name, situations, answers, data, of_page):
    """Traces of situations of one controller by the same functions, on this processor."""
    n, samples = len(situations), round(situations[0]["duration_min"] / 5.0)
    start, step = (Kernel(of_page[f"{name}_{what}"], n) for what in ("start", "step"))
    plant, noise = (Kernel(of_page[what], n) for what in ("plant", "noise"))
    patients = [data["patients"][of["patient"]] for of in situations]
    numbers = [{k: np.nan if v is None else v for k, v in answer["numbers"].items()} for answer in answers]
    limits = {f"limits.{name}": value for name, value in data["limits"].items()}
    for kernel in (start, step):
        kernel.fill(numbers)
    plant.fill(
        [
            {**limits, "matrices": of["matrices"], **{f"patient.{i}": v for i, v in enumerate(of["numbers"])}}
            for of in patients
        ]
    )
    noise.fill([{"variance": of["noise_variance"], "bound_mg_dl": 5.0} for of in situations])
    glucose, delivered, setpoint = (
        np.array([of[name] for of in patients]) for name in ("glucose_mg_dl", "basal_insulin_mU_min", "setpoint_mg_dl")
    )
    late = round(situations[0]["dead_time_min"] / 5.0)
    line, moments = [glucose] * late, moments_of(of_page["meal"], situations, samples)
    noisy = np.array([of["noise_variance"] > 0.0 for of in situations])

    def read(glucose, k):
        noise.own[0, :, :n] = glucose, [data["normals"][of["seed"]][k] for of in situations]
        return np.where(noisy, noise.run()[0, 0], glucose)

    def observed(kernel, reading):
        kernel.own[0, :, :n] = reading, np.isfinite(reading), setpoint, delivered, 0.0 * reading
        return kernel.run()[0].copy()

    step.carry[:, :n] = observed(start, line[0] if late else read(glucose, 0))
    place = np.cumsum([0, *plant.part.names["carry"].values()])
    for name, at in zip(plant.part.names["carry"], place, strict=False):
        rows = np.array([of["x"] for of in patients]).T if name == "x" else delivered[None]
        plant.carry[at : at + rows.shape[0], :n] = rows
    outputs = dict(
        zip(plant.part.names["outputs"], np.cumsum([0, *plant.part.names["outputs"].values()]), strict=False)
    )
    kept = {name: [] for name in ("glucose_mg_dl", "reading_mg_dl", "command_mU_min", "insulin_mU_min", "status")}
    for k in range(samples):
        line.append(read(glucose, k))
        reading = line.pop(0)
        command, status = observed(step, reading)
        plant.own[0, :, :n] = np.concatenate([command[None], moments[k]])
        after = plant.run()[0].copy()
        insulin = after[outputs["delivered_mU_min"]]
        for name, value in zip(kept, (glucose, reading, command, insulin, status), strict=True):
            kept[name].append(value)
        glucose, delivered = after[outputs["glucose_mg_dl"]], after[outputs["reported_mU_min"]]
    return {name: np.array(values) for name, values in kept.items()}


@pytest.fixture(scope="session")
def answers(corpus, in_node):
    found = in_node(corpus)
    assert len(found) >= 200
    refused = [answer["refused"] for answer in found if "refused" in answer]
    assert not refused
    return found


def groups(corpus):
    """Numbers of the situations of each controller, guarded or not."""
    found = {}
    for i, situation in enumerate(corpus):
        found.setdefault((situation["controller"], situation["guard"]), []).append(i)
    return found


@pytest.fixture(scope="session")
def of_page():
    """The functions of the page, lowered now."""
    return parts()


@pytest.mark.long
def test_the_page_has_the_bits_of_portable_arithmetic(corpus, answers, data, of_page):
    for (name, guard), here in groups(corpus).items():
        asked = [answers[i] for i in here]
        function = f"{name.replace('-', '_')}{GUARDED if guard else ''}"
        found = portable(function, [answer["situation"] for answer in asked], asked, data, of_page)
        for key, values in found.items():
            expected = np.array([answer["trace"][key] for answer in asked], float).T
            np.testing.assert_array_equal(values, expected, err_msg=f"{function}, {key}: {SENTENCE}")


@pytest.mark.long
def test_the_package_data_are_those_that_would_be_built_now(data, of_page):
    assert data["functions"] == build.functions(of_page), SENTENCE
    if linker() is None or build.tools() != data["tools"]:
        pytest.skip(f"the module was built with {data['tools']}, which are not here")
    assert build.module(of_page) == MODULE.read_bytes(), SENTENCE


@pytest.mark.long
def test_the_numbers_of_the_page_are_those_of_the_patients_now(data):
    """Other processors and compilers of JAX round otherwise, and a fit stops a little elsewhere."""
    for name, value in json.loads(json.dumps(numbers())).items():
        assert close(value, data[name]), f"{name}: {SENTENCE}"


def close(found, expected):
    if isinstance(expected, dict):
        return found.keys() == expected.keys() and all(close(found[key], expected[key]) for key in expected)
    if isinstance(expected, list):
        same_kind = len(found) == len(expected)
        if not same_kind or not expected or isinstance(expected[0], dict):
            return same_kind and all(map(close, found, expected))
        a, b = (np.array(of, float) for of in (found, expected))
        return a.shape == b.shape and np.allclose(a, b, rtol=1e-6, atol=1e-7 * np.abs(b).max())
    if isinstance(expected, float):
        return bool(np.isclose(found, expected, rtol=1e-6, atol=1e-12))
    return found == expected


@pytest.fixture(scope="session")
def runs(corpus, answers):
    """Each situation as `glucoloop run` reads it from the file that the page offers."""
    keys = [tomllib.loads(answer["toml"]) for answer in answers]
    assert {of.pop("glucoloop") for of in keys} == {"1.2.3"}
    found = [read_run(of) for of in keys]
    for run, situation in zip(found, corpus, strict=True):
        asked = run.situation
        assert (run.case.controller, run.case.guard) == (situation["controller"], situation["guard"])
        assert (asked.operating_point, asked.seed) == (situation["patient"], situation["seed"])
        assert (asked.noise_variance, asked.dead_time_min) == (situation["noise_variance"], situation["dead_time_min"])
        assert sorted((meal.t_min, meal.carbs_g) for meal in asked.eaten()) == sorted(
            (meal["t_min"], meal["carbs_g"]) for meal in situation["meals"]
        )
        assert situation["tuning"].items() <= dict(run.case.tuning).items()
    return found


@dataclass(frozen=True)
class OnModelsOfThePage:
    """What a controller is designed on, from the numbers that the page has; a `DesignCase`."""

    data: Mapping[str, Any]
    controller: str
    limits: DoseLimits = PARKER_1999_LIMITS
    sample_time_min: float = 5.0
    noise_variance: float = 0.0
    dead_time_samples: int = 0

    @property
    def basal_insulin_mU_min(self):
        return self.data["basal_insulin_mU_min"]

    @property
    def identified(self):
        return StepResponseModel(step_response=jnp.asarray(self.data["step_response"]), sample_time_min=5.0)

    def linearised(self):
        linear = {name: jnp.asarray(value) for name, value in self.data["linear"].items() if name in LINEAR}
        return LinearModel(**linear, state=jnp.asarray(self.data["x"]), sample_time_min=5.0)

    def first_order(self, step_mU_min, delay_min=None):
        return FirstOrderModel(**self.data["first_order"][self.controller], residual_rms_mg_dl=jnp.zeros(()))

    def process_noise(self, *variances):
        return np.array(variances)[self.data["linear"]["noise_kinds"]]


@pytest.fixture(scope="session")
def designed(runs, data):
    """The controller of each run, as glucoloop designs it on the page's models."""
    found = []
    for run in runs:
        entry = controller_entry(run.case.controller)
        case = OnModelsOfThePage(data["patients"][run.situation.operating_point], run.case.controller)
        bare = entry.designer()(case, entry.values(run.case.tuning))
        found.append(with_guard(bare, run.case.case().guard, PARKER_1999_LIMITS))
    return found


def named(controller):
    leaves = jax.tree_util.tree_leaves_with_path(controller)
    return {jax.tree_util.keystr(path, simple=True, separator="."): np.ravel(np.asarray(leaf)) for path, leaf in leaves}


@pytest.mark.long
def test_the_page_designs_the_controllers_of_glucoloop(answers, designed):
    for answer, controller in zip(answers, designed, strict=True):
        expected, numbers = named(controller), answer["numbers"]
        for name, value in expected.items():
            if name.endswith(("plan.hessian", "plan.gradient")):
                continue  # which a step in closed form does not use
            found = np.ravel(np.asarray(numbers[name], float))[: value.size]
            np.testing.assert_allclose(
                found, value, rtol=1e-9, atol=1e-9 * np.abs(value).max(), err_msg=f"{name}: {answer['command']}"
            )


def padded(controller):
    """The same controller with room for the horizons of all, so that one compiled loop serves them."""
    if isinstance(controller, Guard):
        return dataclasses.replace(controller, inner=padded(controller.inner))
    return controller.padded(8, LONGEST_HORIZON) if hasattr(controller, "padded") else controller


def by_glucoloop(run, controller, moved_mg_dl=0.0):
    """A run on this processor with JAX; the patient may begin a little off the setpoint."""
    around = run.situation.situation()
    # Noise of no variance is no noise, and one compiled loop serves both.
    sensor = white_noise(around.noise_variance, around.noise_bound_mg_dl)
    sensor = dead_time(around.dead_time_samples, sensor) if around.dead_time_samples else sensor
    surroundings = Surroundings(sensor=sensor, pump=LimitedPump(limits=around.limits))
    begins = around.target_mg_dl + moved_mg_dl if moved_mg_dl else None
    scenario = dataclasses.replace(run.situation.scenario(), initial_glucose_mg_dl=begins)
    return close_loop(around, padded(controller), scenario, around=surroundings)


@pytest.mark.long
def test_the_page_is_glucoloop_within_two_hundredths_of_a_mg_dl(answers, runs, designed):
    """But for a few loops in which rounding decides.

    A guard believes no reading that stays the same to its last digit. Without noise, a person at rest has such readings
    or not by the last digit, and glucoloop's own run changes as much when it begins 1e-12 mg/dl off the setpoint.
    """
    decided_by_rounding = 0
    for answer, run, controller in zip(answers, runs, designed, strict=True):
        trace = by_glucoloop(run, controller)
        expected = np.asarray(trace.fine_glucose_mg_dl)
        found = np.asarray(answer["trace"]["fine_glucose_mg_dl"], float)
        difference = np.abs(found - expected).max()
        if difference > 0.02:
            assert run.case.guard, answer["command"]
            assert run.situation.noise_variance == 0.0, answer["command"]
            moved = [by_glucoloop(run, controller, by) for by in (1e-12, -1e-12, 3e-12, -3e-12)]
            own = max(np.abs(np.asarray(other.fine_glucose_mg_dl) - expected).max() for other in moved)
            print(f"{difference:.3g} mg/dl, of itself {own:.3g}: {answer['command']}")
            assert difference <= 2.0 * own, answer["command"]
            decided_by_rounding += 1
            continue
        metrics = summarise(trace)
        for name, value in answer["summary"].items():
            np.testing.assert_allclose(value, float(getattr(metrics, name)), rtol=2e-3, atol=0.35, err_msg=name)
    assert decided_by_rounding <= len(answers) // 50
