"""Situations of the laboratory, simulated in Python by the functions of the page."""

import dataclasses
import tomllib
import weakref

import jax
import jax.numpy as jnp
import numpy as np

from glucoloop.arguments import random_key
from glucoloop.control.protocol import Observation
from glucoloop.lab.build import _GUARDED
from glucoloop.lab.device_functions import _around, _fault_functions, _fault_name, _Passed
from glucoloop.lab.patient_functions import SAMPLE_TIME_MIN
from glucoloop.native.interpreter import Interpreter
from glucoloop.situations.run import Run
from glucoloop.situations.situation import configured

OBSERVED = [field.name for field in dataclasses.fields(Observation)][:5]
"""What the page shows to a controller without boluses."""
NO_DRAW = 0.5
"""What stands for the draw of an onset that is given."""
OF_PUMP = 0x50554D50
"""Number by which `simulation.loop` sets the pump's draws apart."""
TRACED = ("glucose_mg_dl", "reading_mg_dl", "command_mU_min", "insulin_mU_min", "status")


def run_of(text):
    """The run of a configuration file that the page wrote as version 1.2.3."""
    keys = tomllib.loads(text)
    assert keys.pop("glucoloop") == "1.2.3"
    return configured(Run, keys)


def kept(make):
    """The same function for the same part, which is made once."""
    made = weakref.WeakKeyDictionary()

    def of(part):
        if part.lowered not in made:
            made[part.lowered] = make(part)
        return made[part.lowered]

    return of


@kept
def portable(part):
    """A function with portable arithmetic, by the interpreter of scalar programs."""
    interpreter = Interpreter(part.lowered)

    def of(person, carry, own, shared=None):
        groups = {"person": person, "carry": carry, "own": own, "shared": shared}
        return interpreter(**{name: rows for name, rows in groups.items() if rows is not None and len(rows)})

    return of


@kept
def by_jax(part):
    """A function with the arithmetic of JAX, which is that of a run."""
    shapes = part.lowered.shapes

    def tree(shape, numbers):
        leaves, structure = jax.tree.flatten(shape)
        ends = np.cumsum([leaf.size for leaf in leaves])
        own = zip(jnp.split(numbers, ends[:-1]) if leaves else [], leaves, strict=True)
        parts = [part.reshape(leaf.shape).astype(leaf.dtype) for part, leaf in own]
        return jax.tree.unflatten(structure, parts)

    def flat(tree):
        leaves = [jnp.ravel(leaf).astype(float) for leaf in jax.tree.leaves(tree)]
        return jnp.concatenate(leaves) if leaves else jnp.zeros(0)

    def of_one(*groups):
        given = map(tree, (shapes.person, shapes.carry, shapes.own, shapes.shared), groups)
        return tuple(map(flat, part.step(*given, jax.random.key(0))))

    compiled = jax.jit(jax.vmap(of_one, in_axes=-1, out_axes=-1))

    def of(person, carry, own, shared=None):
        return tuple(map(np.asarray, compiled(person, carry, own, own[:0] if shared is None else shared)))

    return of


def rows_of(fields, given):
    """Numbers by name in the order in which a function takes them; zero where none are given."""
    rows = []
    for name, count in fields.items():
        own = np.zeros(count)
        told = np.ravel(np.asarray(given.get(name, 0.0), float))[:count]
        own[: told.size] = told
        rows.append(own)
    return np.concatenate(rows) if rows else np.zeros(0)


def numbers_of(tree):
    """Numbers of a tree, leaf by leaf."""
    leaves = [np.ravel(np.asarray(leaf)).astype(float) for leaf in jax.tree.leaves(tree)]
    return np.concatenate(leaves) if leaves else np.zeros(0)


def side_by_side(each):
    """Arrays of people with the people trailing."""
    return np.stack(list(each), axis=-1)


def meal_moments(part, situations, patients, step_min, steps):
    """Moments of the meals of each situation, which superpose, ``(steps of the integrator, 3, situations)``."""
    starts, moments = step_min * np.arange(steps), Interpreter(part.lowered)
    total = np.zeros((steps, 3, len(situations)))
    for i, (situation, patient) in enumerate(zip(situations, patients, strict=True)):
        gut = {f"gut.{place}": number for place, number in enumerate(patient["gut"])}
        for meal in situation["meals"]:
            total[:, :, i] += moments(person=meal_at(part, meal, steps, gut), shared=starts[None])[1].T
    return total


def meal_at(part, meal, times, gut):
    """Numbers of a function of one meal, for many times beside one another."""
    person = rows_of(part.names["person"], {**gut, **{f"meal.{name}": value for name, value in meal.items()}})
    return np.repeat(person[:, None], times, axis=1)


def drawn_of(part, key):
    """Numbers that a part draws with a key, by JAX."""
    return jnp.concatenate([jnp.zeros(0), *(jnp.ravel(drawn) for drawn in part.lowered.drawing(key))])


class Loops:
    """Situations of one family and one controller, guarded or not.

    Parameters
    ----------
    parts : mapping
        Functions of the page.
    data : mapping
        Data of the page.
    situations, answers : sequence
        Situations, and what the page answered to each.
    around : sequence of Surroundings
        Sensor and pump of each, all with the same faults around them.
    faults : sequence of Fault
        One example of each fault, the first innermost.
    """

    def __init__(self, parts, data, situations, answers, around, faults):
        # The page has one function for all late readings, glucoloop one for each delay and choice.
        apart = (_fault_functions(fault) for fault in faults if fault.name in ("late", "out-of-order"))
        self.parts = {**parts, **{name: part for of in apart for name, part in of.items()}}
        self.situations, parts = situations, self.parts
        keys = [jax.random.split(random_key(of["seed"])) for of in situations]
        self.start_function, self.keys = [key[0] for key in keys], [key[1] for key in keys]
        patients = [data["patients"][situation["patient"]] for situation in situations]
        family, first = patients[0]["family"], situations[0]
        program = data["families"][family]["controllers"][first["controller"]]["program"]
        self.controller = program + (_GUARDED if first["guard"] else "")
        self.family = family.replace("-", "_")
        self.samples = round(first["duration_min"] / SAMPLE_TIME_MIN)
        self.late = round(first["dead_time_min"] / SAMPLE_TIME_MIN)
        takes = parts[f"{self.controller}_step"].names["person"]
        numbers = [{k: np.nan if v is None else v for k, v in answer["numbers"].items()} for answer in answers]
        self.of_controller = side_by_side(rows_of(takes, of) for of in numbers)
        self.of_plant = side_by_side(numbers_of([*of["matrices"], *of["numbers"]]) for of in patients)
        self.sensors = list(self.sensors_of([answer["sensors"] for answer in answers]))
        self.step_min, self.inside = (data["families"][family][name] for name in ("step_min", "inside"))
        self.steps = round(SAMPLE_TIME_MIN / self.step_min)
        moments = meal_moments(
            parts[f"{self.family}_meal"], situations, patients, self.step_min, self.samples * self.steps
        )
        self.moments = moments.reshape(self.samples, self.steps, 3, -1)
        sensors = [of.sensor for of in around]
        self.faults = []
        for fault in reversed([fault for fault in faults if fault.part == "sensor"]):
            alone = [_around(of, _Passed(valid=jnp.asarray(True))) for of in sensors]
            self.faults.insert(0, (_fault_name(fault), side_by_side(map(numbers_of, alone))))
            sensors = [of.inner for of in sensors]
        of_pump = [fault for fault in faults if fault.part == "pump"]
        self.pump = _fault_name(of_pump[0]) if of_pump else "pump"
        self.of_pump = side_by_side(numbers_of(of.pump) for of in around)
        self.x = side_by_side(of["x"] for of in patients)
        self.glucose = np.array([of["glucose_mg_dl"] for of in patients])
        self.basal = np.array([of["basal_insulin_mU_min"] for of in patients])
        self.setpoint = np.array([of["setpoint_mg_dl"] for of in patients])

    def sensors_of(self, chains):
        """Functions of the sensor with numbers of people, and what is drawn at the start and at each sample.

        The page draws it by a function of its own, with bits that JAX does not have on every processor.
        """
        silent = {"name": "sensor_white_noise", "numbers": {"bound_mg_dl": 5.0}, "start": [], "samples": []}
        chains = [chain or [silent] for chain in chains]
        for of_people in zip(*chains, strict=True):
            [name] = {of["name"] for of in of_people}
            part = self.parts[name]
            numbers = [
                {place: np.nan if number is None else number for place, number in of["numbers"].items()}
                for of in of_people
            ]
            people = side_by_side(rows_of(part.names["person"], of) for of in numbers)
            begun = side_by_side(drawn_of(self.parts[f"{name}_start"], key) for key in self.start_function)
            by_jax = begun, self.draws(part, self.keys)
            drawn = []
            for expected, place in zip(by_jax, ("start", "samples"), strict=True):
                found = expected.copy()
                for i, of in enumerate(of_people):
                    if of[place]:
                        found[..., i] = np.reshape(of[place], found.shape[:-1])
                np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
                drawn.append(found)
            yield name, people, *drawn

    def draws(self, part, keys):
        """Numbers that a part draws at each sample, ``(samples, numbers, situations)``."""
        samples = jnp.arange(self.samples)
        each = [jax.vmap(lambda k, key=key: drawn_of(part, jax.random.fold_in(key, k)))(samples) for key in keys]
        return np.stack([np.asarray(numbers) for numbers in each], axis=-1)

    def samples_of(self, made, moved):
        """Generator that asks for the patients after each step, and returns the trace; see `traces_of`."""
        parts = self.parts
        wake, decide = portable(parts[f"{self.controller}_start"]), made(parts[f"{self.controller}_step"])
        pump = portable(parts[self.pump])
        waking = [portable(parts[f"{name}_start"]) for name, _ in self.faults]
        faulty = [portable(parts[name]) for name, _ in self.faults]
        sensing = [(portable(parts[f"{name}_start"]), portable(parts[name]), *rest) for name, *rest in self.sensors]
        draw = np.full(self.basal.size, NO_DRAW)
        draws = [self.draws(parts[name], self.keys) for name, _ in self.faults]
        pulses = self.draws(parts[self.pump], [jax.random.fold_in(key, OF_PUMP) for key in self.keys])
        x, glucose, reported = self.x * (1.0 + moved), self.glucose * (1.0 + moved), self.basal

        def awake():
            found = [begin(people, None, np.array([glucose, *drawn]))[1] for begin, _, people, drawn, _ in sensing]
            for (name, numbers), begin in zip(self.faults, waking, strict=True):
                drawn = [draw] if "drawn" in parts[f"{name}_start"].names["own"] else []
                found.append(begin(numbers, None, np.array([glucose, *drawn]))[1])
            return found

        def read(k, states, line):
            reading, valid, after = glucose, np.ones_like(glucose), []
            for (_, show, people, _, drawn), state in zip(sensing, states[: len(sensing)], strict=True):
                state, (reading, valid) = show(people, state, np.array([reading, valid, *drawn[k]]))
                after.append(state)
            line = [*line, (reading, valid)]
            reading, valid = line[0]
            of_faults = zip(self.faults, faulty, states[len(sensing) :], draws, strict=True)
            for (_, numbers), show, state, drawn in of_faults:
                state, (reading, valid) = show(numbers, state, np.array([reading, valid, *drawn[k]]))
                after.append(state)
            return after, line[1:], reading, valid

        def observed(reading, valid):
            told = dict(zip(OBSERVED, (reading, valid, self.setpoint, reported, np.zeros_like(reading)), strict=True))
            return np.array([told[name] for name in parts[f"{self.controller}_step"].names["own"]])

        line = [(glucose, np.ones_like(glucose))] * self.late
        _, _, *first = read(0, awake(), line)
        _, memory = wake(self.of_controller, None, observed(*first))
        states = awake()
        start = parts[f"{self.pump}_start"]
        own = np.array([reported, *([draw] if "drawn" in start.names["own"] else [])])
        _, in_pump = portable(start)(self.of_pump, None, own)
        trace = {name: [] for name in (*TRACED, "inside_mg_dl")}
        for k in range(self.samples):
            states, line, reading, valid = read(k, states, line)
            memory, decision = decide(self.of_controller, memory, observed(reading, valid))
            decided = dict(zip(parts[f"{self.controller}_step"].names["outputs"], decision, strict=True))
            asked = {"bolus_mU": np.zeros_like(reading), **decided}
            own = [asked[name] for name in parts[self.pump].names["own"] if name != "drawn"]
            in_pump, delivered = pump(self.of_pump, in_pump, np.array([*own, *pulses[k]]))
            given = dict(zip(parts[self.pump].names["outputs"], delivered, strict=True))
            insulin, reported = given["infused_mU_min"], given["reported_mU_min"]
            happened = [glucose, reading, decided["insulin_mU_min"], given["insulin_mU_min"], given["status"]]
            inside = []
            for step, moments in enumerate(self.moments[k]):
                x, outputs = yield x, np.concatenate([insulin[None], moments])
                inside += [outputs[1 + place] for at, place in self.inside if at == step]
            glucose = outputs[0]
            for name, value in zip(trace, [*happened, np.array(inside)], strict=True):
                trace[name].append(value)
        return {name: np.array(values) for name, values in trace.items()}


def traces_of(loops, made=portable, moved=0.0):
    """Simulate loops side by side, so that the patients of a family are advanced together.

    Parameters
    ----------
    loops : sequence of Loops
    made : callable
        Arithmetic of the patient and the controller at each sample: `portable` or `by_jax`.
    moved : float
        Relative change of the state with which the patient begins.

    Returns
    -------
    list of dict
        Trace of each by name ``(samples, situations)``, with ``inside_mg_dl`` between.
    """
    families = {}
    for i, of in enumerate(loops):
        families.setdefault(of.family, []).append(i)
    plants = {
        family: (made(loops[here[0]].parts[f"{family}_plant"]), np.hstack([loops[i].of_plant for i in here]))
        for family, here in families.items()
    }
    going = [of.samples_of(made, moved) for of in loops]
    asked, traces = [next(of) for of in going], [None] * len(loops)
    while None in traces:
        for family, here in families.items():
            plant, people = plants[family]
            ends = np.cumsum([asked[i][0].shape[1] for i in here])[:-1]
            found = plant(people, *(np.hstack(rows) for rows in zip(*(asked[i] for i in here), strict=True)))
            for i, x, outputs in zip(here, *(np.hsplit(rows, ends) for rows in found), strict=True):
                try:
                    asked[i] = going[i].send((x, outputs))
                except StopIteration as done:
                    traces[i] = done.value
    return traces
