"""What the functions that people call say about arguments of the wrong type, and which numbers they take."""

import dataclasses
import fractions

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import glucoloop as gl
from glucoloop import control
from glucoloop.arguments import ArgumentTypeError, at_once, checked, on_host, random_key
from glucoloop.control import Decision, Observation, design_open_loop, design_pid
from glucoloop.sensors import IdealSensor
from glucoloop.simulation.user_objects import apart, sample_time_of, wrong_with

PID = design_pid(gl.PIDTuning(0.5, 150.0))
NUMBERS = st.sampled_from([float, np.float64, np.float32, np.asarray, jnp.asarray, fractions.Fraction])
WHOLE = st.sampled_from([int, np.int64, np.int32, np.uint8, np.asarray, jnp.asarray])


@given(value=st.floats(1.0, 1000.0, width=32), kind=NUMBERS)
def test_every_kind_of_number_will_do(value, kind):
    for made in (gl.Meal(kind(value), 50.0).carbs_g, gl.white_noise(kind(value)).variance):
        assert type(made) is float
        assert made == value
    assert gl.MPCTuning(output_weight=kind(value)).output_weight == value
    assert gl.GuardSettings(fall_mg_dl=kind(value)) == gl.GuardSettings(fall_mg_dl=value)


@given(value=st.integers(0, 200), kind=WHOLE)
def test_every_kind_of_whole_number_will_do(value, kind):
    made = gl.dead_time(kind(value)).samples
    assert type(made) is int
    assert made == value
    assert gl.MPCTuning(1, prediction_horizon=kind(value + 1)).prediction_horizon == value + 1
    np.testing.assert_array_equal(
        jax.random.key_data(random_key(kind(value))), jax.random.key_data(jax.random.key(value))
    )


@given(junk=st.one_of(st.text(max_size=20), st.none(), st.booleans(), st.lists(st.integers(), max_size=3), st.binary()))
def test_what_is_no_number_is_refused_by_name(junk):
    for make, name in (
        (lambda: gl.Meal(junk, 50.0), "carbs_g"),
        (lambda: gl.Meal(50.0, junk), "t_min"),
        (lambda: gl.white_noise(junk), "variance"),
        (lambda: gl.dead_time(junk), "samples"),
        (lambda: gl.dose_limits(max_mU_min=junk), "max_mU_min"),
        (lambda: gl.MPCTuning(move_weight=junk), "move_weight"),
        (lambda: gl.Scenario([], junk), "horizon_min"),
        (lambda: gl.PIDTuning(junk, 150.0), "gain_mU_min_per_mg_dl"),
        (lambda: gl.with_resolution(junk), "step_mU_min"),
        (lambda: gl.design_imc(-3.0, 90.0, junk), "delay_min"),
        (lambda: gl.Adaptive(junk), "tolerance"),
        (lambda: gl.Exponential(accuracy_mg_dl=junk), "accuracy_mg_dl"),
        (lambda: gl.MealHabits(mean_carbs_g=junk), "mean_carbs_g"),
        (lambda: random_key(junk), "key"),
    ):
        with pytest.raises(ArgumentTypeError, match=rf"^{name} is .*; give "):
            make()


class Mine:
    """A controller that JAX does not know."""

    sample_time_min = 5.0

    def init(self, observation):
        """Nothing is remembered."""
        return ()

    def step(self, state, observation):
        """Always the same."""
        return state, Decision(insulin_mU_min=observation.delivered_mU_min, status=jnp.asarray(0))


@pytest.fixture(scope="module")
def person():
    return gl.patient()


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda p: gl.simulate(PID, p), r"patient is a PID, which would do as controller; the arguments are sim"),
        (lambda p: gl.simulate(p, PID, 1.45), "sensor is 1.45, a float; give a sensor, an object with init and read"),
        (lambda p: gl.simulate(p, PID, None, IdealSensor()), "pump is an IdealSensor, which would do as sensor"),
        (
            lambda p: gl.design_mpc_se(gl.linear_model(p), gl.StateTuning()),
            "process_noise is a StateTuning, which would do as tuning; the arguments are design_mpc_se",
        ),
        (lambda p: gl.simulate(p, PID, scenario=[gl.Meal(50, 50)]), "scenario is .*; give an instance of Scenario"),
        (lambda p: gl.simulate(p, type(PID)), "controller is the class PID, not an instance of it"),
        (lambda p: gl.simulate(p, PID, key="1"), "key is '1', a str; give a whole number"),
        (lambda p: gl.simulate(p, PID, key=1.0), "key is 1.0, a float; give a whole number"),
        (lambda p: gl.simulate(p, PID, integrator="exponential"), "integrator is 'exponential', a str"),
        (lambda p: gl.simulate(p, Mine()), "controller is an instance of Mine, which JAX cannot carry"),
        (lambda p: gl.simulate(p, gl.guarded(Mine())), r"controller\.inner is an instance of Mine"),
        (lambda p: gl.guarded(None), "controller is None; give a controller, an object with init, sample_time_min"),
        (lambda p: gl.guarded(p), "controller is a SorensenPatient"),
        (lambda p: gl.guarded(PID, limits=66.9), "limits is 66.9, a float; give an instance of DoseLimits"),
        (lambda p: gl.identify("setpoint-81"), "patient is 'setpoint-81', a str; give a patient"),
        (lambda p: gl.Scenario([(50, 50)]), r"meals holds \(50, 50\), which is no meal; give meals such as Meal"),
        (lambda p: gl.Scenario(announced="yes"), "announced is 'yes', a str; give True or False"),
        (lambda p: gl.Meal("50g", 50), "carbs_g is '50g', a str; give a number in g, such as 50"),
        (lambda p: gl.Meal([50, 60], 50), r"carbs_g is \[50, 60\], a list; give a number in g"),
        (lambda p: gl.Meal(np.ones(3), 50), r"carbs_g is an array of shape \(3,\); give one number in g, and use"),
        (lambda p: gl.Meal(10**400, 50), "carbs_g of .* is too large"),
        (lambda p: gl.patient(81), "name is 81, an int; give a text"),
        (lambda p: gl.design_pid(0.5), "tuning is 0.5, a float; give an instance of PIDTuning"),
        (lambda p: gl.summarise(p), "trace is a SorensenPatient; give an instance of Trace"),
        (lambda p: gl.virtual_people("parker2000", 1, [1]), "population is 'parker2000', a str; give an instance of"),
        (lambda p: gl.simulate_people(p, PID), "people is a SorensenPatient; give an instance of VirtualPeople"),
        (lambda p: random_key(2**70), "a key of .* is too large; give a whole number of at most 63 bits"),
    ],
)  # fmt: skip
def test_a_wrong_argument_is_named(person, call, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}"):
        call(person)


def test_a_record_that_holds_what_is_wanted_is_pointed_to():
    @dataclasses.dataclass
    class Found:
        model: gl.MPCTuning

    @checked
    def takes(tuning: gl.MPCTuning) -> None: ...

    with pytest.raises(TypeError, match=r"tuning is a Found; give its part \.model"):
        takes(Found(gl.MPCTuning()))


def test_python_says_itself_what_is_missing():
    with pytest.raises(TypeError, match="carbs_g"):
        gl.Meal(t_min=50.0)
    with pytest.raises(TypeError, match="unexpected keyword argument 'size'"):
        gl.dead_time(2, size=3)


def test_a_key_of_jax_is_taken_as_it_is():
    for key in (jax.random.key(3), jax.random.PRNGKey(3)):
        assert random_key(key) is key
    with pytest.raises(ArgumentTypeError, match="key is"):
        random_key(jax.random.split(jax.random.key(3)))


def test_traced_numbers_pass_where_they_may_and_are_refused_where_they_decide_on_the_program():
    assert float(jax.jit(lambda v: gl.white_noise(v).variance)(2.0)) == 2.0
    assert float(jax.jit(lambda v: gl.dose_limits(max_mU_min=v).max_mU_min)(50.0)) == 50.0
    for make, name in (
        (lambda n: gl.dead_time(n), "samples"),
        (lambda n: gl.MPCTuning(n), "move_horizon"),
        (lambda n: gl.Scenario([], n), "horizon_min"),
        (lambda n: gl.GuardSettings(low_mg_dl=n), "low_mg_dl"),
        (lambda n: gl.design_imc(-3.0, 90.0, n), "delay_min"),
        (lambda n: gl.design_open_loop(sample_time_min=n), "sample_time_min"),
    ):
        with pytest.raises(ArgumentTypeError, match=f"^{name} is traced by JAX"):
            jax.jit(lambda n, make=make: make(n) and 0)(5)


def test_what_needs_values_says_why_and_runs_at_once_where_it_has_them():
    @on_host("it reads the number")
    def doubled(value):
        return 2.0 * float(value)

    with pytest.raises(ArgumentTypeError, match=r"doubled cannot be differentiated.*: it reads the number; value is"):
        jax.grad(doubled)(1.0)
    assert float(jax.jit(lambda x: x * doubled(np.asarray(3.0)))(1.0)) == 6.0

    @jax.jit
    def compiled(x):
        with at_once():
            assert float(jnp.sin(0.0)) == 0.0
        return x

    compiled(1.0)


@jax.tree_util.register_dataclass
@dataclasses.dataclass
class Odd:
    """A controller whose answers are made for the test."""

    answer: object = dataclasses.field(metadata={"static": True})
    sample_time_min: float = dataclasses.field(default=5.0, metadata={"static": True})

    def init(self, observation):
        """One number."""
        return jnp.zeros(())

    def step(self, state, observation):
        """Whatever the test wants."""
        return self.answer(state, observation)


def _decision(observation):
    return Decision(insulin_mU_min=observation.delivered_mU_min, status=jnp.asarray(0))


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (lambda state, seen: _decision(seen), r"Odd\.step has to return its new state and a Decision"),
        (lambda state, seen: (state, 25.0), r"Odd\.step has to return its new state and a Decision"),
        (
            lambda state, seen: (state[None], _decision(seen)),
            r"init makes float64 of shape \(\), step makes float64",
        ),
        (lambda state, seen: (state > 0.0, _decision(seen)), r"step makes bool of shape \(\); make them the same"),
        (lambda state, seen: ((state,), _decision(seen)), "changes its structure"),
        (
            lambda state, seen: (state, Decision(insulin_mU_min=jnp.ones(2), status=jnp.asarray(0))),
            r"dose of shape \(2,\) for one person",
        ),
    ],
)
def test_a_controller_that_breaks_the_protocol_is_told_how(person, answer, sentence):
    with pytest.raises(ValueError, match=sentence):
        gl.simulate(person, Odd(answer), scenario=gl.Scenario([], 10.0))


def test_a_sound_controller_has_nothing_wrong():
    seen = Observation(
        glucose_mg_dl=jnp.zeros(()),
        valid=jnp.ones((), bool),
        setpoint_mg_dl=jnp.zeros(()),
        delivered_mU_min=jnp.zeros(()),
        announced_carbs_g=jnp.zeros(()),
    )
    assert wrong_with(design_open_loop(), seen) is None


def test_functions_in_a_tree_are_kept_apart_from_its_numbers():
    tree = {"net": {"weights": [jnp.ones(2), 3.0], "activation": jnp.tanh, "name": "net"}}
    numbers, fixed = apart(tree)
    assert len(numbers) == 2
    again = fixed.joined(numbers)["net"]
    assert again["activation"] is jnp.tanh
    assert again["name"] == "net"
    assert apart(tree)[1] == fixed
    assert hash(apart(tree)[1]) == hash(fixed)


@pytest.mark.parametrize(("sample_time", "sentence"), [("5", "give a number in min"), (0.0, "sample time of 0 min")])
def test_a_sample_time_of_ones_own_is_checked(sample_time, sentence):
    with pytest.raises(ValueError, match=sentence):
        sample_time_of(Odd(None, sample_time))


@pytest.mark.parametrize("controller", [control.PID(), control.LinearMPC(), control.MPCSE(), control.MealMPC()])
def test_a_controller_without_a_design_is_refused(controller):
    with pytest.raises(TypeError, match="has settings and no design; make it with its method designed, or"):
        gl.simulate(gl.patient(), controller)


@pytest.mark.parametrize("name", ["parker-1999", "hovorka-2004", "kanderian-2009"])
def test_the_settings_of_a_patient_are_no_person(name):
    with pytest.raises(TypeError, match="without basal_insulin_mU_min and setpoint_mg_dl; give a patient"):
        gl.simulate(gl.patients.PATIENTS[name](), PID)
