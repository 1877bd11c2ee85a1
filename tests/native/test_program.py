"""Straight-line programs: what is simplified, and that it changes nothing."""

import math
import operator

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glucoloop.native.interpreter import interpret
from glucoloop.native.lower import _QUOTIENTS_A_DIVISION, Layout, lower, share_divisions
from glucoloop.native.program import BOOL, CONSTANT, FLOAT, PERSON, SAMPLE, Program
from glucoloop.native.targets.llvm.chunks import plan_chunks
from glucoloop.native.targets.llvm.emit import _fused_products

ARITHMETIC = {
    "add": operator.add,
    "sub": operator.sub,
    "exact_sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "ratio": operator.truediv,
    "neg": operator.neg,
    "abs": abs,
    "max": max,
    "min": min,
    "lt": operator.lt,
    "select": lambda which, yes, no: yes if which else no,
}


def computed(program, results, inputs):
    """Results of a program, one operation after the other."""
    values = {}
    for value in program.needed(results):
        operation, arguments = program.operations[value]
        if value in program.constants:
            values[value] = program.constants[value]
        elif operation == "input":
            values[value] = inputs[program.names[value]]
        else:
            values[value] = ARITHMETIC[operation](*(values[a] for a in arguments))
    return [values[r] for r in results]


def inputs_of(program):
    return {
        **{f"p{i}": program.input(f"p{i}", PERSON) for i in range(2)},
        **{f"s{i}": program.input(f"s{i}", SAMPLE) for i in range(3)},
    }


NUMBERS = {"p0": 3.0, "p1": -0.5, "s0": 2.0, "s1": -7.0, "s2": 0.25}
FACTORS = st.sampled_from([-2.0, -1.0, 0.0, 0.5, 1.0, 4.0])
STEPS = st.one_of(
    st.tuples(st.sampled_from(["add", "sub", "mul", "max", "min"]), st.integers(0, 30), st.integers(0, 30)),
    st.tuples(st.sampled_from(["neg", "abs"]), st.integers(0, 30)),
    st.tuples(st.just("constant"), FACTORS),
    st.tuples(st.just("halve"), st.integers(0, 30)),
    st.tuples(st.just("choose"), st.integers(0, 30), st.integers(0, 30), st.integers(0, 30)),
)


def written(program, steps):
    """Values of some steps, and what they come to in plain arithmetic; all of it is exact."""
    places = inputs_of(program)
    made = [(place, NUMBERS[name]) for name, place in places.items()]
    for step, *arguments in steps:
        chosen = [made[i % len(made)] for i in arguments] if step != "constant" else []
        if step == "constant":
            made.append((program.constant(arguments[0]), arguments[0]))
        elif step == "halve":
            (x, number), half = chosen[0], program.constant(2.0)
            made.append((program.apply("div", x, half), number / 2.0))
        elif step == "choose":
            (a, u), (b, v), (c, w) = chosen
            made.append((program.apply("select", program.apply("lt", a, b), b, c), v if u < v else w))
        else:
            number = ARITHMETIC[step](*(number for _, number in chosen))
            if abs(number) < 1e6:  # exact, with room for a few more factors
                made.append((program.apply(step, *(x for x, _ in chosen)), number))
    return places, made


@settings(max_examples=200)
@given(st.lists(STEPS, min_size=1, max_size=25))
def test_whatever_is_simplified_the_result_is_the_same(steps):
    program = Program()
    _, made = written(program, steps)
    assert computed(program, [x for x, _ in made], NUMBERS) == [number for _, number in made]


def test_equal_operations_are_one_value():
    p = Program()
    x, y = p.input("x", SAMPLE), p.input("y", PERSON)
    assert p.apply("add", x, y) == p.apply("add", y, x)
    assert p.apply("sub", x, y) != p.apply("sub", y, x)
    assert p.input("x", SAMPLE) == x
    assert p.constant(0.0) != p.constant(-0.0)
    assert p.constant(math.nan) == p.constant(math.nan)
    assert p.constant(1.0) != p.constant(True)


def test_levels_say_how_often_a_value_changes():
    p = Program()
    x, y, two = p.input("x", SAMPLE), p.input("y", PERSON), p.constant(2.0)
    assert [p.levels[v] for v in (two, y, x)] == [CONSTANT, PERSON, SAMPLE]
    assert p.levels[p.apply("add", y, two)] == PERSON
    assert p.levels[p.apply("sub", x, y)] == SAMPLE
    assert p.types[p.apply("lt", x, y)] == BOOL
    assert p.types[p.apply("select", p.apply("lt", x, y), x, y)] == FLOAT


@pytest.mark.parametrize(
    ("operation", "arguments", "result"),
    [
        ("add", (1.5, 2.0), 3.5),
        ("div", (1.0, 0.0), math.inf),
        ("div", (0.0, 0.0), math.nan),
        ("max", (math.nan, 1.0), math.nan),
        ("min", (2.0, 1.0), 1.0),
        ("sqrt", (-1.0,), math.nan),
        ("floor", (-1.5,), -2.0),
        ("lt", (1.0, math.nan), False),
        ("ne", (math.nan, math.nan), True),
        ("and", (True, False), False),
        ("xor", (True, True), False),
        ("is_finite", (math.inf,), False),
        ("select", (False, 1.0, 2.0), 2.0),
        ("number", (True,), 1.0),
    ],
)
def test_operations_on_constants_are_carried_out(operation, arguments, result):
    p = Program()
    found = p.constants[p.apply(operation, *map(p.constant, arguments))]
    assert type(found) is type(result)
    np.testing.assert_equal(found, result)


def test_nothing_is_done_where_nothing_changes():
    p = Program()
    x, truth = p.input("x", SAMPLE), p.input("t", SAMPLE, BOOL)
    zero, one, yes, no = p.constant(0.0), p.constant(1.0), p.constant(True), p.constant(False)
    for operation, arguments in {
        ("add", (x, zero)), ("add", (zero, x)), ("sub", (x, zero)), ("mul", (x, one)), ("mul", (one, x)),
        ("div", (x, one)), ("select", (yes, x, zero)), ("select", (no, zero, x)), ("select", (truth, x, x)),
        ("number", (x,)),
    }:  # fmt: skip
        assert p.apply(operation, *arguments) == x, operation
    assert p.apply("mul", x, zero) == zero
    assert p.apply("and", truth, yes) == p.apply("or", no, truth) == truth
    assert p.apply("and", no, truth) == no
    assert p.apply("or", truth, yes) == yes
    assert p.constants[p.apply("max", x, p.constant(math.nan))] is not None


def test_factors_that_change_less_often_are_gathered():
    p = Program()
    x, y, two, three = p.input("x", SAMPLE), p.input("y", PERSON), p.constant(2.0), p.constant(3.0)
    assert p.apply("mul", p.apply("mul", x, two), three) == p.apply("mul", x, p.constant(6.0))
    product = p.apply("mul", p.apply("mul", y, x), two)
    assert sorted(p.levels[a] for a in p.operations[product][1]) == [PERSON, SAMPLE]
    assert p.apply("div", x, two) == p.apply("mul", x, p.constant(0.5))
    quotient = p.apply("div", x, y)
    assert p.operations[quotient][0] == "mul"
    magic = p.constant(1.5 * 2.0**52)
    whole = p.apply("exact_sub", p.apply("add", x, magic), magic)
    assert computed(p, [whole], {"x": 2.3}) == [2.0]


def polynomial(x, a, b, c):
    """A function with factors to gather, and quotients that could share a division."""
    return ((x * a + c) * b / 3.0 - x / a) * c + jnp.tanh(x / b) / (1.0 + jnp.exp(a * x))


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0.3, 3.0), min_size=4, max_size=4))
def test_bits_of_a_program_as_written_do_not_depend_on_what_is_constant(numbers):
    x, *fixed = numbers
    zero = np.zeros(())

    def known(person, carry, own, shared, rng):
        return carry, polynomial(own, *fixed)

    def free(person, carry, own, shared, rng):
        return carry, polynomial(own, *person)

    def beside(person, carry, own, shared, rng):
        return carry, (polynomial(own, *person), own / (2.0 + jnp.exp(own)), jnp.tanh(own * own))

    own, person = np.array([[x]]), np.array(fixed)[:, None]
    constant = lower(known, (), (), zero, (), as_written=True)
    inputs = [lower(step, (zero,) * 3, (), zero, (), as_written=True) for step in (free, beside)]
    expected = interpret(constant, own=own)[1][0]
    for lowered in inputs:
        np.testing.assert_array_equal(interpret(lowered, person=person, own=own)[1][0], expected)


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40)), min_size=1, max_size=12),
    st.lists(st.floats(0.5, 2.0), min_size=5, max_size=5),
)
def test_divisions_that_are_shared_come_to_the_same(pairs, numbers):
    p = Program()
    values = list(inputs_of(p).values())
    above_half = list(values)
    inputs = dict(zip(NUMBERS, numbers, strict=True))
    ratios = []
    for i, j in pairs:
        ratios.append(p.apply("ratio", values[i % len(values)], above_half[j % len(above_half)]))
        above_half.append(p.apply("add", ratios[-1], p.constant(1.0)))
        values += [ratios[-1], above_half[-1]]
    shared, place = share_divisions(p, ratios)
    assert not any(operation == "ratio" for operation, _ in shared.operations)
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(
            computed(shared, [place[r] for r in ratios], inputs), computed(p, ratios, inputs), rtol=1e-13
        )
    assert set(map(place.get, inputs_of(p).values())) == set(range(5))


@pytest.mark.parametrize(
    ("quotients", "divisions"),
    [(1, 1), (_QUOTIENTS_A_DIVISION, 1), (_QUOTIENTS_A_DIVISION + 1, 2), (2 * _QUOTIENTS_A_DIVISION, 2)],
)
def test_a_division_serves_several(quotients, divisions):
    p = Program()
    above = [p.input(f"a{i}", SAMPLE) for i in range(quotients)]
    below = [p.input(f"b{i}", SAMPLE) for i in range(quotients)]
    ratios = [p.apply("ratio", a, b) for a, b in zip(above, below, strict=True)]
    shared, place = share_divisions(p, ratios)
    kinds = [shared.operations[v][0] for v in shared.needed([place[r] for r in ratios])]
    assert kinds.count("div") == divisions


def test_quotients_that_rest_on_one_another_or_change_at_other_times_do_not_share():
    p = Program()
    x, y = p.input("x", SAMPLE), p.input("y", PERSON)
    first = p.apply("ratio", x, p.apply("add", x, p.constant(2.0)))
    second = p.apply("ratio", first, p.apply("add", first, y))
    of_person = p.apply("ratio", y, p.apply("add", y, p.constant(2.0)))
    shared, place = share_divisions(p, [second, of_person])
    results = [place[second], place[of_person]]
    assert [shared.operations[v][0] for v in shared.needed(results)].count("div") == 3
    assert computed(shared, results, {"x": 1.0, "y": 2.0}) == pytest.approx([1 / 7, 0.5])


def carried_out(program, layout, plan, taken, inputs):
    """What the chunks hand on and write: they see inputs, constants, what they compute, and the slots."""
    slots, found = {}, {}
    at_once = {sum_: product for product, sum_ in taken.items()}

    def evaluate(value, here):
        operation, arguments = program.operations[value]
        product = at_once.get(value)
        return ARITHMETIC[operation](*(evaluate(a, here) if a == product else seen(a, here) for a in arguments))

    def seen(value, here):
        if value in here:
            return here[value]
        if value in program.constants:
            return program.constants[value]
        if program.operations[value][0] == "input":
            return inputs[program.names[value]]
        if program.levels[value] < SAMPLE:
            return computed(program, [value], inputs)[0]
        return slots[plan.cells[value]]

    for chunk in plan.chunks:
        here = {}
        for value in chunk.values:
            here[value] = evaluate(value, here)
        kept, carried = ([(v, cell) for v, cell in chunk.stored if cell[0] == array] for array in ("%slots", "%new"))
        results = {("carried", i): seen(v, here) for v, (_, i, _) in carried}
        results |= {("written", i): seen(v, here) for v, i in chunk.written}
        assert not results.keys() & found.keys()
        found |= results
        slots |= {cell: here[value] for value, cell in kept}
    stored = {cell for chunk in plan.chunks for _, cell in chunk.stored if cell[0] == "%slots"}
    assert plan.slots == len(stored)
    return [found["carried", i] for i in range(len(layout.next_carry))] + [
        found["written", i] for i in range(len(layout.outputs))
    ]


@settings(max_examples=150)
@given(st.lists(STEPS, min_size=1, max_size=25), st.integers(1, 6), st.data())
def test_chunks_of_any_size_come_to_the_same(steps, size, data):
    program = Program()
    _, made = written(program, steps)
    wanted = data.draw(st.lists(st.sampled_from(made), min_size=2, max_size=6))
    results = [place for place, _ in wanted]
    layout = Layout(person=[], carry=[], own=[], shared=[], next_carry=results[:1], outputs=results[1:])
    order = program.needed(results)
    taken = _fused_products(program, order, results)
    values = [
        v for v in order if program.levels[v] == SAMPLE and program.operations[v][0] != "input" and v not in taken
    ]
    plan = plan_chunks(program, layout, program.bodies(values), taken, size)
    assert max(len(chunk.values) for chunk in plan.chunks) <= size
    assert carried_out(program, layout, plan, taken, NUMBERS) == [number for _, number in wanted]


def test_a_product_is_fused_with_the_only_sum_that_takes_it():
    p = Program()
    x, y, z = (p.input(name, SAMPLE) for name in "xyz")
    alone, both, wanted = p.apply("mul", x, y), p.apply("mul", y, z), p.apply("mul", x, z)
    first, second, third = p.apply("add", alone, z), p.apply("sub", both, x), p.apply("add", both, wanted)
    results = [first, second, third, wanted]
    assert _fused_products(p, p.needed(results), results) == {alone: first}
