"""The engines of loops in words: grouped by what native code lacks, and few names however many cases there are."""

from glucoloop.report.descriptions import engine_facts, engine_notes

NATIVE, LACKING = {"engine": "native"}, {"engine": "xla", "not_native": "the operation 'sort' in the controller"}


def test_loops_that_lack_the_same_are_told_in_one_sentence():
    engines = {"a": NATIVE, **{f"b{number}": LACKING for number in range(7)}}
    assert list(engine_notes(engines)) == [
        "b0, b1, b2, b3, b4 and 2 more: native code cannot take these loops, which have the operation 'sort' in the "
        "controller; JAX ran them, to the same result but for rounding, and more slowly."
    ]
    assert engine_facts(engines) == {
        "Engine": "a: native code; b0, b1, b2, b3, b4 and 2 more: JAX (xla): the operation 'sort' in the controller"
    }


def test_an_engine_that_was_asked_for_needs_no_note():
    assert list(engine_notes({"a": {"engine": "xla", "not_native": None}, "b": NATIVE})) == []
